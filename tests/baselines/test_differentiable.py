"""Differentiable inverse dynamics compared with the compiled one, the textbook and difference
quotients."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from oracles.plants import each_of
from oracles.platforms import CAMERA

import cablebot_gym  # noqa: F401  # registers the ids
from cablebot_baselines.laws.flexible import JointMotion
from cablebot_baselines.learned.differentiable import required_actuation
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, find_robot

pytestmark = pytest.mark.usefixtures("one_thread")

PLATFORM = find_robot("ttk4900")
COUNT = 40
MINIMUM = 5.0
SIZES = {"position": 0.05, "velocity": 0.4, "acceleration": 3.0, "jerk": 30.0, "snap": 600.0}


def motion(robot):
    """A random motion and masses."""
    rng = np.random.default_rng(3)
    shape = (COUNT, robot.coordinates)
    values = JointMotion(**{name: rng.uniform(-size, size, shape) for name, size in SIZES.items()})
    return replace(values, position=values.position + robot.home), robot.mass + np.linspace(
        0.0, 5.0, COUNT
    )


def tensors(robot, values):
    return [torch.tensor(value) for value in vars(values).values()][: 5 if robot.flexible else 3]


def actuation(robot, derivatives, mass, **internal):
    """Tensions, torques and actions with one payload, each (B, m)."""
    least = torch.full((len(mass),), MINIMUM, dtype=torch.float64)
    result = required_actuation(robot, derivatives, torch.tensor(mass)[:, None], least, **internal)
    return [values[:, 0] for values in vars(result).values()]


@each_of(PLANAR, SPATIAL, CAMERA, PLATFORM)
def test_actuation_equals_the_compiled_inverse_dynamics(robot):
    x, mass = motion(robot)
    derivatives = (x.position, x.velocity, x.acceleration)
    expected = inverse_dynamics(robot, mass, *derivatives, minimum=MINIMUM)
    tensions, _, action = actuation(robot, tensors(robot, x), mass)
    assert_allclose(tensions.numpy(), expected.tensions, rtol=1e-6, atol=1e-9)
    expected = textbook.normalised_action(robot, expected.torques, expected.speeds)
    assert_allclose(action.numpy(), expected, rtol=1e-6, atol=1e-9)


def test_wrench_is_the_same_with_any_internal_tension():
    x, mass = motion(CAMERA)
    derivatives = tensors(CAMERA, x)
    structure = textbook.jacobian(CAMERA, x.position)
    load = textbook.load(CAMERA, mass, x.position, x.velocity, x.acceleration)
    given = [torch.full((COUNT, 1), size, dtype=torch.float64) for size in (100.0, 0.0, 0.0)]
    tensions, _, _ = actuation(CAMERA, derivatives, mass, internal=given)
    wrench = -np.einsum("tmn,tm->tn", structure, tensions.numpy())
    assert_allclose(wrench, load, atol=1e-8)


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
    _, _, action = actuation(robot, tensors(robot, reference(times)), np.full(COUNT, mass))
    bound = 1e-3 if robot.planar else 1e-6  # a planar robot's tensions have kinks
    error = np.abs(action.numpy() - textbook.normalised_action(robot, torques, speed))
    assert np.quantile(error.max(axis=1), 0.9) < bound


@pytest.mark.parametrize(
    "robot",
    [PLANAR, CAMERA, pytest.param(FLEX_SPATIAL, marks=pytest.mark.nightly)],
    ids=lambda robot: robot.name,
)
def test_gradients_equal_difference_quotients(robot):
    x, mass = motion(robot)
    single = [value[:1].clone().requires_grad_(True) for value in tensors(robot, x)]
    # With springs the action contains difference quotients in time, whose rounding is larger.
    tolerance = 1e-3 if robot.flexible else 1e-5

    def outputs(*derivatives):
        return tuple(actuation(robot, derivatives, mass[:1]))

    assert torch.autograd.gradcheck(outputs, single, eps=1e-6, atol=tolerance, rtol=1e-4)
