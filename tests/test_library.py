"""The library of real robots: complete files, cited values, and motions that the robots can
follow."""

import re
import tomllib
from functools import cache
from operator import attrgetter

import numpy as np
import pytest

from cablebot_gym.bounds.robot_check import check_motion
from cablebot_gym.physics import textbook
from cablebot_gym.robots import ELASTIC, find_robot, library, load_robot, robot_names
from cablebot_gym.robots.ranges import with_values

every_robot = pytest.mark.parametrize("name", library())


def cited_fields(data, table=""):
    """Names of the fields of a file that need a source."""
    tables = {"motors", "transmission", "defaults"}
    without = {"name", "sources", "ranges"}
    names = {f"{table}{name}" for name in data if name not in {*tables, *without}}
    return names.union(*(cited_fields(data[name], f"{name}.") for name in tables if name in data))


@every_robot
def test_every_value_of_a_file_has_a_source(name):
    """Ranges are for values that are assumed, or on which sources disagree, and contain them."""
    data = tomllib.loads(library()[name].read_text(encoding="utf-8"))
    assert (data["name"], set(data["sources"])) == (name, cited_fields(data))
    assert all(text.strip() == text and len(text) > 6 for text in data["sources"].values())
    robot = find_robot(ELASTIC + name)
    assert robot.ranges
    for field, (low, high) in robot.ranges.items():
        assert low <= attrgetter(field)(robot) <= high
        assert re.search("^assumed| has ", robot.sources[field])


@cache
def checked(name):
    """The check of the default motion of a robot."""
    return check_motion(find_robot(name))


@pytest.mark.parametrize("name", ["ttk4900", "stadium-camera"])
def test_payload_range_holds_for_all_values_within_the_ranges(name):
    """The ends are those of corners, which is exact only where the payload is monotonic."""
    robot = find_robot(name)
    motion = checked(name)
    lowest, highest = motion.payload_range
    assert lowest < motion.limit.largest <= highest
    ends = np.array(list(robot.ranges.values()))
    for values in np.random.default_rng(1).uniform(*ends.T, size=(2, len(ends))).tolist():
        other = with_values(robot, dict(zip(robot.ranges, values, strict=True)))
        assert lowest <= check_motion(other).limit.largest <= highest


@every_robot
def test_motors_hold_the_default_motion_and_friction_acts_on_it(name):
    """With the least payload of its range, at least the minimum tension, and torques within the
    torque-speed lines. Friction is smoothed at a speed far below those of the motion: at 0.5 rad/s,
    FAST had hardly any."""
    robot = find_robot(name)
    assert checked(name).held
    motion = checked(name).trajectory
    reference = motion(np.linspace(0, motion.duration, 201))
    speed = textbook.pulley_speed(robot, reference.position, reference.velocity)
    assert robot.transmission.friction_speed <= 0.03 * np.abs(speed).max()


@every_robot
def test_names_are_the_robot_with_rigid_and_with_elastic_cables(name):
    rigid = find_robot(name)
    elastic = find_robot(ELASTIC + name)
    file = load_robot(library()[name])
    assert (rigid.name, rigid.flexible) == (name, False)
    assert (elastic.name, elastic.elastic) == (ELASTIC + name, True)
    assert elastic.replace(name=name) == file
    assert rigid == file.with_rigid_cables()
    assert {name, ELASTIC + name} <= set(robot_names())
