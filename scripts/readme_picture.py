"""The README's picture, from live evaluations: the spatial robot, and what its second motor gives with more payload.

Run ``python scripts/readme_picture.py``. Needs the extra ``plot``.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cablebot_gym.evaluation.evaluator import evaluate_dlcc
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.kinematics import cable_vectors
from cablebot_gym.plotting.figures import demanded_torque, torque_limits
from cablebot_gym.utils.files import write_whole
from cablebot_gym.utils.palette import BLUE, GREEN, SHADE, VERMILLION

Array = NDArray[np.float64]

ENV_ID = "CableBot-Spatial-v0"
MOTOR = 1
"""The one that saturates first, from 0: motor 2."""

AZIMUTH, ELEVATION = np.radians(22), np.radians(38)
"""Where the drawing looks from."""

HANG = 0.36
"""How far below the platform the payload is drawn [m]; in the model it is part of the platform."""


def main() -> None:
    """Evaluates, draws and writes."""
    parser = argparse.ArgumentParser(description="Draws the README's picture from live evaluations.")
    parser.add_argument("--out", type=Path, default=Path("docs/readme.png"), help="PNG to write (docs/readme.png)")
    out: Path = parser.parse_args().out
    empty = evaluate_dlcc("fl", ENV_ID, payload_max=1e-6)  # a milligram: as good as nothing
    paper = evaluate_dlcc("fl", ENV_ID, criterion="paper")
    task = evaluate_dlcc("fl", ENV_ID, criterion="task")
    figure = Figure(figsize=(8, 3.5), layout="constrained")
    robot_axes, torque_axes = figure.subplots(1, 2, width_ratios=[1, 1.2])
    figure.suptitle(f"How much does feedback linearization carry on {ENV_ID}?", fontsize=12)
    draw_robot(robot_axes, task)
    draw_motor(torque_axes, empty, paper, task)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, partial(figure.savefig, dpi=150, format="png"))


def projected(points: Array) -> Array:
    """Points (..., 3) of the base frame, whose z points down, on the page (..., 2)."""
    x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
    right = x * np.cos(AZIMUTH) - y * np.sin(AZIMUTH)
    nearer = x * np.sin(AZIMUTH) + y * np.cos(AZIMUTH)
    return np.stack([right, -z * np.cos(ELEVATION) - nearer * np.sin(ELEVATION)], axis=-1)


def draw_robot(axes: Axes, result: DLCCResult) -> None:
    """Base, cables and platform at the start of the motion, with the circle that it follows."""
    robot, trajectory = result.task.robot, result.task.trajectory
    reference = trajectory(np.linspace(0, trajectory.duration, 400)).position
    start = reference[0]
    anchors = robot.base + cable_vectors(robot.base, robot.platform, start)
    base, platform = projected(robot.base), projected(anchors)
    payload = projected(start[:3] + HANG * np.array([0, 0, 1]))
    axes.fill(*base.T, facecolor="#F3F3F3", edgecolor="#B0B0B0", linewidth=1.2, zorder=1)
    axes.plot(*projected(reference[:, :3]).T, color=VERMILLION, linewidth=1.6, linestyle="--", zorder=2)
    axes.fill(*platform.T, facecolor="#F0E442", edgecolor="black", linewidth=1.4, alpha=0.85, zorder=3)
    for cable, ends in enumerate(zip(base, platform, strict=True)):
        axes.plot(*np.transpose(ends), color=BLUE, linewidth=3.0 if cable == MOTOR else 1.3, zorder=4)
    axes.plot(*base.T, "s", color="black", markersize=8, zorder=5)
    axes.plot(*np.transpose([projected(start[:3]), payload]), color="black", linewidth=1.2, zorder=5)
    axes.plot(*payload, "o", color="black", markersize=17, zorder=5)
    _label(axes, "payload", payload, (13, 0), "left", "center")
    _label(axes, "base", base[5], (10, 3), "left", "center")
    _label(axes, f"cable {MOTOR + 1}", (base[MOTOR] + platform[MOTOR]) / 2, (-8, 6), "right", "bottom")
    _label(axes, "reference", max(projected(reference[:, :3]), key=lambda point: point[1]), (-3, 2), "center", "bottom")
    axes.margins(0.06)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_axis_off()
    axes.set_title("six cables, one motor each", fontsize=11)


def draw_motor(axes: Axes, empty: DLCCResult, paper: DLCCResult, task: DLCCResult) -> None:
    """Torque of one motor against its upper limit with no payload and with those that both criteria find."""
    time, upper = task.history["command_time"], torque_limits(task)[1][:, MOTOR]
    axes.fill_between(time, upper, 14, color=SHADE, linewidth=0)
    axes.plot(time, upper, color="black", linewidth=1.2)
    axes.plot(time, demanded_torque(task)[:, MOTOR], ":", color=VERMILLION, linewidth=1.8)
    for result, color, label in (
        (empty, GREEN, "no payload"),
        (paper, BLUE, f"paper: {paper.score:.2f} kg"),
        (task, VERMILLION, f"task: {task.score:.2f} kg"),
    ):
        torque = result.history["torques"][:, MOTOR]
        axes.plot(time, torque, color=color, linewidth=2.0)
        _label(axes, label, np.array([0.0, torque[0]]), (5, 2), "left", "bottom")
    _label(axes, "more than the motor has", np.array([0.5, 12.5]), (0, 0), "center", "center")
    criteria = "paper criterion: no motor may saturate\ntask criterion: it may, within 10 mm and 10 mrad"
    _label(axes, criteria, np.array([0.0, 1.8]), (5, 2), "left", "bottom")
    _label(axes, "demanded", np.array([0.55, 10.8]), (6, 0), "left", "center")
    axes.set(xlim=(0, 1), ylim=(1.6, 13), xlabel="time [s]", ylabel="torque [N·m]")
    axes.set_title(f"motor {MOTOR + 1} against its torque-speed limit", fontsize=11)


def _label(axes: Axes, text: str, point: Array, offset: tuple[float, float], across: str, along: str) -> None:
    axes.annotate(
        text,
        tuple(point),
        xytext=offset,
        textcoords="offset points",
        horizontalalignment=across,
        verticalalignment=along,
        fontsize=9.5,
    )


if __name__ == "__main__":
    main()
