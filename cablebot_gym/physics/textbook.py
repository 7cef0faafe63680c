"""The equations of motion of the paper with its errata corrected, in batched numpy.

This module is the readable reference for control laws and for tests of the compiled kernel. The
payload is a point mass at the platform's centre of mass, so it does not change the inertia about
it. All functions have these arguments:

    robot: the robot, or N robots whose uncertain values have a leading axis N.
    mass: mass of the platform and its payload [kg], shape (...).
    pose: X = (x, y), (x, y, φ), (x, y, z) or (x, y, z, ψ, θ, φ) [m, rad], shape (..., n).
    velocity, acceleration: Ẋ and Ẍ, shape (..., n).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array, as_numbers
from cablebot_gym.physics.distribution import HELD, unchecked_least_largest_action
from cablebot_gym.robots import Cable, Robot
from cablebot_gym.uncertainty import RobotArrays

MINIMUM_TENSION = 5.0
"""Default minimum tension T_min of planar robots [N], for control laws and for springs at rest.
With 0 the cables become slack at once in closed loop; a few newtons keep them taut."""

TENSION_RESERVE = 1.2
"""Least tension that laws allocate, as a multiple of the robot's own ``minimum_tension``, if that
is more."""

FRICTION_SPEED = 0.5
"""Motor speed ω₀ below which Coulomb friction is smoothed [rad/s]. The friction has 99 % of τ_c
above 3.5 rad/s, which is 0.18 m/s of cable on the paper's pulleys."""


def allocated_minimum(
    robot: Robot, usual: float = MINIMUM_TENSION, reserve: float = TENSION_RESERVE
) -> float:
    """Least tension that laws allocate, and that the springs have at rest [N]: ``usual``, or more
    for heavy cables."""
    return max(usual, reserve * robot.minimum_tension)


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
    mass = np.broadcast_to(as_numbers(mass), pose.shape[:-1])[..., None, None]
    d, n = robot.dimensions, robot.coordinates
    if robot.point_mass:
        return mass * np.eye(d)
    matrix = np.zeros((*pose.shape[:-1], n, n), np.result_type(pose, mass))
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
        coupling = (
            -mass * kinematics.rotation_matrix(pose[..., 3:]) @ _cross_matrix(offset) @ to_omega
        )
        matrix[..., :3, 3:], matrix[..., 3:, :3] = coupling, np.swapaxes(coupling, -1, -2)
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
    vector = np.zeros(
        np.broadcast_shapes(pose.shape, velocity.shape), np.result_type(pose, mass, velocity)
    )
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
    omega = _apply(to_omega, rates)
    spin = _apply(kinematics.euler_rate_matrix_rate(pose[..., 3:], rates), rates)
    if np.any(offset):
        inertia = _about_origin(
            inertia, np.broadcast_to(mass, pose.shape[:-1])[..., None, None], offset
        )
    moment = _apply(inertia, spin) + np.cross(omega, _apply(inertia, omega))
    if np.any(offset):
        rotation = kinematics.rotation_matrix(pose[..., 3:])
        centripetal = np.cross(omega, np.cross(omega, offset)) + np.cross(spin, offset)
        vector[..., :3] += mass[..., None] * _apply(rotation, centripetal)
        moment = moment - np.cross(offset, _apply(np.swapaxes(rotation, -1, -2), weight))
    vector[..., 3:] = _apply(np.swapaxes(to_omega, -1, -2), moment)
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
    return _apply(mass_matrix(robot, mass, pose), as_numbers(acceleration)) + bias(
        robot, mass, pose, velocity
    )


def pulley_speed(robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike) -> Array:
    """Pulley speed β̇ = −S Ẋ / r [rad/s], shape (..., m). It is positive when the cable winds up.

    With a rigid transmission it is the motor speed.
    """
    return -_apply(jacobian(robot, pose), as_numbers(velocity)) / robot.pulley_radius


