"""A planned motion between the instants of its program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_gym.motions import Trajectory, find_trajectory
from cablebot_gym.planning import Margins, MotionProgram
from cablebot_gym.planning.program import STAGES_PER_INTERVAL
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, SPATIAL, Robot
from cablebot_gym.task import ErrorBounds

pytest.importorskip("casadi")

BOUNDS = ErrorBounds(position=0.01, rotation=0.008)
MARGINS = Margins(position=0.002, rotation=0.003, action=0.1, tension=8.0)
PERIOD = 0.002
FINER = 20


@dataclass(frozen=True, kw_only=True)
class Case:
    """A planned motion."""

    robot: Robot
    reference: Trajectory
    intervals: int
    margins: Margins
    lightest: float | None = 0.0


CASES = {
    "planar": Case(
        robot=PLANAR,
        reference=find_trajectory("paper-planar", 2),
        intervals=40,
        margins=MARGINS,
    ),
    "spatial": Case(
        robot=SPATIAL,
        reference=find_trajectory({"name": "line-spatial", "duration": 0.6, "dwell": 0.0}, 6),
        intervals=30,
        margins=MARGINS,
        lightest=2.0,
    ),
    "flexible planar": Case(
        robot=FLEX_PLANAR,
        reference=find_trajectory({"name": "line-planar", "duration": 0.4, "dwell": 0.0}, 2),
        intervals=60,
        margins=replace(MARGINS, tension=2.0),  # episodes start with 5 N
        lightest=1.0,
    ),
}
each_case = pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == "planar" else pytest.mark.landing) for name in CASES],
)


@cache
def plan(name):
    case = CASES[name]
    keywords = {
        "intervals": case.intervals,
        "margins": case.margins,
        "lightest": case.lightest,
        "period": PERIOD,
    }
    return MotionProgram(case.robot, case.reference, BOUNDS, **keywords).solve()


# --- constraints between the program's instants -----------------------------------------------------------------------


@each_case
def test_error_bounds_hold_and_are_used_between_instants(name):
    motion = plan(name)
    case = CASES[name]
    margins = case.margins
    stages = STAGES_PER_INTERVAL[case.robot.joints] * case.intervals
    times = np.linspace(0.0, motion.duration, FINER * stages + 1)
    error = motion(times).position - case.reference(times).position
    position = np.linalg.norm(error[:, :3], axis=1).max()
    most = BOUNDS.position - margins.position
    assert most * (1 - 1e-3) < position < most * (1 + 3e-3)
    if not case.robot.planar:
        rotation = np.abs(error[:, 3:]).max()
        most = BOUNDS.rotation - margins.rotation
        assert 0.9 * most < rotation < most * (1 + 6e-3)


# --- the start --------------------------------------------------------------------------------------------------------


@each_case
def test_motion_starts_in_the_state_of_an_episode(name):
    """A spatial robot starts lower by half the position bound."""
    start = plan(name)(0.0)
    reference = CASES[name].reference
    robot = CASES[name].robot
    lowered = np.zeros(2) if robot.planar else np.array([0, 0, BOUNDS.position / 2, 0, 0, 0])
    assert_allclose(start.position, reference(0.0).position + lowered, atol=1e-9)
    assert_allclose(start.velocity, reference(0.0).velocity, atol=1e-6)


# --- as a trajectory --------------------------------------------------------------------------------------------------


def test_motion_is_a_trajectory_that_rests_outside_its_duration():
    motion = plan("planar")
    assert find_trajectory(motion, 2) is motion
    reference = CASES["planar"].reference
    assert (motion.name, motion.duration) == (reference.name, reference.duration)
    after = motion(motion.duration + 0.3)
    before = motion(-0.3)
    assert_array_equal(after.position, motion(motion.duration).position)
    for rate in (after.velocity, after.acceleration, after.jerk, after.snap):
        assert_array_equal(rate, 0.0)
    assert_array_equal(before.position, motion(0.0).position)
    assert {value.shape for value in vars(motion(np.zeros((4, 3)))).values()} == {
        (4, 3, motion.coordinates)
    }


# --- invalid input ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "margins", "message"),
    [
        (PLANAR, {"position": -1e-3}, "margins: position must be"),
        (PLANAR, {"action": 1.0}, "margins: action must be"),
        (SPATIAL, {"position": BOUNDS.position}, "position must be below the error bound"),
        (FLEX_PLANAR, {"tension": 4.5}, "at most 4 N for 'flex-planar'"),
        (
            PLANAR.replace(maximum_tension=7.0),
            {"tension": 3.1},
            "tension must be at most 3 N for 'planar'",
        ),
        # a plan that ignores the lag would fail in the environment
        (
            PLANAR.replace(motors=PLANAR.motors.replace(lag=0.01)),
            {},
            "need motors without lag, but the motors of robot 'planar' have a lag",
        ),
    ],
)
def test_robot_or_margins_without_a_motion_raise(robot, margins, message):
    reference = find_trajectory(f"paper-{robot.kind}", robot.coordinates)
    with pytest.raises(ValueError, match=message):
        MotionProgram(robot, reference, BOUNDS, intervals=4, margins=Margins(**margins))
