"""The vector environment against single ones, bit by bit, in every autoreset mode."""

from __future__ import annotations

import pickle
import random
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from cablebot_gym.envs import PAPER_ENV_IDS, TERMINATION_REASONS
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.utils.threads import call_all

ROBOTS = {"CableBot-Planar-v0": PLANAR, "CableBot-Spatial-v0": SPATIAL}
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]

# Start errors close to a tight radius: under random actions some episodes end early, the others at the time limit.
LIMIT = 7
RUGGED: dict[str, dict[str, Any]] = {
    "CableBot-Planar-v0": {
        "payload_range": (0.0, 2.0),
        "initial_error_range": [0.02, 0.02],
        "termination_radius": 0.03,
        "control_frequency": 100.0,
        "slack_time": 0.03,
    },
    "CableBot-Spatial-v0": {
        "payload_range": (0.0, 3.0),
        "payload_known": False,
        "initial_error_range": [0.02, 0.02, 0.02, 0.05, 0.05, 0.05],
        "termination_radius": 0.035,
        "control_frequency": 100.0,
        "slack_time": 0.06,
    },
}

each_id = pytest.mark.parametrize("env_id", list(ROBOTS))
each_mode = pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)


def make(env_id="CableBot-Planar-v0", count=3, **keywords) -> Any:
    """Our vector environment."""
    return gym.make_vec(env_id, num_envs=count, **keywords).unwrapped


