"""The vector environment equals single ones to the last bit: here once, over all ids, keywords and
reset options. Other tests then use one form only."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.testing import assert_array_equal
from oracles.episodes import (
    PLANAR,
    ROBOTS,
    check_equal,
    each_id,
    make,
    make_vector,
    random_actions,
    two_ids,
)

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.envs.settings import KEYWORDS, RESET_OPTIONS

MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]
each_mode = pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)

# Start errors close to the termination radius: under random actions some episodes end early, the
# others at the time limit.
LIMIT = 12
RUGGED = {
    "payload_range": (0.0, 2.0),
    "initial_error_range": [0.067, 0.067],
    "control_frequency": 100.0,
    "max_episode_steps": LIMIT,
}


def rugged(count=4, **keywords):
    return make_vector(PLANAR, count, **RUGGED, **keywords)


def held_actions(env, steps):
    """Random actions, each held for some steps: some beyond ±1, and many that slacken cables."""
    return np.repeat(random_actions(env, steps // 4 + 1, -1.0, 1.5), 4, axis=0)[:steps]


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


def check_numbers(info):
    """Arrays that other libraries take: DLPack takes no strings, and JAX contiguous ones only."""
    for name, value in info.items():
        if name == "final_info":
            check_numbers(value)
        elif name != "final_obs":  # an array of arrays, as in Gymnasium
            assert value.dtype.kind in "bfi"
            assert value.flags.c_contiguous


def check_run(env_id, count, mode, actions, **keywords):
    """Compares a run with single environments. Returns the reasons of its ends, and the numbers of
    restarts and of time limits."""
    ours = make_vector(env_id, count, autoreset_mode=mode, **keywords)
    theirs = SyncVectorEnv([lambda: gym.make(env_id, **keywords)] * count, autoreset_mode=mode)
    assert ours.autoreset_mode is mode  # TorchRL reads it
    for name in ("single_observation_space", "observation_space", "action_space"):
        assert getattr(ours, name) == getattr(theirs, name)
    check_same(ours.reset(seed=7), theirs.reset(seed=7))
    reasons = set()
    restarts = 0
    truncations = 0
    for action in actions:
        result = ours.step(action)
        check_same(result, theirs.step(action))
        check_numbers(result[-1])
        observation, _, terminated, truncated, info = result
        assert observation in ours.observation_space
        ended = terminated | truncated
        codes = info.get("final_info", info)["termination_reason"]
        reasons |= {TERMINATION_REASONS[code] for code in codes}
        restarts += ended.sum()
        truncations += truncated.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            again = {"options": {"reset_mask": ended}}
            check_same(ours.reset(**again), theirs.reset(**again))
    assert [*map(repr, ours.tasks)] == [*map(repr, theirs.get_attr("task"))]
    assert_array_equal(ours.pose, theirs.get_attr("pose"))
    assert ours.np_random_seed == theirs.np_random_seed
    return reasons, restarts, truncations


@each_mode
@pytest.mark.parametrize("count", [1, 18])
def test_every_environment_equals_the_single_one(mode, count):
    actions = held_actions(rugged(count), 60 if count == 1 else 14)
    reasons, restarts, truncations = check_run(PLANAR, count, mode, actions, **RUGGED)
    assert restarts >= count
    assert "tracking_error" in reasons
    assert count == 1 or ("slack" in reasons and truncations > 0)


def sensors_of(robot):
    """All sensors that a robot can have."""
    if robot.coordinates == 6:
        return "winches+tensions+imu"
    return "winches+tensions"


DRAWN = {
    "payload_range": (0.0, 2.0),
    "initial_error_range": lambda robot: [0.005] * robot.coordinates,
    "uncertainty": "hardware",
    "measurement": sensors_of,
    "terminate_on_violation": True,
    "normalised_observation": True,
    "observation_dtype": "float32",
}


def cable_of(robot):
    """Only cables that pull have friction that grows with the load."""
    if np.any(robot.load_friction):
        return "unilateral"
    return "bilateral"


GIVEN = {
    "robot": lambda robot: robot.replace(name="mine", mass=1.2 * robot.mass),
    "payload": 2.0,
    "payload_known": False,
    "model_payload_factor": 0.5,
    "trajectory": lambda robot: {"name": f"line-{robot.kind}", "duration": 0.04, "dwell": 0.01},
    "initial_error": lambda robot: [0.055] * robot.coordinates,
    "error_bounds": {"position": 0.02},
    "cable": cable_of,
    "control_frequency": 250.0,
    "substeps": 16,
    "reward_weights": {"position": 3.0},
}


def of_robot(values, robot):
    return {name: value(robot) if callable(value) else value for name, value in values.items()}


@pytest.mark.parametrize("keywords", [DRAWN, GIVEN], ids=["drawn", "given"])
@each_id
def test_every_keyword_has_the_effect_of_the_single_environment(env_id, keywords):
    assert {*DRAWN, *GIVEN} == {*KEYWORDS}
    robot = ROBOTS[env_id]
    actions = np.random.default_rng(0).uniform(0.0, 0.9, (40, 3, robot.cables))
    mode = AutoresetMode.SAME_STEP if keywords is DRAWN else AutoresetMode.NEXT_STEP
    settings = of_robot(keywords, robot)
    _, restarts, _ = check_run(env_id, 3, mode, actions, max_episode_steps=37, **settings)
    assert restarts >= 3


PER_ENVIRONMENT = {
    "payload": [0.5, 0.25, 1.0],
    "payload_known": [True, False, True],
    "model_payload_factor": [0.5, 1.0, 2.0],
    "initial_error": lambda robot: 2e-4 * np.arange(3.0 * robot.coordinates).reshape(3, -1),
    "uncertainty": ["table6+sensors", {"delay": [1, 3]}, {"delay": 3}],
}
FOR_ALL = {
    "trajectory": lambda robot: {"name": f"line-{robot.kind}", "duration": 3.0},
    "error_bounds": {"position": 0.5},
}
LATER = {
    "trajectory": lambda robot: {"name": f"line-{robot.kind}", "duration": 0.016, "dwell": 0},
    "uncertainty": ["hardware", None, {"delay": 7}],
    "payload": [1.5, 2.0, 0.75],
    "initial_error": lambda robot: 3e-4 * np.arange(3.0 * robot.coordinates).reshape(3, -1),
}


def options_of(options, index):
    """Reset options of one environment of three."""
    return {
        name: value[index] if name in (*PER_ENVIRONMENT, "noise_seed") else value
        for name, value in options.items()
    }


@two_ids
def test_reset_options_reach_the_environments_of_the_mask(env_id):
    """Keywords reach them, too. Motions of other lengths and other delays in the middle of other
    episodes make tables and queues grow and shrink."""
    robot = ROBOTS[env_id]
    given = of_robot(PER_ENVIRONMENT | FOR_ALL, robot)
    env = make_vector(env_id, 3, autoreset_mode="Disabled", **given)
    singles = [make(env_id, **options_of(given, index)) for index in range(3)]
    first = given | {"noise_seed": [9, 5, 7]}
    assert {*first} == {*RESET_OPTIONS}
    restarts = {
        0: ([4, 5, 6], {}, {}),
        6: ([9, None, None], of_robot(LATER, robot), {"reset_mask": np.array([True, False, True])}),
        12: ([None] * 3, {}, {"reset_mask": np.array([False, True, True])}),
        16: ([7, 8, None], first, {"reset_mask": np.array([True, True, False])}),
    }

    def check_rows(results, expected):
        for index, row in expected.items():
            for values, value in zip(results[:-1], row[:-1], strict=True):
                check_equal(values[index], value, f"result of {index}")
            check_equal({name: values[index] for name, values in results[-1].items()}, row[-1])
        for index, single in enumerate(singles):
            check_equal({name: rows[index] for name, rows in env.truth.items()}, single.truth)

    for step, action in enumerate(held_actions(env, 20) * 0.3):
        if step in restarts:
            seeds, options, mask = restarts[step]
            rows = {
                index: singles[index].reset(seed=seeds[index], options=options_of(options, index))
                for index in np.flatnonzero(mask.get("reset_mask", np.ones(3)))
            }
            check_rows(env.reset(seed=seeds, options=options | mask), rows)
        rows = {index: single.step(action[index]) for index, single in enumerate(singles)}
        check_rows(env.step(action), rows)


# --- ends of episodes ---------------------------------------------------------------------------------------------


def test_unseeded_environments_differ():
    payloads = [env.reset()[1]["payload"] for env in (rugged(), rugged())]
    assert len(np.unique(payloads)) == 8


def test_reset_mask_keeps_the_automatic_resets_of_others():
    """They forget the options of the episode before."""
    env = make_vector(PLANAR, 2, autoreset_mode="NextStep", max_episode_steps=2)
    env.reset(seed=0)
    actions = np.full((2, 3), 0.1)
    env.step(actions)
    assert env.step(actions)[3].all()
    env.reset(options={"reset_mask": np.array([True, False]), "payload": 1.0})
    results = [env.step(actions) for _ in range(3)]
    ends = [truncated.tolist() for _, _, _, truncated, _ in results]
    assert ends == [[False, False], [True, False], [False, True]]
    assert [info["payload"][0] for *_, info in results] == [1.0, 1.0, 0.0]
