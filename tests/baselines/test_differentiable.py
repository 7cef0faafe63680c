"""Differentiable inverse dynamics compared with the compiled one, the textbook and difference
quotients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import cablebot_gym  # noqa: F401  # registers the ids
from cablebot_baselines.classical.flexible import Motion
from cablebot_baselines.learned.differentiable import required_actuation
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Robot
from cablebot_gym.trajectories import find_trajectory

pytestmark = pytest.mark.usefixtures("one_thread")

COUNT = 40
MINIMUM = 5.0
SIZES = {"position": 0.05, "velocity": 0.4, "acceleration": 3.0, "jerk": 30.0, "snap": 600.0}


def motion(robot: Robot) -> Motion:
    """A random motion."""
    rng = np.random.default_rng(3)
    values = {
        name: rng.uniform(-size, size, (COUNT, robot.coordinates)) for name, size in SIZES.items()
    }
    values["position"] += robot.home
    return Motion(**values)


def tensors(robot: Robot, values: Motion) -> list[torch.Tensor]:
    return [torch.tensor(value) for value in vars(values).values()][: 5 if robot.flexible else 3]


def masses(robot: Robot) -> np.ndarray:
    return robot.mass + np.linspace(0.0, 5.0, COUNT)


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: robot.name)
def test_actuation_equals_the_compiled_inverse_dynamics(robot: Robot):
    x = motion(robot)
    mass = masses(robot)
    expected = inverse_dynamics(
        robot, mass, x.position, x.velocity, x.acceleration, minimum=MINIMUM
    )
    result = required_actuation(robot, tensors(robot, x), torch.tensor(mass), minimum=MINIMUM)
    np.testing.assert_allclose(result.tensions.numpy(), expected.tensions, rtol=1e-9, atol=1e-9)
    action = textbook.normalised_action(robot, expected.torques, expected.speeds)
    np.testing.assert_allclose(result.action.numpy(), action, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("robot", [FLEX_PLANAR, FLEX_SPATIAL], ids=lambda robot: robot.name)
def test_actions_with_springs_equal_difference_quotients(robot: Robot):
    reference = find_trajectory(
        "loop-planar" if robot.planar else "loop-spatial", robot.coordinates
    )
    times = np.linspace(0.2, reference.duration - 0.2, COUNT)
    step = 1e-3
    mass = robot.mass + 2.0

    def spring_and_angle(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = reference(at)
        spring = inverse_dynamics(
            robot, mass, x.position, x.velocity, x.acceleration, minimum=MINIMUM
        ).torques
        return spring, textbook.pulley_angle(robot, x.position) + spring / robot.stiffness

    spring, angle = spring_and_angle(times)
    two_before = spring_and_angle(times - 2 * step)[1]
    before = spring_and_angle(times - step)[1]
    after = spring_and_angle(times + step)[1]
    two_after = spring_and_angle(times + 2 * step)[1]
    speed = (two_before - 8 * before + 8 * after - two_after) / (12 * step)
    acceleration = (-two_before + 16 * before - 30 * angle + 16 * after - two_after) / (
        12 * step**2
    )
    torques = spring + robot.motor_inertia * acceleration + robot.motor_damping * speed
    x = reference(times)
    derivatives = [
        torch.tensor(v) for v in (x.position, x.velocity, x.acceleration, x.jerk, x.snap)
    ]
    result = required_actuation(
        robot, derivatives, torch.full((COUNT,), mass, dtype=torch.float64), minimum=MINIMUM
    )
    bound = 1e-3 if robot.planar else 1e-6  # a planar robot's tensions have kinks
    error = np.abs(result.action.numpy() - textbook.normalised_action(robot, torques, speed)).max(
        axis=1
    )
    assert np.quantile(error, 0.9) < bound


@pytest.mark.parametrize("robot", [PLANAR, pytest.param(FLEX_SPATIAL, marks=pytest.mark.slow)])
def test_gradients_equal_difference_quotients(robot: Robot):
    derivatives_of_one = [
        value[:1].clone().requires_grad_(True) for value in tensors(robot, motion(robot))
    ]
    mass = torch.tensor(masses(robot)[:1])

    def both(*derivatives: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        result = required_actuation(robot, derivatives, mass, minimum=MINIMUM)
        return result.tensions, result.action

    # With springs the action contains difference quotients in time, whose rounding is larger.
    assert torch.autograd.gradcheck(
        both, derivatives_of_one, eps=1e-6, atol=1e-3 if robot.flexible else 1e-5, rtol=1e-4
    )


@pytest.mark.slow
def test_soft_tensions_equal_the_textbook_and_have_gradients():
    x = motion(FLEX_PLANAR)
    mass = masses(FLEX_PLANAR)
    soft = required_actuation(
        FLEX_PLANAR, tensors(FLEX_PLANAR, x), torch.tensor(mass), minimum=MINIMUM, softness=10.0
    )
    required = inverse_dynamics(
        FLEX_PLANAR, mass, x.position, x.velocity, x.acceleration, minimum=MINIMUM
    )
    structure = textbook.jacobian(FLEX_PLANAR, x.position)
    expected = textbook.smooth_tension_distribution(structure, required.tensions, MINIMUM, 10.0)
    np.testing.assert_allclose(soft.tensions.numpy(), expected, rtol=0, atol=1e-8)
    few = [value[:1].clone().requires_grad_(True) for value in tensors(FLEX_PLANAR, x)]
    keywords = {"mass": torch.tensor(mass[:1]), "minimum": MINIMUM, "softness": 10.0}
    assert torch.autograd.gradcheck(
        lambda *motion: required_actuation(FLEX_PLANAR, motion, **keywords).action,
        few,
        eps=1e-6,
        atol=1e-3,
        rtol=1e-4,
    )