def random_actions(env_id, count, steps, seed=0):
    """Random actions, each held for some steps: some beyond ±1, and many that slacken cables."""
    rng = np.random.default_rng(seed)
    held = rng.uniform(-1.0, 1.5, (steps // 4 + 1, count, ROBOTS[env_id].cables))
    return np.repeat(held, 4, axis=0)[:steps]


def check_same_info(ours, theirs):
    """Gymnasium marks in ``_key`` the environments with a valid value; these values are equal bit for bit."""
    assert {key for key in ours if not key.startswith("_")} == {key for key in theirs if not key.startswith("_")}
    for key, mask in theirs.items():
        if not key.startswith("_"):
            continue
        env_indices, name = np.flatnonzero(mask), key[1:]
        if name in ("final_obs", "final_info"):
            np.testing.assert_array_equal(ours[key], mask)
        if name == "final_info":
            check_same_info(ours[name], theirs[name])
            continue
        one, other = (np.array([values[name][env_index] for env_index in env_indices]) for values in (ours, theirs))
        np.testing.assert_array_equal(one, other, err_msg=f"{name} of env_indices {env_indices}")


def check_same(ours, theirs):
    """Observations, rewards, flags and infos of two steps, or observations and infos of two resets."""
    for one, other in zip(ours[:-1], theirs[:-1], strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    check_same_info(ours[-1], theirs[-1])


# ------------------------------------------------------------------------------------- against single environments


def check_run(ours, theirs, actions):
    """Compares the runs; the reasons of their ends, and the numbers of restarts and of time limits."""
    mode = ours.metadata["autoreset_mode"]
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    check_same(ours.reset(seed=7), theirs.reset(seed=7))
    reasons, restarts, truncations = set(), 0, 0
    for action in actions:
        one, other = ours.step(action), theirs.step(action)
        check_same(one, other)
        terminated, truncated, info = one[2], one[3], one[4]
        ended = terminated | truncated
        last = info.get("final_info", info)
        assert np.array_equal(last["termination_reason"] != 0, terminated)
        reasons |= {TERMINATION_REASONS[code] for code in last["termination_reason"]}
        restarts, truncations = restarts + ended.sum(), truncations + truncated.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            check_same(ours.reset(options={"reset_mask": ended}), theirs.reset(options={"reset_mask": ended}))
        truth, singles = ours.truth, [env.unwrapped.truth for env in theirs.envs]
        assert truth.keys() == singles[0].keys()
        for name, values in truth.items():
            np.testing.assert_array_equal(values, [single[name] for single in singles], err_msg=name)
    return reasons, restarts, truncations


@each_id
@each_mode
@pytest.mark.parametrize("count", [1, 33])
def test_every_environment_equals_the_single_one_bit_for_bit(env_id, mode, count):
    keywords = {"max_episode_steps": LIMIT, **RUGGED[env_id]}
    ours = make(env_id, count, autoreset_mode=mode, **keywords)
    theirs = SyncVectorEnv([lambda: gym.make(env_id, **keywords)] * count, autoreset_mode=mode)
    reasons, restarts, truncations = check_run(ours, theirs, random_actions(env_id, count, 60))
    assert restarts > 2 * count
    assert {"", "tracking_error"} <= reasons
    if count == 33:
        assert "slack" in reasons
        assert truncations > 0


LATE: dict[str, Any] = {
    "parameters": {
        "platform_mass": {"low": -0.2, "high": 0.2},
        "payload": {"low": -0.5, "high": 0.5},
        "damping": {"low": 0.0, "high": 0.005, "relative": False},
        "motor_strength": {"low": -0.1, "high": 0.1, "distribution": "normal", "std": 0.1},
        "base_anchors": {"low": -0.01, "high": 0.01, "relative": False},
    },
    "wrench": {"force_std": 1.0, "correlation_time": 0.02, "factor": [0.5, 2.0]},
    "sensors": {"position": 1e-3, "velocity": 0.01, "motor_angle": 0.01},
    "delay": 3,
}


@pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
@pytest.mark.parametrize(
    ("uncertainty", "count", "mode"),
    [("table6+sensors", 3, MODES[0]), (LATE, 3, MODES[1]), (LATE, 33, MODES[2])],
    ids=["by name", "late", "late 33"],
)
def test_every_environment_equals_the_single_one_under_uncertainty(env_id, uncertainty, count, mode):
    """Over ends of noise blocks, time limits and failures."""
    planar = "Planar" in env_id
    keywords = {
        "payload_range": (0.0, 2.0),
        "uncertainty": uncertainty,
        "termination_radius": 0.03,
        "max_episode_steps": 37,
        "initial_error_range": [0.01] * (2 if planar else 6),
    }
    ours = make(env_id, count, autoreset_mode=mode, **keywords)
    theirs = SyncVectorEnv([lambda: gym.make(env_id, **keywords)] * count, autoreset_mode=mode)
    shape = (90 if count < 10 else 45, *ours.action_space.shape)
    actions = np.random.default_rng(0).uniform(0.0, 0.5 if planar else 0.9, shape)
    _, restarts, truncations = check_run(ours, theirs, actions)
    assert restarts >= count
    assert truncations or not planar


# --------------------------------------------------------------------------------------------------------- seeds


def rugged(count=4, **keywords):
    return make(count=count, max_episode_steps=LIMIT, **RUGGED["CableBot-Planar-v0"], **keywords)


def test_seed_is_one_number_that_counts_up_or_a_list():
    first = rugged().reset(seed=3)
    check = rugged().reset(seed=[3, 4, 5, 6])
    np.testing.assert_array_equal(first[0], check[0])
    swapped = rugged().reset(seed=[6, 5, 4, 3])
    np.testing.assert_array_equal(first[0], swapped[0][::-1])
    assert len(set(first[1]["payload"])) == 4
    np.testing.assert_array_equal(first[0], rugged().reset(seed=np.int64(3))[0])
    unseeded = [env.reset()[1]["payload"] for env in (rugged(), rugged())]
    assert len(set(np.concatenate([first[1]["payload"], *unseeded]))) == 12


def test_none_in_a_seed_list_continues_the_streams():
    env, twin = rugged(), rugged()
    env.reset(seed=3)
    twin.reset(seed=3)
    mixed, ran_on = env.reset(seed=[9, None, None, 9])[1]["payload"], twin.reset()[1]["payload"]
    np.testing.assert_array_equal(mixed[1:3], ran_on[1:3])
    assert mixed[0] == mixed[3] != ran_on[0]
    env.reset(seed=50, options={"reset_mask": np.array([True, False, False, False])})
    twin.reset(options={"reset_mask": np.array([True, False, False, False])})
    np.testing.assert_array_equal(env.reset()[1]["payload"][1:3], twin.reset()[1]["payload"][1:3])


def test_global_random_state_is_neither_read_nor_changed():
    np.random.seed(0)  # noqa: NPY002 - the test is about the global generator
    random.seed(0)
    before, plain = np.random.get_state(), random.getstate()  # noqa: NPY002
    env = rugged(uncertainty="table6+sensors")
    first = env.reset(seed=3)
    env.step(np.zeros((4, 3)))
    single = gym.make("CableBot-Planar-v0", payload_range=(0, 1))
    single.reset()
    single.step(np.zeros(3))
    after = np.random.get_state()  # noqa: NPY002
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert random.getstate() == plain
    np.random.seed(1)  # noqa: NPY002
    check_same(first, rugged(uncertainty="table6+sensors").reset(seed=3))


# ---------------------------------------------------------------------------------------------------- reset_mask


@each_id
def test_reset_mask_restarts_the_marked_environments_only(env_id):
    robot = ROBOTS[env_id]
    kind = "planar" if robot.planar else "spatial"
    keywords = {"payload_range": (0.0, 2.0), "termination_radius": 1.0, "slack_time": 9.0}
    env, twin = make(env_id, 5, **keywords), make(env_id, 5, **keywords)
    env.reset(seed=1)
    twin.reset(seed=1)
    actions = random_actions(env_id, 5, 24)
    for action in actions[:6]:
        before = env.step(action)
        twin.step(action)
    mask = np.array([True, True, False, True, False])
    payloads = np.array([0.5, 0.25, 10.0, 0.75, 10.0])
    # A motion of another length, first in the order of environments, so that tables change during the other episodes.
    options = {"reset_mask": mask, "payload": payloads, "trajectory": {"name": f"line-{kind}", "duration": 3.0}}
    observation, info = env.reset(options=options)
    np.testing.assert_array_equal(observation[~mask], before[0][~mask])
    for key, value in info.items():
        np.testing.assert_array_equal(value[~mask], before[4][key][~mask], err_msg=key)
    assert info["payload"][mask].tolist() == [0.5, 0.25, 0.75]
    assert not info["time"][mask].any()
    single = gym.make(env_id, termination_radius=1.0, slack_time=9.0).unwrapped
    start, _ = single.reset(options={"payload": 0.25, "trajectory": options["trajectory"]})
    np.testing.assert_array_equal(observation[1], start)
    for number, action in enumerate(actions[6:]):
        ours, theirs = env.step(action), twin.step(action)
        for one, other in zip(ours[:-1], theirs[:-1], strict=True):
            np.testing.assert_array_equal(one[~mask], other[~mask])
        for key, value in ours[4].items():
            np.testing.assert_array_equal(value[~mask], theirs[4][key][~mask], err_msg=key)
        if number < 9:
            np.testing.assert_array_equal(ours[0][1], single.step(action[1])[0])
            assert [task.trajectory.duration for task in env.tasks] == [3.6, 3.6, 1.6, 3.6, 1.6]
        if number == 8:  # back to the default motion: the tables shrink
            env.reset(options={"reset_mask": mask})
            assert [task.trajectory.duration for task in env.tasks] == [1.6] * 5


@each_mode
@pytest.mark.parametrize("limit", [None, 12, 40])
def test_each_environment_is_truncated_when_its_own_motion_is_complete(mode, limit):
    """By 6, 20 and 6 steps, or by an earlier limit; the third environment starts again while the others continue."""
    env = make(count=3, autoreset_mode=mode, trajectory={"name": "dwell-planar", "duration": 0.06}, slack_time=9.0,
               control_frequency=100.0, max_episode_steps=limit)  # fmt: skip
    env.reset(seed=0)
    long = {"trajectory": {"name": "dwell-planar", "duration": 0.2}, "reset_mask": np.array([False, True, False])}
    env.reset(options=long)
    for _ in range(3):
        env.step(np.zeros((3, 3)))
    env.reset(options={"reset_mask": np.array([False, False, True])})
    steps = np.array([3, 3, 0])
    lengths = np.array([6, 20 if limit is None else min(limit, 20), 6])
    ended = np.zeros(3, bool)
    for _ in range(40):
        _, _, terminated, truncated, _ = env.step(np.zeros((3, 3)))
        steps += 1
        if mode is AutoresetMode.NEXT_STEP:
            steps[ended], lengths[ended] = 0, 6
        ended = steps >= lengths
        assert truncated.tolist() == ended.tolist()
        assert not terminated.any()
        if mode is AutoresetMode.SAME_STEP:
            steps[ended], lengths[ended] = 0, 6


def test_reset_mask_restarts_the_slack_time():
    env = make(count=2, autoreset_mode=AutoresetMode.DISABLED, slack_time=0.1, control_frequency=100.0)
    env.reset()
    loose = np.full((2, 3), -0.5)
    for _ in range(8):
        assert not env.step(loose)[2].any()
    env.reset(options={"reset_mask": np.array([False, True])})
    terminated = [env.step(loose)[2].tolist() for _ in range(3)]
    assert terminated == [[False, False], [False, False], [True, False]]


# ----------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    "action", [np.zeros(3), np.zeros((2, 3)), np.array([[0.0] * 3, [0.0, np.nan, 0.0], [0.0] * 3])]
)
def test_bad_action_raises_and_leaves_the_episodes(action):
    env, twin = make(payload_range=(0, 1)), make(payload_range=(0, 1))
    check_same(env.reset(seed=0), twin.reset(seed=0))
    good = random_actions("CableBot-Planar-v0", 3, 2)
    check_same(env.step(good[0]), twin.step(good[0]))
    with pytest.raises(ValueError, match="action"):
        env.step(action)
    check_same(env.step(good[1]), twin.step(good[1]))


@pytest.mark.parametrize(
    ("reset", "named"),
    [
        ({"options": {"payload": [1.0, 2.0, -1.0]}}, "payload"),
        ({"options": {"paylaod": 1.0}}, "paylaod"),
        ({"options": {"uncertainty": ["table6"] * 2}}, "uncertainty"),
        ({"options": {"reset_mask": np.array([1, 0, 1])}}, "reset_mask"),
        ({"options": {"reset_mask": np.zeros(3, bool)}}, "reset_mask"),
        ({"options": {"reset_mask": np.array([True, False, False]), "payload": -1.0}}, "payload"),
        ({"seed": [1, -2, 3]}, "seed"),
    ],
)
def test_bad_reset_raises_and_leaves_episodes_and_streams(reset, named):
    keywords = {"payload_range": (0.0, 2.0), "initial_error_range": [0.01, 0.01]}
    env, twin = make(**keywords), make(**keywords)
    check_same(env.reset(seed=4), twin.reset(seed=4))
    for action in random_actions("CableBot-Planar-v0", 3, 2):
        with pytest.raises(ValueError, match=named):
            env.reset(**reset)
        check_same(env.step(action), twin.step(action))
    check_same(env.reset(), twin.reset())


@pytest.mark.parametrize(
    ("keywords", "named"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"max_episode_steps": 0}, "max_episode_steps"),
        ({"autoreset_mode": "never"}, "NextStep, SameStep, Disabled"),
        ({"render_mode": "human"}, "render_mode"),
        ({"num_envs": 3, "payload": [1.0, 2.0]}, "payload"),
    ],
)
def test_bad_keyword_raises(keywords, named):
    with pytest.raises(ValueError, match=named):
        CableBotVectorEnv(robot="planar", **keywords)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_info_holds_arrays_of_numbers_that_torch_and_jax_take(mode):
    """DLPack takes no strings; TorchRL reads the attribute."""
    envs = gym.make_vec("CableBot-Planar-v0", 2, autoreset_mode=mode, max_episode_steps=1).unwrapped
    assert envs.autoreset_mode is mode
    infos = [envs.reset(seed=0)[1], envs.step(np.zeros((2, 3)))[4]]
    infos.append(infos[-1].pop("final_info", {}))
    infos[1].pop("final_obs", None)  # an array of arrays, as in Gymnasium
    assert {value.dtype.kind for info in infos for value in info.values()} == {"b", "f", "i"}
    assert all(value.flags.c_contiguous for info in infos for value in info.values())  # JAX


