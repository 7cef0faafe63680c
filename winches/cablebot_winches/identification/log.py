"""Logs of winches as CSV files, and their smooth signals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, minimum_filter1d

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import COORDINATE_NAMES, Robot
from cablebot_gym.utils.csv_table import Table, column_name, read_table

COLUMNS = {
    "time": ("s", "time, which increases"),
    "angle_i": ("rad", "angle of motor i; it grows while the cable winds up"),
    "speed_i": ("rad/s", "speed of motor i; without it, the derivative of the angle"),
    "torque_i": ("N·m", "torque of motor i; positive pulls the cable"),
    "current_i": ("A", "current of motor i in place of its torque"),
    "load_i": ("kg", "mass that hangs on cable i, hook included"),
    "tension_i": ("N", "measured tension of cable i"),
    "x, y, …": ("m, rad", "measured pose of the platform: x, y, z, psi, theta, phi by the robot"),
    "payload": ("kg", "payload of the platform; without it, that of `--payload`"),
}
"""Unit and meaning of the columns of a log. i counts the motors from 1."""

SMOOTHING = 0.01
"""Standard deviation of the Gaussian filter of all signals and their derivatives [s], at least a
sampling period.

All signals have the same filter, which keeps a linear equation exact. The filters of Savitzky and
Golay are different ones for a signal and its derivatives: they lose more of an acceleration than of
a torque.
"""

ANGLE_SMOOTHING = 0.03
"""The same where speeds are derivatives of angles. The noise of their second derivative would hide
the inertia."""

CLEAR = 4.0
"""Speed from which the direction of friction is clear, over the ``friction_speed`` of the robot:
there, smooth friction and dry friction, which winches have, differ by 3 %."""

CUT = 4
"""Half width of the filter over its standard deviation."""

LONGEST_PERIOD = 0.5
"""Longest sampling period [s]: a longer one is in ms."""

GAP = 5.0
"""A pause of more than so many median sampling periods divides a log."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Log(Table):
    """Columns of a log."""

    file: str = ""
    """Name of the file, for sources and figures."""
    delay: float = 0.0
    """Time constant with which the drives filter the speeds [s]; the segments undo it."""

    def motors(self) -> list[int]:
        """Indices of the motors with torque or current.

        Raises:
            ValueError: if a motor has both.
        """
        motors = set()
        for column in self.columns:
            quantity, _, number = column.partition("_")
            if quantity in ("torque", "current"):
                motors.add(int(number) - 1)
        for motor in motors:
            if {f"torque_{motor + 1}", f"current_{motor + 1}"} <= self.columns.keys():
                raise ValueError(
                    f"{self.name}: motor {motor + 1} has torque and current; remove one of them"
                )
        return sorted(motors)

    def require(self, *columns: str, purpose: str) -> None:
        """Checks that there are columns.

        Raises:
            ValueError: if one is missing; the message names all missing ones.
        """
        missing = [column for column in columns if column not in self.columns]
        if missing:
            raise ValueError(
                f"{self.name}: {purpose} needs the columns {', '.join(missing)}; add them to the "
                f"first line. It has {', '.join(self.columns)}"
            )

    def segments(self, columns: Sequence[str]) -> Iterator[Segment]:
        """Stretches without gaps at a constant sampling period, from the rows where all of the
        columns have values.

        Raises:
            ValueError: if a column has no values, or no stretch has twice the window.
        """
        columns = ["time", *columns]
        for column in columns:
            if np.count_nonzero(np.isfinite(self.columns[column])) < 2:
                raise ValueError(f"{self.name}: {column} has no values. Remove or fill the column")
        table = np.stack([self.columns[column] for column in columns], axis=1)
        table = table[np.isfinite(table).all(axis=1)]
        if len(table) < 2:
            raise ValueError(f"{self.name}: no line has values of all of {', '.join(columns)}")
        steps = np.diff(table[:, 0])
        period = float(np.median(steps))
        edges = [0, *(np.flatnonzero(steps > GAP * period) + 1), len(table)]
        smoothing = SMOOTHING
        if has_angles_alone(columns):
            smoothing = ANGLE_SMOOTHING
        width = max(1.0, smoothing / period)
        least = 2 * window_samples(width)
        are_all_short = True
        for start, stop in pairwise(edges):
            rows = table[start:stop]
            grid = np.arange(rows[0, 0], rows[-1, 0] + period / 2, period)
            if len(grid) < least:
                continue
            are_all_short = False
            values = {}
            for index, column in enumerate(columns):
                values[column] = np.interp(grid, rows[:, 0], rows[:, index])
            yield Segment(period=period, width=width, delay=self.delay, columns=values)
        if are_all_short:
            raise ValueError(
                f"{self.name}: no stretch without gaps has {least} samples, the least for a derivative"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """A stretch of a log at a constant sampling period."""

    period: float
    """Sampling period [s]."""
    width: float
    """Standard deviation of the filter [samples]."""
    delay: float
    """Time constant with which the drives filter the speeds [s]."""
    columns: Mapping[str, Array]
    """Values by the name of the column, each (K,)."""

    def smooth(self, column: str, derivative: int = 0) -> Array:
        """A smoothed column or its derivative, without both ends, which have no full window."""
        signal: Array = gaussian_filter1d(self.columns[column], self.width, truncate=CUT)
        for _ in range(derivative):
            rate = np.gradient(signal, self.period)
            # Central differences flatten a sine; what they lack is a sixth of two more of them.
            signal = rate - np.gradient(np.gradient(rate)) / 6
        margin = window_samples(self.width) // 2
        return signal[margin:-margin]

    def moves(self, motor: int, friction_speed: float) -> NDArray[np.bool_]:
        """Where friction has its full size throughout the window of the filter, which would blur a
        reversal: the motor is :data:`CLEAR` times faster than the speed [rad/s] at which its
        friction is smooth. A slow motor is faster than that speed and than a part of its largest."""
        speed, _ = self.motion(motor)
        largest = float(np.max(np.abs(speed)))
        least = max(friction_speed, min(CLEAR * friction_speed, largest / CLEAR))
        window = window_samples(self.width)
        forward = minimum_filter1d(speed, window) > least
        backward = maximum_filter1d(speed, window) < -least
        return forward | backward

    def motion(self, motor: int) -> tuple[Array, Array]:
        """Speed [rad/s] and acceleration [rad/s²] of a motor."""
        column = f"speed_{motor + 1}"
        if column in self.columns:
            speed, acceleration, jerk = (self.smooth(column, order) for order in range(3))
            return speed + self.delay * acceleration, acceleration + self.delay * jerk
        column = f"angle_{motor + 1}"
        return self.smooth(column, 1), self.smooth(column, 2)


def window_samples(width: float) -> int:
    """Odd number of samples of the window of a filter with a standard deviation in samples."""
    return 2 * round(CUT * width) + 1


def has_angles_alone(columns: Sequence[str]) -> bool:
    """Whether a motor has an angle and no speed among the columns."""
    angles = [column for column in columns if column.startswith("angle_")]
    return any(angle.replace("angle", "speed") not in columns for angle in angles)


def pose_columns(robot: Robot) -> list[str]:
    """Names of the columns of the pose."""
    return [column_name(symbol) for symbol in COORDINATE_NAMES[robot.kind]]


def column_units(robot: Robot) -> dict[str, str]:
    """Units of all columns that a log of a robot may have, by their names."""
    units = {}
    for column, (unit, _) in COLUMNS.items():
        if column.endswith("_i"):
            for motor in range(robot.cables):
                units[f"{column[:-1]}{motor + 1}"] = unit
        elif column == "x, y, …":
            for index, name in enumerate(pose_columns(robot)):
                units[name] = "m" if index < robot.dimensions else "rad"
        else:
            units[column] = unit
    return units


def read_log(path: str | Path, robot: Robot) -> Log:
    """A log from a CSV file whose first line names the columns in any order.

    Lines that repeat the line before are left out.

    Raises:
        ValueError: if the file cannot be read, a column is unknown or missing, a cell is no number,
            or the time does not increase. The message names the file and the line.
    """
    path = Path(path)
    table = read_table(path, "log", column_units(robot))
    is_new = np.zeros(len(table.lines), bool)
    is_new[:1] = True
    for values in table.columns.values():
        both_empty = np.isnan(values[1:]) & np.isnan(values[:-1])
        is_new[1:] |= (values[1:] != values[:-1]) & ~both_empty
    log = Log(
        name=table.name,
        file=path.name,
        columns={name: values[is_new] for name, values in table.columns.items()},
        lines=tuple(line for line, new in zip(table.lines, is_new, strict=True) if new),
    )
    log.require("time", purpose="a log")
    log.refuse("time", np.isnan(log.columns["time"]), ". Each line needs a time")
    log.refuse_decrease("time", np.arange(len(log.lines)))
    steps = np.diff(log.columns["time"])
    if len(steps) and np.median(steps) > LONGEST_PERIOD:
        raise ValueError(
            f"{log.name}: time grows by {np.median(steps):g} a line. It must be in s: divide "
            "milliseconds by 1000"
        )
    return log
