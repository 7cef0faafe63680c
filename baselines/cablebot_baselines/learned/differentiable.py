"""What a motion asks of the motors, as torch tensors with gradients: the textbook's own equations.

The textbook calculates with arrays of any objects that calculate. Here each coordinate is a tensor over a batch of
instants, so that there is no second copy of the physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, cast

import numpy as np

try:
    import torch
    from torch import Tensor
except ImportError as error:
    raise ImportError("gradients need torch: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_baselines.classical.flexible import DIFFERENCE_STEP, Motion
from cablebot_baselines.classical.law import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """What a motion asks of cables and motors, each (B, m)."""

    tensions: Tensor
    """T [N]."""
    demand: Tensor
    """Drive commands; the motors can do what is within ±1."""


def asked(
    robot: Robot, motion: Sequence[Tensor], mass: Tensor, *, minimum: float = 0.0, softness: float = 0.0
) -> Asked:
    """What a motion asks with a mass.

    Args:
        robot: any.
        motion: X and its derivatives, each a float64 tensor (B, n): to the second, with joint springs to the fourth.
        mass: of platform and payload [kg], (B,).
        minimum: least tension of a planar robot [N].
        softness: of these tensions [N], see :func:`~cablebot_gym.physics.textbook.soft_tensions`; 0 for the least.
    """
    pulled = partial(_pulled, robot, mass=mass, minimum=minimum, softness=softness)
    tensions, torque = pulled(motion[:3])
    pose, velocity, acceleration = (_objects(value) for value in motion[:3])
    speed = _tensor(textbook.pulley_speed(robot, pose, velocity))
    if robot.flexible:
        names = [item.name for item in fields(Motion)]
        series, step = Motion(**cast(Any, dict(zip(names, motion, strict=True)))), DIFFERENCE_STEP
        winding = _tensor(textbook.pulley_acceleration(robot, pose, velocity, acceleration))
        before, after = (pulled(cast(Any, series.after(time)))[1] for time in (-step, step))
        stiffness, inertia, damping = (
            torch.tensor(value) for value in (robot.stiffness, robot.motor_inertia, robot.motor_damping)
        )
        speed = speed + (after - before) / (2 * step) / stiffness
        winding = winding + (after - 2 * torque + before) / step**2 / stiffness
        torque = torque + inertia * winding + damping * speed
    demand = _tensor(textbook.drive_command(robot, _objects(torque), _objects(speed)))
    return Asked(tensions=tensions, demand=demand)


def _pulled(
    robot: Robot, motion: Sequence[Tensor], mass: Tensor, minimum: float, softness: float
) -> tuple[Tensor, Tensor]:
    """T, by ``−Sᵀ T = D Ẍ + h`` (Eq. 16), and r T + J β̈ + c β̇: torques, or κ of joint springs."""
    pose, velocity, acceleration = (_objects(value) for value in motion)
    lines = textbook.jacobian(robot, pose)
    structure = _tensor(lines)
    load = _tensor(textbook.load(robot, _objects(mass[:, None])[:, 0], pose, velocity, acceleration))
    tensions = _least(structure, load, minimum) if robot.planar else torch.linalg.solve(-structure.mT, load)
    if softness:
        tensions = _tensor(textbook.soft_tensions(lines, _objects(tensions), minimum, softness))
    return tensions, _tensor(textbook.required_torques(robot, _objects(tensions), pose, velocity, acceleration))


def _least(structure: Tensor, load: Tensor, minimum: float) -> Tensor:
    """The least tensions: the textbook says which two cables pull more than the minimum, and these are solved for."""
    with torch.no_grad():
        least = textbook.least_tensions(structure.numpy(), load.numpy(), minimum, strict=False)
    pulling = torch.tensor(np.argsort(least, axis=-1)[..., -2:])
    pair = torch.gather(structure, 1, pulling[..., None].expand(-1, -1, structure.shape[-1]))
    more = torch.linalg.solve(-pair.mT, load + minimum * structure.sum(dim=-2))
    return minimum + torch.zeros_like(structure[..., 0]).scatter(1, pulling, more)


def _objects(values: Tensor) -> Array:
    """A batch of vectors (B, n) as one vector (1, n) of objects, each a tensor (B,)."""
    array = np.empty((1, values.shape[1]), dtype=object)
    for place, value in enumerate(values.unbind(1)):
        array[0, place] = value
    return array


def _tensor(array: Array) -> Tensor:
    """Objects (1, …), each a tensor (B,) or a number, as a tensor (B, …)."""
    flat = array.reshape(-1)
    size = next(item for item in flat if isinstance(item, Tensor)).shape
    columns = [torch.as_tensor(item, dtype=torch.float64).expand(size) for item in flat]
    return torch.stack(columns, dim=-1).reshape(*size, *array.shape[1:])
