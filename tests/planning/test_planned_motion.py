"""A planned motion between the instants that its program looks at, by the textbook's equations and the plant itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

import cablebot_gym  # noqa: F401  # registers the ids
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Margins, MotionProgram, PlannedMotion
from cablebot_gym.planning.program import STAGES_PER_INTERVAL
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Trajectory, find_trajectory

pytest.importorskip("casadi")

LIMITS = ErrorBounds(position=0.01, rotation=0.008)
PERIOD = 0.002
FINER = 20


NONE = Margins()


@dataclass(frozen=True)
class Case:
    """A plan to be made."""

    robot: Robot
    trajectory: str | dict[str, Any]
    intervals: int
    margins: Margins = NONE
    lightest: float | None = None

    @property
    def reference(self) -> Trajectory:
        return find_trajectory(self.trajectory, self.robot.coordinates)


ROOM = Margins(position=0.002, rotation=0.003, action=0.1, tension=8.0)
LOW_ROOM = replace(ROOM, tension=3.0)
"""Flexible planar robots start with 5 N in their cables: no plan can leave more."""
FAST_LINE = {"name": "line-planar", "duration": 0.4}
SHORT_LINE = {"name": "line-spatial", "duration": 0.6}
CASES = {
    "planar": Case(PLANAR, "paper-planar", 40),
    "planar, margins, two loads": Case(PLANAR, "paper-planar", 40, ROOM, 0.0),
    "spatial": Case(SPATIAL, "paper-spatial", 40),
    "spatial, margins, two loads": Case(SPATIAL, SHORT_LINE, 30, ROOM, 2.0),
    "flexible planar": Case(FLEX_PLANAR, FAST_LINE, 60),
    "flexible planar, margins, two loads": Case(FLEX_PLANAR, FAST_LINE, 60, LOW_ROOM, 1.0),
    "flexible spatial": Case(FLEX_SPATIAL, SHORT_LINE, 30),
}
SWINGS = {"planar": 2e-3, "spatial": 3e-3, "flexible planar": 0.01, "flexible spatial": 0.05}
"""Excess of the demand between instants: where a flexible robot's motors are thrown from one side to the other, their
speed bulges, and with it the line of their torque. Holding them at twice as many instants leaves a fourth of it."""
every_case = pytest.mark.parametrize("name", CASES)
flexible_cases = pytest.mark.parametrize("name", [name for name in CASES if name.startswith("flexible")])


@cache
def plan(name: str) -> PlannedMotion:
    case = CASES[name]
    program = MotionProgram(
        case.robot,
        case.reference,
        LIMITS,
        intervals=case.intervals,
        margins=case.margins,
        lightest=case.lightest,
        period=PERIOD,
    )
    return program.solve()


def payloads(name: str) -> list[float]:
    """The lightest, the heaviest and two between, or the only one."""
    motion = plan(name)
    if CASES[name].lightest is None:
        return [motion.payload]
    return [motion.lightest + fraction * (motion.payload - motion.lightest) for fraction in (0.0, 0.31, 0.77, 1.0)]


def fine_times(name: str) -> Array:
    return np.linspace(
        0.0, plan(name).duration, FINER * STAGES_PER_INTERVAL[CASES[name].robot.joints] * CASES[name].intervals + 1
    )


@dataclass(frozen=True)
class Asked:
    """What a motion asks of cables and motors."""

    tensions: Array
    springs: Array
    action: Array
    unbalanced: Array


def asked(name: str, payload: float) -> Asked:
    """By the textbook; a flexible robot's from the motor angles, a rigid one's from the motion alone."""
    robot, motion, times = CASES[name].robot, plan(name), fine_times(name)
    x = motion(times)
    mass = robot.mass + payload
    pulley = textbook.pulley_acceleration(robot, x.position, x.velocity, x.acceleration)
    speed = textbook.pulley_speed(robot, x.position, x.velocity)
    if robot.flexible:
        angle, motor_speed, acceleration = motion.motor_motion(times, np.full(len(times), payload))
        springs = robot.stiffness * (angle - textbook.pulley_angle(robot, x.position))
        tensions = (springs - robot.pulley_inertia * pulley - robot.damping * speed) / robot.pulley_radius
        torques = springs + robot.motor_inertia * acceleration + robot.motor_damping * motor_speed
    else:
        needed = textbook.inverse_dynamics(
            robot, mass, x.position, x.velocity, x.acceleration, minimum=CASES[name].margins.tension
        )
        tensions, torques, motor_speed, acceleration = needed.tensions, needed.torques, speed, pulley
        springs = tensions * robot.pulley_radius
    structure = textbook.jacobian(robot, x.position)
    unbalanced = textbook.load(robot, mass, x.position, x.velocity, x.acceleration)
    unbalanced = unbalanced + np.einsum("tij,ti->tj", structure, tensions)
    half = PERIOD / 2 * acceleration
    action = np.stack([textbook.normalised_action(robot, torques, motor_speed + side) for side in (-half, half)])
    return Asked(tensions, springs, action, unbalanced)


# --- limits between nodes ---------------------------------------------------------------------------------------------


@every_case
def test_motion_does_not_leave_the_tube_between_nodes(name: str) -> None:
    motion, times, margins = plan(name), fine_times(name), CASES[name].margins
    error = motion(times).position - CASES[name].reference(times).position
    along = np.linalg.norm(error[:, :3], axis=1).max()
    most = LIMITS.position - margins.position
    assert most * (1 - 1e-3) < along < most * (1 + 3e-3)  # it is this tube, and it is used
    if not CASES[name].robot.planar:
        turned, most = np.abs(error[:, 3:]).max(), LIMITS.rotation - margins.rotation
        assert 0.9 * most < turned < most * (1 + 6e-3)


@every_case
def test_no_load_asks_for_more_than_the_motors_have_between_nodes(name: str) -> None:
    peaks = [np.abs(asked(name, payload).action).max() for payload in payloads(name)]
    most = 1 - CASES[name].margins.action
    assert most - 2e-3 < max(peaks) < most + SWINGS[name.partition(",")[0]]


@every_case
def test_no_cable_or_spring_pushes_between_nodes(name: str) -> None:
    robot, least = CASES[name].robot, CASES[name].margins.tension
    for payload in payloads(name):
        found = asked(name, payload)
        assert found.tensions.min() > least - 0.6
        assert found.springs.min() > robot.pulley_radius.min() * (least - 0.6)


@every_case
def test_forces_are_not_out_of_balance_between_nodes(name: str) -> None:
    for payload in payloads(name):
        scale = 9.81 * (CASES[name].robot.mass + payload)
        assert np.abs(asked(name, payload).unbalanced).max() < 1e-3 * scale


@pytest.mark.parametrize("name", ["planar, margins, two loads", "spatial, margins, two loads"])
def test_room_for_a_lighter_load_is_not_given_away(name: str) -> None:
    """The heaviest alone may move so that the lightest cannot: two loads carry no more than one."""
    case = CASES[name]
    alone = MotionProgram(
        case.robot, case.reference, LIMITS, intervals=case.intervals, margins=case.margins, period=PERIOD
    ).solve()
    assert plan(name).payload < alone.payload * (1 + 1e-5)
    assert plan(name).lightest == case.lightest
    assert alone.lightest == alone.payload


@pytest.mark.parametrize(("without", "with_"), [("planar", "planar, margins, two loads")])
def test_margins_are_not_for_nothing(without: str, with_: str) -> None:
    assert plan(with_).payload < 0.95 * plan(without).payload


# --- the start --------------------------------------------------------------------------------------------------------


@every_case
def test_motion_does_not_start_off_the_reference(name: str) -> None:
    start, reference = plan(name)(0.0), CASES[name].reference(0.0)
    np.testing.assert_allclose(start.position, reference.position, atol=1e-9)
    np.testing.assert_allclose(start.velocity, reference.velocity, atol=1e-6)


@flexible_cases
def test_springs_do_not_start_with_another_wind_up_than_an_episode(name: str) -> None:
    """The plant's own: β′ holds the payload at rest, β̇′ = β̇."""
    env_id = "CableBot-FlexPlanar-v0" if CASES[name].robot.planar else "CableBot-FlexSpatial-v0"
    for payload in payloads(name):
        env = gym.make(env_id, trajectory=CASES[name].reference, payload=payload)
        observation, _ = env.reset(seed=0)
        part = env.unwrapped.layout.split(observation)
        angle, speed, _ = plan(name).motor_motion(0.0, np.asarray(payload))
        np.testing.assert_allclose(angle, part["motor_angle"], atol=1e-4)
        np.testing.assert_allclose(speed, part["motor_speed"], atol=1e-3)
        env.close()


