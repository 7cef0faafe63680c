"""Inverse dynamics by the compiled kernel: fast enough for control laws, with the same results as
the textbook."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.plant import form_of, pack_parameters
from cablebot_gym.physics.textbook import InverseDynamics
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import all_finite, number


@lru_cache(maxsize=64)
def _prepared(robot: Robot) -> tuple[kernel.Form, Array]:
    """Form and parameters; a law uses the same robot in every control step. The kernel does not
    change them."""
    return form_of(robot), pack_parameters(robot)


def inverse_dynamics(
    robot: Robot,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    *,
    minimum: float = 0.0,
) -> InverseDynamics:
    """Inverse dynamics as in :func:`cablebot_gym.physics.textbook.drives.inverse_dynamics` with
    ``strict=False``.

    The results are equal up to rounding. The relative difference of spatial tensions is about 1e-15
    times the condition number of S, if that is below 1e6. In a singular pose the tensions are
    arbitrary or NaN (the textbook raises).

    Args:
        robot: any robot.
        mass: mass of platform and payload [kg], shape (...).
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
        acceleration: Ẍ, shape (..., n).
        minimum: minimum tension with more cables than coordinates [N]; has no effect otherwise.

    Raises:
        ValueError: if the shapes do not match the robot or each other, or a number is not finite.
    """
    number("minimum", minimum)
    shape = np.broadcast_shapes(np.shape(pose), np.shape(velocity), np.shape(acceleration))
    if shape[-1:] != (robot.coordinates,):
        raise ValueError(
            f"poses of {robot.name} need {robot.coordinates} coordinates; the arrays have shape {shape}"
        )
    motion, masses = np.empty((3, *shape)), np.empty(shape[:-1])
    motion[0], motion[1], motion[2], masses[...] = pose, velocity, acceleration, mass
    all_finite("pose, velocity and acceleration", motion)
    all_finite("mass", masses)
    form, packed = _prepared(robot)
    compiled = kernel.compiled(form, kernel.LANES)
    memory = (
        np.empty(kernel.parameter_rows(form) * kernel.LANES),
        np.empty(kernel.scratch_rows(form) * kernel.LANES),
    )
    items = masses.reshape(-1), motion.reshape(3, -1, robot.coordinates)
    results = np.empty((4, masses.size, robot.cables))
    if robot.cables > robot.coordinates and robot.kind != "planar":
        structure = np.empty((masses.size, robot.cables, robot.coordinates))
        load = np.empty((masses.size, robot.coordinates))
        compiled.demanded(packed, *memory, *items, structure, load, results[2:])
        results[0] = textbook.least_action_tensions(
            robot, structure, load, results[2], results[3], minimum
        )
        results[1] = textbook.motor_torques(robot, results[0], *results[2:])
    else:
        compiled.required(packed, float(minimum), *memory, *items, results)
    tensions, torques, speeds, accelerations = results.reshape(4, *shape[:-1], robot.cables)
    return InverseDynamics(
        tensions=tensions, torques=torques, speeds=speeds, pulley_accelerations=accelerations
    )
