"""What Gymnasium, Stable-Baselines3 and a reader of the docstring may rely on, for every id."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import json
import pickle
import re
import subprocess
import sys
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

import cablebot_gym
from cablebot_baselines.classical import FeedbackLinearization, MotorPD
from cablebot_gym.envs import outcome, register_envs
from cablebot_gym.envs.observation import PREVIEWS, observation_layout
from cablebot_gym.envs.outcome import TERMINATION_REASONS
from cablebot_gym.envs.settings import make_settings
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.trajectories import Reference, find_trajectory
from cablebot_gym.uncertainty import PARAMETERS, ExternalWrench, ParameterDistribution, SensorNoise

ROBOTS = {
    "CableBot-Planar-v0": PLANAR,
    "CableBot-Spatial-v0": SPATIAL,
    "CableBot-FlexPlanar-v0": FLEX_PLANAR,
    "CableBot-FlexSpatial-v0": FLEX_SPATIAL,
}
each_id = pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)

# Plain data that a JSON file can hold, one for each id, with every keyword whose value is structured.
JSON_KEYWORDS: dict[str, dict[str, Any]] = {
    "CableBot-Planar-v0": {
        "trajectory": {"name": "line-planar", "duration": 1.5, "end": [0.05, 0.1]},
        "robot": json.loads(json.dumps(PLANAR.replace(mass=2.0).to_dict())),
        "error_bounds": {"position": 0.02},
        "payload_range": [0.5, 1.5],
        "initial_error": [0.01, 0.0],
        "reward_weights": {"slack": 0.5},
        "uncertainty": {"wrench": {"force_mean": [1.0, -1.0], "factor": [0.5, 1.5]}, "delay": 2},
    },
    "CableBot-Spatial-v0": {
        "trajectory": {"name": "circle-spatial", "duration": 1.5, "radius": 0.05},
        "robot": json.loads(json.dumps(SPATIAL.replace(mass=8.0).to_dict())),
        "error_bounds": {"position": 0.02, "rotation": 0.03},
        "payload": 1.5,
        "initial_error_range": [0.001, 0.0, 0.001, 0.0, 0.01, 0.0],
        "cable": "bilateral",
        "uncertainty": {
            "parameters": {
                "platform_mass": {"low": -0.1, "high": 0.2, "distribution": "normal", "mean": 0.05, "std": 0.1},
                "base_anchors": {"low": -0.01, "high": 0.01, "relative": False},
            },
        },
    },
    "CableBot-FlexPlanar-v0": {
        "trajectory": {"name": "lemniscate-planar", "duration": 2.0},
        "robot": json.loads(json.dumps(FLEX_PLANAR.replace(mass=1.5).to_dict())),
        "uncertainty": "table6+sensors",
    },
    "CableBot-FlexSpatial-v0": {
        "trajectory": {"name": "line-spatial", "duration": 1.5},
        "robot": json.loads(json.dumps(FLEX_SPATIAL.replace(mass=8.0).to_dict())),
        "error_bounds": {"position": 0.02},
        "uncertainty": {
            "parameters": {"stiffness": {"low": -0.2, "high": 0.2, "each": False}},
            "sensors": {"position": 1e-4, "motor_angle": 1e-3},
        },
    },
}


def in_new_process(code: str) -> str:
    """What a fresh interpreter prints, warnings as errors."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def random_rollout(env, steps=20, seed=3, scale=1.0):
    """Observations, rewards and infos of a seeded episode under random commands."""
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    observations, rewards, infos = [observation], [], [info]
    for _ in range(steps):
        observation, reward, _, _, info = env.step(scale * rng.uniform(-1, 1, env.action_space.shape))
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
    return np.array(observations), np.array(rewards), infos


def blown_up(env_id):
    """A single environment and options for its reset under which the state soon ceases to be finite."""
    if ROBOTS[env_id].planar:  # starts on an anchor, so that a cable has no direction
        env = gym.make(env_id, trajectory="dwell-planar").unwrapped
        return env, {"initial_error": PLANAR.base[0]}
    if ROBOTS[env_id].flexible:  # a platform anchor on its base anchor
        env = gym.make(env_id, trajectory="dwell-spatial").unwrapped
        robot = ROBOTS[env_id]
        start = np.append(robot.base[0] - robot.platform[0], np.zeros(3))
        return env, {"initial_error": start - env.settings.trajectory(0.0).position}
    return gym.make(env_id, control_frequency=20.0, substeps=1).unwrapped, None  # steps far too long for the plant


