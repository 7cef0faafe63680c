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
        rest = textbook.static_motor_angle(
            robot, mass, pose, minimum=textbook.allocated_minimum(robot)
        )
    else:
        rest = textbook.pulley_angle(robot, pose)
    offset: Array = np.asarray(angles, float) - rest
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
    start = np.asarray(guess, float)
    (count, m), n = angles.shape, robot.coordinates
    total_mass = robot.mass if mass is None else mass
    zero = np.zeros_like(start)

    def residuals(unknown: Array) -> Array:
        offset, pose = unknown[:m], unknown[m:].reshape(count, n)
        angle_error = (angles - offset - textbook.pulley_angle(robot, pose)) / noise.motor_angle
        residuals = [angle_error.ravel()]
        if tensions is not None:
            structure = textbook.jacobian(robot, pose)
            cable_force = (np.swapaxes(structure, -1, -2) @ np.asarray(tensions, float)[..., None])[
                ..., 0
            ]
            unbalanced = cable_force + textbook.load(robot, total_mass, pose, zero, zero)
            # The error of a moment grows with the lever, so each row of Sᵀ has its own size.
            size = noise.tension * np.linalg.norm(structure, axis=-2)
            residuals.append((unbalanced / size).ravel())
        if orientation is not None:
            orientation_error = np.asarray(orientation, float) - pose[:, -3:]
            residuals.append(
                (orientation_error / np.array([noise.tilt, noise.tilt, noise.yaw])).ravel()
            )
        return np.concatenate(residuals)

    initial = np.concatenate([np.zeros(m), start.ravel()])
    solution = least_squares(residuals, initial, x_scale="jac", xtol=1e-15, ftol=1e-14)
    jacobian = np.asarray(solution.jac, float)
    # A direction that no reading determines has a vanishing singular value.
    scaled = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    singular_values = np.linalg.svd(scaled, compute_uv=False)
    if len(jacobian) < len(initial) or singular_values[-1] < 1e-7 * singular_values[0]:
        raise ValueError(
            f"the readings do not determine the offsets of robot {robot.name!r}: add poses, and tensions or "
            "orientation if it has as many cables as coordinates, or use home_offset at a known pose"
        )
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    return Calibration(
        offset=solution.x[:m],
        deviation=np.sqrt(np.diag(covariance)[:m]),
        poses=solution.x[m:].reshape(count, n),
    )