# --- as a trajectory --------------------------------------------------------------------------------------------------


@every_case
def test_motion_is_no_less_than_a_trajectory(name: str) -> None:
    motion = plan(name)
    assert isinstance(motion, Trajectory)
    assert find_trajectory(motion, CASES[name].robot.coordinates) is motion
    assert (motion.name, motion.duration) == (CASES[name].reference.name, CASES[name].reference.duration)


@pytest.mark.parametrize("name", ["spatial", "flexible planar"])
def test_derivatives_are_not_those_of_another_motion(name: str) -> None:
    times = fine_times(name)
    x = plan(name)(times)
    for rate, value, start in (
        (x.velocity, x.position, x.position[0]),
        (x.acceleration, x.velocity, x.velocity[0]),
    ):
        back = start + cumulative_simpson(rate, x=times, axis=0, initial=0.0)
        np.testing.assert_allclose(back, value, atol=1e-5 * np.ptp(value))


@pytest.mark.parametrize("name", ["spatial", "flexible planar"])
def test_motion_does_not_go_on_before_its_start_or_after_its_end(name: str) -> None:
    motion = plan(name)
    after, before = motion(motion.duration + 0.3), motion(-0.3)
    np.testing.assert_array_equal(after.position, motion(motion.duration).position)
    for rate in (after.velocity, after.acceleration, after.jerk, after.snap):
        np.testing.assert_array_equal(rate, 0.0)
    np.testing.assert_array_equal(before.position, motion(0.0).position)
    shapes = {value.shape for value in vars(motion(np.zeros((4, 3)))).values()}
    assert shapes == {(4, 3, motion.coordinates)}


