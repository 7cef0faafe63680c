"""What has to be true at one instant of a motion, as CasADi functions: the textbook's equations on symbols."""

from __future__ import annotations

import os
from functools import cache, lru_cache
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot

TENSION = 50.0
"""Tensions are in units of so many newtons, which makes the program's numbers alike."""

_WRENCH = np.array([50.0, 50.0, 50.0, 5.0, 5.0, 5.0])
"""The same for balances of forces [N] and moments [N·m]."""

_THREADS = "OPENBLAS_NUM_THREADS"
"""Read by the solver's linear algebra when it is loaded."""


def import_casadi() -> Any:
    """CasADi.

    Raises:
        ImportError: if it is missing; the message names the command that installs it.
    """
    try:
        import casadi
    except ImportError:
        raise ImportError("planned motions need CasADi: pip install 'cablebot-gym[optimal]'", name="casadi") from None
    _load_solver(casadi)
    return casadi


@cache
def _load_solver(casadi: Any) -> None:
    """Loads IPOPT with one thread for its linear algebra, whose matrices are too small for more.

    Two threads make a program a fifth slower, and several times where each core already has a process.
    """
    before = os.environ.get(_THREADS)
    os.environ[_THREADS] = before or "1"
    try:
        casadi.load_nlpsol("ipopt")
    finally:
        if before is None:
            del os.environ[_THREADS]


@lru_cache(maxsize=16)
def rigid_instant(robot: Robot, period: float = 0.0) -> Any:
    """Of (X, Ẋ, Ẍ, T/50 N, mass): balance of forces (n), then :func:`_commands`, of a rigid robot."""
    ca = import_casadi()
    n, m = robot.coordinates, robot.cables
    (xs, x), (vs, v), (as_, a), (ts, t), (ms, mass) = (
        _symbols(ca, name, size) for name, size in (("X", n), ("V", n), ("A", n), ("T", m), ("m", 1))
    )
    tensions, speed = TENSION * t, textbook.pulley_speed(robot, x, v)
    torque = textbook.required_torques(robot, tensions, x, v, a)
    commands = _commands(robot, torque, speed, textbook.pulley_acceleration(robot, x, v, a), period)
    balance = _balance(robot, mass[0], x, v, a, tensions)
    return _function(ca, "rigid", ca.vertcat(xs, vs, as_, ts, ms), balance, *commands)


@lru_cache(maxsize=16)
def flexible_instant(robot: Robot, period: float = 0.0) -> tuple[Any, Any, Any]:
    """Balance, limits and start of a flexible robot.

    Of (X, Ẋ, Ẍ, β′, β̇′, β̈′, mass): balance of forces (n); :func:`_commands`, T/50 N (m) and κ/r/50 N (m), for
    springs do not push. Of (X, Ẋ, β′, β̇′, mass): balance at rest (n), then β̇′ − β̇ (m), which an episode starts with.
    """
    ca = import_casadi()
    n, m = robot.coordinates, robot.cables
    (xs, x), (vs, v), (as_, a), (bs, b), (us, u), (ws, w), (ms, mass) = (
        _symbols(ca, name, size)
        for name, size in (("X", n), ("V", n), ("A", n), ("B", m), ("U", m), ("W", m), ("m", 1))
    )
    spring = robot.stiffness * (b - textbook.pulley_angle(robot, x))
    speed, winding = textbook.pulley_speed(robot, x, v), textbook.pulley_acceleration(robot, x, v, a)
    tensions = (spring - robot.pulley_inertia * winding - robot.damping * speed) / robot.pulley_radius
    wound = spring / robot.pulley_radius
    torque = spring + robot.motor_inertia * w + robot.motor_damping * u
    still = np.zeros((1, n))
    at_rest = _balance(robot, mass[0], x, still, still, wound)
    numbers = ca.vertcat(xs, vs, as_, bs, us, ws, ms)
    return (
        _function(ca, "balance", numbers, _balance(robot, mass[0], x, v, a, tensions)),
        _function(ca, "limits", numbers, *_commands(robot, torque, u, w, period), tensions / TENSION, wound / TENSION),
        # A difference of speeds, in units of what the motors give up to it.
        _function(ca, "start", ca.vertcat(xs, vs, bs, us, ms), at_rest, textbook.drive_command(robot, 0.0, u - speed)),
    )


def _commands(robot: Robot, torque: Array, speed: Array, acceleration: Array, period: float) -> tuple[Array, ...]:
    """Drive commands for a torque that is held for a period, at the motors' speeds when it begins and when it ends.

    A command asks for a torque by the speed at the period's beginning; at its end it must not be clipped. Each is
    (1, m); without a period both are one.
    """
    half = period / 2 * acceleration
    speeds = (speed - half, speed + half) if period > 0 else (speed,)
    return tuple(textbook.drive_command(robot, torque, one) for one in speeds)


def derivatives(function: Any) -> tuple[Any, Any]:
    """The Jacobian of a function of one vector, and the Hessian of its values' sum with multipliers."""
    ca = import_casadi()
    numbers = ca.SX.sym("w", function.size1_in(0))
    values = function(numbers)
    lam = ca.SX.sym("lam", values.shape[0])
    first = ca.Function("first", [numbers], [ca.densify(ca.jacobian(values, numbers))])
    second = ca.Function("second", [numbers, lam], [ca.densify(ca.hessian(ca.dot(lam, values), numbers)[0])])
    return first, second


def _symbols(ca: Any, name: str, count: int) -> tuple[Any, Array]:
    """A CasADi vector, and the same as a batch of one for the textbook."""
    symbol = ca.SX.sym(name, count)
    return symbol, np.array([ca.vertsplit(symbol)], dtype=object)


def _function(ca: Any, name: str, numbers: Any, *values: Array) -> Any:
    return ca.Function(name, [numbers], [ca.vertcat(*(item for value in values for item in value[0]))], {"cse": True})


def _balance(robot: Robot, mass: Array, x: Array, v: Array, a: Array, tensions: Array) -> Array:
    """D Ẍ + h + Sᵀ T, scaled, (1, n)."""
    pull = (np.swapaxes(textbook.jacobian(robot, x), -1, -2) @ tensions[..., None])[..., 0]
    return (textbook.load(robot, mass, x, v, a) + pull) / _WRENCH[: robot.coordinates]
