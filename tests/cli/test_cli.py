"""The command line: what it prints where, which exit status it ends with, and what it leaves behind."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import typer

import cablebot_gym.evaluation
import cablebot_gym.evaluation.comparison
import cablebot_gym.evaluation.rollout
from cablebot_baselines.paper.interpretation import choices_of
from cablebot_baselines.paper.published import PUBLISHED
from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli
from cablebot_gym.cli import listing
from cablebot_gym.envs import env_robot
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import TRAJECTORIES, find_trajectory, trajectory_names
from cablebot_gym.uncertainty import (
    PARAMETERS,
    UNCERTAINTIES,
    ExternalWrench,
    ParameterDistribution,
    SensorNoise,
    find_uncertainty,
)

PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"
HANG = '{"name": "dwell-spatial", "duration": 0.05}'
"""A static hang, as short as a hang can be judged."""
QUICK = (SPATIAL, "--policy", "fl", "--trajectory", HANG, "--payload-max", "16", "--resolution", "0.5")
"""Arguments of an evaluation that takes no time."""


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a command ended."""

    status: int
    out: str
    err: str


@pytest.fixture
def cablebot(monkeypatch, capsys):
    """Runs the command in this process."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["cablebot", *map(str, arguments)])
        status = 0
        try:
            cli.main()
        except SystemExit as ended:
            status = ended.code or 0
        out, err = capsys.readouterr()
        return Ended(status, out, err)

    return run


@pytest.fixture
def toys(tmp_path, monkeypatch):
    """A module of policies by ``toys:name``, each FL except for what its name says."""
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "cli_toys.py").write_text(TOYS, encoding="utf-8")
    monkeypatch.syspath_prepend(folder)
    yield lambda name: f"cli_toys:{name}"
    sys.modules.pop("cli_toys", None)


TOYS = """
import os
import signal
import numpy as np
from cablebot_baselines.classical import FeedbackLinearization

class Toy(FeedbackLinearization):
    steps = 0
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state)
        self.steps += 1
        return (self.eleventh(action) if self.steps == 11 else action), state

class raises(Toy):
    def eleventh(self, action):
        raise RuntimeError("lost")

class short(Toy):
    def eleventh(self, action):
        return action[..., :2]

class nan(Toy):
    def eleventh(self, action):
        return action * np.nan

class interrupted(Toy):
    def eleventh(self, action):
        os.kill(os.getpid(), signal.SIGINT)
        return action

def unmakeable(robot):
    raise RuntimeError("no factory today")

def clipped(robot):
    law = FeedbackLinearization(robot)
    return lambda observation: np.clip(law.predict(observation)[0], -1, 1)

def limp(robot):
    return lambda observation: np.zeros(robot.cables)
