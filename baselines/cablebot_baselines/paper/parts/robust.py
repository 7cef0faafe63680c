"""Figs. 8 and 9: robust control of the paper under its uncertainty (Table 6), and effect of the boundary layer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines import classical
from cablebot_baselines.classical.outer_loop import PAPER_GAINS
from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Jobs, Number, Outcome, Results, Table, job
from cablebot_baselines.paper.parts.plotting import LEGEND, MOTORS, add_headroom, add_loop_title, coordinate_curves
from cablebot_baselines.paper.published import published_value
from cablebot_baselines.paper.runs import FLEX, SPATIAL, Law, closed_loop, compared
from cablebot_gym.benchmark.engine import Job
from cablebot_gym.evaluation.comparison import CONFIDENCE, Estimate
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION

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
    """Error reduction of a robust law relative to the ordinary law over the same draws of Table 6."""

    layer: float
    """Boundary layer ε."""
    total: Estimate
    """Reduction of the sum of the error over time."""
    largest: Estimate
    """Reduction of the largest error."""
    lost: tuple[float, float]
    """Fractions of the draws that ended early with the ordinary and with the robust law."""


def reductions(
    *, env_id: str, plain: Law, robust: Callable[..., Any], robot: Robot, layers: tuple[float, ...], draws: int
) -> tuple[Reduction, ...]:
    """Reductions for each ε at zero payload. The laws know the nominal platform mass."""
    laws: list[tuple[str, Law]] = [("plain", plain)]
    laws += [(f"robust {layer:g}", partial(robust, boundary_layer=layer)) for layer in layers]
    comparison = compared(env_id=env_id, laws=tuple(laws), robot=robot, uncertainty="table6", draws=draws)
    return tuple(
        Reduction(
            layer=layer,
            total=comparison.reduction(index, "mean_error"),
            largest=comparison.reduction(index, "max_error"),
            lost=(float(comparison.metrics[0].ended.mean()), float(comparison.metrics[index].ended.mean())),
        )
        for index, layer in enumerate(layers, 1)
    )


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
    times, pose, velocity = (loop.arrays[name][:-1] for name in ("time", "pose", "velocity"))
    reference = paper_circle(robot)(times)
    blocks = {
        "pose": pose,
        "velocity": velocity,
        "reference_pose": reference.position,
        "reference_velocity": reference.velocity,
        "reference_acceleration": reference.acceleration,
    }
    size = np.linalg.norm(outer.switching(blocks), axis=-1)
    term = outer(blocks) - classical.PD(gains=outer.gains)(blocks)
    return Added(times=times, term=term, outside=size >= outer.boundary_layer)


def _robots(interpretation: Interpretation) -> dict[str, Robot]:
    robots = {SPATIAL: interpretation.spatial("control"), FLEX: interpretation.flexible("control")}
    return {env_id: interpretation.closed_loop_robot(robot) for env_id, robot in robots.items()}


def robust_eq22(robot: Robot) -> classical.PaperFlexible:
    """Eq. 22 as printed with Δv added to v, the law of §4.4."""
    law = classical.PaperFlexible(robot, as_printed=True)
    law.outer = classical.RobustPD(gains=PAPER_GAINS["spatial"])
    return law


def _one_draw(env_id: str, law: Law, robot: Robot) -> Job:
    return job(closed_loop, env_id=env_id, law=law, robot=robot, uncertainty="table6", seed=SEED)


def _robot_title(interpretation: Interpretation, env_id: str) -> str:
    stiffness = interpretation.flexible("control").stiffness[0]
    return "rigid joints" if env_id == SPATIAL else f"joint springs K = {stiffness:g} N·m/rad"


# Fig. 8


def term_jobs(interpretation: Interpretation) -> Jobs:
    """Episodes of Fig. 8."""
    return {env_id: _one_draw(env_id, _LAWS[env_id][1], robot) for env_id, robot in _robots(interpretation).items()}


def _terms(interpretation: Interpretation, results: Results) -> dict[str, Added]:
    robots = _robots(interpretation).items()
    return {env_id: added_input(_LAWS[env_id][1](robot).outer, results[env_id], robot) for env_id, robot in robots}


def term_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 8."""
    plant = "rigid; flex_: with joint springs"
    numbers: dict[str, Number] = {"boundary_layer": classical.RobustPD.boundary_layer, "plant": plant}
    for env_id, added in _terms(interpretation, results).items():
        size, change = np.linalg.norm(added.term, axis=1), np.linalg.norm(np.diff(added.term, axis=0), axis=1)
        rms = float(np.sqrt(np.mean(size**2)))
        values = {
            "peak_dv": float(size.max()),
            "rms_dv": rms,
            "chatter": float(np.sqrt(np.mean(change**2))) / rms,
            "outside_layer": float(added.outside.mean()),
        }
        numbers |= {_PREFIX[env_id] + name: value for name, value in values.items()}
    return Outcome(numbers=numbers)


