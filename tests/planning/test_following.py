"""Torques that follow a plan, against the textbook's and the environment's own plants."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cablebot_gym  # noqa: F401  # registers the ids
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Follower, Margins, MotionProgram, PlannedMotion
from cablebot_gym.planning.following import State
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import find_trajectory

pytest.importorskip("casadi")

NO_GAINS = (0.0, 0.0)
ROOM = Margins(position=0.001, rotation=0.001, action=0.1, tension=2.0)


@dataclass(frozen=True)
class Case:
    """A robot and a motion that is made for it."""

    robot: Robot
    env_id: str
    motion: str
    intervals: int


CASES = {
    "planar": Case(PLANAR, "CableBot-Planar-v0", "line-planar", 40),
    "spatial": Case(SPATIAL, "CableBot-Spatial-v0", "line-spatial", 20),
    "flexible planar": Case(FLEX_PLANAR, "CableBot-FlexPlanar-v0", "line-planar", 60),
    "flexible spatial": Case(FLEX_SPATIAL, "CableBot-FlexSpatial-v0", "line-spatial", 30),
}
every_case = pytest.mark.parametrize("name", CASES)


@cache
def plan(name: str) -> PlannedMotion:
    case = CASES[name]
    duration = 0.5 if case.robot.planar else 0.6
    reference = find_trajectory({"name": case.motion, "duration": duration}, case.robot.coordinates)
    error_bounds = ErrorBounds(position=0.01, rotation=0.01)
    return MotionProgram(
        case.robot, reference, error_bounds, intervals=case.intervals, margins=ROOM, period=0.002
    ).solve()


def follow(name: str, follower: Follower, *, error: float = 0.0, frequency: float = 500.0) -> np.ndarray:
    """Distance of the platform from the plan after every control period, in the environment's plant."""
    case, motion, period = CASES[name], plan(name), 1 / frequency
    steps = round(motion.duration * frequency)
    first = np.zeros(case.robot.coordinates)
    first[0] = error
    env = gym.make(
        case.env_id,
        trajectory=motion,
        payload=motion.payload,
        initial_error=first,
        control_frequency=frequency,
        max_episode_steps=steps,
    )
    observation, _ = env.reset(seed=0)
    layout, distances = env.unwrapped.layout, []
    for step in range(steps):
        state = State.of(layout.split(observation), np.asarray(step * period))
        action = follower.action(motion, state, np.asarray(motion.payload), period)
        observation, _, terminated, _, info = env.step(np.clip(action, -1, 1))
        assert not terminated
        distances.append(float(info["tracking_error"]))
    env.close()
    return np.array(distances)


# --- one period -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_velocity_after_a_held_torque_is_not_off_by_more_than_third_order(name: str) -> None:
    """Torques of the period's beginning, held, would be off by the second."""
    robot, motion = CASES[name].robot, plan(name)
    follower = Follower(robot=robot, gains=NO_GAINS)
    n, mass, time = robot.coordinates, robot.mass + motion.payload, 0.2931
    x = motion(time)

    def off(period: float) -> float:
        state = State(time=np.asarray(time), pose=x.position, velocity=x.velocity)
        torques, speeds = follower.torques(motion, state, np.asarray(motion.payload), period)
        np.testing.assert_allclose(speeds, textbook.pulley_speed(robot, x.position, x.velocity), rtol=1e-9)

        def rates(_: float, y: np.ndarray) -> np.ndarray:
            acceleration = textbook.forward_dynamics(robot, mass, y[:n], y[n:], torques, cable="bilateral")[0]
            return np.r_[y[n:], acceleration]

        end = solve_ivp(rates, (0, period), np.r_[x.position, x.velocity], rtol=1e-11, atol=1e-13).y[:, -1]
        return float(np.abs(end[n:] - motion(time + period).velocity).max())

    errors = [off(period) for period in (0.004, 0.002)]
    assert errors[1] < errors[0] / 5
    assert errors[1] < 1e-4 * np.abs(x.velocity).max()


