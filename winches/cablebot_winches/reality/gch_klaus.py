"""Cable lengths of the library robot ``gch-klaus``: the robot's own log against motion capture.

The geometry of the model gives the cable lengths at the captured poses. Their registration and
calibration are fitted to one half of the samples and judged on the other half, both ways.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from cablebot_gym.kinematics import Array, cable_lengths
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.utils.palette import BLACK, BLUE, GREEN, GREY, VERMILLION
from cablebot_winches.reality.comparison import LogComparison, Validation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOG = "analysis/gerry00_estimation/13_concentric_diamonds_1mps_cal"
"""Path of both files without their suffixes."""

CARRIAGE = "Rigid Body 2_"
"""Start of the names of the carriage's markers."""

HEADER = 7
"""Lines above the samples of the capture."""

PERIOD = 0.01
"""Sampling period of the robot's log [s]."""

BLOCK = 100
"""Samples of a block: blocks alternate between the halves, so that both see all of the
workspace."""

GOAL = 0.005
"""Largest RMS deviation of a length [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotLog:
    """The robot's own record at K instants."""

    position: Array
    """Its estimate of the position, x to the right and y up, (K, 2) [m]."""
    lengths: Array
    """Its cable lengths, (K, m) [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """Planar motion of the carriage in the frame of the motion capture at K instants."""

    time: Array
    """Times, (K,) [s]."""
    pose: Array
    """Position, x to the right and y down, and rotation, (K, 3) [m, rad]."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """What a calibration may change besides the registration and an offset per cable."""

    name: str
    """The fit in words."""
    has_scale: bool = True
    """Whether each cable has a scale of its length."""
    has_size: bool = False
    """Whether width and height of the frame are fitted."""
    goal: float | None = GOAL
    """Largest RMS deviation of a length [m]; None for information."""


OFFSET = Fit(name="offset per cable", has_scale=False, goal=None)
SCALE = Fit(name="offset and scale per cable")
SIZE = Fit(name="the same and size of the frame", has_size=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """A calibration of the lengths on a part of the samples."""

    size: Array
    """Width and height of the frame over those of the model."""
    scale: Array
    """Logged over modelled length of each cable, (m,)."""
    error: Array
    """Logged minus calibrated length of all samples, (K, m) [m]."""


def validate(logs: Mapping[str, bytes]) -> Validation:
    """Compares the cable lengths of the robot with those of its model."""
    robot = find_robot("gch-klaus")
    log = read_log(logs[f"{LOG}.txt"])
    capture = aligned(read_capture(logs[f"{LOG}.csv"]), log)
    comparisons = [_estimate(capture, log)]
    errors = {}
    for fit in (OFFSET, SCALE, SIZE):
        halves = both_halves(robot, capture.pose, log.lengths, fit)
        unseen = errors_of_unseen_half(halves)
        errors[fit.name] = unseen
        quantity = f"RMS of cable lengths, {fit.name}"
        comparisons.append(
            LogComparison(quantity=quantity, unit="m", robot=rms(unseen), goal=fit.goal)
        )
    sides = np.ptp(robot.base, axis=0)
    fitted = sides * np.mean([half.size for half in halves], axis=0)
    radius = robot.pulley_radius.mean()
    # The robot computes lengths with its nominal radius: they are too long if the drum is smaller.
    drum = radius / np.mean([half.scale for half in halves])
    quantities = ("width of the frame", "height of the frame", "drum radius")
    models = (*sides, radius)
    values = (*fitted, drum)
    for quantity, model, value in zip(quantities, models, values, strict=True):
        comparison = LogComparison(
            quantity=f"{quantity}, fitted",
            unit="m",
            model=float(model),
            robot=float(value),
        )
        comparisons.append(comparison)
    tilt = np.degrees(np.ptp(capture.pose[:, 2]))
    return Validation(
        comparisons=tuple(comparisons),
        notes=(
            f"All {len(log.lengths):,} samples of the robot's log are judged, each by the "
            "calibration on the half without it.",
            f"The carriage tilts by {tilt:.1f}° in all.",
        ),
        draw=partial(draw, robot, capture.pose, fitted, errors),
    )


def read_log(text: bytes) -> RobotLog:
    """The robot's log: lines with the estimated and desired position, then error, state, negative
    length and speed of each cable."""
    rows = np.loadtxt(io.BytesIO(text), comments="S", usecols=(1, 2, 9, 14, 19, 24))
    return RobotLog(position=rows[:, :2], lengths=-rows[:, 2:])


def read_capture(text: bytes) -> Capture:
    """Planar motion of the carriage from an OptiTrack export: mean and tilt of its four markers,
    with z to the right and y up.

    The markers of a level rectangle are sorted in each sample, because the export exchanges their
    names in some.
    """
    head = io.StringIO(text.decode("utf-8")).readlines()[:HEADER]
    names = list(csv.reader(head))[3]
    columns = [1]  # the time
    for column, name in enumerate(names):
        if name.startswith(CARRIAGE):
            columns.append(column)
    rows = np.loadtxt(io.BytesIO(text), delimiter=",", skiprows=HEADER, usecols=columns)
    markers = rows[:, 1:].reshape(len(rows), -1, 3)
    right = markers[..., 2]
    down = -markers[..., 1]
    from_left = np.argsort(right, axis=1)
    tilt = np.arctan2(_across(down, from_left), _across(right, from_left))
    x = right.mean(axis=1)
    y = down.mean(axis=1)
    return Capture(time=rows[:, 0], pose=np.stack([x, y, tilt], axis=1))


def _across(coordinate: Array, from_left: NDArray[np.int64]) -> Array:
    """Mean coordinate of the right markers less that of the left ones, (K,) [m]."""
    ordered: Array = np.take_along_axis(coordinate, from_left, axis=1)
    mean_left = ordered[:, :2].mean(axis=1)
    mean_right = ordered[:, 2:].mean(axis=1)
    return mean_right - mean_left


def aligned(capture: Capture, log: RobotLog) -> Capture:
    """The capture at the instants of the robot's log, with the clock shift at which both positions
    correlate best. The capture starts before the log and ends after it."""
    time = PERIOD * np.arange(len(log.position))
    logged = log.position @ [1, 1j]

    def shifted(shift: float) -> Array:
        columns = [np.interp(time + shift, capture.time, column) for column in capture.pose.T]
        return np.stack(columns, axis=1)

    def cost(shift: float) -> float:
        # The frame may be turned in the capture: the magnitude of the correlation of positions as
        # complex numbers does not change with it. y points down here and up in the log.
        captured = shifted(shift)[:, :2] @ [1, -1j]
        correlation = np.corrcoef(captured, logged)[0, 1]
        return -float(np.abs(correlation))

    # The cost has several minima: the best shift of a coarse grid is refined.
    coarse = 5 * PERIOD
    latest = capture.time[-1] - time[-1]
    shifts = np.arange(0.0, latest, coarse)
    near = min(shifts.tolist(), key=cost)
    bounds = (near - coarse, near + coarse)
    best = minimize_scalar(cost, bounds=bounds, method="bounded")
    return Capture(time=time, pose=shifted(float(best.x)))


def calibrate(robot: Robot, pose: Array, lengths: Array, chosen: Array, fit: Fit) -> Calibration:
    """Fits a calibration to the chosen samples by least squares.

    The pose of the frame in the capture and, by ``fit``, its size are nonlinear. Offsets and scales
    are linear and follow from them.

    Args:
        robot: the robot, whose base gives the frame.
        pose: captured poses, (K, 3).
        lengths: logged lengths, (K, m).
        chosen: whether each sample is used, (K,).
        fit: what is fitted.
    """

    def calibrated(values: Array) -> Calibration:
        size = np.ones(2)
        if fit.has_size:
            size = values[3:]
        base = robot.base * size
        poses_in_frame = in_frame(pose, values[:3])
        model = cable_lengths(base, robot.platform, poses_in_frame)
        scale = np.ones(robot.cables)
        if fit.has_scale:
            deviations = model[chosen] - model[chosen].mean(axis=0)
            products = deviations * lengths[chosen]
            squares = np.square(deviations)
            scale = products.sum(axis=0) / squares.sum(axis=0)
        error = lengths - scale * model
        error = error - error[chosen].mean(axis=0)
        return Calibration(size=size, scale=scale, error=error)

    def residuals(values: Array) -> Array:
        return calibrated(values).error[chosen].ravel()

    start = np.zeros(3)
    start[:2] = pose[:, :2].mean(axis=0)
    if fit.has_size:
        start = np.append(start, np.ones(2))
    best = least_squares(residuals, start)
    return calibrated(best.x)


def in_frame(pose: Array, frame: Array) -> Array:
    """Poses in a frame with the position and rotation ``frame``."""
    x, y, angle = (pose - frame).T
    rotation = frame[2]
    cosine = np.cos(rotation)
    sine = np.sin(rotation)
    along = cosine * x + sine * y
    across = cosine * y - sine * x
    return np.stack([along, across, angle], axis=1)


def both_halves(robot: Robot, pose: Array, lengths: Array, fit: Fit) -> list[Calibration]:
    """The calibrations on the even and on the odd blocks."""
    even = first_half(len(lengths))
    return [calibrate(robot, pose, lengths, half, fit) for half in (even, ~even)]


def first_half(samples: int) -> Array:
    """Whether each sample is in an even block."""
    return np.arange(samples) // BLOCK % 2 == 0


def errors_of_unseen_half(halves: list[Calibration]) -> Array:
    """Error of each sample by the calibration without it, (K, m) [m]."""
    on_even, on_odd = halves
    even = first_half(len(on_even.error))
    return np.where(even[:, None], on_odd.error, on_even.error)


def rms(errors: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(errors**2)))


def _estimate(capture: Capture, log: RobotLog) -> LogComparison:
    """Distance of the robot's own estimate from the capture."""
    captured = capture.pose[:, :2] * [1, -1]
    difference = log.position - captured
    difference -= difference.mean(axis=0)
    return LogComparison(
        quantity="RMS of the robot's own position estimate, means removed",
        unit="m",
        robot=rms(np.linalg.norm(difference, axis=1)),
    )


