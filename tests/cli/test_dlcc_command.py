"""``cablebot dlcc``: numbers, options, files and messages."""

import json
import sys

import pytest
from cli.conftest import names, read_json

from cablebot_gym.evaluation.judge import Violation
from cablebot_gym.robots import library

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
HANG = '{"name": "dwell-spatial", "duration": 0.05}'
QUICK = f"dlcc {SPATIAL} --policy fl --trajectory '{HANG}' --payload-max 16 --resolution 0.5 "
"""An evaluation that takes no time."""
ONE = f"{QUICK} --criterion task --json "
SEVERAL = " --uncertainty table6 --draws 4 --probability 0.5 "


@pytest.mark.landing
def test_table_has_payloads_violations_and_bounds(cablebot):
    ended = cablebot(f"dlcc {SPATIAL} --policy fl --trajectory paper-spatial")
    assert (ended.status, ended.err) == (0, "")
    task, paper = (
        next(line for line in ended.out.splitlines() if f" {criterion} " in line)
        for criterion in ("task", "paper")
    )
    for text in ("1.77", "11.77", "motor 2", "t = 0.50"):
        assert text in paper
    for text in ("4.02", "rotation error reaches its bound of 10 mrad at t = 0.488 s"):
        assert text in task
    assert "position 10 mm, rotation 10 mrad" in ended.out


def test_json_has_one_result_per_criterion(cablebot):
    task, paper = cablebot(f"{QUICK} --json").data
    # By the task criterion the motors may saturate: they hold 16 kg at the start.
    expected = {"criterion": "task", "payload": 16, "total_mass": 26, "violation": None}
    assert (expected | {"scan_ended": True}).items() <= task.items()
    assert paper["criterion"] == "paper"
    assert 15 < paper["payload"] < 16
    assert (paper["violation"]["kind"], paper["violation"]["time"]) == ("torque", 0.0)
    assert 0 < paper["resolution"] <= 0.5


OPTIONS = {
    "--payload-unknown": ("payload_known", False),
    "--model-payload-factor 0.9": ("model_payload_factor", 0.9),
    "--position-bound 20": ("error_bounds.position", 0.02),
    "--rotation-bound 30": ("error_bounds.rotation", 0.03),
    "--payload-max 3.5": ("payload_max", 3.5),
    "--control-frequency 400": ("environment.control_frequency", 400),
    "--seed 7": ("seed", 7),
    f"--trajectory '{HANG.replace('0.05', '0.25')}'": ("environment.trajectory.duration", 0.25),
    "--draws 3": ("draws", 3),
    "--probability 0.7": ("probability", 0.7),
    "--uncertainty table6+sensors": ("environment.uncertainty.sensors.position", 1e-4),
}
"""Options that are not the default, each with the key of the result that has its value."""


def value_at(data, path):
    """The value of a nested key such as ``a.b``; None where there is none."""
    for key in path.split("."):
        data = (data or {}).get(key)
    return data


@pytest.mark.landing
def test_options_reach_the_evaluation(cablebot):
    (before,) = cablebot(ONE + SEVERAL).data
    (after,) = cablebot(ONE + SEVERAL + " ".join(OPTIONS)).data
    for path, value in OPTIONS.values():
        assert value_at(after, path) == value, path
        assert value_at(before, path) != value, path
    assert "least over the draws" in cablebot(QUICK + SEVERAL).out


@pytest.mark.landing
def test_paper_criterion_does_not_apply_to_saturated_actions(cablebot, toys):
    clipped = f"{QUICK} --no-isolate --policy {toys('clipped')}"
    assert " n/a " in cablebot(clipped).out
    assert [result["criterion"] for result in cablebot(clipped, "--json").data] == ["task"]


@pytest.mark.landing
def test_wrapper_reaches_the_policy(cablebot, toys, tmp_path):
    path = tmp_path / "toy_weak.py"
    path.write_text(WRAPPERS)
    (result,) = cablebot(ONE, "--policy", toys("declares"), "--wrapper", f"{path}:Weak").data
    assert (result["payload"], result["wrappers"]) == (None, [f"{path}:Weak"])


@pytest.mark.landing
def test_out_has_json_and_figures(cablebot, tmp_path):
    folder = tmp_path / "new" / "results"
    ended = cablebot(ONE, "--out", folder)
    assert names(folder) == ["result-task.png", "result.json"]
    assert (folder / "result.json").read_text() == ended.out
    assert "result-task.png" in ended.err


