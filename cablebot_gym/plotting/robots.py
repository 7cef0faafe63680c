"""Drawing of a robot: cables, platform, motion, and the positions where it holds a payload at
rest."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.bounds.robot_check import MotionCheck, RobotCheck
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.statics import holds
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.rendering.projection import (
    attached_points,
    coinciding,
    drawing_views,
    outline,
    points_downwards,
)
from cablebot_gym.robots import KIND_TEXTS
from cablebot_gym.utils.palette import BLACK, BLUE, GREY, SKY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NUMBER_AT = (0.15, 0.35, 0.55, 0.75)
"""Positions of the numbers of cables from one corner, as fractions of the length from the base
anchor."""

_CELLS = 61
"""Number of positions along each axis of a drawn slice."""


def draw_robot(check: RobotCheck, motion: MotionCheck | None = None) -> Figure:
    """Draws a robot at its home pose, with a motion and a slice of its workspace: the plane, or
    plan and elevations.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    robot = check.robot
    views = drawing_views(robot)
    figure = new_figure(4.6 if robot.planar else 3.4)
    panels = figure.subplots(1, len(views), squeeze=False)[0]
    for axes, view in zip(panels, views, strict=True):
        _draw_view(axes, check, motion, view)
    set_title(
        figure,
        f"{robot.name}: {KIND_TEXTS[robot.kind]}, {robot.cables} cables, payload {check.payload:g} kg",
    )
    add_legend(figure, figure.axes[0])
    return figure


def _draw_view(axes: Axes, check: RobotCheck, motion: MotionCheck | None, view: list[int]) -> None:
    """Draws the robot along two axes; the slice goes through the home pose."""
    robot = check.robot
    path = robot.home[None]
    if motion is not None:
        times = np.linspace(0, motion.trajectory.duration, 201)
        path = motion.trajectory(times).position
    base = robot.base[:, view]
    ends = attached_points(robot.home, robot.platform)[:, view]
    path = path[:, view]
    workspace = robot.pose_bounds[:, view]

    visible = np.concatenate([base, path, workspace])
    if check.workspace is not None:
        _draw_held_positions(axes, check, view, visible.min(axis=0), visible.max(axis=0))
    box_x = workspace[[0, 1, 1, 0, 0], 0]
    box_y = workspace[[0, 0, 1, 1, 0], 1]
    axes.plot(box_x, box_y, "--", color=GREY, linewidth=1.0, label="workspace")
    cable_x, cable_y = np.stack([base, ends], axis=1).T  # a line for each column
    axes.plot(cable_x, cable_y, color=BLUE, linewidth=1.0)
    axes.plot([], [], color=BLUE, linewidth=1.0, label="cables")
    if not robot.point_mass:
        axes.fill(*outline(ends).T, facecolor="none", edgecolor=BLACK, linewidth=1.4)
    axes.plot(*base.T, "o", color=BLACK, markersize=3.5)
    if motion is not None:
        axes.plot(*path.T, color=VERMILLION, linewidth=1.6, label="motion")
    across, along = view
    axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[along]} [m]", aspect="equal")
    if points_downwards(robot, along):
        axes.invert_yaxis()
    _number_cables(axes, base, ends)


def _draw_held_positions(
    axes: Axes, check: RobotCheck, view: list[int], low: Array, high: Array
) -> None:
    """Colours where the robot holds the payload at rest, between the corners ``low`` and ``high``
    of a view, (2,)."""
    robot = check.robot
    columns = np.linspace(low[0], high[0], _CELLS)
    rows = np.linspace(low[1], high[1], _CELLS)
    across, along = view
    poses = np.tile(robot.home, (_CELLS, _CELLS, 1))
    poses[..., across] = columns
    poses[..., along] = rows[:, None]
    held = holds(robot, poses.reshape(-1, robot.coordinates), check.payload)
    axes.contourf(
        columns, rows, held.reshape(_CELLS, _CELLS).astype(float), levels=[0.5, 1.5], colors=[SKY]
    )
    axes.fill([], [], color=SKY, label="holds the payload at rest")


def _number_cables(axes: Axes, starts: Array, ends: Array) -> None:
    """Writes the numbers of the cables; cables with one line in this view share a text.

    Args:
        axes: a view.
        starts: base anchors in the view, (m, 2) [m].
        ends: platform anchors in the view, (m, 2) [m].
    """
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    corner = 0.1 * float(np.ptp(starts, axis=0).max())
    numbered: list[Array] = []
    for cables in coinciding(np.hstack([starts, ends])):
        start = starts[cables[0]]
        end = ends[cables[0]]
        text = ", ".join(str(cable + 1) for cable in cables)
        neighbours = sum(math.dist(start, other) < corner for other in numbered)
        numbered.append(start)
        x, y = start + _NUMBER_AT[neighbours % len(_NUMBER_AT)] * (end - start)
        axes.text(x, y, text, fontsize=8, ha="center", va="center", bbox=box)
