"""Limits of a drive, whose violation stops all winches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number, whole

SLACK_TIME = 0.1
"""Longest time below the least tension [s], as in the environments."""


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """Limits of a drive. None stands for the value of the robot.

    The pose, which follows from the motor angles, must also stay in the robot's workspace, and no
    axis may report an error.

    Raises:
        ValueError: if a value is invalid.
    """

    torque_limit: Annotated[
        float,
        "Largest torque as a fraction of what the motor has at its speed; at 1, larger actions are clipped, as "
        "in the environments.",
    ] = 1.0
    speed_limit: Annotated[
        float | None, "Largest motor speed [rad/s]. The default is the free speed of the motors."
    ] = None
    error_limit: Annotated[
        float, "Largest position error as a multiple of the position bound of the task."
    ] = 5.0
    least_tension: Annotated[
        float | None,
        "Least cable tension [N], judged by the torque of the motor after friction. The default is that of the "
        "robot.",
    ] = None
    slack_limit: Annotated[
        float, "Longest time below the least tension [s]. Shorter dips accelerate the drum."
    ] = SLACK_TIME
    lost_limit: Annotated[
        int, "Number of successive control periods without a valid reply of a winch that stop."
    ] = 2
    late_limit: Annotated[
        int, "Number of successive control periods that end too late that stop."
    ] = 5
    watchdog: Annotated[
        float, "Time without a command after which a board disarms its motors [s]."
    ] = 0.1

    def __post_init__(self) -> None:
        number("torque_limit", self.torque_limit, above=0, most=1)
        for name in ("speed_limit", "error_limit", "watchdog"):
            if getattr(self, name) is not None:
                number(name, getattr(self, name), above=0)
        number("slack_limit", self.slack_limit, least=0, unit="s")
        for name in ("lost_limit", "late_limit"):
            whole(name, getattr(self, name), least=1)


@dataclass(frozen=True, kw_only=True)
class Stop:
    """Why and when a drive stopped before the end of its motion."""

    cause: str
    """Cause in words, such as ``motor speed``."""
    time: float
    """Time since the start of the motion [s]."""
    winch: int | None = None
    """Winch at fault, from 1; None if it is none alone."""

    def __str__(self) -> str:
        at = f"at t = {self.time:.3f} s"
        if self.winch is None:
            return f"{self.cause} {at}"
        return f"{self.cause} of winch {self.winch} {at}"


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveMoment:
    """Quantities of one control period that have limits."""

    time: float
    """Time since the start of the motion [s]."""
    action: Array
    """Actions, clipped to ±1, (m,)."""
    torque: Array
    """Commanded torques, (m,) [N·m]."""
    speed: Array
    """Larger one of the reported motor speed and the change of the angle over time, (m,) [rad/s]."""
    pose: Array
    """Estimated pose X, (n,)."""
    tracking_error: float
    """Distance of the estimated position from the reference [m]."""


class Guard:
    """Compares each control period with the limits.

    Args:
        limits: the limits.
        task: the task.
    """

    def __init__(self, limits: DriveLimits, task: Task) -> None:
        robot = task.robot
        self._limits = limits
        self._robot = robot
        self._period = 1 / task.control_frequency
        self._largest_speed = robot.per_motor(limits.speed_limit or robot.motors.free_speed)
        self._largest_error = limits.error_limit * task.error_bounds.position
        self._least_torque = np.full(robot.cables, -np.inf)
        if task.cable == "unilateral":
            self._least_torque = _least_torque(robot, limits.least_tension)
        self._low_for = np.zeros(robot.cables)

    def check(self, moment: DriveMoment) -> Stop | None:
        """The first limit that is violated in a control period; None if there is none."""
        limits = self._limits
        low, high = self._robot.pose_bounds
        self._low_for += self._period
        self._low_for[moment.torque >= self._least_torque] = 0.0
        exceeds_torque = np.zeros(self._robot.cables, np.bool_)
        if limits.torque_limit < 1:
            exceeds_torque = np.abs(moment.action) > limits.torque_limit
        violations: dict[str, NDArray[np.bool_]] = {
            "torque limit": exceeds_torque,
            "motor speed limit": ~(moment.speed <= self._largest_speed),
            "too little tension": self._low_for > limits.slack_limit + self._period / 2,
        }
        for cause, violated in violations.items():
            if violated.any():
                return Stop(cause=cause, time=moment.time, winch=int(np.argmax(violated)) + 1)
        # Comparisons with NaN are false: a pose that is not known violates the limits.
        if not (moment.tracking_error <= self._largest_error):
            return Stop(cause="position error limit", time=moment.time)
        if not np.all((low <= moment.pose) & (moment.pose <= high)):
            return Stop(cause="workspace left", time=moment.time)
        return None


def _least_torque(robot: Robot, tension: float | None) -> Array:
    """Motor torques at which slowly unwinding cables have the least tension, (m,) [N·m]. Friction
    holds the rest."""
    if tension is None:
        tension = robot.minimum_tension
    torque = robot.pulley_radius * tension * (1 - robot.load_friction) - robot.coulomb_friction
    return np.asarray(torque)
