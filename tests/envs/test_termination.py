"""Termination and info: a constructed case for each reason and quantity."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import PLANAR, ROBOTS, SPATIAL, rigid_ids, rollout
from oracles.episodes import make as make_any

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.physics import textbook


def make(env_id, **keywords) -> Any:
    """An environment whose reference is at rest."""
    return make_any(env_id, **{"trajectory": f"dwell-{ROBOTS[env_id].kind}"} | keywords)


def reason_after(env, action, steps=1, **options):
    """Reason of the termination, which comes in the last of these steps at the earliest, and the
    last info."""
    episode = rollout(env, np.tile(action, (steps, 1)), options=options)
    assert not episode.terminated[:-1].any()
    assert not episode.truncated.any()  # a crash is not a time limit
    info = {key: values[-1] for key, values in episode.info.items()}
    reason = TERMINATION_REASONS[info["termination_reason"]]
    assert episode.terminated[-1] == (reason != "")
    return reason, info


def test_step_after_termination_warns_until_reset():
    env = make(PLANAR)
    env.reset(options={"initial_error": [0.1001, 0.0]})
    action = np.full(3, 0.3)
    assert env.step(action)[2]
    with pytest.warns(UserWarning, match=r"after the episode was terminated.*reset\(\)"):
        env.step(action)
    assert env.reset()[1]["termination_reason"] == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert env.step(action)[2] is False


# --- reasons ------------------------------------------------------------------------------------------------------


@rigid_ids
def test_position_error_beyond_the_radius_terminates(env_id):
    env = make(env_id)
    for error, reason in ((0.1001, "tracking_error"), (0.0995, "")):
        start = error * np.eye(ROBOTS[env_id].coordinates)[0]
        assert (
            reason_after(env, np.full(env.action_space.shape, 0.3), initial_error=start)[0]
            == reason
        )


def test_slack_cable_terminates_after_the_slack_time():
    env = make(SPATIAL, error_bounds={"position": 1.0})
    action = np.full(6, 0.9)
    action[3] = -0.9
    slack = rollout(env, np.tile(action, (60, 1))).info["slack"]
    assert not np.delete(slack, 3, axis=1).any()
    steps = round(0.1 * 500) + np.flatnonzero(slack[1:, 3])[0] + 1
    assert reason_after(env, action, steps - 1)[0] == ""
    assert reason_after(env, action, steps)[0] == "slack"


@rigid_ids
def test_pose_outside_the_workspace_terminates(env_id):
    robot = ROBOTS[env_id]
    workspace = tuple((home - 0.03, home + 0.03) for home in robot.home_pose)
    env = make(env_id, robot=robot.replace(workspace=workspace))
    action = np.full(robot.cables, 0.3)
    for direction, side in itertools.product(np.eye(robot.coordinates), (-1, 1)):
        assert reason_after(env, action, initial_error=0.032 * side * direction)[0] == "workspace"
        assert reason_after(env, action, initial_error=0.028 * side * direction)[0] == ""


def test_non_finite_state_is_bounded_and_earns_nothing():
    """Physics steps that are far too long, under actions that alternate."""
    env = make(SPATIAL, trajectory="paper-spatial", control_frequency=20.0, substeps=1)
    rng = np.random.default_rng(0)
    env.reset()
    reason = ""
    while reason != "non_finite":
        observation, _, terminated, _, info = env.step(rng.choice([-5.0, 5.0], 6))
        reason = TERMINATION_REASONS[info["termination_reason"]]
    assert terminated
    assert observation in env.observation_space
    assert all(np.all(np.isfinite(value)) for value in info.values())
    assert (
        min(
            info["tracking_error"],
            info["rotation_error"],
            info["rotation_error_peak"],
        )
        > 1e3
    )
    assert max(info["reward_position"], info["reward_rotation"]) < 1e-3
    assert (info["violated"], info["reward_inside"]) == (True, 0.0)


def test_termination_uses_the_true_state():
    env = make(SPATIAL, uncertainty={"sensors": {"position": 0.5}})
    assert not rollout(env, np.full((10, 6), 0.3), seed=0).terminated.any()


# --- info columns -------------------------------------------------------------------------------------------------


@rigid_ids
def test_info_is_of_the_start_and_peaks_of_the_whole_period(env_id):
    """The actions are raw, many beyond ±1, and the torques clipped. Damped cables go slack within a
    period."""
    robot = ROBOTS[env_id]
    robot = robot.replace(transmission=robot.transmission.replace(damping=0.3))
    env = make(
        env_id,
        robot=robot,
        control_frequency=60.0,
        substeps=20,
        trajectory=f"paper-{robot.kind}",
        error_bounds={"position": 1.0},
    )
    actions = np.repeat(
        1.6 * np.random.default_rng(0).uniform(-0.6, 1.0, (30, robot.cables)),
        5,
        axis=0,
    )
    episode = rollout(env, actions, seed=0)
    info = {name: values[1:] for name, values in episode.info.items()}
    assert_array_equal(info["commanded_action"], actions)
    drop = robot.speed_slope * info["motor_speeds"]
    assert np.abs(drop).max() > 0.05
    torques = robot.stall_torque * np.clip(actions, -1, 1) - drop
    assert_allclose(info["torques"], torques, atol=1e-12)
    assert_allclose(
        info["torque_margin"],
        robot.stall_torque * (1 - np.abs(actions)),
        atol=1e-12,
    )
    assert_allclose(info["action_time"], np.arange(150) / 60, atol=1e-12)
    assert_allclose(info["time"], np.arange(1, 151) / 60, atol=1e-12)
    blocks = env.layout.split(episode.observations[:-1])
    speeds = textbook.pulley_speed(robot, blocks["pose"], blocks["velocity"])
    assert_allclose(info["motor_speeds"], speeds, atol=1e-9)
    assert_array_equal(info["slack"], info["least_tensions"] == 0.0)
    assert 0.05 < info["slack"].mean() < 0.95
    assert np.any(info["tracking_error_peak"] > info["tracking_error"] + 1e-6)
    if env_id == SPATIAL:
        assert np.any(info["slack"] & (info["tensions"] > 0))
        assert np.any(info["rotation_error_peak"] > info["rotation_error"] + 1e-6)
