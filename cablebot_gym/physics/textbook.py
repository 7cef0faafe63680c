"""The equations of motion of the paper with its errata corrected, in batched numpy.

This module is the readable reference for control laws and for tests of the compiled kernel. The payload is a point mass
at the platform's centre of mass, so it does not change the rotational inertia. All functions have these arguments:

    robot: the robot, or N robots whose uncertain values have a leading axis N.
    mass: mass of the platform and its payload [kg], shape (...).
    pose: X = (x, y) or (x, y, z, ψ, θ, φ) [m, rad], shape (..., n).
    velocity, acceleration: Ẋ and Ẍ, shape (..., n).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array, as_numbers
from cablebot_gym.robots import Cable, Robot
from cablebot_gym.uncertainty import RobotArrays

MINIMUM_TENSION = 5.0
"""Default minimum tension T_min of planar robots [N], for control laws and for springs at rest. With 0 the cables
become slack at once in closed loop; a few newtons keep them taut."""

FRICTION_SPEED = 0.5
"""Motor speed ω₀ below which Coulomb friction is smoothed [rad/s]. The friction has 99 % of τ_c above 3.5 rad/s, which
is 0.18 m/s of cable on the paper's pulleys."""


def jacobian(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Structure Jacobian S = ∂q/∂X (Eq. 3), shape (..., m, n)."""
    return kinematics.structure_jacobian(robot.base, robot.platform, pose)


def jacobian_rate(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Ṡ, the time derivative of S along Ẋ, shape (..., m, n)."""
    return kinematics.structure_jacobian_rate(robot.base, robot.platform, pose, velocity)


def mass_matrix(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike) -> Array:
    """Mass matrix D(X) of Eq. 3, shape (..., n, n): ``blkdiag(m I₃, PᵀIP)``, or ``m I₂`` if planar."""
    pose = as_numbers(pose)
    mass = np.broadcast_to(as_numbers(mass), pose.shape[:-1])[..., None, None]
    if robot.planar:
        return mass * np.eye(2)
    matrix = np.zeros((*pose.shape[:-1], 6, 6), np.result_type(pose, mass))
    matrix[..., :3, :3] = mass * np.eye(3)
    to_omega = kinematics.euler_rate_matrix(pose[..., 3:])
    matrix[..., 3:, 3:] = np.swapaxes(to_omega, -1, -2) @ (np.asarray(robot.inertia)[..., None] * to_omega)
    return matrix


def bias(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """h(X, Ẋ) = C Ẋ + g of Eq. 3, shape (..., n): ``(0, 0, −m g, Pᵀ{I Ṗ Θ̇ + (PΘ̇) × I(PΘ̇)})``, or 0 if planar."""
    pose, velocity, mass = as_numbers(pose), as_numbers(velocity), as_numbers(mass)
    vector = np.zeros(np.broadcast_shapes(pose.shape, velocity.shape), np.result_type(pose, mass))
    if robot.planar:
        return vector
    inertia, rates = np.asarray(robot.inertia), velocity[..., 3:]
    to_omega = kinematics.euler_rate_matrix(pose[..., 3:])
    omega = _apply(to_omega, rates)
    moment = inertia * _apply(kinematics.euler_rate_matrix_rate(pose[..., 3:], rates), rates)
    moment = moment + np.cross(omega, inertia * omega)
    vector[..., 2] = -mass * robot.gravity
    vector[..., 3:] = _apply(np.swapaxes(to_omega, -1, -2), moment)
    return vector


def load(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
    """Required generalised force D Ẍ + h, which the cables apply as −SᵀT (Eqs. 3 and 16), shape (..., n)."""
    return _apply(mass_matrix(robot, mass, pose), as_numbers(acceleration)) + bias(robot, mass, pose, velocity)


def pulley_speed(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Pulley speed β̇ = −S Ẋ / r [rad/s], shape (..., m). It is positive when the cable winds up.

    With a rigid transmission it is the motor speed.
    """
    return -_apply(jacobian(robot, pose), as_numbers(velocity)) / robot.pulley_radius


def pulley_angle(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Pulley angle β = −(q(X) − q(X₀))/r [rad], shape (..., m)."""
    home = kinematics.cable_lengths(robot.base, robot.platform, robot.home)
    return (home - kinematics.cable_lengths(robot.base, robot.platform, pose)) / robot.pulley_radius


def static_torque(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, *, minimum: float = 0.0) -> Array:
    """Motor torque τ = r T at rest [N·m], shape (..., m). T and ``minimum`` are as in :func:`required_tensions`."""
    rest = np.zeros_like(np.asarray(pose, float))
    return robot.pulley_radius * required_tensions(robot, mass, pose, rest, rest, minimum=minimum, strict=False)


def static_motor_angle(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, *, minimum: float = 0.0) -> Array:
    """Motor angle β′ = β + r T/K of a flexible robot at rest [rad], shape (..., m).

    ``minimum`` is as in :func:`required_tensions`.
    """
    return pulley_angle(robot, pose) + static_torque(robot, mass, pose, minimum=minimum) / robot.stiffness


def highest_frequency(robot: RobotArrays) -> float:
    """Highest natural frequency of a flexible robot about its home pose with taut cables [rad/s].

    The linear system is ``blkdiag(D + Sᵀ(J/r²)S, J′) ẍ + BᵀKB x = 0`` for x = (X, β′), with the twist
    ``B x = β′ + S X/r`` of the springs.
    """
    structure = jacobian(robot, robot.home)
    turning = structure / robot.pulley_radius[:, None]
    m, n = structure.shape[-2:]
    pulleys = np.swapaxes(turning, -1, -2) @ (robot.pulley_inertia[..., None] * turning)
    home = np.broadcast_to(robot.home, (*structure.shape[:-2], n))
    inertia = np.zeros((*structure.shape[:-2], n + m, n + m))
    inertia[..., :n, :n] = mass_matrix(robot, robot.mass, home) + pulleys
    inertia[..., n:, n:] = robot.motor_inertia[..., None] * np.eye(m)
    twist = np.concatenate([turning, np.broadcast_to(np.eye(m), (*turning.shape[:-2], m, m))], axis=-1)
    stiffness = np.swapaxes(twist, -1, -2) @ (robot.stiffness[..., None] * twist)
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(inertia, stiffness)).real.max()))


def fastest_decay_rate(robot: RobotArrays) -> float:
    """Largest decay rate of the motor speeds by friction and along the torque-speed line, at home [1/s].

    The slope of the Coulomb friction is largest at standstill, τ_c/ω₀. In a flexible robot it slows a motor alone, in a
    rigid one the platform and all pulleys, with taut cables.
    """
    slope = robot.speed_slope + robot.coulomb_friction / FRICTION_SPEED
    if robot.flexible:
        return float(np.max((slope + robot.motor_damping) / robot.motor_inertia))
    turning = jacobian(robot, robot.home) / robot.pulley_radius[:, None]
    back = np.swapaxes(turning, -1, -2)
    home = np.broadcast_to(robot.home, (*turning.shape[:-2], robot.coordinates))
    inertia = mass_matrix(robot, robot.mass, home) + back @ (robot.pulley_inertia[..., None] * turning)
    resistance = back @ ((slope + robot.damping)[..., None] * turning)
    return float(np.linalg.eigvals(np.linalg.solve(inertia, resistance)).real.max())


def pulley_acceleration(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
    """Pulley acceleration β̈ = −(S Ẍ + Ṡ Ẋ)/r (Eq. 6) [rad/s²], shape (..., m)."""
    cable = _apply(jacobian(robot, pose), as_numbers(acceleration))
    cable = cable + _apply(jacobian_rate(robot, pose, velocity), as_numbers(velocity))
    return -cable / robot.pulley_radius


def required_tensions(
    robot: RobotArrays,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    *,
    minimum: float = 0.0,
    strict: bool = True,
) -> Array:
    """Tensions required for an acceleration, ``−Sᵀ T = D Ẍ + h`` (Eq. 16), shape (..., m) [N].

    Spatial: the unique solution, which may have either sign; ``minimum`` has no effect. Planar: the smallest tensions
    that are all at least ``minimum`` [N], see :func:`tension_distribution` (Eq. 11), also for ``strict``.
    """
    return inverse_dynamics(robot, mass, pose, velocity, acceleration, minimum=minimum, strict=strict).tensions


def tension_distribution(structure: Array, load: Array, minimum: float, *, strict: bool = True) -> Array:
    """Smallest tensions T with ``−Sᵀ T = load`` and ``T_i ≥ minimum`` for a planar ``structure`` S, shape (..., m, 2).

    All cables have at least the tension ``minimum``. Two cables balance the remaining force in addition: of all pairs
    with non-negative tensions, the pair with the smallest sum. For m = 3 this is ``T = T_p + α N`` (Eq. 11)
    with the smallest α, which minimises all tensions at the same time.

    Outside the polygon of the base anchors the cables cannot apply some forces. Without ``strict`` the result for such
    a force is ``minimum`` in all cables, so that a control law can continue.

    Raises:
        ValueError: if ``strict`` and no pair of cables can apply the force.
    """
    rest = load + minimum * structure.sum(axis=-2)
    shape = np.broadcast_shapes(structure.shape[:-2], load.shape[:-1])
    best_sum = np.full(shape, np.inf)
    best = np.zeros((*shape, structure.shape[-2]))
    for i, j in combinations(range(structure.shape[-2]), 2):
        (ax, ay), (bx, by) = (np.moveaxis(-structure[..., k, :], -1, 0) for k in (i, j))
        determinant = ax * by - ay * bx
        with np.errstate(divide="ignore", invalid="ignore"):
            first = (rest[..., 0] * by - rest[..., 1] * bx) / determinant
            second = (ax * rest[..., 1] - ay * rest[..., 0]) / determinant
        # A force along one of the two cables gives a tiny negative value by rounding.
        slack = 1e-12 * (1 + np.abs(first) + np.abs(second))
        usable = (first >= -slack) & (second >= -slack) & (first + second < best_sum) & (np.abs(determinant) > 1e-12)
        best_sum = np.where(usable, first + second, best_sum)
        pair = np.zeros_like(best)
        pair[..., i], pair[..., j] = first, second
        best = np.where(usable[..., None], pair, best)
    if strict and not np.all(np.isfinite(best_sum)):
        raise ValueError("no positive tensions give this force: the pose is outside the polygon of the base anchors")
    return minimum + np.maximum(best, 0.0)


def smooth_tension_distribution(structure: Array, least: Array, minimum: float, softness: float) -> Array:
    """Smooth tensions of three planar cables; those of :func:`tension_distribution` have kinks.

    Let N > 0 be the null vector of Sᵀ with sum 1. ``T + α N`` balances the same force for all α. Let α_i be the value
    that lifts cable i to the minimum tension. The largest α_i gives the smallest tensions. This function uses
    ``softness · log Σ exp(α_i/softness)`` instead. No tension is below the minimum. The sum of the tensions exceeds the
    smallest sum by at most ``softness · log 3``.

    Args:
        structure: S, shape (..., 3, 2).
        least: the smallest tensions T, shape (..., 3) [N].
        minimum: minimum tension [N].
        softness: smoothing of α [N]; > 0.
    """
    (ax, ay), (bx, by), (cx, cy) = (np.moveaxis(structure[..., k, :], -1, 0) for k in range(3))
    null = np.stack([bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay], axis=-1)
    null = null / null.sum(axis=-1, keepdims=True)
    more = softness * np.log(np.exp((minimum - least) / null / softness).sum(axis=-1, keepdims=True))
    soft: Array = least + more * null
    return soft


def required_torques(
    robot: Robot,
    tensions: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
) -> Array:
    """Motor torques ``τ = r T + J β̈ + c β̇`` (Eq. 1) of a rigid transmission for tensions T, shape (..., m) [N·m].

    They include :func:`coulomb_torque`. Of a flexible robot they are the torques of the springs, without it.
    """
    structure, rate = kinematics.jacobian_and_rate(robot.base, robot.platform, pose, velocity)
    return _torques(robot, tensions, *_pulley_motion(robot, structure, rate, velocity, acceleration))


def _pulley_motion(
    robot: RobotArrays, structure: Array, rate: Array, velocity: ArrayLike, acceleration: ArrayLike
) -> tuple[Array, Array]:
    """β̇ and β̈ from S and Ṡ, see :func:`pulley_speed` and :func:`pulley_acceleration`."""
    velocity = as_numbers(velocity)
    speed = -_apply(structure, velocity) / robot.pulley_radius
    return speed, -(_apply(structure, as_numbers(acceleration)) + _apply(rate, velocity)) / robot.pulley_radius


def _torques(robot: RobotArrays, tensions: ArrayLike, speed: Array, acceleration: Array) -> Array:
    torque: Array = robot.pulley_radius * as_numbers(tensions)
    torque = torque + robot.pulley_inertia * acceleration + robot.damping * speed
    return torque if robot.flexible else torque + coulomb_torque(robot, speed)


def coulomb_torque(robot: RobotArrays, speed: ArrayLike) -> Array:
    """Torque τ_c ω/√(ω² + ω₀²) that Coulomb friction takes from the motors at speeds ω (..., m) [N·m].

    ω₀ is :data:`FRICTION_SPEED`: the friction is smooth, and there is no stiction.
    """
    speed = as_numbers(speed)
    torque: Array = robot.coulomb_friction * speed / np.sqrt(speed**2 + FRICTION_SPEED**2)
    return torque


def motor_friction(robot: RobotArrays, speed: ArrayLike) -> Array:
    """Friction c′ β̇′ of Eq. 4 and :func:`coulomb_torque` of a flexible robot at motor speeds (..., m) [N·m]."""
    friction: Array = robot.motor_damping * as_numbers(speed) + coulomb_torque(robot, speed)
    return friction


@dataclass(frozen=True, kw_only=True, eq=False)
class InverseDynamics:
    """Cable tensions, motor torques and pulley motion that a motion requires; each array has shape (..., m)."""

    tensions: Array
    """Tensions T [N], see :func:`required_tensions`."""
    torques: Array
    """Motor torques τ [N·m], see :func:`required_torques`."""
    speeds: Array
    """Pulley speeds β̇ [rad/s], see :func:`pulley_speed`."""
    pulley_accelerations: Array
    """Pulley accelerations β̈ [rad/s²], see :func:`pulley_acceleration`."""


def inverse_dynamics(
    robot: RobotArrays,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    *,
    minimum: float = 0.0,
    strict: bool = True,
) -> InverseDynamics:
    """Tensions, torques and pulley motion for a motion. The arguments are as in :func:`required_tensions`."""
    pose, velocity, acceleration = (np.asarray(array, float) for array in (pose, velocity, acceleration))
    structure, rate = kinematics.jacobian_and_rate(robot.base, robot.platform, pose, velocity)
    speed, second = _pulley_motion(robot, structure, rate, velocity, acceleration)
    wrench = load(robot, mass, pose, velocity, acceleration)
    if robot.planar:
        tensions = tension_distribution(structure, wrench, minimum, strict=strict)
    else:
        tensions = -np.linalg.solve(np.swapaxes(structure, -1, -2), wrench[..., None])[..., 0]
    torques = _torques(robot, tensions, speed, second)
    return InverseDynamics(tensions=tensions, torques=torques, speeds=speed, pulley_accelerations=second)


def torque_limits(robot: Robot, speed: ArrayLike) -> tuple[Array, Array]:
    """Torque limits ``U⁻`` and ``U⁺`` (Eq. 37) at motor speeds (..., m) [rad/s], each (..., m) [N·m]."""
    drop = robot.speed_slope * as_numbers(speed)
    return -robot.stall_torque - drop, robot.stall_torque - drop


def normalised_action(robot: RobotArrays, torques: ArrayLike, speed: ArrayLike) -> Array:
    """Action a = (τ + (τ_s/ω_n) speed)/τ_s for torques [N·m] at motor speeds [rad/s], each (..., m)."""
    action: Array = (as_numbers(torques) + robot.speed_slope * as_numbers(speed)) / robot.stall_torque
    return action


def forward_dynamics(
    robot: Robot,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    torques: ArrayLike,
    *,
    cable: Cable = "unilateral",
) -> tuple[Array, Array]:
    """Accelerations Ẍ (..., n) and tensions T (..., m) for motor torques and a rigid transmission.

    Coulomb friction takes its torque from the motors; of a flexible robot, pass the torques of the springs.
    Bilateral cables may push: ``(D + Sᵀ(J/r²)S) Ẍ = −h − Sᵀ(τ/r + (J/r²) Ṡ Ẋ + (c/r²) S Ẋ)``. Unilateral cables obey
    ``0 ≤ T ⟂ u ≥ 0`` with the take-up torque u. The function tries all sets of taut cables until all tensions of the
    taut cables and all take-up torques of the slack cables are positive. This set is unique. The search is slow but
    exhaustive.
    """
    pose, velocity, torques = (np.asarray(array, float) for array in (pose, velocity, torques))
    if not robot.flexible:
        torques = torques - coulomb_torque(robot, pulley_speed(robot, pose, velocity))
    structure, inertia = jacobian(robot, pose), robot.pulley_inertia / robot.pulley_radius**2
    cable_bias = _apply(jacobian_rate(robot, pose, velocity), velocity)
    damping = robot.damping / robot.pulley_radius**2 * _apply(structure, velocity)
    driving_force = torques / robot.pulley_radius + inertia * cable_bias + damping
    matrix, vector = mass_matrix(robot, mass, pose), bias(robot, mass, pose, velocity)

    def solve(taut: Array) -> tuple[Array, Array]:
        weighted = np.swapaxes(structure, -1, -2) * taut
        left = matrix + weighted @ (inertia[:, None] * structure)
        acceleration = np.linalg.solve(left, -(vector + _apply(weighted, driving_force))[..., None])[..., 0]
        return acceleration, driving_force + inertia * _apply(structure, acceleration)

    acceleration, tension = solve(np.ones(robot.cables))
    if cable == "bilateral":
        return acceleration, tension
    settled = np.all(tension >= 0, axis=-1)
    result, pulled = acceleration.copy(), np.where(settled[..., None], tension, 0.0)
    for taut in product((1.0, 0.0), repeat=robot.cables):
        if np.all(settled):
            break
        acceleration, tension = solve(np.array(taut))
        consistent = np.all(np.where(np.array(taut) > 0, tension >= 0, tension <= 0), axis=-1) & ~settled
        result[consistent], pulled[consistent] = acceleration[consistent], (tension * taut)[consistent]
        settled |= consistent
    return result, pulled


def _apply(matrix: Array, vector: Array) -> Array:
    """Batched matrix times vector."""
    applied: Array = (matrix @ vector[..., None])[..., 0]
    return applied
