"""Termination, info and reward: a constructed case for each reason, quantity and term."""

from __future__ import annotations

import itertools
import warnings

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.kinematics import structure_jacobian
from cablebot_gym.robots import PLANAR, SPATIAL

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
each_kind = pytest.mark.parametrize("kind", list(ROBOTS))


def make(kind, **keywords):
    """An environment without wrappers, whose reference is at rest."""
    return gym.make(IDS[kind], **{"trajectory": f"dwell-{kind}"} | keywords).unwrapped


def displaced(kind, x):
    """A start error along x."""
    return [x] + [0.0] * (ROBOTS[kind].coordinates - 1)


def reason_of(info):
    """Name of the termination reason."""
    return TERMINATION_REASONS[info["termination_reason"]]


def step(env, action):
    """Reward, flags and info of a step, whose action may be the same for all motors."""
    return env.step(np.full(env.action_space.shape, action))[1:]


def last_step(env, action, steps, seed=None, **options):
    """Reward, flags and info of the first step that ends the episode, and its number; fails if none does."""
    env.reset(seed=seed, options=options)
    for number in range(1, steps + 1):
        reward, terminated, truncated, info = step(env, action)
        assert truncated is False  # a crash is not a time limit
        assert terminated == (info["termination_reason"] != 0)
        if terminated:
            return number, reward, info
    raise AssertionError("no step ended the episode")


def test_step_after_termination_warns_until_reset():
    env = make("planar")
    last_step(env, 0.3, 1, initial_error=displaced("planar", 0.1001))
    with pytest.warns(UserWarning, match=r"after the episode was terminated.*reset\(\)"):
        step(env, 0.3)
    assert env.reset()[1]["termination_reason"] == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert step(env, 0.3)[1] is False


# ------------------------------------------------------------------------------------------------------- reasons


@each_kind
def test_position_error_beyond_the_termination_radius_terminates(kind):
    env = make(kind, termination_radius=0.05)
    number, _, info = last_step(env, 0.3, 1, initial_error=displaced(kind, 0.0501))
    assert (number, reason_of(info)) == (1, "tracking_error")
    assert info["tracking_error"] > 0.05
    env.reset(options={"initial_error": displaced(kind, 0.0495)})
    _, terminated, _, info = step(env, 0.3)
    assert (terminated, reason_of(info)) == (False, "")
    assert info["tracking_error"] < 0.05


def test_one_slack_cable_terminates():
    action = np.full(6, 0.9)
    action[3] = -0.9
    info = last_step(make("spatial", termination_radius=5.0), action, 60)[2]
    assert reason_of(info) == "slack"
    assert info["slack"][3]
    assert not info["slack"].all()


@each_kind
def test_pose_outside_the_workspace_terminates(kind):
    box, robot = 0.03, ROBOTS[kind]
    workspace = tuple((home - box, home + box) for home in robot.home_pose)
    env = make(kind, robot=robot.replace(workspace=workspace))
    for coordinate, side in itertools.product(range(robot.coordinates), (-1, 1)):
        for distance, reason in ((0.032, "workspace"), (0.028, "")):
            error = np.zeros(robot.coordinates)
            error[coordinate] = side * distance
            env.reset(options={"initial_error": error})
            _, terminated, _, info = step(env, 0.3)
            assert (terminated, reason_of(info)) == (reason != "", reason)


def test_non_finite_state_is_bounded_and_earns_nothing():
    """Physics steps that are far too long, under actions that alternate."""
    env = make("spatial", trajectory="paper-spatial", control_frequency=20.0, substeps=1)
    rng = np.random.default_rng(0)
    env.reset()
    reason = ""
    while reason != "non_finite":
        observation, _, terminated, _, info = env.step(rng.choice([-5.0, 5.0], 6))
        reason = reason_of(info)
    assert terminated
    assert observation in env.observation_space
    assert all(np.all(np.isfinite(value)) for value in info.values())
    for name in ("tracking_error", "rotation_error", "rotation_error_peak"):
        assert info[name] > 1e3
    assert max(info["reward_position"], info["reward_rotation"]) < 1e-3
    assert (info["violated"], info["reward_inside"]) == (True, 0.0)


# ---------------------------------------------------------------------------------------------------- info columns


@each_kind
def test_info_is_of_the_start_of_the_period_and_slack_and_peaks_of_all_of_it(kind):
    """The actions are raw, many beyond ±1, and the torques clipped. Damped cables go slack within a period."""
    robot = ROBOTS[kind].replace(transmission=ROBOTS[kind].transmission.replace(damping=0.3))
    keywords = {"robot": robot, "control_frequency": 60.0, "substeps": 20}
    env = make(kind, trajectory=f"paper-{kind}", termination_radius=5.0, slack_time=99.0, **keywords)
    actions = np.repeat(1.6 * np.random.default_rng(0).uniform(-0.6, 1.0, (30, *env.action_space.shape)), 5, axis=0)
    observations = [env.reset(seed=0)[0]]
    steps = [env.step(action) for action in actions]
    observations, infos = np.array(observations + [step[0] for step in steps]), [step[4] for step in steps]
    info = {name: np.array([one[name] for one in infos]) for name in infos[0]}
    np.testing.assert_array_equal(info["commanded_action"], actions)
    assert np.abs(actions).max() > 1.2
    drop = robot.speed_slope * info["motor_speeds"]
    assert np.abs(drop).max() > 0.05
    wanted = robot.stall_torque * np.clip(actions, -1, 1) - drop
    np.testing.assert_allclose(info["torques"], wanted, atol=1e-12)
    np.testing.assert_allclose(info["torque_margin"], robot.stall_torque * (1 - np.abs(actions)), atol=1e-12)
    np.testing.assert_allclose(info["action_time"], np.arange(150) / 60, atol=1e-12)
    np.testing.assert_allclose(info["time"], np.arange(1, 151) / 60, atol=1e-12)
    part = env.layout.split(observations)
    for number in range(0, 150, 7):
        jacobian = structure_jacobian(robot.base, robot.platform, part["pose"][number])
        speeds = jacobian @ part["velocity"][number] / -robot.pulley_radius
        np.testing.assert_allclose(info["motor_speeds"][number], speeds, atol=1e-9)
    np.testing.assert_array_equal(info["slack"], info["least_tensions"] == 0.0)
    assert 0.05 < info["slack"].mean() < 0.95
    assert np.any(info["tracking_error_peak"] > info["tracking_error"] + 1e-6)
    if kind == "spatial":
        assert np.any(info["slack"] & (info["tensions"] > 0))
        assert np.any(info["rotation_error_peak"] > info["rotation_error"] + 1e-6)


# ---------------------------------------------------------------------------------------------------- uncertainty


def test_termination_uses_the_true_state():
    env = make("spatial", uncertainty={"sensors": {"position": 0.5}})
    env.reset(seed=0)
    assert not any(step(env, 0.3)[1] for _ in range(10))
