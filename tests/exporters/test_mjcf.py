"""Exported robots in MuJoCo against the plant."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.mujoco_model import MujocoRobot
from oracles.plants import (
    FLEX_QUAD,
    State,
    each_of,
    free_motors,
    loaded_plant,
    nightly,
    no_reference,
    with_transmission,
)
from oracles.platforms import CAMERA, SWIVELLED

from cablebot_gym.exporters import export_mjcf
from cablebot_gym.physics import textbook
from cablebot_gym.physics.kernel import rows
from cablebot_gym.robots import find_robot

pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")

STEP = 2.5e-4


def damped(robot):
    """The robot with its torque-speed lines as damping, which follows the speed at once: the motors
    of the plant keep the speed of the start of a control period."""
    field = "motor_damping" if robot.jointed else "damping"
    damping = getattr(robot, field) + robot.speed_slope
    return free_motors(with_transmission(robot, **{field: damping}))


def after_one_second(name):
    """How far a robot with a payload moves from rest at home under a smooth excitation, and how far
    from MuJoCo it ends [m, rad]."""
    robot = find_robot(name)
    payload = robot.defaults.payload() + 0.1 * robot.mass
    mass = robot.mass + payload
    torques = textbook.static_torque(robot, mass, robot.home)
    exported = export_mjcf(robot, payload=payload, timestep=STEP, holding_torques=torques)
    robot = exported.robot
    peer = MujocoRobot(robot, exported=exported.text)
    peer.set_keyframe(0)
    angle = textbook.rest_angles(robot, torques / robot.pulley_radius, robot.home)
    pose = robot.home[None]
    resting = State(pose, 0 * pose, angle[None], 0 * angle[None])
    plant = loaded_plant(damped(robot), resting, "unilateral", mass)
    masses = np.diagonal(textbook.linear_model(robot, mass=mass).inertia)[: robot.coordinates]
    push = -np.linalg.lstsq(textbook.jacobian(robot, robot.home).T, 0.7 * masses)[0]
    excitation = robot.pulley_radius * push / robot.stall_torque
    holding = textbook.holding_torque(robot, torques) / robot.stall_torque
    for index in range(round(1 / STEP)):
        change = excitation * np.sin(2 * np.pi * index * STEP)
        plant.set_action(holding + change)
        plant.advance(*no_reference(robot), substeps=1, step=STEP)
        peer.step(torques / robot.stall_torque + change)
        assert plant.per_cable(rows.TENSION).min() > 0
    end = plant.pose[0]
    return np.abs(end - robot.home).max(), np.abs(end - peer.state()[0]).max()


@pytest.mark.parametrize("name", ["planar", "flex-planar", "cogiro", *nightly("ttk4900", "fast")])
def test_motion_is_that_of_the_plant(name):
    """Reached: 7e-16."""
    moved, error = after_one_second(name)
    assert moved > 1e-3
    assert error <= 1e-9


@pytest.mark.parametrize("name", ["flex-stadium-camera", *nightly("flex-ttk4900")])
def test_motion_with_elastic_cables_near_home_is_nearly_that_of_the_plant(name):
    """Stiffness and torque of the winches are not exact. Reached: 0.9 % of the motion."""
    moved, error = after_one_second(name)
    assert error < 0.02 * moved


@each_of(FLEX_QUAD, find_robot("flex-stadium-camera"))
def test_springs_only_pull(robot):
    """With all springs unwound the platform falls."""
    robot = with_transmission(robot, pulley_inertia=1e-12)
    exported = export_mjcf(robot)
    peer = MujocoRobot(exported.robot, exported=exported.text)
    peer.set_motors(-np.ones(robot.cables), np.zeros(robot.cables))
    assert_allclose(peer.accelerations(np.zeros(robot.cables)), robot.gravity_vector, atol=1e-5)


TILTED = np.add(np.linspace(-0.3, 0.3, 24).reshape(8, 3), [0.1, 0.0, 1.0])


@pytest.mark.parametrize("axes", [(), TILTED], ids=["vertical", "tilted"])
def test_cables_leave_their_swivel_pulleys_at_home(axes):
    robot = SWIVELLED.replace(swivel_axes=axes)
    robot = with_transmission(robot, axial_stiffness=2e4, extra_length=0.3)
    simplified = export_mjcf(robot).robot
    expected = textbook.jacobian(robot, robot.home)
    assert_allclose(textbook.jacobian(simplified, simplified.home), expected, rtol=0, atol=1e-12)
    length = textbook.cable_lengths(robot, robot.home) + robot.extra_length
    assert_allclose(
        textbook.cable_lengths(simplified, simplified.home) + simplified.extra_length, length
    )


def test_action_has_the_lag_of_its_motor():
    lag = (0.0, 0.02, 0.05, 0.0)
    robot = CAMERA.replace(motors=CAMERA.motors.replace(lag=lag))
    exported = export_mjcf(robot, holding_torques=np.full(4, 15.0))
    peer = MujocoRobot(robot, exported=exported.text)
    peer.set_keyframe(0)
    assert_allclose(peer.data.act, 0.25)
    peer.step(np.full(4, 0.75), 20)
    assert_allclose(peer.data.act, 0.75 - 0.5 * np.exp(-20e-3 / np.array(lag[1:3])), rtol=1e-6)
    assert any("lag" in note for note in exported.notes)
