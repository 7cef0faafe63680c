"""Figures of a DLCC result or an episode: torques and U± as in the paper's Figs. 10 and 12, paths as in Figs. 11
and 13.

Needs the extra ``plot``. The figures need no window and no global state of matplotlib. Show them in
a notebook or save them.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cablebot_gym.envs import described
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.physics.textbook import torque_limits
from cablebot_gym.rendering.projection import points_downwards
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
        }


def draw_torques(result: DLCCResult) -> Figure:
    """Draws the torque of each motor with its limits U± and the tightest instant of the episode.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figure = new_figure(torques_height(result.rollout.task.robot.cables))
    _draw_torques(figure, result.rollout)
    _set_result_title(figure, result)
    return figure


def draw_result(result: DLCCResult) -> Figure:
    """Draws torques and path in one figure.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figure = _draw_both(result.rollout, result.details.error_bounds)
    _set_result_title(figure, result)
    return figure


def draw_rollout(rollout: Rollout, title: str = "") -> Figure:
    """Draws torques and path of a recorded episode in one figure, with the bounds of the task.

    Args:
        rollout: the episode.
        title: title of the figure; the sentence of the rollout if empty.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figure = _draw_both(rollout, vars(rollout.task.error_bounds))
    set_title(figure, title or str(rollout))
    return figure


def _draw_both(rollout: Rollout, bounds: Mapping[str, float | None]) -> Figure:
    heights = [torques_height(rollout.task.robot.cables), _PATH_HEIGHT]
    figure = new_figure(sum(heights))
    rows: Any = figure.subfigures(2, 1, height_ratios=heights)
    _draw_torques(rows[0], rollout)
    _draw_path(rows[1], rollout, bounds)
    return figure


def save_result(result: DLCCResult, folder: str | Path) -> Path:
    """Writes ``result-<criterion>.png`` to a folder, which is created if it does not exist, and
    returns its path. An interrupted call leaves no partial file.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    path = Path(folder, f"result-{result.criterion}.png")
    save_figure(draw_result(result), path)
    return path


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure as PNG. An interrupted call leaves no partial file."""
    atomic_write(path, partial(figure.savefig, dpi=DPI, format="png"))


_PATH_HEIGHT = 4.4
"""Height of a figure with one row of panels [inch]."""


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


def _motor_panels(figure: FigureBase, count: int) -> list[Axes]:
    """A numbered panel for each motor, in rows of up to three panels with common axes."""
    columns = min(3, count)
    rows = math.ceil(count / columns)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[count:]:
        axes.remove()
    for index, axes in enumerate(panels[:count]):
        axes.set_title(f"motor {index + 1}", fontsize=11)
        if index + columns >= count:
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)  # also above a removed panel
        if index % columns == 0:
            axes.set_ylabel("torque [N·m]")
    return list(panels[:count])


def _set_result_title(figure: FigureBase, result: DLCCResult) -> None:
    """Sets the title of a figure that shows the recorded episode of a result."""
    robot = described(result.conditions.env_id, result.conditions.nominal_robot.name)
    lines = [f"{robot}, policy {result.policy}, {result.criterion} criterion"]
    if result.details.probability is not None:
        uncertainty = result.conditions.uncertainty_name or "random episodes"
        lines.append(f"{uncertainty}, {result.assurance}")
        draw = "the first draw that carries it"
        if result.payload is None:
            draw = "the draw with this violation"
        lines.append(f"shown: {draw}")
    if result.payload is None:
        lines.append("fails unloaded (shown: zero payload)")
    else:
        lines.append(f"payload {result.payload:.3f} kg, total mass {result.total_mass:.3f} kg")
    set_title(figure, *lines, f"limiting violation: {result.violation_text}")


def _draw_torques(figure: FigureBase, rollout: Rollout) -> None:
    """Draws the torques of an episode, with a mark at the first occurrence of the largest |a|."""
    robot = rollout.task.robot
    speeds = rollout.arrays["motor_speeds"]
    actions = rollout.arrays["commanded_action"]
    # The strength of a motor does not change its free speed.
    strength = rollout.stall_torque / robot.stall_torque
    lower, upper = strength * np.array(torque_limits(robot, speeds))
    # The mean of the limits is minus the drop of the torque at the speed.
    profile = TorqueProfile(
        times=rollout.arrays["action_time"],
        torques=rollout.arrays["torques"],
        lower=lower,
        upper=upper,
        requested=rollout.stall_torque * actions + (lower + upper) / 2,
        end=float(rollout.arrays["time"][-1]),
    )
    step, motor = np.unravel_index(np.argmax(np.abs(actions)), actions.shape)
    largest = abs(actions[step, motor])
    note = f"{1 - largest:.1%} margin"
    if largest > 1:
        note = f"saturates, |a| = {largest:.3f}"
    mark = Mark(step=int(step), motor=int(motor), name="tightest instant", note=note)
    torque_panels(figure, profile, mark)


def torque_panels(figure: FigureBase, profile: TorqueProfile, mark: Mark | None = None) -> None:
    """Draws a panel for each motor with its torque and limits, and a legend. A mark highlights one
    instant."""
    time = profile.times
    # The torque axis shows the limits, and torques up to half a stall torque beyond them.
    drawn = profile.requested
    if drawn is None:
        drawn = profile.torques
    least = profile.lower.min()
    most = profile.upper.max()
    stall = float((profile.upper - profile.lower).max()) / 2
    low = max(min(least, drawn.min()), least - stall / 2) - 0.15 * stall
    high = min(max(most, drawn.max()), most + stall / 2) + 0.15 * stall
    edges = np.pad(time, 1, mode="edge")  # where the outlines of the shaded areas close
    panels = _motor_panels(figure, profile.torques.shape[1])
    for motor, axes in enumerate(panels):
        upper = profile.upper[:, motor]
        lower = profile.lower[:, motor]
        torque = profile.torques[:, motor]
        beyond = np.pad(upper, 1, constant_values=high)
        axes.fill(edges, beyond, label="infeasible", color=SHADE, linewidth=0)
        beyond = np.pad(lower, 1, constant_values=low)
        axes.fill(edges, beyond, color=SHADE, linewidth=0)
        axes.plot(time, upper, color="black", linewidth=1.0, label="limits U±")
        axes.plot(time, lower, color="black", linewidth=1.0)
        if profile.requested is not None:
            # Where |a| ≤ 1 it equals the applied torque, which hides it.
            requested = profile.requested[:, motor]
            label = "requested torque, where the motor saturates"
            axes.plot(time, requested, "--", color=VERMILLION, linewidth=1.4, label=label)
        axes.plot(time, torque, color=BLUE, linewidth=1.8, label=profile.name)
        axes.set(xlim=(0.0, profile.end), ylim=(low, high))
        # The last label would touch the first label of the next panel.
        axes.locator_params(axis="x", nbins=5, prune="upper")
    labelled = panels[0]
    if mark is not None:
        labelled = panels[mark.motor]
        _draw_mark(labelled, profile, mark)
    add_legend(figure, labelled)


def _draw_mark(axes: Axes, profile: TorqueProfile, mark: Mark) -> None:
    time = profile.times[mark.step]
    torques = profile.torques[:, mark.motor]
    lower = profile.lower[:, mark.motor]
    upper = profile.upper[:, mark.motor]
    torque = torques[mark.step]
    # The annotation is placed between the torque and the opposite limit.
    bottom = torques.max()
    top = upper.min()
    if 2 * torque > lower[mark.step] + upper[mark.step]:
        bottom = lower.max()
        top = torques.min()
    # It is on the side with more room.
    x = 0.04
    alignment = "left"
    if time < profile.end / 2:
        x = 0.96
        alignment = "right"
    axes.plot(
        time, torque, "o", color=VERMILLION, markeredgecolor="black", markersize=7, label=mark.name
    )
    axes.annotate(
        f"t = {round(float(time), 7):.3f} s: {mark.note}",  # rounded as in the text of a result
        (time, torque),
        xytext=(x, (bottom + top) / 2),
        textcoords=axes.get_yaxis_transform(),
        horizontalalignment=alignment,
        verticalalignment="center",
        arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.8, "shrinkB": 4},
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": GREY, "linewidth": 0.6},
    )