"""

LOST = 1 + next(place for place, line in enumerate(TOYS.splitlines()) if "lost" in line)
"""Line of the toys that raises."""


def one_line(ended, status):
    """The sentence on standard error; asserts that there is nothing else."""
    lines = [line for line in ended.err.splitlines() if line.strip()]
    assert len(lines) == 1, ended.err
    assert lines[0].startswith("cablebot: ")
    assert "Traceback" not in ended.err
    assert ended.out == ""
    assert ended.status == status
    return lines[0]


def refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


def loads(text):
    return json.loads(text, parse_constant=refuse)


# --- list and help ----------------------------------------------------------------------------------------------------


def test_list_does_not_print_anything_but_json(cablebot):
    ended = cablebot("list", "--json")
    assert (ended.status, ended.err) == (0, "")
    data = loads(ended.out)
    assert data["env_ids"] == list(ENV_IDS)
    assert data["trajectories"] == trajectory_names()
    assert data["uncertainties"] == list(UNCERTAINTIES)
    assert data["uncertain_parameters"] == list(PARAMETERS)
    assert [policy["name"] for policy in data["policies"]] == list(policy_entries())
    for policy in data["policies"]:
        assert set(policy) >= {"name", "kind", "env_ids"}
        assert policy["kind"] in {"classical", "optimal", "learned"}
        assert set(policy["env_ids"]) <= set(ENV_IDS)
    assert {"name": "fl", "kind": "classical", "env_ids": [PLANAR, SPATIAL]} in data["policies"]


def test_list_for_people_does_not_leave_a_name_out(cablebot):
    ended = cablebot("list")
    assert ended.status == 0
    printed = ended.out.split()
    for names_ in (ENV_IDS, trajectory_names(), UNCERTAINTIES, PARAMETERS, policy_entries()):
        assert set(names_) <= set(printed)


def test_list_fits_80_columns_and_shows_every_field(cablebot, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = cablebot("list").out
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    sections = text.split("\n\n")
    trajectories = next(section for section in sections if section.startswith("Trajectories"))
    rows = [line.split() for line in trajectories.splitlines()[3:]]
    for name, make in TRAJECTORIES.items():
        start = next(place for place, row in enumerate(rows) if row[0] == name)
        block = [rows[start][1:], *itertools.takewhile(lambda row: row[0] not in TRAJECTORIES, rows[start + 1 :])]
        expected = {field.name for field in dataclasses.fields(make())} - {"name"}
        assert expected <= {row[0] for row in block}
    fields = next(section for section in sections if section.startswith("Fields of an uncertainty"))
    for kind in (ParameterDistribution, ExternalWrench, SensorNoise):
        assert {field.name for field in dataclasses.fields(kind)} <= set(fields.split())
    for path in ("parameters.platform_mass", "parameters.stiffness", "wrench.force_std", "sensors.motor_speed"):
        assert path in text.split()
    for unit in (parameter.unit for parameter in PARAMETERS.values()):
        assert unit in text.split()


def test_every_field_and_parameter_has_a_unit():
    names_ = {field.name for make in TRAJECTORIES.values() for field in dataclasses.fields(make())}
    assert names_ - {"name"} == set(listing._TRAJECTORY_UNITS)


def test_listed_defaults_make_the_named_trajectory(cablebot):
    data = loads(cablebot("list", "--json").out)
    for name, entries in data["trajectory_fields"].items():
        given = {key: entry["default"] for key, entry in entries.items()}
        coordinates = TRAJECTORIES[name]().coordinates
        assert find_trajectory({"name": name, **given}, coordinates) == TRAJECTORIES[name]()


def test_listed_uncertainty_fields_make_the_named_uncertainty(cablebot):
    data = loads(cablebot("list", "--json").out)
    for name, entries in data["uncertainty_fields"].items():
        for env_id in ENV_IDS:
            given = {}
            for path, entry in entries.items():
                if env_id in entry["env_ids"]:
                    group, _, key = path.partition(".")
                    given.setdefault(group, {})[key] = entry["value"]
            robot = find_robot(env_robot(env_id))
            assert find_uncertainty(given, robot) == find_uncertainty(name, robot)


COMMANDS = sorted(cli.command_points())


def test_no_command_is_missing():
    assert set(COMMANDS) >= {"benchmark", "compare", "dlcc", "list", "rollout"}


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_no_command_lacks_an_example(cablebot, command):
    ended = cablebot(command, "--help")
    assert (ended.status, ended.err) == (0, "")
    assert re.search(rf"Examples?:\s+cablebot {command}\b", ended.out)


def test_help_does_not_fail(cablebot):
    ended = cablebot("--help")
    assert (ended.status, ended.err) == (0, "")
    assert all(command in ended.out for command in COMMANDS)


def test_help_at_80_columns_has_the_full_first_sentence_of_every_command(cablebot, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = cablebot("--help").out
    assert max(map(len, text.splitlines())) <= 80
    assert "..." not in text.partition("\n")[2]  # the first line is the usage, with [ARGS]...
    commands = typer.main.get_command(cli.app).commands
    printed = " ".join(text.split())
    for name, command in commands.items():
        sentence = re.match(r".+?\.(?=\s|$)", " ".join(command.help.split()))[0]
        assert f" {name} {sentence}" in printed


def test_command_is_not_missing_from_the_installation():
    ended = subprocess.run(
        [sys.executable, "-m", "cablebot_gym.cli.app", "list", "--json"], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert loads(ended.stdout)["env_ids"] == list(ENV_IDS)


# --- dlcc -------------------------------------------------------------------------------------------------------------


def test_table_does_not_lack_payload_motor_or_time(cablebot):
    ended = cablebot("dlcc", SPATIAL, "--policy", "fl")
    assert ended.status == 0
    assert "Traceback" not in ended.err
    task, paper = (next(line for line in ended.out.splitlines() if f" {name} " in line) for name in ("task", "paper"))
    for part in ("1.77", "11.77", "motor 2", "t = 0.50"):
        assert part in paper
    assert "4.03" in task
    assert "rotation at t = 0.4" in task
    for part in (SPATIAL, "fl", "paper-spatial", "payload known", "10 mm", "10 mrad"):
        assert part in ended.out


def test_json_is_not_mixed_with_anything_else(cablebot):
    ended = cablebot("dlcc", *QUICK, "--json")
    assert ended.status == 0
    assert ended.err.strip() == ""
    results = loads(ended.out)
    assert [result["criterion"] for result in results] == ["task", "paper"]
    for result in results:
        assert (result["env_id"], result["policy"]) == (SPATIAL, "fl")
        assert result["total_mass"] == result["payload"] + 10
        assert set(result) >= {"error_bounds", "versions"}
    task, paper = results
    assert set(paper["violation"]) >= {"kind", "index", "time"}
    # The motors saturate, and the platform falls slowly enough.
    assert (task["payload"], task["violation"], task["scan_ended"]) == (16, None, True)
    assert (14 < paper["payload"] < 15, paper["violation"]["kind"], paper["violation"]["time"]) == (True, "torque", 0.0)
    assert 0 < paper["resolution"] <= 0.5


@pytest.mark.parametrize("criterion", ["task", "paper"])
def test_criterion_that_is_not_asked_for_is_not_evaluated(cablebot, criterion):
    ended = cablebot("dlcc", *QUICK, "--criterion", criterion, "--json")
    assert [result["criterion"] for result in loads(ended.out)] == [criterion]


@pytest.mark.parametrize(
    ("option", "place", "value"),
    [
        (("--payload-unknown",), ("payload_known",), False),
        (("--payload-known",), ("payload_known",), True),
        (("--model-payload-factor", "0.9"), ("model_payload_factor",), 0.9),
        (("--position-bound", "0.02"), ("error_bounds", "position"), 0.02),
        (("--rotation-bound", "0.03"), ("error_bounds", "rotation"), 0.03),
        (("--payload-max", "3.5"), ("payload_max",), 3.5),
        (("--control-frequency", "400"), ("environment", "control_frequency"), 400),
        (("--seed", "7"), ("seed",), 7),
        (("--trajectory", "lemniscate-spatial"), ("environment", "trajectory", "name"), "lemniscate-spatial"),
        (
            ("--trajectory", '{"name": "line-spatial", "duration": 0.25}'),
            ("environment", "trajectory", "duration"),
            0.25,
        ),
    ],
)
def test_option_is_not_read_and_then_discarded(cablebot, option, place, value):
    usual = loads(cablebot("dlcc", *QUICK, "--criterion", "task", "--json").out)[0]
    changed = loads(cablebot("dlcc", *QUICK, "--criterion", "task", *option, "--json").out)[0]
    for key in place:
        usual, changed = usual[key], changed[key]
    assert changed == value
    assert usual != value or option == ("--payload-known",)


def test_resolution_is_not_read_and_then_discarded(cablebot):
    (result,) = loads(cablebot("dlcc", *QUICK, "--resolution", "1e-5", "--criterion", "paper", "--json").out)
    assert 0 < result["resolution"] <= 1e-5


def test_paper_criterion_is_not_printed_for_a_policy_that_clips_itself(cablebot, toys):
    arguments = (*QUICK[:2], toys("clipped"), *QUICK[3:])
    table = cablebot("dlcc", *arguments)
    assert table.status == 0
    assert "n/a" in next(line for line in table.out.splitlines() if " paper " in line)
    assert [result["criterion"] for result in loads(cablebot("dlcc", *arguments, "--json").out)] == ["task"]
    line = one_line(cablebot("dlcc", *arguments, "--criterion", "paper"), 2)
    assert "does not declare unsaturated_actions" in line


def test_policy_that_fails_at_zero_is_not_given_zero_kilograms_in_silence(cablebot, toys):
    arguments = (SPATIAL, "--policy", toys("limp"), "--trajectory", '{"name": "dwell-spatial", "duration": 0.3}')
    table = cablebot("dlcc", *arguments)
    row = next(line for line in table.out.splitlines() if " task " in line)
    assert "fails unloaded" in row
    assert "position at t = 0.0" in row
    result = loads(cablebot("dlcc", *arguments, "--json").out)[0]
    assert (result["payload"], result["total_mass"], result["feasible"]) == (None, None, [])
    assert result["violation"]["kind"] == "position"


# --- dlcc --out -------------------------------------------------------------------------------------------------------


def names(folder):
    return sorted(path.name for path in folder.iterdir())


FIGURES = ["path-paper.png", "path-task.png", "torques-paper.png", "torques-task.png"]


def test_out_does_not_lack_a_file(cablebot, tmp_path):
    folder = tmp_path / "new" / "results"
    ended = cablebot("dlcc", *QUICK, "--out", folder, "--json")
    assert ended.status == 0, ended.err
    assert names(folder) == sorted([*FIGURES, "result.json"])
    assert loads((folder / "result.json").read_text(encoding="utf-8")) == loads(ended.out)
    for name in FIGURES:
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
        assert name in ended.err
    assert "result.json" in ended.err


def test_second_run_does_not_keep_the_first_ones_result(cablebot, tmp_path):
    for frequency in ("500", "250"):
        cablebot("dlcc", *QUICK, "--control-frequency", frequency, "--out", tmp_path)
    stored = loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert [result["environment"]["control_frequency"] for result in stored] == [250, 250]
    assert names(tmp_path) == sorted([*FIGURES, "result.json"])


@pytest.fixture
def no_work(monkeypatch):
    """Fails the test when anything is evaluated or recorded."""

    def work(*_, **__):
        pytest.fail("found out after the work")

    monkeypatch.setattr(cablebot_gym.evaluation, "evaluate_dlcc", work)
    monkeypatch.setattr(cablebot_gym.evaluation.comparison, "compare_policies", work)
    monkeypatch.setattr(cablebot_gym.evaluation.rollout, "record_rollout", work)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("below", ["", "sub", "sub/deeper"])
def test_folder_that_cannot_be_written_is_not_found_out_after_the_work(cablebot, tmp_path, below):
    file = tmp_path / "file"
    file.write_text("kept", encoding="utf-8")
    line = one_line(cablebot("dlcc", *QUICK, "--out", file / below), 2)
    assert "cannot write to folder" in line
    assert names(tmp_path) == ["file"]
    assert file.read_text(encoding="utf-8") == "kept"


@pytest.mark.usefixtures("no_work")
def test_missing_matplotlib_is_not_found_out_after_the_work(cablebot, tmp_path, monkeypatch):
    for module in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    line = one_line(cablebot("dlcc", *QUICK, "--out", tmp_path / "results"), 2)
    assert "pip install 'cablebot-gym[plot]'" in line
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    "wrong",
    [
        ("dlcc", "CableBot-Spatial-v7", "--policy", "fl"),
        ("dlcc", SPATIAL, "--policy", "lqr"),
        ("dlcc", SPATIAL, "--policy", "fl", "--trajectory", "spiral"),
        ("dlcc", SPATIAL, "--policy", "fl", "--resolution", "0"),
        ("dlcc", SPATIAL, "--policy", "fl", "--criterion", "both of them"),
    ],
    ids=["id", "policy", "trajectory", "resolution", "criterion"],
)
def test_bad_input_does_not_leave_an_empty_folder(cablebot, tmp_path, wrong):
    one_line(cablebot(*wrong, "--out", tmp_path / "results"), 2)
    assert names(tmp_path) == []


# --- dlcc --uncertainty -----------------------------------------------------------------------------------------------

DRAWN = (*QUICK, "--uncertainty", "table6", "--draws", "4", "--probability", "0.5", "--criterion", "task")
"""Arguments of an evaluation over draws."""


def test_table_over_draws_does_not_lack_draws_probability_or_bound(cablebot):
    ended = cablebot("dlcc", *DRAWN, "--confidence", "0.9")
    assert (ended.status, ended.err) == (0, "")
    text = " ".join(ended.out.split())
    for part in (
        f"{SPATIAL}, fl, dwell-spatial, payload known, table6, 4 draws",
        "required success rate: 50% of the draws",
        "(90%/50% lower tolerance bound)",
    ):
        assert part in text


@pytest.mark.parametrize(
    ("option", "place", "value"),
    [
        ((), ("draws",), 4),
        ((), ("probability",), 0.5),
        ((), ("uncertainty",), "table6"),
        ((), ("environment", "uncertainty", "wrench", "force_mean"), 0.5),
        (("--draws", "3"), ("draws",), 3),
        (("--probability", "0.7"), ("probability",), 0.7),
        (("--confidence", "0.6"), ("confidence",), 0.6),
        (("--uncertainty", '{"sensors": {"position": 0.001}}'), ("uncertainty",), "custom"),
        (
            ("--uncertainty", '{"sensors": {"position": 0.001}, "delay": 2}'),
            ("environment", "uncertainty", "sensors", "position"),
            0.001,
        ),
        (("--uncertainty", "table6+sensors"), ("environment", "uncertainty", "sensors", "position"), 1e-4),
    ],
)
def test_option_of_the_uncertainty_is_not_read_and_then_discarded(cablebot, option, place, value):
    ended = cablebot("dlcc", *DRAWN, *option, "--json")
    assert (ended.status, ended.err) == (0, "")
    (found,) = loads(ended.out)
    for key in place:
        found = found[key]
    assert found == value


def test_evaluation_without_an_uncertainty_is_not_over_draws(cablebot):
    (result,) = loads(cablebot("dlcc", *QUICK, "--criterion", "task", "--json").out)
    assert (result["draws"], result["uncertainty"], result["probability"]) == (1, None, None)


def test_seed_of_the_draws_is_not_read_and_then_discarded(cablebot):
    arguments = (*DRAWN, "--position-bound", "0.001", "--rotation-bound", "1", "--probability", "0.3")
    one, same, other = (loads(cablebot("dlcc", *arguments, "--seed", seed, "--json").out)[0] for seed in (0, 0, 1))
    assert one == same
    assert (one["success"], one["margins"]) != (other["success"], other["margins"])


def test_policy_for_other_robots_does_not_run_without_a_word(cablebot):
    ended = cablebot("dlcc", *QUICK, "--criterion", "task")
    assert "note" not in ended.err
    flexible = ("dlcc", "CableBot-FlexSpatial-v0", "--policy", "fl", "--trajectory", HANG, "--criterion", "task")
    ended = cablebot(*flexible, "--payload-max", "1", "--resolution", "1")
    assert ended.status == 0
    assert ended.err.splitlines() == [
        "note: fl is designed for CableBot-Planar-v0, CableBot-Spatial-v0, not for CableBot-FlexSpatial-v0"
    ]


# --- compare ----------------------------------------------------------------------------------------------------------

PAIR = ("compare", SPATIAL, "--trajectory", HANG, "--uncertainty", "table6", "--draws", "3", "--policies")
"""Arguments of a comparison that takes no time, but for the policies."""


def test_comparison_does_not_lack_a_policy_or_the_reduction(cablebot, toys):
    ended = cablebot(*PAIR, f"fl,{toys('limp')}", "--payload", "1.5", "--payload-unknown")
    assert (ended.status, ended.err) == (0, "")
    lines = ended.out.splitlines()
    assert lines[0].strip() == f"{SPATIAL}, payload 1.5 kg, payload unknown, 3 draws of table6"
    assert sum(line.startswith(("│ fl ", "│ cli_toys:limp ")) for line in lines) == 2
    assert any(line.startswith("cli_toys:limp against fl: mean error +") for line in lines)


def test_comparison_as_json_is_not_mixed_with_anything_else(cablebot, toys):
    ended = cablebot(*PAIR, f" fl , {toys('limp')},", "--json")
    assert (ended.status, ended.err) == (0, "")
    data = loads(ended.out)
    assert [policy["policy"] for policy in data["policies"]] == ["fl", "cli_toys:limp"]
    assert (data["draws"], data["uncertainty"], data["env_id"], data["payload"]) == (3, "table6", SPATIAL, 0)


@pytest.mark.parametrize(
    ("option", "place", "value"),
    [
        (("--payload", "2.5"), ("payload",), 2.5),
        (("--payload-unknown",), ("payload_known",), False),
        (("--model-payload-factor", "0.9"), ("model_payload_factor",), 0.9),
        (("--uncertainty", "sensors"), ("uncertainty",), "sensors"),
        (("--draws", "2"), ("draws",), 2),
        (("--seed", "9"), ("seed",), 9),
        (("--position-bound", "0.02"), ("error_bounds", "position"), 0.02),
        (("--rotation-bound", "0.03"), ("error_bounds", "rotation"), 0.03),
        (("--control-frequency", "400"), ("environment", "control_frequency"), 400),
        (
            ("--trajectory", '{"name": "line-spatial", "duration": 0.05}'),
            ("environment", "trajectory", "name"),
            "line-spatial",
        ),
    ],
)
def test_option_of_a_comparison_is_not_read_and_then_discarded(cablebot, option, place, value):
    arguments = (*PAIR, "fl", "--payload", "2")
    usual, changed = (loads(cablebot(*arguments, *more, "--json").out) for more in ((), option))
    assert usual["policies"] != changed["policies"] or "bound" in option[0]
    for key in place:
        usual, changed = usual[key], changed[key]
    assert changed == value
    assert usual != value


def test_comparison_does_not_lack_a_file(cablebot, tmp_path):
    folder = tmp_path / "new" / "results"
    ended = cablebot(*PAIR, "fl", "--out", folder, "--json")
    assert ended.status == 0, ended.err
    assert names(folder) == ["comparison.json", "comparison.png"]
    assert loads((folder / "comparison.json").read_text(encoding="utf-8")) == loads(ended.out)
    assert (folder / "comparison.png").read_bytes().startswith(b"\x89PNG")
    assert all(name in ended.err for name in names(folder))


@pytest.mark.usefixtures("no_work")
def test_folder_of_a_comparison_that_cannot_be_written_is_not_found_out_after_the_work(cablebot, tmp_path):
    file = tmp_path / "file"
    file.write_text("kept", encoding="utf-8")
    assert "cannot write to folder" in one_line(cablebot(*PAIR, "fl", "--out", file / "sub"), 2)
    for name in ("comparison.json", "comparison.png"):
        (tmp_path / name).mkdir()
        assert f"{name}': it is a folder" in one_line(cablebot(*PAIR, "fl", "--out", tmp_path), 2)
        (tmp_path / name).rmdir()
    assert names(tmp_path) == ["file"]
    assert file.read_text(encoding="utf-8") == "kept"


@pytest.mark.usefixtures("no_work")
def test_missing_matplotlib_for_a_comparison_is_not_found_out_after_the_work(cablebot, tmp_path, monkeypatch):
    for module in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    line = one_line(cablebot(*PAIR, "fl", "--out", tmp_path / "results"), 2)
    assert "pip install 'cablebot-gym[plot]'" in line
    assert names(tmp_path) == []


@pytest.fixture
def heard():
    """Ctrl-C is heard, also where a shell that starts jobs in the background has them ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