def test_environment_that_has_ended_can_be_stepped_without_effect_on_the_others():
    keywords = {"autoreset_mode": AutoresetMode.DISABLED, "payload": [0.0, 0.5, 1.0]}
    env, twin = (make(**keywords, termination_radius=radius) for radius in (0.03, 9.0))
    actions = np.full((30, 3, 3), 0.2)
    actions[:10, 1] = [9.0, -9.0, 0.0]
    env.reset(seed=0)
    twin.reset(seed=0)
    ended = np.zeros(3, bool)
    for action in actions:
        one, other = env.step(action), twin.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        ended |= one[2]
    assert ended.tolist() == [False, True, False]
    env.reset(options={"reset_mask": ended})
    np.testing.assert_array_equal(env.step(actions[-1])[4]["time"], [0.062, 0.002, 0.062])


def test_first_reset_must_start_all_environments():
    env = make()
    with pytest.raises(ResetNeeded, match="reset_mask"):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros((3, 3)))


# ------------------------------------------------------------------------------------- threads


@pytest.mark.parametrize("count", [1, 40, 97])
def test_threads_do_not_change_a_bit(count):
    """With more threads than tiles, and a last tile that is not full."""
    rugged = RUGGED["CableBot-Planar-v0"] | {"max_episode_steps": LIMIT, "uncertainty": "hardware"}
    ours, theirs = make(count=count, threads=3, **rugged), make(count=count, **rugged)
    check_same(ours.reset(seed=5), theirs.reset(seed=5))
    for action in random_actions("CableBot-Planar-v0", count, 2 * LIMIT):
        check_same(ours.step(action), theirs.step(action))


