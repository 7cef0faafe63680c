"""Calibration of the zero of every motor angle.

At one known pose the offsets are the differences of the angles: homing. At unknown poses, angles
alone determine them only if there are more cables than coordinates. With as many cables as
coordinates every offset belongs to some pose, so further readings are needed: tensions at rest,
which depend on the pose by the equilibrium, or the orientation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import SensorNoise

Array = NDArray[Any]

CALIBRATION_NOISE = SensorNoise(motor_angle=1e-4, tension=0.4, tilt=3.5e-3, yaw=17.5e-3)
"""Default errors of the readings, which weight them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Offsets of the motor angles."""

    offset: Array
    """Offset of each motor angle: reading minus true angle, (m,) [rad]."""
    deviation: Array
    """Standard deviation of each offset, by the noise of the readings, (m,) [rad]."""
    poses: Array
    """Poses of the readings, (K, n)."""


def home_offset(
    robot: Robot, angles: ArrayLike, pose: ArrayLike, *, mass: float | None = None
) -> Array:
    """Offset of the motor angles at rest at a known pose, (..., m) [rad].

    Args:
        robot: nominal robot.
        angles: readings at rest, (..., m) [rad].
        pose: the known pose, (..., n).
        mass: mass of platform and payload, which winds the springs of a flexible robot [kg]; None
            without payload.
    """
    if mass is None:
        mass = robot.mass
    if robot.flexible:
        minimum = textbook.allocated_minimum(robot)
        true_angles = textbook.static_motor_angle(robot, mass, pose, minimum=minimum)
    else:
        true_angles = textbook.pulley_angle(robot, pose)
    offset: Array = np.asarray(angles, float) - true_angles
    return offset


def calibrate(
    robot: Robot,
    angles: ArrayLike,
    guess: ArrayLike,
    *,
    tensions: ArrayLike | None = None,
    orientation: ArrayLike | None = None,
    mass: float | None = None,
    noise: SensorNoise = CALIBRATION_NOISE,
) -> Calibration:
    """Offsets of the motor angles from readings at rest at K unknown poses, by least squares.

    Args:
        robot: nominal robot with rigid transmission.
        angles: motor angles, (K, m) [rad].
        guess: poses near the true ones, such as the commanded ones, (K, n).
        tensions: tensions, (K, m) [N]; None without load cells.
        orientation: angles ψ, θ, φ of an IMU, (K, 3) [rad]; None without IMU.
        mass: mass of platform and payload [kg]; None without payload.
        noise: standard deviations of the readings. Those of ``tensions`` and ``orientation``
            include their bias.

    Raises:
        ValueError: if the readings do not determine the offsets.
    """
    from scipy.optimize import least_squares  # slow to import

    angles = np.asarray(angles, float)
    poses = np.asarray(guess, float)
    m = robot.cables
    if mass is None:
        mass = robot.mass

    def residuals(unknown: Array) -> Array:
        offset, pose = unknown[:m], unknown[m:].reshape(poses.shape)
        angle_errors = angles - offset - textbook.pulley_angle(robot, pose)
        residuals = [angle_errors / noise.motor_angle]
        if tensions is not None:
            residuals.append(_force_residual(robot, mass, pose, np.asarray(tensions, float), noise))
        if orientation is not None:
            orientation_error = np.asarray(orientation, float) - pose[:, -3:]
            residuals.append(orientation_error / np.array([noise.tilt, noise.tilt, noise.yaw]))
        return np.concatenate(residuals, axis=None)

    initial = np.concatenate([np.zeros(m), poses.ravel()])
    solution = least_squares(residuals, initial, x_scale="jac", xtol=1e-15, ftol=1e-14)
    jacobian = np.asarray(solution.jac, float)
    if not _has_full_rank(jacobian):
        raise ValueError(
            f"the readings do not determine the offsets of robot {robot.name!r}: add poses, and tensions or "
            "orientation if it has as many cables as coordinates, or use home_offset at a known pose"
        )
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    return Calibration(
        offset=solution.x[:m],
        deviation=np.sqrt(np.diag(covariance)[:m]),
        poses=solution.x[m:].reshape(poses.shape),
    )


def _force_residual(
    robot: Robot, mass: float, pose: Array, tensions: Array, noise: SensorNoise
) -> Array:
    """Unbalanced wrench at rest in units of its standard deviation, (K, n)."""
    structure = textbook.jacobian(robot, pose)
    zero = np.zeros_like(pose)
    cable_force = (np.swapaxes(structure, -1, -2) @ tensions[..., None])[..., 0]
    unbalanced = cable_force + textbook.load(robot, mass, pose, zero, zero)
    # The error of a moment grows with the lever, so each row of Sᵀ has its own size.
    residual: Array = unbalanced / (noise.tension * np.linalg.norm(structure, axis=-2))
    return residual


def _has_full_rank(jacobian: Array) -> bool:
    """Whether the readings determine all unknowns. A direction that no reading determines has a
    vanishing singular value."""
    scaled = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    singular_values = np.linalg.svd(scaled, compute_uv=False)
    rows, columns = jacobian.shape
    return bool(rows >= columns and singular_values[-1] >= 1e-7 * singular_values[0])
