"""Geometry of cable robots in batched numpy: rotations, cable lengths, the structure Jacobian S and
its rate.

Arrays may have any number of leading batch axes. The pose of a point mass is ``(x, y)`` or ``(x, y,
z)``, that of a platform in a plane ``(x, y, φ)``, and that of a platform in space ``(x, y, z, ψ, θ,
φ)`` with the rotation ``R = Rz(φ) Ry(θ) Rx(ψ)``. z points down. Lengths are in m, angles in rad.
``euler`` are the angles (ψ, θ, φ), shape (..., 3).

All functions also accept object arrays, such as arrays of CasADi symbols, so the same equations
serve numbers and symbolic derivatives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
"""An array of float64, unless a docstring says otherwise."""


def as_numbers(values: ArrayLike) -> Array:
    """The values as a float64 array; an object array is returned unchanged.

    All functions here and in the textbook pass their arguments through this one.

    Raises:
        ValueError: if a number is not finite.
    """
    array = np.asarray(values)
    if array.dtype == object:
        return array
    numbers = array.astype(float, copy=False)
    if not np.isfinite(numbers).all():
        raise ValueError(
            "poses, velocities and other arguments must be finite, without NaN and infinity"
        )
    return numbers


def rotation_matrix(euler: ArrayLike) -> Array:
    """Rotation ``R = Rz(φ) Ry(θ) Rx(ψ)`` from the platform frame to the base frame, shape (..., 3,
    3)."""
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
    """Ṗ, the time derivative of :func:`euler_rate_matrix` for Euler angle rates (..., 3), shape
    (..., 3, 3)."""
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


def _cosines_and_sines(
    euler: ArrayLike,
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    euler = as_numbers(euler)
    return _components(np.cos(euler)), _components(np.sin(euler))


def _matrix(rows: list[list[Array | float]]) -> Array:
    """3 × 3 matrices from batched entries. The last entry of the first row determines the batch
    shape."""
    matrix = np.empty((*np.shape(rows[0][2]), 3, 3), np.asarray(rows[0][2]).dtype)
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            matrix[..., i, j] = entry
    return matrix


def turned(pose: ArrayLike, vectors: ArrayLike) -> Array:
    """Vectors of the platform frame, shape (..., k, d), in the base frame at poses (..., n).

    d is 2 or 3, the number of coordinates of the position. A point mass does not turn.
    """
    pose, vectors = as_numbers(pose), as_numbers(vectors)
    d = vectors.shape[-1]
    if pose.shape[-1] == d:
        return vectors
    if d == 3:
        return vectors @ np.swapaxes(rotation_matrix(pose[..., 3:]), -1, -2)
    cosine, sine = np.cos(pose[..., 2:]), np.sin(pose[..., 2:])
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def cable_vectors(base: ArrayLike, platform: ArrayLike, pose: ArrayLike) -> Array:
    """Vectors from base anchor to platform anchor in the base frame, shape (..., m, d).

    Args:
        base: base anchors A_i, shape (m, d) with d = 2 in a plane and 3 in space, or (N, m, d) with
            one set per pose.
        platform: platform anchors b_i in the platform frame, same shape; zeros for a point mass.
        pose: X, shape (..., n) with n = d for a point mass, 3 for a platform in a plane and 6 in
            space.
    """
    base, pose = as_numbers(base), as_numbers(pose)
    return pose[..., None, : base.shape[-1]] + turned(pose, platform) - base


def cable_lengths(
    base: ArrayLike, platform: ArrayLike, pose: ArrayLike, swivel: ArrayLike | None = None
) -> Array:
    """Cable lengths q_i(X) [m], shape (..., m): ``‖A_i − (p + R b_i)‖`` without swivel pulleys.

    With swivel pulleys, q_i is the length on the pulley from the swivel axis on, plus the free
    length.

    Args:
        base: base anchors, as in :func:`cable_vectors`.
        platform: platform anchors, as in :func:`cable_vectors`.
        pose: X, shape (..., n).
        swivel: swivel pulleys in space [m]; None if there are none. Either the signed radii ± ρ,
            shape (m,): the cable runs along the vertical axis through A_i to the pulley, from below
            if the sign is positive and from above if it is negative. Or vectors ρ e, shape (m, 3):
            it comes from the direction e along this axis. The pulley turns about the axis towards
            the platform anchor.
    """
    vectors = cable_vectors(base, platform, pose)
    if swivel is not None:
        return _Swivelled(vectors, as_numbers(swivel)).length
    lengths: Array = np.sqrt(np.sum(vectors**2, axis=-1))
    return lengths


def structure_jacobian(
    base: ArrayLike, platform: ArrayLike, pose: ArrayLike, swivel: ArrayLike | None = None
) -> Array:
    """Structure Jacobian ``S = ∂q/∂X`` (Eq. 3), shape (..., m, n). Arguments as in
    :func:`cable_lengths`."""
    zero_velocity = np.zeros_like(as_numbers(pose))
    return jacobian_and_rate(base, platform, pose, zero_velocity, swivel)[0]


def structure_jacobian_rate(
    base: ArrayLike,
    platform: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    swivel: ArrayLike | None = None,
) -> Array:
    """Ṡ, the time derivative of S along the velocity Ẋ, shape (..., m, n). Arguments as in
    :func:`cable_lengths`."""
    return jacobian_and_rate(base, platform, pose, velocity, swivel)[1]


def jacobian_and_rate(
    base: ArrayLike,
    platform: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    swivel: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """S and Ṡ, each (..., m, n), computed together at little more than the cost of one.

    Args:
        base: base anchors, as in :func:`cable_vectors`.
        platform: platform anchors, as in :func:`cable_vectors`.
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
        swivel: swivel pulleys, as in :func:`cable_lengths`.
    """
    base, pose, velocity, platform = (
        as_numbers(array) for array in (base, pose, velocity, platform)
    )
    d, n = base.shape[-1], pose.shape[-1]
    if n == d:
        return _unit_and_rate(pose[..., None, :] + platform - base, velocity[..., None, :], swivel)
    if d == 2:
        return _turning_in_plane(base, platform, pose, velocity)
    euler, rates = pose[..., 3:], velocity[..., 3:]
    rotation = rotation_matrix(euler)
    to_omega = euler_rate_matrix(euler)
    back = np.swapaxes(rotation, -1, -2)
    omega = (to_omega @ rates[..., None])[..., 0]
    arms = _skew(platform)  # arms @ x = b × x
    anchor_velocity = velocity[..., None, :3] - (arms @ omega[..., None, :, None])[..., 0] @ back
    unit, unit_rate = _unit_and_rate(
        pose[..., None, :3] + platform @ back - base, anchor_velocity, swivel
    )
    # d/dt (Rᵀu) = Rᵀu̇ − ω × Rᵀu, in the platform frame.
    in_frame = unit @ rotation
    in_frame_rate = unit_rate @ rotation - in_frame @ np.swapaxes(_skew(omega), -1, -2)
    moment = (arms @ in_frame[..., None])[..., 0]
    moment_rate = (arms @ in_frame_rate[..., None])[..., 0]
    angular_rate = moment_rate @ to_omega + moment @ euler_rate_matrix_rate(euler, rates)
    jacobian = np.concatenate([unit, moment @ to_omega], axis=-1)
    return jacobian, np.concatenate([unit_rate, angular_rate], axis=-1)


def _turning_in_plane(
    base: Array, platform: Array, pose: Array, velocity: Array
) -> tuple[Array, Array]:
    """S and Ṡ of platforms in a plane: rows (u, (R b) × u)."""
    arm, rate = turned(pose, platform), velocity[..., None, 2:]
    arm_rate = rate * np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    unit, unit_rate = _unit_and_rate(
        pose[..., None, :2] + arm - base, velocity[..., None, :2] + arm_rate, None
    )
    moment = arm[..., 0] * unit[..., 1] - arm[..., 1] * unit[..., 0]
    moment_rate = arm[..., 0] * unit_rate[..., 1] - arm[..., 1] * unit_rate[..., 0]
    moment_rate = moment_rate + arm_rate[..., 0] * unit[..., 1] - arm_rate[..., 1] * unit[..., 0]
    jacobian = np.concatenate([unit, moment[..., None]], axis=-1)
    return jacobian, np.concatenate([unit_rate, moment_rate[..., None]], axis=-1)


class _Swivelled:
    """Cables on swivel pulleys, from the vectors between anchors (..., m, 3) and the swivel pulleys
    of :func:`cable_lengths`.

    In the plane of the pulley let c be the distance of the platform anchor from the swivel axis, h
    its height in the direction e from which the cable comes, and (ρ, 0) the centre of the pulley.
    With L² = (c − ρ)² + h² the free length is f = √(L² − ρ²), its direction u = (f (c − ρ) − ρ h, ρ
    (c − ρ) + f h)/L², and the length on the pulley is ρ (π + atan2(h, c − ρ) − atan2(f, ρ)).
    """

    def __init__(self, vectors: Array, swivel: Array) -> None:
        if swivel.ndim == 1:
            swivel = swivel[:, None] * np.array([0.0, 0.0, 1.0])
        radius = np.sqrt(np.sum(swivel**2, axis=-1))
        upright = np.array([0.0, 0.0, 1.0])  # any direction serves a pulley without a radius
        self.axis = np.where(
            radius[:, None] > 0, swivel / np.where(radius > 0, radius, 1.0)[:, None], upright
        )
        self.radius = radius
        self.height = np.sum(vectors * self.axis, axis=-1)
        level = vectors - self.height[..., None] * self.axis
        self.reach = np.sqrt(np.sum(level**2, axis=-1))
        self.level = level / self.reach[..., None]
        self.across = self.reach - radius
        self.square = self.across**2 + self.height**2
        self.free = np.sqrt(self.square - radius**2)

    @property
    def length(self) -> Array:
        """Cable lengths, (..., m)."""
        # atan2 for symbols too, with ρ ≥ 0 and f > 0
        angle = 2 * np.arctan(self.height / (np.sqrt(self.square) + self.across))
        turn = np.pi / 2 + angle + np.arctan(self.radius / self.free)
        length: Array = self.radius * turn + self.free
        return length

    def unit_and_rate(self, point_velocity: Array) -> tuple[Array, Array]:
        """Directions of the free cables and their rates, each (..., m, 3)."""
        radius = self.radius
        out = (self.free * self.across - radius * self.height) / self.square
        down = (radius * self.across + self.free * self.height) / self.square
        beside = np.cross(self.axis, self.level)
        along, outward, sideways = (
            np.sum(direction * point_velocity, axis=-1)
            for direction in (self.axis, self.level, beside)
        )
        # The free cable turns about the point where it leaves the pulley, and with the pulley about
        # the axis.
        bent = (out * along - down * outward) / self.free
        swung = out * sideways / self.reach
        unit = out[..., None] * self.level + down[..., None] * self.axis
        rate = (
            (out * bent)[..., None] * self.axis
            - (down * bent)[..., None] * self.level
            + swung[..., None] * beside
        )
        return unit, rate


def _unit_and_rate(
    vectors: Array, point_velocity: Array, swivel: ArrayLike | None
) -> tuple[Array, Array]:
    """Cable directions and their rates."""
    if swivel is not None:
        return _Swivelled(vectors, as_numbers(swivel)).unit_and_rate(point_velocity)
    length = np.sqrt(np.sum(vectors * vectors, axis=-1, keepdims=True))
    # the direction of a cable of zero length is NaN
    with np.errstate(divide="ignore", invalid="ignore"):
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
