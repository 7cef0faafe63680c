"""A planned motion between the instants of its program, and torques that follow it in the plant of
the environment."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.episodes import make

from cablebot_gym.motions import find_trajectory
from cablebot_gym.planning import Follower, Infeasible, Margins, MotionProgram, State
from cablebot_gym.planning.program import STAGES_PER_INTERVAL
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds

pytest.importorskip("casadi")

NO_GAINS = (0.0, 0.0)
MARGINS = Margins(position=0.001, rotation=0.001, action=0.1, tension=2.0)

CASES = {
    "planar": (PLANAR, "CableBot-Planar-v0", 40),
    "spatial": (SPATIAL, "CableBot-Spatial-v0", 20),
    "flexible planar": (FLEX_PLANAR, "CableBot-FlexPlanar-v0", 40),
}
"""Robot, environment and number of spline intervals."""
each_case = pytest.mark.parametrize(
    "name",
    [
        "planar",
        pytest.param("flexible planar", marks=pytest.mark.landing),
        pytest.param("spatial", marks=pytest.mark.landing),
    ],
)


def reference_of(name):
    kind = CASES[name][0].kind
    return find_trajectory({"name": f"line-{kind}", "duration": 0.4}, kind)


@cache
def plan(name):
    robot, _, intervals = CASES[name]
    keywords = {"margins": MARGINS, "period": 0.002, "lightest": 1.0}
    program = MotionProgram(
        robot, reference_of(name), ErrorBounds(), intervals=intervals, **keywords
    )
    return program.solve()


# --- between the program's instants -----------------------------------------------------------------------------------


@each_case
def test_error_bounds_hold_and_are_used_between_instants(name):
    """From the start of an episode on, which is lower by half the position bound in space."""
    motion = plan(name)
    robot, _, intervals = CASES[name]
    times = np.linspace(0.0, motion.duration, 20 * STAGES_PER_INTERVAL[robot.joints] * intervals)
    reference = reference_of(name)(times)
    error = motion(times).position - reference.position
    start = ErrorBounds().position / 2 * (np.arange(robot.coordinates) == 2)
    assert_allclose(error[0], start, atol=1e-9)
    assert_allclose(motion(0.0).velocity, reference.velocity[0], atol=1e-6)
    position = np.linalg.norm(error[:, :3], axis=1).max()
    most = ErrorBounds().position - MARGINS.position
    assert most * (1 - 1e-3) < position < most * (1 + 3e-3)
    if not robot.planar:
        most = ErrorBounds().rotation - MARGINS.rotation
        assert 0.9 * most < np.abs(error[:, 3:]).max() < most * (1 + 0.012)


def follow(name, gains, *, payload=None, error=0.0):
    """Results of each control period by name, of the plan's heaviest payload or another one in the
    environment's plant."""
    robot, env_id, _ = CASES[name]
    motion = plan(name)
    if payload is None:
        payload = motion.payload
    follower = Follower(robot=robot, gains=gains, motor_frequency=200.0)
    start_error = error * np.eye(robot.coordinates)[0]
    env = make(env_id, trajectory=motion, payload=payload, initial_error=start_error)
    observation, _ = env.reset(seed=0)
    infos = []
    for step in range(round(motion.duration * 500)):
        state = State.from_blocks(env.layout.split(observation), np.asarray(step / 500))
        action = follower.action(motion, state, np.asarray(payload), 1 / 500)
        observation, _, terminated, _, info = env.step(np.clip(action, -1, 1))
        assert not terminated
        infos.append(info)
    return {key: np.array([info[key] for info in infos]) for key in info}


# --- a whole motion ---------------------------------------------------------------------------------------------------


@each_case
def test_plan_is_followed_and_an_initial_error_corrected(name):
    def errors(gains, **start):
        return follow(name, gains, **start)["tracking_error"]

    if CASES[name][0].flexible:
        assert errors((100.0, 10.0)).max() < 3e-5
        gains = 100.0, 20.0
    else:
        assert errors((2500.0, 100.0)).max() < 1e-5
        gains = 400.0, 40.0
    without = errors(NO_GAINS, error=5e-4)
    corrected = errors(gains, error=5e-4)
    assert corrected[0] == pytest.approx(5e-4, rel=0.1)
    assert corrected[-1] < 0.2 * 5e-4
    assert corrected[-1] < 0.5 * without[-1]


@each_case
def test_plan_keeps_its_margins_with_all_payloads(name):
    robot = CASES[name][0]
    motion = plan(name)
    least = robot.minimum_tension + MARGINS.tension
    actions = []
    for fraction in (0.0, 0.31, 0.77, 1.0):
        payload = motion.lightest + fraction * (motion.payload - motion.lightest)
        results = follow(name, (100.0, 10.0), payload=payload)
        actions.append(np.abs(results["commanded_action"]).max())
        assert results["least_tensions"].min() > least - 0.6
    most = 1 - MARGINS.action
    assert most - 2e-3 < max(actions) < most + 0.01


# --- invalid input ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "margins"),
    [
        (PLANAR, {"position": 0.02}),
        (PLANAR.replace(maximum_tension=7.0), {"tension": 3.1}),
    ],
)
def test_margins_larger_than_the_range_are_infeasible(robot, margins):
    reference = find_trajectory(f"paper-{robot.kind}", robot.coordinates)
    margins = Margins(**margins)
    program = MotionProgram(robot, reference, ErrorBounds(), intervals=4, margins=margins)
    with pytest.raises(Infeasible):
        program.solve()


def test_robot_with_motor_lag_is_refused():
    """It would fail in the environment."""
    robot = PLANAR.replace(motors=PLANAR.motors.replace(lag=0.01))
    with pytest.raises(
        ValueError, match="need motors without lag, but the motors of robot 'planar'"
    ):
        MotionProgram(robot, find_trajectory("paper-planar", 2), ErrorBounds(), intervals=4)
