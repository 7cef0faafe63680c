"""Geometry of cable robots in batched numpy: rotations, cable lengths, the structure Jacobian S and
its rate.

Arrays may have any number of leading batch axes. The pose of a point mass is ``(x, y)`` or ``(x, y,
z)``, that of a platform in a plane ``(x, y, φ)``, and that of a platform in space ``(x, y, z, ψ, θ,
φ)`` with the rotation ``R = Rz(φ) Ry(θ) Rx(ψ)``. z points down. Lengths are in m, angles in rad.
``euler`` are the angles (ψ, θ, φ), shape (..., 3).

All functions but segment_distance also accept object arrays, such as arrays of CasADi symbols, so
the same equations serve numbers and symbolic derivatives.
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
    corner = np.asarray(rows[0][2])
    matrix = np.empty((*corner.shape, 3, 3), corner.dtype)
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            matrix[..., i, j] = entry
    return matrix


def turned(pose: ArrayLike, vectors: ArrayLike) -> Array:
    """Vectors of the platform frame, shape (..., k, d), in the base frame at poses (..., n).

    d is 2 or 3, the number of coordinates of the position. A point mass does not turn.
    """
    pose = as_numbers(pose)
    vectors = as_numbers(vectors)
    d = vectors.shape[-1]
    if pose.shape[-1] == d:
        return vectors
    if d == 3:
        return vectors @ rotation_matrix(pose[..., 3:]).mT
    angle = pose[..., 2:]
    cosine = np.cos(angle)
    sine = np.sin(angle)
    x = vectors[..., 0]
    y = vectors[..., 1]
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
    base = as_numbers(base)
    position = as_numbers(pose)[..., None, : base.shape[-1]]
    return position + turned(pose, platform) - base


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
    base = as_numbers(base)
    platform = as_numbers(platform)
    pose = as_numbers(pose)
    velocity = as_numbers(velocity)
    d = base.shape[-1]
    position = pose[..., None, :d]
    linear_velocity = velocity[..., None, :d]
    if pose.shape[-1] == d:
        return _unit_and_rate(position + platform - base, linear_velocity, swivel)
    if d == 2:
        return _turning_in_plane(base, platform, pose, velocity)
    euler = pose[..., 3:]
    euler_rates = velocity[..., 3:]
    rotation = rotation_matrix(euler)
    back = rotation.mT  # v @ back = R v for rows v
    to_omega = euler_rate_matrix(euler)
    omega = times_vector(to_omega, euler_rates)
    arms = skew(platform)  # arms @ x = b × x
    # In the platform frame, ω × b = −b × ω.
    anchor_velocity = linear_velocity - times_vector(arms, omega[..., None, :]) @ back
    vectors = position + platform @ back - base
    unit, unit_rate = _unit_and_rate(vectors, anchor_velocity, swivel)
    # d/dt (Rᵀu) = Rᵀu̇ − ω × Rᵀu, in the platform frame.
    in_frame = unit @ rotation
    in_frame_rate = unit_rate @ rotation - in_frame @ skew(omega).mT
    moment = times_vector(arms, in_frame)
    moment_rate = times_vector(arms, in_frame_rate)
    to_omega_rate = euler_rate_matrix_rate(euler, euler_rates)
    angular = moment @ to_omega
    angular_rate = moment_rate @ to_omega + moment @ to_omega_rate
    jacobian = np.concatenate([unit, angular], axis=-1)
    return jacobian, np.concatenate([unit_rate, angular_rate], axis=-1)


def _turning_in_plane(
    base: Array, platform: Array, pose: Array, velocity: Array
) -> tuple[Array, Array]:
    """S and Ṡ of platforms in a plane: rows (u, (R b) × u)."""
    arm = turned(pose, platform)
    arm_x = arm[..., :1]
    arm_y = arm[..., 1:]
    turning_rate = velocity[..., None, 2:]
    arm_rate = turning_rate * np.concatenate([-arm_y, arm_x], axis=-1)
    vectors = pose[..., None, :2] + arm - base
    anchor_velocity = velocity[..., None, :2] + arm_rate
    unit, unit_rate = _unit_and_rate(vectors, anchor_velocity, None)
    u_x = unit[..., :1]
    u_y = unit[..., 1:]
    moment = arm_x * u_y - arm_y * u_x
    moment_rate = arm_x * unit_rate[..., 1:] - arm_y * unit_rate[..., :1]
    moment_rate = moment_rate + arm_rate[..., :1] * u_y - arm_rate[..., 1:] * u_x
    jacobian = np.concatenate([unit, moment], axis=-1)
    return jacobian, np.concatenate([unit_rate, moment_rate], axis=-1)


class _Swivelled:
    """Cables on swivel pulleys, from the vectors between anchors (..., m, 3) and the swivel pulleys
    of :func:`cable_lengths`.

    In the plane of the pulley let c be the distance of the platform anchor from the swivel axis, h
    its height in the direction e from which the cable comes, and (ρ, 0) the centre of the pulley.
    With L² = (c − ρ)² + h² the free length is f = √(L² − ρ²), its direction u = (f (c − ρ) − ρ h, ρ
    (c − ρ) + f h)/L², and the length on the pulley is ρ (π + atan2(h, c − ρ) − atan2(f, ρ)).
    """

    def __init__(self, vectors: Array, swivel: Array) -> None:
        downwards = np.array([0.0, 0.0, 1.0])
        if swivel.ndim == 1:
            swivel = swivel[:, None] * downwards
        radius = np.sqrt(np.sum(swivel**2, axis=-1))
        has_radius = radius[:, None] > 0
        directions = swivel / np.where(has_radius, radius[:, None], 1.0)
        # Any direction serves a pulley without a radius.
        self.axis = np.where(has_radius, directions, downwards)
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
        along = np.sum(self.axis * point_velocity, axis=-1)
        outward = np.sum(self.level * point_velocity, axis=-1)
        sideways = np.sum(beside * point_velocity, axis=-1)
        # The free cable turns about the point where it leaves the pulley, and with the pulley about
        # the axis.
        bent = (out * along - down * outward) / self.free
        swung = out * sideways / self.reach
        unit = out[..., None] * self.level + down[..., None] * self.axis
        rate = (out * bent)[..., None] * self.axis
        rate = rate - (down * bent)[..., None] * self.level
        return unit, rate + swung[..., None] * beside


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


def segment_distance(start: Array, end: Array, other_start: Array, other_end: Array) -> Array:
    """Distance of two segments, which may be points, arrays (..., d) of numbers, shape (...) [m]."""
    first = end - start
    second = other_end - other_start
    between = start - other_start
    tiny = np.finfo(float).tiny  # for points
    a = np.vecdot(first, first) + tiny
    e = np.vecdot(second, second) + tiny
    b = np.vecdot(first, second)
    c = np.vecdot(first, between)
    f = np.vecdot(second, between)
    denominator = a * e - b * b
    parallel = denominator <= 1e-12 * a * e
    s = np.where(
        parallel, 0.0, np.clip((b * f - c * e) / np.where(parallel, 1.0, denominator), 0, 1)
    )
    t = np.clip((b * s + f) / e, 0, 1)
    s = np.clip((b * t - c) / a, 0, 1)
    gap = between + s[..., None] * first - t[..., None] * second
    distance: Array = np.linalg.norm(gap, axis=-1)
    return distance


def skew(vector: Array) -> Array:
    """The matrix of ``vector ×``, shape (..., 3, 3)."""
    matrix = np.zeros((*vector.shape, 3), vector.dtype)
    x, y, z = np.moveaxis(vector, -1, 0)
    matrix[..., 0, 1] = -z
    matrix[..., 0, 2] = y
    matrix[..., 1, 0] = z
    matrix[..., 1, 2] = -x
    matrix[..., 2, 0] = -y
    matrix[..., 2, 1] = x
    return matrix


def times_vector(matrix: Array, vector: Array) -> Array:
    """Batched matrix times vector."""
    applied: Array = (matrix @ vector[..., None])[..., 0]
    return applied
