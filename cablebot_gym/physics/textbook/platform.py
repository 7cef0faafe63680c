"""Platform and cables: mass matrix, bias, motion of the pulleys, and tensions of planar cables."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array, as_numbers
from cablebot_gym.uncertainty import RobotArrays


def jacobian(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Structure Jacobian S = ∂q/∂X (Eq. 3), shape (..., m, n)."""
    return kinematics.structure_jacobian(robot.base, robot.platform, pose, robot.swivel)


def jacobian_rate(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Ṡ, the time derivative of S along Ẋ, shape (..., m, n)."""
    return kinematics.structure_jacobian_rate(
        robot.base, robot.platform, pose, velocity, robot.swivel
    )


def mass_matrix(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike) -> Array:
    """Mass matrix D(X) of Eq. 3, shape (..., n, n): ``blkdiag(m I₃, PᵀIP)`` in space, ``m I`` for a
    point mass.

    With the centre of mass c away from the frame's origin, I is the inertia about the origin, and
    the matrix couples both: ``((m I₃, −m R [c]× P), (·ᵀ, PᵀIP))``. In a plane P = 1, and with s = R
    c the coupling is m (−s_y, s_x).
    """
    pose = as_numbers(pose)
    mass = as_numbers(mass)
    shape = np.broadcast_shapes(mass.shape, pose.shape[:-1])
    mass = np.broadcast_to(mass, shape)[..., None, None]
    d, n = robot.dimensions, robot.coordinates
    if robot.point_mass:
        return mass * np.eye(d)
    matrix = np.zeros((*shape, n, n), np.result_type(pose, mass))
    matrix[..., :d, :d] = mass * np.eye(d)
    offset, inertia = robot.mass_center, robot.inertia_tensor
    if robot.planar:
        arm = kinematics.turned(pose, offset[None])[..., 0, :]
        matrix[..., 2, 2] = inertia[..., 2, 2] + mass[..., 0, 0] * (offset @ offset)
        matrix[..., 0, 2] = matrix[..., 2, 0] = -mass[..., 0, 0] * arm[..., 1]
        matrix[..., 1, 2] = matrix[..., 2, 1] = mass[..., 0, 0] * arm[..., 0]
        return matrix
    to_omega = kinematics.euler_rate_matrix(pose[..., 3:])
    if np.any(offset):
        rotation = kinematics.rotation_matrix(pose[..., 3:])
        coupling = -mass * rotation @ _cross_matrix(offset) @ to_omega
        matrix[..., :3, 3:] = coupling
        matrix[..., 3:, :3] = np.swapaxes(coupling, -1, -2)
        inertia = _about_origin(inertia, mass, offset)
    matrix[..., 3:, 3:] = np.swapaxes(to_omega, -1, -2) @ inertia @ to_omega
    return matrix


def _about_origin(inertia: Array, mass: Array, offset: Array) -> Array:
    """Inertia about the frame's origin for a centre of mass at ``offset``: Steiner's theorem."""
    moved: Array = inertia + mass * ((offset @ offset) * np.eye(3) - np.outer(offset, offset))
    return moved


def _cross_matrix(vector: Array) -> Array:
    """Matrix of ``vector ×``, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def bias(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """h(X, Ẋ) = C Ẋ + g of Eq. 3, shape (..., n).

    In space ``(0, 0, −m g, Pᵀ{I Ṗ Θ̇ + ω × Iω})`` with ω = P Θ̇. The centre of mass c away from the
    origin adds the force ``m R {ω × (ω × c) + (Ṗ Θ̇) × c}`` and the moment ``−Pᵀ{c × Rᵀ m g}``. In
    a plane with s = R c: ``(−m g − m φ̇² s, −s × m g)``.
    """
    pose = as_numbers(pose)
    velocity = as_numbers(velocity)
    mass = as_numbers(mass)
    shape = np.broadcast_shapes(pose.shape, velocity.shape, (*mass.shape, 1))
    vector = np.zeros(shape, np.result_type(pose, mass, velocity))
    d, offset = robot.dimensions, robot.mass_center
    weight = mass[..., None] * robot.gravity_vector
    vector[..., :d] = -weight
    if robot.point_mass:
        return vector
    if robot.planar:
        if np.any(offset):
            arm = kinematics.turned(pose, offset[None])[..., 0, :]
            vector[..., :2] -= mass[..., None] * velocity[..., 2:] ** 2 * arm
            vector[..., 2] = arm[..., 1] * weight[..., 0] - arm[..., 0] * weight[..., 1]
        return vector
    inertia, rates = robot.inertia_tensor, velocity[..., 3:]
    to_omega = kinematics.euler_rate_matrix(pose[..., 3:])
    omega = times_vector(to_omega, rates)
    spin = times_vector(kinematics.euler_rate_matrix_rate(pose[..., 3:], rates), rates)
    if np.any(offset):
        inertia = _about_origin(inertia, mass[..., None, None], offset)
    moment = times_vector(inertia, spin) + np.cross(omega, times_vector(inertia, omega))
    if np.any(offset):
        rotation = kinematics.rotation_matrix(pose[..., 3:])
        centripetal = np.cross(omega, np.cross(omega, offset)) + np.cross(spin, offset)
        vector[..., :3] += mass[..., None] * times_vector(rotation, centripetal)
        moment = moment - np.cross(offset, times_vector(np.swapaxes(rotation, -1, -2), weight))
    vector[..., 3:] = times_vector(np.swapaxes(to_omega, -1, -2), moment)
    return vector


def load(
    robot: RobotArrays,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
) -> Array:
    """Required generalised force D Ẍ + h, which the cables apply as −SᵀT (Eqs. 3 and 16), shape
    (..., n)."""
    inertia_force = times_vector(mass_matrix(robot, mass, pose), as_numbers(acceleration))
    return inertia_force + bias(robot, mass, pose, velocity)


def cable_lengths(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Cable lengths q(X) between base anchor and platform anchor [m], shape (..., m)."""
    return kinematics.cable_lengths(robot.base, robot.platform, pose, robot.swivel)


def pulley_speed(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Pulley speed β̇ = −S Ẋ / r [rad/s], shape (..., m). It is positive when the cable winds up.

    With a rigid transmission it is the motor speed.
    """
    return -times_vector(jacobian(robot, pose), as_numbers(velocity)) / robot.pulley_radius


def pulley_angle(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Pulley angle β = −(q(X) − q(X₀))/r [rad], shape (..., m), of cables that do not stretch."""
    return (cable_lengths(robot, robot.home) - cable_lengths(robot, pose)) / robot.pulley_radius


def pulley_acceleration(
    robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> Array:
    """Pulley acceleration β̈ = −(S Ẍ + Ṡ Ẋ)/r (Eq. 6) [rad/s²], shape (..., m)."""
    cable = times_vector(jacobian(robot, pose), as_numbers(acceleration))
    cable = cable + times_vector(jacobian_rate(robot, pose, velocity), as_numbers(velocity))
    return -cable / robot.pulley_radius


def pulley_motion(
    robot: RobotArrays, structure: Array, rate: Array, velocity: ArrayLike, acceleration: ArrayLike
) -> tuple[Array, Array]:
    """β̇ and β̈ from S and Ṡ, see :func:`pulley_speed` and :func:`pulley_acceleration`."""
    velocity = as_numbers(velocity)
    cable = times_vector(structure, as_numbers(acceleration)) + times_vector(rate, velocity)
    return -times_vector(structure, velocity) / robot.pulley_radius, -cable / robot.pulley_radius


def tension_distribution(
    structure: Array, load: Array, minimum: float, *, strict: bool = True
) -> Array:
    """Smallest tensions T with ``−Sᵀ T = load`` and ``T_i ≥ minimum`` for a planar ``structure`` S,
    shape (..., m, 2).

    All cables have at least the tension ``minimum``. Two cables balance the remaining force in
    addition: of all pairs with non-negative tensions, the pair with the smallest sum. For m = 3
    this is ``T = T_p + α N`` (Eq. 11) with the smallest α, which minimises all tensions at the same
    time.

    Outside the polygon of the base anchors the cables cannot apply some forces. Without ``strict``
    the result for such a force is ``minimum`` in all cables, so that a control law can continue.

    Raises:
        ValueError: if ``strict`` and no pair of cables can apply the force.
    """
    remaining = load + minimum * structure.sum(axis=-2)
    shape = np.broadcast_shapes(structure.shape[:-2], load.shape[:-1])
    best_sum = np.full(shape, np.inf)
    best = np.zeros((*shape, structure.shape[-2]))
    for i, j in combinations(range(structure.shape[-2]), 2):
        (ax, ay), (bx, by) = (np.moveaxis(-structure[..., k, :], -1, 0) for k in (i, j))
        determinant = ax * by - ay * bx
        with np.errstate(divide="ignore", invalid="ignore"):
            tension_i = (remaining[..., 0] * by - remaining[..., 1] * bx) / determinant
            tension_j = (ax * remaining[..., 1] - ay * remaining[..., 0]) / determinant
        # A force along one of the two cables gives a tiny negative value by rounding.
        slack = 1e-12 * (1 + np.abs(tension_i) + np.abs(tension_j))
        usable = (tension_i >= -slack) & (tension_j >= -slack) & (np.abs(determinant) > 1e-12)
        usable &= tension_i + tension_j < best_sum
        best_sum = np.where(usable, tension_i + tension_j, best_sum)
        pair = np.zeros_like(best)
        pair[..., i] = tension_i
        pair[..., j] = tension_j
        best = np.where(usable[..., None], pair, best)
    if strict and not np.all(np.isfinite(best_sum)):
        raise ValueError(
            "no positive tensions give this force: the pose is outside the polygon of the base anchors"
        )
    return minimum + np.maximum(best, 0.0)


def smooth_tension_distribution(
    structure: Array, least: Array, minimum: float, softness: float
) -> Array:
    """Smooth tensions of three planar cables; those of :func:`tension_distribution` have kinks.

    Let N > 0 be the null vector of Sᵀ with sum 1. ``T + α N`` balances the same force for all α.
    Let α_i be the value that lifts cable i to the minimum tension. The largest α_i gives the
    smallest tensions. This function uses ``softness · log Σ exp(α_i/softness)`` instead. No tension
    is below the minimum. The sum of the tensions exceeds the smallest sum by at most ``softness ·
    log 3``.

    Args:
        structure: S, shape (..., 3, 2).
        least: the smallest tensions T, shape (..., 3) [N].
        minimum: minimum tension [N].
        softness: smoothing of α [N]; > 0.
    """
    (ax, ay), (bx, by), (cx, cy) = (np.moveaxis(structure[..., k, :], -1, 0) for k in range(3))
    null = np.stack([bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay], axis=-1)
    null = null / null.sum(axis=-1, keepdims=True)
    lifts = np.exp((minimum - least) / null / softness)
    soft: Array = least + softness * np.log(lifts.sum(axis=-1, keepdims=True)) * null
    return soft


def times_vector(matrix: Array, vector: Array) -> Array:
    """Batched matrix times vector."""
    applied: Array = (matrix @ vector[..., None])[..., 0]
    return applied
