"""Kinematics and equations of motion of every kind of platform, against differences and Lagrange's
equations."""

import numpy as np
from numpy.testing import assert_allclose
from oracles.plants import differentiated, each_of, random_motion
from oracles.platforms import CRANE, PLATFORMS, SWIVELLED

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook

LOWER_WINCHES = CRANE.replace(  # four cables come from below and pull downwards
    name="lower-winches",
    base_anchors=[*CRANE.base_anchors[:4], *((x, y, 8.0) for x, y, _ in CRANE.base_anchors[4:])],
    platform_anchors=[
        *CRANE.platform_anchors[:4],
        *((x, y, z + 1.0) for x, y, z in CRANE.platform_anchors[4:]),
    ],
    center_of_mass=(),
    swivel_radius=(0.05, 0.0, 0.1, 0.05, 0.05, 0.2, 0.05, 0.05),
)


def gradient(function, point):
    """∂f/∂X by central differences, with a last axis n."""

    def slope(direction):
        return differentiated(lambda step: function(point + step * direction), 1e-3)

    return np.stack([slope(direction) for direction in np.eye(point.shape[-1])], axis=-1)


def test_cable_wraps_its_swivel_pulley_on_the_right_side():
    """Straight down from the outer edge of the pulley: half a turn on the pulley and the free
    length."""
    anchor = np.zeros((1, 3))
    for swivel, depth in ((0.1, 2.0), (-0.1, -2.0)):
        length = kinematics.cable_lengths(anchor, anchor, [0.2, 0.0, depth], [swivel])
        assert_allclose(length, [np.pi * 0.1 + 2.0], rtol=1e-14)
    assert np.sign(SWIVELLED.swivel).tolist() == [1] * 8
    assert np.sign(LOWER_WINCHES.swivel).tolist() == [1, 0, 1, 1, -1, -1, -1, -1]


def lagrangian(robot, mass, pose, velocity):
    """Kinetic minus potential energy from the motion of the centre of mass, which :mod:`textbook`
    does not use."""

    def center(time):
        moved = pose + time * velocity
        offset = kinematics.turned(moved, robot.mass_center[None])[..., 0, :]
        return moved[..., : robot.dimensions] + offset

    speed = differentiated(center, 1e-3)
    kinetic = mass * np.sum(speed**2, axis=-1) / 2
    energy = kinetic + mass * (center(0.0) @ robot.gravity_vector)
    if robot.point_mass:
        return energy
    omega = np.zeros((*pose.shape[:-1], 3))
    if robot.planar:
        omega[..., 2] = velocity[..., 2]
    else:
        to_omega = kinematics.euler_rate_matrix(pose[..., 3:])
        omega = kinematics.times_vector(to_omega, velocity[..., 3:])
    return energy + np.einsum("...i,ij,...j", omega, robot.inertia_tensor, omega) / 2


@each_of(*PLATFORMS.values())
def test_load_agrees_with_lagranges_equations(robot):
    mass, pose, velocity, acceleration = random_motion(robot, (5,), spread=0.1)

    def momentum(time):
        moved = pose + time * velocity
        rates = velocity + time * acceleration
        return gradient(lambda v: lagrangian(robot, mass, moved, v), rates)

    force = gradient(lambda x: lagrangian(robot, mass, x, velocity), pose)
    load = textbook.load(robot, mass, pose, velocity, acceleration)
    expected = differentiated(momentum, 1e-3) - force
    assert_allclose(load, expected, rtol=1e-5, atol=1e-5 * np.abs(load).max())
