"""``cablebot dlcc``: numbers, options, files and messages."""

from __future__ import annotations

import json
import re
import shlex
import sys

import pytest
from cli.conftest import LOST, names

from cablebot_gym.evaluation.constraints import Violation
from cablebot_gym.robots import PLANAR as PLANAR_ROBOT

PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"
PARTS = ("motors", "transmission")
HANG = '{"name": "dwell-spatial", "duration": 0.05}'
QUICK = ("dlcc", SPATIAL, "--policy", "fl", "--trajectory", HANG, "--payload-max", "16", "--resolution", "0.5")
"""An evaluation that takes no time."""
ONE = (*QUICK, "--criterion", "task", "--json")
DRAWN = (*ONE, "--uncertainty", "table6", "--draws", "4", "--probability", "0.5")


def test_table_has_payloads_violations_and_bounds(cablebot):
    ended = cablebot("dlcc", SPATIAL, "--policy", "fl", "--trajectory", "paper-spatial")
    assert (ended.status, ended.err) == (0, "")
    task, paper = (next(line for line in ended.out.splitlines() if f" {name} " in line) for name in ("task", "paper"))
    assert all(part in paper for part in ("1.77", "11.77", "motor 2", "t = 0.50"))
    assert all(part in task for part in ("4.02", "rotation error reaches its bound of 10 mrad at t = 0.488 s"))
    assert all(part in ended.out for part in ("fl, paper-spatial, payload known", "position 10 mm, rotation 10 mrad"))
    assert re.search(r"resolution [\d.]+ g, with the discretisation error of the physics steps", ended.out)


def test_json_has_one_result_per_criterion(cablebot):
    task, paper = cablebot(*QUICK, "--json").data
    assert (task["criterion"], paper["criterion"]) == ("task", "paper")
    # By the task criterion the motors may saturate: they hold 16 kg at the start.
    assert (task["payload"], task["total_mass"], task["violation"], task["scan_ended"]) == (16, 26, None, True)
    assert 15 < paper["payload"] < 16
    assert (paper["violation"]["kind"], paper["violation"]["time"]) == ("torque", 0.0)
    assert 0 < paper["resolution"] <= 0.5


OPTIONS = [
    (("--payload-unknown",), ("payload_known",), False),
    (("--model-payload-factor", "0.9"), ("model_payload_factor",), 0.9),
    (("--position-bound", "20"), ("error_bounds", "position"), 0.02),
    (("--rotation-bound", "30"), ("error_bounds", "rotation"), 0.03),
    (("--payload-max", "3.5"), ("payload_max",), 3.5),
    (("--control-frequency", "400"), ("environment", "control_frequency"), 400),
    (("--seed", "7"), ("seed",), 7),
    (("--trajectory", "line-spatial"), ("environment", "trajectory", "name"), "line-spatial"),
    (("--trajectory", '{"name": "line-spatial", "duration": 0.25}'), ("environment", "trajectory", "duration"), 0.25),
    (("--criterion", "paper"), ("criterion",), "paper"),
]
DRAWN_OPTIONS = [
    (("--draws", "3"), ("draws",), 3),
    (("--probability", "0.7"), ("probability",), 0.7),
    (("--confidence", "0.6"), ("confidence",), 0.6),
    (("--uncertainty", '{"sensors": {"position": 0.001}}'), ("uncertainty",), "custom"),
    (
        ("--uncertainty", "table6+sensors"),
        ("environment", "uncertainty", "sensors", "position"),
        1e-4,
    ),
]


@pytest.mark.parametrize(
    ("usual", "option", "path", "value"),
    [*((ONE, *rest) for rest in OPTIONS), *((DRAWN, *rest) for rest in DRAWN_OPTIONS)],
)
def test_option_reaches_the_evaluation(cablebot, usual, option, path, value):
    before, after = (cablebot(*usual, *more).data[0] for more in ((), option))
    for key in path:
        before, after = (before or {}).get(key), after[key]
    assert after == value != before


def test_uncertainty_from_a_file(cablebot, tmp_path):
    path = tmp_path / "unknown.json"
    path.write_text('{"sensors": {"position": 1e-4}}', encoding="utf-8")
    result = cablebot(*DRAWN, "--uncertainty", path).data[0]
    assert result["environment"]["uncertainty"]["sensors"]["position"] == 1e-4
    for text, message in (("[1]", "must hold a JSON object"), (None, "cannot read")):
        path.unlink() if text is None else path.write_text(text, encoding="utf-8")
        assert message in cablebot(*DRAWN, "--uncertainty", path).message(2)