@every_case
def test_commands_are_not_other_torques_than_they_ask_for(name: str) -> None:
    robot, motion = CASES[name].robot, plan(name)
    x, payload = motion(0.25), np.asarray(motion.payload)
    angle, speed = motion.motor_motion(0.25, payload)[:2] if robot.flexible else (None, None)
    state = State(time=np.asarray(0.25), pose=x.position, velocity=x.velocity, motor_angle=angle, motor_speed=speed)
    follower = Follower(robot=robot, gains=(100.0, 10.0))
    torques, speeds = follower.torques(motion, state, payload, 0.002)
    command = follower.action(motion, state, payload, 0.002)
    low, high = textbook.torque_limits(robot, speeds)
    np.testing.assert_allclose((high - low) / 2 * command + (high + low) / 2, torques, rtol=1e-9, atol=1e-9)


@every_case
def test_a_batch_is_not_other_than_its_rows(name: str) -> None:
    robot, motion = CASES[name].robot, plan(name)
    times, payload = np.array([0.1, 0.3]), np.full(2, motion.payload)
    x = motion(times)
    pose = x.position + 1e-3
    angle, speed = motion.motor_motion(times, payload)[:2] if robot.flexible else (None, None)
    follower = Follower(robot=robot, gains=(100.0, 10.0))

    def state(k: int | slice) -> State:
        more = {"motor_angle": angle[k], "motor_speed": speed[k]} if robot.flexible else {}
        return State(time=times[k], pose=pose[k], velocity=x.velocity[k], **more)

    together = follower.action(motion, state(slice(None)), payload, 0.002)
    assert together.shape == (2, robot.cables)
    for k in range(2):
        alone = follower.action(motion, state(k), payload[k], 0.002)
        np.testing.assert_allclose(together[k], alone, rtol=1e-9, atol=1e-12)


def test_a_last_period_that_reaches_over_the_end_by_rounding_does_not_brake() -> None:
    """829 periods and one more are 1.6600000000000001 s, where a plan of 1.66 s has come to rest at once."""
    period, steps, duration = 0.002, 830, 1.66
    last = (steps - 1) * period
    assert last + period > duration
    reference = find_trajectory({"name": "line-planar", "duration": duration}, 2)
    drift = PlannedMotion(
        name="drift",
        knots=np.array([0.0, 0.0, duration, duration]),
        poses=reference(0.0).position + np.array([[0.0, 0.0], [0.1, 0.0]]),
        motors=(),
        payload=1.0,
        lightest=1.0,
        minimum_tension=0.0,
    )
    follower = Follower(robot=PLANAR, gains=NO_GAINS)

    def torques(time: float) -> np.ndarray:
        x = drift(time)
        state = State(time=np.asarray(time), pose=x.position, velocity=x.velocity)
        return follower.torques(drift, state, np.asarray(1.0), period)[0]

    np.testing.assert_allclose(torques(last), torques(last - period), atol=1e-3)


# --- a whole motion ---------------------------------------------------------------------------------------------------


@every_case
def test_following_a_plan_does_not_lose_it(name: str) -> None:
    robot = CASES[name].robot
    follower = Follower(robot=robot, gains=(100.0, 10.0) if robot.flexible else (2500.0, 100.0), motor_frequency=200.0)
    assert follow(name, follower).max() < (3e-5 if robot.flexible else 1e-5)


@every_case
def test_feedback_does_not_leave_an_error_of_the_start(name: str) -> None:
    robot = CASES[name].robot
    gains = (100.0, 20.0) if robot.flexible else (400.0, 40.0)
    kept, corrected = (
        follow(name, Follower(robot=robot, gains=chosen, motor_frequency=200.0), error=5e-4)
        for chosen in (NO_GAINS, gains)
    )
    assert corrected[0] == pytest.approx(5e-4, rel=0.1)
    assert corrected[-1] < 0.2 * 5e-4
    assert corrected[-1] < 0.5 * kept[-1]


def test_a_slower_drive_is_not_followed_by_torques_of_another_period() -> None:
    follower = Follower(robot=PLANAR, gains=NO_GAINS)
    right = follow("planar", follower, frequency=100.0)
    assert right.max() < 1e-3


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gains", [(-1.0, 1.0), (1.0, np.inf), (np.nan, 1.0)])
def test_gains_that_drive_apart_are_not_taken(gains: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="gains must be finite and at least 0"):
        Follower(robot=PLANAR, gains=gains)


@pytest.mark.parametrize("field", ["motor_frequency", "motor_damping"])
def test_a_motor_loop_without_a_rate_is_not_taken(field: str) -> None:
    with pytest.raises(ValueError, match="must be finite and greater than 0"):
        Follower(robot=FLEX_PLANAR, gains=(1.0, 1.0), **{field: 0.0})