# ------------------------------------------------------------------------------------------- making, registering


def test_module_prefix_makes_each_id_where_nobody_imported_the_package():
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


def test_registering_again_neither_warns_nor_replaces_a_spec():
    before = {env_id: gym.registry[env_id] for env_id in cablebot_gym.ENV_IDS}
    register_envs()
    importlib.reload(cablebot_gym)
    assert all(gym.registry[env_id] is spec for env_id, spec in before.items())


def test_ids_and_their_robots_are_the_contracts():
    assert set(ROBOTS) <= set(cablebot_gym.ENV_IDS)
    for env_id, robot in ROBOTS.items():
        assert gym.make(env_id).unwrapped.settings.robot == robot
        assert gym.make(env_id).action_space.shape == (robot.cables,)


@each_id
def test_sb3_check_env_finds_nothing_even_as_warning(env_id):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(env_id).unwrapped, warn=True)


@each_id
def test_checkers_find_nothing_under_uncertainty_either(env_id):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gym.make(env_id, uncertainty="table6+sensors")
    check_env(env.unwrapped)
    checker.check_env(env.unwrapped, warn=True)
    checker.check_env(gym.make(env_id, uncertainty={"delay": 3}).unwrapped, warn=True)


@each_id
def test_spec_is_plain_text_with_the_time_limit_and_no_wrappers(env_id):
    spec = gym.spec(env_id)
    assert isinstance(spec.entry_point, str)
    assert isinstance(spec.vector_entry_point, str)
    assert spec.max_episode_steps == 500
    assert spec.additional_wrappers == ()
    assert spec.nondeterministic is False
    assert json.loads(json.dumps(spec.kwargs)) == spec.kwargs


@each_id
@pytest.mark.parametrize("with_keywords", [False, True], ids=["plain", "keywords"])
def test_spec_survives_json_and_makes_the_same_environment(env_id, with_keywords):
    env = gym.make(env_id, **(JSON_KEYWORDS[env_id] if with_keywords else {}))
    spec = EnvSpec.from_json(env.spec.to_json())
    assert spec.to_json() == env.spec.to_json()
    for key, value in (JSON_KEYWORDS[env_id] if with_keywords else {}).items():
        assert spec.kwargs[key] == value  # a keyword that the spec forgot
    again = gym.make(spec)
    for one, other in zip(random_rollout(env)[:2], random_rollout(again)[:2], strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.unwrapped.settings.robot == env.unwrapped.settings.robot


@each_id
def test_time_limit_truncates_at_500_and_the_bare_env_never(env_id):
    robot = ROBOTS[env_id]
    policy = MotorPD(robot) if robot.flexible else FeedbackLinearization(robot)
    limited, bare = gym.make(env_id), gym.make(env_id).unwrapped
    observation, _ = limited.reset(seed=0)
    bare.reset(seed=0)
    for step in range(1, 701):
        action, _ = policy.predict(observation)
        observation, _, terminated, truncated, _ = bare.step(action)
        assert (terminated, truncated) == (False, False), step
        if step <= 500:
            _, _, terminated, truncated, _ = limited.step(action)
            assert (terminated, truncated) == (False, step == 500), step


# ------------------------------------------------------------------------------------------- types, bounds, info


def check_info(info, cables):
    """Info holds what the contract lets it hold: floats, arrays and one name, all finite."""
    for key, value in info.items():
        if key == "termination_reason":
            assert type(value) is str, key
            assert value in TERMINATION_REASONS, key
        elif isinstance(value, np.ndarray):
            assert value.shape == (cables,), key
            assert value.dtype == (np.bool_ if key == "slack" else np.float64), key
            assert np.all(np.isfinite(value)), key
        else:
            assert type(value) in (float, bool), key
            assert np.isfinite(value), key


CONTRACT_INFO = {
    *("time", "payload", "tracking_error", "rotation_error", "tensions", "torques", "motor_speeds", "commanded_action"),
    *("torque_margin", "slack", "termination_reason"),
}


@each_id
def test_types_are_pythons_own_and_info_keys_never_change(env_id):
    env = gym.make(env_id).unwrapped
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=0)
    keys = list(info)
    assert set(keys) >= CONTRACT_INFO
    assert {key for key in keys if key.startswith("reward_")} == {
        f"reward_{term}" for term in ("position", "rotation", "saturation", "slack", "failure")
    }
    check_info(info, env.action_space.shape[0])
    for _ in range(120):
        observation, reward, terminated, truncated, info = env.step(rng.uniform(-2, 2, env.action_space.shape))
        assert type(reward) is float
        assert type(terminated) is bool
        assert type(truncated) is bool
        assert list(info) == keys
        assert (info["termination_reason"] != "") == terminated
        assert observation.dtype == env.observation_space.dtype == np.float64
        check_info(info, env.action_space.shape[0])


