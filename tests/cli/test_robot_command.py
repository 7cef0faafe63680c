"""``cablebot robot check`` and ``cablebot robot export``."""

from xml.etree import ElementTree

import pytest

from cablebot_gym.envs import ENV_KINDS, ENV_ROBOTS
from cablebot_gym.robots import find_robot, library


def test_report_of_a_file_has_every_part(cablebot, tmp_path):
    ended = cablebot("robot check", library()["gch-klaus"], "--out", tmp_path / "my.svg")
    assert ended.status == 0
    for text in (
        "radius of gyration",
        "y points down",
        "holds up to",
        "workspace",
        "motors locked: softest",
        "steps of",
        "exact tracking carries up to",
        "limit at t =",
        "sag ",
    ):
        assert text in ended.out
    assert (tmp_path / "my.svg").read_text().count("<svg") == 1


def test_json_has_numbers_and_questions(cablebot):
    data = cablebot("robot check cogiro --payload 100 --json").data
    expected = {"kind": "spatial", "held": True, "payload": 100, "questions": []}
    assert expected.items() <= data.items()
    assert len(data["cables"]) == 8
    limit = data["limit"]
    assert limit["least"] == 0 < limit["largest"] < data["robot"]["defaults"]["payload_range"][1]


@pytest.mark.parametrize(
    ("robot", "payload", "status", "text"),
    [
        ("spatial", 1.5, 0, "1.5 kg is carried exactly"),
        ("spatial", 4, 0, "cablebot dlcc --policy fl --robot spatial"),  # within the error bounds
        (
            "spatial",
            8,
            1,
            "8 kg cannot be carried: at the start pose the motors and cables hold 7.437 kg",
        ),
        ("flex-ttk4900", 4, 0, "cablebot dlcc --policy composite --robot flex-ttk4900"),
    ],
)
def test_payload_is_judged_by_exact_tracking_and_by_the_start(
    cablebot, robot, payload, status, text
):
    ended = cablebot(f"robot check {robot} --payload {payload}")
    assert ended.status == status
    assert text in ended.out
    assert "exact tracking carries up to" in ended.out


def test_ids_have_robots_of_their_kinds():
    robots = {env_id: find_robot(name) for env_id, name in ENV_ROBOTS.items()}
    assert {env_id: (robot.kind, robot.flexible) for env_id, robot in robots.items()} == ENV_KINDS


def test_export_writes_mjcf_and_notes(cablebot, tmp_path):
    path = tmp_path / "robot.xml"
    ended = cablebot("robot export ttk4900 --payload 1 --out", path)
    assert ended.status == 0
    assert "friction per load is left out" in ended.err
    mujoco = ElementTree.fromstring(path.read_text())
    assert mujoco.find(".//body[@name='platform']/inertial").get("mass") == "1.07"
    assert mujoco.find("keyframe/key").get("name") == "home"
    assert "may have been edited" in cablebot("robot export planar --out", path).message(2)
    heavy = cablebot("robot export spatial --payload 50 --out", tmp_path / "heavy.xml")
    assert "motors cannot hold the payload" in heavy.err
