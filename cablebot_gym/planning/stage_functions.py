"""Constraints at one instant of a motion as CasADi functions, from the textbook equations on
symbols."""

from __future__ import annotations

import os
from functools import cache, lru_cache
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array, times_vector
from cablebot_gym.physics import textbook
from cablebot_gym.physics.rest import motor_start
from cablebot_gym.robots import Robot

TENSION = 50.0
"""Unit of the tensions in the program [N]. It scales the variables to a similar size."""

_FORCE = 50.0
"""Unit of the balance of forces [N]."""

_MOMENT = 5.0
"""Unit of the balance of moments [N·m]."""

_THREADS = "OPENBLAS_NUM_THREADS"
"""Environment variable that the linear algebra of the solver reads on loading."""


def import_casadi() -> Any:
    """Imports CasADi and loads IPOPT.

    Raises:
        ImportError: if it is missing; the message names the command that installs it.
    """
    try:
        import casadi
    except ImportError:
        raise ImportError(
            "planned motions need CasADi: pip install 'cablebot-gym[optimal]'", name="casadi"
        ) from None
    _load_solver(casadi)
    return casadi


@cache
def _load_solver(casadi: Any) -> None:
    """Loads IPOPT with one thread for its linear algebra, because the matrices are small.

    Two threads make a program 20 % slower, and several times slower if each core already runs a
    process.
    """
    before = os.environ.get(_THREADS)
    os.environ[_THREADS] = before or "1"
    try:
        casadi.load_nlpsol("ipopt")
    finally:
        if before is None:
            del os.environ[_THREADS]


def check_model(robot: Robot) -> None:
    """Checks that the program models a robot.

    Raises:
        ValueError: if the motors have a lag.
    """
    if np.any(robot.motor_lag):
        raise ValueError(
            f"planned motions need motors without lag, but the motors of robot {robot.name!r} have a lag"
        )


@lru_cache(maxsize=16)
def rigid_stage(robot: Robot, period: float = 0.0) -> Any:
    """Stage function of a rigid robot.

    The inputs are (X, Ẋ, Ẍ, T/50 N, mass). The outputs are the balance of forces (n) and
    :func:`_actions`.
    """
    ca = import_casadi()
    motion, (x, v, a) = _motion_symbols(ca, robot)
    ts, scaled_tensions = _symbols(ca, "T", robot.cables)
    ms, mass = _symbols(ca, "m", 1)
    tensions = TENSION * scaled_tensions
    speed = textbook.pulley_speed(robot, x, v)
    torque = textbook.required_torques(robot, tensions, x, v, a)
    acceleration = textbook.pulley_acceleration(robot, x, v, a)
    actions = _actions(robot, torque, speed, acceleration, period)
    balance = _balance(robot, mass[0], x, v, a, tensions)
    return _function(ca, "rigid", ca.vertcat(motion, ts, ms), balance, *actions)


@lru_cache(maxsize=16)
def flexible_stage(robot: Robot, period: float = 0.0) -> tuple[Any, Any]:
    """Stage functions of a flexible robot: balance and limits.

    * Balance: from (X, Ẋ, Ẍ, β′, β̇′, β̈′, mass) to the balance of forces (n).
    * Limits: from the same inputs to :func:`_actions`, T/50 N (m) and F/50 N (m) with the forces F
      of the springs, which must not push.
    """
    ca = import_casadi()
    m = robot.cables
    motion, (x, v, a) = _motion_symbols(ca, robot)
    angles, angle = _symbols(ca, "B", m)
    speeds, speed = _symbols(ca, "U", m)
    accelerations, acceleration = _symbols(ca, "W", m)
    ms, mass = _symbols(ca, "m", 1)
    torque, spring_force = textbook.spring_drive(robot, x, v, angle, speed, acceleration)
    if robot.jointed:
        pulley_speed = textbook.pulley_speed(robot, x, v)
        pulley_acceleration = textbook.pulley_acceleration(robot, x, v, a)
        pulley_torque = robot.pulley_inertia * pulley_acceleration + robot.damping * pulley_speed
        tensions = spring_force - pulley_torque / robot.pulley_radius
    else:
        tensions, _ = textbook.cable_springs(robot, x, v, angle, speed, cable="bilateral")
    numbers = ca.vertcat(motion, angles, speeds, accelerations, ms)
    balance = _balance(robot, mass[0], x, v, a, tensions)
    actions = _actions(robot, torque, speed, acceleration, period)
    tensions = tensions / TENSION
    spring_force = spring_force / TENSION
    return (
        _function(ca, "balance", numbers, balance),
        _function(ca, "limits", numbers, *actions, tensions, spring_force),
    )


