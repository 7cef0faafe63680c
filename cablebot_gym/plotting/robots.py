"""Drawing of a robot: cables, platform, motion, and the positions where it holds a payload at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull

from cablebot_gym.bounds.robot_check import MotionCheck, RobotCheck
from cablebot_gym.kinematics import Array, turned
from cablebot_gym.physics.statics import holds
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.robots import KIND_TEXTS, Robot
from cablebot_gym.utils.palette import BLACK, BLUE, GREY, SKY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NUMBER_AT = (0.18, 0.3, 0.42, 0.54, 0.66, 0.78)
"""Tried places of a cable's number, as fractions of its length from the base anchor."""

_NUMBER_GAP = 0.06
"""Least distance of two numbers, as a fraction of the width of the view."""

_CELLS = 61
"""Number of positions along each axis of a drawn slice."""


def draw_robot(check: RobotCheck, motion: MotionCheck | None = None) -> Figure:
    """Draws a robot at its home pose, with a motion and a slice of its workspace: the plane, or plan and elevations.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    robot = check.robot
    views = [(0, 1)] if robot.planar else [(0, 1), (0, 2), (1, 2)]
    figure = new_figure(4.6 if robot.planar else 3.4)
    for axes, view in zip(np.ravel(figure.subplots(1, len(views))), views, strict=True):
        _draw_view(axes, check, motion, view)
    set_title(figure, f"{robot.name}: {KIND_TEXTS[robot.kind]}, {robot.cables} cables, payload {check.payload:g} kg")
    add_legend(figure, figure.axes[0])
    return figure


def _draw_view(axes: Axes, check: RobotCheck, motion: MotionCheck | None, view: tuple[int, int]) -> None:
    """Draws the robot along two axes; the slice goes through the home pose."""
    robot, (across, along) = check.robot, list(view)
    path = robot.home[None]
    if motion is not None:
        path = motion.trajectory(np.linspace(0, motion.trajectory.duration, 201)).position
    low, high = _extent(robot, path)
    columns, rows = (np.linspace(low[axis], high[axis], _CELLS) for axis in view)
    poses = np.tile(robot.home, (_CELLS, _CELLS, 1))
    poses[..., across], poses[..., along] = columns, rows[:, None]
    held = holds(robot, poses.reshape(-1, robot.coordinates), check.payload).reshape(_CELLS, _CELLS)
    axes.contourf(columns, rows, held.astype(float), levels=[0.5, 1.5], colors=[SKY])
    axes.fill([], [], color=SKY, label="holds the payload at rest")
    workspace = robot.pose_bounds[:, list(view)]
    box = np.array([[workspace[i, 0], workspace[j, 1]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))])
    axes.plot(*box.T, "--", color=GREY, linewidth=1.0, label="workspace")
    ends = robot.home[: robot.dimensions] + turned(robot.home, robot.platform)
    for base, end in zip(robot.base, ends, strict=True):
        axes.plot(*np.stack([base, end])[:, view].T, color=BLUE, linewidth=1.0)
    _number_cables(axes, robot.base[:, view], ends[:, view])
    axes.plot([], [], color=BLUE, linewidth=1.0, label="cables")
    if not robot.point_mass:
        shown = ends[:, view]
        outline = shown[ConvexHull(shown, qhull_options="QJ").vertices]  # joggled, for anchors on a line
        axes.fill(*outline.T, facecolor="none", edgecolor=BLACK, linewidth=1.4)
    axes.plot(*robot.base[:, view].T, "o", color=BLACK, markersize=3.5)
    if motion is not None:
        axes.plot(*path[:, view].T, color=VERMILLION, linewidth=1.6, label="motion")
    axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[along]} [m]", aspect="equal")
    if robot.planar or along == 2:
        axes.invert_yaxis()  # y of a plane and z point down


def _number_cables(axes: Axes, starts: Array, ends: Array) -> None:
    """Writes the numbers of the cables; cables with one line in this view share a text, and no texts overlap."""
    lines: dict[tuple[float, ...], list[int]] = {}
    for index, (start, end) in enumerate(zip(starts, ends, strict=True)):
        lines.setdefault(tuple(np.round([*start, *end], 6)), []).append(index)
    width = float(np.ptp(np.concatenate([starts, ends]), axis=0).max())
    places: list[Array] = []
    for group in lines.values():
        start, end = starts[group[0]], ends[group[0]]
        along = [start + fraction * (end - start) for fraction in _NUMBER_AT]
        gaps = [min((float(np.linalg.norm(place - other)) for other in places), default=width) for place in along]
        free = [index for index, gap in enumerate(gaps) if gap > _NUMBER_GAP * width]
        place = along[free[0] if free else int(np.argmax(gaps))]
        places.append(place)
        axes.text(
            float(place[0]),
            float(place[1]),
            ", ".join(str(index + 1) for index in group),
            fontsize=8,
            ha="center",
            va="center",
            bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )


def _extent(robot: Robot, path: Array) -> tuple[Array, Array]:
    """Lowest and highest drawn position, shape (d,)."""
    d = robot.dimensions
    points = np.concatenate([robot.base, path[:, :d], robot.pose_bounds[:, :d]])
    return points.min(axis=0), points.max(axis=0)