def test_interrupt_leaves_old_files_and_no_partial_file(cablebot, tmp_path, monkeypatch):
    figure_path = tmp_path / "result-task.png"
    figure_path.write_text("old")

    def interrupt(figure, path, **_):
        path.write_bytes(b"\x89PNG half")
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", interrupt)
    assert "interrupted" in cablebot(QUICK, "--out", tmp_path).message(130)
    assert list(tmp_path.glob("*.png")) == [figure_path]
    assert figure_path.read_text() == "old"


@pytest.mark.landing
def test_policy_of_others_is_isolated_unless_it_is_trusted(cablebot, toys):
    line = f"{QUICK} --criterion task --policy {toys('declares')}"
    assert cablebot(line, "--json").data[0]["isolated"]
    trusted = cablebot(line, "--no-isolate").out
    assert trusted.count("not isolated") == 2
    assert "leave --no-isolate out" in trusted


@pytest.mark.nightly
def test_isolated_evaluation_has_a_secret_seed(cablebot):
    seeds = {cablebot(f"{ONE} --isolate").data[0]["seed"] for _ in range(2)}
    assert len(seeds) == 2
    shown = cablebot(f"{QUICK} --criterion task --seed 3 --isolate").out
    assert shown.splitlines()[-1] == "seed 3"


@pytest.mark.landing
def test_printed_command_repeats_the_failure(cablebot):
    """With every option that is not the default, quoted for a shell."""
    motion = '{"name": "line-planar", "duration": 0.25}'
    line = f"dlcc {PLANAR} --policy fl --trajectory '{motion}' --position-bound 4 "
    line += "--uncertainty table6 --payload-unknown --draws 4 --resolution 0.5 --criterion paper"
    violation = cablebot(line, "--json").data[0]["violation"]
    shown = cablebot(line).out
    typed = next(text for text in shown.splitlines() if text.startswith("  cablebot rollout"))
    assert "--position-bound 4.0 --payload-unknown" in typed
    ended = cablebot(typed.replace("cablebot ", "", 1))
    assert f"paper criterion: not carried: {Violation(**violation)}" in ended.out


def test_bisection_finds_the_payload_and_is_unranked(cablebot):
    line = f"{ONE} --payload-max 40 --resolution 0.05"
    (scan,) = cablebot(line).data
    (bisection,) = cablebot(f"{line} --search bisection").data
    assert (scan["ranked"], bisection["ranked"]) == (True, False)
    assert bisection["payload"] == pytest.approx(scan["payload"], abs=0.1)
    text = cablebot(f"{QUICK} --criterion task --search bisection").out
    assert "unranked: a bisection" in text


OWN_MOTION = """
from cablebot_gym.motions import Dwell
class Own(Dwell):  # the process of the policy has to find it
    def __init__(self):
        super().__init__(pose=(0.0, 0.0, 0.0), duration=0.05, name="own")
def motion():
    return Own()
"""


@pytest.mark.landing
def test_robot_and_motion_of_files_reach_an_isolated_policy(cablebot, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    text = library()["gch-klaus"].read_text().partition("[defaults]")[0]
    text += '[defaults]\ntrajectory = "own_motion_of_dlcc.py:motion"\npayload_range = [0.1, 0.2]\n'
    (tmp_path / "mine.toml").write_text(text)
    (tmp_path / "own_motion_of_dlcc.py").write_text(OWN_MOTION)
    line = f"dlcc --policy composite --robot {tmp_path / 'mine.toml'} --criterion task --isolate --json"
    (result,) = cablebot(line).data
    assert result["environment"]["robot"]["name"] == "gch-klaus"
    assert result["environment"]["trajectory"]["name"] == "own"
    assert (result["payload"], result["scan_ended"]) == (0.2, True)


WRAPPERS = """
import gymnasium as gym

class Weak(gym.ActionWrapper):
    def action(self, action):
        return 0 * action
"""


@pytest.mark.landing
def test_several_policies_are_evaluated_by_one_command(cablebot, tmp_path):
    results = json.loads(cablebot(f"{ONE} --policy fl,robust --out {tmp_path}").out)
    assert [result["policy"] for result in results] == ["fl", "robust"]
    assert read_json(tmp_path / "robust" / "result.json")[0]["policy"] == "robust"
