"""SB3's VecEnv over the compiled batch: SB3's own DummyVecEnv bit for bit, and all that SB3 asks of one."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorActionWrapper, VectorWrapper
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

import cablebot_gym
from cablebot_baselines.learned.vec_env import CableBotVecEnv, make_sb3_vec_env

PLANAR_ID = "CableBot-Planar-v0"
COUNT, LIMIT = 5, 7
SAME_STEP = AutoresetMode.SAME_STEP

each_id = pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)


def rugged(env_id):
    """Keywords under which random commands end some episodes early, the others at the time limit."""
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
    """Rugged, compiled."""
    return make_sb3_vec_env(env_id, count, **(rugged(env_id) | keywords))


def dummy(env_id=PLANAR_ID, count=COUNT, **keywords):
    """Rugged, SB3's own."""
    return DummyVecEnv([lambda: gym.make(env_id, **(rugged(env_id) | keywords))] * count)


def commands(env, steps, seed=0):
    """Random commands (steps, N, m), each held for some steps, some beyond ±1 and many that let cables go."""
    held = np.random.default_rng(seed).uniform(-1.0, 1.5, (steps // 4 + 1, env.num_envs, *env.action_space.shape))
    return np.repeat(held, 4, axis=0)[:steps]


def check_same_dict(one, other):
    """Two infos say the same, to the last bit and in the same types."""
    assert one.keys() == other.keys()
    for key, value in other.items():
        assert type(one[key]) is type(value), key
        assert getattr(one[key], "dtype", None) == getattr(value, "dtype", None), key
        np.testing.assert_array_equal(one[key], value, err_msg=key)


def check_same_arrays(one, other):
    assert one.dtype == other.dtype
    np.testing.assert_array_equal(one, other)


def check_same_run(env, twin, actions):
    """The same transitions, and the infos of both; how many episodes failed, and ended by the time limit."""
    failed = limited = 0
    for action in actions:
        one, other = env.step(action), twin.step(action)
        for mine, its in zip(one[:3], other[:3], strict=True):
            check_same_arrays(mine, its)
        for mine, its in zip(one[3], other[3], strict=True):
            check_same_dict(mine, its)
        for mine, its in zip(env.reset_infos, twin.reset_infos, strict=True):
            check_same_dict(mine, its)
        limit = np.array([info["TimeLimit.truncated"] for info in other[3]])
        failed, limited = failed + (other[2] & ~limit).sum(), limited + limit.sum()
    return failed, limited


# --------------------------------------------------------------------------------------------- against DummyVecEnv


@each_id
def test_every_transition_and_info_is_that_of_sb3s_own_vecenv_to_the_last_bit(env_id):
    env, twin = ours(env_id, info_keys=None), dummy(env_id)
    assert env.observation_space == twin.observation_space
    assert env.action_space == twin.action_space
    assert env.seed(7) == twin.seed(7)
    check_same_arrays(env.reset(), twin.reset())
    failed, limited = check_same_run(env, twin, commands(env, 40))
    assert failed > 0  # else the test says nothing about one of the two ends
    assert limited > 0
    check_same_arrays(env.reset(), twin.reset())  # the seeds counted once: the draws go on


@each_id
def test_short_infos_leave_the_transitions_as_they_are_and_tell_how_an_episode_ended(env_id):
    env, twin = ours(env_id, seed=7), ours(env_id, seed=7, info_keys=None)
    check_same_arrays(env.reset(), twin.reset())
    endings = set()
    for action in commands(env, 40):
        one, other = env.step(action), twin.step(action)
        for mine, its in zip(one[:3], other[:3], strict=True):
            check_same_arrays(mine, its)
        for done, mine, its in zip(one[2], one[3], other[3], strict=True):
            at_the_end = {"terminal_observation", "termination_reason", "payload"} if done else set()
            assert mine.keys() == {"TimeLimit.truncated"} | at_the_end
            check_same_dict(mine, {key: its[key] for key in mine})
            if done:
                assert mine["TimeLimit.truncated"] is (mine["termination_reason"] == "")
                endings.add(mine["termination_reason"])
    assert {"", "tracking_error"} <= endings
    assert env.reset_infos == [{}] * COUNT


def test_info_keys_come_at_each_step_from_the_episode_that_ended_and_not_from_the_next():
    env, twin = ours(seed=1, info_keys=("time", "slack")), dummy()
    twin.seed(1)
    env.reset()
    twin.reset()
    for action in commands(env, 20):
        _, _, dones, infos = env.step(action)
        for done, mine, its in zip(dones, infos, twin.step(action)[3], strict=True):
            assert {"time", "slack"} <= mine.keys()
            check_same_dict(mine, {key: its[key] for key in mine})
            assert mine["time"] > 0
            assert ("payload" in mine) == done


class Noted(gym.Wrapper[Any, Any, Any, Any]):
    """Infos whose keys are not the same at a reset, at a step and in each environment."""

    def reset(self, **keywords):
        observation, info = super().reset(**keywords)
        return observation, info | {"fresh": True}

    def step(self, action):
        *result, info = super().step(action)
        return (*result, info | {"since": info["time"]} | ({"far": 1} if info["tracking_error"] > 0.02 else {}))


def test_gymnasiums_own_vector_environments_give_the_same():
    """Their infos are marked for the environments that have them; what belongs to the next episode stays there."""
    singles = [lambda: Noted(gym.make(PLANAR_ID, **rugged(PLANAR_ID)))] * COUNT
    env = CableBotVecEnv(SyncVectorEnv(singles, autoreset_mode=SAME_STEP), info_keys=None)
    twin = DummyVecEnv(singles)
    env.seed(3)
    twin.seed(3)
    check_same_arrays(env.reset(), twin.reset())
    failed, limited = check_same_run(env, twin, commands(env, 40))
    assert failed > COUNT
    assert limited > 0


@pytest.mark.parametrize(("limit", "by_limit"), [(10, True), (11, False), (12, False)])
def test_an_episode_that_fails_at_its_last_step_was_not_cut_by_the_time_limit(limit, by_limit):
    """Else SB3 adds the value of a failed state to its reward."""
    keywords = {"control_frequency": 100.0, "slack_time": 0.1, "max_episode_steps": limit}
    env = make_sb3_vec_env(PLANAR_ID, 2, **keywords)
    env.reset()
    loose = np.full((2, 3), -0.5)
    ends = [env.step(loose) for _ in range(min(limit, 11))]
    assert not any(dones.any() for _, _, dones, _ in ends[:-1])
    _, _, dones, infos = ends[-1]
    assert dones.tolist() == [True, True]
    assert [info["TimeLimit.truncated"] for info in infos] == [by_limit] * 2


def test_results_are_the_callers_own():
    """VecNormalize and callbacks write into what they get."""
    env, twin = ours(seed=2), ours(seed=2)
    for one in (env, twin):
        one.reset()
    for action in commands(env, 16):
        results = env.step(action)
        check_same_arrays(results[0], twin.step(action)[0])
        for value in results[:3]:
            value[:] = 1
        for info in results[3]:
            info.clear()


# ------------------------------------------------------------------------------------------------- making and seeds


def test_seeds_are_those_of_sb3s_make_vec_env_and_reach_the_action_space():
    env = make_sb3_vec_env(PLANAR_ID, 3, seed=11, payload_range=(0, 9))
    twin = make_vec_env(PLANAR_ID, 3, seed=11, env_kwargs={"payload_range": (0, 9), "render_mode": None})
    check_same_arrays(env.reset(), twin.reset())
    assert env.get_attr("np_random_seed") == twin.get_attr("np_random_seed") == [11, 12, 13]
    check_same_arrays(env.action_space.sample(), twin.action_space.sample())


def test_payload_range_draws_a_payload_for_each_and_no_seed_draws_others():
    draws = []
    for _ in range(2):
        env = make_sb3_vec_env("CableBot-Spatial-v0", n_envs=64, payload_range=(0, 9), info_keys=("payload",))
        env.reset()
        draws += [info["payload"] for info in env.reset_infos]
    assert len(set(draws)) == 128
    assert 0 <= min(draws) < 1
    assert 8 < max(draws) <= 9


@pytest.mark.parametrize(("limit", "first_end"), [({}, 500), ({"max_episode_steps": 20}, 20)])
def test_the_time_limit_is_the_ids_or_ones_own(limit, first_end):
    env = make_sb3_vec_env(PLANAR_ID, trajectory="dwell-planar", **limit)
    env.reset()
    steps = [env.step(np.full((1, 3), 0.2))[2].item() for _ in range(first_end + 1)]
    assert np.flatnonzero(steps).tolist() == [first_end - 1]


def test_without_a_time_limit_episodes_go_on():
    env = make_sb3_vec_env(PLANAR_ID, trajectory="dwell-planar", max_episode_steps=None)
    env.reset()
    assert not any(env.step(np.full((1, 3), 0.2))[2].item() for _ in range(501))


# ---------------------------------------------------------------------------------------------------------- options


@pytest.mark.parametrize(
    "options",
    [
        {"payload": 1.5, "payload_known": False},
        [{"payload": 1.5}, {}, {"payload": 0.5, "trajectory": "line-planar"}, {}, {"payload": 1.5}],
        [{}, {}, {"payload": 2.0}, {}, {}],
        None,
    ],
    ids=["one for all", "one for each", "one of them", "none"],
)
def test_options_hold_for_one_episode_and_leave_the_draws_of_all_others(options):
    """A lane that is restarted once more than asked would draw other payloads from then on."""
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
        check_same_run(env, twin, commands(env, 12))


def test_one_dict_may_hold_a_value_for_each():
    env = ours(info_keys=("payload",))
    payloads = np.linspace(0, 4, COUNT)
    env.set_options({"payload": payloads})
    payloads[:] = 9.0
    env.reset()
    assert [info["payload"] for info in env.reset_infos] == [0.0, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([{"payload": 1.0}] * 2, "a list of 5 dicts, not of 2"),
        ({"reset_mask": np.ones(COUNT, bool)}, "all environments: remove reset_mask"),
        ([{}] * 4 + [{"reset_mask": np.ones(COUNT, bool)}], "remove reset_mask"),
    ],
)
def test_options_that_no_reset_can_take_are_refused_at_once(options, words):
    with pytest.raises(ValueError, match=words):
        ours().set_options(options)


def test_an_unknown_option_and_a_bad_seed_are_refused_by_the_reset_and_can_be_put_right():
    env, twin = ours(seed=4), ours(seed=4)
    env.set_options({"paylaod": 1.0})
    with pytest.raises(ValueError, match=r"paylaod.*payload_known"):
        env.reset()
    env.set_options()
    check_same_arrays(env.reset(), twin.reset())
    env.seed(-1)
    with pytest.raises(ValueError, match="seed must be at least 0"):
        env.reset()


# ------------------------------------------------------------------------------------------ attributes and methods


class Staged(VectorWrapper[Any, Any, Any, Any, Any]):
    """A wrapper with an attribute and methods of its own, as a curriculum has."""

    stage = 1
    notes: dict[str, Any] = {}  # noqa: RUF012 - the test needs an empty one

    def advance(self, by, *, twice=False):
        self.stage += by * (1 + twice)

    def weights(self):
        return np.arange(self.num_envs) * 0.5


class Counted(VectorWrapper[Any, Any, Any, Any, Any]):
    resets = 0

    def reset(self, **keywords):
        self.resets += 1
        return super().reset(**keywords)


class Halved(VectorActionWrapper[Any, Any, Any, Any]):
    def actions(self, actions):
        return 0.5 * actions


@each_id
def test_attributes_are_those_of_the_single_environments(env_id):
    uncertain = {"uncertainty": "table6"}
    env, twin = ours(env_id, **uncertain), dummy(env_id, **uncertain)
    for one in (env, twin):
        one.seed(1)
        one.reset()
        one.step(commands(one, 1)[0])
    for name in ("pose", "action_space", "observation_space", "render_mode", "np_random_seed"):
        np.testing.assert_equal(env.get_attr(name), twin.get_attr(name))
    for mine, its in zip(env.get_attr("truth"), twin.get_attr("truth"), strict=True):
        assert mine.keys() == its.keys()
        np.testing.assert_equal(mine, its)
    told, expected = (
        [task.model_payload for task in tasks] for tasks in (env.get_attr("tasks"), twin.get_attr("task"))
    )
    assert told == expected
    assert [spec.id for spec in env.get_attr("spec")] == [env_id] * COUNT
    assert env.get_attr("layout") == [env.env.unwrapped.layout] * COUNT
    np.testing.assert_equal(env.get_attr("pose", indices=[3, 1]), twin.get_attr("pose", indices=[3, 1]))
    assert len(env.get_attr("tasks", indices=2)) == 1


def test_environments_restart_together_unless_their_options_differ():
    """One by one, a thousand environments take most of a second."""
    env = CableBotVecEnv(Counted(ours().env))
    counts = []
    for options in (None, {"payload": 1.0}, [{"payload": 1.0}, {"payload": 2.0}, {}, {}, {}]):
        env.set_options(options)
        env.reset()
        env.reset()
        counts += env.get_attr("resets", indices=0)
    assert counts == [2, 4, 8]


def test_methods_and_attributes_are_found_in_wrappers_and_beneath_them():
    bare = gym.make_vec(PLANAR_ID, num_envs=3, autoreset_mode=SAME_STEP)
    env = CableBotVecEnv(Halved(Staged(bare)))
    assert env.env_method("weights") == [0.0, 0.5, 1.0]
    assert env.env_method("weights", indices=[2, 0, 1]) == [1.0, 0.0, 0.5]
    assert env.env_method("advance", 2, twice=True) == [None] * 3
    assert env.get_attr("stage") == [5] * 3
    assert env.get_attr("notes") == [{}] * 3
    assert env.has_attr("stage")
    assert env.has_attr("truth")
    assert not env.has_attr("paylaod")
    assert env.env_is_wrapped(Staged) == env.env_is_wrapped(Halved) == [True] * 3
    assert env.env_is_wrapped(Monitor, indices=0) == [False]


def test_a_wrappers_actions_reach_the_plant():
    plain, wrapped = ours(seed=0), CableBotVecEnv(Halved(ours().env))
    wrapped.seed(0)
    check_same_arrays(plain.reset(), wrapped.reset())
    for action in commands(plain, 12):
        check_same_arrays(plain.step(0.5 * action)[0], wrapped.step(action)[0])


@pytest.mark.parametrize("name", ["reset", "step", "close"])
def test_methods_that_would_move_all_environments_unseen_are_refused(name):
    with pytest.raises(NotImplementedError, match=rf"use {name}\(\) of the VecEnv"):
        ours().env_method(name)


def test_a_method_cannot_be_called_for_some():
    env = CableBotVecEnv(Staged(ours().env))
    with pytest.raises(NotImplementedError, match="'advance' acts on all environments at once: omit indices"):
        env.env_method("advance", 1, indices=[0, 1])
    assert env.get_attr("stage") == [1] * COUNT


def test_unknown_names_and_setting_are_refused_in_words():
    env = ours()
    with pytest.raises(AttributeError, match="paylaod"):
        env.get_attr("paylaod")
    with pytest.raises(AttributeError, match="paylaod"):
        env.env_method("paylaod")
    with pytest.raises(NotImplementedError, match=r"'payload' cannot be set.*set_options\(\)"):
        env.set_attr("payload", 3.0)


# -------------------------------------------------------------------------------------------------- with SB3's parts


def test_episodes_of_gymnasiums_statistics_reach_sb3():
    monitored = VecMonitor(ours(seed=3))
    recorded = CableBotVecEnv(RecordEpisodeStatistics(ours().env))
    recorded.seed(3)
    monitored.reset()
    recorded.reset()
    ends = 0
    for action in commands(monitored, 30):
        dones, theirs = monitored.step(action)[2:]
        for done, one, other in zip(dones, recorded.step(action)[3], theirs, strict=True):
            assert ("episode" in one) == done
            if done:
                ends += 1
                assert one["episode"]["l"] == other["episode"]["l"]
                assert one["episode"]["r"] == pytest.approx(other["episode"]["r"], abs=1e-5)
    assert ends > COUNT


def test_vec_monitor_writes_the_id_payloads_and_reasons(tmp_path):
    env = VecMonitor(ours(seed=0), str(tmp_path / "log"), info_keywords=("payload", "termination_reason"))
    env.reset()
    for action in commands(env, 20):
        env.step(action)
    env.close()
    header, columns, *rows = (tmp_path / "log.monitor.csv").read_text().splitlines()
    assert PLANAR_ID in header
    assert columns.split(",")[3:] == ["payload", "termination_reason"]
    assert len(rows) > COUNT
    assert any(row.endswith(",tracking_error") for row in rows)


def test_vec_normalize_scales_terminal_observations_as_it_does_for_sb3s_own():
    env, twin = VecNormalize(ours()), VecNormalize(dummy())
    for one in (env, twin):
        one.seed(2)
        one.reset()
    ends = 0
    for action in commands(env, 20):
        one, other = env.step(action), twin.step(action)
        for mine, its in zip(one[:3], other[:3], strict=True):
            check_same_arrays(mine, its)
        for mine, its in zip(one[3], other[3], strict=True):
            if "terminal_observation" in its:
                ends += 1
                check_same_arrays(mine["terminal_observation"], its["terminal_observation"])
    assert ends > COUNT


@pytest.fixture
def one_thread():
    """Small networks learn faster so, and to the same bits."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.usefixtures("one_thread")
def test_ppo_learns_the_same_on_the_batch_as_on_single_environments():
    """Bit for bit: what SB3 learns from is the same, and no warning is raised on the way."""
    weights = []
    for env in (ours(count=4), dummy(count=4)):
        model = PPO("MlpPolicy", VecMonitor(env), n_steps=32, batch_size=64, n_epochs=2, seed=0, device="cpu")
        before = [parameter.detach().clone() for parameter in model.policy.parameters()]
        model.learn(256)
        assert model.num_timesteps == 256
        assert len(model.ep_info_buffer) > 10
        after = [parameter.detach() for parameter in model.policy.parameters()]
        assert not any(torch.equal(one, other) for one, other in zip(before, after, strict=True))
        weights.append(after)
    assert all(torch.equal(one, other) for one, other in zip(*weights, strict=True))
    returns, lengths = evaluate_policy(model, VecMonitor(ours(count=2)), n_eval_episodes=4, return_episode_rewards=True)
    assert len(returns) == 4
    assert all(1 <= length <= LIMIT for length in lengths)


# --------------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_another_autoreset_mode_is_refused_with_the_one_that_does(mode):
    """SB3 would learn from steps that no action took, or wait for episodes that have ended."""
    env = gym.make_vec(PLANAR_ID, num_envs=2, autoreset_mode=mode)
    with pytest.raises(ValueError, match=f"has {mode.name}: use .*autoreset_mode=AutoresetMode.SAME_STEP"):
        CableBotVecEnv(env)


def test_a_single_environment_is_refused():
    with pytest.raises(TypeError, match=r"gym\.make_vec, not "):
        CableBotVecEnv(gym.make(PLANAR_ID))


def test_info_keys_that_are_a_string_or_unknown_are_refused():
    with pytest.raises(ValueError, match=r"\('payload',\), not the string 'payload'"):
        ours(info_keys="payload")
    env = ours(info_keys=("time", "paylaod"))
    env.reset()
    with pytest.raises(ValueError, match=r"'paylaod'; choose from .*payload.*torque_margin"):
        env.step(np.zeros((COUNT, 3)))


def test_bad_ids_numbers_and_keywords_are_refused_by_name():
    with pytest.raises(gym.error.Error, match="CableBot-Planar"):
        make_sb3_vec_env("CableBot-Planer-v0")
    with pytest.raises(ValueError, match="at least 1"):
        make_sb3_vec_env(PLANAR_ID, 0)
    with pytest.raises(ValueError, match=r"paylaod_range.*payload_range"):
        make_sb3_vec_env(PLANAR_ID, paylaod_range=(0, 1))
    with pytest.raises(ValueError, match=r"max_episode_steps .*at least 1"):
        make_sb3_vec_env(PLANAR_ID, max_episode_steps=0)


@pytest.mark.parametrize(
    ("action", "word"), [(np.zeros((COUNT - 1, 3)), "shape"), (np.full((COUNT, 3), np.nan), "finite")]
)
def test_bad_actions_are_refused_and_move_nothing(action, word):
    env, twin = ours(seed=1), ours(seed=1)
    env.reset()
    twin.reset()
    with pytest.raises(ValueError, match=word):
        env.step(action)
    with pytest.raises(RuntimeError, match=r"step_async\(actions\)"):
        env.step_wait()
    good = commands(env, 1)[0]
    check_same_arrays(env.step(good)[0], twin.step(good)[0])


def test_without_sb3_the_import_names_the_extra(monkeypatch):
    for module in [name for name in sys.modules if name.partition(".")[0] == "stable_baselines3"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "cablebot_baselines.learned.vec_env")
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[sb3\]'"):
        importlib.import_module("cablebot_baselines.learned.vec_env")
