"""The vector environment against single ones, lane by lane and bit by bit, in every autoreset mode."""

from __future__ import annotations

import random
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import cablebot_gym
from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.robots import PLANAR, SPATIAL

ROBOTS = {"CableBot-Planar-v0": PLANAR, "CableBot-Spatial-v0": SPATIAL}
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]

# Start errors close to a tight radius: under random commands some lanes end early, the others at the time limit.
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


def commands(env_id, count, steps, seed=0):
    """Random commands, each held for some steps, some beyond ±1 and many that let cables go."""
    rng = np.random.default_rng(seed)
    held = rng.uniform(-1.0, 1.5, (steps // 4 + 1, count, ROBOTS[env_id].cables))
    return np.repeat(held, 4, axis=0)[:steps]


def check_same_info(ours, theirs):
    """Theirs marks in ``_key`` for which lanes it says anything; there, ours says the same to the last bit."""
    assert {key for key in ours if not key.startswith("_")} == {key for key in theirs if not key.startswith("_")}
    for key, mask in theirs.items():
        if not key.startswith("_"):
            continue
        lanes, name = np.flatnonzero(mask), key[1:]
        if name in ("final_obs", "final_info"):
            np.testing.assert_array_equal(ours[key], mask)
        if name == "final_info":
            check_same_info(ours[name], theirs[name])
            continue
        one, other = (np.array([values[name][lane] for lane in lanes]) for values in (ours, theirs))
        np.testing.assert_array_equal(one, other, err_msg=f"{name} of lanes {lanes}")


def check_same(ours, theirs):
    """Observations, rewards, flags and infos of two steps, or observations and infos of two resets."""
    for one, other in zip(ours[:-1], theirs[:-1], strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    check_same_info(ours[-1], theirs[-1])


# ------------------------------------------------------------------------------------- against single environments


@each_id
@each_mode
@pytest.mark.parametrize("count", [1, 3, 33])
def test_every_lane_is_the_single_environment_to_the_last_bit(env_id, mode, count):
    steps = 60
    ours = make(env_id, count, max_episode_steps=LIMIT, autoreset_mode=mode, **RUGGED[env_id])
    single = [lambda: gym.make(env_id, max_episode_steps=LIMIT, **RUGGED[env_id])] * count
    theirs = SyncVectorEnv(single, autoreset_mode=mode)
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    check_same(ours.reset(seed=7), theirs.reset(seed=7))
    reasons, truncations, restarts = set(), 0, 0
    for action in commands(env_id, count, steps):
        one, other = ours.step(action), theirs.step(action)
        check_same(one, other)
        terminated, truncated, info = one[2], one[3], one[4]
        ended = terminated | truncated
        last = info.get("final_info", info)
        assert np.array_equal(last["termination_reason"] != "", terminated)
        reasons |= set(last["termination_reason"])
        truncations += truncated.sum()
        restarts += ended.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            check_same(ours.reset(options={"reset_mask": ended}), theirs.reset(options={"reset_mask": ended}))
    assert restarts > 2 * count  # else the test says nothing about restarting
    assert {"", "tracking_error"} <= reasons
    if count == 33:
        assert "slack" in reasons
        assert truncations > 0


@each_id
def test_a_lane_is_the_single_environment_whatever_its_neighbours_do(env_id):
    """Lanes share a tile of the kernel, whose taut sets are searched together."""
    keywords = {"control_frequency": 100.0, "termination_radius": 10.0, "slack_time": 1e9}
    ours, single = make(env_id, 11, **keywords), gym.make(env_id, **keywords).unwrapped
    ours.reset(seed=0)
    single.reset(seed=5)
    for number, action in enumerate(commands(env_id, 11, 30)):
        action[:5] *= 20.0
        action[6:] = -3.0 if number % 2 else 3.0
        observation, reward, _, _, info = single.step(action[5])
        batch = ours.step(action)
        np.testing.assert_array_equal(batch[0][5], observation)
        assert batch[1][5] == reward
        assert all(np.array_equal(batch[4][key][5], value) for key, value in info.items())


@each_id
def test_per_lane_values_are_those_of_single_environments(env_id):
    n = ROBOTS[env_id].coordinates
    rng = np.random.default_rng(2)
    values = {
        "payload": rng.uniform(0, 3, 3),
        "payload_known": np.array([True, False, True]),
        "initial_error": rng.uniform(-0.01, 0.01, (3, n)),
    }
    action = commands(env_id, 3, 1)[0]
    made, asked = make(env_id, **values), make(env_id)
    for env, options in ((made, None), (asked, values)):
        start = env.reset(seed=0, options=options)
        after = env.step(action)
        for lane in range(3):
            single = gym.make(env_id).unwrapped
            own = {key: value[lane] for key, value in values.items()}
            observation, info = single.reset(options=own)
            np.testing.assert_array_equal(start[0][lane], observation)
            assert start[1]["payload"][lane] == info["payload"] == values["payload"][lane]
            np.testing.assert_array_equal(after[0][lane], single.step(action[lane])[0])
            assert env.tasks[lane].model_payload == values["payload"][lane] * values["payload_known"][lane]
    assert not np.array_equal(*(env.reset()[1]["payload"] for env in (made, asked)))  # keywords last, options do not


def test_a_callers_arrays_do_not_stay_connected_to_the_environment():
    payload, known, error = np.array([1.0, 2.0]), np.array([True, True]), np.zeros((2, 2))
    env = make(count=2, payload=payload, payload_known=known, initial_error=error)
    first, _ = env.reset()
    payload[:], known[:], error[:] = 5.0, False, 0.01
    np.testing.assert_array_equal(env.reset()[0], first)


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_async_workers_give_the_same_numbers(context):
    env_id, steps = "CableBot-Spatial-v0", 30
    keywords = {"max_episode_steps": LIMIT, **RUGGED[env_id]}
    ours = make(env_id, 2, **keywords)
    theirs = gym.make_vec(
        env_id, num_envs=2, vectorization_mode="async", vector_kwargs={"context": context}, **keywords
    )
    try:
        check_same(ours.reset(seed=3), theirs.reset(seed=3))
        ended = 0
        for action in commands(env_id, 2, steps):
            result = ours.step(action)
            check_same(result, theirs.step(action))
            ended += (result[2] | result[3]).sum()
        assert ended > 2
    finally:
        theirs.close()


UNCERTAIN: dict[str, Any] = {
    "by name": "table6+sensors",
    "late": {
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
    },
}


@pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)
@pytest.mark.parametrize("form", list(UNCERTAIN))
@each_mode
@pytest.mark.parametrize("count", [1, 3, 33])
def test_every_lane_is_the_single_environment_under_uncertainty_too(env_id, mode, form, count):
    """Over block ends of the read-ahead noise, time limits and failures."""
    steps = 90 if count < 10 else 45
    planar = "Planar" in env_id
    keywords = {
        "payload_range": (0.0, 2.0),
        "uncertainty": UNCERTAIN[form],
        "termination_radius": 0.03,
        "max_episode_steps": 37,
        "initial_error_range": [0.01] * (2 if planar else 6),
    }
    ours = make(env_id, count, autoreset_mode=mode, **keywords)
    theirs = SyncVectorEnv([lambda: gym.make(env_id, **keywords)] * count, autoreset_mode=mode)
    check_same(ours.reset(seed=7), theirs.reset(seed=7))
    rng, restarts, truncations = np.random.default_rng(0), 0, 0
    for _ in range(steps):
        action = rng.uniform(0.0, 0.5 if planar else 0.9, ours.action_space.shape)
        one, other = ours.step(action), theirs.step(action)
        check_same(one, other)
        ended = one[2] | one[3]
        restarts, truncations = restarts + ended.sum(), truncations + one[3].sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            check_same(ours.reset(options={"reset_mask": ended}), theirs.reset(options={"reset_mask": ended}))
        truth, singles = ours.truth, [env.unwrapped.truth for env in theirs.envs]
        for name, values in truth.items():
            np.testing.assert_array_equal(values, [single[name] for single in singles], err_msg=name)
        assert truth.keys() == singles[0].keys()
    assert restarts >= count
    assert truncations or not planar  # planar ones last until the time limit


# --------------------------------------------------------------------------------------------------------- seeds


def rollout(env, steps=30, seed=None, payload_only=False):
    """Observations, rewards and payloads of a run through several episodes."""
    observation, info = env.reset(seed=seed)
    found = [observation, info["payload"]]
    for action in commands("CableBot-Planar-v0", env.num_envs, steps):
        observation, reward, _, _, info = env.step(action)
        found += [observation, reward, info["payload"]]
    return found


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def rugged(count=4, **keywords):
    return make(count=count, max_episode_steps=LIMIT, **RUGGED["CableBot-Planar-v0"], **keywords)


def test_a_seed_repeats_the_run_and_another_does_not():
    env = rugged()
    first = rollout(env, seed=3)
    assert same(first, rollout(env, seed=3))
    assert same(first, rollout(rugged(), seed=3))
    assert not same(first, rollout(env, seed=4))


def test_a_number_seeds_the_lanes_upwards_and_a_list_one_by_one():
    first = rugged().reset(seed=3)
    check = rugged().reset(seed=[3, 4, 5, 6])
    np.testing.assert_array_equal(first[0], check[0])
    swapped = rugged().reset(seed=[6, 5, 4, 3])
    np.testing.assert_array_equal(first[0], swapped[0][::-1])
    assert len(set(first[1]["payload"])) == 4
    np.testing.assert_array_equal(first[0], rugged().reset(seed=np.int64(3))[0])


def test_none_in_a_seed_list_lets_that_lane_run_on():
    env, twin = rugged(), rugged()
    env.reset(seed=3)
    twin.reset(seed=3)
    mixed, ran_on = env.reset(seed=[9, None, None, 9])[1]["payload"], twin.reset()[1]["payload"]
    np.testing.assert_array_equal(mixed[1:3], ran_on[1:3])
    assert mixed[0] == mixed[3] != ran_on[0]


def test_unseeded_resets_and_environments_differ():
    first, other = rugged(), rugged()
    found = [env.reset()[1]["payload"] for env in (first, first, other, other)]
    assert len(set(np.concatenate(found))) == 16


def test_two_environments_in_one_process_do_not_influence_each_other():
    alone = rollout(rugged(), seed=3)
    env, disturber = rugged(), rugged(count=7)
    disturber.reset(seed=3, options={"trajectory": "line-planar"})
    observation, info = env.reset(seed=3)
    found = [observation, info["payload"]]
    for number, action in enumerate(commands("CableBot-Planar-v0", 4, 30)):
        disturber.step(np.full((7, 3), 0.1 * (number % 9)))
        if number % 5 == 0:
            disturber.reset(seed=number)
        observation, reward, _, _, info = env.step(action)
        found += [observation, reward, info["payload"]]
    assert same(alone, found)


def test_global_random_state_is_neither_read_nor_touched():
    np.random.seed(0)  # noqa: NPY002 - the global generator is what the test is about
    random.seed(0)
    before, plain = np.random.get_state(), random.getstate()  # noqa: NPY002
    first = rollout(rugged(), seed=3)
    single = gym.make("CableBot-Planar-v0", payload_range=(0, 1))
    single.reset()
    single.step(np.zeros(3))
    rugged().reset()
    after = np.random.get_state()  # noqa: NPY002
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert random.getstate() == plain
    np.random.seed(1)  # noqa: NPY002
    assert same(first, rollout(rugged(), seed=3))


# ---------------------------------------------------------------------------------------------------- reset_mask


@each_id
@each_mode
def test_reset_mask_restarts_the_marked_lanes_and_leaves_the_others_to_the_last_bit(env_id, mode):
    robot = ROBOTS[env_id]
    kind = "planar" if robot.planar else "spatial"
    keywords = {"payload_range": (0.0, 2.0), "autoreset_mode": mode, "termination_radius": 1.0, "slack_time": 9.0}
    env, twin = make(env_id, 5, **keywords), make(env_id, 5, **keywords)
    env.reset(seed=1)
    twin.reset(seed=1)
    actions = commands(env_id, 5, 24)
    for action in actions[:6]:
        before = env.step(action)
        twin.step(action)
    mask = np.array([True, True, False, True, False])
    payloads = np.array([0.5, 0.25, 10.0, 0.75, 10.0])
    # A motion of another length, first in the order of lanes, so that tables change under the lanes that go on.
    options = {"reset_mask": mask, "payload": payloads, "trajectory": {"name": f"line-{kind}", "duration": 3.0}}
    kept = {key: np.copy(value) for key, value in options.items()}
    observation, info = env.reset(options=options)
    assert list(options) == list(kept)  # read, not popped
    np.testing.assert_array_equal(options["reset_mask"], kept["reset_mask"])
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
            assert [task.trajectory.duration for task in env.tasks] == [3.0, 3.0, 1.0, 3.0, 1.0]
        if number == 8:  # back to the default motion: the tables shrink
            env.reset(options={"reset_mask": mask})
            assert [task.trajectory.duration for task in env.tasks] == [1.0] * 5


def test_reset_mask_restarts_the_clocks_of_its_lanes_alone():
    env = make(count=2, max_episode_steps=10, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    rest = np.full((2, 3), 0.2)
    for _ in range(6):
        env.step(rest)
    env.reset(options={"reset_mask": np.array([False, True])})
    truncated = [env.step(rest)[3].tolist() for _ in range(4)]
    assert truncated == [[False, False]] * 3 + [[True, False]]
    env.reset(options={"reset_mask": np.array([True, False])})
    truncated = [env.step(rest)[3].tolist() for _ in range(6)]
    assert truncated == [[False, False]] * 5 + [[False, True]]


def test_slack_is_counted_anew_after_a_restart():
    env = make(count=2, autoreset_mode=AutoresetMode.DISABLED, slack_time=0.1, control_frequency=100.0)
    env.reset()
    loose = np.full((2, 3), -0.5)
    for _ in range(8):
        assert not env.step(loose)[2].any()
    env.reset(options={"reset_mask": np.array([False, True])})
    terminated = [env.step(loose)[2].tolist() for _ in range(3)]
    assert terminated == [[False, False], [False, False], [True, False]]


def test_masked_seeds_reseed_the_marked_lanes_alone():
    env, twin = rugged(), rugged()
    env.reset(seed=3)
    twin.reset(seed=3)
    env.reset(seed=50, options={"reset_mask": np.array([True, False, False, False])})
    ours, theirs = env.reset()[1]["payload"], twin.reset()[1]["payload"]
    np.testing.assert_array_equal(ours[1:], theirs[1:])
    assert ours[0] != theirs[0]


# ------------------------------------------------------------------------------------------- making, time limit


@each_id
def test_make_vec_uses_our_class_and_truncates_at_500(env_id):
    env = gym.make_vec(env_id, num_envs=2)
    assert type(env.unwrapped) is CableBotVectorEnv
    policy = FeedbackLinearization(ROBOTS[env_id])
    observation, _ = env.reset(seed=0)
    for step in range(1, 502):
        observation, _, terminated, truncated, info = env.step(policy.predict(observation)[0])
        assert not terminated.any()
        assert truncated.tolist() == [step == 500] * 2, step
    assert info["time"].tolist() == [0.0, 0.0]  # step 501 restarted


def test_metadata_holds_the_enum_and_the_class_keeps_its_own():
    before = dict(CableBotVectorEnv.metadata)
    for mode in MODES:
        env = make(autoreset_mode=mode)
        assert env.metadata["autoreset_mode"] is mode
        assert make(autoreset_mode=mode.value).metadata["autoreset_mode"] is mode
    assert make().metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert CableBotVectorEnv.metadata == before
    assert env.metadata is not CableBotVectorEnv.metadata


def test_no_limit_of_steps_means_none():
    env = CableBotVectorEnv(robot="planar", num_envs=1, trajectory="dwell-planar")
    env.reset()
    assert not any(env.step(np.full((1, 3), 0.2))[3].any() for _ in range(600))


def test_results_are_copies_that_the_next_step_leaves_alone():
    env = rugged()
    found = env.reset(seed=0)
    kept = found[0].copy(), {key: value.copy() for key, value in found[1].items()}
    for action in commands("CableBot-Planar-v0", 4, 20):
        env.step(action)
    np.testing.assert_array_equal(found[0], kept[0])
    assert all(np.array_equal(value, kept[1][key]) for key, value in found[1].items())


def test_final_observations_outlive_the_steps_after_them():
    env = rugged(autoreset_mode=AutoresetMode.SAME_STEP)
    env.reset(seed=0)
    finals = []
    for action in commands("CableBot-Planar-v0", 4, 40):
        info = env.step(action)[4]
        if "final_obs" in info:
            lane = int(np.argmax(info["_final_obs"]))
            finals.append((info["final_obs"][lane], info["final_obs"][lane].copy()))
    assert len(finals) > 3
    assert all(np.array_equal(one, copy) for one, copy in finals)


# ----------------------------------------------------------------------------------------------------- bad input

BAD_ACTIONS = {
    "one lane's action": (np.zeros(3), "shape"),
    "a lane too few": (np.zeros((2, 3)), "shape"),
    "transposed": (np.zeros((4, 2)), "shape"),
    "NaN in one lane": (np.array([[0.0] * 3, [0.0, np.nan, 0.0], [0.0] * 3]), "finite"),
    "infinity in one lane": (np.array([[0.0] * 3, [0.0] * 3, [0.0, 0.0, np.inf]]), "finite"),
    "infinities that cancel": (np.array([[np.inf, 0.0, 0.0], [-np.inf, 0.0, 0.0], [0.0] * 3]), "finite"),
}


@pytest.mark.parametrize("name", list(BAD_ACTIONS))
@each_mode
def test_a_bad_action_raises_and_changes_no_lane(name, mode):
    action, word = BAD_ACTIONS[name]
    env, twin = (make(count=3, payload_range=(0, 1), autoreset_mode=mode) for _ in range(2))
    env.reset(seed=0)
    twin.reset(seed=0)
    good = commands("CableBot-Planar-v0", 3, 2)
    check_same(env.step(good[0]), twin.step(good[0]))
    with pytest.raises(ValueError, match=word):
        env.step(action)
    check_same(env.step(good[1]), twin.step(good[1]))


BAD_RESETS: dict[str, tuple[dict[str, Any], str]] = {
    "payloads of the wrong length": ({"options": {"payload": [1.0, 2.0]}}, r"payload .*3.*\(2,\)"),
    "one NaN payload": ({"options": {"payload": [1.0, np.nan, 1.0]}}, "payload .*finite"),
    "one negative payload": ({"options": {"payload": [1.0, 2.0, -1.0]}}, "payload .*at least 0"),
    "unknown option": ({"options": {"paylaod": 1.0}}, "paylaod.*payload_known, model_payload_factor, trajectory"),
    "start errors of the wrong shape": (
        {"options": {"initial_error": np.zeros((2, 2))}},
        "initial_error .*3 rows of 2",
    ),
    "payload_known of the wrong length": ({"options": {"payload_known": [True] * 4}}, "payload_known .*3"),
    "unknown trajectory": ({"options": {"trajectory": "spiral"}}, "spiral.*paper-planar"),
    "mask of the wrong length": ({"options": {"reset_mask": np.array([True, False])}}, "reset_mask .*3"),
    "mask of numbers": ({"options": {"reset_mask": np.array([1, 0, 1])}}, "reset_mask .*booleans"),
    "empty mask": ({"options": {"reset_mask": np.zeros(3, bool)}}, "reset_mask .*at least one"),
    "good mask, bad payload": (
        {"options": {"reset_mask": np.array([True, False, False]), "payload": -1.0}},
        "payload .*at least 0",
    ),
    "seeds of the wrong length": ({"seed": [1, 2]}, "seed .*3.*2"),
    "negative seed": ({"seed": [1, -2, 3]}, "seed .*at least 0"),
    "good seed, bad option": ({"seed": 8, "options": {"payload": -1.0}}, "payload .*at least 0"),
}


@pytest.mark.parametrize("name", list(BAD_RESETS))
def test_a_refused_reset_is_explained_and_changes_neither_lanes_nor_streams(name):
    reset, words = BAD_RESETS[name]
    keywords = {"payload_range": (0.0, 2.0), "initial_error_range": [0.01, 0.01]}
    env, twin = make(**keywords), make(**keywords)
    check_same(env.reset(seed=4), twin.reset(seed=4))
    for action in commands("CableBot-Planar-v0", 3, 4):
        with pytest.raises(ValueError, match=words):
            env.reset(**reset)
        check_same(env.step(action), twin.step(action))
    check_same(env.reset(), twin.reset())


BAD_KEYWORDS: dict[str, tuple[dict[str, Any], str]] = {
    "no environments": ({"num_envs": 0}, "num_envs .*at least 1"),
    "half an environment": ({"num_envs": 1.5}, "num_envs .*whole"),
    "no steps": ({"max_episode_steps": 0}, "max_episode_steps .*at least 1"),
    "unknown autoreset mode": ({"autoreset_mode": "never"}, "never.*NextStep, SameStep, Disabled"),
    "render mode": ({"render_mode": "hologram"}, "render_mode 'hologram'"),
    "payloads of the wrong length": ({"num_envs": 3, "payload": [1.0, 2.0]}, r"payload .*3.*\(2,\)"),
    "unknown cable": ({"cable": "rope"}, "rope.*unilateral, bilateral"),
}


@pytest.mark.parametrize("name", list(BAD_KEYWORDS))
def test_a_bad_keyword_is_named_with_what_would_do(name):
    keywords, words = BAD_KEYWORDS[name]
    with pytest.raises(ValueError, match=words):
        CableBotVectorEnv(robot="planar", **keywords)


def test_disabled_autoreset_refuses_an_ended_lane_and_teaches_reset_mask():
    env = make(count=2, max_episode_steps=3, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    rest = np.full((2, 3), 0.2)
    for _ in range(3):
        result = env.step(rest)
    assert result[3].all()
    for mask in ([True, False], [False, True]):
        for _ in range(2):
            with pytest.raises(ResetNeeded, match=r"ended.*reset\(options=.*reset_mask"):
                env.step(rest)
        env.reset(options={"reset_mask": np.array(mask)})
    np.testing.assert_array_equal(env.step(rest)[4]["time"], [0.002, 0.002])  # the refused steps moved nothing


def test_lanes_that_have_ended_are_stepped_on_if_asked_and_leave_the_others_alone():
    keywords = {"autoreset_mode": AutoresetMode.DISABLED, "termination_radius": 0.03, "payload": [0.0, 0.5, 1.0]}
    env, twin = make(**keywords), make(**keywords, max_episode_steps=10)
    actions = np.full((30, 3, 3), 0.2)
    actions[:10, 1] = [9.0, -9.0, 0.0]  # ends within these; afterwards it may come back
    env.reset(seed=0)
    twin.reset(seed=0)
    ended = np.zeros(3, bool)
    for action in actions:
        one, other = env.step(action, past_end=True), twin.step(action, past_end=True)
        for mine, its in zip(one[:3], other[:3], strict=True):
            np.testing.assert_array_equal(mine, its)
        ended |= one[2]
    assert ended.tolist() == [False, True, False]
    assert other[3].all()
    for _ in range(2):
        with pytest.raises(ResetNeeded, match="reset_mask"):
            env.step(actions[0])
    env.reset(options={"reset_mask": ended})
    assert not env.step(actions[-1])[2].any()
    np.testing.assert_array_equal(env.step(actions[-1])[4]["time"], [0.064, 0.004, 0.064])


def test_an_end_is_not_forgotten_while_a_lane_is_stepped_on():
    env = make(count=2, autoreset_mode=AutoresetMode.DISABLED, slack_time=0.0)
    env.reset(seed=0)
    assert env.step(np.full((2, 3), -0.5))[2].all()
    assert not [env.step(np.full((2, 3), 0.3), past_end=True)[2].any() for _ in range(20)][-1]
    with pytest.raises(ResetNeeded, match="reset_mask"):
        env.step(np.full((2, 3), 0.3))


def test_step_before_reset_and_a_first_reset_of_some_lanes_say_what_to_do():
    env = make()
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros((3, 3)))
    with pytest.raises(ResetNeeded, match="reset_mask"):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros((3, 3)))


def test_every_id_has_a_vector_environment():
    assert set(ROBOTS) <= set(cablebot_gym.ENV_IDS)
    for env_id in cablebot_gym.ENV_IDS:
        assert isinstance(make(env_id, 2), CableBotVectorEnv)