def test_interrupted_comparison_does_not_touch_what_was_there(cablebot, toys, tmp_path):
    for name in ("comparison.json", "comparison.png"):
        (tmp_path / name).write_text("old", encoding="utf-8")
    ended = cablebot(*PAIR, f"fl,{toys('interrupted')}", "--out", tmp_path)
    assert "interrupted" in one_line(ended, 130)
    assert names(tmp_path) == ["comparison.json", "comparison.png", "modules"]
    assert (tmp_path / "comparison.json").read_text(encoding="utf-8") == "old"


def test_interrupted_figure_of_a_comparison_does_not_leave_half_a_file(cablebot, tmp_path, monkeypatch):
    figure = pytest.importorskip("matplotlib.figure")

    def savefig(self, path, **keywords):
        path.write_bytes(b"\x89PNG half")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure.Figure, "savefig", savefig)
    assert cablebot(*PAIR, "fl", "--out", tmp_path).status == 130
    assert set(names(tmp_path)) <= {"comparison.json"}


def test_policy_that_fails_in_a_comparison_is_not_without_its_name(cablebot, toys, tmp_path):
    ended = cablebot(*PAIR, f"fl,{toys('raises')}", "--payload", "0.5", "--out", tmp_path / "out")
    line = one_line(ended, 1)
    assert line.startswith("cablebot: policy 'cli_toys:raises' raised RuntimeError at t = 0.020 s with ")
    assert line.endswith(f"0.5 kg: lost (cli_toys.py, line {LOST})")
    assert names(tmp_path) == ["modules"]


