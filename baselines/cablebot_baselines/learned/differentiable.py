"""Differentiable inverse dynamics in torch, computed with the equations in ``physics.textbook``.

The textbook functions accept object arrays. Here each element of such an array is a tensor over a
batch of instants, so that the physics is not implemented twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from cablebot_baselines.laws.flexible import JointMotion
from cablebot_baselines.laws.law import Array
from cablebot_gym.motions import ORDERS
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import joint_equivalent
from cablebot_gym.robots import Robot

DIFFERENCE_STEP = 2e-4
"""Time step of the central differences for κ̇ and κ̈ along a plan [s]; their error is below 1e-6."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RequiredActuation:
    """What a motion requires at B instants with P payloads, each (B, P, m)."""

    tensions: Tensor
    """Cable tensions T [N]."""
    torques: Tensor
    """Torques of the pulleys, r T + J β̈ + c β̇: of the motors of a rigid robot, of the springs of a
    flexible one [N·m]."""
    action: Tensor
    """Actions without saturation."""


def required_actuation(
    robot: Robot,
    motion: Sequence[Tensor],
    masses: Tensor,
    minimum: Tensor,
    internal: Sequence[Tensor] | None = None,
) -> RequiredActuation:
    """Tensions and actions that a motion with given masses requires.

    With one cable more than coordinates, the tensions are those of least norm plus an internal
    tension, see :func:`internal_direction`.

    Args:
        robot: any robot with at most one cable more than coordinates.
        motion: X and its derivatives up to the second, with joint springs up to the fourth; float64
            tensors (B, n).
        masses: P masses of platform and payload at each instant [kg], (B, P).
        minimum: least tension at each instant with one more cable [N], (B,).
        internal: internal tension and its derivatives up to the second, each (B, P); None for the
            one with the least largest action with which no cable has less than ``minimum``.
    """
    robot = joint_equivalent(robot)
    orders = [derivative[:, None] for derivative in motion]
    now = None if internal is None else internal[0]
    pulleys = _pulley_actuation(robot, orders[:3], masses, minimum, now)
    torque = pulleys.torques
    speed = pulleys.speed
    if robot.flexible:
        named: dict[str, Any] = dict(zip(ORDERS, orders, strict=True))
        series: Any = JointMotion(**named)
        step = DIFFERENCE_STEP
        before, after = (
            _pulley_actuation(
                robot, series.after(time), masses, minimum, _after(internal, time)
            ).torques
            for time in (-step, step)
        )
        stiffness = torch.tensor(robot.stiffness)
        inertia = torch.tensor(robot.motor_inertia)
        torque_rate = (after - before) / (2 * step)
        speed = speed + torque_rate / stiffness
        torque_second = (after - 2 * torque + before) / step**2
        motor_acceleration = pulleys.acceleration + torque_second / stiffness
        friction = textbook.motor_friction(robot, _objects(speed), _objects(torque))
        torque = torque + inertia * motor_acceleration + _tensor(friction)
    action = _tensor(textbook.normalised_action(robot, _objects(torque), _objects(speed)))
    return RequiredActuation(tensions=pulleys.tensions, torques=pulleys.torques, action=action)


def _after(internal: Sequence[Tensor] | None, step: float) -> Tensor | None:
    """The internal tension a little later."""
    if internal is None:
        return None
    value, rate, second = internal
    return value + step * rate + step**2 / 2 * second


class _PulleyActuation(NamedTuple):
    """Tensions and torques as in :class:`RequiredActuation`, and the motion of the pulleys, β̇ and
    β̈, each (B, 1, m)."""

    tensions: Tensor
    torques: Tensor
    speed: Tensor
    acceleration: Tensor


