"""The paper's robust control, signs corrected: Lyapunov's equation, and the effect of the
term."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_baselines.laws import ROBUST, Composite, FeedbackLinearization, RobustPD
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL

GAINS = (30.0, 20.0)


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


@pytest.mark.parametrize(
    ("plain", "env_id"),
    [
        (FeedbackLinearization(SPATIAL), "CableBot-Spatial-v0"),
        (Composite(FLEX_SPATIAL), "CableBot-FlexSpatial-v0"),
    ],
)
def test_options_of_the_robust_term_take_effect(plain, env_id):
    """With an infinite boundary layer the law is that without the term."""
    observation, _ = gym.make_vec(env_id, num_envs=3, initial_error=np.full(6, 1e-4)).reset(seed=0)

    def action(**options):
        return ROBUST.factory(plain.robot, **options).predict(observation)[0]

    assert_array_equal(action(boundary_layer=np.inf), plain.predict(observation)[0])
    options = {"gains": (50.0, 20.0), "boundary_layer": 2e-3, "zeta": 0.3, "phi": 2.0}
    for name, value in options.items():
        assert np.abs(action(**{name: value}) - action()).max() > 1e-6
