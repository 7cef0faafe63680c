"""Limits of stiff springs and stiff cables: the flexible plant approaches the rigid one."""

import math

import numpy as np
import pytest
from oracles.elastic import plant_at, wound_state
from oracles.plants import advance, each_of, free_motors, off_centre, slowly, with_transmission
from oracles.platforms import CRANE, HANGING

from cablebot_gym.physics import kernel, textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL


def slope_of_error(stiffnesses, error):
    """Slope of an error over a stiffness, in logarithms."""
    errors = [error(stiffness) for stiffness in stiffnesses]
    return np.polyfit(np.log(stiffnesses), np.log(errors), 1)[0]


def distance(robot, rigid, holding, torques, duration, *, pose, velocity):
    """Largest difference of the poses of two robots under the same torques, which ``holding``
    torques precede."""
    plants = []
    for free_robot in (free_motors(robot), free_motors(rigid)):
        tensions = holding / robot.pulley_radius
        plants.append(plant_at(free_robot, wound_state(free_robot, pose, velocity, tensions)))
    step = min(1e-4, 0.2 / textbook.highest_frequency(free_motors(robot)))
    period = 5e-3
    largest = 0.0
    for _ in range(round(duration / period)):
        for plant in plants:
            advance(plant, torques, period, math.ceil(period / step))
            assert not plant.per_cable(kernel.SLACK).any()
        largest = max(largest, np.abs(plants[0].pose - plants[1].pose).max())
    assert np.abs(plants[1].pose - pose).max() > 1e-3
    return largest


@pytest.mark.parametrize("damping", [0.0, 0.01])
@pytest.mark.parametrize(("flexible", "rigid"), [(FLEX_PLANAR, PLANAR), (FLEX_SPATIAL, SPATIAL)])
def test_stiff_springs_approach_the_rigid_plant(flexible, rigid, damping):
    """The error against J + J′ and the same c falls as 1/K."""
    rigid = with_transmission(rigid, damping=damping)
    pose, velocity = off_centre(rigid)
    holding = textbook.static_torque(rigid, rigid.mass, pose[None], minimum=30.0)
    torques = holding * np.linspace(0.93, 1.07, rigid.cables)

    def error(stiffness):
        robot = with_transmission(flexible, damping=damping, stiffness=stiffness)
        return distance(
            robot, rigid, torques, torques, 0.3, pose=pose[None], velocity=0.3 * velocity[None]
        )

    assert -1.03 < slope_of_error((30.0, 300.0, 3000.0), error) < -0.97


def error_at_home(robot, rigid):
    """Error of a robot at rest at its home pose, whose torques change by a tenth."""
    pose = rigid.home[None]
    holding = textbook.static_torque(rigid, rigid.mass, pose, minimum=60.0)
    torques = holding * np.linspace(0.9, 1.1, rigid.cables)
    return distance(robot, rigid, holding, torques, 0.1, pose=pose, velocity=0 * pose)


@each_of(HANGING, *slowly(CRANE))
def test_stiff_cables_approach_the_rigid_robot(robot):
    """The error falls as 1/EA. Damped cables, as the rigid robot has no waves."""

    def error(stiffness):
        return error_at_home(with_transmission(robot, axial_stiffness=stiffness), robot)

    assert -1.1 < slope_of_error((1e5, 1e6, 1e7), error) < -0.9


def test_stiff_joints_approach_the_robot_with_rigid_joints():
    """Motor and pulley turn together: their inertias add."""
    single = with_transmission(HANGING, axial_stiffness=2e4)

    def error(stiffness):
        double = with_transmission(
            single, stiffness=stiffness, pulley_inertia=1e-3, motor_inertia=3e-3
        )
        return error_at_home(double, single)

    assert -1.1 < slope_of_error((1e4, 1e5, 1e6), error) < -0.9