@each_id
def test_a_blown_up_state_leaves_info_finite_and_the_observation_in_the_box(env_id):
    env, options = blown_up(env_id)
    assert np.all(np.isfinite(env.observation_space.low))
    assert np.all(np.isfinite(env.observation_space.high))
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=1, options=options)
    keys, reasons = list(info), set()
    for _ in range(600):
        action = rng.choice([-5.0, 5.0], env.action_space.shape)
        observation, reward, terminated, _, info = env.step(action)
        assert observation in env.observation_space
        assert np.isfinite(reward)
        assert list(info) == keys
        check_info(info, env.action_space.shape[0])
        reasons.add(info["termination_reason"])
        assert terminated == (info["termination_reason"] != "")
    assert "non_finite" in reasons  # else nothing was blown up, and the test says nothing


@each_id
def test_results_are_copies_that_the_next_step_leaves_alone(env_id):
    env = gym.make(env_id).unwrapped
    observation, info = env.reset(seed=0)
    kept = observation.copy(), {key: np.copy(value) for key, value in info.items()}
    env.step(np.full(env.action_space.shape, 0.7))
    np.testing.assert_array_equal(observation, kept[0])
    for key, value in info.items():
        np.testing.assert_array_equal(value, kept[1][key])
    observation[:] = 99.0  # nor does the caller's writing change the environment
    twin = gym.make(env_id).unwrapped
    twin.reset(seed=0)
    twin.step(np.full(env.action_space.shape, 0.7))
    zero = np.zeros(env.action_space.shape)
    np.testing.assert_array_equal(env.step(zero)[0], twin.step(zero)[0])


@each_id
def test_same_seed_and_commands_give_the_same_episode_to_the_last_bit(env_id):
    keywords = {"payload_range": (0.0, 2.0), "initial_error_range": np.full(ROBOTS[env_id].coordinates, 0.002)}
    first = random_rollout(gym.make(env_id, **keywords), steps=40)
    again = random_rollout(gym.make(env_id, **keywords), steps=40)
    other = random_rollout(gym.make(env_id, **keywords), steps=40, seed=4)
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
    assert first[2][-1]["payload"] == again[2][-1]["payload"] != other[2][-1]["payload"]


@each_id
def test_every_motors_command_reaches_the_plant(env_id):
    env = gym.make(env_id).unwrapped

    def after(action):
        env.reset(seed=0)
        return env.step(action)[0]

    rest = np.full(env.action_space.shape, 0.5)
    for motor in range(len(rest)):
        nudged = rest.copy()
        nudged[motor] += 0.1
        difference = after(nudged) - after(rest)
        least = 1e-5 if ROBOTS[env_id].flexible else 1e-4  # through springs it takes its time
        assert np.abs(difference[env.layout.slices()["velocity"]]).max() > least, motor


# ------------------------------------------------------------------------------------------------- observation


@each_id
def test_no_observation_component_is_constant(env_id):
    kind = "planar" if ROBOTS[env_id].planar else "spatial"
    env = gym.make(env_id).unwrapped
    rng = np.random.default_rng(0)
    seen = []
    for options in ({"trajectory": f"line-{kind}", "payload": 2.0}, {"payload_known": False, "payload": 1.0}):
        observation, _ = env.reset(seed=0, options=options)
        seen.append(observation)
        for _ in range(60):
            seen.append(env.step(rng.uniform(0, 1, env.action_space.shape))[0])
    moved = np.ptp(np.array(seen), axis=0)
    still = [name for name, part in env.layout.split(moved).items() if not np.all(part > 1e-9)]
    assert still == []