def draw_term(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 8."""
    figure = new_figure(5.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (env_id, added) in enumerate(_terms(interpretation, results).items()):
        for row, unit in enumerate(("m/s²", "rad/s²")):
            axes = grid[row, column]
            coordinate_curves(axes, added.times, added.term[:, 3 * row : 3 * row + 3], 3 * row)
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


# Fig. 9


def tracking_jobs(interpretation: Interpretation) -> Jobs:
    """Episodes and reductions of Fig. 9. The prefix ``eq22`` is the law of the paper with joint springs."""
    jobs, robots = {}, _robots(interpretation)
    for env_id, robot in robots.items():
        plain, robust = _LAWS[env_id]
        laws: dict[str, Any] = {"env_id": env_id, "plain": plain, "robust": robust, "robot": robot}
        jobs[f"{env_id} plain"] = _one_draw(env_id, plain, robot)
        jobs[f"{env_id} robust"] = _one_draw(env_id, robust, robot)
        jobs[f"{env_id} layers"] = job(reductions, **laws, layers=LAYERS, draws=DRAWS)
    jobs["eq22 plain"] = _one_draw(FLEX, partial(classical.PaperFlexible, as_printed=True), robots[FLEX])
    jobs["eq22 robust"] = _one_draw(FLEX, robust_eq22, robots[FLEX])
    return jobs


def reduced(plain: Rollout, robust: Rollout, name: str) -> float | None:
    """Reduction of the sum or maximum of the error in one draw; None if an episode ended early."""
    if plain.reason or robust.reason:
        return None
    reduce = np.sum if name == "tracking_error" else np.max
    return 1 - float(reduce(robust.arrays[name])) / float(reduce(plain.arrays[name]))


def layer_name(layer: float) -> str:
    """ε as in the names of the numbers, for example 1e-3."""
    return f"{layer:.0e}".replace("e-0", "e-")


def tracking_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 9."""
    numbers: dict[str, Number] = {"draws": DRAWS}
    rows: list[tuple[Number, ...]] = []
    for env_id, prefix in _PREFIX.items():
        loops = _loops(results, env_id)
        plain, robust = loops.values()
        for name, quantity in (("draw_sum_reduction", "tracking_error"), ("draw_max_reduction", "tracking_error_peak")):
            numbers[prefix + name] = reduced(plain, robust, quantity)
        numbers |= {f"{prefix}draw_{law}_peak_mm": _peak_mm(loop) for law, loop in loops.items()}
        difference = plain.arrays["pose"] - plain.arrays["reference_pose"]
        numbers[f"{prefix}draw_plain_peak_xy_mm"] = 1e3 * float(np.linalg.norm(difference[:, :2], axis=1).max())
        for point in results[f"{env_id} layers"]:
            fractions: list[Number] = []
            for name, fraction in (("sum", point.total), ("max", point.largest)):
                key = f"{prefix}{name}_reduction_{layer_name(point.layer)}"
                numbers |= {key: fraction.mean, f"{key}_low": fraction.low, f"{key}_high": fraction.high}
                fractions += (100 * fraction.mean, f"{100 * fraction.low:.1f} to {100 * fraction.high:.1f}")
            rows.append((_robot_title(interpretation, env_id), point.layer, *fractions, *point.lost))
    numbers |= {f"eq22_draw_{law}_peak_mm": _peak_mm(loop) for law, loop in _loops(results, "eq22").items()}
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
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=tuple(rows)),))


