"""Blocks of the observation beyond state and reference, its layout, and the normalised form."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    SPATIAL,
    make,
    make_vector,
    random_actions,
    two_ids,
)

from cablebot_gym.envs.observation import LAST_ACTIONS, observation_layout
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import find_robot, library
from cablebot_gym.trajectories import trajectory_names

# --- last actions and slack time ----------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
@pytest.mark.parametrize("delay", [0, 2])
def test_last_actions_are_those_sent_in_this_episode(mode, delay):
    """Latest first, clipped, before delay, zeros after a reset, for episodes that end at different
    times."""
    env = make_vector(
        PLANAR,
        5,
        autoreset_mode=mode,
        uncertainty={"delay": delay},
        trajectory={"name": "line-planar", "duration": 0.06, "dwell": 0.01},
    )
    observation, _ = env.reset(seed=0)
    sent = np.zeros((5, LAST_ACTIONS, 3))
    restarting = np.zeros(5, bool)
    ends = 0
    for actions in random_actions(env, 150, -0.8, 1.6):
        assert observation in env.observation_space
        assert_array_equal(env.layout.split(observation)["last_actions"], sent.reshape(5, -1))
        observation, _, terminated, truncated, info = env.step(actions)
        sent = np.concatenate([np.clip(actions, -1, 1)[:, None], sent[:, :-1]], axis=1)
        done = terminated | truncated
        ends += done.sum()
        if mode is AutoresetMode.NEXT_STEP:
            sent[restarting] = 0.0
            restarting = done
            continue
        if mode is AutoresetMode.DISABLED and done.any():
            observation, _ = env.reset(options={"reset_mask": done})
        for index in np.flatnonzero(done & (mode is AutoresetMode.SAME_STEP)):
            sent_last = env.layout.split(info["final_obs"][index])["last_actions"]
            assert_array_equal(sent_last, sent[index].ravel())
        sent[done] = 0.0
    assert ends > 10


# --- layout -------------------------------------------------------------------------------------------------------


def test_layout_rejects_the_observation_of_another_robot():
    layout = observation_layout(ROBOTS[PLANAR])
    for function in (layout.split, layout.normalise):
        with pytest.raises(ValueError, match=f"'planar' has {layout.size} components"):
            function(np.zeros((4, layout.size + 1)))


def test_model_payload_spans_the_payload_range_of_a_real_robot():
    """At 1000 kg it did: laws that read it sagged with the tonnes of FAST."""
    for name in library():
        robot = find_robot(name)
        blocks = {block.name: block for block in observation_layout(robot).blocks}
        assert robot.defaults.payload_range[1] <= blocks["model_payload"].high[0], name


def test_blocks_are_views_that_cover_the_observation():
    layout = observation_layout(ROBOTS[FLEX_SPATIAL])
    observation = np.zeros((2, layout.size))
    for number, block in enumerate(layout.split(observation).values(), 1):
        assert not block.any()
        block[...] = number
    assert observation.all()


def test_policies_cannot_change_the_shared_layout():
    layout = observation_layout(ROBOTS[PLANAR])
    for array in (layout.centre, layout.per_scale):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2.0
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True


# --- normalised ---------------------------------------------------------------------------------------------------


def tracked(env_id, options=None, **keywords):
    """Observations and normalised observations of an episode of a policy that follows most motions,
    and both envs."""
    envs = [
        make(
            env_id,
            normalised_observation=form,
            **keywords,
        )
        for form in (False, True)
    ]
    robot = ROBOTS[env_id]
    policy = load_policy("composite" if robot.flexible else "fl", robot)
    rows = []
    results = [env.reset(seed=0, options=options) for env in envs]
    ended = False
    while not ended:
        rows.append([result[0] for result in results])
        action = policy.predict(rows[-1][0])[0]
        results = [env.step(action) for env in envs]
        ended = results[0][2] or results[0][3]
    return np.array(rows).swapaxes(0, 1), envs


@two_ids
def test_normalised_observation_is_the_layouts_function(env_id):
    """With sensor noise, payload, delay and saturated components; the vector environment returns
    the same."""
    uncertainty = {"sensors": {"position": 1e-3, "velocity": 30.0}, "delay": 1}
    keywords = {"uncertainty": uncertainty, "payload": 1.0}
    (raw, normalised), (env, twin) = tracked(env_id, **keywords)
    assert np.any(raw == env.observation_space.high)  # velocities saturate
    assert_array_equal(normalised, env.layout.normalise(raw))
    space = twin.observation_space
    assert space == env.layout.space(normalised=True)
    assert all(observation in space for observation in normalised)
    assert np.all(np.isfinite([space.low, space.high]))
    vector = make_vector(env_id, 3, normalised_observation=True, **keywords)
    assert vector.single_observation_space == space
    assert_array_equal(vector.reset(seed=[4, 0, 7])[0][1], normalised[0])
    action = np.full(vector.action_space.shape, 0.4)
    twin.reset(seed=0)
    assert_array_equal(vector.step(action)[0][1], twin.step(action[1])[0])


@pytest.mark.parametrize("env_id", [PLANAR, pytest.param(FLEX_SPATIAL, marks=pytest.mark.slow)])
def test_normalised_components_are_of_order_one_on_all_motions(env_id):
    names = trajectory_names(ROBOTS[env_id].kind)
    episodes = []
    for number, name in enumerate(names):
        options = {"trajectory": name, "payload": float(number % 3)}
        episodes.append(tracked(env_id, options)[0])
    raw, normalised = np.concatenate(episodes, axis=1)
    assert np.mean(np.abs(normalised) <= 10) > 0.99
    moving = np.std(raw, axis=0) > 1e-9
    assert np.mean(moving) > 0.9
    deviation = np.std(normalised, axis=0)[moving]
    assert deviation.min() > 5e-4  # the motions rotate by a few milliradians only
    assert deviation.max() < 3
    layout = observation_layout(ROBOTS[env_id])
    for values, least, most in ((raw, 30, np.inf), (normalised, 1, 10)):
        blocks = layout.split(values)
        # Derivatives of the position, up to snap for flexible robots.
        spreads = [np.std(blocks[name][:, :2]) for name in blocks if name.startswith("reference_")]
        assert least < max(spreads) / min(spreads) < most


def test_pose_and_velocity_become_tracking_errors():
    env = make(SPATIAL, normalised_observation=True, trajectory="paper-spatial")
    error = np.array([0.01, -0.02, 0.0, 0.005, 0.0, -0.01])
    blocks = env.layout.split(env.reset(options={"initial_error": error})[0])
    assert_allclose(blocks["pose"], error / 0.01, atol=1e-9)
    assert_allclose(blocks["velocity"], 0.0, atol=1e-9)
    bounds = ROBOTS[SPATIAL].pose_bounds[:, :3]
    reference = env.task.trajectory(0.0).position[:3] - bounds.mean(axis=0)
    length = np.ptp(bounds, axis=0).max() / 2
    assert_allclose(blocks["reference_pose"][:3], reference / length, atol=1e-12)


@pytest.mark.parametrize("normalised", [False, True])
def test_observation_in_float32_is_the_rounded_one_in_its_space(normalised):
    keywords = {"normalised_observation": normalised, "observation_dtype": "float32"}
    double = make(PLANAR, normalised_observation=normalised)
    env = make(PLANAR, **keywords)
    envs = make_vector(
        PLANAR,
        2,
        autoreset_mode="SameStep",
        max_episode_steps=2,
        **keywords,
    )
    assert env.observation_space.dtype == envs.observation_space.dtype == np.float32
    assert envs.single_observation_space == env.observation_space
    expected = double.reset(seed=0)[0]
    rounded = [env.reset(seed=0)[0], envs.reset(seed=0)[0][0]]
    for action in random_actions(env, 2, -1, 1):
        for observation in rounded:
            assert observation in env.observation_space
            assert_array_equal(observation, expected.astype(np.float32), strict=True)
        expected = double.step(action)[0]
        observations, _, _, _, info = envs.step(np.tile(action, (2, 1)))
        rounded = [env.step(action)[0], observations[0]]
    assert_array_equal(info["final_obs"][0], expected.astype(np.float32), strict=True)
