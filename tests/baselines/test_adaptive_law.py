"""The law that estimates its payload: the estimate, the torque allocation, and what both carry."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from cablebot_baselines.classical import Adaptive, Composite, FeedbackLinearization
from cablebot_baselines.classical.adaptive import ADAPTIVE, ADAPTIVE_COMPOSITE
from cablebot_baselines.classical.allocation import allocate
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL

LAWS = {
    "CableBot-Planar-v0": FeedbackLinearization(PLANAR),
    "CableBot-Spatial-v0": FeedbackLinearization(SPATIAL),
    "CableBot-FlexPlanar-v0": Composite(FLEX_PLANAR, gains=(800.0, 30.0), spring_damping=0.5),
    "CableBot-FlexSpatial-v0": Composite(FLEX_SPATIAL),
}
SPATIAL_ID, FLEX_ID = "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"

NOISE = {"pose": (1e-4, 2e-4), "velocity": (2e-3, 4e-3), "motor_angle": (1e-3, 1e-3), "motor_speed": (1e-2, 1e-2)}
"""σ of white noise on the first three and the other components [m, rad, m/s, rad/s]."""


def noisy(observation, layout, rng):
    made = observation.copy()
    for block in layout.blocks:
        if block.name in NOISE:
            sigma = np.where(np.arange(block.size) < 3, *NOISE[block.name])
            made[:, block.slice] += sigma * rng.normal(size=(len(made), block.size))
    return made


def rollout(law, env, *, rng=None, steps=None):
    """Whether each episode kept 10 mm, 10 mrad and taut cables, and the estimates of the mass at every step."""
    observation, _ = env.reset(seed=0)
    count, layout = env.num_envs, observation_layout(law.robot)
    state, start, kept, estimates = None, np.ones(count, np.bool_), np.ones(count, np.bool_), []
    for _ in range(steps or env.unwrapped.tasks[0].steps - 1):
        seen = observation if rng is None else noisy(observation, layout, rng)
        action, state = law.predict(seen, state=state, episode_start=start)
        model_mass = law.robot.mass + observation[:, layout.slices()["model_payload"]][:, 0]
        estimates.append(law.mass(state, model_mass))
        observation, _, start, _, info = env.step(action)
        kept &= ~start & ~info["slack"].any(axis=1)
        kept &= (info["tracking_error_peak"] < 0.01) & (info["rotation_error_peak"] < 0.01)
    return kept, np.array(estimates)


# --- the estimate -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", LAWS)
def test_payload_is_not_misjudged_after_a_tenth_of_a_second(env_id):
    """What is left is the prior's share: 10 ms of 100 ms."""
    law, payload = LAWS[env_id], np.array([0.0, 0.4, 1.0])
    env = gym.make_vec(env_id, num_envs=3, payload=payload, payload_known=False)
    _, estimates = rollout(Adaptive(law, estimator_prior_weight=1e-4), env, steps=50)
    np.testing.assert_allclose(estimates[0], law.robot.mass)
    np.testing.assert_allclose(estimates[-1], law.robot.mass + payload, rtol=2e-3)


def test_prior_is_not_another_share_than_its_time():
    """Weighed for as long as the prior, the estimate lies half way between the model mass and the true mass."""
    env = gym.make_vec(SPATIAL_ID, num_envs=1, payload=2.0, payload_known=False)
    _, estimates = rollout(Adaptive(LAWS[SPATIAL_ID], estimator_prior_weight=0.05), env, steps=26)
    assert estimates[-1][0] == pytest.approx(11.0, abs=0.1)


def test_clipped_torque_is_not_taken_for_what_was_asked():
    """Motors of a quarter of the torque clip from the start; the mass that they move is judged right all the same."""
    weak = SPATIAL.replace(motors=type(SPATIAL.motors)(stall_torque=2.9, free_speed=20.0))
    env = gym.make_vec(SPATIAL_ID, num_envs=1, robot=weak, payload=1.5, payload_known=False, slack_time=1.0)
    law = Adaptive(FeedbackLinearization(weak), estimator_prior_weight=1e-4, allocation=False)
    observation, _ = env.reset(seed=0)
    state, beyond = None, 0.0
    for _ in range(60):
        action, state = law.predict(observation, state=state)
        beyond = max(beyond, np.abs(action).max())
        observation, *_ = env.step(action)
    assert beyond > 1.05
    assert law.mass(state, np.array([10.0]))[0] == pytest.approx(11.5, rel=5e-3)


def test_new_episode_does_not_inherit_an_estimate():
    law = Adaptive(LAWS[SPATIAL_ID])
    env = gym.make_vec(SPATIAL_ID, num_envs=2, payload=3.0, payload_known=False)
    observation, _ = env.reset(seed=0)
    state = None
    for _ in range(20):
        action, state = law.predict(observation, state=state, episode_start=np.zeros(2, np.bool_))
        observation, *_ = env.step(action)
    _, state = law.predict(observation, state=state, episode_start=np.array([True, False]))
    estimate = law.mass(state, np.array([10.0, 10.0]))
    assert estimate[0] == 10.0
    assert estimate[1] > 12.0


def test_estimate_does_not_move_once_the_clock_stands_still():
    law = Adaptive(LAWS[SPATIAL_ID])
    env = gym.make(SPATIAL_ID, payload=3.0, payload_known=False, max_episode_steps=-1)
    observation, _ = env.reset(seed=0)
    state = None
    for step in range(520):
        action, state = law.predict(observation, state=state, episode_start=np.array(step == 0))
        observation, *_ = env.step(action)
        if step == 501:
            before = law.mass(state, np.array(10.0))
    assert law.mass(state, np.array(10.0)) == before


