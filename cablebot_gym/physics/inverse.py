"""Inverse dynamics by the compiled kernel: fast enough for control laws, with the same results as
the textbook."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.plant import form_of, pack_parameters
from cablebot_gym.physics.textbook import InverseDynamics
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import all_finite


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
    minimum: ArrayLike = 0.0,
    distribute: Callable[..., Array] = textbook.least_action_tensions,
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
        minimum: minimum tension with more cables than coordinates, shape (...) [N]; has no effect
            otherwise.
        distribute: tensions of redundant cables, other than those of a point mass in a plane:
            :func:`~cablebot_gym.physics.textbook.drives.least_action_tensions`, or
            :func:`~cablebot_gym.physics.textbook.drives.central_tensions` for laws, which need
            tensions that change slowly.

    Raises:
        ValueError: if the shapes do not match the robot or each other, or a number is not finite.
    """
    all_finite("minimum", minimum)
    masses, motion = _checked(robot, mass, pose, velocity, acceleration)
    shape = (*masses.shape, robot.cables)
    results = np.empty((4, *shape))
    minima = np.empty_like(masses)
    minima[...] = minimum
    if robot.cables > robot.coordinates and robot.kind != "planar":
        required = demands(robot, masses, motion)
        results[2] = required.speeds
        results[3] = required.pulley_accelerations
        results[0] = distribute(
            robot, required.structure, required.load, results[2], results[3], minima[..., None]
        )
        results[1] = textbook.motor_torques(robot, results[0], *results[2:])
    else:
        form, packed = _prepared(robot)
        items = masses.reshape(-1), motion.reshape(3, -1, robot.coordinates)
        kernel.compiled(form, rows.LANES).required(
            packed, minima.reshape(-1), *_memory(form), *items, results.reshape(4, -1, robot.cables)
        )
    tensions, torques, speeds, accelerations = results
    return InverseDynamics(
        tensions=tensions, torques=torques, speeds=speeds, pulley_accelerations=accelerations
    )


class Demands(NamedTuple):
    """What a motion demands of cables and pulleys. S and load are those of the accelerations y, see
    :mod:`~cablebot_gym.physics.kernel`: ``−Sᵀ T = load`` has the tensions of the textbook."""

    structure: Array
    """S, (..., m, n)."""
    load: Array
    """Load, (..., n)."""
    y: Array
    """y, affine in Ẍ, (..., n)."""
    speeds: Array
    """Pulley speeds β̇, (..., m) [rad/s]."""
    pulley_accelerations: Array
    """β̈, (..., m) [rad/s²]."""


def demands(robot: Robot, mass: Array, motion: Array) -> Demands:
    """What motions demand of a robot, without checks of the arguments.

    Args:
        robot: any robot.
        mass: mass of platform and payload [kg], shape (...).
        motion: X, Ẋ and Ẍ, shape (3, ..., n).
    """
    form, packed = _prepared(robot)
    m = robot.cables
    n = robot.coordinates
    structure = np.empty((*mass.shape, m, n))
    load, y = np.empty((2, *mass.shape, n))
    speeds, accelerations = pulleys = np.empty((2, *mass.shape, m))
    kernel.compiled(form, rows.LANES).demanded(
        packed,
        *_memory(form),
        mass.reshape(-1),
        motion.reshape(3, -1, n),
        structure.reshape(-1, m, n),
        load.reshape(-1, n),
        y.reshape(-1, n),
        pulleys.reshape(2, -1, m),
    )
    return Demands(structure, load, y, speeds, accelerations)


def _checked(
    robot: Robot, mass: ArrayLike, pose: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> tuple[Array, Array]:
    """Masses (...) and motion (3, ..., n) as arrays that the kernel can read."""
    shapes = np.shape(pose), np.shape(velocity), np.shape(acceleration)
    shape = np.broadcast_shapes(*shapes, (*np.shape(mass), 1))
    if shape[-1:] != (robot.coordinates,):
        raise ValueError(
            f"poses of {robot.name} need {robot.coordinates} coordinates; the arrays have shape {shape}"
        )
    motion = np.empty((3, *shape))
    masses = np.empty(shape[:-1])
    motion[0] = pose
    motion[1] = velocity
    motion[2] = acceleration
    masses[...] = mass
    all_finite("pose, velocity and acceleration", motion)
    all_finite("mass", masses)
    return masses, motion


def _memory(form: kernel.Form) -> tuple[Array, Array]:
    """Memory of the kernel for the parameters of a tile and for its scratch values."""
    return (
        np.empty(rows.parameter_rows(form) * rows.LANES),
        np.empty(rows.scratch_rows(form) * rows.LANES),
    )
