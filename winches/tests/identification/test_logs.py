"""Columns of logs: errors that name the column and the remedy."""

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
        ((), {"speed_1": "speed1"}, "unknown column 'speed1'; columns of 'ttk4900' are time, ang"),
        ((), {"speed_1": "speed_5"}, "unknown column 'speed_5'"),
        ((), {"speed_1": "time"}, "a column appears twice"),
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
        ("", "the file is empty"),
        ("time,speed_1\n0,1,2\n", "row 1 has 3 cells, the first line 2"),
        ("time,speed_1\n0,1\n1,1;5\n", "'1;5' in row 2 is no number"),
    ],
)
def test_malformed_file_raises(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"a.csv: {message}"):
        read_log(path, ROBOT)


def test_time_that_does_not_increase_and_short_logs_raise():
    columns = dict(lift(0, 5.0).columns)
    backwards = Log(name="a.csv", columns=columns | {"time": columns["time"][::-1]})
    with pytest.raises(ValueError, match="time must increase"):
        identify(ROBOT, [backwards])
    short = Log(name="a.csv", columns={name: values[:9] for name, values in columns.items()})
    with pytest.raises(ValueError, match="no stretch without gaps has"):
        identify(ROBOT, [short])


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
