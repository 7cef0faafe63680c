"""Linear models of small motions against the plant."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.plants import (
    FLEX_HANGING,
    ROUGH,
    each_of,
    nightly,
    no_reference,
    with_transmission,
)
from oracles.platforms import CAMERA, CRANE, SWIVELLED, TURNING

from cablebot_gym.physics import textbook
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import PLANAR

PAYLOAD = 2.5

SOFT = {"axial_stiffness": 2e4, "extra_length": 0.3}
ELASTIC = tuple(with_transmission(robot, **SOFT) for robot in (CAMERA, CRANE, SWIVELLED, TURNING))
JOINTED = tuple(
    with_transmission(robot, stiffness=900.0, motor_inertia=1e-3) for robot in (SWIVELLED, TURNING)
)
BOTH = with_transmission(TURNING, stiffness=900.0, motor_inertia=1e-3, **SOFT)


def plant_rates(robot, mass, states, actions):
    """Rates of states (N, k) from steps of the plant of 1 µs and of half of it, without the error
    of first order."""
    every = np.arange(len(states))
    n, m = robot.coordinates, robot.cables
    angles = n + m * (robot.elastic + robot.jointed)
    rates = []
    for step in (1e-6, 5e-7):
        plant = Plant(robot.replace(mass=mass), len(states), cable="bilateral")
        plant.set_state(every, states[:, :n], states[:, angles : angles + n])
        if robot.flexible:
            plant.set_motors(
                every, states[:, angles - m : angles], states[:, 2 * angles - m : 2 * angles]
            )
        if robot.elastic and robot.jointed:
            plant.set_pulleys(every, states[:, n : n + m], states[:, angles + n : angles + n + m])
        plant.set_action(actions)
        plant.advance(*no_reference(robot), substeps=1, step=step)
        names = [("pose", "velocity")]
        if robot.elastic:
            names.append(("pulley_angle", "pulley_speed"))
        if robot.jointed:
            names.append(("motor_angle", "motor_speed"))
        values = [getattr(plant, name) for pair in zip(*names, strict=True) for name in pair]
        rates.append((np.concatenate(values, axis=1) - states) / step)
    return 2 * rates[1] - rates[0]


@pytest.mark.landing
@each_of(
    PLANAR, *ROUGH, ELASTIC[1], BOTH, *nightly(FLEX_HANGING, ELASTIC[0], *ELASTIC[2:], *JOINTED)
)
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
    ahead, behind = np.split(plant_rates(robot, mass, states, model.action + both[:, size:]), 2)
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
