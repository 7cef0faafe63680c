"""A planned motion between the instants of its program, and torques that follow it in the plant of
the environment."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.episodes import make
from scipy.interpolate import BSpline

from cablebot_gym.motions import ORDERS, find_trajectory
from cablebot_gym.planning import (
    Follower,
    Infeasible,
    Margins,
    MotionProgram,
    PlannedMotion,
    PlannedMotions,
    State,
    clamped_knots,
)
from cablebot_gym.planning.motion import FLEXIBLE_DEGREE, MOTOR_DEGREE, RIGID_DEGREE
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


# --- splines ----------------------------------------------------------------------------------------------------------


def random_plan(duration, intervals, degree, seed):
    random = np.random.default_rng(seed)
    motors = ()
    if degree == FLEXIBLE_DEGREE:
        motors = tuple(random.normal(size=(2, intervals + MOTOR_DEGREE, 3)))
    return PlannedMotion(
        name="random",
        knots=clamped_knots(duration, intervals, degree),
        poses=random.normal(size=(intervals + degree, 2)),
        motors=motors,
        payload=2.0,
        lightest=0.5,
        minimum_tension=1.0 + seed,
    )


@pytest.mark.parametrize("degree", [RIGID_DEGREE, FLEXIBLE_DEGREE])
def test_each_row_of_a_batch_has_the_spline_of_its_own_plan(degree):
    """At knots and between them, and at rest after the end."""
    plans = [random_plan(0.8, 10, degree, 0), random_plan(1.2, 25, degree, 1)]
    times = np.array([0.0, 0.13, 0.16, 0.8, 1.0, 0.8, 1.2, 1.3])
    rows = [0, 1, 0, 0, 0, 1, 1, 1]
    motions = PlannedMotions([plans[row] for row in rows])
    together = motions(times)
    for index, row in enumerate(rows):
        plan = plans[row]
        spline = BSpline(plan.knots, plan.poses, degree)
        for order, name in enumerate(ORDERS):
            expected = np.zeros(2)
            if order == 0 or (order <= degree and times[index] <= plan.duration):
                expected = spline(min(times[index], plan.duration), nu=order)
            values = getattr(together, name)[index], getattr(plan(times[index]), name)
            assert_allclose(values, [expected] * 2, rtol=1e-9, atol=1e-11 * 100.0**order)
    assert motions.minimum_tension.tolist() == [1.0 + row for row in rows]


def test_motor_angles_are_affine_in_the_payload_of_each_row():
    plans = [random_plan(0.8, 10, FLEXIBLE_DEGREE, seed) for seed in (0, 1)]
    payloads = np.array([0.0, 3.0])
    angles, *_ = PlannedMotions(plans).motor_motion(np.array([0.3, 0.5]), payloads)
    for index, plan in enumerate(plans):
        knots = plan.knots[FLEXIBLE_DEGREE - MOTOR_DEGREE : MOTOR_DEGREE - FLEXIBLE_DEGREE]
        splines = [BSpline(knots, points, MOTOR_DEGREE) for points in plan.motors]
        heaviest, lightest = (spline([0.3, 0.5][index]) for spline in splines)
        part = (payloads[index] - plan.lightest) / (plan.payload - plan.lightest)
        assert_allclose(angles[index], lightest + part * (heaviest - lightest), atol=1e-12)


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
