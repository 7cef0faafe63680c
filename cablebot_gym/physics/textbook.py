"""The equations of motion as the paper writes them (errata corrected), in batched numpy.

This is the form to read, to write control laws from, and to test the compiled kernel against. Every function takes
poses X and velocities Ẋ of shape (..., n), and ``mass``, platform plus payload [kg], of shape (...). The payload sits
at the platform's centre of mass and leaves the rotational inertia alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array, as_numbers
from cablebot_gym.robots import Cable, Robot, RobotArrays

MINIMUM_TENSION = 5.0
"""Default T_min of planar robots [N], in laws and in springs wound at rest. At 0 the cables slacken at once in closed
loop; a few newtons keep them taut."""


def jacobian(robot: RobotArrays, pose: ArrayLike) -> Array:
    """S = ∂q/∂X (Eq. 3), shape (..., m, n)."""
    return kinematics.structure_jacobian(robot.base, robot.platform, pose)


def jacobian_rate(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Ṡ along Ẋ, shape (..., m, n)."""
    return kinematics.structure_jacobian_rate(robot.base, robot.platform, pose, velocity)


def mass_matrix(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike) -> Array:
    """D(X) of Eq. 3, shape (..., n, n): ``blkdiag(m I₃, PᵀIP)``; planar ``m I₂``."""
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
    """h(X, Ẋ) = C Ẋ + g of Eq. 3, shape (..., n): ``(0, 0, −m g, Pᵀ{I Ṗ Θ̇ + (PΘ̇) × I(PΘ̇)})``; planar 0."""
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
    """D Ẍ + h, what the cables' −SᵀT has to give (Eqs. 3 and 16), shape (..., n)."""
    return _apply(mass_matrix(robot, mass, pose), as_numbers(acceleration)) + bias(robot, mass, pose, velocity)


