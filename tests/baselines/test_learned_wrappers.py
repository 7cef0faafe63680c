"""Wrappers for training: payload curriculum and steered law, single and in batches."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_array_equal, assert_equal
from stable_baselines3.common import env_checker
from steering import network_of

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.wrappers import PayloadCurriculum, Steered, make_steered_vec

PLANAR_ID = "CableBot-Planar-v0"
SPATIAL_ID = "CableBot-Spatial-v0"
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
    "shift": {
        "env_id": PLANAR_ID,
        "steered": {
            "base": "fl",
            "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.5},
            "features": OBSERVED,
        },
    },
    "springs": {
        "env_id": FLEX_ID,
        "steered": {
            "base": "composite",
            "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.3, "degree": 5},
            "features": OBSERVED,
        },
    },
}
each_case = pytest.mark.parametrize("case", list(CASES))


def wrappers_of(case):
    """Classes and arguments of both wrappers."""
    return [(PayloadCurriculum, {"heaviest": 4.0}), (Steered, CASES[case]["steered"])]


def single(case, **keywords):
    env = gym.make(CASES[case]["env_id"], terminate_on_violation=True, **keywords)
    for wrapper, arguments in wrappers_of(case):
        env = wrapper(env, **arguments)
    return env


def batch(case, count, **keywords):
    keywords = {"terminate_on_violation": True, "wrappers": wrappers_of(case), **keywords}
    return make_steered_vec(CASES[case]["env_id"], count, **keywords)


def check_same_row(results, env_index, single_results):
    """The row of a batch's results, the info last, equals the single environment's; its scalars are
    Python objects."""
    for value, single_value in zip(results[:-1], single_results[:-1], strict=True):
        assert_array_equal(value[env_index], single_value)
        assert value.dtype == np.asarray(single_value).dtype
    info = results[-1]
    single_info = single_results[-1]
    assert info.keys() == single_info.keys()
    for key, value in single_info.items():
        assert isinstance(value, (float, bool, int, np.ndarray))
        assert_array_equal(info[key][env_index], value, err_msg=key)


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version:UserWarning")
@pytest.mark.filterwarnings(
    "ignore:.*A Box observation space m.*imum value is -?infinity:UserWarning"
)
def test_single_form_passes_the_checkers_of_gymnasium_and_sb3():
    env = single("shift")
    check_env(env)
    env_checker.check_env(env, warn=True)
    assert env.observation_space.dtype == env.action_space.dtype == np.float32


@pytest.mark.landing
@each_case
def test_row_of_a_batch_equals_the_single_environment(case):
    """Over several episodes, with masked resets and ends within an action."""
    count = 5
    seed = 3
    limit = {"max_episode_steps": 56}
    env = batch(case, count, **limit)
    singles = [single(case, **limit) for _ in range(count)]
    started = env.reset(seed=seed)
    for env_index, single_env in enumerate(singles):
        check_same_row(started, env_index, single_env.reset(seed=seed + env_index))
    failures = limits = ends_within_an_action = 0
    for action in (
        np.random.default_rng(0).uniform(-1, 1, (30, *env.action_space.shape)).astype(np.float32)
    ):
        results = env.step(action)
        ended = results[2] | results[3]
        for env_index, single_env in enumerate(singles):
            single_results = single_env.step(action[env_index])
            check_same_row(results, env_index, single_results)
            if ended[env_index]:
                info = single_results[-1]
                failures += bool(info["termination_reason"])
                limits += not info["termination_reason"]
                periods = round(info["time"] / env.unwrapped.settings.period)
                ends_within_an_action += periods % env.steering.periods != 0
        if ended.any():
            started = env.reset(options={"reset_mask": ended})
            for env_index in np.flatnonzero(ended):
                check_same_row(started, env_index, singles[env_index].reset())
    assert min(failures, limits, ends_within_an_action) > 0
    assert failures + limits > 2 * count


class Recorder(gym.Wrapper):
    """Keeps the result of every control period."""

    def __init__(self, env):
        super().__init__(env)
        self.results = []

    def step(self, action):
        self.results.append(super().step(action))
        return self.results[-1]


def test_ended_episode_has_the_result_of_its_last_period():
    """The episode ends within an action; the reward is the sum up to the end."""
    inside = Recorder(gym.make(SPATIAL_ID, terminate_on_violation=True, payload=30.0))
    env = Steered(inside, base="fl", steering="shift", features=("pose",))
    env.reset(seed=0)
    has_ended = False
    total = 0.0
    while not has_ended:
        observed, reward, has_ended, _, info = env.step(np.zeros(6))
        total += reward
    assert [result[2] for result in inside.results].index(True) == len(inside.results) - 1
    observation, *_, last_info = inside.results[-1]
    assert total == pytest.approx(sum(result[1] for result in inside.results))
    assert_equal(info, last_info)
    assert_array_equal(observed, observation[:6].astype(np.float32))
    assert round(info["time"] * 500) % env.steering.periods != 0


def test_payloads_follow_the_power_law():
    """At power 1 they equal the environment's own uniform draws."""
    linear = PayloadCurriculum(gym.make(PLANAR_ID), heaviest=3.0, power=1.0)
    plain = gym.make(PLANAR_ID, payload_range=(0.0, 3.0))
    heavy = PayloadCurriculum(gym.make(PLANAR_ID), heaviest=3.0)
    for seed in range(20):
        payload = plain.reset(seed=seed)[1]["payload"]
        assert linear.reset(seed=seed)[1]["payload"] == payload
        expected = 3.0 * (payload / 3.0) ** 0.6
        assert heavy.reset(seed=seed)[1]["payload"] == pytest.approx(expected, rel=1e-12)


