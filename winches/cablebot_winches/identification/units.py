"""Questions about units: values that are far from those of the robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_winches.identification.log import Log
from cablebot_winches.identification.regression import CONSTANT, ParameterEstimate

FAR = 5.0
"""Smallest factor between an identified value and that of the robot that is questioned."""

FASTEST = 2.0
"""Largest speed of a motor over the free speed of the robot."""

VOLTAGES = (1.0, 1000.0)
"""Supplies of motors [V]: torque constant times free speed."""


def questions(
    robot: Robot, logs: Sequence[Log], estimates: Sequence[ParameterEstimate]
) -> Iterator[str]:
    """Sentences that ask for units.

    Args:
        robot: robot before the identification.
        logs: logs.
        estimates: identified parameters.
    """
    for log in logs:
        yield from _speeds(robot, log)
        yield from _torques(robot, log)
    for item in estimates:
        if item.name == CONSTANT:
            yield from _constant(robot, item)
            continue
        known = getattr(robot.transmission, item.name, None)
        if known is None or not item.half_width < abs(item.value):
            continue
        value = float(np.mean(np.broadcast_to(known, robot.cables)[list(item.motors)]))
        if value > 0 and not 1 / FAR < item.value / value < FAR:
            yield (
                f"{item.name} of {item.value:.3g} is {item.value / value:.2g} times that of the robot: "
                "are speeds in rad/s (rev/s times 2π), torques in N·m and loads in kg?"
            )


def _speeds(robot: Robot, log: Log) -> Iterator[str]:
    """Questions about speeds that the motors do not reach."""
    for motor, free_speed in enumerate(_free_speeds(robot)):
        column = f"speed_{motor + 1}"
        if column not in log.columns:
            continue
        largest = float(np.nanmax(np.abs(log.columns[column])))
        if largest > FASTEST * free_speed:
            yield (
                f"{log.file}: {column} reaches {largest:.3g} rad/s, and the free speed of the motor is "
                f"{free_speed:.3g} rad/s: is it in rad/s (rpm times 2π/60)?"
            )


def _torques(robot: Robot, log: Log) -> Iterator[str]:
    """Questions about torques that do not hold the hanging masses."""
    for motor in log.motors():
        columns = [f"torque_{motor + 1}", f"load_{motor + 1}"]
        if not log.columns.keys() >= set(columns):
            continue
        torque, load = (np.nanmean(log.columns[column]) for column in columns)
        expected = robot.pulley_radius[motor] * robot.gravity * load
        if expected > 0 and not 1 / FAR < torque / expected < FAR:
            yield (
                f"{log.file}: the mean of {columns[0]} is {torque:.3g} N·m, and its load needs "
                f"{expected:.3g} N·m: is {columns[0]} in N·m, {columns[1]} in kg and pulley_radius in m?"
            )


def _constant(robot: Robot, item: ParameterEstimate) -> Iterator[str]:
    """A question about a torque constant that fits no supply."""
    voltage = item.value * float(np.mean(_free_speeds(robot)[list(item.motors)]))
    least, most = VOLTAGES
    if not least < voltage < most:
        yield (
            f"{item.name} of {item.value:.3g} N·m/A and the free speed of the robot mean a supply of "
            f"{voltage:.2g} V: are currents in A, loads in kg and speeds in rad/s?"
        )


def _free_speeds(robot: Robot) -> Array:
    """Free speeds of the motors, (m,) [rad/s]."""
    return np.broadcast_to(robot.motors.free_speed, robot.cables)
