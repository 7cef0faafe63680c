"""Figures of a DLCC result: torques and U± as in the paper's Figs. 10 and 12, paths as in Figs. 11
and 13.

Needs the extra ``plot``. The figures need no window and no global state of matplotlib. Show them in
a notebook or save them.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cablebot_gym.envs import described
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.kinematics import Array
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.files import atomic_write
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, SKY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

DPI = 150
"""Resolution of saved figures [dots per inch]."""

_WIDTH = 9.6
"""Width of every figure [inch]."""

LINE_LENGTH = 112
"""Number of characters that fit into a line of a title or legend."""

_HANDLE = 6
"""Width of the line sample in a legend [characters]."""

_FEW = 20
"""Largest number of steps for which every step is drawn as a dot, because a line would be too
short."""


def import_matplotlib() -> ModuleType:
    """Imports ``matplotlib.figure``. A command calls this first, so that it fails before a long
    computation.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    try:
        from matplotlib import figure
    except ImportError as error:
        raise ImportError("figures need matplotlib: pip install 'cablebot-gym[plot]'") from error
    return figure


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueProfile:
    """Torques and their limits over time, for :func:`torque_panels`."""

    times: Array
    """Times, (K,) [s]."""
    torques: Array
    """Applied torques, (K, m) [N·m]."""
    lower: Array
    """Lower limits U⁻, (K, m) [N·m]."""
    upper: Array
    """Upper limits U⁺, (K, m) [N·m]."""
    requested: Array | None = None
    """Requested torques before saturation, (K, m) [N·m]; None without saturation."""
    end: float
    """End of the time axis [s]."""
    name: str = "applied torque"
    """Label of the torque in the legend."""


@dataclass(frozen=True, kw_only=True)
class Mark:
    """An instant to highlight in a :class:`TorqueProfile`."""

    step: int
    """Index of the instant in ``times``."""
    motor: int
    """Index of the motor, from 0."""
    name: str
    """Label of the mark in the legend."""
    note: str
    """Text after the time in the annotation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TravelledPath:
    """A path and its tracking errors, for :func:`path_panels`."""

    times: Array
    """Times, (K,) [s]."""
    pose: Array
    """Poses, (K, n) [m, rad]."""
    position_error: Array
    """Position error, (K,) [m]."""
    rotation_error: Array | None
    """Rotation error, (K,) [rad]; None for a planar robot."""
    name: str = "path"
    """Label of the path in the legend."""
    color: str = BLUE
    """Colour of the curves."""
    style: str = "-"
    """Line style of the curves."""

    @property
    def line(self) -> dict[str, Any]:
        """Keywords of matplotlib for the curves."""
        return {
            "color": self.color,
            "linestyle": self.style,
            "linewidth": 1.8,
            "marker": _marker(self.times),
        }


def draw_torques(result: DLCCResult) -> Figure:
    """Draws the torque of each motor with its limits U± and the tightest instant of the episode.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    return _drawn(result, {_draw_torques: torques_height(result.rollout.task.robot.cables)})


def draw_path(result: DLCCResult) -> Figure:
    """Draws the path with the tube around its reference, and the tracking errors with their bounds.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    return _drawn(result, {_draw_path: _PATH_HEIGHT})


def draw_result(result: DLCCResult) -> Figure:
    """Draws torques and path in one figure.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    return _drawn(
        result,
        {_draw_torques: torques_height(result.rollout.task.robot.cables), _draw_path: _PATH_HEIGHT},
    )


def _drawn(
    result: DLCCResult, parts: Mapping[Callable[[FigureBase, DLCCResult], None], float]
) -> Figure:
    """A figure with parts of given heights [inch], one below the other, and the title of the
    result."""
    figure = new_figure(sum(parts.values()))
    heights = list(parts.values())
    rows = (
        [figure]
        if len(parts) == 1
        else figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    )
    for draw, row in zip(parts, rows, strict=True):
        draw(row, result)
    _set_result_title(figure, result)
    return figure


