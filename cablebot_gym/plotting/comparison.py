"""Figures of comparisons: errors over time and their distribution, as in Fig. 9, or over payload.
Extra ``plot``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.envs import described
from cablebot_gym.evaluation.comparison import Comparison, PayloadComparison
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import DPI, add_legend, new_figure, set_title
from cablebot_gym.utils.files import atomic_write
from cablebot_gym.utils.palette import (
    BLACK,
    BLUE,
    DEEP_SKY,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILLION,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, DEEP_SKY, BLACK)
"""Colours of the policies, in order."""

STYLES = ("-", "--", "-.", ":")
"""Line styles of the policies, in order."""

BAND = (0.05, 0.95)
"""Quantiles over the draws at the lower and upper edge of the band."""

BOUND_IN_VIEW = 5.0
"""Largest ratio of bound to largest error for which the bound is drawn."""


def draw_comparison(comparison: Comparison) -> Figure:
    """Draws the position error over time and the distribution of the largest errors over the draws.

    A spatial robot gets the same panels for the rotation error.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    kinds = [("position", "mm", "error", "max_error")]
    if not comparison.task.robot.point_mass:
        kinds.append(("rotation", "mrad", "rotation", "max_rotation"))
    figure = new_figure(1.6 + 2.6 * len(kinds))
    grid = figure.subplots(
        len(kinds),
        2,
        squeeze=False,
        width_ratios=[1.6, 1],
        sharex="col" if len(kinds) < 2 else False,
    )
    for (over_time, largest), (name, unit, series, peak) in zip(grid, kinds, strict=True):
        bound = getattr(comparison.conditions.error_bounds, name)
        largest_error = max(float(np.max(getattr(metrics, peak))) for metrics in comparison.metrics)
        _over_time(over_time, comparison, series)
        over_time.set(ylabel=f"{name} error [{unit}]")
        _distribution(largest, comparison, peak)
        if bound <= BOUND_IN_VIEW * largest_error:
            over_time.axhline(1e3 * bound, color="black", linewidth=1.0)
            largest.axvline(1e3 * bound, color="black", linewidth=1.0)
            note = "black line"
            top = max(1.05 * largest_error, 1.1 * bound)
        else:  # with the bound in view, the curves would be flat
            note, top = "above the plotted range", 1.05 * largest_error
        over_time.set_title(
            f"bound {1e3 * bound:g} {unit}: {note}", fontsize=10, loc="right", color=GREY
        )
        over_time.set(ylim=(0, 1e3 * top or 1.0))
        largest.set(
            xlabel=f"largest {name} error [{unit}]", ylabel="fraction of draws", ylim=(0, 1.02)
        )
    grid[-1, 0].set_xlabel("time [s]")
    add_legend(figure, grid[0, 0])
    band = (
        ["mean over draws, band from the 5th to the 95th percentile"]
        if comparison.draws > 1
        else []
    )
    if band and any(metrics.ended.any() for metrics in comparison.metrics):
        band[0] += "; draws that ended early are excluded after their end"
    set_title(figure, _conditions(comparison, f"payload {comparison.payload:g} kg, "), *band)
    return figure


def draw_payload_comparison(comparison: PayloadComparison) -> Figure:
    """Draws the largest errors, the torque and the success rate over the payload.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    first = comparison.comparisons[0]
    payloads = comparison.payloads
    rows = [("max_error", "position error,\nlargest [mm]", 1e3)]
    rows += (
        []
        if first.task.robot.point_mass
        else [("max_rotation", "rotation error,\nlargest [mrad]", 1e3)]
    )
    rows += [
        ("rms_torque", "torque, root\nmean square [N·m]", 1.0),
        ("success", "success rate [%]", 100.0),
    ]
    figure = new_figure(1.4 + 1.9 * len(rows))
    panels = figure.subplots(len(rows), 1, sharex=True)
    for axes, (name, label, factor) in zip(panels, rows, strict=True):
        for index, policy in enumerate(comparison.policies):
            metrics = [one.metrics[index] for one in comparison.comparisons]
            found = [one.success if name == "success" else one.estimate(name) for one in metrics]
            mean, low, high = factor * np.array([(one.mean, one.low, one.high) for one in found]).T
            colour = COLOURS[index % len(COLOURS)]
            style = STYLES[index % len(STYLES)]
            if first.draws > 1:
                axes.fill_between(payloads, low, high, color=colour, alpha=0.2, linewidth=0)
            axes.plot(
                payloads, mean, style, color=colour, linewidth=1.8, marker=".", label=f" {policy}"
            )
        axes.set_ylabel(label)
    for axes, bound, unit in zip(
        panels[:-2], vars(first.conditions.error_bounds).values(), ("mm", "mrad"), strict=False
    ):
        axes.axhline(1e3 * bound, color="black", linewidth=1.0)
        axes.set_title(
            f"bound {1e3 * bound:g} {unit}: black line", fontsize=10, loc="right", color=GREY
        )
    for axes in panels[:-1]:
        axes.set_ylim(bottom=0)
    panels[-1].set(xlabel="payload [kg]", ylim=(-4, 104))
    add_legend(figure, panels[0])
    band = ["mean over draws, with 95 % confidence"] if first.draws > 1 else []
    set_title(figure, _conditions(first), *band)
    return figure


def _conditions(comparison: Comparison, payload: str = "") -> str:
    """Environment, payload, payload model and draws."""
    draws = (
        f"{comparison.draws} draws of {comparison.conditions.uncertainty_name}"
        if comparison.conditions.uncertainty_name
        else "no uncertainty"
    )
    model = comparison.conditions.payload_model
    return f"{described(comparison.conditions.env_id, comparison.task.robot.name)}, {payload}{model}; {draws}"


def save_comparison(comparison: Comparison | PayloadComparison, folder: Path) -> Path:
    """Writes ``comparison.png``. An interrupted call leaves no partial file.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    path = folder / "comparison.png"
    figure = (
        draw_comparison(comparison)
        if isinstance(comparison, Comparison)
        else draw_payload_comparison(comparison)
    )
    atomic_write(path, partial(figure.savefig, dpi=DPI, format="png"))
    return path


def _over_time(axes: Axes, comparison: Comparison, series: str) -> None:
    for index, metrics in enumerate(comparison.metrics):
        error: Array = 1e3 * getattr(metrics, series)
        time = np.arange(1, len(error) + 1) / comparison.task.control_frequency
        colour = COLOURS[index % len(COLOURS)]
        style = STYLES[index % len(STYLES)]
        if comparison.draws > 1:
            low, high = np.nanquantile(error, BAND, axis=1)
            axes.fill_between(time, low, high, color=colour, alpha=0.2, linewidth=0)
        label = f" {metrics.policy}"  # the space keeps names with a leading "_" in the legend
        axes.plot(time, np.nanmean(error, axis=1), style, color=colour, linewidth=1.8, label=label)
    axes.set_xlim(0, comparison.task.trajectory.duration)


def _distribution(axes: Axes, comparison: Comparison, peak: str) -> None:
    for index, metrics in enumerate(comparison.metrics):
        colour = COLOURS[index % len(COLOURS)]
        style = STYLES[index % len(STYLES)]
        axes.ecdf(1e3 * getattr(metrics, peak), color=colour, linestyle=style, linewidth=1.8)
