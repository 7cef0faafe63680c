"""Geometry of cable robots in batched numpy: rotations, cable lengths, the structure Jacobian S and its rate.

Arrays carry any number of leading batch axes. A planar pose is ``(x, y)``; a spatial pose is
``(x, y, z, ψ, θ, φ)`` with the rotation ``R = Rz(φ) Ry(θ) Rx(ψ)`` and z pointing down. Lengths in m, angles in rad.
Nothing here knows masses or motors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SPATIAL_COORDINATES = 6
"""Number of coordinates of a spatial pose."""


def rotation_matrix(euler: ArrayLike) -> Array:
    """``R = Rz(φ) Ry(θ) Rx(ψ)``, platform to base frame, shape (..., 3, 3), from ``(ψ, θ, φ)`` of shape (..., 3)."""
    psi, theta, phi = np.moveaxis(np.asarray(euler, float), -1, 0)
    cx, sx, cy, sy, cz, sz = np.cos(psi), np.sin(psi), np.cos(theta), np.sin(theta), np.cos(phi), np.sin(phi)
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_rate_matrix(euler: ArrayLike) -> Array:
    """The paper's P (Eq. 3), shape (..., 3, 3): ``ω_body = P [ψ̇, θ̇, φ̇]``."""
    psi, theta, _ = np.moveaxis(np.asarray(euler, float), -1, 0)
    zero, one = np.zeros_like(psi), np.ones_like(psi)
    rows = [
        [one, zero, -np.sin(theta)],
        [zero, np.cos(psi), np.sin(psi) * np.cos(theta)],
        [zero, -np.sin(psi), np.cos(psi) * np.cos(theta)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_rate_matrix_rate(euler: ArrayLike, rates: ArrayLike) -> Array:
    """Ṗ, the time derivative of :func:`euler_rate_matrix`, shape (..., 3, 3)."""
    psi, theta, _ = np.moveaxis(np.asarray(euler, float), -1, 0)
    dpsi, dtheta, _ = np.moveaxis(np.asarray(rates, float), -1, 0)
    zero = np.zeros_like(psi)
    cx, sx, cy, sy = np.cos(psi), np.sin(psi), np.cos(theta), np.sin(theta)
    rows = [
        [zero, zero, -cy * dtheta],
        [zero, -sx * dpsi, cx * cy * dpsi - sx * sy * dtheta],
        [zero, -cx * dpsi, -sx * cy * dpsi - cx * sy * dtheta],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def cable_vectors(base: ArrayLike, platform: ArrayLike, pose: ArrayLike) -> Array:
    """Vectors from base anchor to platform anchor in the base frame, shape (..., m, 2 or 3).

    Args:
        base: base anchors A_i, shape (m, 2) planar or (m, 3) spatial.
        platform: platform anchors b_i in the platform frame, same shape; planar cables meet in one point, b_i = 0.
        pose: shape (..., 2) or (..., 6).
    """
    base, platform, pose = (np.asarray(array, float) for array in (base, platform, pose))
    if pose.shape[-1] == SPATIAL_COORDINATES:
        platform = np.einsum("...jk,mk->...mj", rotation_matrix(pose[..., 3:]), platform)
    return pose[..., None, : base.shape[-1]] + platform - base


def cable_lengths(base: ArrayLike, platform: ArrayLike, pose: ArrayLike) -> Array:
    """``q_i(X) = ‖A_i − (p + R b_i)‖``, shape (..., m). Arguments as in :func:`cable_vectors`."""
    return np.linalg.norm(cable_vectors(base, platform, pose), axis=-1)


def structure_jacobian(base: ArrayLike, platform: ArrayLike, pose: ArrayLike) -> Array:
    """``S = ∂q/∂X`` (Eq. 3), shape (..., m, n). Arguments as in :func:`cable_vectors`."""
    pose = np.asarray(pose, float)
    vectors = cable_vectors(base, platform, pose)
    unit = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    if pose.shape[-1] != SPATIAL_COORDINATES:
        return unit
    return np.concatenate([unit, _angular_part(unit, platform, pose)], axis=-1)


def _angular_part(along: Array, platform: ArrayLike, pose: Array) -> Array:
    """Derivative of ``along · R b`` with respect to ``(ψ, θ, φ)``, the direction ``along`` held, shape (..., m, 3)."""
    in_platform_frame = np.einsum("...kj,...mk->...mj", rotation_matrix(pose[..., 3:]), along)
    moment = np.cross(np.asarray(platform, float), in_platform_frame)
    return moment @ euler_rate_matrix(pose[..., 3:])


def structure_jacobian_rate(base: ArrayLike, platform: ArrayLike, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """``Ṡ``, the time derivative of S along ``velocity = Ẋ``, shape (..., m, n)."""
    pose, velocity, platform = (np.asarray(array, float) for array in (pose, velocity, platform))
    vectors = cable_vectors(base, platform, pose)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit = vectors / length
    point_velocity = _anchor_velocity(platform, pose, velocity)
    length_rate = np.sum(unit * point_velocity, axis=-1, keepdims=True)
    unit_rate = (point_velocity - unit * length_rate) / length
    if pose.shape[-1] != SPATIAL_COORDINATES:
        return np.broadcast_to(unit_rate, np.broadcast_shapes(unit_rate.shape, unit.shape)).copy()
    euler, rates = pose[..., 3:], velocity[..., 3:]
    rotation, to_omega = rotation_matrix(euler), euler_rate_matrix(euler)
    omega = np.einsum("...jk,...k->...j", to_omega, rates)[..., None, :]
    # d/dt (Rᵀu) = Rᵀu̇ − ω × Rᵀu, in the platform frame.
    in_frame = np.einsum("...kj,...mk->...mj", rotation, unit)
    in_frame_rate = np.einsum("...kj,...mk->...mj", rotation, unit_rate) - np.cross(omega, in_frame)
    angular = np.cross(platform, in_frame_rate) @ to_omega
    angular = angular + np.cross(platform, in_frame) @ euler_rate_matrix_rate(euler, rates)
    return np.concatenate([unit_rate, angular], axis=-1)


def _anchor_velocity(platform: Array, pose: Array, velocity: Array) -> Array:
    """Velocity of each platform anchor in the base frame, shape (..., m, 2 or 3)."""
    if pose.shape[-1] != SPATIAL_COORDINATES:
        return velocity[..., None, :]
    omega = np.einsum("...jk,...k->...j", euler_rate_matrix(pose[..., 3:]), velocity[..., 3:])
    turning = np.cross(omega[..., None, :], platform)
    return velocity[..., None, :3] + np.einsum("...jk,...mk->...mj", rotation_matrix(pose[..., 3:]), turning)