def add_legend(figure: FigureBase, axes: Axes) -> None:
    """Adds a legend of the curves in ``axes`` below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    labels = [textwrap.fill(label.strip(), LINE_LENGTH - _HANDLE) for label in labels]
    widths = [len(label) + _HANDLE for label in labels]
    columns = len(labels)
    if sum(widths) > LINE_LENGTH:
        columns = max(1, LINE_LENGTH // max(widths))
    legend = figure.legend(
        handles, labels, loc="outside lower center", ncols=columns, frameon=False
    )
    for text in legend.get_texts():
        text.set_parse_math(False)


def _draw_path(figure: FigureBase, rollout: Rollout, bounds: Mapping[str, float | None]) -> None:
    arrays = rollout.arrays
    robot = rollout.task.robot
    rotation_error = None
    if not robot.point_mass:
        rotation_error = arrays["rotation_error"]
    path = TravelledPath(
        times=arrays["time"],
        pose=arrays["true_pose"],
        position_error=arrays["tracking_error"],
        rotation_error=rotation_error,
    )
    plane = path_panels(figure, rollout.task.trajectory, [path], **bounds)
    if points_downwards(robot, 1):
        plane.invert_yaxis()


def path_panels(
    figure: FigureBase,
    trajectory: Trajectory,
    paths: Sequence[TravelledPath],
    *,
    position: float | None,
    rotation: float | None,
) -> Axes:
    """Draws paths with the tube around their reference, errors with their bounds, and a legend.
    Returns the axes of the paths.

    Args:
        figure: an empty figure.
        trajectory: the reference.
        paths: at least one path.
        position: bound of the position error [m], the radius of the tube; None without bound.
        rotation: bound of the rotation error [rad]; None without bound.
    """
    rotates = any(path.rotation_error is not None for path in paths)
    grid = figure.add_gridspec(1 + rotates, 2, width_ratios=[1, 1.25])
    plane = figure.add_subplot(grid[:, 0])
    draw_plane(plane, trajectory, paths, position or 0.0)
    errors = figure.add_subplot(grid[0, 1])
    _draw_error(errors, paths, "position", position, "mm")
    if rotates:
        errors.tick_params(labelbottom=False)
        errors = figure.add_subplot(grid[1, 1], sharex=errors)
        _draw_error(errors, paths, "rotation", rotation, "mrad")
    errors.set_xlabel("time [s]")
    add_legend(figure, plane)
    return plane


def draw_plane(
    axes: Axes, trajectory: Trajectory, paths: Sequence[TravelledPath], radius: float
) -> None:
    """Draws paths in the x–y plane and the tube with a radius [m] around their reference."""
    from matplotlib.collections import EllipseCollection

    reference = trajectory(np.linspace(0.0, trajectory.duration, 1001)).position[:, :2]
    # Discs instead of offset curves, which fail for a reference that stops or turns on the spot.
    tube = EllipseCollection(
        2 * radius,
        2 * radius,
        0,
        units="xy",
        offsets=reference,
        offset_transform=axes.transData,
        color=SKY,
        linewidth=0,
        zorder=0,
    )
    axes.add_collection(tube, autolim=False)
    # A legend ignores the collection.
    axes.fill([], [], color=SKY, label=f"tube, R = {radius * 1e3:g} mm")
    points = [reference - radius, reference + radius]
    for path in paths:
        travelled = path.pose[:, :2]
        points.append(travelled)
        axes.plot(*travelled.T, label=path.name, **path.line)
    axes.plot(*reference.T, "--", color="black", linewidth=1.0, label="reference")
    low = np.concatenate(points).min(axis=0)
    high = np.concatenate(points).max(axis=0)
    pad = 0.06 * (high - low).max()
    xlim, ylim = np.transpose([low - pad, high + pad])
    axes.set(xlim=xlim, ylim=ylim, xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _draw_error(
    axes: Axes,
    paths: Sequence[TravelledPath],
    name: str,
    bound: float | None,
    unit: str,
) -> None:
    """Draws an error of all paths with its bound. ``unit`` is a thousandth of the SI unit."""
    axes.locator_params(axis="x", nbins=6)
    longest = max((path.times for path in paths), key=len)
    top = 0.0
    for path in paths:
        error: Array | None = getattr(path, f"{name}_error")
        if error is not None:
            axes.plot(path.times, 1e3 * error, **path.line)
            top = max(top, 1e3 * float(error.max()))
    if bound is None:
        axes.set_title("no bound under this criterion", fontsize=10, loc="right", color=GREY)
    else:
        mark_bound(axes, bound, unit)
        top = max(top, 1e3 * bound)
    end = 1.2 * top or 1.0  # above 0, also without errors
    axes.set(xlim=(0.0, longest[-1]), ylim=(0, end), ylabel=f"{name} error\n[{unit}]")


def mark_bound(
    axes: Axes, bound: float, unit: str, *, side: Literal["left", "right"] = "right"
) -> None:
    """Draws a labelled line at the bound of an error. ``unit`` is a thousandth of the SI unit."""
    axes.axhline(1e3 * bound, color="black", linewidth=1.0)
    x = {"left": 0.01, "right": 0.99}[side]
    axes.annotate(
        f"bound {1e3 * bound:g} {unit}",
        (x, 1e3 * bound),
        xycoords=("axes fraction", "data"),
        xytext=(0, 4),
        textcoords="offset points",
        horizontalalignment=side,
        verticalalignment="bottom",
        bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85},
    )