@lru_cache(maxsize=16)
def start_stage(
    robot: Robot, pose: tuple[float, ...], velocity: tuple[float, ...], masses: tuple[float, ...]
) -> Any:
    """Deviation of the motors of a flexible robot from the start of an episode.

    The inputs are (β′, β̇′, mass). The outputs are β′ − β′₀ (m), where the robot is at rest with
    β′₀, and the difference of the speeds (m) as an action, which scales it. β′₀ is linear in the
    mass between ``masses`` (k,).
    """
    ca = import_casadi()
    bs, angle = _symbols(ca, "B", robot.cables)
    us, speed = _symbols(ca, "U", robot.cables)
    ms, _ = _symbols(ca, "m", 1)
    points = np.array(masses)
    angles, speeds = start_motors(robot, points, np.array(pose), np.array(velocity))
    start_angle = [_piecewise(ca, ms, points, column) for column in angles.T]
    start_speed = [_piecewise(ca, ms, points, column) for column in speeds.T]
    turned = angle - np.array([start_angle])
    speed_difference = speed - np.array([start_speed])
    action = textbook.normalised_action(robot, 0.0, speed_difference)
    return _function(ca, "start", ca.vertcat(bs, us, ms), turned, action)


def start_motors(robot: Robot, mass: Array, pose: Array, velocity: Array) -> tuple[Array, Array]:
    """Motor angles β′ [rad] and speeds β̇′ at the start of an episode with masses (...), each (...,
    m).

    The springs are at rest with the tensions that the environment gives them.
    """
    poses = np.broadcast_to(pose, (*np.shape(mass), robot.coordinates))
    torque = textbook.static_torque(robot, mass, poses)
    start = motor_start(robot, torque, poses, velocity)
    return start.motor_angle, start.speed


def _piecewise(ca: Any, at: Any, points: Array, values: Array) -> Any:
    """Piecewise linear function of a symbol through values at points, extended beyond them."""
    slopes = np.diff(values) / np.diff(points)
    result = values[0] + slopes[0] * (at - points[0])
    for point, change in zip(points[1:-1], np.diff(slopes), strict=True):
        result += change * ca.fmax(at - point, 0.0)
    return result


def _actions(
    robot: Robot, torque: Array, speed: Array, acceleration: Array, period: float
) -> tuple[Array, ...]:
    """Actions for a torque that is constant over a control period, at the motor speeds at its start
    and at its end.

    An action refers to the motor speed at the start of the period. The torque must still be within
    its limits at the end of the period. Each result has shape (1, m). For a period of 0 there is
    only one result.
    """
    if period == 0:
        return (textbook.normalised_action(robot, torque, speed),)
    half = period / 2 * acceleration
    start = textbook.normalised_action(robot, torque, speed - half)
    end = textbook.normalised_action(robot, torque, speed + half)
    return start, end


def derivatives(function: Any) -> tuple[Any, Any]:
    """Jacobian of a function of one vector, and Hessian of the sum of its values weighted by
    multipliers."""
    ca = import_casadi()
    numbers = ca.SX.sym("w", function.size1_in(0))
    values = function(numbers)
    lam = ca.SX.sym("lam", values.shape[0])
    jacobian = ca.densify(ca.jacobian(values, numbers))
    hessian, _ = ca.hessian(ca.dot(lam, values), numbers)
    return (
        ca.Function("first", [numbers], [jacobian]),
        ca.Function("second", [numbers, lam], [ca.densify(hessian)]),
    )


def _motion_symbols(ca: Any, robot: Robot) -> tuple[Any, list[Array]]:
    """A CasADi vector (X, Ẋ, Ẍ), and its three parts for the textbook."""
    vectors = []
    arrays = []
    for name in ("X", "V", "A"):
        vector, array = _symbols(ca, name, robot.coordinates)
        vectors.append(vector)
        arrays.append(array)
    return ca.vertcat(*vectors), arrays


def _symbols(ca: Any, name: str, count: int) -> tuple[Any, Array]:
    """A CasADi vector, and the same vector as a batch of one for the textbook."""
    symbol = ca.SX.sym(name, count)
    return symbol, np.array([ca.vertsplit(symbol)], dtype=object)


def _function(ca: Any, name: str, numbers: Any, *values: Array) -> Any:
    outputs = ca.vertcat(*np.concatenate([value[0] for value in values]))
    return ca.Function(name, [numbers], [outputs], {"cse": True})


def _balance(robot: Robot, mass: Array, x: Array, v: Array, a: Array, tensions: Array) -> Array:
    """Scaled balance of forces D Ẍ + h + Sᵀ T, shape (1, n)."""
    pull = times_vector(textbook.jacobian(robot, x).mT, tensions)
    units = np.full(robot.coordinates, _MOMENT)
    units[: robot.dimensions] = _FORCE
    return (textbook.load(robot, mass, x, v, a) + pull) / units