# --- interrupted ------------------------------------------------------------------------------------------------------


def interrupting(after):
    """``evaluate_dlcc``, interrupted in its call number ``after`` + 1."""
    original, calls = cablebot_gym.evaluation.evaluate_dlcc, []

    def evaluate(*arguments, **keywords):
        calls.append(1)
        if len(calls) > after:
            raise KeyboardInterrupt
        return original(*arguments, **keywords)

    return evaluate


@pytest.mark.parametrize("after", [0, 1], ids=["first criterion", "second criterion"])
def test_interrupted_evaluation_does_not_touch_what_was_there(cablebot, tmp_path, monkeypatch, after):
    (tmp_path / "result.json").write_text("old", encoding="utf-8")
    monkeypatch.setattr(cablebot_gym.evaluation, "evaluate_dlcc", interrupting(after))
    line = one_line(cablebot("dlcc", *QUICK, "--out", tmp_path), 130)
    assert "interrupted" in line
    assert names(tmp_path) == ["result.json"]
    assert (tmp_path / "result.json").read_text(encoding="utf-8") == "old"


def test_interrupted_figure_does_not_leave_half_a_file(cablebot, tmp_path, monkeypatch):
    figure = pytest.importorskip("matplotlib.figure")

    def savefig(self, path, **keywords):
        with open(path, "wb") as file:
            file.write(b"\x89PNG half")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure.Figure, "savefig", savefig)
    ended = cablebot("dlcc", *QUICK, "--out", tmp_path)
    assert ended.status == 130
    assert set(names(tmp_path)) <= {"result.json"}
    if names(tmp_path):
        assert len(loads((tmp_path / "result.json").read_text(encoding="utf-8"))) == 2
        assert "nothing was written" not in ended.err


