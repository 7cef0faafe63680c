"""Motors, springs and inverse dynamics: torques, tensions at rest and in motion, and linear models."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array, as_numbers, times_vector
from cablebot_gym.physics.tensions.distribution import (
    HELD,
    largest_scale,
    least_norm,
    unchecked_central,
    unchecked_least_largest_action,
)
from cablebot_gym.physics.textbook.platform import (
    bias,
    cable_lengths,
    jacobian,
    jacobian_and_rate,
    load,
    mass_matrix,
    pulley_angle,
    pulley_motion,
    tension_distribution,
)
from cablebot_gym.robots import Cable, Robot, find_robot
from cablebot_gym.uncertainty import RobotArrays

MINIMUM_TENSION = 5.0
"""Usual least tension T_min of redundant cables [N], for control laws and at rest. With 0 the cables
become slack at once in closed loop; a few newtons keep them taut."""

USUAL_STRENGTH = 50.0
"""Strength of motors and cables from which on robots have the usual least tension [N], half of that
of the paper's planar robot. On weaker robots it is less in proportion."""

TENSION_RESERVE = 1.2
"""Least tension that laws allocate, as a multiple of the robot's own ``minimum_tension``, if that
is more."""


@lru_cache(maxsize=64)
def allocated_minimum(
    robot: Robot, usual: float = MINIMUM_TENSION, reserve: float = TENSION_RESERVE
) -> float:
    """Least tension that laws allocate, and that redundant cables have at rest [N].

    It is ``usual``, less for weak motors or cables, or more for heavy cables; at most half way from
    the robot's ``minimum_tension`` to its largest tension, and to that which all cables can have at
    once when they hold the platform at home.
    """
    strength = float(largest_tensions(robot).min())
    weaker = usual * strength / USUAL_STRENGTH
    minimum = max(min(usual, weaker), reserve * robot.minimum_tension)
    most = strength
    if robot.cables > robot.coordinates and not robot.weightless:
        structure = jacobian(robot, robot.home)
        weight = bias(robot, robot.mass, robot.home, np.zeros(robot.coordinates))
        # a common tension t pulls with −Sᵀ t; tensions ≥ 0 besides it hold weight and pull
        common = largest_scale(structure, weight, structure.sum(axis=0), 0.0, np.inf, strength)
        if common.status == HELD:
            most = float(common.largest)
    return min(minimum, (robot.minimum_tension + most) / 2)


def largest_tensions(robot: RobotArrays) -> Array:
    """Largest tensions at rest by the stall torques and the maximum tension, (..., m) [N]."""
    tensions: Array = np.minimum(robot.stall_torque / robot.pulley_radius, robot.maximum_tension)
    return tensions


def static_torque(
    robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, *, minimum: float | None = None
) -> Array:
    """Torque r T at rest [N·m], shape (..., m), by default that of the start of an episode. T and
    ``minimum`` are as in :func:`required_tensions`; None for :func:`allocated_minimum`.

    Where redundant cables would not hold the robot or exceed their largest tension, T is nearest to
    ``minimum`` within the robot's bounds of the tension, or without its minimum tension if that
    holds the robot. With elastic cables :func:`holding_torque` of it is the motor torque.
    """
    if minimum is None:
        minimum = allocated_minimum(robot)
    zero = np.zeros_like(np.asarray(pose, float))
    tensions = required_tensions(robot, mass, pose, zero, zero, minimum=minimum, strict=False)
    if robot.cables > robot.coordinates:
        tensions = _holding_tensions(robot, mass, pose, tensions, minimum)
    return robot.pulley_radius * tensions


def _holding_tensions(
    robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, tensions: Array, minimum: float
) -> Array:
    """Tensions (..., m), replaced where they do not hold the robot at rest or are too large."""
    still = np.zeros(robot.coordinates)
    structure = jacobian(robot, pose)
    wrench = load(robot, mass, pose, still, still)
    largest = largest_tensions(robot)
    for least in (robot.minimum_tension, 0.0):
        missing = np.abs(wrench + times_vector(structure.mT, tensions)).max(axis=-1)
        unheld = (missing > 1e-6 * tensions.max(axis=-1)) | np.any(tensions > largest, axis=-1)
        if not np.any(unheld):
            break
        nearest = least_norm(structure, wrench, least, largest, minimum)
        replaced = unheld & (nearest.status == HELD)
        tensions = np.where(replaced[..., None], nearest.tensions, tensions)
    return tensions


