"""Linear models of small motions against differences of the equations of motion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.plants import (
    FLEX_HANGING,
    ROUGH,
    ElasticState,
    State,
    drive_speed,
    each_of,
    textbook_rates,
    with_transmission,
)
from oracles.platforms import CAMERA, SWIVELLED, TURNING

from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR

PAYLOAD = 2.5
SOFT = {"axial_stiffness": 2e4, "extra_length": 0.3}
SPRINGS = {"stiffness": 900.0, "motor_inertia": 1e-3}
ROBOTS = [PLANAR, *ROUGH, FLEX_HANGING]
for springs in (SOFT, SPRINGS, SOFT | SPRINGS):
    ROBOTS += [with_transmission(robot, **springs) for robot in (CAMERA, SWIVELLED, TURNING)]


def rates_of(robot, mass, states, actions):
    """Rates (N, k) of states, which are angles of the platform, the pulleys of elastic cables and
    the motors of joint springs, and their speeds."""
    positions, rates = np.hsplit(states, 2)
    blocks = [robot.coordinates, robot.coordinates + robot.cables]
    pose, *angles = np.split(positions, blocks, axis=1)
    velocity, *speeds = np.split(rates, blocks, axis=1)
    motor = int(robot.elastic and robot.jointed)
    state = State(pose, velocity, angles[motor], speeds[motor])
    if robot.elastic:
        state = ElasticState(**vars(state), pulley=angles[0], pulley_speed=speeds[0])
    torques = robot.stall_torque * actions - robot.speed_slope * drive_speed(robot, state)
    slopes, _ = textbook_rates(robot, state, torques, mass=mass)
    accelerations = [slopes.velocity]
    if robot.elastic:
        accelerations.append(slopes.pulley_speed)
    if robot.jointed:
        accelerations.append(slopes.speed)
    return np.concatenate([rates, *accelerations], axis=1)


@each_of(*ROBOTS)
def test_state_space_has_the_differences_of_the_plant(robot):
    """Of friction, springs, elastic cables, tensions and weight."""
    robot = robot.replace(motors=robot.motors.replace(lag=0.0))
    mass = robot.mass + PAYLOAD
    pose = robot.home + np.linspace(0.02, 0.05, robot.coordinates)
    model = textbook.linearise(robot, pose, PAYLOAD)
    motors, pulleys = textbook.rest_angles(robot, model.tensions, pose)
    rest = np.concatenate(
        [pose, pulleys[: robot.cables * robot.elastic], motors[: robot.cables * robot.jointed]]
    )
    rest = np.concatenate([rest, 0 * rest])
    assert len(model.states) == len(model.units) == len(rest) == len(model.A)
    nudge = 1e-4
    size = len(rest)
    nudges = nudge * np.eye(size + robot.cables)
    both = np.concatenate([nudges, -nudges])
    states = rest + both[:, :size]
    ahead, behind = np.split(rates_of(robot, mass, states, model.action + both[:, size:]), 2)
    slopes = (ahead - behind).T / (2 * nudge)
    expected = np.concatenate([model.A, model.B], axis=1)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert_allclose(slopes / scale, expected / scale, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("robot", "pose", "payload", "message"),
    [
        ("planar", [9.0, 9.0], 0.0, "outside the polygon of the base anchors"),
        ("spatial", [0.0, 0.0, -5.0, 0.0, 0.0, 0.0], 0.0, "no taut cables hold spatial"),
    ],
)
def test_linearising_asks_for_a_pose_at_rest(robot, pose, payload, message):
    with pytest.raises(ValueError, match=message):
        textbook.linearise(robot, pose, payload)
