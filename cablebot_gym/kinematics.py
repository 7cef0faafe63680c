"""Geometry of cable robots in batched numpy: rotations, cable lengths, the structure Jacobian S and its rate.

Arrays may have any number of leading batch axes. A planar pose is ``(x, y)``. A spatial pose is
``(x, y, z, ψ, θ, φ)`` with the rotation ``R = Rz(φ) Ry(θ) Rx(ψ)`` and z pointing down. Lengths are in m, angles in rad.
``euler`` are the angles (ψ, θ, φ), shape (..., 3).

All functions also accept object arrays, such as arrays of CasADi symbols, so the same equations serve numbers and
symbolic derivatives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
"""An array of float64, unless a docstring says otherwise."""

SPATIAL_COORDINATES = 6
"""Number of coordinates of a spatial pose."""


def as_numbers(values: ArrayLike) -> Array:
    """The values as a float64 array; an object array is returned unchanged."""
    array = np.asarray(values)
    return array if array.dtype == object else array.astype(float, copy=False)


def rotation_matrix(euler: ArrayLike) -> Array:
    """Rotation ``R = Rz(φ) Ry(θ) Rx(ψ)`` from the platform frame to the base frame, shape (..., 3, 3)."""
    (cx, cy, cz), (sx, sy, sz) = _cosines_and_sines(euler)
    return _matrix(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def euler_rate_matrix(euler: ArrayLike) -> Array:
    """Matrix P of Eq. 3, shape (..., 3, 3): ``ω_body = P [ψ̇, θ̇, φ̇]``."""
    (cx, cy, _), (sx, sy, _) = _cosines_and_sines(euler)
    return _matrix([[1.0, 0.0, -sy], [0.0, cx, sx * cy], [0.0, -sx, cx * cy]])


def euler_rate_matrix_rate(euler: ArrayLike, rates: ArrayLike) -> Array:
    """Ṗ, the time derivative of :func:`euler_rate_matrix` for Euler angle rates (..., 3), shape (..., 3, 3)."""
    (cx, cy, _), (sx, sy, _) = _cosines_and_sines(euler)
    dpsi, dtheta, _ = _components(rates)
    return _matrix(
        [
            [0.0, 0.0, -cy * dtheta],
            [0.0, -sx * dpsi, cx * cy * dpsi - sx * sy * dtheta],
            [0.0, -cx * dpsi, -sx * cy * dpsi - cx * sy * dtheta],
        ]
    )


def _components(vector: ArrayLike) -> tuple[Array, Array, Array]:
    vector = as_numbers(vector)
    return vector[..., 0], vector[..., 1], vector[..., 2]


def _cosines_and_sines(euler: ArrayLike) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    euler = as_numbers(euler)
    return _components(np.cos(euler)), _components(np.sin(euler))


def _matrix(rows: list[list[Array | float]]) -> Array:
    """3 × 3 matrices from batched entries. The last entry of the first row determines the batch shape."""
    matrix = np.empty((*np.shape(rows[0][2]), 3, 3), np.asarray(rows[0][2]).dtype)
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            matrix[..., i, j] = entry
    return matrix


def cable_vectors(base: ArrayLike, platform: ArrayLike, pose: ArrayLike) -> Array:
    """Vectors from base anchor to platform anchor in the base frame, shape (..., m, 2 or 3).

    Args:
        base: base anchors A_i, shape (m, 2) planar or (m, 3) spatial, or (N, m, …) with one set per pose.
        platform: platform anchors b_i in the platform frame, same shape; zeros for a planar robot (point mass).
        pose: X, shape (..., 2) or (..., 6).
    """
    base, platform, pose = (as_numbers(array) for array in (base, platform, pose))
    if pose.shape[-1] == SPATIAL_COORDINATES:
        platform = platform @ np.swapaxes(rotation_matrix(pose[..., 3:]), -1, -2)
    return pose[..., None, : base.shape[-1]] + platform - base


def cable_lengths(base: ArrayLike, platform: ArrayLike, pose: ArrayLike) -> Array:
    """Cable lengths ``q_i(X) = ‖A_i − (p + R b_i)‖`` [m], shape (..., m). Arguments as in :func:`cable_vectors`."""
    lengths: Array = np.sqrt(np.sum(cable_vectors(base, platform, pose) ** 2, axis=-1))
    return lengths


def structure_jacobian(base: ArrayLike, platform: ArrayLike, pose: ArrayLike) -> Array:
    """Structure Jacobian ``S = ∂q/∂X`` (Eq. 3), shape (..., m, n). Arguments as in :func:`cable_vectors`."""
    zero_velocity = np.zeros_like(as_numbers(pose))
    return jacobian_and_rate(base, platform, pose, zero_velocity)[0]


def structure_jacobian_rate(base: ArrayLike, platform: ArrayLike, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Ṡ, the time derivative of S along the velocity Ẋ, shape (..., m, n). Arguments as in :func:`cable_vectors`."""
    return jacobian_and_rate(base, platform, pose, velocity)[1]


def jacobian_and_rate(
    base: ArrayLike, platform: ArrayLike, pose: ArrayLike, velocity: ArrayLike
) -> tuple[Array, Array]:
    """S and Ṡ, each (..., m, n), computed together at little more than the cost of one.

    Args:
        base: base anchors, as in :func:`cable_vectors`.
        platform: platform anchors, as in :func:`cable_vectors`.
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
    """
    base, pose, velocity, platform = (as_numbers(array) for array in (base, pose, velocity, platform))
    if pose.shape[-1] != SPATIAL_COORDINATES:
        unit, unit_rate = _unit_and_rate(pose[..., None, :] + platform - base, velocity[..., None, :])
        return unit, unit_rate
    euler, rates = pose[..., 3:], velocity[..., 3:]
    rotation, to_omega = rotation_matrix(euler), euler_rate_matrix(euler)
    turned = np.swapaxes(rotation, -1, -2)
    omega = (to_omega @ rates[..., None])[..., 0]
    arms = _skew(platform)  # arms @ x = b × x
    anchor_velocity = velocity[..., None, :3] - (arms @ omega[..., None, :, None])[..., 0] @ turned
    unit, unit_rate = _unit_and_rate(pose[..., None, :3] + platform @ turned - base, anchor_velocity)
    # d/dt (Rᵀu) = Rᵀu̇ − ω × Rᵀu, in the platform frame.
    in_frame = unit @ rotation
    in_frame_rate = unit_rate @ rotation - in_frame @ np.swapaxes(_skew(omega), -1, -2)
    moment, moment_rate = (arms @ in_frame[..., None])[..., 0], (arms @ in_frame_rate[..., None])[..., 0]
    angular_rate = moment_rate @ to_omega + moment @ euler_rate_matrix_rate(euler, rates)
    jacobian = np.concatenate([unit, moment @ to_omega], axis=-1)
    return jacobian, np.concatenate([unit_rate, angular_rate], axis=-1)


def _unit_and_rate(vectors: Array, point_velocity: Array) -> tuple[Array, Array]:
    """Cable directions and their rates."""
    length = np.sqrt(np.sum(vectors * vectors, axis=-1, keepdims=True))
    with np.errstate(divide="ignore", invalid="ignore"):  # the direction of a cable of zero length is NaN
        unit = vectors / length
        length_rate = np.sum(unit * point_velocity, axis=-1, keepdims=True)
        return unit, (point_velocity - unit * length_rate) / length


def _skew(vector: Array) -> Array:
    """The matrix of ``vector ×``, shape (..., 3, 3)."""
    matrix = np.zeros((*vector.shape, 3), vector.dtype)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix
