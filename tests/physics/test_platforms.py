"""Kinematics and equations of motion of every kind of platform, against differences and Lagrange's equations."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.platforms import CRANE, PLATFORMS

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook

SWIVELLED = CRANE.replace(name="swivelled", swivel_radius=0.05)
LOWER_WINCHES = CRANE.replace(  # four cables come from below and pull downwards
    name="lower-winches",
    base_anchors=[*CRANE.base_anchors[:4], *((x, y, 8.0) for x, y, _ in CRANE.base_anchors[4:])],
    platform_anchors=[*CRANE.platform_anchors[:4], *((x, y, z + 1.0) for x, y, z in CRANE.platform_anchors[4:])],
    center_of_mass=(),
    swivel_radius=(0.05, 0.0, 0.1, 0.05, 0.05, 0.2, 0.05, 0.05),
)
ROBOTS = {**PLATFORMS, "swivelled": SWIVELLED}
each_platform = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
STEP = 1e-5


def states(robot, count: int = 5):
    """Random poses near home and random velocities, each (count, n)."""
    random = np.random.default_rng(7)
    size = (count, robot.coordinates)
    return robot.home + random.uniform(-0.2, 0.2, size), random.normal(size=size)


def gradient(function, pose):
    """∂f/∂X by central differences, with a last axis n."""
    steps = STEP * np.eye(pose.shape[-1])
    return np.stack([(function(pose + step) - function(pose - step)) / (2 * STEP) for step in steps], axis=-1)


@each_platform
def test_jacobian_and_its_rate_are_derivatives_of_the_lengths(robot):
    pose, velocity = states(robot)
    structure = textbook.jacobian(robot, pose)
    np.testing.assert_allclose(structure, gradient(lambda x: textbook.cable_lengths(robot, x), pose), atol=1e-8)
    ahead, back = (textbook.jacobian(robot, pose + sign * STEP * velocity) for sign in (1, -1))
    rate = textbook.jacobian_rate(robot, pose, velocity)
    np.testing.assert_allclose(rate, (ahead - back) / (2 * STEP), atol=1e-7)


def test_cable_wraps_its_swivel_pulley_on_the_side_it_comes_from():
    """Straight down from the outer edge of the pulley: half a turn on the pulley and the free length."""
    for swivel, depth in ((0.1, 2.0), (-0.1, -2.0)):
        length = kinematics.cable_lengths([[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]], [0.2, 0.0, depth], [swivel])
        np.testing.assert_allclose(length, [np.pi * 0.1 + 2.0], rtol=1e-14)
    assert np.array_equal(np.sign(SWIVELLED.swivel), np.ones(8))
    assert np.array_equal(np.sign(LOWER_WINCHES.swivel), [1, 0, 1, 1, -1, -1, -1, -1])


def lagrangian(robot, mass, pose, velocity):
    """Kinetic minus potential energy from the motion of the centre of mass, which :mod:`textbook` does not use."""
    center = pose[..., : robot.dimensions] + kinematics.turned(pose, robot.mass_center[None])[..., 0, :]
    ahead, back = (
        (x := pose + sign * STEP * velocity)[..., : robot.dimensions]
        + kinematics.turned(x, robot.mass_center[None])[..., 0, :]
        for sign in (1, -1)
    )
    speed = (ahead - back) / (2 * STEP)
    energy = mass * np.sum(speed**2, axis=-1) / 2 + mass * center @ robot.gravity_vector
    if robot.kind == "planar-platform":
        energy = energy + robot.inertia_tensor[2, 2] * velocity[..., 2] ** 2 / 2
    if robot.kind == "spatial":
        omega = (kinematics.euler_rate_matrix(pose[..., 3:]) @ velocity[..., 3:, None])[..., 0]
        energy = energy + np.einsum("...i,ij,...j", omega, robot.inertia_tensor, omega) / 2
    return energy


@each_platform
def test_load_agrees_with_lagranges_equations(robot):
    pose, velocity = states(robot)
    acceleration = np.random.default_rng(8).normal(size=pose.shape)
    mass = robot.mass + 3.0

    def momentum(x, v):
        return gradient(lambda u: lagrangian(robot, mass, x, u), v)

    h = 1e-4
    ahead, back = (momentum(pose + s * h * velocity, velocity + s * h * acceleration) for s in (1, -1))
    expected = (ahead - back) / (2 * h) - gradient(lambda x: lagrangian(robot, mass, x, velocity), pose)
    found = textbook.load(robot, mass, pose, velocity, acceleration)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3 * np.abs(found).max())


def test_elastic_cables_at_rest_have_the_given_tensions():
    given = CRANE.transmission.replace(axial_stiffness=5e5, extra_length=3.0, stiffness=2e3, motor_inertia=1e-2)
    robot = CRANE.replace(transmission=given)
    tensions, zero = np.linspace(50.0, 400.0, 8), np.zeros(6)
    motor, pulley = textbook.rest_angles(robot, tensions, robot.home)
    found, torque = textbook.cable_springs(robot, robot.home, zero, pulley, np.zeros(8))
    np.testing.assert_allclose(found, tensions, rtol=1e-9)
    np.testing.assert_allclose(robot.stiffness * (motor - pulley), torque, rtol=1e-9)
    slack, none = textbook.cable_springs(robot, robot.home, zero, -pulley, np.zeros(8))
    np.testing.assert_array_equal([slack, none], np.zeros((2, 8)))


def test_linear_model_contains_the_springs_of_the_cables():
    """A mass between a locked winch and its cable oscillates with √(EA/(l m)); the winch turns with √(EA r²/(l J))."""
    given = PLATFORMS["hanging"].transmission.replace(axial_stiffness=1e4, pulley_inertia=1e6)
    robot = PLATFORMS["hanging"].replace(
        base_anchors=[(-1.0, 0.0), (1.0, 0.0)], home_pose=(0.0, 1.0), transmission=given
    )
    model = textbook.linear_model(robot)
    rates = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(model.inertia, model.stiffness)).real)[-2:])
    np.testing.assert_allclose(rates, np.sqrt([1e4 / np.sqrt(2) / 5] * 2), rtol=1e-6)
