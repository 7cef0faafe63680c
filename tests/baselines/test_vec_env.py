"""SB3's VecEnv over the compiled batch: it equals SB3's own DummyVecEnv bit for bit."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal, assert_equal
from oracles.episodes import check_equal
from stable_baselines3.common.vec_env import DummyVecEnv

from cablebot_baselines.learned.vec_env import make_sb3_vec_env
from cablebot_gym.envs import PAPER_ENV_IDS

PLANAR_ID = "CableBot-Planar-v0"
COUNT = 5
LIMIT = 7


def failing(env_id):
    """Keywords with which random actions end some episodes early, the others at the time limit."""
    planar = "Planar" in env_id
    return {
        "max_episode_steps": LIMIT,
        "payload_range": (0.0, 3.0),
        "initial_error_range": [0.067] * 2 if planar else [0.057] * 3 + [0.05] * 3,
        "control_frequency": 100.0,
    }


def ours(env_id=PLANAR_ID, **keywords):
    return make_sb3_vec_env(env_id, COUNT, **(failing(env_id) | keywords))


def dummy(env_id=PLANAR_ID, **keywords):
    return DummyVecEnv([lambda: gym.make(env_id, **(failing(env_id) | keywords))] * COUNT)


def random_actions(env, steps):
    """Actions (steps, N, m), each constant for some steps, some beyond ±1 and many that slacken
    cables."""
    drawn = np.random.default_rng(0).uniform(
        -1.0, 1.5, (steps // 4 + 1, env.num_envs, *env.action_space.shape)
    )
    return np.repeat(drawn, 4, axis=0)[:steps]


def check_same_run(env, twin, actions):
    """Compares transitions, and the infos of ended and started episodes; returns how many episodes
    failed, and how many the time limit ended."""
    failed = limited = 0
    for action in actions:
        *results, infos = env.step(action)
        *expected, expected_infos = twin.step(action)
        for result, expected_result in zip(results, expected, strict=True):
            assert_array_equal(result, expected_result, strict=True)
        for done, info, expected_info in zip(results[2], infos, expected_infos, strict=True):
            is_limit = expected_info["TimeLimit.truncated"]
            check_equal(info, expected_info if done else {"TimeLimit.truncated": is_limit})
            failed += done and not is_limit
            limited += is_limit
        check_reset_infos(env, twin)
    return failed, limited


def check_reset_infos(env, twin):
    check_equal(tuple(env.reset_infos), tuple(twin.reset_infos))


@pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
def test_transitions_equal_those_of_dummy_vec_env(env_id):
    env = ours(env_id)
    twin = dummy(env_id)
    assert env.observation_space == twin.observation_space
    assert env.action_space == twin.action_space
    assert env.seed(7) == twin.seed(7)
    assert_array_equal(env.reset(), twin.reset())
    failed, limited = check_same_run(env, twin, random_actions(env, 40))
    assert failed > 0
    assert limited > 0
    assert_array_equal(env.reset(), twin.reset())  # the seeds applied once
    for name in ("pose", "action_space", "render_mode"):
        assert_equal(env.get_attr(name, indices=[3, 1]), twin.get_attr(name, indices=[3, 1]))


def test_results_may_be_overwritten_by_the_caller():
    """VecNormalize and callbacks write into what they get."""
    env = ours(seed=2)
    twin = ours(seed=2)
    env.reset(), twin.reset()
    assert_array_equal(env.action_space.sample(), twin.action_space.sample())
    for action in random_actions(env, 16):
        *results, infos = env.step(action)
        assert_array_equal(results[0], twin.step(action)[0])
        for value in (*results, *(info.get("terminal_observation", np.zeros(1)) for info in infos)):
            value[:] = 1


def test_options_apply_to_one_episode():
    env = ours()
    twin = dummy()
    for vec_env in (env, twin):
        vec_env.seed(5)
        vec_env.set_options({"payload": 1.5, "payload_known": False})
    for _ in range(2):
        assert_array_equal(env.reset(), twin.reset())
        check_reset_infos(env, twin)
    check_same_run(env, twin, random_actions(env, 12))
    env.set_options({"payload": np.arange(5.0)})
    env.reset()
    assert [info["payload"] for info in env.reset_infos] == [0.0, 1.0, 2.0, 3.0, 4.0]