def pulley_angle(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Pulley angle β = −(q(X) − q(X₀))/r [rad], shape (..., m), of cables that do not stretch."""
    return (cable_lengths(robot, robot.home) - cable_lengths(robot, pose)) / robot.pulley_radius


def cable_lengths(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Cable lengths q(X) between base anchor and platform anchor [m], shape (..., m)."""
    return kinematics.cable_lengths(robot.base, robot.platform, pose, robot.swivel)


def static_torque(
    robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, *, minimum: float = 0.0
) -> Array:
    """Torque r T at rest [N·m], shape (..., m). T and ``minimum`` are as in
    :func:`required_tensions`.

    With elastic cables :func:`holding_torque` of it is the motor torque.
    """
    rest = np.zeros_like(np.asarray(pose, float))
    return robot.pulley_radius * required_tensions(
        robot, mass, pose, rest, rest, minimum=minimum, strict=False
    )


def holding_torque(robot: RobotArrays, torque: Array) -> Array:
    """Motor torque at rest for a torque r T, (..., m): r T (1 + ε/2) with elastic cables of strain
    ε = T/EA."""
    return (
        torque * (1 + torque / robot.pulley_radius / robot.axial_stiffness / 2)
        if robot.elastic
        else torque
    )


def stretched_torque(robot: RobotArrays, torque: Array) -> Array:
    """Torque r T for a torque K δ with the stiffness K of :func:`joint_stiffness` and the
    deflection δ, (..., m).

    It is K δ (1 + ε) with elastic cables of strain ε = T/EA, because their free length is less than
    their length.
    """
    return (
        torque / (1 - torque / robot.pulley_radius / robot.axial_stiffness)
        if robot.elastic
        else torque
    )


def rest_angles(robot: RobotArrays, tensions: ArrayLike, pose: ArrayLike) -> tuple[Array, Array]:
    """Motor angle β′ and pulley angle β of a robot at rest with tensions T (..., m), each (..., m)
    [rad].

    Elastic cables have the free length l = (q + extra_length)/(1 + T/EA). Without joint springs
    both angles are equal.
    """
    tensions = as_numbers(tensions)
    pulley = pulley_angle(robot, pose)
    torque = robot.pulley_radius * tensions
    if robot.elastic:
        strain = tensions / robot.axial_stiffness
        stretched = (cable_lengths(robot, pose) + robot.extra_length) * strain / (1 + strain)
        pulley = pulley + stretched / robot.pulley_radius
        torque = holding_torque(robot, torque)
    return (pulley + torque / robot.stiffness if robot.jointed else pulley), pulley


def static_motor_angle(
    robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, *, minimum: float = 0.0
) -> Array:
    """Motor angle β′ of a flexible robot at rest [rad], shape (..., m), see :func:`rest_angles`.

    ``minimum`` is as in :func:`required_tensions`.
    """
    return rest_angles(
        robot, static_torque(robot, mass, pose, minimum=minimum) / robot.pulley_radius, pose
    )[0]


def joint_stiffness(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Stiffness at the pulleys between motor and platform, of joint spring and cable in series,
    (..., m) [N·m/rad]."""
    if not robot.elastic:
        return robot.stiffness
    length = cable_lengths(robot, pose) + robot.extra_length
    cable: Array = robot.pulley_radius**2 * robot.axial_stiffness / length
    return 1 / (1 / cable + 1 / robot.stiffness) if robot.jointed else cable


def joint_equivalent(robot: Robot) -> Robot:
    """The robot with joint springs in place of its elastic cables, for control laws; itself if they
    do not stretch.

    The springs have the stiffness at the home pose. Without joint springs the pulley becomes the
    motor; otherwise it stays on the side of the stiffer spring. The damping of the cables is left
    out.
    """
    if not robot.elastic:
        return robot
    given = robot.transmission
    stiffness = joint_stiffness(robot, robot.home)
    rigid = {
        "axial_stiffness": None,
        "axial_damping": 0.0,
        "extra_length": 0.0,
        "stiffness": stiffness,
    }
    if not robot.jointed:
        sides = {"motor_inertia": robot.pulley_inertia, "motor_damping": robot.damping}
        return robot.replace(
            transmission=given.replace(**rigid, **sides, pulley_inertia=0.0, damping=0.0)
        )
    at_motor = robot.stiffness > 2 * stiffness  # the cable is the softer spring
    sides = {
        "motor_inertia": robot.motor_inertia + np.where(at_motor, robot.pulley_inertia, 0.0),
        "motor_damping": robot.motor_damping + np.where(at_motor, robot.damping, 0.0),
        "pulley_inertia": np.where(at_motor, 0.0, robot.pulley_inertia),
        "damping": np.where(at_motor, 0.0, robot.damping),
    }
    return robot.replace(transmission=given.replace(**rigid, **sides))


def cable_springs(
    robot: RobotArrays,
    pose: ArrayLike,
    velocity: ArrayLike,
    angle: ArrayLike,
    speed: ArrayLike,
    *,
    cable: Cable = "unilateral",
) -> tuple[Array, Array]:
    """Tensions T of elastic cables and their torques on the pulleys, each (..., m).

    ``T = EA ε + ηA (q̇ + r β̇)/l`` with the strain ε = (q + extra_length − l)/l and the free length
    l = q(X₀) + extra_length − r β. The torque is ``r (T + ½ EA ε²)``. Unilateral cables are slack
    for ε ≤ 0, and do not push.

    Args:
        robot: robot with elastic cables.
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
        angle: pulley angle β, shape (..., m) [rad].
        speed: pulley speed β̇, shape (..., m) [rad/s].
        cable: ``unilateral`` cables can only pull.
    """
    radius = robot.pulley_radius
    free = cable_lengths(robot, robot.home) + robot.extra_length - radius * as_numbers(angle)
    strain = (cable_lengths(robot, pose) + robot.extra_length) / free - 1
    rate = (_apply(jacobian(robot, pose), as_numbers(velocity)) + radius * as_numbers(speed)) / free
    tension = robot.axial_stiffness * strain + robot.axial_damping * rate
    wound = radius * robot.axial_stiffness * strain**2 / 2
    if cable == "unilateral":
        tension = np.where(strain > 0, np.maximum(tension, 0.0), 0.0)
        wound = np.where(strain > 0, wound, 0.0)
    return tension, radius * tension + wound


@lru_cache(maxsize=16)
def cable_equivalent(robot: Robot) -> Robot:
    """The robot with longer elastic cables in place of joint springs in series with them; itself
    without both.

    A cable of the length EA r²/K has the stiffness of the joint spring. The pulley turns with the
    motor.
    """
    if not (robot.elastic and robot.jointed):
        return robot
    length = robot.extra_length + robot.axial_stiffness * robot.pulley_radius**2 / robot.stiffness
    sides = {
        "pulley_inertia": robot.pulley_inertia + robot.motor_inertia,
        "damping": robot.damping + robot.motor_damping,
        "motor_inertia": None,
        "motor_damping": 0.0,
    }
    return robot.replace(
        transmission=robot.transmission.replace(stiffness=None, extra_length=length, **sides)
    )


def spring_drive(
    robot: RobotArrays,
    pose: ArrayLike,
    velocity: ArrayLike,
    angle: ArrayLike,
    speed: ArrayLike,
    acceleration: ArrayLike,
) -> tuple[Array, Array]:
    """Motor torques of a flexible robot [N·m] and forces of its springs without damping [N], each
    (..., m).

    The springs are joint springs or elastic cables, not both. They also push.

    Args:
        robot: flexible robot.
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
        angle: motor angle β′, shape (..., m) [rad].
        speed: motor speed β̇′, shape (..., m) [rad/s].
        acceleration: motor acceleration β̈′, shape (..., m) [rad/s²].
    """
    if robot.jointed:
        torque = robot.stiffness * (as_numbers(angle) - pulley_angle(robot, pose))
        moved = (
            torque + robot.motor_inertia * as_numbers(acceleration) + motor_friction(robot, speed)
        )
        return moved, torque / robot.pulley_radius
    _, torque = cable_springs(robot, pose, velocity, angle, speed, cable="bilateral")
    moved = (
        torque + robot.pulley_inertia * as_numbers(acceleration) + robot.damping * as_numbers(speed)
    )
    still, _ = cable_springs(
        robot, pose, 0 * as_numbers(velocity), angle, 0 * as_numbers(speed), cable="bilateral"
    )
    return moved + coulomb_torque(robot, speed), still


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearModel:
    """Matrices of ``M ẍ + C ẋ + K x = 0`` about the home pose with taut cables.

    x = (X, β, β′), without β if the cables do not stretch and without β′ if there are no joint
    springs.
    """

    inertia: Array
    """M, shape (..., k, k)."""
    damping: Array
    """C, shape (..., k, k): friction of motors and pulleys, slope of the torque-speed lines,
    damping of the cables."""
    stiffness: Array
    """K, shape (..., k, k)."""


def linear_model(robot: RobotArrays) -> LinearModel:
    """Linear model of a robot about its home pose, without the stiffness that the cable tensions
    add."""
    structure = jacobian(robot, robot.home)
    m = robot.cables
    n = robot.coordinates
    batch, one = structure.shape[:-2], np.eye(m)
    size = n + m * (robot.elastic + robot.jointed)
    home = np.broadcast_to(robot.home, (*batch, n))
    inertia = np.zeros((*batch, size, size))
    damping = np.zeros_like(inertia)
    stiffness = np.zeros_like(inertia)
    inertia[..., :n, :n] = mass_matrix(robot, robot.mass, home)

    def add(matrix: Array, weight: Array, *parts: tuple[int, Array]) -> None:
        """Adds BᵀWB for B with the given blocks of columns."""
        rows = np.zeros((*batch, m, size))
        for start, block in parts:
            rows[..., start : start + block.shape[-1]] = block
        matrix += np.swapaxes(rows, -1, -2) @ (
            np.broadcast_to(weight, (*batch, m))[..., None] * rows
        )

    pulley = (n, one) if robot.elastic else (0, -structure / robot.pulley_radius[..., None])
    motor = (size - m, one) if robot.jointed else pulley
    add(inertia, robot.pulley_inertia, pulley)
    add(damping, robot.damping, pulley)
    add(damping, robot.speed_slope + robot.coulomb_friction / FRICTION_SPEED, motor)
    if robot.elastic:
        length = cable_lengths(robot, robot.home) + robot.extra_length
        stretch = (0, structure), (n, robot.pulley_radius[..., None] * one)
        add(stiffness, robot.axial_stiffness / length, *stretch)
        add(damping, robot.axial_damping / length, *stretch)
    if robot.jointed:
        twist = motor, (pulley[0], -pulley[1])
        add(inertia, robot.motor_inertia, motor)
        add(damping, robot.motor_damping, motor)
        add(stiffness, robot.stiffness, *twist)
    return LinearModel(inertia=inertia, damping=damping, stiffness=stiffness)


def highest_frequency(robot: RobotArrays) -> float:
    """Highest natural frequency of a flexible robot about its home pose with taut cables
    [rad/s]."""
    model = linear_model(robot)
    return float(
        np.sqrt(np.linalg.eigvals(np.linalg.solve(model.inertia, model.stiffness)).real.max())
    )


def fastest_decay_rate(robot: RobotArrays) -> float:
    """Largest decay rate by friction, along the torque-speed line and of the cables, at home [1/s].

    The slope of the Coulomb friction is largest at standstill, τ_c/ω₀.
    """
    model = linear_model(robot)
    return float(np.linalg.eigvals(np.linalg.solve(model.inertia, model.damping)).real.max())


def pulley_acceleration(
    robot: RobotArrays, pose: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> Array:
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

    As many cables as coordinates: the unique solution, which may have either sign; ``minimum`` has
    no effect. More cables: tensions that are all at least ``minimum`` [N]; for a point mass in a
    plane the smallest ones, see :func:`tension_distribution` (Eq. 11), otherwise
    :func:`least_action_tensions`, both also for ``strict``.
    """
    return inverse_dynamics(
        robot, mass, pose, velocity, acceleration, minimum=minimum, strict=strict
    ).tensions


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
        usable = (
            (first >= -slack)
            & (second >= -slack)
            & (first + second < best_sum)
            & (np.abs(determinant) > 1e-12)
        )
        best_sum = np.where(usable, first + second, best_sum)
        pair = np.zeros_like(best)
        pair[..., i], pair[..., j] = first, second
        best = np.where(usable[..., None], pair, best)
    if strict and not np.all(np.isfinite(best_sum)):
        raise ValueError(
            "no positive tensions give this force: the pose is outside the polygon of the base anchors"
        )
    return minimum + np.maximum(best, 0.0)


def least_action_tensions(
    robot: RobotArrays,
    structure: Array,
    load: Array,
    speed: Array,
    acceleration: Array,
    minimum: float,
    *,
    strict: bool = False,
) -> Array:
    """Tensions of redundant cables with the least largest action that hold a load, shape (..., m)
    [N].

    All tensions are at least ``minimum``, see
    :func:`~cablebot_gym.physics.distribution.least_largest_action`. Without ``strict`` the result
    for a load beyond the cables and motors leaves the least wrench error, so that a control law can
    continue.

    Args:
        robot: the robot.
        structure: S, shape (..., m, n).
        load: D Ẍ + h, shape (..., n).
        speed: pulley speeds β̇, shape (..., m) [rad/s].
        acceleration: pulley accelerations β̈, shape (..., m) [rad/s²].
        minimum: least tension [N].
        strict: whether a load that no tensions above the minimum hold raises an error.

    Raises:
        ValueError: if ``strict`` and no tensions of at least ``minimum`` hold the load.
    """
    radius = np.broadcast_to(robot.pulley_radius, robot.stall_torque.shape)
    offset = normalised_action(robot, motor_torques(robot, 0.0, speed, acceleration), speed)
    slope = radius / robot.stall_torque
    span = 1.0 / np.max(np.abs(robot.platform), initial=1e-3)
    weights = np.where(np.arange(robot.coordinates) < robot.dimensions, 1.0, span)
    found = unchecked_least_largest_action(
        structure, as_numbers(load), minimum, slope, offset, weights=weights
    )
    if strict and np.any(found.status != HELD):
        raise ValueError(f"no cable tensions of at least {minimum:g} N give this wrench")
    return found.tensions


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
    more = softness * np.log(
        np.exp((minimum - least) / null / softness).sum(axis=-1, keepdims=True)
    )
    soft: Array = least + more * null
    return soft


def required_torques(
    robot: Robot,
    tensions: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
) -> Array:
    """Motor torques ``τ = r T + J β̈ + c β̇`` (Eq. 1) of a rigid transmission for tensions T, shape
    (..., m) [N·m].

    They include :func:`coulomb_torque`. Of a flexible robot they are the torques of the springs,
    without it.
    """
    structure, rate = kinematics.jacobian_and_rate(
        robot.base, robot.platform, pose, velocity, robot.swivel
    )
    return motor_torques(
        robot, tensions, *_pulley_motion(robot, structure, rate, velocity, acceleration)
    )


def _pulley_motion(
    robot: RobotArrays, structure: Array, rate: Array, velocity: ArrayLike, acceleration: ArrayLike
) -> tuple[Array, Array]:
    """β̇ and β̈ from S and Ṡ, see :func:`pulley_speed` and :func:`pulley_acceleration`."""
    velocity = as_numbers(velocity)
    speed = -_apply(structure, velocity) / robot.pulley_radius
    return speed, -(
        _apply(structure, as_numbers(acceleration)) + _apply(rate, velocity)
    ) / robot.pulley_radius


def motor_torques(
    robot: RobotArrays, tensions: ArrayLike, speed: Array, acceleration: Array
) -> Array:
    """Torques of :func:`required_torques` for pulley speeds and pulley accelerations, each (...,
    m)."""
    torque: Array = robot.pulley_radius * as_numbers(tensions)
    torque = (
        torque + robot.pulley_inertia * as_numbers(acceleration) + robot.damping * as_numbers(speed)
    )
    return torque if robot.flexible else torque + coulomb_torque(robot, speed)


def coulomb_torque(robot: RobotArrays, speed: ArrayLike) -> Array:
    """Torque τ_c ω/√(ω² + ω₀²) that Coulomb friction takes from the motors at speeds ω (..., m)
    [N·m].

    ω₀ is :data:`FRICTION_SPEED`: the friction is smooth, and there is no stiction.
    """
    speed = as_numbers(speed)
    torque: Array = robot.coulomb_friction * speed / np.sqrt(speed**2 + FRICTION_SPEED**2)
    return torque


def motor_friction(robot: RobotArrays, speed: ArrayLike) -> Array:
    """Friction c′ β̇′ of Eq. 4 and :func:`coulomb_torque` of a flexible robot at motor speeds (...,
    m) [N·m]."""
    friction: Array = robot.motor_damping * as_numbers(speed) + coulomb_torque(robot, speed)
    return friction


@dataclass(frozen=True, kw_only=True, eq=False)
class InverseDynamics:
    """Cable tensions, motor torques and pulley motion that a motion requires; each array has shape
    (..., m)."""

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
    """Tensions, torques and pulley motion for a motion. The arguments are as in
    :func:`required_tensions`."""
    pose, velocity, acceleration = (
        np.asarray(array, float) for array in (pose, velocity, acceleration)
    )
    structure, rate = kinematics.jacobian_and_rate(
        robot.base, robot.platform, pose, velocity, robot.swivel
    )
    speed, second = _pulley_motion(robot, structure, rate, velocity, acceleration)
    wrench = load(robot, mass, pose, velocity, acceleration)
    if robot.cables == robot.coordinates:
        tensions = -np.linalg.solve(np.swapaxes(structure, -1, -2), wrench[..., None])[..., 0]
    elif robot.kind == "planar":
        tensions = tension_distribution(structure, wrench, minimum, strict=strict)
    else:
        tensions = least_action_tensions(
            robot, structure, wrench, speed, second, minimum, strict=strict
        )
    torques = motor_torques(robot, tensions, speed, second)
    return InverseDynamics(
        tensions=tensions, torques=torques, speeds=speed, pulley_accelerations=second
    )


def torque_limits(robot: Robot, speed: ArrayLike) -> tuple[Array, Array]:
    """Torque limits ``U⁻`` and ``U⁺`` (Eq. 37) at motor speeds (..., m) [rad/s], each (..., m)
    [N·m]."""
    drop = robot.speed_slope * as_numbers(speed)
    return -robot.stall_torque - drop, robot.stall_torque - drop


def normalised_action(robot: RobotArrays, torques: ArrayLike, speed: ArrayLike) -> Array:
    """Action a = (τ + (τ_s/ω_n) speed)/τ_s for torques [N·m] at motor speeds [rad/s], each (...,
    m)."""
    action: Array = (
        as_numbers(torques) + robot.speed_slope * as_numbers(speed)
    ) / robot.stall_torque
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

    Coulomb friction takes its torque from the motors; of a flexible robot, pass the torques of the
    springs. Bilateral cables may push: ``(D + Sᵀ(J/r²)S) Ẍ = −h − Sᵀ(τ/r + (J/r²) Ṡ Ẋ + (c/r²) S
    Ẋ)``. Unilateral cables obey ``0 ≤ T ⟂ u ≥ 0`` with the take-up torque u. The function tries all
    sets of taut cables until all tensions of the taut cables and all take-up torques of the slack
    cables are positive. This set is unique. The search is slow but exhaustive.
    """
    pose, velocity, torques = (as_numbers(array) for array in (pose, velocity, torques))
    if not robot.flexible:
        torques = torques - coulomb_torque(robot, pulley_speed(robot, pose, velocity))
    structure = jacobian(robot, pose)
    inertia = robot.pulley_inertia / robot.pulley_radius**2
    cable_bias = _apply(jacobian_rate(robot, pose, velocity), velocity)
    damping = robot.damping / robot.pulley_radius**2 * _apply(structure, velocity)
    driving_force = torques / robot.pulley_radius + inertia * cable_bias + damping
    matrix = mass_matrix(robot, mass, pose)
    vector = bias(robot, mass, pose, velocity)

    def solve(taut: Array) -> tuple[Array, Array]:
        weighted = np.swapaxes(structure, -1, -2) * taut
        left = matrix + weighted @ (inertia[:, None] * structure)
        acceleration = np.linalg.solve(
            left, -(vector + _apply(weighted, driving_force))[..., None]
        )[..., 0]
        return acceleration, driving_force + inertia * _apply(structure, acceleration)

    acceleration, tension = solve(np.ones(robot.cables))
    if cable == "bilateral":
        return acceleration, tension
    settled = np.all(tension >= 0, axis=-1)
    result = acceleration.copy()
    pulled = np.where(settled[..., None], tension, 0.0)
    for taut in product((1.0, 0.0), repeat=robot.cables):
        if np.all(settled):
            break
        acceleration, tension = solve(np.array(taut))
        consistent = (
            np.all(np.where(np.array(taut) > 0, tension >= 0, tension <= 0), axis=-1) & ~settled
        )
        result[consistent], pulled[consistent] = (
            acceleration[consistent],
            (tension * taut)[consistent],
        )
        settled |= consistent
    return result, pulled


def _apply(matrix: Array, vector: Array) -> Array:
    """Batched matrix times vector."""
    applied: Array = (matrix @ vector[..., None])[..., 0]
    return applied
