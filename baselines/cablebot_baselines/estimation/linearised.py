"""Nominal dynamics and statics with their gradients, which the extended Kalman filter needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot

Array = NDArray[Any]

STEP = 1e-6
"""Step of the difference quotients with respect to coordinates [m, rad] and mass [kg]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Accelerated:
    """Acceleration and tensions of N robots, and their gradients."""

    acceleration: Array
    """Ẍ, (N, n)."""
    tensions: Array
    """T, (N, m) [N]."""
    by_pose: tuple[Array, Array]
    """Gradients of Ẍ and T with respect to X, (N, n, n) and (N, m, n)."""
    by_mass: tuple[Array, Array]
    """Gradients of Ẍ and T with respect to the mass, (N, n, 1) and (N, m, 1)."""
    by_torque: tuple[Array, Array]
    """Gradients of Ẍ and T with respect to the torques on the pulleys, (N, n, m) and (N, m, m)."""
    by_wrench: Array
    """Gradient of Ẍ with respect to a wrench on the platform, (N, n, n)."""


def accelerated(
    robot: Robot, mass: Array, pose: Array, velocity: Array, torque: Array
) -> Accelerated:
    """Bilateral dynamics for masses (N,), poses and velocities (N, n) and torques (N, m)."""
    poses, masses = _varied(pose, mass)
    acceleration, tensions = textbook.forward_dynamics(
        robot, masses, poses, np.broadcast_to(velocity, poses.shape), torque, cable="bilateral"
    )
    structure = textbook.jacobian(robot, pose)
    transposed = np.swapaxes(structure, -1, -2)
    rotors = (robot.pulley_inertia / robot.pulley_radius**2)[:, None]
    inertia = textbook.mass_matrix(robot, mass, pose) + transposed @ (rotors * structure)
    by_wrench = np.linalg.inv(inertia)
    by_torque = -by_wrench @ transposed / robot.pulley_radius
    pulled = np.eye(robot.cables) / robot.pulley_radius + rotors * (structure @ by_torque)
    by_pose, by_mass = zip(_quotients(acceleration), _quotients(tensions), strict=True)
    return Accelerated(
        acceleration=acceleration[0],
        tensions=tensions[0],
        by_pose=by_pose,
        by_mass=by_mass,
        by_torque=(by_torque, pulled),
        by_wrench=by_wrench,
    )


def static(robot: Robot, mass: Array, pose: Array) -> tuple[Array, Array, Array]:
    """Torques at rest (N, m), and their gradients with respect to X (N, m, n) and the mass (N, m,
    1)."""
    poses, masses = _varied(pose, mass)
    minimum = textbook.allocated_minimum(robot)
    torques = textbook.static_torque(robot, masses, poses, minimum=minimum)
    return torques[0], *_quotients(torques)


def _varied(pose: Array, mass: Array) -> tuple[Array, Array]:
    """Poses (n + 2, N, n) and masses (n + 2, N): nominal, each coordinate changed, mass changed."""
    n = pose.shape[-1]
    changes = STEP * np.eye(n + 2, n, -1)
    masses = np.broadcast_to(mass, (n + 2, *mass.shape)).copy()
    masses[-1] += STEP
    return pose + changes[:, None, :], masses


def _quotients(values: Array) -> tuple[Array, Array]:
    """Difference quotients of values (n + 2, N, j) with respect to X (N, j, n) and mass (N, j, 1)."""
    quotients = np.moveaxis(values[1:] - values[0], 0, -1) / STEP
    return quotients[..., :-1], quotients[..., -1:]


def anchor_gradients(robot: Robot, pose: Array) -> tuple[Array, Array]:
    """Gradients of the pulley angles at poses (N, n) with respect to the anchors of base and
    platform, each (N, m, m·d).

    The pulley angle is zero at the home pose, so anchor errors have no effect there.
    """
    base, platform = _directions(robot, pose)
    base_at_home, platform_at_home = _directions(robot, robot.home[None])
    return (
        _by_cable(robot, base - base_at_home),
        _by_cable(robot, platform - platform_at_home),
    )


def _directions(robot: Robot, pose: Array) -> tuple[Array, Array]:
    """Gradients of the cable lengths with respect to their own anchors, each (N, m, d)."""
    vectors = kinematics.cable_vectors(robot.base, robot.platform, pose)
    units = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    turned_back = units
    if robot.dimensions == 3 and robot.coordinates == 6:
        turned_back = units @ kinematics.rotation_matrix(pose[:, 3:])
    elif robot.coordinates == 3 and robot.dimensions == 2:
        cosine, sine = np.cos(pose[:, 2:]), np.sin(pose[:, 2:])
        x, y = units[..., 0], units[..., 1]
        turned_back = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)
    return -units, turned_back


def _by_cable(robot: Robot, directions: Array) -> Array:
    """Gradients of the pulley angles (N, m, m·d) from those of the lengths (N, m, d)."""
    count, m, d = directions.shape
    spread = np.eye(m)[:, :, None] * directions[:, :, None, :]
    return -spread.reshape(count, m, m * d) / robot.pulley_radius[:, None]
