"""Figures of an identification: measured and modelled responses over time, and their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, VERMILLION
from cablebot_winches.identification.log import GAP
from cablebot_winches.identification.result import Identification, Response, shown_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 0.95
"""Fraction of the residuals within the shaded band."""

_ROW = 1.7
"""Height of a row [inch]."""

_FRAME = 1.2
"""Height of title and legend [inch]."""


def draw_identification(result: Identification) -> dict[str, Figure]:
    """Draws ``torques``, the responses of motors and platform, and ``lengths``, those of the cables,
    whichever the result has.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    groups: dict[str, list[Response]] = {"torques": [], "lengths": []}
    for response in result.responses:
        name = "torques"
        if response.unit == "m":
            name = "lengths"
        groups[name].append(response)
    return {name: _draw(responses, result) for name, responses in groups.items() if responses}


def _draw(responses: Sequence[Response], result: Identification) -> Figure:
    """A row with response and residual of each equation. The logs follow one another in time."""
    figure = new_figure(_FRAME + _ROW * len(responses))
    starts = _starts(responses, len(result.logs))
    panels = figure.subplots(len(responses), 2, sharex=True, squeeze=False)
    for (response, residual), item in zip(panels, responses, strict=True):
        _draw_response(response, residual, item, starts)
        for axes in (response, residual):
            for start in starts[1:]:
                axes.axvline(start, color=GREY, linewidth=0.8, linestyle=":")
    label = "time [s]"
    if len(result.logs) > 1:
        label = "time, one log after the other [s]"
    for axes in panels[-1]:
        axes.set_xlabel(label)
    title = f"{result.robot.name}: measured and modelled responses; logs {', '.join(result.logs)}"
    set_title(figure, title)
    add_legend(figure, panels[0, 0])
    return figure


def _draw_response(response: Axes, residual: Axes, item: Response, starts: Array) -> None:
    """Draws one equation into its two panels."""
    unit, factor = shown_unit(item.unit)
    order = np.lexsort((item.time, item.log))
    start_times = np.zeros(len(starts))  # in the logs
    for log in np.unique(item.log):
        start_times[log] = item.time[item.log == log].min()
    time = item.time - start_times[item.log] + starts[item.log]
    time = time[order]
    residuals = item.residual[order]
    measured = item.measured[order]
    modelled = measured - residuals
    errors = factor * residuals
    # No line crosses a gap, such as a standstill, whose samples are left out, or the next log.
    steps = np.diff(time)
    is_gap = steps > GAP * np.median(steps)
    is_gap |= np.diff(item.log[order]) > 0
    breaks = np.flatnonzero(is_gap) + 1
    time, measured, modelled, errors = (
        np.insert(values, breaks, np.nan) for values in (time, measured, modelled, errors)
    )
    curves = [("measured", measured, BLUE), ("modelled", modelled, VERMILLION)]
    # The noisier curve lies below: it would hide the other one.
    curves.sort(key=lambda curve: float(np.nanstd(np.diff(curve[1]))), reverse=True)
    for (label, values, color), width in zip(curves, (1.6, 1.0), strict=True):
        response.plot(time, values, color=color, linewidth=width, label=label)
    response.set_ylabel(f"{item.equation} [{item.unit}]")
    bound = float(np.nanquantile(np.abs(errors), SHOWN))
    response.fill([], [], color=SHADE, label=f"{SHOWN:.0%} of the residuals")
    residual.axhspan(-bound, bound, color=SHADE)
    residual.plot(time, errors, color=BLUE, linewidth=0.6)
    residual.annotate(
        f"± {bound:.2g} {unit}",
        (0.99, 0.96),
        xycoords="axes fraction",
        horizontalalignment="right",
        verticalalignment="top",
        bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85},
    )
    residual.set_ylabel(f"residual [{unit}]")


def _starts(responses: Sequence[Response], logs: int) -> Array:
    """Times at which the logs start in the figure, (logs,) [s]."""
    durations = np.zeros(logs)
    for item in responses:
        for log in np.unique(item.log):
            duration = float(np.ptp(item.time[item.log == log]))
            durations[log] = max(durations[log], duration)
    return np.cumsum(durations) - durations