def holding_torque(robot: RobotArrays, torque: Array) -> Array:
    """Motor torque at rest for a torque r T, (..., m): r T (1 + ε/2) with elastic cables of strain
    ε = T/EA."""
    if not robot.elastic:
        return torque
    strain = torque / robot.pulley_radius / robot.axial_stiffness
    return torque * (1 + strain / 2)


def stretched_torque(robot: RobotArrays, torque: Array) -> Array:
    """Torque r T for a torque K δ with the stiffness K of :func:`joint_stiffness` and the
    deflection δ, (..., m).

    It is K δ (1 + ε) with elastic cables of strain ε = T/EA, because their free length is less than
    their length.
    """
    if not robot.elastic:
        return torque
    relative_strain = torque / robot.pulley_radius / robot.axial_stiffness  # ε/(1 + ε)
    return torque / (1 - relative_strain)


def rest_angles(robot: RobotArrays, tensions: ArrayLike, pose: ArrayLike) -> Array:
    """Motor angles β′ of a robot at rest with tensions T (..., m), (..., m) [rad].

    Elastic cables have the free length l = (q + extra_length)/(1 + T/EA).
    """
    tensions = as_numbers(tensions)
    angle = pulley_angle(robot, pose)
    if robot.elastic:
        strain = tensions / robot.axial_stiffness
        length = cable_lengths(robot, pose) + robot.extra_length
        stretch = length * strain / (1 + strain)
        return angle + stretch / robot.pulley_radius
    if robot.jointed:
        return angle + robot.pulley_radius * tensions / robot.stiffness
    return angle


def static_motor_angle(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike) -> Array:
    """Motor angle β′ of a flexible robot at rest [rad], shape (..., m), see :func:`rest_angles`."""
    tensions = static_torque(robot, mass, pose) / robot.pulley_radius
    return rest_angles(robot, tensions, pose)


def joint_stiffness(robot: RobotArrays, pose: ArrayLike) -> Array:
    """Stiffness at the pulleys between motor and platform, (..., m) [N·m/rad]."""
    if not robot.elastic:
        return robot.stiffness
    length = cable_lengths(robot, pose) + robot.extra_length
    cable: Array = robot.pulley_radius**2 * robot.axial_stiffness / length
    return cable


