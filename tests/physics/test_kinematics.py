"""Angles of pulleys and of the platform against finite differences and SciPy's rotations."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from oracles.plants import QUAD, differentiated, each_of
from oracles.platforms import CRANE
from scipy.spatial.transform import Rotation

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL


def random_angles():
    """Euler angles and their rates."""
    rng = np.random.default_rng(5)
    return rng.uniform(-1.5, 1.5, (100, 3)), rng.uniform(-3, 3, (100, 3))


@each_of(QUAD, CRANE)
def test_lengths_are_distances_between_turned_anchors(robot):
    pose = robot.home + np.random.default_rng(3).uniform(-0.3, 0.3, (50, robot.coordinates))
    points = pose[:, None, : robot.dimensions] - robot.base
    if not robot.planar:
        rotation = Rotation.from_euler("ZYX", pose[:, :2:-1])  # capitals: about the turned axes
        points = points + robot.platform @ np.swapaxes(rotation.as_matrix(), 1, 2)
    lengths = kinematics.cable_lengths(robot.base, robot.platform, pose)
    assert_allclose(lengths, np.linalg.norm(points, axis=-1), rtol=1e-14)


@each_of(PLANAR, SPATIAL, QUAD, CRANE)
def test_pulley_speed_and_acceleration_are_slopes_of_the_angle(robot):
    rng = np.random.default_rng(3)
    pose = robot.home + rng.uniform(-0.2, 0.2, (50, robot.coordinates))
    velocity = rng.uniform(-2, 2, pose.shape)
    acceleration = rng.uniform(-5, 5, pose.shape)

    def angle(time):
        return textbook.pulley_angle(robot, pose + time * velocity + time**2 / 2 * acceleration)

    def speed(time):
        moved = pose + time * velocity + time**2 / 2 * acceleration
        return textbook.pulley_speed(robot, moved, velocity + time * acceleration)

    assert_array_equal(textbook.pulley_angle(robot, robot.home), 0)
    assert_allclose(speed(0), differentiated(angle, 1e-4), rtol=1e-9, atol=1e-8)
    winding = textbook.pulley_acceleration(robot, pose, velocity, acceleration)
    assert_allclose(winding, differentiated(speed, 1e-4), rtol=1e-8, atol=1e-6)


def test_euler_rate_matrix_gives_omega_in_the_platform_frame():
    """RᵀṘ is ω_body = P Θ̇ as a matrix."""
    euler, rates = random_angles()
    rotation = kinematics.rotation_matrix(euler)
    rate = differentiated(lambda time: kinematics.rotation_matrix(euler + time * rates), 1e-4)
    crossed = np.swapaxes(rotation, 1, 2) @ rate
    omega = np.einsum("nij,nj->ni", kinematics.euler_rate_matrix(euler), rates)
    assert_allclose(crossed + np.swapaxes(crossed, 1, 2), 0, atol=1e-10)
    assert_allclose(crossed[:, [2, 0, 1], [1, 2, 0]], omega, atol=1e-10)


def test_rate_of_the_euler_rate_matrix_is_its_slope():
    euler, rates = random_angles()
    slope = differentiated(lambda time: kinematics.euler_rate_matrix(euler + time * rates), 1e-4)
    assert_allclose(
        kinematics.euler_rate_matrix_rate(euler, rates),
        slope,
        rtol=0,
        atol=1e-10,
    )


def test_z_points_down():
    """Sinking lengthens every cable and unwinds every pulley, and gravity is what makes the
    platform sink."""
    sinking = np.array([0, 0, 0.1, 0, 0, 0])
    home = SPATIAL.home
    assert np.all(
        textbook.cable_lengths(SPATIAL, home + sinking) > textbook.cable_lengths(SPATIAL, home)
    )
    assert np.all(textbook.pulley_speed(SPATIAL, home, sinking) < 0)
    fall, _ = textbook.forward_dynamics(SPATIAL, 10.0, home, np.zeros(6), np.zeros(6))
    assert 0 < fall[2] < SPATIAL.gravity
