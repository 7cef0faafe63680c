"""Small motions about a pose at rest: masses, damping, and the stiffness of springs, cable tensions
and weight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh, null_space

from cablebot_gym.kinematics import Array, as_numbers
from cablebot_gym.physics.textbook.drives import (
    allocated_minimum,
    holding_torque,
    required_tensions,
)
from cablebot_gym.physics.textbook.platform import (
    cable_lengths,
    center_arm,
    jacobian,
    jacobian_rate,
    mass_matrix,
)
from cablebot_gym.robots import COORDINATE_NAMES, Robot, find_robot
from cablebot_gym.uncertainty import RobotArrays
from cablebot_gym.utils.checks import number, numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearModel:
    """Matrices of ``M ẍ + C ẋ + K x = 0`` about a pose with taut cables.

    x = (X, β′), and X alone of a rigid robot. Pulleys of elastic cables turn with the motors.
    """

    inertia: Array
    """M, shape (..., k, k)."""
    damping: Array
    """C, shape (..., k, k): friction of motors and pulleys, slope of the torque-speed lines,
    damping of the cables. Load friction is that of the holding torques, or of the stall torques if
    no tensions are given."""
    stiffness: Array
    """K, shape (..., k, k)."""
    motors: Array
    """Gradient of the motor angles with respect to x, shape (..., m, k): its transpose times the
    motor torques is their generalised force."""


def linear_model(
    robot: RobotArrays,
    *,
    mass: ArrayLike | None = None,
    pose: ArrayLike | None = None,
    tensions: ArrayLike | None = None,
) -> LinearModel:
    """Linear model of a robot about a pose.

    Args:
        robot: the robot, or N robots.
        mass: mass of the platform and its payload [kg], shape (...); None for the platform alone.
        pose: X, shape (..., n); None for the home pose.
        tensions: T that hold the mass at rest [N], shape (..., m): K is then the second derivative
            of the potential of springs and weight. None omits the stiffness of tensions and weight.
    """
    if mass is None:
        mass = robot.mass
    if pose is None:
        pose = robot.home
    pose = as_numbers(pose)
    structure = jacobian(robot, pose)
    m = robot.cables
    n = robot.coordinates
    batch = structure.shape[:-2]
    identity = np.eye(m)
    size = n + m * robot.flexible
    inertia = np.zeros((*batch, size, size))
    damping = np.zeros_like(inertia)
    stiffness = np.zeros_like(inertia)
    inertia[..., :n, :n] = mass_matrix(robot, mass, np.broadcast_to(pose, (*batch, n)))

    def rows_of(*blocks: tuple[int, Array]) -> Array:
        """Rows (..., m, k) made of blocks: index of the first column, and values."""
        rows = np.zeros((*batch, m, size))
        for start, block in blocks:
            rows[..., start : start + block.shape[-1]] = block
        return rows

    def add(matrix: Array, weight: Array, *blocks: tuple[int, Array]) -> None:
        """Adds BᵀWB for the rows B."""
        rows = rows_of(*blocks)
        weights = np.broadcast_to(weight, (*batch, m))[..., None]
        matrix += rows.mT @ (weights * rows)

    radius = robot.pulley_radius[..., None]
    # Blocks of the gradients of pulley and motor angles with respect to x.
    pulley = (0, -structure / radius)
    if robot.elastic:
        pulley = (n, identity)
    motor = pulley
    if robot.jointed:
        motor = (n, identity)
    add(inertia, robot.pulley_inertia, pulley)
    add(damping, robot.damping, pulley)
    load_torque = robot.stall_torque
    if tensions is not None:
        load_torque = holding_torque(robot, robot.pulley_radius * as_numbers(tensions))
    largest_friction = robot.coulomb_friction + robot.load_friction * load_torque
    friction_slope = largest_friction / robot.transmission.friction_speed
    add(damping, robot.speed_slope + friction_slope, motor)
    if robot.elastic:
        stretch = np.ones(m)  # length over free length
        if tensions is not None:
            stretch = 1 + as_numbers(tensions) / robot.axial_stiffness
        free_length = (cable_lengths(robot, pose) + robot.extra_length) / stretch
        wound = radius * stretch[..., None] * identity
        platform = (0, structure)
        add(stiffness, robot.axial_stiffness / free_length, platform, (n, wound))
        add(damping, robot.axial_damping / free_length, platform, (n, radius * identity))
    if robot.jointed:
        add(inertia, robot.motor_inertia, motor)
        add(damping, robot.motor_damping, motor)
        start, pulley_angle = pulley
        add(stiffness, robot.stiffness, motor, (start, -pulley_angle))
    if tensions is not None:
        platform_stiffness = stiffness[..., :n, :n]  # a view, changed in place
        platform_stiffness += tension_stiffness(robot, pose, tensions)
        platform_stiffness += weight_stiffness(robot, mass, pose)
    return LinearModel(inertia=inertia, damping=damping, stiffness=stiffness, motors=rows_of(motor))


@dataclass(frozen=True, kw_only=True, eq=False)
class StateSpace:
    """Linear equations ``ẋ = A x + B u`` of the deviations x from a state at rest and u from the
    actions there, in SI units and radians.

    Here actions have no lag, and actions and speeds act continuously. The environments apply the
    lag of the motors, and keep the action and the torque drop constant in a control period.
    """

    A: Array
    """System matrix, shape (2k, 2k)."""
    B: Array
    """Input matrix of the m actions, shape (2k, m)."""
    states: tuple[str, ...]
    """Name of each state: coordinates of the pose X, angles of the pulleys at elastic cables and of
    the motors at joint springs, and the rates of all."""
    units: tuple[str, ...]
    """Unit of each state. Actions have none."""
    pose: Array
    """Pose at rest X, shape (n,) [m, rad]."""
    action: Array
    """Actions at rest, shape (m,). Beyond ±1 the motors cannot hold the robot."""
    tensions: Array
    """Cable tensions at rest, shape (m,) [N]."""


def linearise(
    robot: Robot | str, pose: ArrayLike | None = None, payload: float = 0.0
) -> StateSpace:
    """Linear equations of a robot about a pose at rest, with taut cables.

    Args:
        robot: as for ``find_robot``.
        pose: pose X, shape (n,) [m, rad]; None for the home pose.
        payload: payload [kg].

    Raises:
        ValueError: if an argument is invalid, or no tensions hold the robot at the pose.
    """
    robot = find_robot(robot)
    n = robot.coordinates
    mass = robot.mass + number("payload", payload, least=0, unit="kg")
    if pose is None:
        pose = robot.home
    pose = numbers("pose", pose, shapes=[(n,)])
    still = np.zeros(n)
    try:
        tensions = required_tensions(
            robot, mass, pose, still, still, minimum=allocated_minimum(robot)
        )
    except np.linalg.LinAlgError:
        tensions = still  # refused below
    if tensions.min() <= 0:
        raise ValueError(f"no taut cables hold {robot.name} with {payload:g} kg at {pose.tolist()}")
    model = linear_model(robot, mass=mass, pose=pose, tensions=tensions)
    k = len(model.inertia)
    system = np.eye(2 * k, k=k)  # identity at the upper right: the rates of the coordinates
    forces = np.hstack([model.stiffness, model.damping])
    system[k:] = -np.linalg.solve(model.inertia, forces)
    inputs = np.zeros((2 * k, robot.cables))
    inputs[k:] = np.linalg.solve(model.inertia, model.motors.T) * robot.stall_torque
    names = list(COORDINATE_NAMES[robot.kind])
    for part, has_states in (("pulley", robot.elastic), ("motor", robot.jointed)):
        if has_states:
            names += [f"{part} angle {index + 1}" for index in range(robot.cables)]
    units = ["m"] * robot.dimensions + ["rad"] * (k - robot.dimensions)
    return StateSpace(
        A=system,
        B=inputs,
        states=(*names, *(f"rate of {name}" for name in names)),
        units=(*units, *(f"{unit}/s" for unit in units)),
        pose=pose,
        action=holding_torque(robot, robot.pulley_radius * tensions) / robot.stall_torque,
        tensions=tensions,
    )


def tension_stiffness(robot: RobotArrays, pose: ArrayLike, tensions: ArrayLike) -> Array:
    """Stiffness Σ T_i ∂²q_i/∂X² of tensions T, (..., m), because the cables turn [N/m, N, N·m],
    shape (..., n, n)."""
    pose = as_numbers(pose)
    weights = as_numbers(tensions)[..., None]
    columns = []
    for along in np.eye(robot.coordinates):
        slope = jacobian_rate(robot, pose, np.broadcast_to(along, pose.shape))  # ∂S/∂X_j
        columns.append(np.sum(weights * slope, axis=-2))
    return np.stack(columns, axis=-1)


def weight_stiffness(robot: RobotArrays, mass: ArrayLike, pose: ArrayLike) -> Array:
    """Second derivative of the potential of the weight, −m g ∂²(R c)/∂X² along gravity, shape (...,
    n, n) [N·m].

    It is zero if the centre of mass c is the origin of the platform frame.
    """
    pose = as_numbers(pose)
    second = np.zeros((*pose.shape, robot.coordinates))
    if robot.point_mass or not np.any(robot.mass_center):
        return second
    weight = as_numbers(mass)[..., None] * robot.gravity_vector
    if robot.planar:
        second[..., 2, 2] = np.sum(weight * center_arm(robot, pose), axis=-1)
        return second
    c_x, c_y, c_z = robot.mass_center
    psi = pose[..., 3]
    theta = pose[..., 4]
    level = np.sin(psi) * c_y + np.cos(psi) * c_z
    turned = np.cos(psi) * c_y - np.sin(psi) * c_z
    # −∂²(R c)_z/∂X², where (R c)_z = −sin θ c_x + cos θ (sin ψ c_y + cos ψ c_z).
    second[..., 3, 3] = np.cos(theta) * level
    second[..., 3, 4] = second[..., 4, 3] = np.sin(theta) * turned
    second[..., 4, 4] = np.cos(theta) * level - np.sin(theta) * c_x
    return weight[..., 2, None, None] * second


def locked_modes(
    robot: Robot, mass: ArrayLike, pose: ArrayLike, tensions: ArrayLike | None
) -> tuple[Array, Array]:
    """Modes with locked motors about a pose at rest, from the softest to the stiffest.

    Cables that do not stretch keep their lengths: the platform moves only where it hangs on fewer
    cables than coordinates.

    Args:
        robot: the robot.
        mass: mass of the platform and its payload [kg].
        pose: X, shape (n,).
        tensions: T that hold the mass at rest, shape (m,) [N], or None as in :func:`linear_model`.

    Returns:
        Frequencies (k,) [Hz], 0 for a mode without a restoring force, and shapes (n, k).
    """
    model = linear_model(robot, mass=mass, pose=pose, tensions=tensions)
    moving = len(model.inertia)
    if robot.flexible:
        moving -= robot.cables  # the motors are the last coordinates
        free = np.eye(moving)
    else:
        free = null_space(jacobian(robot, pose))
    if free.shape[1] == 0:
        return np.empty(0), free
    stiffness = free.T @ model.stiffness[:moving, :moving] @ free
    inertia = free.T @ model.inertia[:moving, :moving] @ free
    squares, shapes = eigh(stiffness, inertia)
    return _frequencies(squares), free @ shapes


def free_modes(
    robot: Robot, mass: ArrayLike, pose: ArrayLike, tensions: ArrayLike
) -> tuple[Array, Array]:
    """Modes of a flexible robot with constant motor torques, without the n modes in which no spring
    is deflected.

    The arguments and results are as in :func:`locked_modes`; the shapes have the rows X, β′.
    """
    model = linear_model(robot, mass=mass, pose=pose, tensions=tensions)
    squares, shapes = eigh(model.stiffness, model.inertia)
    n = robot.coordinates
    return _frequencies(squares[n:]), shapes[:, n:]


def _frequencies(squares: Array) -> Array:
    """Frequencies [Hz] from squares of angular frequencies, which rounding can make negative."""
    angular_frequencies = np.sqrt(np.maximum(squares, 0.0))
    return angular_frequencies / (2 * np.pi)


def highest_frequency(robot: RobotArrays) -> float:
    """Highest natural frequency of a flexible robot about its home pose with taut cables
    [rad/s]."""
    model = linear_model(robot)
    return math.sqrt(_largest_eigenvalue(model.inertia, model.stiffness))


def fastest_decay_rate(robot: RobotArrays) -> float:
    """Largest decay rate at home [1/s], by friction, torque-speed lines and damping of cables.

    The slope of the Coulomb friction is largest at standstill, τ_c/ω₀.
    """
    model = linear_model(robot)
    return _largest_eigenvalue(model.inertia, model.damping)


def _largest_eigenvalue(inertia: Array, matrix: Array) -> float:
    """Largest real part of the eigenvalues of M⁻¹ A, of one robot or of any of N."""
    eigenvalues = np.linalg.eigvals(np.linalg.solve(inertia, matrix))
    return float(eigenvalues.real.max())