def draw_springs(result: DLCCResult) -> Figure:
    """Draws the deflection of each joint spring over time, and its mean.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
        ValueError: if the robot has no joint springs, or its cables stretch.
    """
    deflections = result.rollout.arrays.get("spring_deflection")
    if deflections is None:
        raise ValueError(
            f"robot {result.rollout.task.robot.name!r} has no joint springs with cables that do not stretch"
        )
    cables = deflections.shape[1]
    columns = min(3, deflections.shape[1])
    figure = new_figure(torques_height(cables))
    grid = figure.subplots(
        math.ceil(cables / columns), columns, sharex=True, sharey=True, squeeze=False
    )
    times = result.rollout.arrays["time"]
    for axes in grid.flat[cables:]:
        axes.remove()
    for spring, axes in enumerate(grid.flat[:cables]):
        axes.set_title(f"spring {spring + 1}", fontsize=11)
        axes.axhline(0.0, color="black", linewidth=1.0, label="no torque")
        axes.axhline(
            deflections[:, spring].mean(), color=GREY, linewidth=1.0, linestyle="--", label="mean"
        )
        label = "motor angle minus pulley angle"
        axes.plot(
            times,
            deflections[:, spring],
            color=BLUE,
            linewidth=1.4,
            marker=_marker(times),
            label=label,
        )
        below = spring + columns >= cables
        axes.tick_params(labelbottom=below)
        axes.set(xlim=_span(times, _end(result)), xlabel="time [s]" if below else "")
        if spring % columns == 0:
            axes.set_ylabel("deflection [rad]")
    add_legend(figure, grid.flat[0])
    _set_result_title(figure, result)
    return figure


def draw_success(result: DLCCResult) -> Figure:
    """Draws the fraction of the scan's draws that carry each payload, the required probability and
    the payload.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
        ValueError: if the result has only one draw.
    """
    if result.details.probability is None:
        raise ValueError("a success curve needs several draws: evaluate with a random uncertainty")
    figure = new_figure(_SUCCESS_HEIGHT)
    axes = figure.subplots()
    payload, fraction = np.array(result.details.success).T
    label = "fraction of the scan's draws that carry it"
    axes.plot(payload, fraction, color=BLUE, linewidth=1.8, marker="o", markersize=3, label=label)
    axes.axhline(
        result.details.probability,
        color="black",
        linewidth=1.0,
        label=f"required: {result.details.probability:.0%}",
    )
    if result.payload is not None:
        label = f"payload: {result.payload:.2f} kg ({result.assurance})"
        axes.axvline(result.payload, color=VERMILLION, linewidth=1.2, label=label)
    largest = payload[np.flatnonzero(fraction > 0)[-1]] if fraction.any() else 0.0
    axes.set(
        xlim=(
            0,
            min(result.details.payload_max, 1.25 * largest + 0.02 * result.details.payload_max),
        ),
        ylim=(0, 1.02),
    )
    axes.set(xlabel="payload [kg]", ylabel="fraction of draws")
    add_legend(figure, axes)
    _set_result_title(figure, result, one_draw=False)
    return figure


def save_figures(result: DLCCResult, folder: Path) -> list[Path]:
    """Writes ``torques-<criterion>.png`` and ``path-<criterion>.png``.

    Several draws add ``success-<criterion>.png``, and joint springs ``springs-<criterion>.png``.

    An interrupted call leaves no partial file.

    Args:
        result: the result to draw.
        folder: folder of the files; created if it does not exist.

    Returns:
        Paths of the written files.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figures = {"torques": draw_torques(result), "path": draw_path(result)}
    if result.details.probability is not None:
        figures["success"] = draw_success(result)
    if "spring_deflection" in result.rollout.arrays:
        figures["springs"] = draw_springs(result)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}-{result.criterion}.png")
        atomic_write(paths[-1], partial(figure.savefig, dpi=DPI, format="png"))
    return paths


def tightest(result: DLCCResult) -> tuple[int, int]:
    """Step and motor with the least torque margin, both from 0: the first occurrence of the largest
    |a|."""
    action = np.abs(result.rollout.arrays["commanded_action"])
    step, motor = np.unravel_index(np.argmax(action), action.shape)
    return int(step), int(motor)


def torque_limits(result: DLCCResult) -> tuple[Array, Array]:
    """U⁻ and U⁺ at the motor speeds of the episode (Eq. 37), each (steps, m) [N·m]."""
    stall = result.rollout.stall_torque
    drop = _slope(result) * result.rollout.arrays["motor_speeds"]
    return -stall - drop, stall - drop


def requested_torque(result: DLCCResult) -> Array:
    """Requested torque ``τ_s a − (τ_s/ω_n) β̇``, (steps, m) [N·m]; beyond U± where |a| > 1."""
    rollout, arrays = result.rollout, result.rollout.arrays
    return np.asarray(
        rollout.stall_torque * arrays["commanded_action"] - _slope(result) * arrays["motor_speeds"]
    )


def _slope(result: DLCCResult) -> Array:
    """True slope τ_s/ω_n, (m,) [N·m·s]. The strength factor of a motor does not change its free
    speed."""
    robot = result.rollout.task.robot
    slope: Array = robot.speed_slope * (result.rollout.stall_torque / robot.stall_torque)
    return slope


_PATH_HEIGHT, _SUCCESS_HEIGHT = 4.4, 4.4


def torques_height(cables: int) -> float:
    """Figure height for :func:`torque_panels` with a title and a legend [inch]."""
    return 1.4 + 2.0 * math.ceil(cables / 3)


def new_figure(height: float) -> Figure:
    """An empty figure with a height [inch] and the common width.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    return import_matplotlib().Figure(figsize=(_WIDTH, height), layout="constrained")