def test_paper_criterion_is_not_applicable_to_a_policy_that_saturates(cablebot, toys):
    clipped = (*QUICK, "--policy", toys("clipped"))
    assert "n/a" in next(line for line in cablebot(*clipped).out.splitlines() if " paper " in line)
    assert [result["criterion"] for result in cablebot(*clipped, "--json").data] == ["task"]
    assert "does not declare unsaturated_actions" in cablebot(*clipped, "--criterion", "paper").message(2)


def test_policy_that_fails_unloaded_has_no_payload(cablebot, toys):
    limp = ("dlcc", SPATIAL, "--policy", toys("limp"), "--trajectory", '{"name": "dwell-spatial", "duration": 0.3}')
    row = next(line for line in cablebot(*limp).out.splitlines() if " task " in line)
    assert "fails unloaded" in row
    assert "cable 1 falls below its tension bound of 1 N at t = 0.0" in row
    result = cablebot(*limp, "--json").data[0]
    assert (result["payload"], result["total_mass"], result["feasible"]) == (None, None, [])


def test_out_has_json_and_figures(cablebot, tmp_path):
    folder = tmp_path / "new" / "results"
    ended = cablebot("dlcc", PLANAR, "--policy", "fl", "--criterion", "task", "--out", folder, "--json")
    assert names(folder) == ["path-task.png", "result.json", "torques-task.png"]
    assert (folder / "result.json").read_text(encoding="utf-8") == ended.out
    for name in ("path-task.png", "torques-task.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
        assert name in ended.err


def test_interrupt_leaves_old_files_and_no_partial_file(cablebot, tmp_path, monkeypatch):
    (tmp_path / "path-task.png").write_text("old", encoding="utf-8")

    def interrupt(figure, path, **_):
        path.write_bytes(b"\x89PNG half")
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", interrupt)
    assert "interrupted" in cablebot(*QUICK, "--out", tmp_path).message(130)
    assert [name for name in names(tmp_path) if name.endswith("png")] == ["path-task.png"]
    assert (tmp_path / "path-task.png").read_text(encoding="utf-8") == "old"


def test_table_over_draws_has_their_number_and_what_they_assure(cablebot):
    few = [one for one in DRAWN if one != "--json"]
    text = " ".join(cablebot(*few).out.split())
    assert re.search(r"│ task │ [\d.]+ kg, 4 draws │", text)
    assert "payload: not assured: only 4 draws" in text
    assert "a lower tolerance bound needs at least 5 draws" in text
    text = " ".join(cablebot(*few, "--draws", "5", "--payload-max", "20").out.split())
    assert "payload: 50/95 lower tolerance bound, 5 draws" in text
    assert re.search(r"resolution [\d.]+ g, without the discretisation error", text)


def test_unsaturated_actions_that_only_the_policy_declares_are_marked(cablebot, toys):
    paper = (*QUICK, "--criterion", "paper")
    assert "declared" not in cablebot(*paper).out
    text = cablebot(*paper, "--policy", toys("declares")).out
    assert "paper (declared)" in text
    assert "only the policy itself says that its actions are not saturated" in text


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("raises", ("RuntimeError", "t = 0.020 s", "payloads of 0 to 10 kg", f"lost (cli_toys.py, line {LOST})")),
        ("nan", ("returned NaN or infinity", "t = 0.020 s", "with a payload of ")),
    ],
)
def test_error_of_a_policy_names_payload_and_time(cablebot, toys, name, words):
    line = cablebot("dlcc", PLANAR, "--policy", toys(name), "--out", "new").message(1)
    assert line.startswith(f"cablebot: policy '{toys(name)}'")
    assert all(part in line for part in words)
    assert "no factory today" in cablebot("dlcc", PLANAR, "--policy", toys("unmakeable")).message(2)


def test_isolated_policy_gives_the_same_result(cablebot):
    same = (*ONE, "--policy", "adaptive", "--seed", "3")  # a law with a state, which stays in its process
    assert cablebot(*same, "--isolate", "--deadline", "30").data == cablebot(*same).data


@pytest.mark.slow
def test_isolated_evaluation_has_a_secret_seed(cablebot):
    seeds = {cablebot(*ONE, "--isolate").data[0]["seed"] for _ in range(2)}
    assert len(seeds) == 2
    shown = cablebot(*(word for word in ONE if word != "--json"), "--seed", "3", "--isolate").out
    assert shown.splitlines()[-1] == "seed 3"


def test_options_of_isolation_are_checked(cablebot):
    assert "--deadline needs --isolate" in cablebot(*ONE, "--deadline", "30").message(2)
    assert "--deadline must" in cablebot(*ONE, "--isolate", "--deadline", "0").message(2)


