"""``cablebot robot check``."""

from __future__ import annotations

import json

import pytest

from cablebot_gym.envs import ENV_KINDS, ENV_ROBOTS, fitting_env_id
from cablebot_gym.robots import find_robot, library


@pytest.fixture
def edited(tmp_path):
    """Writes the file of a library robot with one text replaced."""

    def write(name, old="", new=""):
        text = library()[name].read_text(encoding="utf-8")
        assert old in text
        path = tmp_path / "my.toml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return path

    return write


def test_report_of_a_file_has_every_part(cablebot, edited, tmp_path):
    ended = cablebot("robot", "check", edited("gch-klaus"), "--out", tmp_path / "my.svg")
    assert ended.status == 0
    for text in ("carries 0 kg", "limit at t =", "workspace", "motors locked: softest", "physics steps of", "sag "):
        assert text in ended.out
    assert "questions  none" in ended.out
    assert (tmp_path / "my.svg").read_text(encoding="utf-8").count("<svg") == 1


def test_json_has_numbers_and_questions(cablebot):
    data = cablebot("robot", "check", "cogiro", "--payload", 100, "--json").data
    assert (data["kind"], data["held"], data["payload"], len(data["cables"])) == ("spatial", True, 100, 8)
    assert data["limit"]["least"] == 0 < data["limit"]["largest"] < data["robot"]["defaults"]["payload_range"][1]
    assert json.dumps(data["questions"]) == "[]"


def test_payload_beyond_the_limit_is_a_failure_with_its_cause(cablebot):
    ended = cablebot("robot", "check", "ttk4900", "--payload", 4)
    assert ended.status == 1
    assert "does not carry 4 kg" in ended.out
    assert "cable 3 at the torque limit" in ended.out


@pytest.mark.parametrize(
    ("name", "old", "new", "remedy"),
    [
        ("gch-klaus", "pulley_radius = 0.0127", "pulley_radius = 12.7", "lengths are in metres"),
        ("stadium-camera", "[-60.0, 40.0, -30.0],", "[-60.0, -40.0, -30.0],", "cables 1 and 4 coincide"),
        ("stadium-camera", "-30.0]", "10.0]", "no positive tensions hold"),
        ("stadium-camera", "  [60.0, 40.0, -30.0],\n  [-60.0, 40.0, -30.0],\n", "", "needs at least 3 cables"),
        ("stadium-camera", "home_pose = [0.0, 0.0, -12.0]", "home_pose = [0.0, 0.0, -32.0]", "outside the workspace"),
    ],
)
def test_impossible_robot_is_refused_with_its_remedy(cablebot, edited, name, old, new, remedy):
    ended = cablebot("robot", "check", edited(name, old, new))
    assert (ended.status, ended.out) == (1, "")
    assert ended.err.startswith("refused: robot file")
    assert remedy in ended.err


def test_command_finds_the_id_by_the_robot(cablebot):
    found = {name: fitting_env_id(name) for name in ("cogiro", "stadium-camera", "ttk4900", "flex-cogiro", "planar")}
    assert list(found.values()) == [
        *("CableBot-Spatial-v0", "CableBot-Point-v0", "CableBot-PlanarPlatform-v0"),
        *("CableBot-FlexSpatial-v0", "CableBot-Planar-v0"),
    ]
    kinds = {env_id: (find_robot(name).kind, find_robot(name).flexible) for env_id, name in ENV_ROBOTS.items()}
    assert kinds == ENV_KINDS
    assert "give an environment id, one of" in cablebot("dlcc", "--policy", "fl").message(2)
    unknown = cablebot("rollout", "--policy", "no", "--robot", "ttk4900", "--out", "run.csv").message(2)
    assert "unknown policy 'no'" in unknown


def test_unknown_robot_and_task_are_invalid_input(cablebot):
    assert "did you mean 'cogiro'" in cablebot("robot", "check", "cogyro").message(2)
    assert "choose one of check" in cablebot("robot", "chek", "cogiro").message(2)
    assert "must end in .svg" in cablebot("robot", "check", "cogiro", "--out", "my.txt").message(2)
