"""The paper's robust control, signs corrected: Lyapunov's equation, and the effect of the
term."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_baselines.classical import (
    Composite,
    FeedbackLinearization,
    Robust,
    RobustComposite,
    RobustPD,
)
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL

ID = "CableBot-Spatial-v0"
FLEX_ID = "CableBot-FlexSpatial-v0"
GAINS = (30.0, 20.0)


def mean_error(outer_loop):
    """Mean position error of a robot that is a tenth heavier than the model [m]."""
    law = FeedbackLinearization(SPATIAL)
    law.outer = outer_loop
    loop = record_rollout(law, ID, robot=SPATIAL.replace(mass=11.0), trajectory="paper-spatial")
    assert not loop.reason
    return loop.arrays["tracking_error"].mean()


@pytest.mark.parametrize("layer", [1e-4, 1e3])
def test_term_equals_the_corrected_equations(layer):
    """Eq. 34–36 over all twelve errors at once, with block matrices."""
    rng = np.random.default_rng(0)
    pose, velocity, acceleration = (rng.normal(size=6) for _ in range(3))
    zero = np.zeros(6)
    blocks = {
        "reference_pose": pose,
        "pose": zero,
        "reference_velocity": velocity,
        "velocity": zero,
    }
    blocks["reference_acceleration"] = acceleration
    q = np.array([[3.0, 0.2], [0.2, 1.0]])
    loop = RobustPD(gains=GAINS, boundary_layer=layer, zeta=0.3, phi=2.0, q=q)
    p = loop.lyapunov
    system = np.array([[0.0, 1.0], [-30.0, -20.0]])
    assert_allclose(system.T @ p + p @ system, -q, atol=1e-12)
    e = np.stack([pose, velocity], axis=1).ravel()
    a = np.kron(np.eye(6), system)
    s = np.kron(np.eye(6), [[0.0, 1.0]]) @ np.kron(np.eye(6), p) @ e
    rho = (0.3 * (np.linalg.norm(acceleration) + np.linalg.norm(a @ e)) + 2.0) / (1 - 0.3)
    expected = acceleration + 20 * velocity + 30 * pose + rho * s / max(np.linalg.norm(s), layer)
    assert_allclose(loop(blocks), expected, rtol=1e-12)
    assert_allclose(loop.switching(blocks), s, rtol=1e-12)
    batch = {name: np.stack([value, 0.1 * value]) for name, value in blocks.items()}
    assert_allclose(loop(batch)[0], expected, rtol=1e-12)


def test_error_decreases_with_the_boundary_layer():
    """Independent runs: 19 and 68 % less mean error at 10 % too much mass."""
    plain = mean_error(RobustPD(gains=GAINS, boundary_layer=np.inf))
    for layer, reduction in ((1e-2, 0.19), (1e-3, 0.68)):
        robust = mean_error(RobustPD(gains=GAINS, boundary_layer=layer))
        assert 1 - robust / plain == pytest.approx(reduction, abs=0.02)


@pytest.mark.parametrize(
    ("law", "plain", "env_id"),
    [
        (Robust, FeedbackLinearization(SPATIAL), ID),
        (RobustComposite, Composite(FLEX_SPATIAL), FLEX_ID),
    ],
)
def test_parameters_of_the_robust_term_take_effect(law, plain, env_id):
    observation, _ = gym.make_vec(env_id, num_envs=3, initial_error=np.full(6, 1e-4)).reset(seed=0)

    def action(**parameters):
        return law(plain.robot, **parameters).predict(observation)[0]

    assert_array_equal(action(boundary_layer=np.inf), plain.predict(observation)[0])
    parameters = {"gains": (50.0, 20.0), "boundary_layer": 2e-3, "zeta": 0.3, "phi": 2.0, "q": 2.0}
    for name, value in parameters.items():
        assert np.abs(action(**{name: value}) - action()).max() > 1e-6