def test_interrupted_recording_does_not_touch_what_was_there(cablebot, tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text("old", encoding="utf-8")

    def record(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(cablebot_gym.evaluation.rollout, "record_rollout", record)
    assert "interrupted" in one_line(cablebot("rollout", PLANAR, "--policy", "fl", "--out", path), 130)
    assert names(tmp_path) == ["run.csv"]
    assert path.read_text(encoding="utf-8") == "old"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("command", ["dlcc", "compare", "rollout"])
def test_ctrl_c_does_not_end_with_another_status_than_130(toys, tmp_path, command):
    out = tmp_path / "out"
    out.mkdir()
    target = {"dlcc": out, "compare": out, "rollout": out / "run.npz"}[command]
    # A shell that starts jobs in the background may have them ignore the signal, which Python inherits.
    start = (
        f"import signal, cablebot_gym.cli.app as c; signal.signal({int(signal.SIGINT)}, signal.default_int_handler); "
    )
    option = "--policies" if command == "compare" else "--policy"
    arguments = (command, PLANAR, option, toys("interrupted"), "--out", str(target))
    ended = subprocess.run(
        [sys.executable, "-c", start + "c.main()", *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path / "modules"), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    # A process of its own may be the first to compile, and says so.
    said = "".join(line for line in ended.stderr.splitlines(keepends=True) if not line.startswith("compiling"))
    assert "interrupted" in one_line(Ended(ended.returncode, ended.stdout, said), 130)
    assert names(out) == []


# --- a policy that fails ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("raises", f"raised RuntimeError at t = 0.020 s with payloads of 0 to 10 kg: lost (cli_toys.py, line {LOST})"),
        ("short", "returned shape (64, 2) at t = 0.020 s with payloads of 0 to 10 kg; expected (64, 3)"),
        ("nan", "returned NaN or infinity at t = 0.020 s with a payload of 0 kg"),
    ],
)
def test_policy_that_fails_in_an_evaluation_is_not_without_payload_and_time(cablebot, toys, tmp_path, name, message):
    (tmp_path / "result.json").write_text("old", encoding="utf-8")
    line = one_line(cablebot("dlcc", PLANAR, "--policy", toys(name), "--out", tmp_path), 1)
    assert line == f"cablebot: policy '{toys(name)}' {message}"
    assert names(tmp_path) == ["modules", "result.json"]
    assert (tmp_path / "result.json").read_text(encoding="utf-8") == "old"


@pytest.mark.parametrize("name", ["raises", "short", "nan"])
def test_policy_that_fails_in_a_recording_is_not_without_payload_and_time(cablebot, toys, tmp_path, name):
    path = tmp_path / "run.csv"
    ended = cablebot("rollout", PLANAR, "--policy", toys(name), "--payload", "0.25", "--out", path)
    line = one_line(ended, 1)
    assert "0.25 kg" in line
    assert "t = 0.020 s" in line
    assert not path.exists()


def test_factory_that_raises_is_not_a_traceback(cablebot, toys):
    ended = cablebot("dlcc", PLANAR, "--policy", toys("unmakeable"))
    assert "no factory today" in one_line(ended, ended.status)
    assert ended.status in (1, 2)


# --- bad input --------------------------------------------------------------------------------------------------------

BAD = [
    (("dlcc", "CableBot-Cubic-v0", "--policy", "fl"), "choose one of CableBot-Planar-v0, CableBot-Spatial-v0"),
    (("dlcc", SPATIAL, "--policy", "lqr"), "unknown policy 'lqr'; choose one of "),
    (("dlcc", SPATIAL, "--policy", "nowhere.zip"), "'nowhere.zip' does not exist"),
    (("dlcc", SPATIAL, "--policy", "nowhere:make"), "cannot import 'nowhere'"),
    (("dlcc", SPATIAL, "--policy", "nowhere.py:make"), "write the module name without .py: nowhere:make"),
    (("dlcc", SPATIAL, "--policy", "json:make"), "'json' has no attribute 'make'"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", "spiral"), "unknown trajectory 'spiral'; choose one of paper"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", "paper-planar"), "paper-spatial, circle-spatial"),
    (("dlcc", PLANAR, "--policy", "fl", "--trajectory", "paper-spatial"), "paper-planar, circle-planar"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"name": '), "--trajectory is not valid JSON"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"name": "spiral"}'), "choose one of paper-spatial"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"duration": 1.0}'), "name"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"name": "circle-spatial", "speed": 2}'), "speed"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"name": "circle-spatial", "duration": -1}'), "duration"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"name": "circle-spatial", "duration": NaN}'), "duration"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"name": "circle-spatial", "duration": "1"}'), "duration"),
    (("dlcc", SPATIAL, "--policy", "fl", "--trajectory", '{"name": ["circle-spatial"]}'), "circle-spatial"),
    (("dlcc", SPATIAL, "--policy", "fl", "--criterion", "papers"), "'task', 'paper', 'both'"),
    (
        ("dlcc", SPATIAL, "--policy", "fl", "--position-bound", "0"),
        "cablebot: --position-bound must be a number greater than 0",
    ),
    (
        ("dlcc", SPATIAL, "--policy", "fl", "--rotation-bound", "nan"),
        "cablebot: --rotation-bound must be a number greater than 0",
    ),
    (("dlcc", SPATIAL, "--policy", "fl", "--resolution", "-1"), "resolution must be greater than 0 kg"),
    (("dlcc", SPATIAL, "--policy", "fl", "--resolution", "fine"), "--resolution"),
    (("dlcc", SPATIAL, "--policy", "fl", "--payload-max", "0"), "cablebot: --payload-max must be greater than 0 kg"),
    (("dlcc", SPATIAL, "--policy", "fl", "--payload-max=0"), "cablebot: --payload-max must be greater than 0 kg"),
    (("dlcc", SPATIAL, "--policy", "fl", "--control-frequency", "0"), "cablebot: --control-frequency must be"),
    (("dlcc", SPATIAL, "--policy", "fl", "--seed", "-1"), "a seed must be at least 0"),
    (("dlcc", SPATIAL, "--policy", "fl", "--payload", "1"), "--payload"),
    (("dlcc", SPATIAL), "--policy"),
    (("dlcc", "--policy", "fl"), "ID"),
    (
        ("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", "table5"),
        "unknown uncertainty 'table5'; choose one of none",
    ),
    (
        ("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", "table6+table6"),
        "defines parameters twice; leave one name out",
    ),
    (("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", '{"delay": '), "--uncertainty is not valid JSON"),
    (("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", '{"noise": 1}'), "unknown field 'noise' of an uncertainty"),
    (("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", '{"delay": -1}'), "delay must be 0 to "),
    (
        ("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", "table6", "--draws", "0"),
        "--draws must be an integer of at least 1",
    ),
    (
        ("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", "table6", "--draws", "-4"),
        "--draws must be an integer of at least 1",
    ),
    (("dlcc", SPATIAL, "--policy", "fl", "--uncertainty", "table6", "--draws", "2.5"), "--draws"),
    (("dlcc", SPATIAL, "--policy", "fl", "--draws", "4"), "all 4 draws would be equal: choose a random uncertainty"),
    (("dlcc", SPATIAL, "--policy", "fl", "--probability", "1"), "probability must lie between 0 and 1"),
    (("dlcc", SPATIAL, "--policy", "fl", "--probability", "95"), "probability must lie between 0 and 1"),
    (("dlcc", SPATIAL, "--policy", "fl", "--confidence", "0"), "confidence must lie between 0.5 and 1"),
    (("compare", SPATIAL, "--policies", "fl,lqr"), "unknown policy 'lqr'; choose one of "),
    (("compare", SPATIAL, "--policies", "fl, fl"), "every policy needs its own name, but the names are fl, fl"),
    (("compare", SPATIAL, "--policies", " , "), "there is no policy to compare: give at least one policy"),
    (("compare", SPATIAL), "--policies"),
    (("compare", "CableBot-Cubic-v0", "--policies", "fl"), "choose one of CableBot-Planar-v0, CableBot-Spatial-v0"),
    (("compare", SPATIAL, "--policies", "fl", "--payload", "-1"), "--payload must be a finite number of at least 0 kg"),
    (("compare", SPATIAL, "--policies", "fl", "--draws", "0"), "--draws must be an integer of at least 1"),
    (
        ("compare", SPATIAL, "--policies", "fl", "--draws", "4"),
        "all 4 draws would be equal: choose a random uncertainty",
    ),
    (("compare", SPATIAL, "--policies", "fl", "--uncertainty", "table5"), "unknown uncertainty 'table5'"),
    (
        ("compare", SPATIAL, "--policies", "fl", "--position-bound", "0"),
        "cablebot: --position-bound must be a number greater than 0",
    ),
    (("compare", SPATIAL, "--policies", "fl", "--trajectory", "spiral"), "unknown trajectory 'spiral'"),
    (("compare", SPATIAL, "--policies", "fl", "--probability", "0.5"), "--probability"),
    (("list", "--yaml"), "--yaml"),
    (("weigh", SPATIAL), "weigh"),
]