@each_id
def test_docstring_table_is_the_layout(env_id):
    robot = ROBOTS[env_id]
    section = CableBotEnv.__doc__.split("## Observation space")[1].split("## ")[0]
    rows = re.findall(r"^ *\| `(\w+)` \| (\w+) \| (.+?) \|$", section, flags=re.MULTILINE)
    sizes, only = {"n": robot.coordinates, "m": robot.cables}, "flexible only: "
    documented = [
        (name, sizes.get(size) or int(size), meaning.removeprefix(only))
        for name, size, meaning in rows
        if robot.flexible or not meaning.startswith(only)
    ]
    layout = observation_layout(robot)
    assert documented == [(block.name, block.size, block.meaning) for block in layout.blocks]
    assert gym.make(env_id).observation_space == layout.space()


@each_id
def test_docstring_names_every_info_key_argument_and_termination(env_id):
    """An undocumented key, keyword or reason fails, and so does one that is documented only."""
    text = CableBotEnv.__doc__
    info = gym.make(env_id).unwrapped.reset(seed=0)[1]
    quoted = set(re.findall(r"`(\w+)`", text.split("## Info")[1].split("## Arguments")[0]))
    undocumented = [key for key in info if key not in quoted and not key.startswith("reward_")]
    assert undocumented == ["termination_reason"]  # stands under Termination
    assert "termination_reason" in text
    assert sorted(quoted - set(info)) == ["action_time"] * ("action_time" not in info)
    rows = re.findall(
        r"^ *\| `(\w+)`\*? \|", text.split("## Arguments")[1].split("## Uncertainty")[0], flags=re.MULTILINE
    )
    assert set(rows) == set(inspect.signature(make_settings).parameters) - {"count"}
    reasons = re.findall(r"^ *\d\. `(\w+)`:", text.split("## Termination")[1].split("## Truncation")[0], re.MULTILINE)
    assert set(reasons) == set(TERMINATION_REASONS) - {""}


def test_docstring_names_every_field_of_an_uncertainty():
    section = CableBotEnv.__doc__.split("## Uncertainty")[1].split("## Version history")[0]
    fields = {
        field.name
        for kind in (ParameterDistribution, ExternalWrench, SensorNoise)
        for field in dataclasses.fields(kind)
    }
    assert fields | set(PARAMETERS) <= set(re.findall(r"`(\w+)`", section))


@each_id
def test_layout_table_has_one_line_for_each_block_and_covers_the_observation(env_id):
    layout = observation_layout(ROBOTS[env_id])
    lines = layout.table().splitlines()[2:]
    assert [re.search(r"`(\w+)`", line)[1] for line in lines] == list(layout.slices())
    ends = [0, *np.cumsum([block.size for block in layout.blocks])]
    assert [(block.slice.start, block.slice.stop) for block in layout.blocks] == list(pairwise(ends))
    assert gym.make(env_id).observation_space.shape == (layout.size,) == (ends[-1],)


@each_id
def test_unit_of_a_derivative_has_its_power_of_the_second_for_angles_too(env_id):
    robot = ROBOTS[env_id]
    orders = {"velocity": "", "acceleration": "²", "jerk": "³", "snap": "⁴"}
    for block in observation_layout(robot).blocks:
        order = orders.get(block.name.removeprefix("reference_"))
        if order is not None:
            assert block.unit == (f"m/s{order}" if robot.planar else f"m/s{order}, rad/s{order}")


@each_id
@pytest.mark.parametrize("motion", ["paper", "line", "lemniscate"])
def test_reference_blocks_are_the_motion_now_and_ahead_not_one_step_off(env_id, motion):
    robot = ROBOTS[env_id]
    kind = "planar" if robot.planar else "spatial"
    trajectory = {"name": f"{motion}-{kind}", "duration": 0.3}
    frequency = 70.0  # 0.3 s are 21 periods; 0.3 s is reached and passed
    env = gym.make(env_id, trajectory=trajectory, control_frequency=frequency, termination_radius=10.0).unwrapped
    wanted = find_trajectory(trajectory, robot.coordinates)
    observation, _ = env.reset(seed=0)
    for k in range(30):
        time = k / frequency
        part = env.layout.split(observation)
        now = wanted(time)
        assert part["time_to_go"][0] == pytest.approx(max(0.3 - time, 0.0), abs=1e-12)
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