def set_title(figure: FigureBase, *lines: str) -> None:
    """Sets the title of a figure. Long lines are wrapped."""
    # The wrap option of matplotlib would interpret dollar signs as mathematics.
    title = "\n".join(textwrap.fill(line, LINE_LENGTH) for line in lines)
    figure.suptitle(title, fontsize=11, parse_math=False)


def _set_result_title(figure: FigureBase, result: DLCCResult, *, one_draw: bool = True) -> None:
    """Sets a title that states the result. ``one_draw``: whether the figure shows a single draw."""
    if result.payload is None:
        summary = "fails unloaded (shown: zero payload)"
    else:
        summary = f"payload {result.payload:.3f} kg, total mass {result.total_mass:.3f} kg"
    robot = described(result.conditions.env_id, result.conditions.robot.name)
    head = f"{robot}, policy {result.policy}, {result.criterion} criterion"
    draws_line = []
    if result.details.probability is not None:
        uncertainty = result.conditions.uncertainty_name or "random episodes"
        draws_line.append(f"{uncertainty}, {result.assurance}")
        if one_draw and result.payload is not None:
            draws_line.append("shown: the first draw that carries it")
        elif one_draw:
            draws_line.append("shown: the draw with this violation")
    set_title(figure, head, *draws_line, summary, f"limiting violation: {result.violation_text}")


def _draw_torques(figure: FigureBase, result: DLCCResult) -> None:
    arrays = result.rollout.arrays
    (lower, upper) = torque_limits(result)
    (step, motor) = tightest(result)
    action = abs(arrays["commanded_action"][step, motor])
    profile = TorqueProfile(
        times=arrays["action_time"],
        torques=arrays["torques"],
        lower=lower,
        upper=upper,
        requested=requested_torque(result),
        end=_end(result),
    )
    margin = f"{action - 1:.1%} beyond the limit" if action > 1 else f"{1 - action:.1%} margin"
    torque_panels(
        figure, profile, Mark(step=step, motor=motor, name="tightest instant", note=margin)
    )


def torque_panels(figure: FigureBase, profile: TorqueProfile, mark: Mark | None = None) -> None:
    """Draws a panel for each motor with its torque and limits, and a legend. A mark highlights one
    instant."""
    time, cables = profile.times, profile.torques.shape[1]
    columns = min(3, cables)
    grid = figure.subplots(
        math.ceil(cables / columns), columns, sharex=True, sharey=True, squeeze=False
    )
    for axes in grid.flat[cables:]:
        axes.remove()
    (low, high), marker = _torque_range(profile), _marker(time)
    for motor, axes in enumerate(grid.flat[:cables]):
        axes.set_title(f"motor {motor + 1}", fontsize=11)
        shade: dict[str, Any] = {"color": SHADE, "linewidth": 0}
        upper = profile.upper[:, motor]
        lower = profile.lower[:, motor]
        ends = time[[0, *range(len(time)), -1]]
        axes.fill(ends, np.concatenate([[high], upper, [high]]), label="infeasible", **shade)
        axes.fill(ends, np.concatenate([[low], lower, [low]]), **shade)
        axes.plot(time, upper, color="black", linewidth=1.0, marker=marker, label="limits U±")
        axes.plot(time, lower, color="black", linewidth=1.0, marker=marker)
        if profile.requested is not None:
            # Where |a| ≤ 1 it equals the applied torque, which hides it.
            requested = profile.requested[:, motor]
            axes.plot(
                time,
                requested,
                "--",
                color=VERMILLION,
                linewidth=1.4,
                label="requested torque beyond the limits",
            )
        axes.plot(
            time,
            profile.torques[:, motor],
            color=BLUE,
            linewidth=1.8,
            marker=marker,
            label=profile.name,
        )
        axes.set(xlim=_span(time, profile.end), ylim=(low, high))
        below = motor + columns >= cables
        axes.tick_params(labelbottom=below)
        axes.locator_params(
            axis="x", nbins=5, prune="upper"
        )  # the last label would touch the first label of the next panel
        if below:
            axes.set_xlabel("time [s]")
        if motor % columns == 0:
            axes.set_ylabel("torque [N·m]")
    if mark is not None:
        _draw_mark(grid.flat[mark.motor], profile, mark)
    add_legend(figure, grid.flat[0 if mark is None else mark.motor])


