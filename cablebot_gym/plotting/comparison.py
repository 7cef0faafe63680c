"""Figures of comparisons: errors over time and their distribution, as in Fig. 9, or over payload.
Extra ``plot``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_gym.evaluation.comparison import Comparison, PayloadComparison
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
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
    errors = [("position", "mm", "error", "max_error")]
    if not comparison.task.robot.point_mass:
        errors.append(("rotation", "mrad", "rotation", "max_rotation"))
    figure = new_figure(1.6 + 2.6 * len(errors))
    grid = figure.subplots(len(errors), 2, squeeze=False, width_ratios=[1.6, 1])
    for (over_time, largest), (name, unit, series, peak) in zip(grid, errors, strict=True):
        bound = getattr(comparison.conditions.bounds, name)
        peaks = [getattr(metrics, peak).max() for metrics in comparison.metrics]
        _over_time(over_time, comparison, series)
        _distribution(largest, comparison, peak)
        top = 1.05 * float(max(peaks))
        # Otherwise the curves would be flat.
        if bound <= BOUND_IN_VIEW * max(peaks):
            largest.axvline(1e3 * bound, color="black", linewidth=1.0)
            top = max(top, 1.1 * bound)
        _draw_bound(over_time, bound, unit)
        over_time.set(ylim=(0, 1e3 * top or 1.0), ylabel=f"{name} error [{unit}]")
        largest.set(
            xlabel=f"largest {name} error [{unit}]", ylabel="fraction of draws", ylim=(0, 1.02)
        )
    grid[-1, 0].set_xlabel("time [s]")
    add_legend(figure, grid[0, 0])
    title = [comparison.describe(f"payload {comparison.payload:g} kg")]
    if comparison.draws > 1:
        band = "mean over draws, band from the 5th to the 95th percentile"
        if any(metrics.ended.any() for metrics in comparison.metrics):
            band += "; draws that ended early are excluded after their end"
        title.append(band)
    set_title(figure, *title)
    return figure


def draw_payload_comparison(comparison: PayloadComparison) -> Figure:
    """Draws the largest errors, the torque and the success rate over the payload.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    common = comparison.comparisons[0]
    payloads = comparison.payloads
    rows = [("max_error", "position error,\nlargest [mm]", 1e3)]
    if not common.task.robot.point_mass:
        rows.append(("max_rotation", "rotation error,\nlargest [mrad]", 1e3))
    rows.append(("rms_torque", "torque, root\nmean square [N·m]", 1.0))
    rows.append(("success", "success rate [%]", 100.0))
    figure = new_figure(1.4 + 1.9 * len(rows))
    panels = figure.subplots(len(rows), 1, sharex=True)
    for axes, (name, label, factor) in zip(panels, rows, strict=True):
        for index, policy in enumerate(comparison.policies):
            estimates = []
            for compared in comparison.comparisons:
                metrics = compared.metrics[index]
                estimate = metrics.success
                if name != "success":
                    estimate = metrics.estimate(name)
                estimates.append((estimate.mean, estimate.low, estimate.high))
            mean, low, high = factor * np.array(estimates).T
            line = _line(index)
            if common.draws > 1:
                axes.fill_between(payloads, low, high, color=line["color"], alpha=0.2, linewidth=0)
            axes.plot(payloads, mean, marker=".", label=f" {policy}", **line)
        axes.set_ylabel(label)
    bounds = vars(common.conditions.bounds).values()
    for axes, bound, unit in zip(panels[:-2], bounds, ("mm", "mrad"), strict=False):
        _draw_bound(axes, bound, unit)
    for axes in panels[:-1]:
        axes.set_ylim(bottom=0)
    panels[-1].set(xlabel="payload [kg]", ylim=(-4, 104))
    add_legend(figure, panels[0])
    title = [common.describe()]
    if common.draws > 1:
        title.append("mean over draws, with 95 % confidence")
    set_title(figure, *title)
    return figure


def _draw_bound(axes: Axes, bound: float, unit: str) -> None:
    """Draws a bound, and states it above the panel. ``unit`` is a thousandth of the SI unit."""
    axes.axhline(1e3 * bound, color="black", linewidth=1.0)
    axes.set_title(
        f"bound {1e3 * bound:g} {unit}: black line", fontsize=10, loc="right", color=GREY
    )


def _line(index: int) -> dict[str, Any]:
    """Keywords of matplotlib for the curves of a policy."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": STYLES[index % len(STYLES)],
        "linewidth": 1.8,
    }


def _over_time(axes: Axes, comparison: Comparison, series: str) -> None:
    """Draws an error of all policies over time: mean and quantiles of the draws."""
    for index, metrics in enumerate(comparison.metrics):
        error: Array = 1e3 * getattr(metrics, series)
        time = np.arange(1, len(error) + 1) / comparison.task.control_frequency
        line = _line(index)
        if comparison.draws > 1:
            low, high = np.nanquantile(error, BAND, axis=1)
            axes.fill_between(time, low, high, color=line["color"], alpha=0.2, linewidth=0)
        label = f" {metrics.policy}"  # the space keeps names with a leading "_" in the legend
        axes.plot(time, np.nanmean(error, axis=1), label=label, **line)
    axes.set_xlim(0, comparison.task.trajectory.duration)


def _distribution(axes: Axes, comparison: Comparison, peak: str) -> None:
    """Draws the distribution of a largest error of all policies over the draws."""
    for index, metrics in enumerate(comparison.metrics):
        axes.ecdf(1e3 * getattr(metrics, peak), **_line(index))
