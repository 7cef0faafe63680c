"""Delay of measured speeds behind the torques: drives filter the speeds that they report.

A filter with the time constant δ is undone by ω + δ ω̇. The torque of friction changes at the
reversals of the true speed, so that reversals tell δ. It minimises the residual of the drive
equation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_winches.identification.log import Log
from cablebot_winches.identification.regression import jackknife_half_width
from cablebot_winches.identification.samples import Samples, drive_samples

LARGEST = 0.02
"""Largest uncertainty of the delay [s]: filters of drives are hardly slower. Logs that do not
determine it better, because their speeds are constant, have the delay zero."""

STEP = 0.004
"""Step of the search [s]."""

ITERATIONS = 5
"""Largest number of steps to the minimum of a parabola."""

RESOLUTION = 0.1
"""Least half width of the interval of the delay over the sampling period. The filter of the signals
changes the shape of a reversal, and with it the delay."""

NEGLIGIBLE = 2e-4
"""Change of the delay with which the search ends [s]."""


def speed_delay(robot: Robot, logs: Sequence[Log], payload: float) -> tuple[float, float]:
    """Delay of the speeds of all logs and the half width of its interval [s]: zero without a column
    of a speed."""
    columns = {column for log in logs for column in log.columns}
    if not any(column.startswith("speed_") for column in columns):
        return 0.0, 0.0
    delay = 0.0
    for _ in range(ITERATIONS):
        squares = _squares(robot, logs, payload, delay)
        change = _minimum(squares.sum(axis=0))
        delay += change
        if abs(change) < NEGLIGIBLE:
            break
    changes = squares.sum(axis=0) - squares
    half_width = jackknife_half_width([_minimum(others) for others in changes])
    if not half_width < LARGEST:
        return 0.0, LARGEST
    period = max(float(np.median(np.diff(log.columns["time"]))) for log in logs)
    return delay, max(half_width, RESOLUTION * period)


def _squares(robot: Robot, logs: Sequence[Log], payload: float, delay: float) -> Array:
    """Sums of the squared residuals in each block, (B, 3), with delays one step before ``delay``,
    at it, and one step after it."""
    columns = []
    for value in (delay - STEP, delay, delay + STEP):
        delayed = [replace(log, delay=value) for log in logs]
        samples = drive_samples(robot, delayed, payload, friction_speed=-np.inf)
        columns.append(np.bincount(samples.block, _residual(samples) ** 2))
    return np.stack(columns, axis=1)


def _residual(samples: Samples) -> Array:
    """Residual of the drive equation with parameters for each motor [N·m], (N,)."""
    count = len(samples.response)
    columns = [samples.regressors.reshape(count, -1)]
    target = samples.response - samples.known
    if samples.is_current:
        target = -samples.known
        motors = np.unique(samples.motor)
        columns.append(-samples.response[:, None] * (samples.motor[:, None] == motors))
    regressors = np.hstack(columns)
    regressors = regressors[:, np.any(regressors, axis=0)]
    solution = np.linalg.lstsq(regressors, target, rcond=None)[0]
    return target - regressors @ solution


def _minimum(squares: Array) -> float:
    """Where a parabola through three equidistant points has its minimum [s], at most two steps
    away."""
    before, middle, after = squares
    curvature = before - 2 * middle + after
    slope = (after - before) / 2
    if curvature <= 0:
        return -2 * STEP * float(np.sign(slope))
    return STEP * float(np.clip(-slope / curvature, -2, 2))
