"""Blocks of the observation beyond state and reference, its layout, and the normalised form."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from cablebot_gym.envs import ENV_IDS, PAPER_ENV_IDS, TERMINATION_REASONS
from cablebot_gym.envs.observation import LAST_ACTIONS, observation_layout
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, ROBOTS, SPATIAL, find_robot, library
from cablebot_gym.trajectories import trajectory_names

PLANAR_ID = "CableBot-Planar-v0"
each_id = pytest.mark.parametrize("env_id", ENV_IDS)


# --------------------------------------------------------------------------------------- last actions and slack time


@pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
@pytest.mark.parametrize("delay", [0, 2])
def test_last_actions_are_those_sent_in_this_episode(mode, delay):
    """Latest first, clipped, before delay, zeros after a reset, for episodes that end at different times."""
    count, rng = 5, np.random.default_rng(0)
    env = gym.make_vec(
        PLANAR_ID, count, autoreset_mode=mode, slack_time=0.01, termination_radius=0.03,
        uncertainty={"delay": delay}, trajectory={"name": "line-planar", "duration": 0.1, "dwell": 0.01},
    ).unwrapped  # fmt: skip
    observation, _ = env.reset(seed=0)
    sent, ended, ends = np.zeros((count, LAST_ACTIONS, 3)), np.zeros(count, bool), 0
    for _ in range(150):
        assert observation in env.observation_space
        np.testing.assert_array_equal(env.layout.split(observation)["last_actions"], sent.reshape(count, -1))
        actions = rng.uniform(-0.8, 1.6, (count, 3))
        observation, _, terminated, truncated, info = env.step(actions)
        now = np.concatenate([np.clip(actions, -1, 1)[:, None], sent[:, :-1]], axis=1)
        done = terminated | truncated
        ends += done.sum()
        if mode is AutoresetMode.NEXT_STEP:
            now[ended], ended = 0.0, done
        elif mode is AutoresetMode.SAME_STEP and done.any():
            for env_index in np.flatnonzero(done):
                last = env.layout.split(info["final_obs"][env_index])["last_actions"]
                np.testing.assert_array_equal(last, now[env_index].ravel())
            now[done] = 0.0
        elif done.any():
            observation, _ = env.reset(options={"reset_mask": done})
            now[done] = 0.0
        sent = now
    assert ends > 2 * count


def test_slack_time_is_the_timer_of_the_termination():
    env = gym.make(PLANAR_ID, slack_time=0.02, termination_radius=1.0).unwrapped
    observation, _ = env.reset()
    timer, terminated, step = 0.0, False, 0
    while not terminated:
        assert env.layout.split(observation)["slack_time"] == pytest.approx([timer], abs=1e-12)
        observation, _, terminated, _, info = env.step(np.full(3, -0.9 if step % 9 > 1 or step > 20 else 0.5))
        timer, step = (timer + 0.002 if info["slack"].any() else 0.0), step + 1
    assert TERMINATION_REASONS[info["termination_reason"]] == "slack"
    assert env.layout.split(observation)["slack_time"][0] == pytest.approx(0.022)
    assert env.layout.split(env.reset()[0])["slack_time"][0] == 0.0


# ------------------------------------------------------------------------------------------------------------- layout


def test_layout_rejects_the_observation_of_another_robot():
    for robot in ROBOTS.values():
        layout = observation_layout(robot)
        for other in ROBOTS.values():
            observation = np.zeros((4, observation_layout(other).size))
            if robot is other:
                assert layout.split(observation).keys() == layout.slices().keys()
                continue
            for function in (layout.split, layout.normalise):
                with pytest.raises(ValueError, match=f"'{robot.name}' has {layout.size} components"):
                    function(observation)


def test_model_payload_spans_the_payload_range_of_a_real_robot():
    """At 1000 kg it did: laws that read it sagged with the tonnes of FAST."""
    for name in library():
        robot = find_robot(name)
        (block,) = (block for block in observation_layout(robot).blocks if block.name == "model_payload")
        assert robot.defaults.payload_range[1] <= block.high[0], name


def test_blocks_are_views_that_cover_the_observation():
    observation = np.zeros((2, observation_layout(FLEX_PLANAR).size))
    for number, block in enumerate(observation_layout(FLEX_PLANAR).split(observation).values(), 1):
        assert not block.any()
        block[...] = number
    assert observation.all()


def test_policies_cannot_change_the_shared_layout():
    layout = observation_layout(PLANAR)
    for array in (layout.centre, layout.per_scale):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2.0
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True


# --------------------------------------------------------------------------------------------------------- normalised


def tracking(env_id, **keywords):
    """An environment, its twin with normalised observations, and a policy that follows most motions."""
    env = gym.make(env_id, **keywords).unwrapped
    robot = env.settings.robot
    policy = load_policy("composite-tuned" if robot.flexible else "fl", robot)
    return env, gym.make(env_id, normalised_observation=True, **keywords).unwrapped, policy


def observations(env, twin, policy, **options):
    """Observations and normalised observations of an episode."""
    observation, seen = env.reset(seed=0, options=options)[0], []
    normalised, ended = twin.reset(seed=0, options=options)[0], False
    while not ended:
        seen.append((observation, normalised))
        action = policy.predict(observation)[0]
        observation, _, terminated, truncated, _ = env.step(action)
        normalised, ended = twin.step(action)[0], terminated or truncated
    return tuple(np.array(values) for values in zip(*seen, strict=True))


@each_id
def test_normalised_observation_is_the_layouts_function_bit_for_bit(env_id):
    """With sensor noise, payload, delay and saturated components; the vector environment returns the same."""
    keywords = {"uncertainty": {"sensors": {"position": 1e-3, "velocity": 30.0}, "delay": 1}, "payload": 1.0}
    env, twin, policy = tracking(env_id, **keywords)
    raw, normalised = observations(env, twin, policy)
    assert np.any(raw == env.observation_space.high)  # velocities saturate
    np.testing.assert_array_equal(normalised, env.layout.normalise(raw))
    np.testing.assert_array_equal(normalised[0], env.layout.normalise(raw[0]))
    assert twin.observation_space == env.layout.space(normalised=True)
    assert all(observation in twin.observation_space for observation in normalised)
    assert np.all(np.isfinite([twin.observation_space.low, twin.observation_space.high]))
    vector = gym.make_vec(env_id, 3, normalised_observation=True, **keywords).unwrapped
    np.testing.assert_array_equal(vector.reset(seed=[4, 0, 7])[0][1], normalised[0])
    action = np.full(vector.action_space.shape, 0.4)
    twin.reset(seed=0)
    np.testing.assert_array_equal(vector.step(action)[0][1], twin.step(action[1])[0])
    assert vector.single_observation_space == twin.observation_space


@pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
def test_normalised_components_are_of_order_one_on_all_named_motions(env_id):
    env, twin, policy = tracking(env_id)
    names = trajectory_names(env.settings.robot.kind)
    seen = [observations(env, twin, policy, trajectory=name, payload=float(i % 3)) for i, name in enumerate(names)]
    raw, normalised = (np.concatenate(values) for values in zip(*seen, strict=True))
    assert np.mean(np.abs(normalised) <= 10) > 0.99
    moving = np.std(raw, axis=0) > 1e-9
    assert np.mean(moving) > 0.9
    deviation = np.std(normalised, axis=0)[moving]
    assert deviation.min() > 5e-4  # the motions rotate by a few milliradians only
    assert deviation.max() < 3
    before, after = (
        [np.std(block[:, :2]) for name, block in env.layout.split(values).items() if name.startswith("reference_")]
        for values in (raw, normalised)
    )
    assert max(before) > 30 * min(before)  # derivatives of the position, up to snap for flexible robots
    assert max(after) < 10 * min(after)


def test_pose_and_velocity_become_tracking_errors():
    env = gym.make("CableBot-Spatial-v0", normalised_observation=True, trajectory="paper-spatial").unwrapped
    error = np.array([0.01, -0.02, 0.0, 0.005, 0.0, -0.01])
    blocks = env.layout.split(env.reset(options={"initial_error": error})[0])
    np.testing.assert_allclose(blocks["pose"], error / 0.01, atol=1e-9)
    np.testing.assert_allclose(blocks["velocity"], 0.0, atol=1e-9)
    length = np.ptp(SPATIAL.pose_bounds[:, :3], axis=0).max() / 2
    reference = env.task.trajectory(0.0).position - SPATIAL.pose_bounds.mean(axis=0)
    np.testing.assert_allclose(blocks["reference_pose"][:3], reference[:3] / length, atol=1e-12)


@pytest.mark.parametrize("normalised", [False, True])
def test_observation_in_float32_is_the_rounded_one_within_its_space(normalised):
    keywords = {"normalised_observation": normalised, "observation_dtype": "float32"}
    usual, env = (
        gym.make(PLANAR_ID, **changed).unwrapped for changed in ({"normalised_observation": normalised}, keywords)
    )
    envs = gym.make_vec(PLANAR_ID, 2, autoreset_mode="SameStep", max_episode_steps=2, **keywords).unwrapped
    assert env.observation_space.dtype == envs.observation_space.dtype == np.float32
    assert envs.single_observation_space == env.observation_space
    first, one, several = (each.reset(seed=0)[0] for each in (usual, env, envs))
    for action in np.random.default_rng(0).uniform(-1, 1, (2, 3)):
        for observation in (one, several[0]):
            assert observation in env.observation_space
            np.testing.assert_array_equal(observation, first.astype(np.float32), strict=True)
        first, one = usual.step(action)[0], env.step(action)[0]
        several, _, _, truncated, info = envs.step(np.tile(action, (2, 1)))
    assert truncated.all()
    np.testing.assert_array_equal(info["final_obs"][0], first.astype(np.float32), strict=True)


@pytest.mark.parametrize("value", ["yes", 1, None])
@pytest.mark.parametrize("name", ["normalised_observation", "terminate_on_violation"])
def test_flags_must_be_booleans(name, value):
    with pytest.raises(ValueError, match=f"{name} must be True or False"):
        gym.make(PLANAR_ID, **{name: value})
