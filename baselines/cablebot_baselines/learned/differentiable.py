"""Differentiable inverse dynamics in torch, computed with the equations in ``physics.textbook``.

The textbook functions accept object arrays. Here each element of such an array is a tensor over a
batch of instants, so that the physics is not implemented twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cablebot_baselines.laws.flexible import DIFFERENCE_STEP, Motion
from cablebot_baselines.laws.law import Array
from cablebot_gym.motions import ORDERS
from cablebot_gym.physics import textbook
from cablebot_gym.physics.tensions.distribution import BARRIER, RELAXED, unchecked_central
from cablebot_gym.physics.textbook import joint_equivalent
from cablebot_gym.robots import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class RequiredActuation:
    """Tensions and actions that a motion requires, each (B, m)."""

    tensions: Tensor
    """Cable tensions T [N]."""
    action: Tensor
    """Normalised actions; the motors can apply actions within ±1."""


def required_actuation(
    robot: Robot,
    motion: Sequence[Tensor],
    mass: Tensor,
    *,
    minimum: float = 0.0,
) -> RequiredActuation:
    """Tensions and actions that a motion with a given mass requires.

    Args:
        robot: any robot.
        motion: X and its derivatives up to the second, with joint springs up to the fourth; float64
            tensors (B, n).
        mass: mass of platform and payload [kg], (B,).
        minimum: least tension with more cables than coordinates [N].
    """
    robot = joint_equivalent(robot)
    tensions_and_torques = partial(_tensions_and_torques, robot, mass=mass, minimum=minimum)
    tensions, torque = tensions_and_torques(motion[:3])
    pose, velocity, acceleration = map(_objects, motion[:3])
    speed = _tensor(textbook.pulley_speed(robot, pose, velocity))
    if robot.flexible:
        orders: dict[str, Any] = dict(zip(ORDERS, motion, strict=True))
        series: Any = Motion(**orders)
        step = DIFFERENCE_STEP
        pulley_acceleration = textbook.pulley_acceleration(robot, pose, velocity, acceleration)
        _, before = tensions_and_torques(series.after(-step))
        _, after = tensions_and_torques(series.after(step))
        stiffness = torch.tensor(robot.stiffness)
        inertia = torch.tensor(robot.motor_inertia)
        torque_rate = (after - before) / (2 * step)
        speed = speed + torque_rate / stiffness
        torque_second = (after - 2 * torque + before) / step**2
        motor_acceleration = _tensor(pulley_acceleration) + torque_second / stiffness
        friction = textbook.motor_friction(robot, _objects(speed), _objects(torque))
        torque = torque + inertia * motor_acceleration + _tensor(friction)
    action = _tensor(textbook.normalised_action(robot, _objects(torque), _objects(speed)))
    return RequiredActuation(tensions=tensions, action=action)


def _tensions_and_torques(
    robot: Robot, motion: Sequence[Tensor], mass: Tensor, minimum: float
) -> tuple[Tensor, Tensor]:
    """Tensions T from ``−Sᵀ T = D Ẍ + h`` (Eq. 16), and torques r T + J β̈ + c β̇ (of the springs
    if flexible)."""
    pose, velocity, acceleration = map(_objects, motion)
    jacobian = textbook.jacobian(robot, pose)
    masses = _objects(mass[:, None])[:, 0]
    structure = _tensor(jacobian)
    load = _tensor(textbook.load(robot, masses, pose, velocity, acceleration))
    if robot.cables == robot.coordinates:
        tensions = torch.linalg.solve(-structure.mT, load)
    elif robot.kind == "planar":
        tensions = _tension_distribution(structure, load, minimum)
    else:
        slack = np.zeros((1, robot.cables))
        torques = textbook.required_torques(robot, slack, pose, velocity, acceleration)
        speed = textbook.pulley_speed(robot, pose, velocity)
        offset = _tensor(textbook.normalised_action(robot, torques, speed))
        # an object array, also where the radius is a number
        radius = textbook.loaded_radius(robot, speed) + 0 * speed
        slope = _tensor(radius / robot.stall_torque)
        if robot.maximum_tension != math.inf:  # as the central tensions of the textbook
            slope = torch.maximum(slope, (1 - offset) / robot.maximum_tension)
        tensions = _central_tensions(structure, load, slope, offset, minimum)
    torques = textbook.required_torques(robot, _objects(tensions), pose, velocity, acceleration)
    return tensions, _tensor(torques)


def _tension_distribution(structure: Tensor, load: Tensor, minimum: float) -> Tensor:
    """The textbook's tension distribution of a planar robot.

    The textbook selects the two cables with more than the minimum tension; their tensions are
    solved for here.
    """
    with torch.no_grad():
        distribution = textbook.tension_distribution(
            structure.numpy(), load.numpy(), minimum, strict=False
        )
    by_tension = np.argsort(distribution, axis=-1)
    active = torch.tensor(by_tension[..., -2:])
    pair = torch.take_along_dim(structure, active[..., None], dim=1)
    remaining_load = load + minimum * structure.sum(dim=-2)
    excess = torch.linalg.solve(-pair.mT, remaining_load)
    zeros = torch.zeros_like(structure[..., 0])
    return minimum + zeros.scatter(1, active, excess)


def _central_tensions(
    structure: Tensor, load: Tensor, slope: Tensor, offset: Tensor, minimum: float
) -> Tensor:
    """The tensions of :func:`~cablebot_gym.physics.tensions.distribution.unchecked_central`.

    That function gives the values. One step of Newton's method from them changes them by rounding
    only, and has their derivatives.
    """
    least = torch.full_like(offset, minimum)
    arguments = structure, load, least, slope, offset
    arrays = [argument.detach().numpy() for argument in arguments]
    tensions = torch.tensor(unchecked_central(*arrays))
    actions = slope * tensions + offset
    below, below_curvature = _barrier_derivatives(slope * (tensions - minimum))
    above, above_curvature = _barrier_derivatives(1 - actions)
    gradient = slope * (actions + BARRIER * (below - above))
    curvature = slope**2 * (1 + BARRIER * (below_curvature + above_curvature))
    coordinates = load.shape[-1]
    zeros = load.new_zeros(len(load), coordinates, coordinates)
    stationarity = torch.cat([torch.diag_embed(curvature), -structure], dim=2)
    balance = torch.cat([-structure.mT, zeros], dim=2)
    system = torch.cat([stationarity, balance], dim=1)
    missing = load + (structure.mT @ tensions[..., None])[..., 0]
    residual = torch.cat([-gradient, missing], dim=1)
    step = torch.linalg.solve(system, residual)
    return tensions + step[:, : tensions.shape[1]]


def _barrier_derivatives(distance: Tensor) -> tuple[Tensor, Tensor]:
    """First and second derivative of the barrier in :func:`~cablebot_gym.physics.tensions.distribution.unchecked_central`."""
    relaxed = RELAXED * BARRIER
    inverse = 1 / distance.clamp(min=relaxed)
    first = torch.where(distance > relaxed, -inverse, (distance / relaxed - 2) / relaxed)
    return first, inverse**2


def _objects(values: Tensor) -> Array:
    """Converts a batch of vectors (B, n) to an object array (1, n) of tensors (B,)."""
    array = np.empty((1, values.shape[1]), dtype=object)
    for index, value in enumerate(values.unbind(1)):
        array[0, index] = value
    return array


def _tensor(array: Array) -> Tensor:
    """Converts an object array (1, …) of tensors (B,) or numbers to a tensor (B, …)."""
    flat = array.reshape(-1)
    size = next(item for item in flat if isinstance(item, Tensor)).shape
    columns = [torch.as_tensor(item, dtype=torch.float64).expand(size) for item in flat]
    return torch.stack(columns, dim=-1).reshape(*size, *array.shape[1:])
