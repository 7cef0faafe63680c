"""Lengths of swivelled cables by hand, and angles of pulleys and platform against finite
differences."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from oracles.plants import QUAD, differentiated, each_of, random_motion
from oracles.platforms import CRANE, PLATFORMS, SWIVELLED

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL


@each_of(PLANAR, SPATIAL, QUAD, *PLATFORMS.values(), SWIVELLED)
def test_pulley_speed_and_acceleration_are_slopes_of_the_angle(robot):
    _, pose, velocity, acceleration = random_motion(robot, (50,), spread=0.1)

    def moved(time):
        return pose + time * velocity + time**2 / 2 * acceleration

    def speed(time):
        return textbook.pulley_speed(robot, moved(time), velocity + time * acceleration)

    assert_array_equal(textbook.pulley_angle(robot, robot.home), 0)
    slope = differentiated(lambda time: textbook.pulley_angle(robot, moved(time)), 1e-4)
    assert_allclose(speed(0), slope, rtol=1e-9, atol=1e-8)
    pulley_acceleration = textbook.pulley_acceleration(robot, pose, velocity, acceleration)
    slope = differentiated(speed, 1e-4)
    assert_allclose(pulley_acceleration, slope, rtol=1e-8, atol=1e-6)


LOWER_WINCHES = CRANE.replace(  # four cables come from below and pull downwards
    base_anchors=[*CRANE.base_anchors[:4], *((x, y, 8.0) for x, y, _ in CRANE.base_anchors[4:])],
    platform_anchors=[
        *CRANE.platform_anchors[:4],
        *((x, y, z + 1.0) for x, y, z in CRANE.platform_anchors[4:]),
    ],
    center_of_mass=(),
    swivel_radius=(0.05, 0.0, 0.1, 0.05, 0.05, 0.2, 0.05, 0.05),
)


def test_cable_wraps_its_swivel_pulley_on_the_right_side():
    """Straight down from the outer edge of the pulley: half a turn on the pulley and the free
    length."""
    anchor = np.zeros((1, 3))
    for swivel, depth in ((0.1, 2.0), (-0.1, -2.0)):
        length = kinematics.cable_lengths(anchor, anchor, [0.2, 0.0, depth], [swivel])
        assert_allclose(length, [np.pi * 0.1 + 2.0], rtol=1e-14)
    assert np.sign(SWIVELLED.swivel).tolist() == [1] * 8
    assert np.sign(LOWER_WINCHES.swivel).tolist() == [1, 0, 1, 1, -1, -1, -1, -1]


def test_euler_rate_matrix_gives_omega_in_the_platform_frame():
    """RᵀṘ is ω_body = P Θ̇ as a matrix; Ṗ is the slope of P."""
    rng = np.random.default_rng(5)
    euler = rng.uniform(-1.5, 1.5, (100, 3))
    rates = rng.uniform(-3, 3, (100, 3))

    def slope(function):
        return differentiated(lambda time: function(euler + time * rates), 1e-4)

    to_platform = kinematics.rotation_matrix(euler).mT
    omega_matrix = to_platform @ slope(kinematics.rotation_matrix)
    omega = np.einsum("nij,nj->ni", kinematics.euler_rate_matrix(euler), rates)
    assert_allclose(omega_matrix + omega_matrix.mT, 0, atol=1e-10)
    assert_allclose(omega_matrix[:, [2, 0, 1], [1, 2, 0]], omega, atol=1e-10)
    rate = kinematics.euler_rate_matrix_rate(euler, rates)
    assert_allclose(rate, slope(kinematics.euler_rate_matrix), rtol=0, atol=1e-10)
