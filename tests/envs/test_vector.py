"""The vector environment against single ones, bit by bit, in every autoreset mode."""

import pickle
import random

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.testing import assert_array_equal
from oracles.episodes import PLANAR, ROBOTS, check_equal, make_vector, paper_ids, rigid_ids
from oracles.episodes import make as make_single

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.utils.threads import call_all

MODES = [
    AutoresetMode.NEXT_STEP,
    AutoresetMode.SAME_STEP,
    AutoresetMode.DISABLED,
]

# Start errors close to the termination radius: under random actions some episodes end early, the
# others at the time limit.
LIMIT = 12
RUGGED = {
    "payload_range": (0.0, 2.0),
    "initial_error_range": [0.067, 0.067],
    "control_frequency": 100.0,
    "max_episode_steps": LIMIT,
}


def make(env_id=PLANAR, count=3, **keywords):
    return make_vector(env_id, count, **keywords)


def rugged(count=4, **keywords):
    return make(count=count, **RUGGED, **keywords)


def random_actions(env, steps):
    """Random actions, each held for some steps: some beyond ±1, and many that slacken cables."""
    held = np.random.default_rng(0).uniform(
        -1.0,
        1.5,
        (steps // 4 + 1, *env.action_space.shape),
    )
    return np.repeat(held, 4, axis=0)[:steps]


# --- against single environments ----------------------------------------------------------------------------------


def check_same_info(ours, theirs):
    assert {key.removeprefix("_") for key in ours} == {key.removeprefix("_") for key in theirs}
    for key in [key for key in theirs if key.startswith("_")]:
        name = key[1:]
        if name in ("final_obs", "final_info"):
            assert_array_equal(ours[key], theirs[key])
        if name == "final_info":
            check_same_info(ours[name], theirs[name])
        else:
            for index in np.flatnonzero(theirs[key]):
                check_equal(ours[name][index], theirs[name][index], f"{name} {index}")


def check_same(ours, theirs):
    """Gymnasium marks in ``_key`` the environments with a valid value; these values are equal bit
    for bit."""
    check_equal(ours[:-1], theirs[:-1])
    check_same_info(ours[-1], theirs[-1])


def check_run(env_id, count, mode, actions, **keywords):
    """Compares a run with single environments; the reasons of its ends, and the numbers of restarts
    and of time limits."""
    ours = make(env_id, count, autoreset_mode=mode, **keywords)
    theirs = SyncVectorEnv([lambda: gym.make(env_id, **keywords)] * count, autoreset_mode=mode)
    for name in ("single_observation_space", "observation_space", "action_space"):
        assert getattr(ours, name) == getattr(theirs, name)
    check_same(ours.reset(seed=7), theirs.reset(seed=7))
    reasons = set()
    restarts = 0
    truncations = 0
    for action in actions:
        result = ours.step(action)
        check_same(result, theirs.step(action))
        _, _, terminated, truncated, info = result
        ended = terminated | truncated
        codes = info.get("final_info", info)["termination_reason"]
        assert np.array_equal(codes != 0, terminated)
        reasons |= {TERMINATION_REASONS[code] for code in codes}
        restarts += ended.sum()
        truncations += truncated.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            again = {"options": {"reset_mask": ended}}
            check_same(ours.reset(**again), theirs.reset(**again))
        for name, values in ours.truth.items():
            expected = [env.unwrapped.truth[name] for env in theirs.envs]
            assert_array_equal(values, expected, err_msg=name)
    return reasons, restarts, truncations


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
@pytest.mark.parametrize("count", [1, 18])
def test_every_environment_equals_the_single_one(mode, count):
    actions = random_actions(rugged(count), 60 if count == 1 else 40)
    reasons, restarts, truncations = check_run(PLANAR, count, mode, actions, **RUGGED)
    assert restarts > 2 * count
    assert "tracking_error" in reasons
    assert count == 1 or ("slack" in reasons and truncations > 0)


@paper_ids
@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
def test_uncertain_environments_equal_the_single_ones(env_id, mode):
    """Over ends of noise blocks, time limits and failures."""
    robot = ROBOTS[env_id]
    high = 0.5 if robot.planar else 0.9
    actions = np.random.default_rng(0).uniform(0.0, high, (90, 3, robot.cables))
    _, restarts, truncations = check_run(
        env_id,
        3,
        mode,
        actions,
        payload_range=(0.0, 2.0),
        payload_known=robot.planar,
        uncertainty=LATE,
        max_episode_steps=37,
        initial_error_range=[0.055] * robot.coordinates,
    )
    assert restarts >= 3
    assert truncations or not robot.planar


LATE = {
    "parameters": {
        "platform_mass": {"low": -0.2, "high": 0.2},
        "payload": {"low": -0.5, "high": 0.5},
        "damping": {"low": 0.0, "high": 0.005, "relative": False},
        "motor_strength": {
            "low": -0.1,
            "high": 0.1,
            "distribution": "normal",
            "std": 0.1,
        },
        "base_anchors": {"low": -0.01, "high": 0.01, "relative": False},
    },
    "wrench": {
        "force_std": 1.0,
        "correlation_time": 0.02,
        "factor": [0.5, 2.0],
    },
    "sensors": {"position": 1e-3, "velocity": 0.01, "motor_angle": 0.01},
    "delay": 3,
}


# --- seeds --------------------------------------------------------------------------------------------------------


def test_seed_is_one_number_that_counts_up_or_a_list():
    observations, info = rugged().reset(seed=3)
    for seed in ([3, 4, 5, 6], np.int64(3)):
        assert_array_equal(observations, rugged().reset(seed=seed)[0])
    assert_array_equal(observations, rugged().reset(seed=[6, 5, 4, 3])[0][::-1])
    unseeded = [env.reset()[1]["payload"] for env in (rugged(), rugged())]
    assert len(np.unique([info["payload"], *unseeded])) == 12


def test_none_in_a_seed_list_continues_the_streams():
    env, twin = rugged(), rugged()
    check_equal(env.reset(seed=3), twin.reset(seed=3))
    mixed = env.reset(seed=[9, None, None, 9])[1]["payload"]
    continued = twin.reset()[1]["payload"]
    assert_array_equal(mixed[1:3], continued[1:3])
    assert mixed[0] == mixed[3] != continued[0]
    first_alone = {"reset_mask": np.array([True, False, False, False])}
    env.reset(seed=50, options=first_alone)
    twin.reset(options=first_alone)
    assert_array_equal(env.reset()[1]["payload"][1:3], twin.reset()[1]["payload"][1:3])


def test_global_random_state_is_neither_read_nor_changed():
    results = []
    for seed in (0, 1):
        np.random.seed(seed)  # noqa: NPY002 - the test is about the global generator
        random.seed(seed)
        states = np.random.get_state(), random.getstate()  # noqa: NPY002
        env = rugged(uncertainty="table6+sensors")
        results.append((env.reset(seed=3), env.step(np.zeros((4, 3)))))
        make_single(PLANAR, payload_range=(0, 1)).reset()
        check_equal((np.random.get_state(), random.getstate()), states)  # noqa: NPY002
    check_equal(*results)


# --- reset_mask ---------------------------------------------------------------------------------------------------


@rigid_ids
def test_reset_mask_restarts_the_marked_environments_only(env_id):
    """With a motion of another length, first in the order of environments: tables change during
    other episodes."""
    keywords = {"error_bounds": {"position": 0.5}}
    env, twin = (
        make(
            env_id,
            5,
            payload_range=(0.0, 2.0),
            **keywords,
        )
        for _ in range(2)
    )
    mask = np.array([True, True, False, True, False])

    def check_unmarked(ours, theirs):
        assert_array_equal(ours[0][~mask], theirs[0][~mask])
        for key, value in ours[-1].items():
            assert_array_equal(value[~mask], theirs[-1][key][~mask], err_msg=key)

    env.reset(seed=1)
    twin.reset(seed=1)
    actions = random_actions(env, 24)
    for action in actions[:6]:
        before = env.step(action)
        twin.step(action)
    motion = {"trajectory": {"name": f"line-{ROBOTS[env_id].kind}", "duration": 3.0}}
    payloads = np.array([0.5, 0.25, 10.0, 0.75, 10.0])
    observation, info = env.reset(options=motion | {"reset_mask": mask, "payload": payloads})
    check_unmarked((observation, info), before)
    assert_array_equal(info["payload"][mask], payloads[mask])
    assert not info["time"][mask].any()
    single = make_single(env_id, **keywords)
    assert_array_equal(observation[1], single.reset(options=motion | {"payload": 0.25})[0])
    for step, action in enumerate(actions[6:]):
        ours = env.step(action)
        check_unmarked(ours, twin.step(action))
        if step < 9:
            assert_array_equal(ours[0][1], single.step(action[1])[0])
        if step == 8:  # back to the default motion: the tables shrink
            env.reset(options={"reset_mask": mask})
            assert [task.trajectory.duration for task in env.tasks] == [1.6] * 5


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
@pytest.mark.parametrize("limit", [None, 12])
def test_each_environment_is_truncated_after_its_motion(mode, limit):
    """By 6, 20 and 6 steps, or by an earlier limit; the third environment starts again while the
    others continue."""
    env = make(
        trajectory={"name": "dwell-planar", "duration": 0.06},
        control_frequency=100.0,
        max_episode_steps=limit,
        autoreset_mode=mode,
    )
    taut = np.full((3, 3), 0.1)
    env.reset(seed=0)
    long = {"trajectory": {"name": "dwell-planar", "duration": 0.2}}
    env.reset(options=long | {"reset_mask": np.array([False, True, False])})
    for _ in range(3):
        env.step(taut)
    env.reset(options={"reset_mask": np.array([False, False, True])})
    steps = np.array([3, 3, 0])
    lengths = np.array([6, limit or 20, 6])
    ended = np.zeros(3, bool)
    for _ in range(40):
        _, _, terminated, truncated, _ = env.step(taut)
        steps += 1
        if mode is not AutoresetMode.DISABLED:
            restarted = ended if mode is AutoresetMode.NEXT_STEP else steps > lengths
            steps[restarted] = mode is AutoresetMode.SAME_STEP
            lengths[restarted] = 6
        ended = steps >= lengths
        assert truncated.tolist() == ended.tolist()
        assert not terminated.any()


def test_first_reset_must_start_all_environments():
    env = make()
    with pytest.raises(ResetNeeded, match="reset_mask"):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros((3, 3)))