def test_rejected_resets_leave_the_draws_unchanged():
    env, twin = (PayloadCurriculum(gym.make(PLANAR_ID), heaviest=2.0) for _ in range(2))
    assert env.reset(seed=0, options={"payload": 0.25})[1]["payload"] == 0.25
    twin.reset(seed=0)
    for bad in ({"seed": -1}, {"options": {"paylaod": 1.0}}):
        with pytest.raises(ValueError, match=r"seed|paylaod"):
            env.reset(**bad)
    assert env.reset()[1]["payload"] == twin.reset()[1]["payload"]


class Ended(gym.Wrapper[Any, Any, Any, Any]):
    """Ends each episode after one step."""

    succeeds = True

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        return observation, reward, False, True, info | {"violated": not self.succeeds}


@pytest.fixture
def curriculum():
    """A curriculum; ``play(succeeds)`` plays an episode with a heavy or a light payload and returns
    the ceiling."""
    ended = Ended(gym.make(PLANAR_ID))
    settings = {"start": 1.0, "step": 0.25, "success": 0.75, "window": 4, "setback": 0.5}
    env = PayloadCurriculum(ended, heaviest=2.0, **settings)
    env.reset(seed=0)

    def play(succeeds, is_heavy=True):
        ended.succeeds = succeeds
        payload = env.reset()[1]["payload"]
        while (payload >= 2 / 3 * env.ceiling) is not is_heavy:
            payload = env.reset()[1]["payload"]
        assert env.step(np.full(3, 0.2))[4]["is_success"] is succeeds
        env.step(np.full(3, 0.2))
        return env.ceiling

    return env, play


def test_only_drawn_heavy_payloads_count(curriculum):
    """Abandoned episodes and steps after the end do not count either."""
    env, play = curriculum
    for _ in range(8):
        assert play(True, is_heavy=False) == 1.0
        env.reset(options={"payload": env.ceiling})
        env.step(np.full(3, 0.2))
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


def test_environments_of_a_batch_share_a_ceiling():
    curriculum = {"heaviest": 2.0, "start": 0.4, "step": 0.02, "window": 8, "power": 0.01}
    wrappers = [(PayloadCurriculum, curriculum), (Steered, CASES["shift"]["steered"])]
    env = make_steered_vec(PLANAR_ID, 16, wrappers=wrappers, seed=0, max_episode_steps=45)
    for _ in range(10):
        _, _, terminated, truncated, _ = env.step(np.zeros((16, 2)))
        if (terminated | truncated).any():
            env.reset(options={"reset_mask": terminated | truncated})
    assert env.env.ceiling == pytest.approx(0.4 + 4 * 0.04)  # of 32 episodes in windows of 8


class SinglePrecision(Network):
    """Rounds its inputs to single precision, as a learner does."""

    def __call__(self, values):
        return super().__call__(np.asarray(values, np.float32).astype(float))


@each_case
def test_policy_on_the_plain_environment_repeats_training(case):
    env = single(case)
    steering = env.steering
    env_id = CASES[case]["env_id"]
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
        observed, _, terminated, _, info = env.step(network(observed))
        assert not terminated
        for _ in range(steering.periods):
            action, state = policy.predict(observation, state)
            observation, _, _, _, plain_info = plain.step(action)
        assert_array_equal(env.unwrapped.pose, plain.unwrapped.pose)
        for name in ("commanded_action", "tensions", "time"):
            assert_array_equal(info[name], plain_info[name], err_msg=name)


def test_seed_of_a_batch_repeats_its_draws():
    def draws(seed):
        env = batch("shift", 3, seed=seed)
        return [*env.reset()[1]["payload"], *env.action_space.sample().ravel()]

    assert draws(3) == draws(3)
    assert not set(draws(3)) & set(draws(9))
