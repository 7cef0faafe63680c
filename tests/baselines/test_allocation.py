"""Torque allocation, and the slope of the torques that it uses."""

import math

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import lsq_linear

from cablebot_baselines.laws import Composite, FeedbackLinearization
from cablebot_baselines.laws.allocation import allocate
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL


def test_allocation_solves_the_bounded_least_squares_problem():
    rng = np.random.default_rng(0)
    slope = rng.normal(size=(100, 6, 6)) + 2 * np.eye(6)
    requested = rng.normal(size=(100, 6)) * rng.uniform(0.3, 3.0, size=(100, 1))
    allocated = allocate(requested, slope)
    assert np.abs(allocated).max() <= 1.0
    for request, inverse, action in zip(requested, np.linalg.inv(slope), allocated, strict=True):
        solution = lsq_linear(inverse, inverse @ request, bounds=(-1, 1), tol=1e-14)
        residual = np.linalg.norm(inverse @ (action - request))
        assert residual == pytest.approx(math.sqrt(2 * solution.cost), rel=1e-6, abs=1e-9)
    within = rng.uniform(-1, 1, size=(5, 6))
    assert_allclose(allocate(within, slope[:5]), within, rtol=1e-12)


@pytest.mark.parametrize(
    ("env_id", "law"),
    [
        ("CableBot-Spatial-v0", FeedbackLinearization(SPATIAL)),
        ("CableBot-FlexSpatial-v0", Composite(FLEX_SPATIAL)),
    ],
)
def test_torque_slope_is_the_derivative_of_the_torques(env_id, law):
    """Torques are affine in the reference's acceleration."""
    error = np.array([0.02, 0.01, -0.02, 0.1, 0.1, -0.1])
    blocks = law.split(gym.make(env_id, initial_error=error).reset(seed=0)[0])
    mass = np.array(12.0)
    torques = law.torques(blocks, mass)[0]
    for column, unit in zip(law.torque_slope(mass, blocks["pose"]).T, np.eye(6), strict=True):
        shifted = blocks["reference_acceleration"] + unit
        changed = law.torques({**blocks, "reference_acceleration": shifted}, mass)[0]
        assert_allclose(column, changed - torques, rtol=1e-8, atol=1e-10)
