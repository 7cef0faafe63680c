"""Estimation of pose and velocity from the sensors of winches."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.episodes import ROBOTS
from scipy.stats import chi2

from cablebot_baselines.observer import (
    Estimated,
    Expectation,
    WinchEstimator,
    usual_expectation,
)
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import find_robot
from cablebot_gym.uncertainty import find_uncertainty

ENCODERS = {"kind": "winches", "encoder_resolution": 2 * np.pi / 8192}


def run(
    env_id, estimator, *, law="fl", count=4, measurement="winches", uncertainty=None, **options
):
    """Errors of pose and velocity (steps, N, 2n) in closed loop, normalised squared errors of the
    filter, and the largest tracking error of the last step."""
    robot = ROBOTS[env_id]
    env = gym.make_vec(
        env_id,
        num_envs=count,
        payload=1.0,
        measurement=measurement,
        uncertainty=uncertainty,
        max_episode_steps=None,
        **options,
    ).unwrapped
    policy = Estimated(load_policy(law, robot), robot, estimator)
    rows, _ = env.reset(seed=0)
    policy.reset(env.tasks)
    state = None
    errors = []
    squares = []
    size = 2 * robot.coordinates
    for _ in range(300):
        actions, state = policy.predict(rows, state)
        estimate = state[0]
        true = np.concatenate([env.pose, env._simulation._plant.velocity], axis=-1)
        errors.append(estimate.mean[:, :size] - true)
        inverse = np.linalg.inv(estimate.covariance[:, :size, :size])
        squares.append(np.einsum("ij,ijk,ik->i", errors[-1], inverse, errors[-1]))
        rows, *_, info = env.step(actions)
    return np.array(errors[50:]), np.array(squares[50:]), info["tracking_error"].max()


@pytest.mark.landing
def test_filter_finds_the_pose_behind_the_springs():
    errors, *_ = run(
        "CableBot-FlexPlanar-v0", WinchEstimator(find_robot("flex-planar")), law="composite"
    )
    assert np.abs(errors[..., :2]).max() < 1e-4  # the springs deflect by centimetres of cable


@pytest.mark.landing
@pytest.mark.parametrize(
    ("env_id", "law", "zero_error"),
    [
        ("CableBot-Planar-v0", "fl", 1e-3),
        ("CableBot-FlexPlanar-v0", "motor-pd", 0.3),
    ],
)
def test_homing_removes_zero_errors_of_sensors(env_id, law, zero_error):
    """With the raw motor angles the laws for springs fail at once: the zero error is centimetres of
    cable."""
    robot = ROBOTS[env_id]
    errors, _, tracking_error = run(
        env_id,
        WinchEstimator(robot, usual_expectation(robot, homing=True)),
        law=law,
        measurement="winches+tensions",
        uncertainty={"sensor_bias": {"motor_angle": zero_error, "tension": 5.0}},
    )
    assert np.abs(errors[..., :2]).max() < 2e-4
    assert tracking_error < 0.01


def test_diverged_filter_starts_anew_and_leaves_the_other_episodes():
    """Equations that take only finite numbers would end the evaluation of all episodes."""
    env = gym.make_vec("CableBot-FlexPlanar-v0", num_envs=2, measurement="winches").unwrapped
    rows, _ = env.reset(seed=0)
    robot = find_robot("flex-planar")
    policy = Estimated(load_policy("composite", robot), robot)
    policy.reset(env.tasks)
    _, (estimate, law) = policy.predict(rows)
    for value in (np.nan, 1e200):
        lost = estimate.mean.copy()
        lost[0] = value
        _, (following, _) = policy.predict(rows, (replace(estimate, mean=lost), law))
        _, (expected, _) = policy.predict(rows, (estimate, law))
        assert np.isfinite(following.mean).all()
        assert_allclose(following.mean[1], expected.mean[1])


POSITION, ROTATION = 2e-3, 2e-3
"""Half widths of the error of the start pose [m, rad]."""


def homed(env_id, law, count, errors):
    """Errors of the pose (steps, N, n) and their normalised squares (steps, N) with an error of the
    start pose that the filter expects."""
    robot = ROBOTS[env_id]
    uncertainty = find_uncertainty(errors, robot)
    start = POSITION / np.sqrt(3), ROTATION / np.sqrt(3)
    expected = Expectation.of(robot, uncertainty, start_spread=start)
    turns = robot.coordinates - robot.dimensions
    pose_errors, squares, _ = run(
        env_id,
        WinchEstimator(robot, expected),
        law=law,
        count=count,
        measurement=ENCODERS | {"tensions": True},
        uncertainty=errors,
        initial_error_range=[POSITION] * robot.dimensions + [ROTATION] * turns,
    )
    return pose_errors[..., : robot.coordinates], squares


SENSORS = {
    "sensors": {"motor_angle": 1e-4, "motor_speed": 1e-2, "tension": 0.4},
    "sensor_bias": {"motor_angle": 6e-3, "tension": 2.0},
}


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("env_id", "law"),
    [
        ("CableBot-Spatial-v0", "fl"),
        ("CableBot-FlexSpatial-v0", "composite:gains=paper"),
    ],
)
def test_errors_are_as_large_as_the_filter_states(env_id, law):
    """Zeros taken once at the nominal start pose would give thousands instead of one: the errors of
    the pose and of the zeros belong together."""
    robot = ROBOTS[env_id]
    errors, squares = homed(env_id, law, 32, SENSORS)
    degrees = 32 * 2 * robot.coordinates
    low, high = chi2.ppf([0.001, 0.999], degrees) / degrees
    # The motion of the filter is integrated less exactly than that of the plant. Behind springs it
    # takes the noise of a speed in two periods as independent, which is careful.
    least = 0.25 if robot.flexible else 0.8 * low
    assert least < squares.mean() / (2 * robot.coordinates) < 1.2 * high
    if env_id == "CableBot-FlexSpatial-v0":
        assert np.abs(errors[..., 3:]).max() < 4e-3  # 40 % of the bound


@pytest.mark.landing
def test_filter_finds_the_stiffness():
    """With nominal springs the error is a millimetre: 10 % of a deflection of centimetres."""
    softer = {"stiffness": {"low": -0.1, "high": 0.1, "each": False}}
    errors, _ = homed("CableBot-FlexPlanar-v0", "composite", 4, SENSORS | {"parameters": softer})
    assert np.abs(errors[-50:]).max() < 5e-4
