"""Figs. 8 and 9: robust control of the paper under its uncertainty (Table 6), and effect of the
boundary layer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines import classical
from cablebot_baselines.classical.outer_loop import PAPER_GAINS
from cablebot_gym.benchmark.engine import Job
from cablebot_gym.evaluation.comparison import CONFIDENCE, Estimate
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cablebot_reproduction.exact import paper_circle
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.part import Jobs, Number, Outcome, Results, Table, job
from cablebot_reproduction.parts.plotting import (
    LEGEND,
    MOTORS,
    add_headroom,
    add_loop_title,
    coordinate_curves,
)
from cablebot_reproduction.published import published_value
from cablebot_reproduction.runs import FLEX, SPATIAL, Law, closed_loop, compared

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LAYERS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
"""Boundary layers ε of Fig. 9; the paper prints no value."""

DRAWS = 200
"""Number of draws of Table 6 for each ε."""

SEED = 0
"""Seed of the draw in the figures."""

PUBLISHED = published_value("4.4.sum")
"""Published reduction "more than 60 %" (§4.4) [%]."""

_PREFIX = {SPATIAL: "", FLEX: "flex_"}
"""Prefix of the names of the numbers."""

_LAWS: dict[str, tuple[Law, Law]] = {
    SPATIAL: (classical.FeedbackLinearization, classical.Robust),
    FLEX: (classical.Composite, classical.RobustComposite),
}
"""Ordinary and robust law."""

_CURVES = {"plain": ("ordinary", "-", VERMILLION), "robust": ("robust", ":", MOTORS[2])}
"""Name, line style and colour of each law."""


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """Error reduction of a robust law relative to the ordinary law over the same draws of Table
    6."""

    layer: float
    """Boundary layer ε."""
    total: Estimate
    """Reduction of the sum of the error over time."""
    largest: Estimate
    """Reduction of the largest error."""
    lost: tuple[float, float]
    """Fractions of the draws that ended early with the ordinary and with the robust law."""


def reductions(
    *,
    env_id: str,
    plain: Law,
    robust: Callable[..., Any],
    robot: Robot,
    layers: tuple[float, ...],
    draws: int,
) -> tuple[Reduction, ...]:
    """Reductions for each ε at zero payload. The laws know the nominal platform mass."""
    laws: list[tuple[str, Law]] = [("plain", plain)]
    for layer in layers:
        laws.append((f"robust {layer:g}", partial(robust, boundary_layer=layer)))
    comparison = compared(
        env_id=env_id, laws=tuple(laws), robot=robot, uncertainty="table6", draws=draws
    )
    lost = [float(metrics.ended.mean()) for metrics in comparison.metrics]
    reductions = []
    for index, layer in enumerate(layers, 1):
        reduction = Reduction(
            layer=layer,
            total=comparison.reduction(index, "mean_error"),
            largest=comparison.reduction(index, "max_error"),
            lost=(lost[0], lost[index]),
        )
        reductions.append(reduction)
    return tuple(reductions)


@dataclass(frozen=True, kw_only=True, eq=False)
class Added:
    """Robust term along an episode."""

    times: Array
    """Control instants, shape (K,) [s]."""
    term: Array
    """Δv (Eq. 34) at the measured state, shape (K, 6) [m/s², rad/s²]."""
    outside: Array
    """Whether ‖BᵀPe‖ ≥ ε, which implies ‖Δv‖ = ρ, shape (K,)."""


def added_input(outer: classical.RobustPD, loop: Rollout, robot: Robot) -> Added:
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
    ordinary = classical.PD(gains=outer.gains)
    term = outer(blocks) - ordinary(blocks)
    return Added(times=times, term=term, outside=size >= outer.boundary_layer)


def _robots(interpretation: Interpretation) -> dict[str, Robot]:
    return {
        SPATIAL: interpretation.closed_loop_robot(interpretation.spatial("control")),
        FLEX: interpretation.closed_loop_robot(interpretation.flexible("control")),
    }


def robust_eq22(robot: Robot) -> classical.PaperFlexible:
    """Eq. 22 as printed with Δv added to v, the law of §4.4."""
    law = classical.PaperFlexible(robot, as_printed=True)
    law.outer = classical.RobustPD(gains=PAPER_GAINS["spatial"])
    return law


def _episode(env_id: str, law: Law, robot: Robot) -> Job:
    return job(closed_loop, env_id=env_id, law=law, robot=robot, uncertainty="table6", seed=SEED)


def _robot_title(interpretation: Interpretation, env_id: str) -> str:
    if env_id == SPATIAL:
        return "rigid joints"
    return f"joint springs K = {interpretation.flexible('control').stiffness[0]:g} N·m/rad"


# --- Fig. 8 -----------------------------------------------------------------------------------------------------------


def term_jobs(interpretation: Interpretation) -> Jobs:
    """Episodes of Fig. 8."""
    jobs = {}
    for env_id, robot in _robots(interpretation).items():
        _, robust = _LAWS[env_id]
        jobs[env_id] = _episode(env_id, robust, robot)
    return jobs


def _terms(interpretation: Interpretation, results: Results) -> dict[str, Added]:
    terms = {}
    for env_id, robot in _robots(interpretation).items():
        _, robust = _LAWS[env_id]
        outer = robust(robot).outer
        terms[env_id] = added_input(outer, results[env_id], robot)
    return terms


def term_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 8."""
    numbers: dict[str, Number] = {
        "boundary_layer": classical.RobustPD.boundary_layer,
        "plant": "rigid; flex_: with joint springs",
    }
    for env_id, added in _terms(interpretation, results).items():
        prefix = _PREFIX[env_id]
        size = np.linalg.norm(added.term, axis=1)
        changes = np.diff(added.term, axis=0)
        change = np.linalg.norm(changes, axis=1)
        rms = float(np.sqrt(np.mean(size**2)))
        change_rms = float(np.sqrt(np.mean(change**2)))
        numbers[f"{prefix}peak_dv"] = float(size.max())
        numbers[f"{prefix}rms_dv"] = rms
        numbers[f"{prefix}chatter"] = change_rms / rms
        numbers[f"{prefix}outside_layer"] = float(added.outside.mean())
    return Outcome(numbers=numbers)