def test_an_environment_does_not_refuse_a_plan_as_its_motion() -> None:
    """The law follows it with the plan's payload where it cannot follow the circle; then it rests."""
    motion = plan("planar, margins, two loads")
    law, steps = load_policy("fl", PLANAR), round(motion.duration * 500)
    env = gym.make("CableBot-Planar-v0", trajectory=motion, payload=motion.payload, max_episode_steps=steps + 250)
    observation, _ = env.reset(seed=0)
    layout = env.unwrapped.layout
    np.testing.assert_allclose(layout.split(observation)["pose"], motion(0.0).position, atol=1e-6)
    errors, peak = [], 0.0
    for step in range(steps + 250):
        observation, _, terminated, _, info = env.step(law.predict(observation)[0])
        assert not terminated
        errors.append(float(info["tracking_error"]))
        if step < steps:
            peak = max(peak, float(np.abs(info["commanded_action"]).max()))
    env.close()
    assert max(errors[:steps]) < 1e-3
    assert peak < 1.0
    np.testing.assert_allclose(layout.split(observation)["pose"], motion(motion.duration).position, atol=1e-3)
    np.testing.assert_allclose(layout.split(observation)["velocity"], 0.0, atol=0.05)


# --- motor angles between payloads, arrays, margins -------------------------------------------------------------------


@pytest.mark.parametrize("name", ["flexible planar, margins, two loads"])
def test_motor_angles_of_a_batch_are_not_mixed_up(name: str) -> None:
    motion = plan(name)
    times, loads = np.array([0.05, 0.2, 0.37]), np.array(payloads(name)[:3])
    together = motion.motor_motion(times, loads)
    for place in range(3):
        alone = motion.motor_motion(times[place], loads[place])
        for one, all_ in zip(alone, together, strict=True):
            np.testing.assert_allclose(one, all_[place], rtol=1e-12)


@pytest.mark.parametrize("name", ["planar", "flexible planar, margins, two loads"])
def test_arrays_do_not_lose_anything(name: str) -> None:
    motion = plan(name)
    again = PlannedMotion.from_arrays(motion.to_arrays())
    for field in ("name", "payload", "lightest", "minimum_tension", "duration", "degree"):
        assert getattr(again, field) == getattr(motion, field)
    np.testing.assert_array_equal(again(0.37).acceleration, motion(0.37).acceleration)
    assert len(again.motors) == len(motion.motors)
    for one, other in zip(again.motors, motion.motors, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("field", "value"), [("position", -1e-3), ("rotation", np.nan), ("action", 1.0), ("tension", np.inf)]
)
def test_margins_that_mean_nothing_are_not_taken(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"margins: {field} must be at least 0 and below"):
        Margins(**{field: value})


def test_scaling_margins_does_not_leave_one_out() -> None:
    assert ROOM.scaled(0.5) == Margins(position=0.001, rotation=0.0015, action=0.05, tension=4.0)


@pytest.mark.parametrize("field", ["position", "rotation"])
def test_margins_that_leave_nothing_of_a_limit_are_not_planned_with(field: str) -> None:
    margins = replace(Margins(), **{field: getattr(LIMITS, field)})
    with pytest.raises(ValueError, match=f"margins: {field} must be below the error bound"):
        MotionProgram(SPATIAL, find_trajectory("paper-spatial", 6), LIMITS, intervals=4, margins=margins)


def test_more_tension_than_there_is_at_the_start_is_not_left_to_the_solver_to_refuse() -> None:
    margins = Margins(tension=textbook.MINIMUM_TENSION + 1)
    with pytest.raises(ValueError, match="at most 5 N, the initial tension of 'flex-planar', not 6 N"):
        MotionProgram(FLEX_PLANAR, find_trajectory("paper-planar", 2), LIMITS, intervals=20, margins=margins)
