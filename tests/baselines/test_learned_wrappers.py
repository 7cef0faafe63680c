"""Wrappers for training: payload curriculum and steered law."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorWrapper
from numpy.testing import assert_array_equal
from steering import network_of

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.wrappers import PayloadCurriculum, Steered

PLANAR_ID = "CableBot-Planar-v0"
FLEX_ID = "CableBot-FlexSpatial-v0"

OBSERVED = (
    "pose",
    "velocity",
    "error",
    "actions",
    "time_since_start",
    "time_to_go_decays",
    "model_payload",
)

# Under random actions some episodes fail, others last until a time limit that falls within an
# action.
CASES: dict[str, dict[str, Any]] = {
    PLANAR_ID: {
        "base": "fl",
        "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.5},
    },
    FLEX_ID: {
        "base": "composite",
        "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.3, "degree": 5},
    },
}
each_case = pytest.mark.parametrize("env_id", list(CASES))


def make(env_id, count=1, **keywords):
    return gym.make_vec(env_id, num_envs=count, autoreset_mode=AutoresetMode.DISABLED, **keywords)


def steered(env_id, count=1, **keywords):
    env = make(env_id, count, terminate_on_violation=True, **keywords)
    return Steered(PayloadCurriculum(env, heaviest=4.0), features=OBSERVED, **CASES[env_id])


def check_row(results, env_index, single_results):
    """A row of a batch's results, the info last, equals those of a batch of one."""
    for value, single_value in zip(results[:-1], single_results[:-1], strict=True):
        assert_array_equal(value[env_index], single_value[0])
    for key, value in single_results[-1].items():
        assert_array_equal(results[-1][key][env_index], value[0], err_msg=key)


@pytest.mark.parametrize("env_id", [PLANAR_ID, pytest.param(FLEX_ID, marks=pytest.mark.landing)])
def test_row_of_a_batch_equals_a_batch_of_one(env_id):
    """Over several episodes, with masked resets and ends within an action."""
    count = 3
    seed = 3
    env = steered(env_id, count, max_episode_steps=56)
    singles = [steered(env_id, max_episode_steps=56) for _ in range(count)]
    started = env.reset(seed=seed)
    for env_index, single in enumerate(singles):
        check_row(started, env_index, single.reset(seed=seed + env_index))
    failures = limits = ends_within_an_action = 0
    draw = np.random.default_rng(0)
    for _ in range(30):
        action = draw.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        results = env.step(action)
        ended = results[2] | results[3]
        for env_index, single in enumerate(singles):
            check_row(results, env_index, single.step(action[env_index : env_index + 1]))
        failures += results[2].sum()
        limits += (ended & ~results[2]).sum()
        periods = np.round(results[-1]["time"] / env.unwrapped.settings.period)
        ends_within_an_action += (periods[ended] % env.steering.periods != 0).sum()
        if ended.any():
            started = env.reset(options={"reset_mask": ended})
            for env_index in np.flatnonzero(ended):
                check_row(started, env_index, singles[env_index].reset())
    assert min(failures, limits, ends_within_an_action) > 0
    assert failures + limits > 2 * count


def test_payloads_follow_the_power_law():
    """At power 1 they equal the environment's own uniform draws."""
    linear = PayloadCurriculum(make(PLANAR_ID, 20), heaviest=3.0, power=1.0)
    heavy = PayloadCurriculum(make(PLANAR_ID, 20), heaviest=3.0)
    payload = make(PLANAR_ID, 20, payload_range=(0.0, 3.0)).reset(seed=4)[1]["payload"]
    assert_array_equal(linear.reset(seed=4)[1]["payload"], payload)
    expected = 3.0 * (payload / 3.0) ** 0.6
    assert heavy.reset(seed=4)[1]["payload"] == pytest.approx(expected, rel=1e-12)


