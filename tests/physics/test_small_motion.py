"""Linear models of small motions against the potential of springs and weight."""

import numpy as np
from numpy.testing import assert_allclose
from oracles.plants import FLEX_HANGING, FLEX_QUAD, FLEX_UNEQUAL, each_of, with_transmission
from oracles.platforms import CAMERA, CRANE, SWIVELLED, TURNING

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook

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


@each_of(FLEX_QUAD, FLEX_UNEQUAL, FLEX_HANGING, *ELASTIC, *JOINTED, BOTH)
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
