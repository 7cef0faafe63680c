"""Termination and info: a constructed case for each reason and quantity."""

import itertools
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.episodes import PLANAR, ROBOTS, SPATIAL, rigid_ids, rollout
from oracles.episodes import make as make_any

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.physics import textbook


def make(env_id, **keywords):
    """An environment whose reference is at rest."""
    return make_any(env_id, **{"trajectory": f"dwell-{ROBOTS[env_id].kind}"} | keywords)


def reason_after(env, action, **options):
    """Reason of the termination in the first step."""
    episode = rollout(env, action[None], options=options)
    assert not episode.truncated.any()  # a crash is not a time limit
    reason = TERMINATION_REASONS[episode.info["termination_reason"][-1]]
    assert episode.terminated[-1] == (reason != "")
    return reason


def test_step_after_termination_warns_until_reset():
    env = make(PLANAR)
    action = np.full(3, 0.3)
    env.reset(options={"initial_error": [0.1001, 0.0]})
    assert env.step(action)[2]
    with pytest.warns(UserWarning, match=r"after the episode was terminated.*reset\(\)"):
        env.step(action)
    assert env.reset()[1]["termination_reason"] == 0
    with warnings.catch_warnings(action="error"):
        assert env.step(action)[2] is False


@rigid_ids
def test_pose_outside_radius_or_workspace_terminates(env_id):
    """The sensors do not matter: noise of 0.5 m would end the episodes at once."""
    robot = ROBOTS[env_id]
    action = np.full(robot.cables, 0.3)
    workspace = tuple((home - 0.03, home + 0.03) for home in robot.home_pose)
    noise = {"sensors": {"position": 0.5}}
    narrow = make(env_id, robot=robot.replace(workspace=workspace), uncertainty=noise)
    for direction, side in itertools.product(np.eye(robot.coordinates), (-1, 1)):
        for distance, reason in ((0.032, "workspace"), (0.028, "")):
            error = distance * side * direction
            assert reason_after(narrow, action, initial_error=error) == reason
    wide = make(env_id)
    for distance, reason in ((0.1001, "tracking_error"), (0.0995, "")):
        error = distance * np.eye(robot.coordinates)[0]
        assert reason_after(wide, action, initial_error=error) == reason


# --- reasons ------------------------------------------------------------------------------------------------------


def test_slack_cable_terminates_after_the_slack_time():
    """The observation has the timer, which starts anew when the cable is taut."""
    env = make(SPATIAL, error_bounds={"position": 1.0})
    action = np.full(6, 0.9)
    action[3] = -0.9
    actions = np.tile(action, (100, 1))
    actions[8:10, 3] = 0.9
    episode = rollout(env, actions)
    slack = episode.info["slack"]
    assert not np.delete(slack, 3, axis=1).any()
    assert slack[8, 3] > slack[10, 3] < slack[20, 3]
    timer = np.zeros(101)
    for step in range(100):
        timer[step + 1] = (timer[step] + 0.002) * slack[step + 1, 3]
    end = np.flatnonzero(episode.terminated)[0] + 1
    observed = env.layout.split(episode.observations)["slack_time"][:, 0]
    assert_allclose(observed[: end + 1], timer[: end + 1], atol=1e-12)
    assert timer[end] == pytest.approx(0.102)
    assert TERMINATION_REASONS[episode.info["termination_reason"][end]] == "slack"


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
    for name in ("tracking_error", "rotation_error", "rotation_error_peak"):
        assert info[name] > 1e3
    assert max(info["reward_position"], info["reward_rotation"]) < 1e-3
    assert (info["violated"], info["reward_inside"]) == (True, 0.0)


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
    rng = np.random.default_rng(0)
    actions = np.repeat(1.6 * rng.uniform(-0.6, 1.0, (20, robot.cables)), 5, axis=0)
    episode = rollout(env, actions, seed=0)
    info = {name: values[1:] for name, values in episode.info.items()}
    drop = robot.speed_slope * info["motor_speeds"]
    assert np.abs(drop).max() > 0.05
    blocks = env.layout.split(episode.observations[:-1])
    expected = {
        "commanded_action": actions,
        "torques": robot.stall_torque * np.clip(actions, -1, 1) - drop,
        "torque_margin": robot.stall_torque * (1 - np.abs(actions)),
        "action_time": np.arange(100) / 60,
        "time": np.arange(1, 101) / 60,
        "motor_speeds": textbook.pulley_speed(robot, blocks["pose"], blocks["velocity"]),
        "slack": info["least_tensions"] == 0.0,
    }
    for name, values in expected.items():
        assert_allclose(info[name], values, atol=1e-9, err_msg=name)
    assert 0.05 < info["slack"].mean() < 0.95
    assert np.any(info["tracking_error_peak"] > info["tracking_error"] + 1e-6)
    if env_id == SPATIAL:
        assert np.any(info["slack"] & (info["tensions"] > 0))
        assert np.any(info["rotation_error_peak"] > info["rotation_error"] + 1e-6)
