"""Columns of logs: errors that name the column and the remedy."""

import re
from pathlib import Path

import numpy as np
import pytest
from identification.lifts import ROBOT, lift, write

from cablebot_gym.robots import load_robot
from cablebot_winches.identification import identify, read_log
from cablebot_winches.identification.log import COLUMNS, Log
from cablebot_winches.robot_file import to_toml


def test_log_of_a_file_has_its_values(tmp_path):
    log = lift(0, 5.0)
    again = read_log(write(log, tmp_path), ROBOT)
    assert again.columns.keys() == log.columns.keys()
    for name, values in log.columns.items():
        np.testing.assert_allclose(again.columns[name], values, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("without", "rename", "message"),
    [
        ((), {"speed_1": "speed1"}, "unknown column 'speed1'; .* did you mean 'speed_1'"),
        ((), {"speed_1": "speed_5"}, "unknown column 'speed_5'"),
        ((), {"speed_1": "time"}, "column 'time' appears twice"),
        (("time",), {}, "a log needs the columns time; add them to the first line"),
        (
            ("torque_1",),
            {},
            "no motor has a column torque_1 .N·m. or current_1 .A. for its friction",
        ),
        (("speed_1",), {}, "motor 1 needs the columns speed_1; add"),
        (("load_1",), {}, r"add load_1 \[kg\] of a hanging mass, tension_1 \[N\], or the pose"),
        ((), {"load_1": "x"}, "the pose needs the columns y, phi; add"),
        ((), {"load_1": "current_1"}, "motor 1 has torque and current; remove one"),
    ],
)
def test_wrong_columns_raise(tmp_path, without, rename, message):
    path = write(lift(0, 5.0), tmp_path, without=without, rename=rename)
    with pytest.raises(ValueError, match=message):
        identify(ROBOT, [read_log(path, ROBOT)])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it is empty"),
        ("time,speed_1\n0,1,2\n", "line 2 has 3 values, and the first line 2 columns"),
        ("time,speed_1\n0,1\n1,1;5\n", "line 3: speed_1 is '1;5'"),
        ("time,speed_1 [rpm]\n0,1\n", "column 'speed_1 .rpm.' must be in rad/s"),
        ("time,speed_1\n0,1\n,1\n", "line 3: time is empty"),
        ("time,speed_1\n0,1\n0.1,2\n0.1,3\n", "line 4: time is 0.1, after 0.1 in line 3"),
        ("time,speed_1\n0,1\n5,2\n10,3\n", "time grows by 5 a line. It must be in s"),
    ],
)
def test_malformed_file_raises(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"a.csv': {message}"):
        read_log(path, ROBOT)


def test_repeated_lines_are_left_out(tmp_path):
    """Loggers write a line twice. Empty cells are equal, too."""
    path = tmp_path / "a.csv"
    path.write_text("time,speed_1\n0,1\n1e-3,\n1e-3,\n2e-3,1\n")
    log = read_log(path, ROBOT)
    np.testing.assert_array_equal(log.columns["speed_1"], [1, np.nan, 1])
    assert log.lines == (2, 3, 5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({name: slice(9) for name in lift(0, 5.0).columns}, "no stretch without gaps has 34 samp"),
        ({"torque_1": np.nan}, "torque_1 has no values"),
        ({"speed_1": 0.0}, "no motor moves: each needs speeds above 0.5 rad/s, the friction_speed"),
    ],
    ids=["short", "empty column", "standstill"],
)
def test_log_without_samples_raises(changes, message):
    """The right column is named."""
    columns = dict(lift(0, 5.0).columns)
    for name, change in changes.items():
        if isinstance(change, slice):
            columns[name] = columns[name][change]
        else:
            columns[name] = np.full(len(columns[name]), change)
    with pytest.raises(ValueError, match=message):
        identify(ROBOT, [Log(name="a.csv", columns=columns)])


@pytest.mark.parametrize(
    ("quantity", "column", "factor", "question"),
    [
        (
            "torque",
            "speed",
            1 / (2 * np.pi),
            "pulley_inertia of .* times that of the robot: are sp",
        ),
        ("torque", "speed", 30 / np.pi, "pulley_inertia of .* times that of the robot: are sp"),
        ("torque", "speed", 180 / np.pi, "speed_1 reaches 1.43e.03 rad/s, and the free speed"),
        ("torque", "load", 1e3, "the mean of torque_1 is .* and its load needs"),
        ("current", "current", 1e3, "mean a supply of 0.021 V: are currents in A"),
    ],
    ids=["rev/s", "rpm", "°/s", "g", "mA"],
)
def test_wrong_units_are_questioned(quantity, column, factor, question):
    logs = []
    for load in (1.0, 5.0):
        columns = dict(lift(0, load, quantity=quantity).columns)
        columns[f"{column}_1"] = factor * columns[f"{column}_1"]
        logs.append(Log(name="a.csv", columns=columns))
    questions = identify(ROBOT, logs).questions
    assert any(re.search(question, text) for text in questions), questions


def test_right_units_are_not_questioned():
    for quantity in ("torque", "current"):
        logs = [lift(0, load, quantity=quantity) for load in (1.0, 5.0)]
        assert not identify(ROBOT, logs).questions


def test_identified_robot_survives_its_file(tmp_path):
    """Also default motion, bounds and sources."""
    robot = identify(ROBOT, [lift(0, load) for load in (1.0, 5.0)]).robot
    path = tmp_path / "robot.toml"
    path.write_text(to_toml(robot), encoding="utf-8")
    again = load_robot(path)
    assert again == robot
    assert again.defaults == robot.defaults
    assert again.sources == robot.sources


def test_page_has_the_columns():
    folder = Path(__file__).parents[2] / "docs"
    page = (folder / "identify.md").read_text(encoding="utf-8")
    for name, (unit, meaning) in COLUMNS.items():
        assert f"| `{name}` | {unit} | {meaning} |" in page