def _pulley_actuation(
    robot: Robot,
    motion: Sequence[Tensor],
    masses: Tensor,
    minimum: Tensor,
    internal: Tensor | None,
) -> _PulleyActuation:
    """Tensions T from ``−Sᵀ T = D Ẍ + h`` (Eq. 16), and torques r T + J β̈ + c β̇."""
    pose, velocity, acceleration = map(_objects, motion)
    structure_and_rate = textbook.jacobian_and_rate(robot, pose, velocity)
    speed, second = textbook.pulley_motion(robot, *structure_and_rate, velocity, acceleration)
    structure = _tensor(structure_and_rate[0])[:, 0]
    mass = _objects(masses[:, :, None])[:, 0]
    load = _tensor(textbook.load(robot, mass, pose, velocity, acceleration))
    if robot.cables == robot.coordinates:
        tensions = torch.linalg.solve(-structure.mT, load.mT).mT
    else:
        inverse, direction = internal_direction(structure)
        tensions = -load @ inverse
        direction = direction[:, None]
        if internal is None:
            missing = (minimum[:, None, None] - tensions) / direction
            internal = torch.where(direction > 0, missing, -torch.inf).amax(-1)
            if (direction < 0).any():
                action = _action(robot, tensions, speed, second)
                slope = _action(robot, tensions + direction, speed, second) - action
                least = _least_largest(action, slope)
                most = torch.where(direction < 0, missing, torch.inf).amin(-1)
                internal = torch.minimum(torch.maximum(least, internal), most)
        tensions = tensions + direction * internal[..., None]
    torques = textbook.motor_torques(robot, _objects(tensions), speed, second)
    return _PulleyActuation(tensions, _tensor(torques), _tensor(speed), _tensor(second))


def internal_direction(structure: Tensor) -> tuple[Tensor, Tensor]:
    """S⁺, (..., n, m), and the change of the tensions (..., m) by an internal tension of 1: the
    projection of equal tensions, with the signs of those without effect, on them.

    Args:
        structure: S of a robot with one cable more than coordinates, (..., m, n).
    """
    inverse = torch.linalg.solve(structure.mT @ structure, structure.mT)
    projection = torch.eye(structure.shape[-2], dtype=structure.dtype) - structure @ inverse
    signs = projection[..., :1].detach().sign()
    return inverse, (projection @ signs)[..., 0]


def _action(robot: Robot, tensions: Tensor, speed: Array, acceleration: Array) -> Tensor:
    """Actions of rigid motors with tensions and a motion of the pulleys, (B, P, m)."""
    torques = textbook.motor_torques(robot, _objects(tensions), speed, acceleration)
    return _tensor(textbook.normalised_action(robot, torques, speed))


def _least_largest(action: Tensor, slope: Tensor) -> Tensor:
    """λ with the least largest component of action + λ slope, (B, P) for (B, P, m); infinite where
    all slopes have the same sign."""
    first, second = torch.triu_indices(action.shape[-1], action.shape[-1], 1)
    is_crossing = slope[..., first] * slope[..., second] < 0
    turn = torch.where(is_crossing, slope[..., first] - slope[..., second], 1.0)
    crossing = (action[..., second] - action[..., first]) / turn
    height = action[..., first] + slope[..., first] * crossing
    highest = torch.where(is_crossing, height, -torch.inf).argmax(-1, keepdim=True)
    unbounded = -slope[..., 0].sign() * torch.inf
    return torch.where(is_crossing.any(-1), crossing.gather(-1, highest)[..., 0], unbounded)


def _objects(values: Tensor) -> Array:
    """Converts batches of vectors (B, P, n) to an object array (P, n) of tensors (B,)."""
    array = np.empty(values.shape[1:], dtype=object)
    for index in np.ndindex(*array.shape):
        array[index] = values[:, *index]
    return array


def _tensor(array: Array) -> Tensor:
    """Converts an object array (P, …) of tensors (B,) or numbers to a tensor (B, P, …)."""
    flat = array.reshape(-1)
    size = next(item for item in flat if isinstance(item, Tensor)).shape
    columns = [torch.as_tensor(item, dtype=torch.float64).expand(size) for item in flat]
    return torch.stack(columns, dim=-1).reshape(*size, *array.shape)
