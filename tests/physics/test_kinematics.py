"""Cable geometry against symbolic differentiation, finite differences and SciPy's rotations."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
import sympy
from oracles.plants import QUAD, differentiated, each_of
from scipy.spatial.transform import Rotation

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL

# Anchors without any symmetry, above and beside each other, so that no two and no sign can be swapped unseen.
GENERIC_SPATIAL = SPATIAL.replace(
    name="generic spatial",
    base_anchors=(
        (-0.5, -0.3, 0.02),
        (0.45, -0.28, -0.03),
        (0.5, -0.2, 0.01),
        (0.1, 0.55, 0.0),
        (-0.05, 0.5, 0.04),
        (-0.48, -0.2, -0.01),
    ),
    platform_anchors=(
        (0.01, -0.17, 0.02),
        (0.03, -0.16, -0.01),
        (0.15, 0.08, 0.01),
        (0.14, 0.1, 0.03),
        (-0.15, 0.09, -0.02),
        (-0.13, 0.07, 0.0),
    ),
    home_pose=(0.02, -0.01, 0.4, 0.03, -0.02, 0.05),
)
each_robot = each_of(PLANAR, SPATIAL, QUAD, GENERIC_SPATIAL)


def random_motion(robot, count, seed=3):
    rng = np.random.default_rng(seed)
    pose = rng.uniform(*robot.pose_bounds, (count, robot.coordinates))
    return pose, rng.uniform(-2, 2, pose.shape), rng.uniform(-5, 5, pose.shape)


@cache
def symbolic_length_and_gradient(planar):
    """q(X; A, b) and ∂q/∂X of one cable, differentiated by SymPy."""
    if planar:
        pose, base, platform = sympy.symbols("x y"), sympy.symbols("A:2"), sympy.symbols("b:2")
        point = sympy.Matrix(pose)
    else:
        pose, base, platform = sympy.symbols("x y z psi theta phi"), sympy.symbols("A:3"), sympy.symbols("b:3")
        about_x, about_y, about_z = (
            sympy.Matrix(3, 3, list(rows))
            for rows in (
                (1, 0, 0, 0, sympy.cos(pose[3]), -sympy.sin(pose[3]), 0, sympy.sin(pose[3]), sympy.cos(pose[3])),
                (sympy.cos(pose[4]), 0, sympy.sin(pose[4]), 0, 1, 0, -sympy.sin(pose[4]), 0, sympy.cos(pose[4])),
                (sympy.cos(pose[5]), -sympy.sin(pose[5]), 0, sympy.sin(pose[5]), sympy.cos(pose[5]), 0, 0, 0, 1),
            )
        )
        point = sympy.Matrix(pose[:3]) + about_z * about_y * about_x * sympy.Matrix(platform)
    cable = point - sympy.Matrix(base)
    length = sympy.sqrt(cable.dot(cable))
    return sympy.lambdify([pose, base, platform], [length, *(sympy.diff(length, x) for x in pose)], cse=True)


@each_robot
def test_lengths_and_jacobian_are_those_of_sympy(robot):
    symbolic = symbolic_length_and_gradient(robot.planar)
    poses, _, _ = random_motion(robot, 50)
    lengths = kinematics.cable_lengths(robot.base, robot.platform, poses)
    jacobians = kinematics.structure_jacobian(robot.base, robot.platform, poses)
    for pose, length, jacobian in zip(poses, lengths, jacobians, strict=True):
        expected = np.array([symbolic(pose, *ends) for ends in zip(robot.base, robot.platform, strict=True)])
        np.testing.assert_allclose(length, expected[:, 0], rtol=1e-14)
        np.testing.assert_allclose(jacobian, expected[:, 1:], rtol=0, atol=1e-14)


@each_robot
def test_rate_of_the_jacobian_is_its_slope(robot):
    """Reached: 2e-11 of entries up to about 20."""
    pose, velocity, acceleration = random_motion(robot, 200)
    near = kinematics.cable_lengths(robot.base, robot.platform, pose).min(axis=1) < 0.05
    pose, velocity, acceleration = pose[~near], velocity[~near], acceleration[~near]

    def jacobian(time):
        moved = pose + time * velocity + time**2 / 2 * acceleration
        return kinematics.structure_jacobian(robot.base, robot.platform, moved)

    both, found = kinematics.jacobian_and_rate(robot.base, robot.platform, pose, velocity)
    np.testing.assert_allclose(both, jacobian(0), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(found, kinematics.structure_jacobian_rate(robot.base, robot.platform, pose, velocity))
    assert np.abs(found).max() > 1
    np.testing.assert_allclose(found, differentiated(jacobian, 1e-4), rtol=1e-9, atol=1e-9)


@each_robot
def test_pulley_speed_and_acceleration_are_slopes_of_the_angle(robot):
    pose, velocity, acceleration = random_motion(robot, 50)
    near = kinematics.cable_lengths(robot.base, robot.platform, pose).min(axis=1) < 0.05
    pose, velocity, acceleration = pose[~near], velocity[~near], acceleration[~near]

    def angle(time):
        return textbook.pulley_angle(robot, pose + time * velocity + time**2 / 2 * acceleration)

    def speed(time):
        moved = pose + time * velocity + time**2 / 2 * acceleration
        return textbook.pulley_speed(robot, moved, velocity + time * acceleration)

    found = textbook.pulley_speed(robot, pose, velocity)
    np.testing.assert_allclose(found, differentiated(angle, 1e-4), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(textbook.pulley_angle(robot, robot.home), 0)
    found = textbook.pulley_acceleration(robot, pose, velocity, acceleration)
    np.testing.assert_allclose(found, differentiated(speed, 1e-4), rtol=1e-8, atol=1e-7)


def test_rotation_is_that_of_scipy():
    euler = np.random.default_rng(4).uniform(-3, 3, (50, 3))
    expected = Rotation.from_euler("ZYX", euler[:, ::-1]).as_matrix()  # capitals: about the turned axes
    np.testing.assert_allclose(kinematics.rotation_matrix(euler), expected, rtol=0, atol=1e-15)


def test_euler_rate_matrix_gives_omega_in_the_platform_frame():
    """RᵀṘ is ω_body = P Θ̇ as a matrix, and ṘRᵀ is Rω."""
    rng = np.random.default_rng(5)
    euler, rates = rng.uniform(-1.5, 1.5, (100, 3)), rng.uniform(-3, 3, (100, 3))
    rotation = kinematics.rotation_matrix(euler)
    rate = differentiated(lambda time: kinematics.rotation_matrix(euler + time * rates), 1e-4)
    omega = np.einsum("nij,nj->ni", kinematics.euler_rate_matrix(euler), rates)
    body = np.swapaxes(rotation, 1, 2) @ rate
    base = rate @ np.swapaxes(rotation, 1, 2)
    for crossed, vector in ((body, omega), (base, np.einsum("nij,nj->ni", rotation, omega))):
        np.testing.assert_allclose(crossed + np.swapaxes(crossed, 1, 2), 0, atol=1e-10)
        np.testing.assert_allclose(
            np.stack([crossed[:, 2, 1], crossed[:, 0, 2], crossed[:, 1, 0]], 1), vector, atol=1e-10
        )


def test_rate_of_the_euler_rate_matrix_is_its_slope():
    rng = np.random.default_rng(6)
    euler, rates = rng.uniform(-1.5, 1.5, (100, 3)), rng.uniform(-3, 3, (100, 3))
    expected = differentiated(lambda time: kinematics.euler_rate_matrix(euler + time * rates), 1e-4)
    np.testing.assert_allclose(kinematics.euler_rate_matrix_rate(euler, rates), expected, rtol=0, atol=1e-10)


def test_z_points_down():
    """+z is down: sinking lengthens every cable and unwinds every pulley, and gravity is what makes it sink."""
    sinking = np.array([0, 0, 0.1, 0, 0, 0])
    home = SPATIAL.home
    lengths = kinematics.cable_lengths(SPATIAL.base, SPATIAL.platform, np.stack([home, home + sinking]))
    assert np.all(lengths[1] > lengths[0])
    assert np.all(textbook.pulley_speed(SPATIAL, home, sinking) < 0)
    fall, _ = textbook.forward_dynamics(SPATIAL, 10.0, home, np.zeros(6), np.zeros(6))
    assert 0 < fall[2] < SPATIAL.gravity


def test_positive_torque_pulls_towards_the_anchor():
    """And shortens that cable."""
    cable, torques = 1, np.array([0.0, 1.0, 0.0])
    acceleration, tension = textbook.forward_dynamics(PLANAR, 1.0, PLANAR.home, np.zeros(2), torques)
    towards = PLANAR.base[cable] / np.linalg.norm(PLANAR.base[cable])
    assert acceleration @ towards == pytest.approx(np.linalg.norm(acceleration))
    assert np.linalg.norm(acceleration) > 1
    assert tension[cable] > 0
    assert textbook.pulley_speed(PLANAR, PLANAR.home, acceleration)[cable] > 0


def test_batch_keeps_its_leading_axes():
    pose, velocity, _ = random_motion(GENERIC_SPATIAL, 6)
    ends = GENERIC_SPATIAL.base, GENERIC_SPATIAL.platform
    batched = kinematics.structure_jacobian_rate(*ends, pose.reshape(2, 3, 6), velocity.reshape(2, 3, 6))
    assert batched.shape == (2, 3, 6, 6)
    for k in range(6):
        single = kinematics.structure_jacobian_rate(*ends, pose[k], velocity[k])
        np.testing.assert_allclose(batched[k // 3, k % 3], single, rtol=0, atol=1e-14)


def test_lengths_at_home_are_those_of_tables_2_and_4():
    """By hand: planar 1/√3; spatial √(a² + ((a − 2b)/√3)² + 0.1²) with a = 0.47, b = 0.148."""
    planar = kinematics.cable_lengths(PLANAR.base, PLANAR.platform, PLANAR.home)
    np.testing.assert_allclose(planar, 1 / math.sqrt(3), rtol=1e-14)
    spatial = kinematics.cable_lengths(SPATIAL.base, SPATIAL.platform, SPATIAL.home)
    np.testing.assert_allclose(spatial, math.sqrt(0.47**2 + (0.47 - 2 * 0.148) ** 2 / 3 + 0.01), rtol=1e-14)