def pulley_speed(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """β̇ = −S Ẋ / r [rad/s], shape (..., m); winding is positive. With a rigid transmission, the motor speed."""
    return -_apply(jacobian(robot, pose), as_numbers(velocity)) / robot.pulley_radius


def pulley_angle(robot: RobotArrays, pose: ArrayLike) -> Array:
    """β = −(q(X) − q(X₀))/r [rad], shape (..., m)."""
    home = kinematics.cable_lengths(robot.base, robot.platform, robot.home)
    return (home - kinematics.cable_lengths(robot.base, robot.platform, pose)) / robot.pulley_radius


def static_torque(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, *, minimum: float = 0.0) -> Array:
    """τ = r T at rest [N·m], shape (..., m), T as :func:`required_tensions` at rest, ``minimum`` too."""
    rest = np.zeros_like(np.asarray(pose, float))
    return robot.pulley_radius * required_tensions(robot, mass, pose, rest, rest, minimum=minimum, strict=False)


def static_motor_angle(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, *, minimum: float = 0.0) -> Array:
    """β′ = β + r T/K of a flexible robot at rest [rad], shape (..., m); ``minimum`` as in :func:`required_tensions`."""
    return pulley_angle(robot, pose) + static_torque(robot, mass, pose, minimum=minimum) / robot.stiffness


def highest_frequency(robot: RobotArrays) -> float:
    """Highest natural frequency of a flexible robot about its home pose, cables taut [rad/s].

    Of ``blkdiag(D + Sᵀ(J/r²)S, J′) ẍ + K-terms x = 0`` in x = (X, β′), with twist ``β′ + S X/r``.
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


def fastest_motor_rate(robot: RobotArrays) -> float:
    """Largest rate at which a flexible robot's motors settle by friction or along their torque-speed line [1/s]."""
    line = np.sqrt(2) * robot.speed_slope  # held for a physics step, and so less stable than friction
    return float(np.max(np.maximum(robot.motor_damping, line) / robot.motor_inertia))


def pulley_acceleration(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
    """β̈ = −(S Ẍ + Ṡ Ẋ)/r (Eq. 6) [rad/s²], shape (..., m)."""
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
    """Tensions that give the acceleration: ``−Sᵀ T = D Ẍ + h`` (Eq. 16), shape (..., m) [N].

    Spatial: the only solution, of either sign; ``minimum`` has no effect. Planar: the least tensions that are all at
    least ``minimum`` [N], see :func:`least_tensions` (Eq. 11); ``strict`` as there.
    """
    pose = np.asarray(pose, float)
    return _tensions(robot, mass, pose, velocity, acceleration, jacobian(robot, pose), minimum, strict)


def _tensions(
    robot: RobotArrays,
    mass: ArrayLike,
    pose: Array,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    structure: Array,
    minimum: float,
    strict: bool,
) -> Array:
    wrench = load(robot, mass, pose, velocity, acceleration)
    if robot.planar:
        return least_tensions(structure, wrench, minimum, strict=strict)
    return -np.linalg.solve(np.swapaxes(structure, -1, -2), wrench[..., None])[..., 0]


def least_tensions(structure: Array, load: Array, minimum: float, *, strict: bool = True) -> Array:
    """The least T with ``−Sᵀ T = load`` and every ``T_i ≥ minimum``, for a planar ``structure`` S, shape (..., m, 2).

    ``minimum`` in all cables, plus the two neighbouring cables between which the remaining force points: of all pairs
    of non-negative tensions that balance it, the one with the smallest sum. With m = 3 this is the paper's
    ``T = T_p + α N`` (Eq. 11) with the least α, which minimises every tension at once.

    Outside the polygon of the base anchors some forces cannot be given. Without ``strict``, ``minimum`` in all cables
    stands for them: a control law has to go on.

    Raises:
        ValueError: if ``strict`` and no pair of cables can pull in the direction asked for.
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
        # The slightest negative value is rounding, of a force along one of the two cables.
        slack = 1e-12 * (1 + np.abs(first) + np.abs(second))
        usable = (first >= -slack) & (second >= -slack) & (first + second < best_sum) & (np.abs(determinant) > 1e-12)
        best_sum = np.where(usable, first + second, best_sum)
        pair = np.zeros_like(best)
        pair[..., i], pair[..., j] = first, second
        best = np.where(usable[..., None], pair, best)
    if strict and not np.all(np.isfinite(best_sum)):
        raise ValueError("no positive tensions give this force: the pose lies outside the polygon of the base anchors")
    return minimum + np.maximum(best, 0.0)


def soft_tensions(structure: Array, least: Array, minimum: float, softness: float) -> Array:
    """Tensions of three planar cables that pass smoothly where the least ones of :func:`least_tensions` have a kink.

    With the null vector N > 0 of Sᵀ whose sum is 1, ``T + α N`` balances the same force; of the α that lift one cable
    each to the minimum, the largest makes the least tensions, and ``softness · log Σ exp(α_i/softness)`` these.
    None is below the minimum, and where two cables compete, their sum is at most ``softness · log 3`` more.

    Args:
        structure: S, (..., 3, 2).
        least: T, (..., 3) [N].
        minimum: of the least tensions [N].
        softness: of α [N], greater than 0.
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
    """Motor torques ``τ = r T + J β̈ + c β̇`` (Eq. 1) of a rigid transmission with tensions T, shape (..., m) [N·m]."""
    structure, rate = kinematics.jacobian_and_rate(robot.base, robot.platform, pose, velocity)
    return _torques(robot, tensions, *_winding(robot, structure, rate, velocity, acceleration))


def _winding(
    robot: Robot, structure: Array, rate: Array, velocity: ArrayLike, acceleration: ArrayLike
) -> tuple[Array, Array]:
    """β̇ and β̈, see :func:`pulley_speed` and :func:`pulley_acceleration`, for S and Ṡ that are at hand."""
    velocity = as_numbers(velocity)
    speed = -_apply(structure, velocity) / robot.pulley_radius
    return speed, -(_apply(structure, as_numbers(acceleration)) + _apply(rate, velocity)) / robot.pulley_radius


def _torques(robot: Robot, tensions: ArrayLike, speed: Array, acceleration: Array) -> Array:
    torque: Array = robot.pulley_radius * as_numbers(tensions)
    return torque + robot.pulley_inertia * acceleration + robot.damping * speed


@dataclass(frozen=True, kw_only=True, eq=False)
class InverseDynamics:
    """What a motion asks of cables and motors; each array has shape (..., m)."""

    tensions: Array
    """T [N], see :func:`required_tensions`."""
    torques: Array
    """τ [N·m], see :func:`required_torques`."""
    speeds: Array
    """β̇ [rad/s], see :func:`pulley_speed`."""
    windings: Array
    """β̈ [rad/s²], see :func:`pulley_acceleration`."""


def inverse_dynamics(
    robot: Robot,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    *,
    minimum: float = 0.0,
    strict: bool = True,
) -> InverseDynamics:
    """Tensions, torques, speeds and windings of a motion at once; arguments as for :func:`required_tensions`."""
    pose, velocity, acceleration = (np.asarray(array, float) for array in (pose, velocity, acceleration))
    structure, rate = kinematics.jacobian_and_rate(robot.base, robot.platform, pose, velocity)
    speed, winding = _winding(robot, structure, rate, velocity, acceleration)
    tensions = _tensions(robot, mass, pose, velocity, acceleration, structure, minimum, strict)
    torques = _torques(robot, tensions, speed, winding)
    return InverseDynamics(tensions=tensions, torques=torques, speeds=speed, windings=winding)


def torque_limits(robot: Robot, speed: ArrayLike) -> tuple[Array, Array]:
    """``U⁻`` and ``U⁺`` (Eq. 37) at motor speeds of shape (..., m) [rad/s], each (..., m) [N·m]."""
    drop = robot.speed_slope * as_numbers(speed)
    return -robot.stall_torque - drop, robot.stall_torque - drop


def drive_command(robot: RobotArrays, torques: ArrayLike, speed: ArrayLike) -> Array:
    """a = (τ + (τ_s/ω_n) speed)/τ_s, which asks for torques [N·m] at motor speeds [rad/s], each (..., m)."""
    command: Array = (as_numbers(torques) + robot.speed_slope * as_numbers(speed)) / robot.stall_torque
    return command


def forward_dynamics(
    robot: Robot,
    mass: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    torques: ArrayLike,
    *,
    cable: Cable = "unilateral",
) -> tuple[Array, Array]:
    """Accelerations Ẍ (..., n) and tensions T (..., m) under motor torques, rigid transmission.

    Bilateral cables may push: ``(D + Sᵀ(J/r²)S) Ẍ = −h − Sᵀ(τ/r + (J/r²) Ṡ Ẋ + (c/r²) S Ẋ)``. Unilateral cables obey
    ``0 ≤ T ⟂ u ≥ 0`` with the take-up torque u; here every set of taut cables is tried until the one is found whose
    taut tensions and slack take-ups are all positive (it is unique). Slow, and without a doubt.
    """
    pose, velocity, torques = (np.asarray(array, float) for array in (pose, velocity, torques))
    structure, inertia = jacobian(robot, pose), robot.pulley_inertia / robot.pulley_radius**2
    cable_bias = _apply(jacobian_rate(robot, pose, velocity), velocity)
    damping = robot.damping / robot.pulley_radius**2 * _apply(structure, velocity)
    drive = torques / robot.pulley_radius + inertia * cable_bias + damping
    matrix, vector = mass_matrix(robot, mass, pose), bias(robot, mass, pose, velocity)

    def solve(taut: Array) -> tuple[Array, Array]:
        weighted = np.swapaxes(structure, -1, -2) * taut
        left = matrix + weighted @ (inertia[:, None] * structure)
        acceleration = np.linalg.solve(left, -(vector + _apply(weighted, drive))[..., None])[..., 0]
        return acceleration, drive + inertia * _apply(structure, acceleration)

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
