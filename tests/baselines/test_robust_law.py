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
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL

ID = "CableBot-Spatial-v0"
FLEX_ID = "CableBot-FlexSpatial-v0"
GAINS = (30.0, 20.0)


def errors_with(outer_loop, mass_factor=1.1, initial_error=(0.0,) * 6, steps=500):
    """Position error, V and ‖s‖ at every control instant of a robot whose mass differs from the
    model."""
    law = FeedbackLinearization(SPATIAL)
    law.outer = outer_loop
    env = gym.make(
        ID,
        robot=SPATIAL.replace(mass=10.0 * mass_factor),
        initial_error=initial_error,
        trajectory="paper-spatial",
    )
    observation, _ = env.reset(seed=0)
    record = []
    for _ in range(steps):
        blocks = law.split(observation)
        values = outer_loop.lyapunov_value(blocks), np.linalg.norm(outer_loop.switching(blocks))
        record.append((np.linalg.norm((blocks["reference_pose"] - blocks["pose"])[:3]), *values))
        observation, _, terminated, _, _ = env.step(law.predict(observation)[0])
        assert not terminated
    return np.array(record).T


@pytest.fixture(scope="module")
def plain_error():
    """Mean position error without the robust term."""
    return errors_with(RobustPD(gains=GAINS, boundary_layer=np.inf))[0].mean()


@pytest.mark.parametrize(("q", "matrix"), [(7, 7 * np.eye(2)), ([[2.0, -0.3], [-0.3, 0.5]],) * 2])
def test_lyapunov_matrix_solves_its_equation(q, matrix):
    a = np.array([[0.0, 1.0], [-30.0, -20.0]])
    p = RobustPD(gains=GAINS, q=q).lyapunov
    assert_allclose(a.T @ p + p @ a, -np.array(matrix), atol=1e-9 * np.abs(p).max())
    assert np.linalg.eigvalsh(p)[0] > 0


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
    loop = RobustPD(
        gains=GAINS, boundary_layer=layer, zeta=0.3, phi=2.0, q=[[3.0, 0.2], [0.2, 1.0]]
    )
    e = np.stack([pose, velocity], axis=1).ravel()
    a = np.kron(np.eye(6), [[0.0, 1.0], [-30.0, -20.0]])
    s = np.kron(np.eye(6), [[0.0, 1.0]]) @ np.kron(np.eye(6), loop.lyapunov) @ e
    rho = (0.3 * (np.linalg.norm(acceleration) + np.linalg.norm(a @ e)) + 2.0) / (1 - 0.3)
    expected = acceleration + 20 * velocity + 30 * pose + rho * s / max(np.linalg.norm(s), layer)
    assert_allclose(loop(blocks), expected, rtol=1e-12)
    assert_allclose(loop.switching(blocks), s, rtol=1e-12)
    assert loop.lyapunov_value(blocks) == pytest.approx(e @ np.kron(np.eye(6), loop.lyapunov) @ e)
    batch = {name: np.stack([value, 0.1 * value]) for name, value in blocks.items()}
    assert_allclose(loop(batch)[0], expected, rtol=1e-12)


def test_lyapunov_function_decreases_outside_the_boundary_layer():
    error = np.array([0.02, -0.01, 0.02, 0.05, -0.03, 0.05])
    loop = RobustPD(gains=GAINS, boundary_layer=1e-4)
    _, value, length = errors_with(loop, 0.9, error, steps=250)
    reached = int(np.argmax(length < loop.boundary_layer))
    assert reached > 5
    assert np.all(np.diff(value[: reached + 1]) < 0)


@pytest.mark.parametrize(("layer", "reduction"), [(1e-2, 0.19), (1e-3, 0.68)])
def test_error_decreases_with_the_boundary_layer(layer, reduction, plain_error):
    """Independent runs: 19 and 68 % less mean error at 10 % too much mass."""
    robust = errors_with(RobustPD(gains=GAINS, boundary_layer=layer))[0].mean()
    assert 1 - robust / plain_error == pytest.approx(reduction, abs=0.02)


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
