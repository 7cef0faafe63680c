"""Inverse dynamics by the compiled kernel, for laws that run at every control step: textbook's numbers, much sooner."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.physics import kernel
from cablebot_gym.physics.plant import pack_parameters
from cablebot_gym.physics.textbook import InverseDynamics
from cablebot_gym.robots import Robot

_packed = lru_cache(maxsize=64)(pack_parameters)
"""A law asks for the same robot at every control step. The kernel only reads these."""


def inverse_dynamics(
    robot: Robot,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    *,
    minimum: float = 0.0,
) -> InverseDynamics:
    """What :func:`cablebot_gym.physics.textbook.inverse_dynamics` gives with ``strict=False``, up to rounding.

    Spatial tensions differ by 1e-15 of the condition of S, as far as that is below 1e6. In a singular pose they are
    arbitrary or no numbers, where the textbook raises an error.

    Args:
        robot: any robot.
        mass: platform plus payload [kg], shape (...).
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
        acceleration: Ẍ, shape (..., n).
        minimum: least tension of a planar robot [N]; has no effect on a spatial one.

    Raises:
        ValueError: if the shapes do not fit the robot or each other.
    """
    shape = np.broadcast_shapes(np.shape(pose), np.shape(velocity), np.shape(acceleration))
    if shape[-1:] != (robot.coordinates,):
        raise ValueError(f"poses of {robot.name} have {robot.coordinates} coordinates, not the last axis of {shape}")
    motion, masses = np.empty((3, *shape)), np.empty(shape[:-1])
    motion[0], motion[1], motion[2], masses[...] = pose, velocity, acceleration, mass
    results = np.empty((4, *shape[:-1], robot.cables))
    compute = kernel.required_planar if robot.planar else kernel.required_spatial
    compute(
        (0,) * robot.cables,  # as the plant tells the kernel the number of cables
        _packed(robot),
        float(minimum),
        np.empty(kernel.parameter_rows(robot.cables) * kernel.LANES),
        np.empty(kernel.scratch_rows(robot.cables) * kernel.LANES),
        masses.reshape(-1),
        motion.reshape(3, -1, robot.coordinates),
        results.reshape(4, -1, robot.cables),
    )
    tensions, torques, speeds, windings = results
    return InverseDynamics(tensions=tensions, torques=torques, speeds=speeds, windings=windings)
