"""The paper's robust control, signs corrected: Lyapunov's equation, and the effect of the
term."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_baselines.laws import RobustPD

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
    loop = RobustPD(gains=GAINS, boundary_layer=layer, zeta=0.3, phi=2.0)
    p = loop.lyapunov
    system = np.array([[0.0, 1.0], [-30.0, -20.0]])
    assert_allclose(system.T @ p + p @ system, -np.eye(2), atol=1e-12)
    e = np.stack([pose, velocity], axis=1).ravel()
    a = np.kron(np.eye(6), system)
    s = np.kron(np.eye(6), [[0.0, 1.0]]) @ np.kron(np.eye(6), p) @ e
    rho = (0.3 * (np.linalg.norm(acceleration) + np.linalg.norm(a @ e)) + 2.0) / (1 - 0.3)
    expected = acceleration + 20 * velocity + 30 * pose + rho * s / max(np.linalg.norm(s), layer)
    assert_allclose(loop(blocks), expected, rtol=1e-12)
    assert_allclose(loop.switching(blocks), s, rtol=1e-12)
    batch = {name: np.stack([value, 0.1 * value]) for name, value in blocks.items()}
    assert_allclose(loop(batch)[0], expected, rtol=1e-12)