# --- bad input ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reset", "named"),
    [
        ({"options": {"payload": [1.0, 2.0, -1.0]}}, "payload"),
        ({"options": {"uncertainty": ["table6"] * 2}}, "uncertainty"),
        ({"options": {"reset_mask": np.array([1, 0, 1])}}, "reset_mask"),
        ({"options": {"reset_mask": np.zeros(3, bool)}}, "reset_mask"),
        ({"options": {"reset_mask": np.array([True, False, False]), "payload": -1.0}}, "payload"),
        ({"seed": [1, -2, 3]}, "seed"),
    ],
)
def test_bad_reset_raises_and_leaves_episodes_and_streams(reset, named):
    env, twin = (make(payload_range=(0.0, 2.0), initial_error_range=[0.01, 0.01]) for _ in range(2))
    check_equal(env.reset(seed=4), twin.reset(seed=4))
    with pytest.raises(ValueError, match=named):
        env.reset(**reset)
    for bad in (np.zeros(3), np.zeros((2, 3)), np.where(np.eye(3), np.nan, 0.0)):
        with pytest.raises(ValueError, match="action"):
            env.step(bad)
    for action in random_actions(env, 2):
        check_equal(env.step(action), twin.step(action))
    check_equal(env.reset(), twin.reset())


@pytest.mark.parametrize(
    ("keywords", "named"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"max_episode_steps": 0}, "max_episode_steps"),
        ({"autoreset_mode": "never"}, "NextStep, SameStep, Disabled"),
        ({"render_mode": "human"}, "render_mode"),
        ({"num_envs": 3, "payload": [1.0, 2.0]}, "payload"),
        ({"threads": 0}, "threads"),
        ({"threads": 1.5}, "threads"),
    ],
)
def test_bad_keyword_raises(keywords, named):
    with pytest.raises((TypeError, ValueError), match=named):
        gym.make_vec(PLANAR, **keywords)


