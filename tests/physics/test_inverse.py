"""The compiled inverse dynamics against the textbook, and the textbook's pulley accelerations against Eq. 6."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles.plants import (
    FLEX_UNEQUAL,
    NINE,
    QUAD,
    ROUGH,
    UNEQUAL,
    each_of,
    rigid_robots,
)
from oracles.platforms import CAMERA, CRANE, HANGING, TURNING

from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import PLANAR, SPATIAL

every_robot = each_of(PLANAR, QUAD, NINE, SPATIAL, UNEQUAL, FLEX_UNEQUAL, *ROUGH)
TRIPOD = CAMERA.replace(name="tripod", base_anchors=(*CAMERA.base_anchors[:2], (0.1, 4.0, 0.0)))
"""As many cables as coordinates in space."""
TRIANGLE = TURNING.replace(
    name="triangle",
    base_anchors=((-1.5, -1.2), (1.5, -1.2), (0.3, -1.4)),
    platform_anchors=((-0.2, -0.1), (0.2, -0.1), (-0.2, -0.1)),
)
"""As many cables as coordinates in a plane."""
other_kinds = each_of(HANGING, TRIPOD, TRIANGLE, TURNING, CAMERA, CRANE)


def random_motion(robot, shape, seed=1):
    """Poses all over the workspace, velocities up to 2, accelerations up to 10; masses from the robot's on."""
    rng = np.random.default_rng(seed)
    pose = rng.uniform(*robot.pose_bounds, (*shape, robot.coordinates))
    motion = pose, rng.uniform(-2, 2, pose.shape), rng.uniform(-10, 10, pose.shape)
    return robot.mass + rng.uniform(0, 3, shape), *motion


def worst_errors(found, expected):
    """Of each member in each of the results, relative to its largest entry or 1; shape (4, ...)."""
    errors = []
    for field in dataclasses.fields(textbook.InverseDynamics):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        assert ours.shape == theirs.shape
        errors.append(np.abs(ours - theirs).max(axis=-1) / np.maximum(1, np.abs(theirs).max(axis=-1)))
    return np.stack(errors)


@pytest.mark.parametrize("minimum", [0.0, 4.0])
@every_robot
def test_results_are_those_of_the_textbook(robot, minimum):
    """Reached: 2e-16 times the condition of S, up to 1e-12; planar 1e-12, where two cables are nearly in line."""
    motion = random_motion(robot, (2000,))
    expected = textbook.inverse_dynamics(robot, *motion, minimum=minimum, strict=False)
    if robot.planar:
        impossible = np.all(expected.tensions == minimum, axis=-1)
        assert 0.02 < impossible.mean() < 0.98
    errors = worst_errors(inverse_dynamics(robot, *motion, minimum=minimum), expected)
    if not robot.planar:
        condition = np.linalg.cond(textbook.jacobian(robot, motion[1]))
        assert condition.max() > 1e3
        assert np.max(errors / condition) <= 2e-15
    assert errors.max() <= 2e-11


@other_kinds
def test_motions_of_every_kind_need_the_tensions_of_the_textbook(robot):
    """Unique ones, and the same choice of redundant ones; an error is left only of loads that no tensions hold."""
    mass, pose, velocity, acceleration = random_motion(robot, (200,))
    motion = mass, robot.home + 0.3 * (pose - robot.home), velocity, 0.1 * acceleration
    expected = textbook.inverse_dynamics(robot, *motion, minimum=4.0, strict=False)
    load = textbook.load(robot, *motion)
    missing = load + np.einsum("kmn,km->kn", textbook.jacobian(robot, motion[1]), expected.tensions)
    held = np.abs(missing).max(axis=1) < 1e-6
    assert held.mean() > 0.5
    errors = worst_errors(inverse_dynamics(robot, *motion, minimum=4.0), expected)
    assert errors[:, held].max() <= 1e-11


def test_error_near_a_singular_pose_does_not_grow_with_the_squared_condition():
    """Turned by nearly a quarter, where no moment is left: condition 50 to 5e5. Reached: 3e-17 of it, else 3e-12."""
    turn = np.pi / 2 - np.geomspace(1e-1, 1e-5, 64)
    pose = np.zeros((64, 6))
    pose[:, 2], pose[:, 5] = 0.4, turn
    _, _, velocity, acceleration = random_motion(SPATIAL, (64,))
    motion = np.full(64, SPATIAL.mass), pose, velocity, acceleration
    condition = np.linalg.cond(textbook.jacobian(SPATIAL, pose))
    assert condition.max() > 5e5
    errors = worst_errors(inverse_dynamics(SPATIAL, *motion), textbook.inverse_dynamics(SPATIAL, *motion))
    assert np.max(errors / condition) <= 2e-15


@pytest.mark.parametrize("shape", [(), (0,), (33,), (3, 1, 23)])
@rigid_robots
def test_member_of_a_batch_has_the_bits_it_has_alone(robot, shape):
    mass, *motion = random_motion(robot, shape, seed=2)
    found = inverse_dynamics(robot, mass, *motion, minimum=2.0)
    for field in dataclasses.fields(found):
        value = getattr(found, field.name)
        assert value.shape == (*shape, robot.cables)
        for index in np.ndindex(shape):
            alone = inverse_dynamics(robot, mass[index], *(part[index] for part in motion), minimum=2.0)
            np.testing.assert_array_equal(value[index], getattr(alone, field.name))


@rigid_robots
def test_arguments_are_broadcast(robot):
    """One mass, one acceleration, an integer, a read-only and a reversed array are all right."""
    _, pose, velocity, _ = random_motion(robot, (40,), seed=3)
    velocity.flags.writeable = False
    rest = np.zeros(robot.coordinates, int)
    found = inverse_dynamics(robot, 7, pose[::-1], velocity, rest)
    full = np.full(40, 7.0), np.ascontiguousarray(pose[::-1]), velocity.copy(), np.zeros(pose.shape)
    np.testing.assert_array_equal(worst_errors(found, inverse_dynamics(robot, *full)), 0)


@rigid_robots
def test_wrong_shape_raises(robot):
    mass, *motion = random_motion(robot, (4,))
    other = PLANAR if robot is UNEQUAL else SPATIAL
    with pytest.raises(ValueError, match="coordinates"):
        inverse_dynamics(other, mass, *motion)
    with pytest.raises(ValueError, match="broadcast"):
        inverse_dynamics(robot, mass[:3], *motion)


@every_robot
def test_pulley_accelerations_are_those_of_eq_6(robot):
    motion = random_motion(robot, (20,))
    found = textbook.inverse_dynamics(robot, *motion, strict=False).pulley_accelerations
    np.testing.assert_allclose(found, textbook.pulley_acceleration(robot, *motion[1:]), rtol=1e-13, atol=1e-11)