def _end(result: DLCCResult) -> float:
    """End of the last step of the episode [s]."""
    return float(
        result.rollout.arrays["action_time"][-1] + 1 / result.rollout.task.control_frequency
    )


def _span(times: Array, end: float) -> tuple[float, float]:
    """Range of the time axis [s]: the recorded episode, with a border if it is very short."""
    return (-0.1 * end, 1.1 * end) if _is_short(times) else (0.0, end)


def _marker(times: Array) -> str:
    return "." if _is_short(times) else ""


def _is_short(times: Array) -> bool:
    return len(times) <= _FEW


def _torque_range(profile: TorqueProfile) -> tuple[float, float]:
    """Range of the torque axis [N·m]: the limits, and requested torques up to half a stall torque
    beyond them."""
    lower, upper = profile.lower, profile.upper
    requested = profile.torques if profile.requested is None else profile.requested
    stall = float((upper - lower).max()) / 2
    low = max(min(lower.min(), requested.min()), lower.min() - stall / 2)
    high = min(max(upper.max(), requested.max()), upper.max() + stall / 2)
    return float(low - 0.15 * stall), float(high + 0.15 * stall)


def _draw_mark(axes: Axes, profile: TorqueProfile, mark: Mark) -> None:
    time = profile.times[mark.step]
    torques = profile.torques[:, mark.motor]
    lower = profile.lower[:, mark.motor]
    upper = profile.upper[:, mark.motor]
    torque = torques[mark.step]
    early = time < sum(_span(profile.times, profile.end)) / 2
    # The annotation is placed between the torque and the opposite limit.
    positive = 2 * torque > lower[mark.step] + upper[mark.step]
    gap = (lower.max(), torques.min()) if positive else (torques.max(), upper.min())
    axes.plot(
        time, torque, "o", color=VERMILLION, markeredgecolor="black", markersize=7, label=mark.name
    )
    axes.annotate(
        f"t = {round(float(time), 7):.3f} s: {mark.note}",  # rounded as in the text of a result
        (time, torque),
        xytext=(0.96 if early else 0.04, sum(gap) / 2),
        textcoords=axes.get_yaxis_transform(),
        horizontalalignment="right" if early else "left",
        verticalalignment="center",
        arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.8, "shrinkB": 4},
        bbox={
            "boxstyle": "round,pad=0.25",
            "facecolor": "white",
            "edgecolor": GREY,
            "linewidth": 0.6,
        },
    )


