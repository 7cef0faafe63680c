"""What Gymnasium, Stable-Baselines3 and the class docstring promise, for every id."""

from __future__ import annotations

import copy
import json
import pickle
import re
import subprocess
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from clock import HANG
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

import cablebot_gym
from cablebot_baselines.classical import FeedbackLinearization, MotorPD
from cablebot_gym.envs import TERMINATION_REASONS, env_robot
from cablebot_gym.envs.observation import PREVIEWS, observation_layout
from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, find_robot
from cablebot_gym.trajectories import find_trajectory

ROBOTS = {env_id: find_robot(env_robot(env_id)) for env_id in cablebot_gym.ENV_IDS}
each_id = pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)
PLANAR_ID = "CableBot-Planar-v0"
two_ids = pytest.mark.parametrize("env_id", [PLANAR_ID, "CableBot-FlexSpatial-v0"])

# Keywords as a JSON file can contain them.
JSON_KEYWORDS: dict[str, Any] = {
    "trajectory": {"name": "line-spatial", "duration": 1.5},
    "robot": FLEX_SPATIAL.replace(mass=8.0).to_dict(),
    "error_bounds": {"position": 0.02},
    "payload_range": [0.5, 1.5],
    "initial_error_range": [0.001, 0.0, 0.001, 0.0, 0.01, 0.0],
    "cable": "bilateral",
    "reward_weights": {"saturation": 0.5},
    "uncertainty": {
        "parameters": {"stiffness": {"low": -0.2, "high": 0.2, "distribution": "normal", "std": 0.1}},
        "wrench": {"force_mean": [1.0, -1.0, 0.0], "factor": [0.5, 1.5]},
        "sensors": {"position": 1e-4, "motor_angle": 1e-3},
        "delay": 2,
    },
}


def in_new_process(code: str) -> str:
    """Output of a new interpreter that raises warnings as errors."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    return done.stdout


def random_rollout(env, steps=20, seed=3):
    """Observations, rewards and infos of a seeded episode under random actions."""
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    observations, rewards, infos = [observation], [], [info]
    for _ in range(steps):
        observation, reward, _, _, info = env.step(rng.uniform(-1, 1, env.action_space.shape))
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
    return np.array(observations), np.array(rewards), infos


def test_module_prefix_imports_and_makes_each_id():
    code = (
        "import sys, gymnasium as gym\n"
        "assert 'cablebot_gym' not in sys.modules\n"
        f"for env_id in {cablebot_gym.ENV_IDS!r}:\n"
        "    env = gym.make('cablebot_gym:' + env_id)\n"
        "    env.reset(seed=0)\n"
        "    vector = gym.make_vec('cablebot_gym:' + env_id, num_envs=2)\n"
        "    print(env.spec.id, vector.num_envs, type(vector.unwrapped).__name__)\n"
    )
    assert in_new_process(code).splitlines() == [f"{env_id} 2 CableBotVectorEnv" for env_id in cablebot_gym.ENV_IDS]


def test_import_registers_without_loading_numba_torch_or_scipy():
    code = (
        "import sys, cablebot_gym, gymnasium as gym\n"
        "print([i for i in gym.registry if i.startswith('CableBot')])\n"
        "print([m for m in ('numba', 'torch', 'scipy', 'mujoco', 'matplotlib') if m in sys.modules])\n"
    )
    assert in_new_process(code).splitlines() == [str(list(cablebot_gym.ENV_IDS)), "[]"]


def test_each_id_has_its_robot():
    for env_id, robot in ROBOTS.items():
        env = gym.make(env_id)
        assert env.unwrapped.settings.robot == robot
        assert env.action_space.shape == (robot.cables,)
        assert env.observation_space == observation_layout(robot).space()
        assert gym.spec(env_id).max_episode_steps is None


@each_id
@pytest.mark.filterwarnings("error")
def test_checkers_of_gymnasium_and_sb3_find_nothing(env_id):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    for uncertainty in (None, "table6+sensors", {"delay": 3}):
        env = gym.make(env_id, uncertainty=uncertainty)
        checker.check_env(env.unwrapped, warn=True)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("delay", [0, 2])
@each_id
def test_action_out_of_bounds_acts_like_the_bound(env_id, delay):
    """As Gymnasium's own tests demand. Only the record of the raw action and the reward differ."""
    rng = np.random.default_rng(0)
    actions = 3 * rng.uniform(-0.6, 1.0, (60, 2, ROBOTS[env_id].cables))
    raw, clipped = (
        gym.make_vec(env_id, 2, uncertainty={"delay": delay}, termination_radius=9.0, slack_time=9.0) for _ in range(2)
    )
    for env in (raw, clipped):
        env.reset(seed=0)
    for action in actions:
        ours, theirs = raw.step(action), clipped.step(np.clip(action, -1, 1))
        np.testing.assert_array_equal(ours[0], theirs[0])
        different = {name for name, value in ours[4].items() if not np.array_equal(value, theirs[4][name])}
        assert different <= {"commanded_action", "torque_margin", "reward_saturation"}
    assert different
    np.testing.assert_array_equal(ours[4]["commanded_action"], actions[-1 - delay])