@pytest.mark.parametrize("payload", [0.0, 3.0])
@pytest.mark.parametrize(("entry", "env_id"), [(ADAPTIVE, SPATIAL_ID), (ADAPTIVE_COMPOSITE, FLEX_ID)])
def test_sensor_noise_does_not_make_it_fail(entry, env_id, payload):
    law = entry.factory(LAWS[env_id].robot)
    env = gym.make_vec(env_id, num_envs=16, payload=payload, payload_known=False)
    kept, estimates = rollout(law, env, rng=np.random.default_rng(0))
    assert kept.all()
    np.testing.assert_allclose(estimates[-1], 10.0 + payload, atol=0.1)


def test_model_mass_that_is_wrong_is_not_believed():
    """A platform 10 % heavier than the law knows, payload known: fl leaves its error bounds, this law does not."""
    heavy = SPATIAL.replace(mass=11.0)
    env = gym.make_vec(SPATIAL_ID, num_envs=1, robot=heavy, payload=1.0)
    kept, estimates = rollout(ADAPTIVE.factory(SPATIAL), env)
    assert kept.all()
    assert estimates[-1][0] == pytest.approx(12.0, abs=0.1)


@pytest.mark.parametrize("estimator_prior_weight", [0.0, -1.0, np.nan, np.inf])
def test_prior_that_is_no_time_is_not_accepted(estimator_prior_weight):
    with pytest.raises(ValueError, match="estimator_prior_weight must be a time greater than 0 s"):
        Adaptive(LAWS[SPATIAL_ID], estimator_prior_weight=estimator_prior_weight)


# --- allocation -------------------------------------------------------------------------------------------------------


def test_allocation_is_not_another_than_the_bounded_least_squares():
    rng = np.random.default_rng(0)
    slope = rng.normal(size=(200, 6, 6)) + 2 * np.eye(6)
    command = rng.normal(size=(200, 6)) * rng.uniform(0.3, 3.0, size=(200, 1))
    found = allocate(command, slope)
    for wanted, g, given in zip(command, slope, found, strict=True):
        inverse = np.linalg.inv(g)
        expected = lsq_linear(inverse, inverse @ wanted, bounds=(-1, 1), tol=1e-14).x
        best = np.linalg.norm(inverse @ (expected - wanted))
        assert np.abs(given).max() <= 1.0
        assert np.linalg.norm(inverse @ (given - wanted)) == pytest.approx(best, rel=1e-6, abs=1e-9)


def test_command_within_reach_is_not_changed():
    rng = np.random.default_rng(1)
    command = rng.uniform(-1, 1, size=(5, 6))
    np.testing.assert_allclose(allocate(command, rng.normal(size=(5, 6, 6))), command, rtol=1e-12)


@pytest.mark.parametrize(
    "law", [FeedbackLinearization(SPATIAL), Composite(FLEX_SPATIAL)], ids=lambda law: type(law).__name__
)
def test_slope_is_not_another_than_the_torques_own(law):
    """∂τ/∂v by adding to the reference's acceleration, of which torques are an affine function."""
    env_id = FLEX_ID if law.robot.flexible else SPATIAL_ID
    observation, _ = gym.make(env_id, initial_error=np.array([0.02, 0.01, -0.02, 0.1, 0.1, -0.1])).reset(seed=0)
    layout = observation_layout(law.robot)
    blocks, mass = layout.split(observation), np.array(12.0)
    base = law.torques(blocks, mass)[0]
    columns = [
        law.torques({**blocks, "reference_acceleration": blocks["reference_acceleration"] + unit}, mass)[0] - base
        for unit in np.eye(6)
    ]
    np.testing.assert_allclose(law.torque_slope(mass, blocks["pose"]), np.transpose(columns), rtol=1e-8, atol=1e-10)


def test_law_that_clips_itself_does_not_declare_the_contrary():
    assert not ADAPTIVE.factory(SPATIAL).unsaturated_actions
    assert ADAPTIVE.factory(PLANAR).unsaturated_actions
    free = Adaptive(LAWS[SPATIAL_ID], allocation=False)
    assert free.unsaturated_actions
    observation, _ = gym.make(SPATIAL_ID, payload=15.0).reset(seed=0)
    assert np.abs(free.predict(observation)[0]).max() > 1.2
    assert np.abs(ADAPTIVE.factory(SPATIAL).predict(observation)[0]).max() == 1.0


# --- what it carries --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "env_id", "payload"),
    [(ADAPTIVE, "CableBot-Planar-v0", 1.93), (ADAPTIVE, SPATIAL_ID, 4.97), (ADAPTIVE_COMPOSITE, FLEX_ID, 5.45)],
)
def test_unknown_payload_is_not_less_than_was_reached(entry, env_id, payload):
    """With a known payload, fl carries 1.92 and 4.03 kg, and the best other law for joint springs 4.63 kg."""
    law = entry.factory(LAWS[env_id].robot)
    result = evaluate_dlcc(law, env_id, payload_known=False, resolution=0.01)
    assert result.payload == pytest.approx(payload, abs=0.05)


def test_sharing_out_is_not_without_effect():
    law = Adaptive(FeedbackLinearization(SPATIAL, gains=(400.0, 40.0)), allocation=False)
    assert evaluate_dlcc(law, SPATIAL_ID, resolution=0.01).payload == pytest.approx(4.03, abs=0.05)
