"""``cablebot identify``."""

import json
import sys

import pytest
from identification.lifts import ROBOT, TRUTH, lift, write

from cablebot_gym.robots import load_robot
from cablebot_gym.uncertainty import find_uncertainty
from cablebot_winches.cli.identify import _texts


@pytest.fixture
def logs(tmp_path):
    """Files of motor 1 with two loads."""
    return [write(lift(0, load), tmp_path) for load in (1.0, 5.0)]


def test_files_are_a_robot_and_an_uncertainty_of_it(cablebot, logs, tmp_path):
    out = tmp_path / "out"
    ended = cablebot("identify", *logs, "--robot", "ttk4900", "--out", out)
    assert ended.status == 0
    for text in ("coulomb_friction", "95 % intervals", "N·m·s/rad", "residual   motor 1: "):
        assert text in ended.out
    rows = [line for line in ended.out.splitlines() if "│" in line]
    assert len(rows) == len(TRUTH) - 1  # one line each in 80 columns; there is no torque constant
    assert "motors 2, 3, 4: no log; they keep the values of the robot" in ended.err
    robot = load_robot(out / "robot.toml")
    assert robot.coulomb_friction[0] != ROBOT.coulomb_friction[0]
    data = json.loads((out / "uncertainty.json").read_text())
    uncertainty = find_uncertainty(data, robot)
    assert {"coulomb_friction", "load_friction"} <= uncertainty.parameters.keys()
    again = cablebot("identify", *logs, "--robot", "ttk4900", "--out", out)
    assert again.status == 2
    assert "choose another --out" in again.err


def test_figures_are_beside_the_report_if_matplotlib_is_there(
    cablebot, logs, tmp_path, monkeypatch
):
    """Without it, the command writes all else and says what to install."""
    pytest.importorskip("matplotlib")
    options = ("--robot", "ttk4900", "--out")
    ended = cablebot("identify", *logs, *options, tmp_path / "drawn")
    assert "torques.png" in ended.err
    assert (tmp_path / "drawn" / "torques.png").stat().st_size > 10_000
    assert not (tmp_path / "drawn" / "lengths.png").exists()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    ended = cablebot("identify", *logs, *options, tmp_path / "plain")
    assert ended.status == 0
    assert "wrote no figures: figures need matplotlib: pip install" in ended.err
    assert (tmp_path / "plain" / "robot.toml").exists()
    assert not (tmp_path / "plain" / "torques.png").exists()


@pytest.mark.parametrize(
    ("value", "half_width", "texts"),
    [
        (12.0, 0.03, ("12.000", "0.03")),
        (12.7, 2e-4, ("12.70000", "0.0002")),
        (15010.0, 22.0, ("15010", "22")),
        (-0.0003, 0.0076, ("-0.000300", "0.0076")),
        (2e-4, 1e-9, ("0.0002", "1e-09")),
        (1.0, float("inf"), ("1", "∞")),
    ],
)
def test_digits_show_the_interval(value, half_width, texts):
    """Four digits of a radius would hide its interval."""
    assert _texts(value, half_width) == texts


def test_json_has_the_reason_of_an_open_parameter(cablebot, logs, tmp_path):
    data = cablebot(
        "identify", logs[1], "--robot", "ttk4900", "--json", "--out", tmp_path / "out"
    ).data
    reasons = {item["name"]: item["reason"] for item in data["estimates"]}
    assert reasons["load_friction"] == "the logs have one load; add a log with another load"
    assert not reasons["coulomb_friction"]
    assert json.loads((tmp_path / "out" / "identification.json").read_text()) == data


def test_missing_column_of_a_log_is_named(cablebot, tmp_path):
    path = write(lift(0, 5.0), tmp_path, without=("load_1",))
    ended = cablebot("identify", path, "--robot", "ttk4900", "--out", tmp_path / "out")
    assert ended.status == 2
    assert "add load_1 [kg]" in ended.err


def test_same_winches_and_notes_of_given_values_are_shown(cablebot, logs, tmp_path):
    """A reason has a line of its own below the table."""
    out = tmp_path / "out"
    options = ("--robot", "ttk4900", "--same-winches", "--out", out)
    ended = cablebot("identify", logs[1], *options)
    assert ended.status == 0
    assert "given (1)" in ended.out
    assert "\n(1) given load_friction = 0.051\n(2) the logs have one load; " in ended.out
    assert "no log" not in ended.err
    robot = load_robot(out / "robot.toml")
    assert len(set(robot.damping)) == 1
    assert robot.damping[0] != ROBOT.damping[0]