@pytest.mark.parametrize(
    ("arguments", "message"), BAD, ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_bad_input_is_answered_by_one_line(cablebot, arguments, message):
    assert message in one_line(cablebot(*arguments), 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("CableBot-Cubic-v0", "--policy", "fl"), "choose one of CableBot-Planar-v0, CableBot-Spatial-v0"),
        ((PLANAR, "--policy", "lqr"), "unknown policy 'lqr'; choose one of "),
        ((PLANAR, "--policy", "fl", "--trajectory", "spiral"), "unknown trajectory 'spiral'; choose one of paper"),
        ((PLANAR, "--policy", "fl", "--payload", "-1"), "--payload must be finite and at least 0 kg"),
        ((PLANAR, "--policy", "fl", "--uncertainty", "table5"), "unknown uncertainty 'table5'"),
        ((PLANAR, "--policy", "fl", "--uncertainty", "{"), "--uncertainty is not valid JSON"),
        ((PLANAR, "--policy", "fl", "--payload", "nan"), "--payload must be finite and at least 0 kg"),
        ((PLANAR, "--policy", "fl", "--seed", "-1"), "eed must be "),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_input_of_a_recording_does_not_change_anything(cablebot, tmp_path, arguments, message):
    line = one_line(cablebot("rollout", *arguments, "--out", tmp_path / "new" / "run.npz"), 2)
    assert message in line
    assert names(tmp_path) == []


def test_message_does_not_come_after_an_empty_line(cablebot):
    ended = cablebot("dlcc", SPATIAL, "--policy", "fl", "--trajectory", "spiral")
    assert ended.err.startswith("cablebot: ")
    assert ended.err.count("\n") == 1


# --- rollout ----------------------------------------------------------------------------------------------------------


def read_csv(path):
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, float)


