"""Steering of a base law: spline, memory and features."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from steering import SPATIAL_ID, steer, steering_of, tasks_of

from cablebot_baselines.learned.steering import Shift
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import SPATIAL
from cablebot_gym.task import ErrorBounds

PERIOD = 1 / 500


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_spline_is_a_smooth_partition_of_unity(degree):
    """Its derivatives equal difference quotients, and it is continuous at its knots up to order
    degree − 1."""
    action_period = 0.03
    step = 1e-6
    shift = Shift(degree=degree)
    times = np.linspace(0.002, 0.028, 7)
    sizes = action_period ** -np.arange(5.0)[:, None]
    before = shift.weights(times - step, action_period) / sizes
    now = shift.weights(times, action_period) / sizes
    after = shift.weights(times + step, action_period) / sizes
    assert_allclose(now[:, 0].sum(axis=-1), 1.0, atol=1e-14)
    assert now[:, 0].min() >= 0
    slope = (after - before) / (2 * step) * action_period
    assert_allclose(now[:, 1:], slope[:, :-1], atol=1e-5)
    start, end = shift.weights(np.array([0.0, action_period]), action_period) / sizes
    smooth = slice(min(degree, 5))
    assert_allclose(end[smooth, 1:], start[smooth, :-1], atol=1e-9)
    assert_allclose(end[smooth, 0], 0.0, atol=1e-9)
    assert_allclose(start[smooth, -1], 0.0, atol=1e-9)


def test_shift_stays_within_the_error_bounds():
    steering = steering_of(SPATIAL_ID, action_mapping=Shift(action_period=0.006, fraction=0.95))
    error_bounds = ErrorBounds(position=0.02, rotation=0.03)
    steering.reset(tasks_of(SPATIAL_ID, error_bounds=error_bounds))
    actions = 3 * np.sign(np.random.default_rng(0).normal(size=(600, 6)))
    actions[300:] = 3.0  # all to one corner
    law_blocks, _ = steer(steering, np.zeros((600, observation_layout(SPATIAL).size)), actions)
    shift = law_blocks["reference_pose"]
    away = np.linalg.norm(shift[:, :3], axis=1)
    assert away.max() <= 0.95 * 0.02 * (1 + 1e-12)
    assert away[-1] == pytest.approx(0.95 * 0.02)
    assert np.abs(shift[:, 3:]).max() == pytest.approx(0.95 * 0.03)


@pytest.mark.parametrize("degree", [2, 5])
def test_learner_and_law_get_the_shift_of_the_present_instant(degree):
    """Rigid robots' laws get the mean acceleration of each control period."""
    action_mapping = Shift(action_period=0.01, degree=degree)
    steps = 60
    steering = steering_of(SPATIAL_ID, action_mapping=action_mapping, features=("error", "actions"))
    actions = np.random.default_rng(degree).uniform(-0.5, 0.5, (steps, 6))
    layout = observation_layout(SPATIAL)
    rows = np.zeros((steps, layout.size))
    blocks = layout.split(rows)
    speed = np.linspace(-1, 1, 6)
    blocks["reference_pose"][:] = speed * np.arange(steps)[:, None] * PERIOD
    blocks["reference_velocity"][:] = speed
    blocks["pose"][:] = np.random.default_rng(0).normal(size=(steps, 6))
    law_blocks, learner = steer(steering, rows, actions)
    error, past = np.split(learner, [6], axis=1)
    assert_allclose(error, law_blocks["reference_pose"] - blocks["pose"], atol=1e-13)
    mean = np.diff(law_blocks["reference_velocity"], axis=0) / PERIOD
    assert_allclose(law_blocks["reference_acceleration"][:-1], mean, atol=1e-9)
    decisions = actions[::5].copy()
    decisions[:, :3] /= np.maximum(np.linalg.norm(decisions[:, :3], axis=1, keepdims=True), 1)
    points = np.concatenate([np.zeros((degree, 6)), decisions])
    for decision in range(steps // 5):
        expected = points[decision : decision + degree].ravel()
        assert_allclose(past[5 * decision], expected, atol=1e-15)
