"""Differentiable inverse dynamics in torch, computed with the equations in ``physics.textbook``.

The textbook functions accept object arrays. Here each element of such an array is a tensor over a
batch of instants, so that the physics is not implemented twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from cablebot_baselines.classical.flexible import DIFFERENCE_STEP, Motion
from cablebot_baselines.classical.law import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.distribution import SMOOTHING, least_largest_action
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
    softness: float = 0.0,
) -> RequiredActuation:
    """Tensions and actions that a motion with a given mass requires.

    Args:
        robot: any robot.
        motion: X and its derivatives up to the second, with joint springs up to the fourth; float64
            tensors (B, n).
        mass: mass of platform and payload [kg], (B,).
        minimum: least tension with more cables than coordinates [N].
        softness: smoothing of a planar robot's tensions [N], see
            :func:`~cablebot_gym.physics.textbook.platform.smooth_tension_distribution`; 0 for none.
    """
    robot = joint_equivalent(robot)
    tensions_and_torques = partial(
        _tensions_and_torques, robot, mass=mass, minimum=minimum, softness=softness
    )
    tensions, torque = tensions_and_torques(motion[:3])
    pose, velocity, acceleration = map(_objects, motion[:3])
    speed = _tensor(textbook.pulley_speed(robot, pose, velocity))
    if robot.flexible:
        names = [item.name for item in fields(Motion)]
        series = Motion(**cast(Any, dict(zip(names, motion, strict=True))))
        step = DIFFERENCE_STEP
        pulley_acceleration = _tensor(
            textbook.pulley_acceleration(robot, pose, velocity, acceleration)
        )
        _, before = tensions_and_torques(cast(Any, series.after(-step)))
        _, after = tensions_and_torques(cast(Any, series.after(step)))
        stiffness = torch.tensor(robot.stiffness)
        inertia = torch.tensor(robot.motor_inertia)
        speed = speed + (after - before) / (2 * step) / stiffness
        motor_acceleration = (
            pulley_acceleration + (after - 2 * torque + before) / step**2 / stiffness
        )
        torque = (
            torque
            + inertia * motor_acceleration
            + _tensor(textbook.motor_friction(robot, _objects(speed)))
        )
    action = _tensor(textbook.normalised_action(robot, _objects(torque), _objects(speed)))
    return RequiredActuation(tensions=tensions, action=action)


def _tensions_and_torques(
    robot: Robot, motion: Sequence[Tensor], mass: Tensor, minimum: float, softness: float
) -> tuple[Tensor, Tensor]:
    """Tensions T from ``−Sᵀ T = D Ẍ + h`` (Eq. 16), and torques r T + J β̈ + c β̇ (of the springs
    if flexible)."""
    pose, velocity, acceleration = map(_objects, motion)
    lines = textbook.jacobian(robot, pose)
    structure = _tensor(lines)
    load = _tensor(
        textbook.load(robot, _objects(mass[:, None])[:, 0], pose, velocity, acceleration)
    )
    if robot.cables == robot.coordinates:
        tensions = torch.linalg.solve(-structure.mT, load)
    elif robot.kind == "planar":
        tensions = _tension_distribution(structure, load, minimum)
    else:
        slack = np.zeros((1, robot.cables))
        idle = textbook.required_torques(robot, slack, pose, velocity, acceleration)
        offset = textbook.normalised_action(
            robot, idle, textbook.pulley_speed(robot, pose, velocity)
        )
        tensions = _least_action_tensions(robot, structure, load, _tensor(offset), minimum)
    if softness:
        tensions = _tensor(
            textbook.smooth_tension_distribution(lines, _objects(tensions), minimum, softness)
        )
    return tensions, _tensor(
        textbook.required_torques(robot, _objects(tensions), pose, velocity, acceleration)
    )


def _tension_distribution(structure: Tensor, load: Tensor, minimum: float) -> Tensor:
    """The textbook's tension distribution of a planar robot.

    The textbook selects the two cables with more than the minimum tension; their tensions are
    solved for here.
    """
    with torch.no_grad():
        distribution = textbook.tension_distribution(
            structure.numpy(), load.numpy(), minimum, strict=False
        )
    active = torch.tensor(np.argsort(distribution, axis=-1)[..., -2:])
    pair = torch.gather(structure, 1, active[..., None].expand(-1, -1, structure.shape[-1]))
    excess = torch.linalg.solve(-pair.mT, load + minimum * structure.sum(dim=-2))
    return minimum + torch.zeros_like(structure[..., 0]).scatter(1, active, excess)


def _least_action_tensions(
    robot: Robot, structure: Tensor, load: Tensor, offset: Tensor, minimum: float
) -> Tensor:
    """The tensions of :func:`~cablebot_gym.physics.distribution.least_largest_action`.

    That function gives the active constraints. The tensions solve the optimality conditions of t² +
    ε Σ a_i² with these as equations, for x = (T, t) and the multipliers of S, of the minimum
    tensions and of the largest actions.
    """
    slope = torch.tensor(robot.pulley_radius / robot.stall_torque)
    count, m, n = structure.shape
    with torch.no_grad():
        arrays = structure.numpy(), load.numpy(), minimum, slope.numpy(), offset.numpy()
        tensions = torch.tensor(least_largest_action(*arrays).tensions)
        actions = slope * tensions + offset
        largest = actions.abs().amax(dim=1, keepdim=True)
        tolerance = 1e-7 * (1 + tensions.amax(dim=1, keepdim=True))
        at_minimum = (tensions - minimum <= tolerance).double()
        at_largest = torch.where(actions.abs() >= (1 - 1e-7) * largest, actions.sign(), 0.0)
    # Unknowns are T and t in units of the mean slope, so that all are tensions.
    unit = float(slope.mean())
    identity = torch.eye(m, dtype=torch.float64)
    hessian = torch.diag(
        torch.cat([2 * SMOOTHING * (slope / unit) ** 2, torch.full((1,), 2.0, dtype=torch.float64)])
    )
    column = torch.zeros((count, m, 1), dtype=torch.float64)
    rows = torch.cat(
        [
            torch.cat([-structure.mT, column[:, :n]], dim=2),
            torch.cat([at_minimum[:, :, None] * identity, column], dim=2),
            torch.cat(
                [at_largest[:, :, None] * (slope / unit * identity), -at_largest.abs()[:, :, None]],
                dim=2,
            ),
        ],
        dim=1,
    )
    # The multiplier of an inactive constraint is zero; the small number keeps dependent constraints
    # solvable.
    active = torch.cat([torch.ones_like(load), at_minimum, at_largest.abs()], dim=1)
    idle = torch.diag_embed(active - 1 - 1e-12)
    system = torch.cat(
        [
            torch.cat([hessian.expand(count, -1, -1), rows.mT], dim=2),
            torch.cat([rows, idle], dim=2),
        ],
        dim=1,
    )
    gradient = torch.cat([2 * SMOOTHING * slope * offset / unit**2, column[:, 0]], dim=1)
    right = torch.cat([-gradient, load, at_minimum * minimum, -at_largest * offset / unit], dim=1)
    return torch.linalg.solve(system, right)[:, :m]


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
