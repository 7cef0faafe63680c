"""SB3's VecEnv over the compiled batch: it equals SB3's own DummyVecEnv bit for bit."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorActionWrapper, VectorWrapper
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import cablebot_gym

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from cablebot_baselines.learned.vec_env import CableBotVecEnv, make_sb3_vec_env

PLANAR_ID = "CableBot-Planar-v0"
COUNT, LIMIT = 5, 7

each_id = pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)


def failing(env_id):
    """Keywords with which random actions end some episodes early, the others at the time limit."""
    planar = "Planar" in env_id
    return {
        "max_episode_steps": LIMIT,
        "payload_range": (0.0, 3.0),
        "initial_error_range": [0.02, 0.02] if planar else [0.02, 0.02, 0.02, 0.05, 0.05, 0.05],
        "termination_radius": 0.03 if planar else 0.035,
        "control_frequency": 100.0,
        "slack_time": 0.03 if planar else 0.06,
    }


def ours(env_id=PLANAR_ID, count=COUNT, **keywords):
    return make_sb3_vec_env(env_id, count, **(failing(env_id) | keywords))


def dummy(env_id=PLANAR_ID, count=COUNT, **keywords):
    return DummyVecEnv([lambda: gym.make(env_id, **(failing(env_id) | keywords))] * count)


def random_actions(env, steps, seed=0):
    """Actions (steps, N, m), each constant for some steps, some beyond ±1 and many that slacken cables."""
    drawn = np.random.default_rng(seed).uniform(-1.0, 1.5, (steps // 4 + 1, env.num_envs, *env.action_space.shape))
    return np.repeat(drawn, 4, axis=0)[:steps]


def check_same_dict(one, other):
    assert one.keys() == other.keys()
    for key, value in other.items():
        assert type(one[key]) is type(value), key
        assert getattr(one[key], "dtype", None) == getattr(value, "dtype", None), key
        np.testing.assert_array_equal(one[key], value, err_msg=key)


def check_same_arrays(one, other):
    assert one.dtype == other.dtype
    np.testing.assert_array_equal(one, other)


def check_same_run(env, twin, actions):
    """Compares transitions and infos; returns how many episodes failed, and how many the time limit ended."""
    failed = limited = 0
    for action in actions:
        one, other = env.step(action), twin.step(action)
        for mine, its in zip(one[:3], other[:3], strict=True):
            check_same_arrays(mine, its)
        for mine, its in zip(one[3] + env.reset_infos, other[3] + twin.reset_infos, strict=True):
            check_same_dict(mine, its)
        limit = np.array([info["TimeLimit.truncated"] for info in other[3]])
        failed, limited = failed + (other[2] & ~limit).sum(), limited + limit.sum()
    return failed, limited


# --- against DummyVecEnv ----------------------------------------------------------------------------------------------


@each_id
def test_transitions_and_infos_equal_those_of_dummy_vec_env_bit_for_bit(env_id):
    env, twin = ours(env_id, info_keys=None), dummy(env_id)
    assert env.observation_space == twin.observation_space
    assert env.action_space == twin.action_space
    assert env.seed(7) == twin.seed(7)
    check_same_arrays(env.reset(), twin.reset())
    failed, limited = check_same_run(env, twin, random_actions(env, 40))
    assert failed > 0
    assert limited > 0
    check_same_arrays(env.reset(), twin.reset())  # the seeds applied once


def test_info_keys_select_the_info_of_the_episode_that_ended():
    """Ended episodes also have the final keys; the info of the next episode is in ``reset_infos`` only."""
    env, twin = ours(seed=1, info_keys=("time", "slack")), dummy()
    twin.seed(1)
    check_same_arrays(env.reset(), twin.reset())
    reasons = set()
    for action in random_actions(env, 40):
        one, other = env.step(action), twin.step(action)
        for mine, its in zip(one[:3], other[:3], strict=True):
            check_same_arrays(mine, its)
        for done, mine, its in zip(one[2], one[3], other[3], strict=True):
            final = {"terminal_observation", "termination_reason", "payload"} if done else set()
            assert mine.keys() == {"TimeLimit.truncated", "time", "slack"} | final
            check_same_dict(mine, {key: its[key] for key in mine})
            reasons |= {mine["termination_reason"]} if done else set()
    assert {"", "tracking_error"} <= reasons


@pytest.mark.parametrize(("limit", "by_limit"), [(10, True), (11, False), (12, False)])
def test_failure_at_the_last_step_is_not_a_truncation(limit, by_limit):
    """SB3 would add the value of a failed state to its reward."""
    env = make_sb3_vec_env(PLANAR_ID, 2, control_frequency=100.0, slack_time=0.1, max_episode_steps=limit)
    env.reset()
    ends = [env.step(np.full((2, 3), -0.5)) for _ in range(min(limit, 11))]
    assert not any(dones.any() for _, _, dones, _ in ends[:-1])
    _, _, dones, infos = ends[-1]
    assert dones.tolist() == [True, True]
    assert [info["TimeLimit.truncated"] for info in infos] == [by_limit] * 2


def test_results_may_be_overwritten_by_the_caller():
    """VecNormalize and callbacks write into what they get."""
    env, twin = ours(seed=2), ours(seed=2)
    for one in (env, twin):
        one.reset()
    for action in random_actions(env, 16):
        results = env.step(action)
        check_same_arrays(results[0], twin.step(action)[0])
        for value in results[:3]:
            value[:] = 1
        for info in results[3]:
            info.clear()


# --- seeds and options ------------------------------------------------------------------------------------------------


def test_seeds_equal_those_of_sb3s_make_vec_env():
    env = make_sb3_vec_env(PLANAR_ID, 3, seed=11, payload_range=(0, 9))
    twin = make_vec_env(PLANAR_ID, 3, seed=11, env_kwargs={"payload_range": (0, 9), "render_mode": None})
    check_same_arrays(env.reset(), twin.reset())
    assert env.get_attr("np_random_seed") == twin.get_attr("np_random_seed") == [11, 12, 13]
    check_same_arrays(env.action_space.sample(), twin.action_space.sample())


def test_default_time_limit_is_that_of_the_id():
    env = make_sb3_vec_env(PLANAR_ID, trajectory="dwell-planar")
    env.reset()
    dones = [env.step(np.full((1, 3), 0.2))[2].item() for _ in range(501)]
    assert np.flatnonzero(dones).tolist() == [499]


@pytest.mark.parametrize("options", [{"payload": 1.5, "payload_known": False}, None])
def test_options_apply_to_one_episode_and_leave_the_draws_unchanged(options):
    env, twin = ours(info_keys=None), dummy()
    for first in (True, False):
        for one in (env, twin):
            if first:
                one.seed(5)
            one.set_options(options)
        for _ in range(2):
            check_same_arrays(env.reset(), twin.reset())
            for mine, its in zip(env.reset_infos, twin.reset_infos, strict=True):
                check_same_dict(mine, its)
        check_same_run(env, twin, random_actions(env, 12))


def test_option_may_have_one_value_per_environment():
    env = ours(info_keys=("payload",))
    env.set_options({"payload": np.arange(5.0)})
    env.reset()
    assert [info["payload"] for info in env.reset_infos] == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_invalid_options_and_seeds_raise_and_can_be_corrected():
    for options in ([{"payload": 1.0}] * COUNT, {"reset_mask": np.ones(COUNT, bool)}):
        with pytest.raises(ValueError, match="one dict without reset_mask"):
            ours().set_options(options)
    env, twin = ours(seed=4), ours(seed=4)
    env.set_options({"paylaod": 1.0})
    with pytest.raises(ValueError, match="paylaod"):
        env.reset()
    env.set_options()
    check_same_arrays(env.reset(), twin.reset())
    env.seed(-1)
    with pytest.raises(ValueError, match="seed"):
        env.reset()


# --- attributes and wrappers ------------------------------------------------------------------------------------------


class Staged(VectorWrapper[Any, Any, Any, Any, Any]):
    """A wrapper with an attribute of its own."""

    stage = 1


class Halved(VectorActionWrapper[Any, Any, Any, Any]):
    def actions(self, actions):
        return 0.5 * actions


@pytest.mark.parametrize("env_id", [PLANAR_ID, "CableBot-FlexSpatial-v0"])
def test_attributes_equal_those_of_the_single_environments(env_id):
    env, twin = (make(env_id, uncertainty="table6") for make in (ours, dummy))
    for one in (env, twin):
        one.seed(1)
        one.reset()
        one.step(random_actions(one, 1)[0])
    for name in ("pose", "action_space", "observation_space", "render_mode", "np_random_seed"):
        np.testing.assert_equal(env.get_attr(name), twin.get_attr(name))
    tasks = zip(env.get_attr("tasks"), twin.get_attr("task"), strict=True)
    assert all(mine.model_payload == its.model_payload for mine, its in tasks)
    assert [spec.id for spec in env.get_attr("spec")] == [env_id] * COUNT
    np.testing.assert_equal(env.get_attr("pose", indices=[3, 1]), twin.get_attr("pose", indices=[3, 1]))
    with pytest.raises(AttributeError, match="paylaod"):
        env.get_attr("paylaod")
    with pytest.raises(NotImplementedError, match=r"set_options\(\)"):
        env.set_attr("payload", 3.0)
    with pytest.raises(NotImplementedError, match="vector environment"):
        env.env_method("reset")


def test_wrappers_of_the_batch_take_effect():
    plain, wrapped = ours(seed=0), CableBotVecEnv(Halved(Staged(ours().env)))
    wrapped.seed(0)
    check_same_arrays(plain.reset(), wrapped.reset())
    for action in random_actions(plain, 12):
        check_same_arrays(plain.step(0.5 * action)[0], wrapped.step(action)[0])
    assert wrapped.get_attr("stage") == [1] * COUNT
    assert wrapped.has_attr("truth")
    assert wrapped.env_is_wrapped(Staged) == wrapped.env_is_wrapped(Halved) == [True] * COUNT
    assert wrapped.env_is_wrapped(Monitor, indices=0) == [False]


def test_episode_statistics_of_gymnasium_equal_those_of_vec_monitor(tmp_path):
    keywords = ("payload", "termination_reason")
    monitored = VecMonitor(ours(seed=3), str(tmp_path / "log"), info_keywords=keywords)
    recorded = CableBotVecEnv(RecordEpisodeStatistics(ours().env))
    recorded.seed(3)
    monitored.reset()
    recorded.reset()
    ends = 0
    for action in random_actions(monitored, 30):
        dones, theirs = monitored.step(action)[2:]
        for done, one, other in zip(dones, recorded.step(action)[3], theirs, strict=True):
            assert ("episode" in one) == done
            if done:
                ends += 1
                assert one["episode"]["l"] == other["episode"]["l"]
                assert one["episode"]["r"] == pytest.approx(other["episode"]["r"], abs=1e-5)
    assert ends > COUNT
    monitored.close()
    header, columns, *rows = (tmp_path / "log.monitor.csv").read_text().splitlines()
    assert PLANAR_ID in header
    assert columns.split(",")[3:] == list(keywords)
    assert len(rows) == ends


# --- invalid input ----------------------------------------------------------------------------------------------------


def test_other_environments_and_autoreset_modes_raise():
    with pytest.raises(TypeError, match=r"gym\.make_vec, not "):
        CableBotVecEnv(gym.make(PLANAR_ID))
    for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
        with pytest.raises(ValueError, match="DISABLED"):
            CableBotVecEnv(gym.make_vec(PLANAR_ID, num_envs=2, autoreset_mode=mode))


def test_unknown_info_key_raises():
    env = ours(info_keys=("time", "paylaod"))
    env.reset()
    with pytest.raises(ValueError, match=r"'paylaod'.*payload"):
        env.step(np.zeros((COUNT, 3)))


def test_import_without_sb3_names_the_extra(monkeypatch):
    for module in [name for name in sys.modules if name.partition(".")[0] == "stable_baselines3"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "cablebot_baselines.learned.vec_env")
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[sb3\]'"):
        importlib.import_module("cablebot_baselines.learned.vec_env")
