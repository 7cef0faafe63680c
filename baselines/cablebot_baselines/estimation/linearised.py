"""Nominal dynamics and statics with their gradients, which the extended Kalman filter needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablebot_gym.kinematics import Array, cable_vectors, rotation_matrix
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot

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
    velocities = np.broadcast_to(velocity, poses.shape)
    acceleration, tensions = textbook.forward_dynamics(
        robot, masses, poses, velocities, torque, cable="bilateral"
    )
    acceleration_by_pose, acceleration_by_mass = _quotients(acceleration)
    tensions_by_pose, tensions_by_mass = _quotients(tensions)
    radius = robot.pulley_radius
    structure = textbook.jacobian(robot, pose)
    rotor_mass = (robot.pulley_inertia / radius**2)[:, None]
    rotors = structure.mT @ (rotor_mass * structure)
    inertia = textbook.mass_matrix(robot, mass, pose) + rotors
    acceleration_by_wrench = np.linalg.inv(inertia)
    acceleration_by_torque = -acceleration_by_wrench @ structure.mT / radius
    drag_by_torque = rotor_mass * (structure @ acceleration_by_torque)
    tensions_by_torque = np.eye(robot.cables) / radius + drag_by_torque
    return Accelerated(
        acceleration=acceleration[0],
        tensions=tensions[0],
        by_pose=(acceleration_by_pose, tensions_by_pose),
        by_mass=(acceleration_by_mass, tensions_by_mass),
        by_torque=(acceleration_by_torque, tensions_by_torque),
        by_wrench=acceleration_by_wrench,
    )


def static(robot: Robot, mass: Array, pose: Array) -> tuple[Array, Array, Array]:
    """Torques at rest (N, m), and their gradients with respect to X (N, m, n) and the mass (N, m,
    1)."""
    poses, masses = _varied(pose, mass)
    torques = textbook.static_torque(robot, masses, poses)
    by_pose, by_mass = _quotients(torques)
    return torques[0], by_pose, by_mass


def _varied(pose: Array, mass: Array) -> tuple[Array, Array]:
    """Poses (n + 2, N, n) and masses (n + 2, N): nominal, each coordinate changed, mass changed."""
    n = pose.shape[-1]
    count = n + 2
    changes = STEP * np.eye(count, n, -1)
    poses = pose + changes[:, None]
    masses = np.repeat(mass[None], count, axis=0)
    masses[-1] += STEP
    return poses, masses


def _quotients(values: Array) -> tuple[Array, Array]:
    """Difference quotients of values (n + 2, N, j) with respect to X (N, j, n) and mass (N, j, 1)."""
    changes = values[1:] - values[0]
    quotients = np.moveaxis(changes, 0, -1) / STEP
    by_pose = quotients[..., :-1]
    by_mass = quotients[..., -1:]
    return by_pose, by_mass


def anchor_gradients(robot: Robot, pose: Array) -> tuple[Array, Array]:
    """Gradients of the pulley angles at poses (N, n) with respect to the anchors of base and
    platform, each (N, m, m·d).

    The pulley angle is zero at the home pose, so anchor errors have no effect there.
    """
    base, platform = _directions(robot, pose)
    base_at_home, platform_at_home = _directions(robot, robot.home[None])
    by_base = _by_cable(robot, base - base_at_home)
    by_platform = _by_cable(robot, platform - platform_at_home)
    return by_base, by_platform


def _directions(robot: Robot, pose: Array) -> tuple[Array, Array]:
    """Gradients of the cable lengths with respect to their own anchors, each (N, m, d)."""
    vectors = cable_vectors(robot.base, robot.platform, pose)
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    units = vectors / lengths
    if robot.coordinates == robot.dimensions:
        return -units, units
    angles = pose[:, robot.dimensions :]
    if robot.dimensions == 3:
        return -units, units @ rotation_matrix(angles)
    cosine = np.cos(angles)
    sine = np.sin(angles)
    x, y = np.moveaxis(units, -1, 0)
    turned_back_x = cosine * x + sine * y
    turned_back_y = cosine * y - sine * x
    turned_back = np.stack([turned_back_x, turned_back_y], axis=-1)
    return -units, turned_back


def _by_cable(robot: Robot, directions: Array) -> Array:
    """Gradients of the pulley angles (N, m, m·d) from those of the lengths (N, m, d)."""
    m = robot.cables
    own_anchor = np.eye(m)[:, :, None]
    by_anchor = own_anchor * directions[:, :, None, :]
    lengths = by_anchor.reshape(-1, m, robot.base.size)
    return -lengths / robot.pulley_radius[:, None]