def test_printed_command_repeats_the_failure(cablebot, tmp_path):
    """With every option that is not the default, quoted for a shell."""
    line = '{"name": "line-planar", "duration": 0.25}'
    options = ("--trajectory", line, "--position-bound", "4", "--uncertainty", "table6", "--payload-unknown")
    evaluation = ("dlcc", PLANAR, "--policy", "fl", *options, "--draws", "4", "--resolution", "0.5", "--json")
    violation = cablebot(*evaluation, "--criterion", "paper").data[0]["violation"]
    shown = cablebot(*evaluation[:-1], "--criterion", "paper").out
    typed = next(text for text in shown.splitlines() if text.startswith("  cablebot rollout"))
    assert "--position-bound 4 --payload-unknown" in typed
    ended = cablebot(*shlex.split(typed)[1:])
    assert f"paper criterion: not carried: {Violation(**violation)}" in ended.out


def test_bisection_finds_the_payload_with_few_episodes_and_is_unranked(cablebot):
    scan = cablebot(*ONE, "--payload-max", "40", "--resolution", "0.05").data[0]
    found = cablebot(*ONE, "--payload-max", "40", "--resolution", "0.05", "--search", "bisection").data[0]
    assert (scan["ranked"], found["ranked"]) == (True, False)
    assert found["payload"] == pytest.approx(scan["payload"], abs=0.1)
    assert "unranked: a bisection" in cablebot(*ONE[:-1], "--search", "bisection").out


OWN_MOTION = """
from cablebot_gym.trajectories import Dwell
class Own(Dwell):  # the process of the policy has to find it
    def __init__(self):
        super().__init__(pose=(0.0, 0.0), duration=0.05, name="own")
def motion():
    return Own()
"""


@pytest.mark.slow
def test_robot_and_motion_of_files_reach_an_isolated_policy(cablebot, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    data = PLANAR_ROBOT.replace(name="mine").to_dict()
    table = "".join(f"{name} = {json.dumps(value)}\n" for name, value in data.items() if value and name not in PARTS)
    parts = [
        f"[{name}]\n" + "".join(f"{key} = {value}\n" for key, value in data[name].items() if value) for name in PARTS
    ]
    text = (
        table + "".join(parts) + '[defaults]\ntrajectory = "own_motion_of_dlcc.py:motion"\npayload_range = [0.1, 0.2]\n'
    )
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    (tmp_path / "own_motion_of_dlcc.py").write_text(OWN_MOTION, encoding="utf-8")
    typed = ("dlcc", PLANAR, "--policy", "fl", "--robot", tmp_path / "mine.toml", "--criterion", "task", "--isolate")
    result = cablebot(*typed, "--json").data[0]
    assert (result["environment"]["robot"]["name"], result["environment"]["trajectory"]["name"]) == ("mine", "own")
    assert (result["payload"], result["scan_ended"]) == (0.2, True)


WRAPPERS = """
import gymnasium as gym

class Weak(gym.ActionWrapper):
    def action(self, action):
        return 0 * action
"""


def test_wrappers_reach_the_policy_and_the_result(cablebot, tmp_path):
    file = tmp_path / "toy_weak.py"
    file.write_text(WRAPPERS, encoding="utf-8")
    (tmp_path / "law.py").write_text("from cablebot_baselines.classical import FeedbackLinearization\n" + MAKE)
    (result,) = cablebot(*ONE, "--wrapper", str(file)).data
    assert (result["payload"], result["wrappers"]) == (None, [str(file)])
    pair = ("--policies", f"fl,{tmp_path}/law.py", "--trajectory", HANG, "--json")
    law, weak = cablebot("compare", SPATIAL, *pair, "--wrapper", str(file)).data["policies"]
    assert law["estimates"]["max_error"]["mean"] < weak["estimates"]["max_error"]["mean"]
    ended = cablebot("compare", SPATIAL, "--policies", "fl,robust", "--normalize", "x.pkl")
    assert (ended.status, "do not apply to installed policies" in ended.err) == (2, True)


MAKE = "def make(robot):\n    return FeedbackLinearization(robot)\n"


def test_several_policies_are_evaluated_by_one_command(cablebot, tmp_path):
    several = [*ONE[: ONE.index("fl")], "fl,robust,adaptive", *ONE[ONE.index("fl") + 1 :], "--out", str(tmp_path)]
    ended = cablebot(*several)
    assert [result["policy"] for result in json.loads(ended.out)] == ["fl", "robust", "adaptive"]
    alone = json.loads((tmp_path / "robust" / "result.json").read_text())
    assert alone[0]["policy"] == "robust"
