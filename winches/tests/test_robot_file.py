"""Robots survive a TOML file."""

import math

import pytest

from cablebot_gym.robots import SPATIAL, find_robot, library, load_robot
from cablebot_winches.robot_file import to_toml


def test_maximum_tension_survives_a_robot_file(tmp_path):
    robot = SPATIAL.replace(maximum_tension=120.0)
    file = tmp_path / "strong.toml"
    file.write_text(to_toml(robot))
    assert find_robot(str(file)).maximum_tension == 120.0
    file.write_text(to_toml(SPATIAL))
    assert find_robot(str(file)).maximum_tension == math.inf


@pytest.mark.parametrize("name", library())
def test_robot_of_the_library_survives_a_file(name, tmp_path):
    robot = load_robot(library()[name])
    (tmp_path / "copy.toml").write_text(to_toml(robot), encoding="utf-8")
    copy = load_robot(tmp_path / "copy.toml")
    assert (copy, copy.sources, copy.ranges) == (robot, robot.sources, robot.ranges)