def test_rejected_resets_leave_the_draws_unchanged():
    env, twin = (PayloadCurriculum(make(PLANAR_ID), heaviest=2.0) for _ in range(2))
    assert env.reset(seed=0, options={"payload": 0.25})[1]["payload"] == 0.25
    twin.reset(seed=0)
    for bad in ({"seed": -1}, {"options": {"paylaod": 1.0}}):
        with pytest.raises(ValueError, match=r"seed|paylaod"):
            env.reset(**bad)
    assert env.reset()[1]["payload"] == twin.reset()[1]["payload"]


class Ended(VectorWrapper):
    """Ends each episode after one step."""

    succeeds = True

    def step(self, actions):
        observation, reward, _, _, info = super().step(actions)
        violated = np.full(self.num_envs, not self.succeeds)
        return (
            observation,
            reward,
            ~violated & violated,
            violated | True,
            info | {"violated": violated},
        )


@pytest.fixture
def curriculum():
    """A curriculum; ``play(succeeds)`` plays an episode with a heavy or a light payload and returns
    the ceiling."""
    ended = Ended(make(PLANAR_ID))
    settings = {"start": 1.0, "step": 0.25, "success": 0.75, "window": 4, "setback": 0.5}
    env = PayloadCurriculum(ended, heaviest=2.0, **settings)
    env.reset(seed=0)
    actions = np.full((1, 3), 0.2)

    def play(succeeds, is_heavy=True):
        ended.succeeds = succeeds
        payload = env.reset()[1]["payload"].item()
        while (payload >= 2 / 3 * env.ceiling) is not is_heavy:
            payload = env.reset()[1]["payload"].item()
        assert env.step(actions)[4]["is_success"].tolist() == [succeeds]
        env.step(actions)
        return env.ceiling

    return env, play


def test_only_drawn_heavy_payloads_count(curriculum):
    """Abandoned episodes and steps after the end do not count either."""
    env, play = curriculum
    for _ in range(8):
        assert play(True, is_heavy=False) == 1.0
        env.reset(options={"payload": env.ceiling})
        env.step(np.full((1, 3), 0.2))
        assert env.ceiling == 1.0


def test_ceiling_follows_the_fraction_of_successes(curriculum):
    _, play = curriculum
    for succeeds in (True, True, False, False, True, True):
        assert play(succeeds) == 1.0
    assert play(True) == 1.5  # three of the last four
    assert [play(True) for _ in range(4)] == [1.5, 1.5, 1.5, 2.0]
    assert [play(True) for _ in range(8)] == [2.0] * 8  # the heaviest
    for succeeds in (True, True, False, False):
        assert play(succeeds) == 2.0
    assert play(False) == 1.5
    assert [play(False) for _ in range(8)] == [1.5] * 3 + [1.0] * 5


class SinglePrecision(Network):
    """Rounds its inputs to single precision, as a learner does."""

    def __call__(self, values):
        return super().__call__(np.asarray(values, np.float32).astype(float))


@each_case
def test_policy_on_the_plain_environment_repeats_training(env_id):
    env = steered(env_id)
    steering = env.steering
    network = SinglePrecision(**vars(network_of(steering, scale=0.02)))
    bundle = Bundle.of_steering(env_id, steering, network)
    plain = gym.make(env_id)
    policy = LearnedPolicy(bundle, plain.unwrapped.settings.robot)
    start = {"seed": 0, "options": {"payload": 0.4}}
    observed, _ = env.reset(**start)
    observation, _ = plain.reset(**start)
    policy.reset([plain.unwrapped.task])
    state = None
    for _ in range(6):
        observed, total, terminated, _, info = env.step(network(observed))
        assert not terminated
        rewards = []
        for _ in range(steering.periods):
            action, state = policy.predict(observation, state)
            observation, reward, _, _, plain_info = plain.step(action)
            rewards.append(reward)
        assert total.item() == pytest.approx(sum(rewards))
        assert_array_equal(env.unwrapped.pose[0], plain.unwrapped.pose)
        for name in ("commanded_action", "tensions", "time"):
            assert_array_equal(info[name][0], plain_info[name], err_msg=name)