def draw_term(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 8."""
    figure = new_figure(5.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (env_id, added) in enumerate(_terms(interpretation, results).items()):
        for row, unit in enumerate(("m/s²", "rad/s²")):
            axes = grid[row, column]
            offset = 3 * row
            coordinates = added.term[:, offset : offset + 3]
            coordinate_curves(axes, added.times, coordinates, offset)
            axes.set(xlim=(0, 1), xlabel="time [s]", ylabel=f"Δv [{unit}]")
            axes.label_outer()
        grid[0, column].set_title(_robot_title(interpretation, env_id), fontsize=11)
    for axes in grid[:, 0]:
        axes.legend(**LEGEND, ncols=3, loc="upper left")
        add_headroom(axes, above=0.2)
    law = classical.RobustPD
    layer = f"boundary layer ε = {law.boundary_layer:g}, ζ = {law.zeta:g}, φ = {law.phi:g}"
    add_loop_title(figure, interpretation, f"Robust term Δv (Eq. 34), one draw of Table 6; {layer}")
    return figure


# --- Fig. 9 -----------------------------------------------------------------------------------------------------------


def tracking_jobs(interpretation: Interpretation) -> Jobs:
    """Episodes and reductions of Fig. 9. The prefix ``eq22`` is the law of the paper with joint
    springs."""
    jobs = {}
    robots = _robots(interpretation)
    for env_id, robot in robots.items():
        plain, robust = _LAWS[env_id]
        jobs[f"{env_id} plain"] = _episode(env_id, plain, robot)
        jobs[f"{env_id} robust"] = _episode(env_id, robust, robot)
        jobs[f"{env_id} layers"] = job(
            reductions,
            env_id=env_id,
            plain=plain,
            robust=robust,
            robot=robot,
            layers=LAYERS,
            draws=DRAWS,
        )
    eq22 = partial(classical.PaperFlexible, as_printed=True)
    jobs["eq22 plain"] = _episode(FLEX, eq22, robots[FLEX])
    jobs["eq22 robust"] = _episode(FLEX, robust_eq22, robots[FLEX])
    return jobs


def reduced(plain: Rollout, robust: Rollout, name: str) -> float | None:
    """Reduction of the sum or maximum of the error in one draw; None if an episode ended early."""
    if plain.reason or robust.reason:
        return None
    reduce: Any = np.max
    if name == "tracking_error":
        reduce = np.sum
    plain_error = float(reduce(plain.arrays[name]))
    robust_error = float(reduce(robust.arrays[name]))
    return 1 - robust_error / plain_error


def layer_name(layer: float) -> str:
    """ε as in the names of the numbers, for example 1e-3."""
    return f"{layer:.0e}".replace("e-0", "e-")


def tracking_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 9."""
    numbers: dict[str, Number] = {"draws": DRAWS}
    rows: list[tuple[Number, ...]] = []
    for env_id, prefix in _PREFIX.items():
        plain = results[f"{env_id} plain"]
        robust = results[f"{env_id} robust"]
        numbers[f"{prefix}draw_sum_reduction"] = reduced(plain, robust, "tracking_error")
        numbers[f"{prefix}draw_max_reduction"] = reduced(plain, robust, "tracking_error_peak")
        numbers[f"{prefix}draw_plain_peak_mm"] = _peak_mm(plain)
        numbers[f"{prefix}draw_robust_peak_mm"] = _peak_mm(robust)
        difference = plain.arrays["pose"] - plain.arrays["reference_pose"]
        distance = np.linalg.norm(difference[:, :2], axis=1)
        numbers[f"{prefix}draw_plain_peak_xy_mm"] = 1e3 * float(distance.max())
        for reduction in results[f"{env_id} layers"]:
            row: list[Number] = [_robot_title(interpretation, env_id), reduction.layer]
            for name, fraction in (("sum", reduction.total), ("max", reduction.largest)):
                key = f"{prefix}{name}_reduction_{layer_name(reduction.layer)}"
                numbers[key] = fraction.mean
                numbers[f"{key}_low"] = fraction.low
                numbers[f"{key}_high"] = fraction.high
                row.append(100 * fraction.mean)
                row.append(f"{100 * fraction.low:.1f} to {100 * fraction.high:.1f}")
            rows.append((*row, *reduction.lost))
    numbers["eq22_draw_plain_peak_mm"] = _peak_mm(results["eq22 plain"])
    numbers["eq22_draw_robust_peak_mm"] = _peak_mm(results["eq22 robust"])
    header = (
        "robot",
        "ε",
        "reduction of the summed error [%]",
        f"reduction of the summed error, {CONFIDENCE:.0%} interval",
        "reduction of the largest error [%]",
        f"reduction of the largest error, {CONFIDENCE:.0%} interval",
        "fraction of episodes ended early, ordinary law",
        "fraction of episodes ended early, robust law",
    )
    title = f"Error reduction of the robust law relative to the ordinary law over {DRAWS} draws of Table 6"
    table = Table(title=title, header=header, rows=tuple(rows))
    return Outcome(numbers=numbers, tables=(table,))


def _peak_mm(loop: Rollout) -> float:
    return 1e3 * float(loop.arrays["tracking_error_peak"].max())


def draw_tracking(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 9."""
    figure = new_figure(11.4)
    grid = figure.subplots(3, 2, height_ratios=[1.15, 1.15, 1])
    for row, env_id in enumerate(_PREFIX):
        robot = _robot_title(interpretation, env_id)
        loops = {"plain": results[f"{env_id} plain"], "robust": results[f"{env_id} robust"]}
        plane, errors = grid[row]
        magnification = _draw_plane(plane, loops)
        plane.set_title(f"{robot}, deviations × {magnification}", fontsize=10)
        _draw_errors(errors, loops)
        errors.set_title(f"{robot}, error", fontsize=10)
        layers = grid[2, row]
        _draw_layers(layers, results[f"{env_id} layers"])
        layers.set_title(f"{robot}, {DRAWS} draws", fontsize=10)
    mass = interpretation.spatial("control").mass
    title = f"Tracking with the uncertainty of Table 6, nominal mass {mass:g} kg known: ordinary and robust law"
    layer = f"ε = {classical.RobustPD.boundary_layer:g}"
    legend = f"top and middle: one draw, {layer}; bottom: all draws versus boundary layer"
    add_loop_title(figure, interpretation, title, legend)
    return figure


def _draw_plane(axes: Axes, loops: Mapping[str, Rollout]) -> int:
    """Draws the path seen along z with magnified deviations, and returns the magnification."""
    references, deviations = {}, {}
    largest = 0.0
    for law, loop in loops.items():
        reference = loop.arrays["reference_pose"][:, :2]
        deviation = loop.arrays["pose"][:, :2] - reference
        references[law] = reference
        deviations[law] = deviation
        largest = max(largest, float(np.abs(deviation).max()))
    reference = max(references.values(), key=len)
    size = float(np.ptp(reference, axis=0).max())
    magnification = 1
    for factor in (2, 5, 10, 20, 50, 100, 200, 500):
        if factor * largest <= 0.22 * size:
            magnification = factor
    axes.plot(*reference.T, color="black", linewidth=0.8, label="reference")
    for law, deviation in deviations.items():
        drawn = references[law] + magnification * deviation
        _draw_curve(axes, law, *drawn.T)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.legend(**LEGEND, loc="center")
    return magnification


def _draw_curve(axes: Axes, law: str, x: Array, y: Array) -> None:
    name, style, colour = _CURVES[law]
    axes.plot(x, y, style, color=colour, linewidth=2.0, label=name)


def _draw_errors(axes: Axes, loops: Mapping[str, Rollout]) -> None:
    radius = 1e3 * ErrorBounds().position
    for law, loop in loops.items():
        error = 1e3 * loop.arrays["tracking_error"]
        _draw_curve(axes, law, loop.arrays["time"], error)
    axes.axhline(radius, color="black", linewidth=1.0, label=f"R = {radius:g} mm")
    axes.set(xlim=(0, 1), ylim=(0, None))
    axes.set(xlabel="time [s]", ylabel="position error ‖e‖ [mm]")
    axes.legend(**LEGEND, loc="upper left")


def _draw_layers(axes: Axes, points: tuple[Reduction, ...]) -> None:
    _draw_reduction(axes, points, "total", label="sum of the error", color=BLUE, linestyle="-")
    _draw_reduction(axes, points, "largest", label="largest error", color=GREY, linestyle="--")
    axes.axhline(PUBLISHED, color="black", linewidth=1.0, label="paper: more than 60 %")
    axes.set(xscale="log", ylim=(0, 100))
    axes.set(xlabel="boundary layer ε", ylabel="error reduction [%]")
    axes.invert_xaxis()
    axes.legend(**LEGEND, loc="lower right")


def _draw_reduction(
    axes: Axes, points: tuple[Reduction, ...], name: str, *, color: str, **style: Any
) -> None:
    """Draws a reduction with its confidence interval versus the boundary layer."""
    layers, rows = [], []
    for point in points:
        fraction: Estimate = getattr(point, name)
        layers.append(point.layer)
        rows.append((fraction.low, fraction.mean, fraction.high))
    low, mean, high = 100 * np.array(rows).T
    axes.fill_between(layers, low, high, color=color, alpha=0.25, linewidth=0)
    axes.plot(layers, mean, marker="o", markersize=4, color=color, linewidth=1.6, **style)


# --- verdicts ---------------------------------------------------------------------------------------------------------

_CHOICE = "joint springs, ε = 1e-3, ζ and φ of this project"

_LAYER_NAMES = ("1e-2", "1e-3", "1e-4")
"""Boundary layers of the verdicts."""


@verdict("4.4.sum", "fig9", choice=_CHOICE)
def summed_error_is_reduced(run: Run) -> Judgement:
    """The robust term reduces the summed error by more than 60 %."""
    return _judge_reduction(run, "sum")


@verdict("4.4.max", "fig9", choice=_CHOICE)
def largest_error_is_reduced(run: Run) -> Judgement:
    """The robust term reduces the largest error by more than 60 %."""
    return _judge_reduction(run, "max")


def _judge_reduction(run: Run, name: str) -> Judgement:
    reduction = run.number(f"fig9.flex_{name}_reduction_1e-3")
    springs = _reductions_text(f"flex_{name}")
    evidence = (
        f"For ε = 1e-2, 1e-3, 1e-4: {springs} with joint springs, where `composite` replaces the unstable Eq. 22.",
        f"Without springs: {_reductions_text(name)}.",
        "The paper does not print ε, ζ and φ. The reduction depends mainly on ε.",
    )
    return Judgement(reduction, reduction > 0.01 * PUBLISHED, evidence)


def _reductions_text(name: str) -> str:
    """Template of the reductions for three boundary layers."""
    return ", ".join(f"{{fig9.{name}_reduction_{layer}:%}}" for layer in _LAYER_NAMES)


@verdict("6.robust", "fig9", choice=_CHOICE)
def tracking_is_improved(run: Run) -> Judgement:
    """The same as the summed error."""
    evidence = ("See §4.4: reduction of the summed tracking error by the robust term (Fig. 9).",)
    return replace(summed_error_is_reduced(run), evidence=evidence)


@verdict("3.4.stability", "fig9", unit="%", choice="sign corrected")
def robust_term_ensures_stability(run: Run) -> Judgement:
    """The robust term reduces the summed error of the rigid robot for each boundary layer."""
    least = min(run.number(f"fig9.sum_reduction_{layer}") for layer in _LAYER_NAMES)
    evidence = (
        f"Rigid robot with the uncertainty of Table 6 for ε = 1e-2, 1e-3, 1e-4: {_reductions_text('sum')}.",
        "The sign is correct for e = z_d − z; the printed minus is correct for e = z − z_d. "
        "With joint springs no Δv stabilises Eq. 22 (§3.3).",
    )
    return Judgement(least, least > 0, evidence, "error reduction ≥ {ours}")