def joint_equivalent(robot: Robot) -> Robot:
    """The robot with joint springs in place of its elastic cables, for control laws; itself if they
    do not stretch.

    The springs have the stiffness at the home pose, and the pulley becomes the motor. The damping of
    the cables is left out.
    """
    if not robot.elastic:
        return robot
    transmission = robot.transmission.replace(
        axial_stiffness=None,
        axial_damping=0.0,
        extra_length=0.0,
        stiffness=joint_stiffness(robot, robot.home),
        motor_inertia=robot.pulley_inertia,
        motor_damping=robot.damping,
        pulley_inertia=0.0,
        damping=0.0,
    )
    return robot.replace(transmission=transmission)


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

    The cable slides on its drum without friction and is unstretched there, so l follows from β. A
    cable that sticks to its drum keeps its strain there: at rest its torque is r T, lower by half
    the strain, and ``l̇ = −r β̇/(1 + ε)`` makes l a further state. Both conserve energy.

    Args:
        robot: robot with elastic cables.
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
        angle: pulley angle β, shape (..., m) [rad].
        speed: pulley speed β̇, shape (..., m) [rad/s].
        cable: ``unilateral`` cables can only pull.
    """
    radius = robot.pulley_radius
    home_length = cable_lengths(robot, robot.home) + robot.extra_length
    free_length = home_length - radius * as_numbers(angle)
    length = cable_lengths(robot, pose) + robot.extra_length
    strain = length / free_length - 1
    stretching_speed = times_vector(jacobian(robot, pose), as_numbers(velocity))
    stretching_speed = stretching_speed + radius * as_numbers(speed)
    rate = stretching_speed / free_length
    tension = robot.axial_stiffness * strain + robot.axial_damping * rate
    wound = radius * robot.axial_stiffness * strain**2 / 2
    if cable == "unilateral":
        is_taut = strain > 0
        tension = np.where(is_taut, np.maximum(tension, 0.0), 0.0)
        wound = np.where(is_taut, wound, 0.0)
    return tension, radius * tension + wound


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

    The springs also push.

    Args:
        robot: flexible robot.
        pose: X, shape (..., n).
        velocity: Ẋ, shape (..., n).
        angle: motor angle β′, shape (..., m) [rad].
        speed: motor speed β̇′, shape (..., m) [rad/s].
        acceleration: motor acceleration β̈′, shape (..., m) [rad/s²].
    """
    if robot.jointed:
        spring_torque = robot.stiffness * (as_numbers(angle) - pulley_angle(robot, pose))
        torque = spring_torque + robot.motor_inertia * as_numbers(acceleration)
        torque = torque + motor_friction(robot, speed, spring_torque)
        return torque, spring_torque / robot.pulley_radius
    velocity = as_numbers(velocity)
    speed = as_numbers(speed)
    _, cable_torque = cable_springs(robot, pose, velocity, angle, speed, cable="bilateral")
    torque = cable_torque + robot.pulley_inertia * as_numbers(acceleration)
    torque = torque + robot.damping * speed
    torque = torque + coulomb_torque(robot, speed)
    if np.any(robot.load_friction):
        torque = torque + load_friction(robot, speed) * np.abs(cable_torque)
    tensions, _ = cable_springs(robot, pose, 0 * velocity, angle, 0 * speed, cable="bilateral")
    return torque, tensions


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
    plane the smallest ones, see
    :func:`~cablebot_gym.physics.textbook.platform.tension_distribution` (Eq. 11), otherwise
    :func:`least_action_tensions`, both also for ``strict``.
    """
    return inverse_dynamics(
        robot, mass, pose, velocity, acceleration, minimum=minimum, strict=strict
    ).tensions


def least_action_tensions(
    robot: RobotArrays,
    structure: Array,
    load: Array,
    speed: Array,
    acceleration: Array,
    minimum: ArrayLike,
    *,
    strict: bool = False,
) -> Array:
    """Tensions of redundant cables with the least largest action that hold a load, shape (..., m)
    [N].

    All tensions are at least ``minimum``, see
    :func:`~cablebot_gym.physics.tensions.distribution.unchecked_least_largest_action`. Without ``strict`` the result
    for a load beyond the cables and motors leaves the least wrench error, so that a control law can
    continue.

    Args:
        robot: the robot.
        structure: S, shape (..., m, n).
        load: D Ẍ + h, shape (..., n).
        speed: pulley speeds β̇, shape (..., m) [rad/s].
        acceleration: pulley accelerations β̈, shape (..., m) [rad/s²].
        minimum: least tension, a number or one for each cable, (..., m) [N].
        strict: whether a load that no tensions above the minimum hold raises an error.

    Raises:
        ValueError: if ``strict`` and no tensions of at least ``minimum`` hold the load.
    """
    slope, offset = _actions_of_tensions(robot, speed, acceleration)
    weights = np.ones(robot.coordinates)
    # Moments over the largest lever arm are comparable to forces.
    weights[robot.dimensions :] = 1.0 / np.max(np.abs(robot.platform), initial=1e-3)
    distribution = unchecked_least_largest_action(
        structure, as_numbers(load), minimum, slope, offset, weights=weights
    )
    if strict and np.any(distribution.status != HELD):
        raise ValueError(f"no cable tensions of at least {np.min(minimum):g} N give this wrench")
    return distribution.tensions


def central_tensions(
    robot: RobotArrays,
    structure: Array,
    load: Array,
    speed: Array,
    acceleration: Array,
    minimum: ArrayLike,
) -> Array:
    """Tensions of redundant cables that change smoothly along a motion, shape (..., m) [N]: those of
    :func:`~cablebot_gym.physics.tensions.distribution.unchecked_central`, or in a pose where S is singular those of
    :func:`least_action_tensions`.

    The arguments are as there.
    """
    slope, offset = _actions_of_tensions(robot, speed, acceleration)
    tensions = unchecked_central(structure, as_numbers(load), minimum, slope, offset)
    if np.isfinite(tensions).all():
        return tensions
    least = least_action_tensions(robot, structure, load, speed, acceleration, minimum)
    return np.where(np.isfinite(tensions), tensions, least)


def _actions_of_tensions(
    robot: RobotArrays, speed: Array, acceleration: Array
) -> tuple[Array, Array]:
    """Action per tension [1/N] and action at zero tension. Where the maximum tension is less than
    that of the motor, the slope is larger, so that the action is 1 at the maximum tension."""
    unloaded_torques = motor_torques(robot, 0.0, speed, acceleration)
    offset = normalised_action(robot, unloaded_torques, speed)
    slope = loaded_radius(robot, speed) / robot.stall_torque
    if robot.maximum_tension != math.inf:
        slope = np.maximum(slope, (1.0 - offset) / robot.maximum_tension)
    return slope, offset


def required_torques(
    robot: Robot,
    tensions: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
) -> Array:
    """Motor torques ``τ = r T + J β̈ + c β̇`` (Eq. 1) of a rigid transmission for tensions T, shape
    (..., m) [N·m].

    They include :func:`coulomb_torque` and load friction. Of a flexible robot they are the torques of the springs,
    without it.
    """
    structure, rate = jacobian_and_rate(robot, pose, velocity)
    speed, second = pulley_motion(robot, structure, rate, velocity, acceleration)
    return motor_torques(robot, tensions, speed, second)


def motor_torques(
    robot: RobotArrays, tensions: ArrayLike, speed: Array, acceleration: Array
) -> Array:
    """Torques of :func:`required_torques` for pulley speeds and pulley accelerations, each (...,
    m)."""
    torque: Array = loaded_radius(robot, speed) * as_numbers(tensions)
    torque = torque + robot.pulley_inertia * as_numbers(acceleration)
    torque = torque + robot.damping * as_numbers(speed)
    if not robot.flexible:
        torque = torque + coulomb_torque(robot, speed)
    return torque


def smooth_magnitude(robot: RobotArrays, speed: ArrayLike) -> Array:
    """√(ω² + ω₀²) of motor speeds ω, with the ``friction_speed`` ω₀ of the transmission, of the
    shape of the speeds [rad/s].

    Over it, a speed is the part of its largest friction that a motor has.
    """
    magnitude: Array = np.sqrt(as_numbers(speed) ** 2 + robot.transmission.friction_speed**2)
    return magnitude


def coulomb_torque(robot: RobotArrays, speed: ArrayLike) -> Array:
    """Torque τ_c ω/√(ω² + ω₀²) that Coulomb friction takes from the motors at speeds ω (..., m)
    [N·m].

    See :func:`smooth_magnitude`: the friction is smooth, and there is no stiction.
    """
    torque: Array = robot.coulomb_friction * as_numbers(speed) / smooth_magnitude(robot, speed)
    return torque


def load_friction(robot: RobotArrays, speed: ArrayLike) -> Array:
    """Load friction over the load, μ ω/√(ω² + ω₀²), at motor speeds ω (..., m)."""
    fraction: Array = robot.load_friction * as_numbers(speed) / smooth_magnitude(robot, speed)
    return fraction


def loaded_radius(robot: RobotArrays, speed: ArrayLike) -> Array:
    """Motor torque per tension at pulley speeds (..., m) [m]: r, and of a rigid transmission r (1 +
    μ ω/√(ω² + ω₀²))."""
    if robot.flexible or not np.any(robot.load_friction):
        return robot.pulley_radius
    radius: Array = robot.pulley_radius * (1 + load_friction(robot, speed))
    return radius


def motor_friction(robot: RobotArrays, speed: ArrayLike, load: ArrayLike) -> Array:
    """Friction of the motors of a flexible robot, (..., m) [N·m]: c′ β̇′ of Eq. 4,
    :func:`coulomb_torque` and load friction.

    Args:
        robot: flexible robot.
        speed: motor speeds β̇′, shape (..., m) [rad/s].
        load: torques of the springs, shape (..., m) [N·m].
    """
    friction: Array = robot.motor_damping * as_numbers(speed) + coulomb_torque(robot, speed)
    if np.any(robot.load_friction):
        friction = friction + load_friction(robot, speed) * np.abs(as_numbers(load))
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
    """Pulley speeds β̇ [rad/s], see :func:`~cablebot_gym.physics.textbook.platform.pulley_speed`."""
    pulley_accelerations: Array
    """Pulley accelerations β̈ [rad/s²], see :func:`~cablebot_gym.physics.textbook.platform.pulley_acceleration`."""


def inverse_dynamics(
    robot: RobotArrays | str,
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
    if isinstance(robot, str):
        robot = find_robot(robot)
    pose = np.asarray(pose, float)
    velocity = np.asarray(velocity, float)
    acceleration = np.asarray(acceleration, float)
    structure, rate = jacobian_and_rate(robot, pose, velocity)
    speed, second = pulley_motion(robot, structure, rate, velocity, acceleration)
    wrench = load(robot, mass, pose, velocity, acceleration)
    if robot.cables == robot.coordinates:
        negative_tensions = np.linalg.solve(structure.mT, wrench[..., None])
        tensions = -negative_tensions[..., 0]
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


def normalised_action(robot: RobotArrays | str, torques: ArrayLike, speed: ArrayLike) -> Array:
    """Action a = (τ + (τ_s/ω_n) speed)/τ_s for torques [N·m] at motor speeds [rad/s], each (...,
    m)."""
    if isinstance(robot, str):
        robot = find_robot(robot)
    requested = as_numbers(torques) + robot.speed_slope * as_numbers(speed)
    action: Array = requested / robot.stall_torque
    return action


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionEquations:
    """Terms of the equations of motion at a state, with a rigid transmission: ``D Ẍ + h = −Sᵀ T``
    and ``T = τ/r + (J/r²) S Ẍ + d``."""

    mass_matrix: Array
    """D, (..., n, n)."""
    bias: Array
    """h, (..., n)."""
    structure: Array
    """S, (..., m, n)."""
    pulley_speed: Array
    """β̇ = −S Ẋ / r [rad/s], (..., m)."""
    rotor_masses: Array
    """J/r² [kg], (m,)."""
    cable_drag: Array
    """d = (J/r²) Ṡ Ẋ + (c/r²) S Ẋ [N], (..., m)."""


def motion_equations(
    robot: RobotArrays, mass: ArrayLike, pose: ArrayLike, velocity: ArrayLike
) -> MotionEquations:
    """The terms at poses (..., n) and velocities (..., n), with masses (...) [kg]."""
    velocity = as_numbers(velocity)
    structure, rate = jacobian_and_rate(robot, pose, velocity)
    radius = robot.pulley_radius
    cable_speed = times_vector(structure, velocity)
    rotor_masses = robot.pulley_inertia / radius**2
    rotor_force = rotor_masses * times_vector(rate, velocity)
    drag = rotor_force + robot.damping / radius**2 * cable_speed
    return MotionEquations(
        mass_matrix=mass_matrix(robot, mass, pose),
        bias=bias(robot, mass, pose, velocity),
        structure=structure,
        pulley_speed=-cable_speed / radius,
        rotor_masses=rotor_masses,
        cable_drag=drag,
    )


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

    Friction takes its torque from the motors; of a flexible robot, pass the torques of the
    springs. Bilateral cables may push: ``(D + Sᵀ(J/r²)S) Ẍ = −h − Sᵀ(τ/r + (J/r²) Ṡ Ẋ + (c/r²) S
    Ẋ)``. Unilateral cables obey ``0 ≤ T ⟂ u ≥ 0`` with the take-up torque u. The function tries all
    sets of taut cables until all tensions of the taut cables and all take-up torques of the slack
    cables are positive. This set is unique. The search is slow but exhaustive.
    """
    torques = as_numbers(torques)
    equations = motion_equations(robot, mass, pose, velocity)
    if not robot.flexible:
        torques = torques - coulomb_torque(robot, equations.pulley_speed)
    structure = equations.structure
    grip = robot.pulley_radius / loaded_radius(robot, equations.pulley_speed)
    rotors = grip * equations.rotor_masses
    driving_force = grip * (torques / robot.pulley_radius + equations.cable_drag)

    def solve(taut: Array) -> tuple[Array, Array]:
        """Accelerations and tensions if only the cables with ``taut`` = 1 act."""
        weighted = structure.mT * taut
        left = equations.mass_matrix + weighted @ (rotors[..., None] * structure)
        right = -(equations.bias + times_vector(weighted, driving_force))
        acceleration = np.linalg.solve(left, right[..., None])[..., 0]
        tension = driving_force + rotors * times_vector(structure, acceleration)
        return acceleration, tension

    acceleration, tension = solve(np.ones(robot.cables))
    if cable == "bilateral":
        return acceleration, tension
    settled = np.all(tension >= 0, axis=-1)
    result = acceleration.copy()
    pulled = np.where(settled[..., None], tension, 0.0)
    for taut_set in product((1.0, 0.0), repeat=robot.cables):
        if np.all(settled):
            break
        taut = np.array(taut_set)
        acceleration, tension = solve(taut)
        # A slack cable would have to push to keep up with its winch.
        sign_agrees = np.where(taut > 0, tension >= 0, tension <= 0)
        consistent = np.all(sign_agrees, axis=-1) & ~settled
        result[consistent] = acceleration[consistent]
        pulled[consistent] = (tension * taut)[consistent]
        settled |= consistent
    return result, pulled
