"""Torques that follow a plan, against the plants of the textbook and of the environment."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.episodes import make

from cablebot_gym.motions import find_trajectory
from cablebot_gym.planning import Follower, Margins, MotionProgram, State
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


@cache
def plan(name):
    robot, _, intervals = CASES[name]
    line = {"name": f"line-{robot.kind}", "duration": 0.5 if robot.planar else 0.4}
    reference = find_trajectory(line, robot.coordinates)
    keywords = {"margins": MARGINS, "period": 0.002, "lightest": 1.0}
    return MotionProgram(robot, reference, ErrorBounds(), intervals=intervals, **keywords).solve()


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


# --- one period -------------------------------------------------------------------------------------------------------


@each_case
def test_action_of_a_row_of_a_batch_is_that_alone(name):
    robot = CASES[name][0]
    motion = plan(name)
    times = np.array([0.1, 0.3])
    payload = np.full(2, motion.payload)
    x = motion(times)
    values = {"time": times, "pose": x.position + 1e-3, "velocity": x.velocity}
    if robot.flexible:
        values["motor_angle"], values["motor_speed"], _ = motion.motor_motion(times, payload)
    follower = Follower(robot=robot, gains=(100.0, 10.0))
    together = follower.action(motion, State(**values), payload, 0.002)
    for k in range(2):
        state = State(**{block: array[k] for block, array in values.items()})
        alone = follower.action(motion, state, payload[k], 0.002)
        assert_allclose(together[k], alone, rtol=1e-9, atol=1e-12)


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
