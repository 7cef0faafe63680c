"""The law that estimates its payload: the estimate, and the torque allocation."""

import math

import gymnasium as gym
import numpy as np
import pytest
from driving import drive
from numpy.testing import assert_allclose
from scipy.optimize import lsq_linear

from cablebot_baselines.laws import Adaptive, Composite, FeedbackLinearization
from cablebot_baselines.laws.allocation import allocate
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL

PLANAR_ID = "CableBot-Planar-v0"
SPATIAL_ID = "CableBot-Spatial-v0"
FLEX_ID = "CableBot-FlexSpatial-v0"
LAWS = {
    PLANAR_ID: FeedbackLinearization(PLANAR),
    SPATIAL_ID: FeedbackLinearization(SPATIAL),
    FLEX_ID: Composite(FLEX_SPATIAL),
}


def run(law, env, steps):
    """The mass estimates and the last step."""
    column = observation_layout(law.robot).slices()["model_payload"]
    estimates = []
    for step in drive(law, env, steps):
        mass = law.robot.mass + step.observation[:, column][:, 0]
        estimates.append(law.mass(step.state, mass))
    return np.array(estimates), step


# --- the estimate -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", LAWS)
def test_estimate_converges_within_a_tenth_of_a_second(env_id):
    """At rest the torques of a planar robot do not depend on its payload."""
    law = LAWS[env_id]
    payload = np.array([0.0, 0.4, 1.0])
    circle = "paper-planar" if law.robot.planar else "paper-spatial"
    env = gym.make_vec(env_id, num_envs=3, payload=payload, payload_known=False, trajectory=circle)
    estimates, _ = run(Adaptive(law, estimator_prior_weight=1e-4), env, steps=50)
    assert_allclose(estimates[0], law.robot.mass)
    assert_allclose(estimates[-1], law.robot.mass + payload, rtol=2e-3)


def test_prior_and_data_weigh_equally_after_its_time():
    env = gym.make_vec(SPATIAL_ID, num_envs=1, payload=2.0, payload_known=False)
    estimates, _ = run(Adaptive(LAWS[SPATIAL_ID], estimator_prior_weight=0.05), env, steps=26)
    assert estimates[-1][0] == pytest.approx(11.0, abs=0.1)


def test_estimate_uses_the_saturated_torque():
    """Motors of a quarter of the torque saturate from the start."""
    weak = SPATIAL.replace(motors=type(SPATIAL.motors)(stall_torque=2.9, free_speed=20.0))
    env = gym.make_vec(SPATIAL_ID, num_envs=1, robot=weak, payload=1.5, payload_known=False)
    law = Adaptive(FeedbackLinearization(weak), estimator_prior_weight=1e-4, allocation=False)
    estimates, last = run(law, env, steps=61)
    assert np.abs(last.action).max() > 1.05
    assert estimates[-1][0] == pytest.approx(11.5, rel=5e-3)


def test_estimate_is_frozen_after_the_end_of_the_reference():
    law = Adaptive(LAWS[SPATIAL_ID])
    keywords = {
        "payload": 3.0,
        "payload_known": False,
        "trajectory": "paper-spatial",
        "autoreset_mode": "Disabled",
    }
    env = gym.make_vec(SPATIAL_ID, num_envs=1, **keywords)
    estimates, _ = run(law, env, steps=520)
    assert estimates[501] == estimates[-1]
    assert estimates[490] != estimates[-1]


# --- allocation -------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("env_id", [SPATIAL_ID, FLEX_ID])
def test_torque_slope_is_the_derivative_of_the_torques(env_id):
    """Torques are affine in the reference's acceleration."""
    law = LAWS[env_id]
    error = np.array([0.02, 0.01, -0.02, 0.1, 0.1, -0.1])
    blocks = law.split(gym.make(env_id, initial_error=error).reset(seed=0)[0])
    mass = np.array(12.0)
    torques = law.torques(blocks, mass)[0]
    for column, unit in zip(law.torque_slope(mass, blocks["pose"]).T, np.eye(6), strict=True):
        shifted = blocks["reference_acceleration"] + unit
        changed = law.torques({**blocks, "reference_acceleration": shifted}, mass)[0]
        assert_allclose(column, changed - torques, rtol=1e-8, atol=1e-10)
