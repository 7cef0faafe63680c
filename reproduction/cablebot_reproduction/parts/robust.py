"""Figs. 8 and 9: robust control of the paper under its uncertainty (Table 6), and effect of the
boundary layer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cablebot_baselines.laws import PD, FeedbackLinearization, RobustPD
from cablebot_baselines.laws.outer_loop import PAPER_GAINS
from cablebot_gym.evaluation import Comparison
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.comparison import COLOURS, STYLES
from cablebot_gym.plotting.figures import new_figure, set_title
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREEN, GREY, VERMILLION
from cablebot_reproduction.outcome import Number, Numbers, Outcome, Table
from cablebot_reproduction.robots import FLEXIBLE_OF_4, RIGID_OF_4, paper_circle
from cablebot_reproduction.simulation import (
    Law,
    compared,
    composite,
    episode,
    eq22,
    peak_error_mm,
    with_robust_term,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LAYERS = {"1e-2": 1e-2, "3e-3": 3e-3, "1e-3": 1e-3, "3e-4": 3e-4, "1e-4": 1e-4}
"""Boundary layers ε of Fig. 9 by their text; the paper prints no value."""

DRAWS = 200
"""Number of draws of Table 6 for each ε."""

_ROBUST = {"uncertainty": "table6", "seed": 0}
"""Conditions of the draw in the figures."""


def robust_fl(robot: Robot, **options: float) -> Any:
    """Feedback linearization with Δv."""
    return with_robust_term(FeedbackLinearization(robot), **options)


def robust_composite(robot: Robot, **options: float) -> Any:
    """The composite law with Δv."""
    return with_robust_term(composite(robot), **options)


def robust_eq22(robot: Robot) -> Any:
    """Eq. 22 as printed with Δv, the law of §4.4."""
    return with_robust_term(eq22(robot))


class _Case(NamedTuple):
    robot: Robot
    name: str
    plain: Law
    robust: Callable[..., Any]


CASES = {
    "": _Case(RIGID_OF_4, "rigid joints", FeedbackLinearization, robust_fl),
    "flex_": _Case(FLEXIBLE_OF_4, "joint springs K = 2 N·m/rad", composite, robust_composite),
}
"""Robots with their ordinary and their robust law, by the prefix of the numbers."""


class Added(NamedTuple):
    """Robust term along an episode."""

    times: Array
    """Control instants, shape (K,) [s]."""
    term: Array
    """Δv (Eq. 34) at the measured state, shape (K, 6) [m/s², rad/s²]."""
    outside: Array
    """Whether ‖BᵀPe‖ ≥ ε, which implies ‖Δv‖ = ρ, shape (K,)."""


def added_input(outer: RobustPD, loop: Rollout, robot: Robot) -> Added:
    """Robust term of an outer loop in its own episode, computed from the recorded motion.

    The last recorded instant is the end of the motion and has no action, so it is omitted.
    """
    arrays = loop.arrays
    times = arrays["time"][:-1]
    reference = paper_circle(robot)(times)
    blocks = {
        "pose": arrays["pose"][:-1],
        "velocity": arrays["velocity"][:-1],
        "reference_pose": reference.position,
        "reference_velocity": reference.velocity,
        "reference_acceleration": reference.acceleration,
    }
    size = np.linalg.norm(outer.switching(blocks), axis=-1)
    ordinary = PD(gains=outer.gains)
    return Added(times, outer(blocks) - ordinary(blocks), size >= outer.boundary_layer)


def fig8() -> Outcome:
    """Robust term in the input."""
    outer = RobustPD(gains=PAPER_GAINS["spatial"])
    numbers: Numbers = {}
    figure = new_figure(5.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (prefix, case) in enumerate(CASES.items()):
        added = added_input(outer, episode(case.robust, case.robot, **_ROBUST), case.robot)
        size = np.linalg.norm(added.term, axis=1)
        change = np.linalg.norm(np.diff(added.term, axis=0), axis=1)
        rms = np.sqrt(np.mean(size**2))
        numbers[f"{prefix}peak_dv"] = size.max()
        numbers[f"{prefix}rms_dv"] = rms
        numbers[f"{prefix}chatter"] = np.sqrt(np.mean(change**2)) / rms
        numbers[f"{prefix}outside_layer"] = added.outside.mean()
        for row, (unit, names) in enumerate((("m/s²", "xyz"), ("rad/s²", "ψθφ"))):
            axes = grid[row, column]
            for index, name in enumerate(names):
                values = added.term[:, 3 * row + index]
                axes.plot(added.times, values, STYLES[index], color=COLOURS[index], label=name)
            axes.set(xlim=(0, 1), xlabel="time [s]", ylabel=f"Δv [{unit}]")
            axes.legend(fontsize=8, ncols=3, loc="upper left")
            axes.label_outer()
        grid[0, column].set_title(case.name, fontsize=11)
    layer = f"ε = {outer.boundary_layer:g}, ζ = {outer.zeta:g}, φ = {outer.phi:g}"
    set_title(figure, f"Robust term Δv (Eq. 34), one draw of Table 6; boundary layer {layer}")
    return Outcome(numbers=numbers, figure=figure)


def fig9() -> Outcome:
    """Tracking under uncertainty with the ordinary and the robust law."""
    numbers: Numbers = {}
    rows: list[list[Number]] = []
    figure = new_figure(11.4)
    grid = figure.subplots(3, 2, height_ratios=[1.15, 1.15, 1])
    for index, (prefix, case) in enumerate(CASES.items()):
        loops = {
            "ordinary": episode(case.plain, case.robot, **_ROBUST),
            "robust": episode(case.robust, case.robot, **_ROBUST),
        }
        numbers |= _draw_numbers(prefix, loops["ordinary"], loops["robust"])
        comparison = _comparison(case)
        rows += _reduction_rows(prefix, case.name, comparison, numbers)
        plane, errors = grid[index]
        _draw_plane(plane, loops)
        plane.set_title(f"{case.name}, deviations × {_MAGNIFICATION}", fontsize=10)
        _draw_errors(errors, loops)
        _draw_layers(grid[2, index], prefix, numbers)
        grid[2, index].set_title(f"{case.name}, {DRAWS} draws", fontsize=10)
    for name, law in (("plain", eq22), ("robust", robust_eq22)):
        loop = episode(law, FLEXIBLE_OF_4, **_ROBUST)
        numbers[f"eq22_draw_{name}_peak_mm"] = peak_error_mm(loop)
    set_title(
        figure,
        "Tracking with the uncertainty of Table 6, nominal mass 11 kg known: ordinary and robust law",
        "top and middle: one draw, ε = 0.001; bottom: all draws versus boundary layer",
    )
    header = (
        "robot",
        "ε",
        "reduction of the summed error [%]",
        "95% interval",
        "reduction of the largest error [%]",
        "95% interval",
        "fraction ended early, ordinary law",
        "fraction ended early, robust law",
    )
    title = f"Error reduction of the robust law relative to the ordinary law over {DRAWS} draws of Table 6"
    table = Table(title=title, header=header, rows=rows)
    return Outcome(numbers=numbers, tables=(table,), figure=figure)


def _draw_numbers(prefix: str, plain: Rollout, robust: Rollout) -> Numbers:
    """Numbers of the draw in the figure."""
    total = robust.arrays["tracking_error"].sum() / plain.arrays["tracking_error"].sum()
    deviation = plain.arrays["pose"] - plain.arrays["reference_pose"]
    return {
        f"{prefix}draw_sum_reduction": 1 - total,
        f"{prefix}draw_max_reduction": 1 - peak_error_mm(robust) / peak_error_mm(plain),
        f"{prefix}draw_plain_peak_mm": peak_error_mm(plain),
        f"{prefix}draw_robust_peak_mm": peak_error_mm(robust),
        f"{prefix}draw_plain_peak_xy_mm": 1e3 * np.linalg.norm(deviation[:, :2], axis=1).max(),
    }


def _comparison(case: _Case) -> Comparison:
    """The ordinary law, and the robust law for each ε, over the same draws."""
    laws = {"ordinary": case.plain}
    for name, layer in LAYERS.items():
        laws[f"robust {name}"] = partial(case.robust, boundary_layer=layer)
    return compared(laws, case.robot, uncertainty="table6", draws=DRAWS)


def _reduction_rows(
    prefix: str, robot: str, comparison: Comparison, numbers: Numbers
) -> list[list[Number]]:
    """Rows of the table of reductions; adds the reductions to the numbers."""
    rows = []
    ended = [metrics.ended.mean() for metrics in comparison.metrics]
    for index, (name, layer) in enumerate(LAYERS.items(), 1):
        row: list[Number] = [robot, layer]
        for kind, quantity in (("sum", "mean_error"), ("max", "max_error")):
            reduction = comparison.reduction(index, quantity)
            key = f"{prefix}{kind}_reduction_{name}"
            numbers[key] = reduction.mean
            numbers[f"{key}_low"] = reduction.low
            numbers[f"{key}_high"] = reduction.high
            row += [
                100 * reduction.mean,
                f"{100 * reduction.low:.1f} to {100 * reduction.high:.1f}",
            ]
        rows.append([*row, ended[0], ended[index]])
    return rows


_MAGNIFICATION = 5
_CURVES: dict[str, dict[str, Any]] = {
    "ordinary": {"color": VERMILLION, "linestyle": "-"},
    "robust": {"color": GREEN, "linestyle": ":"},
}


def _draw_plane(axes: Axes, loops: Mapping[str, Rollout]) -> None:
    """Draws the path seen along z with magnified deviations."""
    reference = loops["ordinary"].arrays["reference_pose"][:, :2]
    axes.plot(*reference.T, color="black", linewidth=0.8, label="reference")
    for law, loop in loops.items():
        deviation = loop.arrays["pose"][:, :2] - reference
        drawn = reference + _MAGNIFICATION * deviation
        axes.plot(*drawn.T, label=law, **_CURVES[law])
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.legend(fontsize=9, loc="center")


def _draw_errors(axes: Axes, loops: Mapping[str, Rollout]) -> None:
    for law, loop in loops.items():
        axes.plot(loop.arrays["time"], 1e3 * loop.arrays["tracking_error"], **_CURVES[law])
    axes.axhline(1e3 * ErrorBounds().position, color="black", linewidth=1.0, label="R")
    axes.set(xlim=(0, 1), ylim=(0, None), xlabel="time [s]", ylabel="position error ‖e‖ [mm]")
    axes.legend(fontsize=9)


def _draw_layers(axes: Axes, prefix: str, numbers: Mapping[str, Any]) -> None:
    """Draws the reductions with their confidence intervals versus the boundary layer."""
    layers = list(LAYERS.values())
    for kind, label, colour in (("sum", "sum of the error", BLUE), ("max", "largest error", GREY)):
        curves = []
        for end in ("", "_low", "_high"):
            curves.append([100 * numbers[f"{prefix}{kind}_reduction_{e}{end}"] for e in LAYERS])
        mean, low, high = curves
        axes.fill_between(layers, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(layers, mean, "o-", markersize=4, color=colour, label=label)
    axes.axhline(60, color="black", linewidth=1.0, label="paper: more than 60 %")
    axes.set(xscale="log", ylim=(0, 100), xlabel="boundary layer ε", ylabel="error reduction [%]")
    axes.invert_xaxis()
    axes.legend(fontsize=9, loc="lower right")
