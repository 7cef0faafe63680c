"""What Gymnasium, Stable-Baselines3 and the class docstring promise."""

import copy
import pickle
import re
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from clock import HANG
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    check_equal,
    make,
    make_vector,
    random_actions,
    rollout,
    two_ids,
)

import cablebot_gym
from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.motions import find_trajectory

# --- registration -------------------------------------------------------------------------------------------------


def test_import_registers_without_loading_heavy_libraries():
    code = (
        "import sys, cablebot_gym, gymnasium as gym\n"
        "print([i for i in gym.registry if i.startswith('CableBot')])\n"
        "heavy = 'numba', 'torch', 'scipy', 'mujoco', 'matplotlib', 'cablebot_gym.evaluation'\n"
        "print([m for m in heavy if m in sys.modules])\n"
    )
    ended = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=HANG
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines() == [str(list(cablebot_gym.ENV_IDS)), "[]"]


@pytest.mark.parametrize(
    ("env_id", "keywords"),
    [
        (PLANAR, {"uncertainty": {"delay": 3, "sensors": {"position": 1e-4}}}),
        (
            FLEX_SPATIAL,
            {
                "measurement": "winches+tensions+imu",
                "normalised_observation": True,
                "uncertainty": "hardware",
            },
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_checkers_of_gymnasium_and_sb3_raise_nothing(env_id, keywords):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = make(env_id, **keywords)
    checker.check_env(env, warn=True)
    check_env(env, skip_render_check=True)


# --- ends of episodes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frequency", "trajectory", "steps"),
    [
        (500.0, {"name": "dwell-planar", "duration": 0.002}, 1),
        (333.0, {"name": "dwell-planar", "duration": 0.1246}, 41),
    ],
)
def test_step_that_completes_the_motion_truncates(frequency, trajectory, steps):
    """Steps after the end are truncated too."""
    keywords = {"trajectory": trajectory, "control_frequency": frequency}
    taut = np.full((steps + 2, 3), 0.1)
    episode = rollout(make(PLANAR, **keywords), taut, seed=0)
    assert episode.truncated.tolist() == [False] * (steps - 1) + [True] * 3


# --- results ------------------------------------------------------------------------------------------------------


@two_ids
def test_types_are_pythons_own_and_info_keys_are_constant(env_id):
    """Info contains finite numbers and arrays, which other libraries stack, under the names of the
    manual."""
    env = make(env_id)
    _, info = env.reset(seed=0)
    types = {key: type(value) for key, value in info.items()}
    assert set(types.values()) == {int, float, bool, np.ndarray}
    terms = {f"reward_{term}" for term in REWARD_TERMS}
    assert not any(info[term] for term in terms)  # a reset earns nothing
    section = CableBotEnv.__doc__.split("## Info")[1].split("## Arguments")[0]
    assert {*re.findall(r"`(\w+)`", section)} | terms == {*info}
    for action in random_actions(env, 20, -2, 2):
        _, reward, terminated, truncated, info = env.step(action)
        assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
        assert {key: type(value) for key, value in info.items()} == types
        assert all(np.all(np.isfinite(value)) for value in info.values())


@pytest.mark.parametrize("count", [None, 3])
def test_results_are_copies(count):
    """Neither a later step nor writing by the caller changes the other."""
    keywords = {"uncertainty": {"delay": 1}}
    env, twin = (
        make_vector(PLANAR, count, **keywords) if count else make(PLANAR, **keywords)
        for _ in range(2)
    )
    action = np.full(env.action_space.shape, 0.7)
    results = env.reset(seed=0)
    before = copy.deepcopy(results)
    env.step(action)
    check_equal(results, before)
    results[0][:] = 99.0
    env.truth["base_anchors"][:] = 99.0
    twin.reset(seed=0)
    twin.step(action.copy())
    action[:] = 0.0
    check_equal(env.step(action), twin.step(action))
    check_equal(env.truth, twin.truth)


@two_ids
def test_reference_blocks_are_the_motion_now_and_ahead(env_id):
    robot = ROBOTS[env_id]
    amplitude = [0.2, 0.1]
    trajectory = {"name": f"lemniscate-{robot.kind}", "amplitude": amplitude}
    trajectory |= {"duration": 0.3, "dwell": 0.1}
    frequency = 70.0  # 0.5 s are 35 periods; 0.5 s is reached and passed
    wide = {"error_bounds": {"position": 1.0}}
    env = make(env_id, trajectory=trajectory, control_frequency=frequency, **wide)
    expected = find_trajectory(trajectory, robot.coordinates)
    orders = {"velocity": 1e-12, "acceleration": 1e-10}
    if robot.flexible:
        orders |= {"jerk": 1e-8, "snap": 1e-6}
    episode = rollout(env, np.full((44, robot.cables), 0.3), seed=0)
    blocks = env.layout.split(episode.observations)
    times = np.arange(45) / frequency
    now = expected(times)
    assert_allclose(blocks["time_to_go"][:, 0], np.maximum(0.5 - times, 0.0), atol=1e-12)
    assert_allclose(blocks["reference_pose"], now.position, atol=1e-12)
    for order, tolerance in orders.items():
        values = blocks[f"reference_{order}"]
        assert_allclose(values, getattr(now, order), rtol=1e-12, atol=tolerance)
    for milliseconds in (20, 50, 100, 200):
        ahead = expected(times + milliseconds / 1000).position
        assert_allclose(blocks[f"preview_{milliseconds}ms"], ahead - now.position, atol=1e-12)


@pytest.mark.parametrize(("env_id", "known"), [(PLANAR, True), (FLEX_SPATIAL, False)])
def test_observation_and_task_hide_the_true_values(env_id, known):
    """Only the springs of flexible robots depend on the true payload at the start, and only info
    has it."""
    names = ("payload", "platform_mass", "motor_strength")
    uncertainty = {"parameters": {name: {"low": 0.5, "high": 1.0} for name in names}}
    keywords = {"payload": 2.0, "payload_known": known}
    env = make(env_id, uncertainty=uncertainty, **keywords)
    nominal = make(env_id, **keywords)
    visible = np.ones(env.layout.size, bool)
    if ROBOTS[env_id].flexible:
        visible[env.layout.slices()["motor_angle"]] = False
    observation, info = env.reset(seed=1)
    assert 3.0 <= info["payload"] == env.truth["payload"] <= 4.0
    assert_array_equal(observation[visible], nominal.reset(seed=1)[0][visible])
    blocks = env.layout.split(env.step(np.full(ROBOTS[env_id].cables, 0.3))[0])
    assert blocks["model_payload"][0] == env.task.model_payload == (2.0 if known else 0.0)
    assert blocks["payload_known"][0] == env.task.payload_known == known
    assert env.task.robot == ROBOTS[env_id]
    assert str(info["payload"]) not in repr(env.task)


# --- copies -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "duplicate"),
    [(None, copy.deepcopy), (40, lambda env: pickle.loads(pickle.dumps(env)))],
)
def test_copy_in_mid_episode_continues_independently(count, duplicate):
    """Excludes a copy whose kernel reads other memory than its actions are written to."""
    keywords = {"uncertainty": "table6+sensors", "payload": 1.0}
    if count is None:
        env = gym.make(FLEX_SPATIAL, render_mode="rgb_array", **keywords)
    else:
        env = gym.make_vec(FLEX_SPATIAL, count, **keywords)
    actions = random_actions(env, 12, -0.2, 0.2)

    def go_on(env, actions):
        results = [*(env.step(action) for action in actions), env.reset()]
        return [*results, env.render()] if env.render_mode else results

    env.reset(seed=3)
    env.step(actions[0])
    if env.render_mode:
        env.render()
    twin, stray = duplicate(env), duplicate(env)
    elsewhere = go_on(stray, -actions)  # first, so that shared memory has an effect
    results = go_on(env, actions)
    assert not np.array_equal(results[0][0], elsewhere[0][0])
    for ours, theirs in zip(results, go_on(twin, actions), strict=True):
        check_equal(ours, theirs)


def test_copies_need_no_compilation_of_their_own():
    """Copies of read-only arrays are writable, which is another type for numba: seconds of
    compilation."""
    constants = make(PLANAR)._simulation._constants
    assert all(value.flags.writeable for value in constants if isinstance(value, np.ndarray))