@each_id
def test_pose_and_velocity_blocks_are_the_true_state(env_id):
    env = gym.make(env_id, control_frequency=1000.0).unwrapped
    observations, _, infos = random_rollout(env, steps=30)
    part = env.layout.split(observations)
    np.testing.assert_array_equal(part["pose"][-1], env.pose)
    slope = (part["pose"][1:] - part["pose"][:-1]) * 1000.0
    mean = (part["velocity"][1:] + part["velocity"][:-1]) / 2
    np.testing.assert_allclose(slope, mean, atol=2e-3)
    assert np.abs(part["velocity"]).max() > 0.05  # else the comparison is of zeros
    error = part["pose"] - part["reference_pose"]
    np.testing.assert_allclose(
        [info["tracking_error"] for info in infos], np.linalg.norm(error[:, :3], axis=1), atol=1e-14
    )
    turn = np.abs(error[:, 3:]).max(axis=1) if error.shape[1] > 2 else np.zeros(len(error))
    np.testing.assert_allclose([info["rotation_error"] for info in infos], turn, atol=1e-14)


@dataclasses.dataclass(frozen=True)
class Drift:
    """A motion of one's own that is under way at time 0."""

    coordinates: int
    name: str = "drift"
    duration: float = 0.5

    def __call__(self, times):
        times = np.asarray(times, float)
        rate = np.where(times <= self.duration, 1.0, 0.0)[..., None] * np.arange(1, self.coordinates + 1) * 0.01
        center = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])[: self.coordinates]
        position = center + np.clip(times, 0, self.duration)[..., None] * np.arange(1, self.coordinates + 1) * 0.01
        zero = np.zeros_like(position)
        return Reference(position=position, velocity=rate + zero, acceleration=zero, jerk=zero, snap=zero)


@each_id
def test_an_episode_starts_on_the_references_pose_and_velocity(env_id):
    n = ROBOTS[env_id].coordinates
    env = gym.make(env_id).unwrapped
    observation, info = env.reset(options={"trajectory": Drift(n)})
    part = env.layout.split(observation)
    np.testing.assert_allclose(part["velocity"], 0.01 * np.arange(1, n + 1), atol=1e-15)
    np.testing.assert_array_equal(part["pose"], part["reference_pose"])
    assert info["tracking_error"] == info["rotation_error"] == info["time"] == 0.0
    assert not info["slack"].any()
    for name in ("commanded_action", "torques", "tensions", "motor_speeds"):
        assert not info[name].any(), name


def test_a_workspace_of_ones_own_is_not_compiled_for():
    gym.make("CableBot-Planar-v0").reset()
    before = list(outcome.outcome.signatures)
    walled = PLANAR.replace(name="walled", workspace=((-0.3, 0.3), (-0.2, 0.4)))
    gym.make("CableBot-Planar-v0", robot=walled).reset()
    assert outcome.outcome.signatures == before


@settings(max_examples=20, deadline=None, derandomize=True)
@given(payloads=st.tuples(st.floats(0, 5), st.floats(0, 5)), spatial=st.booleans())
def test_an_untold_payload_leaves_no_trace_in_observation_or_task(payloads, spatial):
    env = gym.make(cablebot_gym.ENV_IDS[spatial], payload_known=False).unwrapped
    seen = []
    for payload in payloads:
        observation, info = env.reset(seed=0, options={"payload": payload})
        seen.append(observation)
        assert info["payload"] == payload
        assert env.task.model_payload == 0.0
        assert env.task.payload_known is False
        part = env.layout.split(observation)
        assert (part["model_payload"][0], part["payload_known"][0]) == (0.0, 0.0)
    np.testing.assert_array_equal(seen[0], seen[1])
    observation, _ = env.reset(options={"payload": payloads[0], "payload_known": True})
    part = env.layout.split(observation)
    assert (part["model_payload"][0], part["payload_known"][0]) == (payloads[0], 1.0)
    assert env.task.model_payload == payloads[0]


def test_a_drawn_payload_that_is_not_told_stays_out_of_the_observation():
    env = gym.make("CableBot-Spatial-v0", payload_range=(1.0, 3.0), payload_known=False).unwrapped
    resets = [env.reset(seed=seed) for seed in range(4)]
    assert len({info["payload"] for _, info in resets}) == 4
    for observation, _ in resets:
        np.testing.assert_array_equal(observation, resets[0][0])