def draw(robot: Robot, pose: Array, fitted: Array, errors: Mapping[str, Array]) -> Figure:
    """Draws the captured path with the frames of model and fit, and the errors of the lengths."""
    from matplotlib.patches import Rectangle

    from cablebot_gym.plotting.figures import add_legend, new_figure

    figure = new_figure(4.4)
    path, over_time = figure.subplots(1, 2, width_ratios=[1, 1.3])
    position = pose[:, :2]
    centre = (position.max(axis=0) + position.min(axis=0)) / 2
    x, y = (position - centre).T
    path.plot(x, y, color=BLUE, linewidth=1.2, label="captured path")

    def add_frame(size: Array, style: str, label: str) -> None:
        width, height = size
        corner = (-width / 2, -height / 2)
        frame = Rectangle(corner, width, height, fill=False, linestyle=style, label=label)
        path.add_patch(frame)

    add_frame(np.ptp(robot.base, axis=0), "--", "frame of the model")
    add_frame(fitted, "-", "frame, fitted")
    path.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-1.7, 1.7), ylim=(1.4, -1.4))
    time = PERIOD * np.arange(len(pose))
    for (name, error), colour in zip(errors.items(), (GREY, VERMILLION, GREEN), strict=True):
        per_sample = 1e3 * np.sqrt(np.mean(error**2, axis=1))
        over_time.plot(time, per_sample, color=colour, linewidth=1.2)
        path.plot([], [], color=colour, label=name)  # for the legend
    goal = {"color": BLACK, "linewidth": 1.0, "linestyle": ":"}
    over_time.axhline(1e3 * GOAL, **goal)
    path.plot([], [], label="goal", **goal)
    over_time.set(xlabel="time [s]", ylabel="RMS error of the cable lengths [mm]", ylim=(0, None))
    add_legend(figure, path)
    return figure
