"""Tensions, torques and accelerations of the textbook equations against linear programs, statics and themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracles.plants import QUAD, ROUGH, UNEQUAL, each_of
from scipy.linalg import null_space
from scipy.optimize import linprog
from scipy.special import logsumexp

from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL

every_robot = each_of(QUAD, SPATIAL, UNEQUAL, *ROUGH[:2])


def random_motion(robot, count, seed=3):
    """Poses around home, within the polygon of the anchors, and velocities and accelerations of any direction."""
    rng = np.random.default_rng(seed)
    reach = np.array([0.12, 0.12] if robot.planar else [0.1, 0.1, 0.05, 0.2, 0.2, 0.2])
    pose = robot.home + rng.uniform(-reach, reach, (count, robot.coordinates))
    if not robot.planar:
        pose[:, 2] += 0.3
    return pose, rng.uniform(-1, 1, pose.shape), rng.uniform(-5, 5, pose.shape)


def least_by_linear_program(structure, load, minimum, cost):
    cables = structure.shape[0]
    return linprog(cost, A_eq=-structure.T, b_eq=load, bounds=[(minimum, None)] * cables, method="highs")


coordinate = st.floats(-0.2, 0.2)
force = st.floats(-20, 20).filter(lambda value: value == 0 or abs(value) > 1e-3)


@settings(max_examples=80, derandomize=True)
@given(coordinate, coordinate, force, force, st.sampled_from([0.0, 1.0, 5.0]), st.sampled_from([PLANAR, QUAD]))
def test_tensions_are_the_least_of_a_linear_program(x, y, fx, fy, minimum, robot):
    structure, load = textbook.jacobian(robot, [x, y]), np.array([fx, fy])
    best = least_by_linear_program(structure, load, minimum, np.ones(robot.cables))
    assume(best.status == 0)  # a corner of the box may lie outside the triangle
    found = textbook.tension_distribution(structure, load, minimum)
    np.testing.assert_allclose(-structure.T @ found, load, rtol=0, atol=1e-10)
    assert found.min() >= minimum
    assert found.sum() == pytest.approx(best.fun, rel=1e-7, abs=1e-7)


@settings(max_examples=40, derandomize=True)
@given(coordinate, coordinate, force, force, st.sampled_from([0.0, 1.0, 5.0]))
def test_least_tensions_of_three_cables_are_least_at_once(x, y, fx, fy, minimum):
    """The least α minimises every tension at once."""
    structure, load = textbook.jacobian(PLANAR, [x, y]), np.array([fx, fy])
    assume(least_by_linear_program(structure, load, minimum, np.ones(3)).status == 0)
    found = textbook.tension_distribution(structure, load, minimum)
    for cable in range(3):
        least = least_by_linear_program(structure, load, minimum, np.eye(3)[cable])
        assert found[cable] == pytest.approx(least.fun, rel=1e-7, abs=1e-7)
    assert found.min() == pytest.approx(minimum, abs=1e-9)


@settings(max_examples=40, derandomize=True)
@given(coordinate, coordinate, force, force, st.sampled_from([0.5, 5.0]))
def test_smooth_tensions_are_a_soft_maximum(x, y, fx, fy, softness):
    """By another way: least-norm tensions, and a soft maximum of what each cable needs of the null space."""
    structure, load, minimum = textbook.jacobian(PLANAR, [x, y]), np.array([fx, fy]), 5.0
    assume(least_by_linear_program(structure, load, minimum, np.ones(3)).status == 0)
    null = null_space(structure.T)[:, 0]
    null = null / null.sum()
    norm = -np.linalg.pinv(structure.T) @ load
    expected = norm + softness * logsumexp((minimum - norm) / null / softness) * null
    found = textbook.smooth_tension_distribution(
        structure, textbook.tension_distribution(structure, load, minimum), minimum, softness
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert found.min() >= minimum


def test_force_along_a_cable_is_carried_by_that_cable():
    for robot in (PLANAR, QUAD):
        structure = textbook.jacobian(robot, robot.home)
        for cable in range(robot.cables):
            expected = 7.0 * np.eye(robot.cables)[cable]
            found = textbook.tension_distribution(structure, -structure.T @ expected, 0.0)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(textbook.tension_distribution(structure, np.zeros(2), 0.0), 0.0)


def test_batch_of_tensions_keeps_its_leading_axes():
    rng = np.random.default_rng(8)
    pose, load = rng.uniform(-0.15, 0.15, (4, 5, 2)), rng.uniform(-9, 9, (4, 5, 2))
    batch = textbook.tension_distribution(textbook.jacobian(QUAD, pose), load, 2.0)
    assert batch.shape == (4, 5, 4)
    for index in np.ndindex(4, 5):
        single = textbook.tension_distribution(textbook.jacobian(QUAD, pose[index]), load[index], 2.0)
        np.testing.assert_allclose(batch[index], single, rtol=0, atol=1e-13)


@pytest.mark.parametrize("robot", [PLANAR, QUAD], ids=lambda robot: robot.name)
def test_impossible_force_raises_or_gives_the_minimum(robot):
    outside = np.array([0.0, -0.7])
    away = np.array([0.0, -5.0])
    with pytest.raises(ValueError, match="outside the polygon"):
        textbook.tension_distribution(textbook.jacobian(robot, outside), away, 0.0)
    with pytest.raises(ValueError, match="outside the polygon"):  # one member of a batch is enough
        textbook.required_tensions(robot, 1.0, np.stack([robot.home, outside]), np.zeros(2), np.stack([away, away]))
    poses, loads = np.stack([robot.home, outside]), np.stack([away, away])
    going_on = textbook.tension_distribution(textbook.jacobian(robot, poses), loads, 2.0, strict=False)
    np.testing.assert_array_equal(going_on[1], 2.0)  # a control law gets the minimum, and its neighbour the solution
    assert going_on[0].max() > 2.5
    towards = textbook.tension_distribution(textbook.jacobian(robot, outside), -away, 0.0)
    assert towards.min() >= 0  # inwards, cables can pull from there too


@pytest.mark.parametrize("minimum", [0.0, 3.0])
@every_robot
def test_forward_dynamics_invert_the_inverse_dynamics(robot, minimum):
    pose, velocity, acceleration = random_motion(robot, 200)
    mass = robot.mass + np.linspace(0, 3, 200)
    tension = textbook.required_tensions(robot, mass, pose, velocity, acceleration, minimum=minimum)
    torques = textbook.required_torques(robot, tension, pose, velocity, acceleration)
    at_once = textbook.inverse_dynamics(robot, mass, pose, velocity, acceleration, minimum=minimum)
    speeds = textbook.pulley_speed(robot, pose, velocity)
    for one, other in ((at_once.torques, torques), (at_once.speeds, speeds)):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)
    found, pulled = textbook.forward_dynamics(robot, mass, pose, velocity, torques, cable="bilateral")
    np.testing.assert_allclose(found, acceleration, rtol=0, atol=1e-10)
    np.testing.assert_allclose(pulled, tension, rtol=0, atol=1e-9)
    taut = np.all(tension > 0.1, axis=1)
    if robot.planar and minimum == 0.0:
        assert not taut.any()  # the least tensions leave one cable without any
        return
    assert taut.sum() > 20
    found, pulled = textbook.forward_dynamics(robot, mass[taut], pose[taut], velocity[taut], torques[taut])
    np.testing.assert_allclose(found, acceleration[taut], rtol=0, atol=1e-10)
    np.testing.assert_allclose(pulled, tension[taut], rtol=0, atol=1e-9)