def test_copy_of_a_threaded_environment_continues_equally():
    ours = make(count=70, threads=2)
    ours.reset(seed=0)
    copy = pickle.loads(pickle.dumps(ours))
    action = np.full((70, 3), 0.1)
    check_same(ours.step(action), copy.step(action))


@pytest.mark.parametrize("threads", [0, 1.5, "2"])
def test_invalid_threads_raise(threads):
    with pytest.raises((TypeError, ValueError), match="threads"):
        make(threads=threads)


def test_error_in_a_thread_is_raised_after_all_calls_ended():
    ended = []

    def fails():
        raise ArithmeticError("in a thread")

    with pytest.raises(ArithmeticError, match="in a thread"):
        call_all([lambda: ended.append(0), fails, lambda: ended.append(2)])
    assert sorted(ended) == [0, 2]


# ---------------------------------------------------------------------------- attributes of single environments


ATTRIBUTES = ("task", "truth", "pose", "np_random_seed", "action_space", "observation_space", "settings", "render_mode")


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_attribute_equals_that_of_gymnasiums_vector_environment(name):
    keywords = {"payload_range": (0.0, 2.0), "uncertainty": "hardware"}
    theirs = SyncVectorEnv([lambda: gym.make("CableBot-Planar-v0", **keywords)] * 3)
    ours = make(**keywords)
    ours.reset(seed=1)
    theirs.reset(seed=1)
    values, expected = ours.get_attr(name), theirs.get_attr(name)
    assert type(values) is type(expected) is tuple
    for value, other in zip(values, expected, strict=True):
        assert repr(value) == repr(other)


def test_set_attributes_are_returned():
    env = make()
    env.set_attr("label", ["a", "b", "c"])
    env.set_attr("level", 4)
    assert (env.get_attr("label"), env.call("level")) == (("a", "b", "c"), (4, 4, 4))


def test_invalid_attributes_raise():
    env = make()
    with pytest.raises(AttributeError, match="payloads"):
        env.get_attr("payloads")
    with pytest.raises(AttributeError, match=r"reset\(\)"):
        env.set_attr("pose", 0.0)
    with pytest.raises(ValueError, match="3 values"):
        env.set_attr("label", [1, 2])


def test_call_renders_each_environment():
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    assert [picture.shape for picture in env.call("render")] == [(480, 640, 3)] * 3