def test_spec_survives_json_and_makes_the_same_environment():
    keywords = json.loads(json.dumps(JSON_KEYWORDS))
    env = gym.make("CableBot-FlexSpatial-v0", **keywords)
    spec = EnvSpec.from_json(env.spec.to_json())
    assert spec.kwargs == keywords
    again = gym.make(spec)
    for one, other in zip(random_rollout(env)[:2], random_rollout(again)[:2], strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.unwrapped.settings.robot == env.unwrapped.settings.robot


@two_ids
def test_complete_default_motion_is_truncated_and_not_terminated(env_id):
    robot = ROBOTS[env_id]
    policy = MotorPD(robot) if robot.flexible else FeedbackLinearization(robot)
    env = gym.make(env_id)
    observation, _ = env.reset(seed=0)
    for step in range(1, 801):
        observation, _, terminated, truncated, _ = env.step(policy.predict(observation)[0])
        assert (terminated, truncated) == (False, step == 800), step


LENGTHS = [
    (500.0, {"name": "dwell-planar", "duration": 0.002}, 1),
    (500.0, {"name": "line-planar", "duration": 2.0, "dwell": 0}, 1000),
    (1000.0, "paper-planar", 1000),
    (1000.0, {"name": "line-planar", "duration": 2.0}, 2600),
    (70.0, {"name": "loop-planar", "seed": 10_000}, 155),  # 2.21 s
    (333.0, {"name": "circle-planar", "dwell": 0.0123}, 341),
]


@pytest.mark.filterwarnings("ignore:.*after the episode was terminated")
@pytest.mark.parametrize(("frequency", "trajectory", "steps"), LENGTHS)
def test_step_that_completes_the_motion_truncates_the_episode(frequency, trajectory, steps):
    """A time limit shortens the episode and never lengthens it. Steps after the end are truncated too."""
    keywords = {"trajectory": trajectory, "control_frequency": frequency}
    env = gym.make(PLANAR_ID, **keywords).unwrapped
    for _ in range(2):
        env.reset(seed=0)
        assert env.task.steps == steps
        truncated = [env.step(np.zeros(3))[3] for _ in range(steps + 2)]
        assert truncated == [False] * (steps - 1) + [True] * 3
    for limit in (max(1, steps // 2), 2 * steps):
        limited = gym.make(PLANAR_ID, max_episode_steps=limit, **keywords)
        limited.reset(seed=0)
        truncated = [limited.step(np.zeros(3))[3] for _ in range(min(limit, steps))]
        assert truncated == [False] * (len(truncated) - 1) + [True]


def check_info(info, cables):
    """Info contains finite numbers and arrays, which other libraries stack."""
    for key, value in info.items():
        if key == "termination_reason":
            assert type(value) is int, key
            assert 0 <= value < len(TERMINATION_REASONS), key
        elif isinstance(value, np.ndarray):
            assert value.shape == (cables,), key
            assert value.dtype == (np.bool_ if key == "slack" else np.float64), key
            assert np.all(np.isfinite(value)), key
        else:
            assert type(value) in (float, bool), key
            assert np.isfinite(value), key


@each_id
def test_types_are_pythons_own_and_info_keys_are_constant(env_id):
    env = gym.make(env_id).unwrapped
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=0)
    keys = list(info)
    assert {key for key in keys if key.startswith("reward_")} == {f"reward_{term}" for term in REWARD_TERMS}
    documented = set(re.findall(r"`(\w+)`", CableBotEnv.__doc__.split("## Info")[1].split("## Arguments")[0]))
    assert documented == {key for key in keys if not key.startswith("reward_")}
    check_info(info, env.action_space.shape[0])
    for _ in range(60):
        observation, reward, terminated, truncated, info = env.step(rng.uniform(-2, 2, env.action_space.shape))
        assert (type(reward), type(terminated), type(truncated)) == (float, bool, bool)
        assert list(info) == keys
        assert (info["termination_reason"] != 0) == terminated
        assert observation.dtype == env.observation_space.dtype == np.float64
        check_info(info, env.action_space.shape[0])


@pytest.mark.parametrize("count", [None, 3])
def test_results_are_copies(count):
    """Neither a later step nor writing by the caller changes the other."""
    env, twin = (gym.make(PLANAR_ID) if count is None else gym.make_vec(PLANAR_ID, count) for _ in range(2))
    action = np.full(env.action_space.shape, 0.7)
    observation, info = env.reset(seed=0)
    kept = observation.copy(), {key: np.copy(value) for key, value in info.items()}
    env.step(action)
    np.testing.assert_array_equal(observation, kept[0])
    for key, value in info.items():
        np.testing.assert_array_equal(value, kept[1][key])
    observation[:] = 99.0
    twin.reset(seed=0)
    twin.step(action)
    np.testing.assert_array_equal(env.step(0 * action)[0], twin.step(0 * action)[0])


@each_id
def test_reference_blocks_are_the_motion_now_and_ahead(env_id):
    robot = ROBOTS[env_id]
    trajectory = {"name": f"lemniscate-{robot.kind}", "amplitude": [0.2, 0.1], "duration": 0.3, "dwell": 0.1}
    frequency = 70.0  # 0.5 s are 35 periods; 0.5 s is reached and passed
    env = gym.make(env_id, trajectory=trajectory, control_frequency=frequency, termination_radius=10.0).unwrapped
    wanted = find_trajectory(trajectory, robot.coordinates)
    observation, _ = env.reset(seed=0)
    for k in range(44):
        time = k / frequency
        part = env.layout.split(observation)
        now = wanted(time)
        assert part["time_to_go"][0] == pytest.approx(max(0.5 - time, 0.0), abs=1e-12)
        np.testing.assert_allclose(part["reference_pose"], now.position, atol=1e-12)
        np.testing.assert_allclose(part["reference_velocity"], now.velocity, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(part["reference_acceleration"], now.acceleration, rtol=1e-12, atol=1e-10)
        if robot.flexible:
            np.testing.assert_allclose(part["reference_jerk"], now.jerk, rtol=1e-12, atol=1e-8)
            np.testing.assert_allclose(part["reference_snap"], now.snap, rtol=1e-12, atol=1e-6)
        for ahead in PREVIEWS:
            preview = part[f"preview_{round(ahead * 1000)}ms"]
            np.testing.assert_allclose(preview, wanted(time + ahead).position - now.position, atol=1e-12)
        observation = env.step(np.full(robot.cables, 0.3))[0]
    assert PREVIEWS == (0.02, 0.05, 0.1, 0.2)


@two_ids
def test_pose_and_velocity_blocks_are_the_true_state(env_id):
    env = gym.make(env_id, control_frequency=1000.0).unwrapped
    observations, _, infos = random_rollout(env, steps=30)
    part = env.layout.split(observations)
    np.testing.assert_array_equal(part["pose"][-1], env.pose)
    slope = (part["pose"][1:] - part["pose"][:-1]) * 1000.0
    mean = (part["velocity"][1:] + part["velocity"][:-1]) / 2
    np.testing.assert_allclose(slope, mean, atol=2e-3)
    assert np.abs(part["velocity"]).max() > 0.05
    error = part["pose"] - part["reference_pose"]
    np.testing.assert_allclose(
        [info["tracking_error"] for info in infos], np.linalg.norm(error[:, :3], axis=1), atol=1e-14
    )
    turn = np.abs(error[:, 3:]).max(axis=1) if error.shape[1] > 2 else np.zeros(len(error))
    np.testing.assert_allclose([info["rotation_error"] for info in infos], turn, atol=1e-14)


@two_ids
@pytest.mark.parametrize("known", [True, False])
def test_observation_and_task_contain_nominal_values_and_info_the_true_payload(env_id, known):
    """Only the springs of flexible robots depend on the true payload at the start."""
    robot = ROBOTS[env_id]
    uncertainty = {
        "parameters": {
            "payload": {"low": 0.5, "high": 1.0},
            "platform_mass": {"low": 0.05, "high": 0.1},
            "motor_strength": {"low": 0.05, "high": 0.1},
        }
    }
    env = gym.make(env_id, uncertainty=uncertainty, payload=2.0, payload_known=known).unwrapped
    usual = gym.make(env_id, payload=2.0, payload_known=known).unwrapped
    blind = np.ones(env.layout.size, bool)
    if robot.flexible:
        blind[env.layout.slices()["motor_angle"]] = False
    true = set()
    for seed in range(4):
        (observation, info), (expected, _) = env.reset(seed=seed), usual.reset(seed=seed)
        np.testing.assert_array_equal(observation[blind], expected[blind])
        assert 3.0 <= info["payload"] <= 4.0
        assert info["payload"] == env.truth["payload"]
        true.add(info["payload"])
        observation, _, _, _, later = env.step(np.full(robot.cables, 0.3))
        assert later["payload"] == info["payload"]
        part = env.layout.split(observation)
        assert part["model_payload"][0] == env.task.model_payload == (2.0 if known else 0.0)
        assert part["payload_known"][0] == env.task.payload_known == known
        assert env.task.robot == robot
        for hidden in (info["payload"], env.truth["platform_mass"], env.truth["motor_strength"][0]):
            assert f"{hidden}" not in repr(env.task)
    assert len(true) == 4


@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"]
)
@pytest.mark.parametrize("count", [None, 2, 40])
@two_ids
def test_copy_in_mid_episode_continues_independently(env_id, count, duplicate):
    """Excludes a copy whose kernel reads other memory than its actions are written to."""
    keywords = {"uncertainty": "table6+sensors", "payload": 1.0}
    if count != 40:
        keywords["render_mode"] = "rgb_array"
    env = gym.make(env_id, **keywords) if count is None else gym.make_vec(env_id, count, **keywords)
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (12, *env.action_space.shape))

    def go_on(env, actions):
        return [value for action in actions for value in flat(env.step(action))] + flat(env.reset())

    env.reset(seed=3)
    env.step(actions[0])
    if env.render_mode:
        env.render()
    one, other = duplicate(env), duplicate(env)
    elsewhere = go_on(other, -actions)  # first, so that shared memory has an effect
    original, again = go_on(env, actions), go_on(one, actions)
    for value, same in zip(original, again, strict=True):
        np.testing.assert_array_equal(value, same)
    assert any(not np.array_equal(value, different) for value, different in zip(original, elsewhere, strict=True))
    if env.render_mode:
        np.testing.assert_array_equal(env.render(), one.render())


def test_copies_need_no_compilation_of_their_own():
    """Copies of read-only arrays are writable, which is another type for numba: seconds of compilation."""
    constants = gym.make(PLANAR_ID).unwrapped._simulation._constants
    assert all(value.flags.writeable for value in constants if isinstance(value, np.ndarray))


def flat(result):
    """Arrays that reset or step returned."""
    *values, info = result
    return [np.asarray(value) for value in (*values, *(info[name] for name in sorted(info)))]


@pytest.mark.parametrize("make", [gym.make, lambda *a, **k: gym.make_vec(*a, num_envs=2, **k)], ids=["one", "vector"])
def test_robot_of_another_kind_raises_when_the_environment_is_made(make):
    make("CableBot-Planar-v0", robot=PLANAR.replace(mass=2.0, name="mine")).reset(seed=0)
    with pytest.raises(ValueError, match="use CableBot-FlexPlanar-v0"):
        make("CableBot-Planar-v0", robot=FLEX_PLANAR)
    CableBotEnv(robot=SPATIAL).reset(seed=0)  # a class without id takes any robot
