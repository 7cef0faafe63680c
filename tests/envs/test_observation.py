"""Blocks of the observation beyond state and reference, its layout, and the normalised form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import PLANAR, ROBOTS, SPATIAL, make, random_actions, rollout, two_ids

from cablebot_gym.envs.observation import LAST_ACTIONS, observation_layout
from cablebot_gym.robots import find_robot, library

# --- last actions and slack time ----------------------------------------------------------------------------------


def test_last_actions_are_those_sent_in_this_episode():
    """Latest first, clipped, before delay, zeros after a reset."""
    dwell = {"trajectory": {"name": "dwell-planar", "duration": 0.02}}
    env = make(PLANAR, uncertainty={"delay": 2}, **dwell)
    for _ in range(2):
        observation, _ = env.reset(seed=0)
        sent = np.zeros((LAST_ACTIONS, 3))
        for action in random_actions(env, 10, -0.8, 1.6):
            last = env.layout.split(observation)["last_actions"]
            assert_array_equal(last, sent.ravel())
            observation = env.step(action)[0]
            sent = np.concatenate([np.clip(action, -1, 1)[None], sent[:-1]])


# --- layout -------------------------------------------------------------------------------------------------------


def test_layout_rejects_the_observation_of_another_robot():
    layout = observation_layout(ROBOTS[PLANAR])
    with pytest.raises(ValueError, match=f"'planar' has {layout.size} components"):
        layout.split(np.zeros((4, layout.size + 1)))


def test_model_payload_spans_the_payload_range_of_a_real_robot():
    """At 1000 kg it did: laws that read it sagged with the tonnes of FAST."""
    for name in library():
        robot = find_robot(name)
        blocks = {block.name: block for block in observation_layout(robot).blocks}
        assert robot.defaults.payload_range[1] <= blocks["model_payload"].high[0], name


# --- normalised ---------------------------------------------------------------------------------------------------


@two_ids
def test_normalised_observation_is_the_layouts_function(env_id):
    """With sensor noise, payload, delay and saturated components."""
    uncertainty = {"sensors": {"position": 1e-3, "velocity": 30.0}, "delay": 1}
    keywords = {"uncertainty": uncertainty, "payload": 1.0}
    env, twin = (make(env_id, normalised_observation=form, **keywords) for form in (False, True))
    actions = random_actions(env, 40)
    raw, normalised = (rollout(form, actions, seed=0).observations for form in (env, twin))
    assert np.any(raw == env.observation_space.high)  # velocities saturate
    assert_array_equal(normalised, env.layout.normalise(raw))
    space = twin.observation_space
    assert space == env.layout.space(normalised=True)
    assert all(observation in space for observation in normalised)
    assert np.all(np.isfinite([space.low, space.high]))


def test_pose_and_velocity_become_tracking_errors():
    env = make(SPATIAL, normalised_observation=True, trajectory="paper-spatial")
    error = np.array([0.01, -0.02, 0.0, 0.005, 0.0, -0.01])
    blocks = env.layout.split(env.reset(options={"initial_error": error})[0])
    assert_allclose(blocks["pose"], error / 0.01, atol=1e-9)
    assert_allclose(blocks["velocity"], 0.0, atol=1e-9)


def test_observation_in_float32_is_the_rounded_one():
    double = make(PLANAR, normalised_observation=True)
    env = make(PLANAR, normalised_observation=True, observation_dtype=np.float32)
    expected = double.reset(seed=0)[0]
    rounded = env.reset(seed=0)[0]
    for action in random_actions(env, 2, -1, 1):
        assert rounded in env.observation_space
        assert_array_equal(rounded, expected.astype(np.float32), strict=True)
        expected = double.step(action)[0]
        rounded = env.step(action)[0]