@each_id
@pytest.mark.parametrize("known", [True, False])
def test_observation_and_task_tell_the_nominal_payload_and_robot_and_info_the_true_payload(env_id, known):
    """A rigid robot's first observation does not know the truth; flexible, the springs' wind-up is physics."""
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


def test_a_payload_that_would_be_negative_is_zero_and_not_a_lighter_platform():
    uncertainty = {"parameters": {"payload": {"low": -2.0, "high": -1.0, "relative": False}}}
    env = gym.make("CableBot-Spatial-v0", uncertainty=uncertainty, payload=0.5).unwrapped
    empty = gym.make("CableBot-Spatial-v0").unwrapped
    for one in (env, empty):
        one.reset(seed=0)
    info, expected = (one.step(np.full(6, 0.2))[4] for one in (env, empty))
    assert info["payload"] == env.truth["payload"] == 0.0
    assert env.task.model_payload == 0.5
    np.testing.assert_array_equal(info["tensions"], expected["tensions"])


def test_the_public_task_has_no_place_for_the_true_payload_or_a_seed():
    env = gym.make("CableBot-Spatial-v0", payload_known=False).unwrapped
    env.reset(seed=12345, options={"payload": 3.25})
    fields = {field.name: getattr(env.task, field.name) for field in dataclasses.fields(env.task)}
    assert set(fields) == {
        *("robot", "trajectory", "error_bounds", "control_frequency", "cable", "model_payload", "payload_known")
    }
    assert fields["robot"].mass == SPATIAL.mass
    assert "3.25" not in repr(env.task)
    assert "12345" not in repr(env.task)


COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}


@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("count", [None, 2, 40])
@each_id
def test_copy_in_mid_episode_goes_on_by_itself_as_the_original_would(env_id, count, how):
    """Excludes a copy whose kernel reads other memory than its commands are written to."""
    keywords = {"uncertainty": "table6+sensors", "payload": 1.0}
    if count != 40:  # so many pictures take long
        keywords["render_mode"] = "rgb_array"
    env = gym.make(env_id, **keywords) if count is None else gym.make_vec(env_id, count, **keywords)
    commands = np.random.default_rng(0).uniform(-0.2, 0.2, (12, *env.action_space.shape))

    def go_on(env, commands):
        return [value for command in commands for value in flat(env.step(command))] + flat(env.reset())

    env.reset(seed=3)
    env.step(commands[0])
    if env.render_mode:
        env.render()
    one, other = COPIES[how](env), COPIES[how](env)
    elsewhere = go_on(other, -commands)  # first, so that what is shared shows
    original, again = go_on(env, commands), go_on(one, commands)
    assert len(original) == len(again)
    for value, same in zip(original, again, strict=True):
        np.testing.assert_array_equal(value, same)
    assert any(not np.array_equal(value, different) for value, different in zip(original, elsewhere, strict=True))
    if env.render_mode:
        np.testing.assert_array_equal(env.render(), one.render())


def flat(outcome):
    """The arrays of what reset or step returned."""
    *values, info = outcome
    return [np.asarray(value) for value in (*values, *(info[name] for name in sorted(info)))]


@pytest.mark.parametrize("make", [gym.make, lambda *a, **k: gym.make_vec(*a, num_envs=2, **k)], ids=["one", "vector"])
@each_id
def test_id_is_not_that_of_another_kind_of_robot(env_id, make):
    for other_id, robot in ROBOTS.items():
        if other_id == env_id:
            make(env_id, robot=robot.replace(mass=2.0, name="mine")).reset(seed=0)
            continue
        with pytest.raises(ValueError, match=rf"^robot '{robot.name}' does not fit {env_id}: use {other_id}$"):
            make(env_id, robot=robot).reset(seed=0)


def test_ids_of_others_and_classes_without_id_take_any_robot():
    gym.register("Mine-v0", entry_point=CableBotEnv, kwargs={"robot": "planar"})
    try:
        gym.make("Mine-v0", robot=SPATIAL).reset(seed=0)
    finally:
        del gym.registry["Mine-v0"]
    CableBotEnv(robot=SPATIAL).reset(seed=0)