# --- for other libraries ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", AutoresetMode)
def test_info_holds_arrays_of_numbers_that_torch_and_jax_take(mode):
    """DLPack takes no strings; TorchRL reads the attribute."""
    envs = make(count=2, autoreset_mode=mode, max_episode_steps=1)
    assert envs.autoreset_mode is mode
    infos = [envs.reset(seed=0)[1], envs.step(np.zeros((2, 3)))[4]]
    infos.append(infos[-1].pop("final_info", {}))
    infos[1].pop("final_obs", None)  # an array of arrays, as in Gymnasium
    values = [value for info in infos for value in info.values()]
    assert {value.dtype.kind for value in values} == {"b", "f", "i"}
    assert all(value.flags.c_contiguous for value in values)  # JAX


def test_attributes_equal_those_of_a_sync_vector_env():
    keywords = {"payload_range": (0.0, 2.0), "uncertainty": "hardware"}
    theirs = SyncVectorEnv([lambda: gym.make(PLANAR, **keywords)] * 3)
    ours = make(**keywords)
    ours.reset(seed=1)
    theirs.reset(seed=1)
    names = "task", "truth", "pose", "np_random_seed", "settings", "render_mode"
    for name in (*names, "action_space", "observation_space"):
        values = ours.get_attr(name)
        assert type(values) is tuple
        assert [repr(value) for value in values] == [*map(repr, theirs.get_attr(name))], name


def test_attributes_are_set_of_each_environment():
    env = make()
    env.set_attr("label", ["a", "b", "c"])
    env.set_attr("level", 4)
    assert (env.get_attr("label"), env.call("level")) == (
        ("a", "b", "c"),
        (4, 4, 4),
    )
    with pytest.raises(AttributeError, match="payloads"):
        env.get_attr("payloads")
    with pytest.raises(AttributeError, match=r"reset\(\)"):
        env.set_attr("pose", 0.0)
    with pytest.raises(ValueError, match="3 values"):
        env.set_attr("label", [1, 2])


# --- threads ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 97])
def test_threads_do_not_change_a_bit(count):
    """With more threads than tiles, and a last tile that is not full."""
    theirs = rugged(count, uncertainty="hardware")
    ours = pickle.loads(pickle.dumps(rugged(count, threads=3, uncertainty="hardware")))
    check_equal(ours.reset(seed=5), theirs.reset(seed=5))
    for action in random_actions(ours, LIMIT - 1):
        check_equal(ours.step(action), theirs.step(action))


def test_error_in_a_thread_is_raised_after_all_calls_ended():
    ended = []

    def fails():
        raise ArithmeticError("in a thread")

    with pytest.raises(ArithmeticError, match="in a thread"):
        call_all([lambda: ended.append(0), fails, lambda: ended.append(2)])
    assert sorted(ended) == [0, 2]
