"""The library of real robots: complete files, cited values, and motions that the robots can
follow."""

import tomllib

import numpy as np
import pytest

from cablebot_gym.physics import textbook
from cablebot_gym.physics.distribution import HELD, feasible
from cablebot_gym.robots import (
    ELASTIC,
    find_robot,
    library,
    load_robot,
    robot_names,
)
from cablebot_gym.task import check_workspace
from cablebot_gym.trajectories import find_trajectory

every_robot = pytest.mark.parametrize("name", library())


def cited_fields(data, table=""):
    """Names of the fields of a file that need a source."""
    tables = {"motors", "transmission", "defaults"}
    names = {f"{table}{name}" for name in data if name not in {*tables, "name", "sources"}}
    return names.union(*(cited_fields(data[name], f"{name}.") for name in tables if name in data))


@every_robot
def test_every_value_of_a_file_has_a_source(name):
    data = tomllib.loads(library()[name].read_text(encoding="utf-8"))
    assert (data["name"], set(data["sources"])) == (name, cited_fields(data))
    assert all(text.strip() == text and len(text) > 6 for text in data["sources"].values())


@every_robot
def test_names_are_the_robot_with_rigid_and_with_elastic_cables(
    name,
):
    rigid = find_robot(name)
    elastic = find_robot(ELASTIC + name)
    file = load_robot(library()[name])
    assert (rigid.name, rigid.flexible) == (name, False)
    assert (elastic.name, elastic.elastic) == (ELASTIC + name, True)
    assert elastic.replace(name=name) == file
    assert rigid == file.with_rigid_cables()
    assert {name, ELASTIC + name} <= set(robot_names())


@every_robot
def test_motors_hold_the_default_motion(name):
    """With the least payload of its range, at least the minimum tension, and torques within the
    torque-speed lines."""
    robot = find_robot(name)
    motion = find_trajectory(robot.defaults.trajectory or "", robot.kind)
    check_workspace(robot, motion)
    assert held(robot, motion(np.linspace(0, motion.duration, 101))).all()


def held(robot, reference):
    pose = reference.position
    velocity = reference.velocity
    acceleration = reference.acceleration
    mass = robot.mass + robot.defaults.payload(0.0)
    load = textbook.load(robot, np.full(len(pose), mass), pose, velocity, acceleration)
    speed = textbook.pulley_speed(robot, pose, velocity)
    moving = robot.pulley_inertia * textbook.pulley_acceleration(
        robot, pose, velocity, acceleration
    )
    moving = moving + robot.damping * speed + textbook.coulomb_torque(robot, speed)
    low, high = (np.array(textbook.torque_limits(robot, speed)) - moving) / robot.pulley_radius
    structure = textbook.jacobian(robot, pose)
    return feasible(structure, load, np.maximum(low, robot.minimum_tension), high).status == HELD
