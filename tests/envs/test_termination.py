"""Termination, info and reward: a constructed case for each reason, quantity and term."""

from __future__ import annotations

import itertools
import warnings

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.kinematics import structure_jacobian
from cablebot_gym.robots import PLANAR, SPATIAL, Motors, Transmission

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
each_kind = pytest.mark.parametrize("kind", list(ROBOTS))


def make(kind, **keywords):
    """An environment without wrappers, whose reference is at rest."""
    return gym.make(IDS[kind], **{"trajectory": f"dwell-{kind}"} | keywords).unwrapped


def displaced(kind, x):
    """A start error along x."""
    return [x] + [0.0] * (ROBOTS[kind].coordinates - 1)


def step(env, action):
    """Reward, flags and info of a step, whose action may be the same for all motors."""
    return env.step(np.full(env.action_space.shape, action))[1:]


def last_step(env, action, steps, seed=None, **options):
    """Reward, flags and info of the first step that ends the episode, and its number; fails if none does."""
    env.reset(seed=seed, options=options)
    for number in range(1, steps + 1):
        reward, terminated, truncated, info = step(env, action)
        assert truncated is False  # a crash is not a time limit
        assert terminated == (info["termination_reason"] != "")
        if terminated:
            return number, reward, info
    raise AssertionError("no step ended the episode")


def test_step_after_termination_warns_until_reset():
    env = make("planar")
    last_step(env, 0.3, 1, initial_error=displaced("planar", 0.1001))
    with pytest.warns(UserWarning, match=r"after the episode was terminated.*reset\(\)"):
        step(env, 0.3)
    assert env.reset()[1]["termination_reason"] == ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert step(env, 0.3)[1] is False


# ------------------------------------------------------------------------------------------------------- reasons


@each_kind
def test_position_error_beyond_the_termination_radius_terminates(kind):
    env = make(kind, termination_radius=0.05)
    number, _, info = last_step(env, 0.3, 1, initial_error=displaced(kind, 0.0501))
    assert (number, info["termination_reason"]) == (1, "tracking_error")
    assert info["tracking_error"] > 0.05
    env.reset(options={"initial_error": displaced(kind, 0.0495)})
    _, terminated, _, info = step(env, 0.3)
    assert (terminated, info["termination_reason"]) == (False, "")
    assert info["tracking_error"] < 0.05


@each_kind
@pytest.mark.parametrize("slack_time", [0.0, 0.1])
def test_slack_for_longer_than_slack_time_terminates(kind, slack_time):
    env = make(kind, termination_radius=5.0, slack_time=slack_time)
    number, _, info = last_step(env, -0.2, 200)
    assert info["termination_reason"] == "slack"
    assert info["slack"].all()
    assert not info["tensions"].any()
    assert number == round(slack_time * 500) + 1
    assert info["time"] == pytest.approx(number / 500)


@each_kind
def test_short_slack_does_not_add_up(kind):
    env = make(kind, termination_radius=5.0, slack_time=0.05)
    env.reset()
    slack = []
    for _ in range(5):
        for action in [-0.9] * 24 + [0.9] * 2:  # 48 ms slack, 4 ms taut
            _, terminated, _, info = step(env, action)
            assert terminated is False
            slack.append(info["slack"].any())
    assert sum(slack) == 5 * 24
    for number in range(1, 27):
        _, terminated, _, info = step(env, -0.9)
        assert terminated == (number == 26)
    assert info["termination_reason"] == "slack"


def test_one_slack_cable_terminates():
    action = np.full(6, 0.9)
    action[3] = -0.9
    info = last_step(make("spatial", termination_radius=5.0), action, 60)[2]
    assert info["termination_reason"] == "slack"
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
            assert (terminated, info["termination_reason"]) == (reason != "", reason)


def test_non_finite_state_is_bounded_and_earns_nothing():
    """Physics steps that are far too long, under actions that alternate."""
    env = make("spatial", trajectory="paper-spatial", control_frequency=20.0, substeps=1)
    rng = np.random.default_rng(0)
    env.reset()
    reason = ""
    while reason != "non_finite":
        observation, _, terminated, _, info = env.step(rng.choice([-5.0, 5.0], 6))
        reason = info["termination_reason"]
    assert terminated
    assert observation in env.observation_space
    assert all(np.all(np.isfinite(value)) for name, value in info.items() if name != "termination_reason")
    for name in ("tracking_error", "rotation_error", "rotation_error_peak"):
        assert info[name] > 1e3
    assert max(info["reward_position"], info["reward_rotation"]) < 1e-3
    assert (info["violated"], info["reward_inside"]) == (True, 0.0)


def test_bilateral_cables_push():
    """Their tensions are negative, and count as slack."""
    env = make("spatial", cable="bilateral", slack_time=9.0)
    env.reset()
    _, _, _, info = step(env, -0.3)
    assert np.all(info["tensions"] < 0)
    assert info["slack"].all()


