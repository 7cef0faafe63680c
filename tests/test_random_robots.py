"""Random robots through checks, default motion, reset and steps."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.random_robots import random_robot

from cablebot_gym.bounds.robot_check import check_model, check_motion
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.evaluation.evaluator import default_payload_max
from cablebot_gym.physics.textbook import normalised_action

LANDING = [pytest.param(seed, marks=pytest.mark.landing) for seed in range(12)]
NIGHTLY = [pytest.param(seed, marks=pytest.mark.nightly) for seed in range(134, 320)]


@pytest.mark.parametrize("seed", [63, 133, *LANDING, *NIGHTLY])
def test_robot_starts_balanced_or_is_said_to_fail(seed):
    """And its default motion is smooth, with a payload within the scan."""
    robot = random_robot(seed)
    check_model(robot)
    check = check_motion(robot)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        env = gym.make(fitting_env_id(robot), robot=robot).unwrapped
        _, info = env.reset(seed=0)
    is_warned = any("All episodes fail" in str(warning.message) for warning in caught)
    assert not (is_warned and check.held)
    start = env.pose.copy()
    action = np.clip(normalised_action(robot, info["torques"], 0.0), -1.0, 1.0)
    for _ in range(5):  # without cables the platform falls by 0.5 mm
        observation, *_ = env.step(action)
        assert np.all(np.isfinite(observation))
    assert is_warned or np.abs(env.pose - start).max() < 1e-4
    # The start is lower than the exact motion, where some robots hold a little less.
    assert check.ceiling >= 0.99 * check.limit.largest
    largest = max(robot.mass, check.limit.largest)
    top = default_payload_max(robot, check.trajectory, check.error_bounds)
    assert check.limit.largest < top < 320 * largest  # eight motors of at most 32 times the weight
    reference = check.trajectory(np.linspace(0, check.trajectory.duration, 101))
    assert_allclose(reference.position[[0, -1]], [robot.home, robot.home], atol=1e-12)
    for order in ("velocity", "acceleration", "jerk", "snap"):
        assert np.abs(getattr(reference, order)[[0, -1]]).max() < 1e-9
