"""Torque on the pulleys in a control period, and its errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.estimation.kalman import Columns, KalmanState
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot

Array = NDArray[Any]

_FRACTIONS = ((np.arange(8) + 0.5) / 8)[:, None, None]
"""Instants of a control period, as fractions."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PulleyTorque:
    """Mean torque on the pulleys in a control period."""

    torque: Array
    """Torque with its estimated errors, (N, m) [N·m]."""
    motor: Array
    """Torque of the motors without errors, (N, m) [N·m]."""
    errors: list[tuple[slice, Array]]
    """Columns of the state that are errors of the torque, each with the torque per unit of the
    error, (m,) or (N, m)."""


def pulley_torque(
    robot: Robot,
    blocks: dict[str, Array],
    state: KalmanState,
    mean: Array,
    columns: Columns,
    period: float,
) -> PulleyTorque:
    """Torque on the pulleys in the last control period.

    It is the torque of the motors; of a flexible robot, the torque of the springs by the torque
    balance of the motors.

    Args:
        robot: nominal robot with joint springs in place of elastic cables.
        blocks: blocks of the observation, each (N, size).
        state: state at the last observation.
        mean: predicted errors, (N, k).
        columns: columns of ``mean``.
        period: control period [s].
    """
    speed = blocks["motor_speed"]
    acceleration = (speed - state.speed) / period
    motor = _motor_torque(robot, blocks, state)
    torque = motor
    errors: list[tuple[slice, Array]] = [
        (columns.torque, np.ones(robot.cables)),
        (columns.strength, motor),
        (columns.lag, -(motor - state.motor_torque) / period),
    ]
    if robot.flexible:
        mean_speed = (speed + state.speed) / 2
        friction = textbook.motor_friction(robot, mean_speed, 0.0)
        torque = torque - robot.motor_inertia * acceleration - friction
        torque = torque / (1 + textbook.load_friction(robot, mean_speed))
        # The noise of a speed enters the balances of two periods, with opposite signs. The drive
        # computes its torque from the speed at the start of the period.
        inertia, damping = robot.motor_inertia / period, robot.motor_damping / 2
        errors += [
            (columns.rotor, -robot.motor_inertia * acceleration),
            (columns.noise, inertia + damping),
            (columns.last_noise, robot.speed_slope + damping - inertia),
        ]
    errors = [(part, factor) for part, factor in errors if part.stop > part.start]
    for part, factor in errors:
        torque = torque + factor * mean[:, part]
    return PulleyTorque(torque=torque, motor=motor, errors=errors)


def _motor_torque(robot: Robot, blocks: dict[str, Array], state: KalmanState) -> Array:
    """Mean torque of the motors in the last control period, (N, m) [N·m]."""
    speed = blocks["motor_speed"]
    action = np.clip(blocks["last_actions"][:, : robot.cables], -1.0, 1.0)
    # The request is constant over the period; the torque-speed line clips it at the changing speed.
    request = robot.stall_torque * action - robot.speed_slope * state.speed
    drop = robot.speed_slope * (state.speed + _FRACTIONS * (speed - state.speed))
    clipped = np.clip(request, -robot.stall_torque - drop, robot.stall_torque - drop)
    return np.asarray(np.mean(clipped, axis=0))
