"""Differentiable inverse dynamics compared with the compiled one, the textbook and difference
quotients."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from oracles.plants import each_of
from oracles.platforms import CRANE, TURNING

import cablebot_gym  # noqa: F401  # registers the ids
from cablebot_baselines.laws.flexible import Motion
from cablebot_baselines.learned.differentiable import required_actuation
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL

pytestmark = pytest.mark.usefixtures("one_thread")

COUNT = 40
RIGID = (PLANAR, SPATIAL, TURNING, CRANE)
MINIMUM = 5.0
SIZES = {"position": 0.05, "velocity": 0.4, "acceleration": 3.0, "jerk": 30.0, "snap": 600.0}


def motion(robot):
    """A random motion and masses."""
    rng = np.random.default_rng(3)
    shape = (COUNT, robot.coordinates)
    values = Motion(**{name: rng.uniform(-size, size, shape) for name, size in SIZES.items()})
    return replace(values, position=values.position + robot.home), robot.mass + np.linspace(
        0.0, 5.0, COUNT
    )


def tensors(robot, values):
    return [torch.tensor(value) for value in vars(values).values()][: 5 if robot.flexible else 3]


@each_of(*RIGID)
def test_actuation_equals_the_compiled_inverse_dynamics(robot):
    x, mass = motion(robot)
    derivatives = (x.position, x.velocity, x.acceleration)
    expected = inverse_dynamics(
        robot, mass, *derivatives, minimum=MINIMUM, distribute=textbook.central_tensions
    )
    result = required_actuation(robot, tensors(robot, x), torch.tensor(mass), minimum=MINIMUM)
    assert_allclose(result.tensions.numpy(), expected.tensions, rtol=1e-6, atol=1e-9)
    action = textbook.normalised_action(robot, expected.torques, expected.speeds)
    assert_allclose(result.action.numpy(), action, rtol=1e-6, atol=1e-9)


@each_of(FLEX_PLANAR, FLEX_SPATIAL)
def test_actions_with_springs_equal_difference_quotients(robot):
    name = "loop-planar" if robot.planar else "loop-spatial"
    reference = find_trajectory(name, robot.coordinates)
    times = np.linspace(0.2, reference.duration - 0.2, COUNT)
    step = 1e-3
    mass = robot.mass + 2.0
    springs = []
    angles = []
    for offset in range(-2, 3):
        x = reference(times + offset * step)
        derivatives = (x.position, x.velocity, x.acceleration)
        spring = inverse_dynamics(robot, mass, *derivatives, minimum=MINIMUM).torques
        springs.append(spring)
        angles.append(textbook.pulley_angle(robot, x.position) + spring / robot.stiffness)
    # Central differences of fourth order.
    speed = np.tensordot([1, -8, 0, 8, -1], angles, axes=1) / (12 * step)
    acceleration = np.tensordot([-1, 16, -30, 16, -1], angles, axes=1) / (12 * step**2)
    torques = springs[2] + robot.motor_inertia * acceleration + robot.motor_damping * speed
    masses = torch.full((COUNT,), mass, dtype=torch.float64)
    result = required_actuation(robot, tensors(robot, reference(times)), masses, minimum=MINIMUM)
    bound = 1e-3 if robot.planar else 1e-6  # a planar robot's tensions have kinks
    error = np.abs(result.action.numpy() - textbook.normalised_action(robot, torques, speed))
    assert np.quantile(error.max(axis=1), 0.9) < bound


@pytest.mark.parametrize(
    "robot",
    [
        PLANAR,
        TURNING,
        pytest.param(CRANE, marks=pytest.mark.landing),
        pytest.param(FLEX_SPATIAL, marks=pytest.mark.nightly),
    ],
    ids=lambda robot: robot.name,
)
def test_gradients_equal_difference_quotients(robot):
    x, mass = motion(robot)
    keywords = {"mass": torch.tensor(mass[:1]), "minimum": MINIMUM}

    def actuation(*derivatives):
        result = required_actuation(robot, derivatives, **keywords)
        return result.tensions, result.action

    single = [value[:1].clone().requires_grad_(True) for value in tensors(robot, x)]
    # With springs the action contains difference quotients in time, whose rounding is larger.
    tolerance = 1e-3 if robot.flexible else 1e-5
    assert torch.autograd.gradcheck(actuation, single, eps=1e-6, atol=tolerance, rtol=1e-4)