def _loops(results: Results, prefix: str) -> dict[str, Rollout]:
    return {law: results[f"{prefix} {law}"] for law in ("plain", "robust")}


def _peak_mm(loop: Rollout) -> float:
    return 1e3 * float(loop.arrays["tracking_error_peak"].max())


def draw_tracking(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 9."""
    figure = new_figure(11.4)
    grid = figure.subplots(3, 2, height_ratios=[1.15, 1.15, 1])
    for row, env_id in enumerate(_PREFIX):
        loops, robot = _loops(results, env_id), _robot_title(interpretation, env_id)
        magnified = _draw_plane(grid[row, 0], loops)
        _draw_errors(grid[row, 1], loops)
        _draw_layers(grid[2, row], results[f"{env_id} layers"])
        titles = (f"{robot}, deviations × {magnified}", f"{robot}, error", f"{robot}, {DRAWS} draws")
        for axes, title in zip((*grid[row], grid[2, row]), titles, strict=True):
            axes.set_title(title, fontsize=10)
    mass = interpretation.spatial("control").mass
    title = f"Tracking with the uncertainty of Table 6, nominal mass {mass:g} kg known: ordinary and robust law"
    legend = (
        f"top and middle: one draw, ε = {classical.RobustPD.boundary_layer:g}; bottom: all draws versus boundary layer"
    )
    add_loop_title(figure, interpretation, title, legend)
    return figure


def _draw_plane(axes: Axes, loops: Mapping[str, Rollout]) -> int:
    """Draws the path seen along z with magnified deviations, and returns the magnification."""
    poses = {law: (loop.arrays["pose"][:, :2], loop.arrays["reference_pose"][:, :2]) for law, loop in loops.items()}
    reference = max((pair[1] for pair in poses.values()), key=len)
    size = float(np.ptp(reference, axis=0).max())
    most = max(float(np.abs(pose - reference_pose).max()) for pose, reference_pose in poses.values())
    magnified = max([step for step in (1, 2, 5, 10, 20, 50, 100, 200, 500) if step * most <= 0.22 * size], default=1)
    axes.plot(*reference.T, color="black", linewidth=0.8, label="reference")
    for law, (pose, reference_pose) in poses.items():
        name, style, colour = _CURVES[law]
        drawn = reference_pose + magnified * (pose - reference_pose)
        axes.plot(*drawn.T, style, color=colour, linewidth=2.0, label=name)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.legend(**LEGEND, loc="center")
    return magnified


def _draw_errors(axes: Axes, loops: Mapping[str, Rollout]) -> None:
    radius = 1e3 * ErrorBounds().position
    for law, loop in loops.items():
        name, style, colour = _CURVES[law]
        error = 1e3 * loop.arrays["tracking_error"]
        axes.plot(loop.arrays["time"], error, style, color=colour, linewidth=2.0, label=name)
    axes.axhline(radius, color="black", linewidth=1.0, label=f"R = {radius:g} mm")
    axes.set(xlim=(0, 1), ylim=(0, None), xlabel="time [s]", ylabel="position error ‖e‖ [mm]")
    axes.legend(**LEGEND, loc="upper left")


def _draw_layers(axes: Axes, points: tuple[Reduction, ...]) -> None:
    layers = [point.layer for point in points]
    for name, label, colour, style in (
        ("total", "sum of the error", BLUE, "-"),
        ("largest", "largest error", GREY, "--"),
    ):
        fractions: list[Estimate] = [getattr(point, name) for point in points]
        low, mean, high = ([100 * getattr(fraction, end) for fraction in fractions] for end in ("low", "mean", "high"))
        axes.fill_between(layers, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(layers, mean, style, marker="o", markersize=4, color=colour, linewidth=1.6, label=label)
    axes.axhline(PUBLISHED, color="black", linewidth=1.0, label="paper: more than 60 %")
    axes.set(xscale="log", xlabel="boundary layer ε", ylabel="error reduction [%]", ylim=(0, 100))
    axes.invert_xaxis()
    axes.legend(**LEGEND, loc="lower right")
