"""Platform and cables: mass matrix, bias, motion of the pulleys, and tensions of planar cables."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array, as_numbers, skew, times_vector
from cablebot_gym.uncertainty import RobotArrays


def jacobian(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Structure Jacobian S = ∂q/∂X (Eq. 3), shape (..., m, n)."""
    return kinematics.structure_jacobian(robot.base, robot.platform, pose, robot.swivel)


def jacobian_rate(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Ṡ, the time derivative of S along Ẋ, shape (..., m, n)."""
    _, rate = jacobian_and_rate(robot, pose, velocity)
    return rate


def jacobian_and_rate(
    robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike
) -> tuple[Array, Array]:
    """S and Ṡ, each (..., m, n)."""
    return kinematics.jacobian_and_rate(robot.base, robot.platform, pose, velocity, robot.swivel)


def mass_matrix(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike) -> Array:
    """Mass matrix D(X) of Eq. 3, shape (..., n, n): ``blkdiag(m I₃, PᵀIP)`` in space, ``m I`` for a
    point mass.

    With the centre of mass c away from the frame's origin, I is the inertia about the origin, and
    the matrix couples both: ``((m I₃, −m R [c]× P), (·ᵀ, PᵀIP))``. In a plane P = 1, and with s = R
    c the coupling is m (−s_y, s_x).
    """
    pose = as_numbers(pose)
    mass = as_numbers(mass)
    batch = np.broadcast_shapes(mass.shape, pose.shape[:-1])
    mass = np.broadcast_to(mass, batch)
    masses = mass[..., None, None]
    d = robot.dimensions
    n = robot.coordinates
    translation = masses * np.eye(d)
    if robot.point_mass:
        return translation
    matrix = np.zeros((*batch, n, n), np.result_type(pose, mass))
    matrix[..., :d, :d] = translation
    offset = robot.mass_center
    inertia = robot.inertia_tensor
    if robot.planar:
        arm = center_arm(robot, pose)
        matrix[..., 2, 2] = inertia[..., 2, 2] + mass * (offset @ offset)
        matrix[..., 0, 2] = matrix[..., 2, 0] = -mass * arm[..., 1]
        matrix[..., 1, 2] = matrix[..., 2, 1] = mass * arm[..., 0]
        return matrix
    euler = pose[..., 3:]
    to_omega = kinematics.euler_rate_matrix(euler)
    if np.any(offset):
        rotation = kinematics.rotation_matrix(euler)
        coupling = -masses * rotation @ skew(offset) @ to_omega
        matrix[..., :3, 3:] = coupling
        matrix[..., 3:, :3] = coupling.mT
        inertia = _about_origin(inertia, masses, offset)
    matrix[..., 3:, 3:] = to_omega.mT @ inertia @ to_omega
    return matrix


def center_arm(robot: RobotArrays, pose: Array) -> Array:
    """R c in a plane, from the frame's origin to the centre of mass, shape (..., 2) [m]."""
    return kinematics.turned(pose, robot.mass_center[None])[..., 0, :]


def _about_origin(inertia: Array, mass: Array, offset: Array) -> Array:
    """Inertia about the frame's origin for a centre of mass at ``offset``: Steiner's theorem."""
    squares = (offset @ offset) * np.eye(3)
    moved: Array = inertia + mass * (squares - np.outer(offset, offset))
    return moved


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
    mass = mass[..., None]
    weight = mass * robot.gravity_vector
    vector[..., : robot.dimensions] = -weight
    if robot.point_mass:
        return vector
    offset = robot.mass_center
    is_offset = np.any(offset)
    if robot.planar:
        if is_offset:
            arm = center_arm(robot, pose)
            vector[..., :2] -= mass * velocity[..., 2:] ** 2 * arm
            vector[..., 2] = arm[..., 1] * weight[..., 0] - arm[..., 0] * weight[..., 1]
        return vector
    euler = pose[..., 3:]
    rates = velocity[..., 3:]
    inertia = robot.inertia_tensor
    if is_offset:
        inertia = _about_origin(inertia, mass[..., None], offset)
    to_omega = kinematics.euler_rate_matrix(euler)
    to_omega_rate = kinematics.euler_rate_matrix_rate(euler, rates)
    omega = times_vector(to_omega, rates)
    spin = times_vector(to_omega_rate, rates)
    gyroscopic = np.cross(omega, times_vector(inertia, omega))
    moment = times_vector(inertia, spin) + gyroscopic
    if is_offset:
        rotation = kinematics.rotation_matrix(euler)
        centripetal = np.cross(omega, np.cross(omega, offset)) + np.cross(spin, offset)
        vector[..., :3] += mass * times_vector(rotation, centripetal)
        weight_in_frame = times_vector(rotation.mT, weight)
        moment = moment - np.cross(offset, weight_in_frame)
    vector[..., 3:] = times_vector(to_omega.mT, moment)
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
    cable_speed = times_vector(jacobian(robot, pose), as_numbers(velocity))
    return -cable_speed / robot.pulley_radius


def pulley_angle(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Pulley angle β = −(q(X) − q(X₀))/r [rad], shape (..., m), of cables that do not stretch."""
    wound_up = cable_lengths(robot, robot.home) - cable_lengths(robot, pose)
    return wound_up / robot.pulley_radius


def pulley_acceleration(
    robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> Array:
    """Pulley acceleration β̈ = −(S Ẍ + Ṡ Ẋ)/r (Eq. 6) [rad/s²], shape (..., m)."""
    structure, rate = jacobian_and_rate(robot, pose, velocity)
    _, second = pulley_motion(robot, structure, rate, velocity, acceleration)
    return second


def pulley_motion(
    robot: RobotArrays, structure: Array, rate: Array, velocity: ArrayLike, acceleration: ArrayLike
) -> tuple[Array, Array]:
    """β̇ and β̈ from S and Ṡ, see :func:`pulley_speed` and :func:`pulley_acceleration`."""
    velocity = as_numbers(velocity)
    radius = robot.pulley_radius
    cable_speed = times_vector(structure, velocity)
    cable_acceleration = times_vector(structure, as_numbers(acceleration))
    cable_acceleration = cable_acceleration + times_vector(rate, velocity)
    return -cable_speed / radius, -cable_acceleration / radius


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
    cables = structure.shape[-2]
    best = np.zeros((*shape, cables))
    force_x, force_y = np.moveaxis(remaining, -1, 0)
    pulls = np.moveaxis(-structure, (-2, -1), (0, 1))  # on the platform, (m, 2, ...)
    for i, j in combinations(range(cables), 2):
        ax, ay = pulls[i]
        bx, by = pulls[j]
        determinant = ax * by - ay * bx
        with np.errstate(divide="ignore", invalid="ignore"):
            tension_i = (force_x * by - force_y * bx) / determinant
            tension_j = (ax * force_y - ay * force_x) / determinant
        # A force along one of the two cables gives a tiny negative value by rounding.
        slack = 1e-12 * (1 + np.abs(tension_i) + np.abs(tension_j))
        usable = (tension_i >= -slack) & (tension_j >= -slack)
        usable &= np.abs(determinant) > 1e-12  # the cables are not parallel
        pair_sum = tension_i + tension_j
        usable &= pair_sum < best_sum
        best_sum = np.where(usable, pair_sum, best_sum)
        pair = np.zeros_like(best)
        pair[..., i] = tension_i
        pair[..., j] = tension_j
        best = np.where(usable[..., None], pair, best)
    if strict and not np.all(np.isfinite(best_sum)):
        raise ValueError(
            "no positive tensions give this force: the pose is outside the polygon of the base anchors"
        )
    return minimum + np.maximum(best, 0.0)