@pytest.mark.parametrize("env_id", [PLANAR, SPATIAL])
def test_two_formats_do_not_hold_different_numbers(cablebot, tmp_path, env_id):
    kind = env_id.split("-")[1].lower()
    arguments = ("--policy", "fl", "--payload", "0.5", "--control-frequency", "400")
    trajectory = ("--trajectory", json.dumps({"name": f"circle-{kind}", "duration": 1.5}))
    for suffix in ("npz", "csv"):
        ended = cablebot("rollout", env_id, *arguments, *trajectory, "--out", tmp_path / f"run.{suffix}")
        assert ended.status == 0
        assert (f"{kind} criterion" in ended.out) is False
        assert "0.5 kg, task criterion: carried; recorded in" in ended.out
    header, table = read_csv(tmp_path / "run.csv")
    recorded = dict(np.load(tmp_path / "run.npz"))
    recorded.pop("allow_pickle", None)
    assert len(table) == 600
    assert len(set(header)) == len(header)
    columns = {}
    for name, array in recorded.items():
        assert len(array) == 600
        if array.ndim == 1:
            columns[name] = array
        else:
            columns |= {f"{name}_{place + 1}": array[:, place] for place in range(array.shape[1])}
    assert list(columns) == header
    np.testing.assert_array_equal(table, np.stack([column.astype(float) for column in columns.values()], axis=1))
    np.testing.assert_array_equal(recorded["payload"], 0.5)
    np.testing.assert_allclose(recorded["action_time"], np.arange(600) / 400, atol=1e-12)
    assert {"pose", "velocity", "reference_pose", "tensions", "torques", "commanded_action", "reward"} <= set(recorded)
    offset = np.linalg.norm((recorded["pose"] - recorded["reference_pose"])[:, :3], axis=1)
    np.testing.assert_allclose(offset, recorded["tracking_error"], atol=1e-12)  # of the same instant
    np.testing.assert_allclose(recorded["time"], np.arange(1, 601) / 400, atol=1e-12)