# ---------------------------------------------------------------------------------------------------- info columns


def random_run(kind, steps=150, radius=5.0, **keywords):
    """Environment, actions, observations, rewards and infos of an episode under random actions, many beyond ±1."""
    env = make(kind, trajectory=f"paper-{kind}", termination_radius=radius, slack_time=99.0, **keywords)
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    observations, rewards, infos, actions = [observation], [], [], []
    for number in range(steps):
        if number % 5 == 0:
            action = 1.6 * rng.uniform(-0.6, 1.0, env.action_space.shape)
        observation, reward, _, _, info = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
        actions.append(action)
    named = {name: np.array([info[name] for info in infos]) for name in infos[0]}
    return env, np.array(actions), np.array(observations), np.array(rewards), named


@each_kind
def test_info_has_the_raw_action_clipped_torques_and_slack_at_the_start_of_the_period(kind):
    env, actions, observations, _, info = random_run(kind, substeps=1)
    robot = ROBOTS[kind]
    np.testing.assert_array_equal(info["commanded_action"], actions)
    assert np.abs(actions).max() > 1.2
    drop = robot.speed_slope * info["motor_speeds"]
    assert np.abs(drop).max() > 0.05
    wanted = robot.stall_torque * np.clip(actions, -1, 1) - drop
    np.testing.assert_allclose(info["torques"], wanted, atol=1e-12)
    np.testing.assert_allclose(info["torque_margin"], robot.stall_torque * (1 - np.abs(actions)), atol=1e-12)
    np.testing.assert_allclose(info["action_time"], np.arange(150) / 500, atol=1e-12)
    np.testing.assert_allclose(info["time"], np.arange(1, 151) / 500, atol=1e-12)
    part = env.layout.split(observations)
    for number in range(0, 150, 7):
        jacobian = structure_jacobian(robot.base, robot.platform, part["pose"][number])
        speeds = jacobian @ part["velocity"][number] / -robot.pulley_radius
        np.testing.assert_allclose(info["motor_speeds"][number], speeds, atol=1e-9)
    np.testing.assert_array_equal(info["slack"], info["tensions"] == 0.0)
    assert 0.05 < info["slack"].mean() < 0.95
    assert np.all(info["tensions"] >= 0)


@each_kind
def test_peaks_and_slack_are_over_every_physics_step(kind):
    """A slow controller against a fast one that repeats its action.

    The motors' torque does not depend on their speed, so that both request the same torque. Their damping is so large
    that a cable goes slack within a period.
    """
    own, planar = ROBOTS[kind], ROBOTS[kind].planar
    robot = own.replace(
        motors=Motors(stall_torque=own.motors.stall_torque, free_speed=1e12),
        transmission=Transmission(pulley_radius=0.05, pulley_inertia=1e-5 if planar else 8e-4, damping=0.3),
    )
    keywords = {"robot": robot, "trajectory": f"paper-{kind}", "termination_radius": 5.0, "slack_time": 99.0}
    slow = make(kind, control_frequency=25.0, substeps=40, **keywords)
    fast = make(kind, control_frequency=1000.0, substeps=1, **keywords)
    rng = np.random.default_rng(3)
    inner, late, early = 0, 0, 0
    for _ in range(8):
        start = {"initial_error": [-0.2165, 0.4] if planar else displaced(kind, 0.01)}
        slow.reset(options=start)
        fast.reset(options=start)
        for period in range(3):
            action = rng.uniform(-0.2, 0.5, robot.cables)
            if planar and period == 0:
                action[:2] = 0.02, 0.6
            info = slow.step(action)[4]
            each = [fast.step(action)[4] for _ in range(40)]
            for name in ("tracking_error", "rotation_error"):
                errors = [one[name] for one in each]
                assert info[f"{name}_peak"] == pytest.approx(max(errors), abs=1e-9)
                assert info[name] == pytest.approx(errors[-1], abs=1e-9)
                inner += max(errors) > errors[-1] + 1e-6
            slack = np.array([one["slack"] for one in each])
            np.testing.assert_array_equal(info["slack"], slack.any(axis=0))
            late += np.sum(slack.any(axis=0) & ~slack[0])
            early += np.sum(slack.any(axis=0) & ~slack[-1])
            for name in ("tensions", "torques", "motor_speeds"):  # at the start of the period
                np.testing.assert_allclose(info[name], each[0][name], rtol=1e-6, atol=1e-9)
    assert inner > 0
    assert late > 0
    assert early > 0


# ---------------------------------------------------------------------------------------------------- uncertainty


def test_termination_uses_the_true_state():
    env = make("spatial", uncertainty={"sensors": {"position": 0.5}})
    env.reset(seed=0)
    assert not any(step(env, 0.3)[1] for _ in range(10))
