"""A comparison, drawn: errors over time and their largest values over draws, as the paper's Fig. 9. Extra ``plot``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.envs import described
from cablebot_gym.evaluation.comparison import Comparison
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import DPI, add_legend, entitle, new_figure
from cablebot_gym.utils.files import write_whole
from cablebot_gym.utils.palette import BLACK, BLUE, DEEP_SKY, GREEN, GREY, ORANGE, PURPLE, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, DEEP_SKY, BLACK)
"""Of policies in order."""

STYLES = ("-", "--", "-.", ":")
"""Lines differ by more than their colour."""

BAND = (0.05, 0.95)
"""Quantiles over draws between which the band lies."""

FAR = 5.0
"""How many times the largest error a bound may be and still be drawn."""


def draw_comparison(comparison: Comparison) -> Figure:
    """Position error, and rotation error of a spatial robot, over time and as distribution of the largest one.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    kinds = [("position", "mm", "error", "max_error")]
    if not comparison.task.robot.planar:
        kinds.append(("rotation", "mrad", "rotation", "max_rotation"))
    figure = new_figure(1.6 + 2.6 * len(kinds))
    grid = figure.subplots(
        len(kinds), 2, squeeze=False, width_ratios=[1.6, 1], sharex="col" if len(kinds) < 2 else False
    )
    for (over_time, largest), (name, unit, series, peak) in zip(grid, kinds, strict=True):
        bound = getattr(comparison.limits, name)
        seen = max(float(np.max(getattr(one, peak))) for one in comparison.measured)
        _over_time(over_time, comparison, series)
        over_time.set(ylabel=f"{name} error [{unit}]")
        _distribution(largest, comparison, peak)
        if bound <= FAR * seen:
            over_time.axhline(1e3 * bound, color="black", linewidth=1.0)
            largest.axvline(1e3 * bound, color="black", linewidth=1.0)
            where, top = "black line", max(1.05 * seen, 1.1 * bound)
        else:  # nothing would be seen of the errors beside it
            where, top = "far above", 1.05 * seen
        # Above the panel, where no curve can cross it.
        over_time.set_title(f"bound {1e3 * bound:g} {unit}: {where}", fontsize=10, loc="right", color=GREY)
        over_time.set(ylim=(0, 1e3 * top or 1.0))
        largest.set(xlabel=f"largest {name} error [{unit}]", ylabel="share of draws", ylim=(0, 1.02))
    grid[-1, 0].set_xlabel("time [s]")
    add_legend(figure, grid[0, 0])
    draws = f"{comparison.draws} draws of {comparison.uncertainty}" if comparison.uncertainty else "no uncertainty"
    told = "told" if comparison.payload_known else "not told"
    where = described(comparison.env_id, comparison.task.robot.name)
    head = f"{where}, payload {comparison.payload:g} kg, {told}; {draws}"
    band = ["mean over draws, band from the 5th to the 95th percentile"] if comparison.draws > 1 else []
    if band and any(one.ended.any() for one in comparison.measured):
        band[0] += "; draws that ended early are left out from then on"
    entitle(figure, head, *band)
    return figure


def save_comparison(comparison: Comparison, folder: Path) -> Path:
    """Writes ``comparison.png``; an interrupt leaves no half-written file.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figure, path = draw_comparison(comparison), folder / "comparison.png"
    write_whole(path, partial(figure.savefig, dpi=DPI, format="png"))
    return path


def _over_time(axes: Axes, comparison: Comparison, series: str) -> None:
    for place, one in enumerate(comparison.measured):  # labels begin with a space: matplotlib hides those with "_"
        error: Array = 1e3 * getattr(one, series)
        time = np.arange(1, len(error) + 1) / comparison.task.control_frequency
        colour, style = COLOURS[place % len(COLOURS)], STYLES[place % len(STYLES)]
        if comparison.draws > 1:
            low, high = np.nanquantile(error, BAND, axis=1)
            axes.fill_between(time, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(time, np.nanmean(error, axis=1), style, color=colour, linewidth=1.8, label=f" {one.policy}")
    axes.set_xlim(0, comparison.task.trajectory.duration)


def _distribution(axes: Axes, comparison: Comparison, peak: str) -> None:
    for place, one in enumerate(comparison.measured):
        colour, style = COLOURS[place % len(COLOURS)], STYLES[place % len(STYLES)]
        axes.ecdf(1e3 * getattr(one, peak), color=colour, linestyle=style, linewidth=1.8)