def test_recording_does_not_hold_anything_but_its_arrays(cablebot, tmp_path):
    cablebot("rollout", SPATIAL, "--policy", "fl", "--trajectory", HANG, "--out", tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        lengths = {name: file[name].shape[:1] for name in file.files}
    assert set(lengths.values()) == {(25,)}


def test_payload_and_payload_model_reach_the_recording(cablebot, tmp_path):
    runs = {}
    for name, options in {
        "empty": (),
        "known": ("--payload", "3"),
        "unknown": ("--payload", "3", "--payload-unknown"),
        "scaled": ("--payload", "3", "--model-payload-factor", "0.9"),
    }.items():
        cablebot("rollout", SPATIAL, "--policy", "fl", *options, "--out", tmp_path / f"{name}.npz")
        runs[name] = dict(np.load(tmp_path / f"{name}.npz"))
    first = {name: run["commanded_action"][0] for name, run in runs.items()}
    np.testing.assert_array_equal(first["empty"], first["unknown"])
    assert np.all(np.abs(first["known"] - first["empty"]) > 1e-3)
    assert np.all(np.abs(first["known"] - first["scaled"]) > 1e-4)
    assert runs["known"]["tracking_error_peak"].max() < 0.01 < runs["unknown"]["tracking_error_peak"].max()


def test_uncertainty_of_a_recording_is_not_read_and_then_discarded(cablebot, tmp_path):
    runs = {}
    for name, options in {
        "nominal": (),
        "drawn": ("--uncertainty", "table6"),
        "again": ("--uncertainty", "table6"),
        "other": ("--uncertainty", "table6", "--seed", "1"),
        "late": ("--uncertainty", '{"delay": 3}'),
    }.items():
        path = tmp_path / f"{name}.npz"
        motion = ("--trajectory", '{"name": "circle-spatial", "duration": 1}')
        ended = cablebot("rollout", SPATIAL, "--policy", "fl", *motion, *options, "--out", path)
        assert (ended.status, ended.err) == (0, "")
        runs[name] = dict(np.load(path))["pose"]
    np.testing.assert_array_equal(runs["drawn"], runs["again"])
    for name in ("drawn", "other", "late"):
        assert np.abs(runs[name] - runs["nominal"]).max() > 1e-9
    assert np.abs(runs["drawn"] - runs["other"]).max() > 1e-6


def test_motion_that_is_not_carried_is_not_said_to_be(cablebot, tmp_path):
    ended = cablebot("rollout", SPATIAL, "--policy", "fl", "--payload", "9", "--out", tmp_path / "run.csv")
    assert "9 kg, task criterion: not carried: " in ended.out
    assert " at t = 0." in ended.out
    assert (tmp_path / "run.csv").exists()


def test_episode_that_the_environment_ends_is_not_recorded_as_whole(cablebot, toys, tmp_path):
    ended = cablebot("rollout", SPATIAL, "--policy", toys("limp"), "--out", tmp_path / "run.csv")
    assert "not carried: " in ended.out
    assert "(ended early: tracking_error)" in ended.out
    _, table = read_csv(tmp_path / "run.csv")
    assert 10 < len(table) < 500


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("name", ["run", "run.json", "run.csv.gz", "run.NPZ"])
def test_unknown_format_is_not_found_out_after_the_work(cablebot, tmp_path, name):
    line = one_line(cablebot("rollout", PLANAR, "--policy", "fl", "--out", tmp_path / name), 2)
    assert "must end in .npz or .csv" in line
    assert names(tmp_path) == []


@pytest.mark.usefixtures("no_work")
def test_folder_in_the_place_of_the_recording_is_not_found_out_after_the_work(cablebot, tmp_path):
    (tmp_path / "run.csv").mkdir()
    assert "it is a folder" in one_line(cablebot("rollout", PLANAR, "--policy", "fl", "--out", tmp_path / "run.csv"), 2)


@pytest.mark.usefixtures("no_work")
def test_recording_below_a_file_is_not_found_out_after_the_work(cablebot, tmp_path):
    (tmp_path / "file").write_text("kept", encoding="utf-8")
    line = one_line(cablebot("rollout", PLANAR, "--policy", "fl", "--out", tmp_path / "file" / "run.csv"), 2)
    assert "cannot write to folder" in line
    assert (tmp_path / "file").read_text(encoding="utf-8") == "kept"


def test_uncertainty_in_a_file_is_not_taken_for_a_name(cablebot, tmp_path):
    path = tmp_path / "unknown.json"
    path.write_text('{"sensors": {"position": 1e-4}}', encoding="utf-8")
    arguments = ("dlcc", SPATIAL, "--policy", "fl", "--trajectory", HANG, "--payload-max", "1", "--resolution", "1")
    ended = cablebot(*arguments, "--criterion", "task", "--uncertainty", str(path), "--draws", "2", "--json")
    assert (ended.status, ended.err) == (0, "")
    assert loads(ended.out)[0]["environment"]["uncertainty"]["sensors"]["position"] == 1e-4
    for text, message in (("[1]", "must hold a JSON object"), (None, "cannot read")):
        path.unlink() if text is None else path.write_text(text, encoding="utf-8")
        assert message in one_line(cablebot(*arguments, "--uncertainty", str(path)), 2)


# --- reproduce --------------------------------------------------------------------------------------------------------


def test_command_of_another_package_is_not_missing_from_the_help(cablebot):
    ended = cablebot("--help")
    assert ended.out.count("reproduce") == 1
    assert re.search(r"^ +train ", ended.out, re.MULTILINE)
    assert cablebot("--help").out == ended.out
    refused = cablebot("nosuch").err.replace("\n", " ")
    named = refused.partition("The commands are ")[2].partition(".")[0].split(", ")
    assert named == [*cli.BUILT_IN, "reproduce", "train"]
    assert re.search(r"Examples:\s+cablebot reproduce", cablebot("reproduce", "--help").out)


def test_reproduction_does_not_lack_a_file(cablebot, tmp_path):
    ended = cablebot("reproduce", "--only", "fig1,fig3", "--out", tmp_path / "out", "--workers", "1")
    assert (ended.status, ended.err) == (0, "")
    assert "interpretation: default" in ended.out
    made = {"results.json", "reproduction.md", "reproduction.html"}
    assert set(names(tmp_path / "out")) == made | {f"fig{k}.{suffix}" for k in (1, 3) for suffix in ("png", "svg")}
    assert "not run: fig2" in ended.out


def test_reading_is_not_read_and_then_discarded(cablebot, tmp_path):
    arguments = ("reproduce", "--only", "fig1", "--out", tmp_path, "--workers", "1")
    assert cablebot(*arguments, "--planar-apex", "left", "--minimum-tension", "2").status == 0
    choices = loads((tmp_path / "results.json").read_text(encoding="utf-8"))["interpretation"]
    assert (choices["planar_apex"], choices["minimum_tension"]) == ("left", 2.0)


@pytest.mark.parametrize("name", list(choices_of()))
def test_no_reading_lacks_its_option(cablebot, tmp_path, name):
    option = f"--{name.replace('_', '-')}"
    message = one_line(cablebot("reproduce", option, "sideways", "--out", tmp_path), 2)
    assert f"cablebot: {option} must be one of" in message
    assert names(tmp_path) == []


def test_rows_as_json_are_not_mixed_with_anything_else(cablebot, tmp_path):
    ended = cablebot("reproduce", "--only", "fig1", "--out", tmp_path, "--workers", "1", "--json")
    assert {row["key"] for row in loads(ended.out)} == set(PUBLISHED)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--only", "fig4"), "unknown part 'fig4'; valid parts are fig1, fig2"),
        (("--only", ""), "unknown part ''"),
        (("--workers", "0"), "workers must be at least 1"),
        (("--minimum-tension", "-1"), "--minimum-tension must be at least 0 N"),
    ],
)
def test_bad_input_of_a_reproduction_does_not_leave_a_file(cablebot, tmp_path, arguments, message):
    assert message in one_line(cablebot("reproduce", *arguments, "--out", tmp_path / "out"), 2)
    assert names(tmp_path) == []


SAID = re.compile("compiling|robot …|finished parts|--only")
"""What the command says before it ends."""


def is_alive(group):
    """Whether a process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupted_reproduction_keeps_what_was_done_and_leaves_no_process(tmp_path):
    start = (
        f"import signal, cablebot_gym.cli.app as c; signal.signal({int(signal.SIGINT)}, signal.default_int_handler); "
    )
    arguments = ("reproduce", "--only", "fig3,scan", "--workers", "2", "--out", str(tmp_path))
    process = subprocess.Popen(
        [sys.executable, "-c", start + "c.main()", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while not (tmp_path / "fig3.svg").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    said = "".join(line for line in err.splitlines(keepends=True) if not SAID.search(line))
    assert "interrupted" in one_line(Ended(process.returncode, out, said), 130)
    assert f"--out {tmp_path} --only scan" in err.replace("\n", " ").replace("  ", " ")
    results = loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert [part["name"] for part in results["parts"]] == ["fig3"]
    assert "scan" in results["missing"]
    while is_alive(process.pid) and time.monotonic() < deadline:  # the workers may take a moment to end
        time.sleep(0.1)
    assert not is_alive(process.pid)
