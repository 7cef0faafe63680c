"""Linear models of small motions against MuJoCo and against the potential of springs and weight."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.mujoco_model import MujocoRobot
from oracles.plants import FLEX_HANGING, FLEX_QUAD, FLEX_UNEQUAL, each_of, with_transmission
from oracles.platforms import CAMERA, CRANE, SWIVELLED, TURNING

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook

NUDGE = 1e-5
PAYLOAD = 2.5

SOFT = {"axial_stiffness": 2e4, "extra_length": 0.3}
ELASTIC = tuple(with_transmission(robot, **SOFT) for robot in (CAMERA, CRANE, SWIVELLED, TURNING))
JOINTED = tuple(
    with_transmission(robot, stiffness=900.0, motor_inertia=1e-3) for robot in (SWIVELLED, TURNING)
)
BOTH = with_transmission(TURNING, stiffness=900.0, motor_inertia=1e-3, **SOFT)


def at_rest(robot):
    """Mass, pose and tensions at rest away from home."""
    mass = robot.mass + PAYLOAD
    pose = robot.home + np.linspace(0.02, 0.05, robot.coordinates)
    still = np.zeros_like(pose)
    return mass, pose, textbook.required_tensions(robot, mass, pose, still, still, minimum=20.0)


@each_of(FLEX_QUAD, FLEX_UNEQUAL, FLEX_HANGING, *ELASTIC[:2], ELASTIC[3])
def test_stiffness_of_the_platform_is_that_of_mujoco(robot):
    """Motors locked. MuJoCo's cables and weight are nudged; 30 % of some entries is by tensions."""
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    mass, pose, tensions = at_rest(robot)
    motors, pulleys = textbook.rest_angles(robot, tensions, pose)
    still = np.zeros(robot.cables)
    peer = MujocoRobot(robot, payload=PAYLOAD)

    def accelerations(nudged):
        peer.set_state(nudged, np.zeros_like(nudged))
        if robot.elastic:
            home = textbook.cable_lengths(robot, robot.home) + robot.extra_length
            peer.set_free_lengths(home - robot.pulley_radius * pulleys)
        else:
            peer.set_motors(motors, still)
        return peer.accelerations(still)

    nudges = NUDGE * np.eye(robot.coordinates)
    columns = [
        (accelerations(pose + nudge) - accelerations(pose - nudge)) / (2 * NUDGE)
        for nudge in nudges
    ]
    n = robot.coordinates
    model = textbook.linear_model(robot, mass=mass, pose=pose, tensions=tensions)
    # MuJoCo's locked motors leave the pulleys' inertia on the platform.
    inertia = textbook.mass_matrix(robot, mass, pose) if robot.elastic else model.inertia[:n, :n]
    expected = -inertia @ np.stack(columns, axis=1)
    stiffness = model.stiffness[:n, :n]
    assert_allclose(stiffness, expected, rtol=0, atol=1e-7 * np.abs(stiffness).max())


@each_of(FLEX_QUAD, FLEX_UNEQUAL, *ELASTIC, *JOINTED, BOTH)
def test_stiffness_is_the_second_derivative_of_the_potential(robot):
    """Of springs and weight, over poses, pulleys and motors, with tensions that balance it."""
    mass, pose, tensions = at_rest(robot)
    motors, pulleys = textbook.rest_angles(robot, tensions, pose)
    parts = [pose]
    if robot.elastic:
        parts.append(pulleys)
    if robot.jointed:
        parts.append(motors)
    rest = np.concatenate(parts)
    ends = np.cumsum([len(part) for part in parts])[:-1]

    def potential(values):
        at, *angles = np.split(values, ends, axis=-1)
        center = kinematics.turned(at, robot.mass_center[None])[..., 0, :]
        energy = -mass * (at[..., : robot.dimensions] + center) @ robot.gravity_vector
        wound = textbook.pulley_angle(robot, at)
        if robot.elastic:
            free = textbook.cable_lengths(robot, robot.home) + robot.extra_length
            free = free - robot.pulley_radius * angles[0]
            stretch = textbook.cable_lengths(robot, at) + robot.extra_length - free
            energy = energy + np.sum(robot.axial_stiffness / free * stretch**2, axis=-1) / 2
            wound = angles[0]
        if robot.jointed:
            energy = energy + np.sum(robot.stiffness * (angles[-1] - wound) ** 2, axis=-1) / 2
        return energy

    nudges = 1e-3 * np.eye(len(rest))
    expected = sum(
        sign
        * other
        * potential(rest + (sign * nudges)[:, None] + (other * nudges)[None])
        / (4 * 1e-6)
        for sign in (1, -1)
        for other in (1, -1)
    )
    model = textbook.linear_model(robot, mass=mass, pose=pose, tensions=tensions)
    assert_allclose(model.stiffness, expected, rtol=0, atol=2e-5 * np.abs(expected).max())