def add_legend(figure: FigureBase, axes: Axes) -> None:
    """Adds a legend of the curves in ``axes`` below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    labels = [textwrap.fill(label.strip(), LINE_LENGTH - _HANDLE) for label in labels]
    width = sum(len(label) + _HANDLE for label in labels)
    columns = (
        len(labels)
        if width <= LINE_LENGTH
        else max(1, LINE_LENGTH // (max(map(len, labels)) + _HANDLE))
    )
    legend = figure.legend(
        handles, labels, loc="outside lower center", ncols=columns, frameon=False
    )
    for text in legend.get_texts():
        text.set_parse_math(False)


def _draw_path(figure: FigureBase, result: DLCCResult) -> None:
    arrays = result.rollout.arrays
    path = TravelledPath(
        times=arrays["action_time"] + 1 / result.rollout.task.control_frequency,
        pose=arrays["true_pose"],
        position_error=arrays["tracking_error"],
        rotation_error=None if result.rollout.task.robot.point_mass else arrays["rotation_error"],
    )
    path_panels(figure, result.rollout.task.trajectory, [path], **result.details.error_bounds)


def path_panels(
    figure: FigureBase,
    trajectory: Trajectory,
    paths: Sequence[TravelledPath],
    *,
    position: float | None,
    rotation: float | None,
) -> None:
    """Draws paths with the tube around their reference, errors with their bounds, and a legend.

    Args:
        figure: an empty figure.
        trajectory: the reference.
        paths: at least one path.
        position: bound of the position error [m], the radius of the tube; None without bound.
        rotation: bound of the rotation error [rad]; None without bound.
    """
    rotates = any(path.rotation_error is not None for path in paths)
    grid = figure.add_gridspec(2 if rotates else 1, 2, width_ratios=[1, 1.25])
    plane = figure.add_subplot(grid[:, 0])
    last = figure.add_subplot(grid[0, 1])
    draw_plane(plane, trajectory, paths, position or 0.0)
    _draw_error(last, paths, [path.position_error for path in paths], position, "position", "mm")
    if rotates:
        last.tick_params(labelbottom=False)
        last = figure.add_subplot(grid[1, 1], sharex=last)
        _draw_error(
            last, paths, [path.rotation_error for path in paths], rotation, "rotation", "mrad"
        )
    last.set_xlabel("time [s]")
    add_legend(figure, plane)


def draw_plane(
    axes: Axes, trajectory: Trajectory, paths: Sequence[TravelledPath], radius: float
) -> None:
    """Draws paths in the x–y plane and the tube with a radius [m] around their reference."""
    from matplotlib.collections import EllipseCollection

    reference = trajectory(np.linspace(0.0, trajectory.duration, 1001)).position[:, :2]
    # Discs instead of offset curves, which fail for a reference that stops or turns on the spot.
    discs: dict[str, Any] = {
        "units": "xy",
        "offsets": reference,
        "offset_transform": axes.transData,
    }
    tube = EllipseCollection(2 * radius, 2 * radius, 0, color=SKY, linewidth=0, zorder=0, **discs)
    axes.add_collection(tube, autolim=False)
    axes.fill(
        [], [], color=SKY, label=f"tube, R = {radius * 1e3:g} mm"
    )  # a legend ignores the collection
    points = [reference - radius, reference + radius]
    for path in paths:
        points.append(path.pose[:, :2])
        axes.plot(*points[-1].T, label=path.name, **path.line)
    axes.plot(*reference.T, "--", color="black", linewidth=1.0, label="reference")
    low = np.concatenate(points).min(axis=0)
    high = np.concatenate(points).max(axis=0)
    pad = 0.06 * (high - low).max()
    axes.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad))
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _draw_error(
    axes: Axes,
    paths: Sequence[TravelledPath],
    errors: Sequence[Array | None],
    bound: float | None,
    name: str,
    unit: str,
) -> None:
    """Draws errors with their bound. ``unit`` is a thousandth of the SI unit."""
    axes.locator_params(axis="x", nbins=6)
    longest = max((path.times for path in paths), key=len)
    top = 0.0
    for path, error in zip(paths, errors, strict=True):
        if error is not None:
            axes.plot(path.times, 1e3 * error, **path.line)
            top = max(top, 1e3 * float(error.max()))
    if bound is not None:
        mark_bound(axes, bound, unit)
        top = max(top, 1e3 * bound)
    else:
        axes.set_title("no bound under this criterion", fontsize=10, loc="right", color=GREY)
    span = _span(longest, float(longest[-1]))
    axes.set(xlim=span, ylim=(0, 1.2 * top or 1.0), ylabel=f"{name} error [{unit}]")


def mark_bound(
    axes: Axes, bound: float, unit: str, *, side: Literal["left", "right"] = "right"
) -> None:
    """Draws a labelled line at the bound of an error. ``unit`` is a thousandth of the SI unit."""
    axes.axhline(1e3 * bound, color="black", linewidth=1.0)
    axes.annotate(
        f"bound {1e3 * bound:g} {unit}",
        (0.99 if side == "right" else 0.01, 1e3 * bound),
        xycoords=("axes fraction", "data"),
        xytext=(0, 4),
        textcoords="offset points",
        horizontalalignment=side,
        verticalalignment="bottom",
        bbox={
            "boxstyle": "round,pad=0.15",
            "facecolor": "white",
            "edgecolor": "none",
            "alpha": 0.85,
        },
    )
