"""Figs. 8 and 9: robust control of the paper under its uncertainty (Table 6), and effect of the boundary layer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines.classical import (
    PD,
    Composite,
    FeedbackLinearization,
    PaperFlexible,
    Robust,
    RobustComposite,
    RobustPD,
)
from cablebot_baselines.classical.outer_loop import PAPER_GAINS
from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Cell, CellResults, Number, Outcome, Part, Table
from cablebot_baselines.paper.parts.drawings import MOTORS
from cablebot_baselines.paper.parts.tracking import COORDINATES, notes
from cablebot_baselines.paper.published import published_value
from cablebot_baselines.paper.runs import Law, closed_loop
from cablebot_gym.evaluation import compare_policies
from cablebot_gym.evaluation.comparison import CONFIDENCE, Estimate
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import new_figure, set_title
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

RIGID, FLEXIBLE = "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"

_PREFIX = {RIGID: "", FLEXIBLE: "flex_"}
"""Prefix of the names of the numbers."""

_HEAD = {RIGID: "rigid joints", FLEXIBLE: "joint springs K = {:g} N·m/rad"}

_STYLES = ("-", "--", "-.")

_GREEN = MOTORS[2]


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
    laws = [plain(robot), *(robust(robot, boundary_layer=layer) for layer in layers)]
    names = ["plain", *(f"robust {layer:g}" for layer in layers)]
    comparison = compare_policies(laws, env_id, uncertainty="table6", draws=draws, names=names, robot=robot)
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


def added_input(outer: RobustPD, loop: Rollout, robot: Robot) -> Added:
    """Robust term of an outer loop in its own episode, computed from the recorded motion.

    The last recorded instant is the end of the motion and has no action, so it is omitted.
    """
    arrays = {name: loop.arrays[name][:-1] for name in ("time", "pose", "velocity")}
    reference = paper_circle(robot)(arrays["time"])
    blocks = {
        "pose": arrays["pose"],
        "velocity": arrays["velocity"],
        "reference_pose": reference.position,
        "reference_velocity": reference.velocity,
        "reference_acceleration": reference.acceleration,
    }
    size = np.linalg.norm(outer.switching(blocks), axis=-1)
    return Added(
        times=arrays["time"],
        term=outer(blocks) - PD(gains=outer.gains)(blocks),
        outside=size >= outer.boundary_layer,
    )


def _robots(interpretation: Interpretation) -> dict[str, Robot]:
    return {
        RIGID: interpretation.closed_loop_robot(interpretation.spatial("control")),
        FLEXIBLE: interpretation.closed_loop_robot(interpretation.flexible("control")),
    }


_LAWS: dict[str, tuple[Law, Law]] = {
    RIGID: (FeedbackLinearization, Robust),
    FLEXIBLE: (Composite, RobustComposite),
}
"""Ordinary and robust law."""


_EQ22 = "eq22"
"""Prefix of the cells of the law of the paper with joint springs."""


def robust_eq22(robot: Robot) -> PaperFlexible:
    """Eq. 22 as printed with Δv added to v, the law of §4.4."""
    law = PaperFlexible(robot, as_printed=True)
    law.outer = RobustPD(gains=PAPER_GAINS["spatial"])
    return law


def _one_draw(env_id: str, law: Law, robot: Robot) -> Cell:
    return partial(closed_loop, env_id=env_id, law=law, robot=robot, payload=0.0, uncertainty="table6", seed=SEED)


# Fig. 8


def _term_cells(interpretation: Interpretation) -> dict[str, Cell]:
    robots = _robots(interpretation)
    return {env_id: _one_draw(env_id, _LAWS[env_id][1], robot) for env_id, robot in robots.items()}


def _terms(interpretation: Interpretation, results: CellResults) -> dict[str, Added]:
    robots = _robots(interpretation)
    return {
        env_id: added_input(_LAWS[env_id][1](robot).outer, results[env_id], robot) for env_id, robot in robots.items()
    }


def _term_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    numbers: dict[str, Number] = {
        "boundary_layer": RobustPD.boundary_layer,
        "plant": "rigid; flex_: with joint springs",
    }
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


def _draw_term(interpretation: Interpretation, results: CellResults) -> Figure:
    figure = new_figure(5.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    groups = ((slice(0, 3), "Δv [m/s²]"), (slice(3, 6), "Δv [rad/s²]"))
    for column, (env_id, added) in enumerate(_terms(interpretation, results).items()):
        grid[0, column].set_title(_robot_title(interpretation, env_id), fontsize=11)
        for axes, (columns, label) in zip(grid[:, column], groups, strict=True):
            for index, coordinate in enumerate(COORDINATES[columns]):
                style = _STYLES[index]
                line = {"color": MOTORS[index], "linewidth": 1.3, "label": coordinate}
                axes.plot(added.times, added.term[:, columns][:, index], style, **line)
            axes.axhline(0, color=GREY, linewidth=0.6)
            axes.set_xlim(0, 1)
            if column == 0:
                axes.set_ylabel(label)
                axes.legend(frameon=False, fontsize=10, ncols=3, loc="upper left", handlelength=1.8)
        grid[1, column].set_xlabel("time [s]")
    for axes in grid[:, 0]:
        low, high = axes.get_ylim()
        axes.set_ylim(top=high + 0.2 * (high - low))
    layer = f"boundary layer ε = {RobustPD.boundary_layer:g}, ζ = {RobustPD.zeta:g}, φ = {RobustPD.phi:g}"
    title = f"Robust term Δv (Eq. 34), one draw of Table 6; {layer}"
    set_title(figure, title, *notes(interpretation))
    return figure


def _robot_title(interpretation: Interpretation, env_id: str) -> str:
    return _HEAD[env_id].format(interpretation.flexible("control").stiffness[0])


# Fig. 9


def _tracking_cells(interpretation: Interpretation) -> dict[str, Cell]:
    cells: dict[str, Cell] = {}
    for env_id, robot in _robots(interpretation).items():
        plain, robust = _LAWS[env_id]
        cells[f"{env_id} plain"] = _one_draw(env_id, plain, robot)
        cells[f"{env_id} robust"] = _one_draw(env_id, robust, robot)
        cells[f"{env_id} layers"] = partial(
            reductions, env_id=env_id, plain=plain, robust=robust, robot=robot, layers=LAYERS, draws=DRAWS
        )
    robot = interpretation.closed_loop_robot(interpretation.flexible("control"))
    cells[f"{_EQ22} plain"] = _one_draw(FLEXIBLE, partial(PaperFlexible, as_printed=True), robot)
    cells[f"{_EQ22} robust"] = _one_draw(FLEXIBLE, robust_eq22, robot)
    return cells


def _reduced(plain: Rollout, robust: Rollout, name: str) -> float | None:
    """Reduction of the sum or maximum of the error in one draw; None if an episode ended early."""
    if plain.reason or robust.reason:
        return None
    reduce = np.sum if name == "tracking_error" else np.max
    return 1 - float(reduce(robust.arrays[name])) / float(reduce(plain.arrays[name]))


def _named(layer: float) -> str:
    """ε as in the names of the numbers, for example 1e-3."""
    return f"{layer:.0e}".replace("e-0", "e-")


def _tracking_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    numbers: dict[str, Number] = {"draws": DRAWS}
    rows: list[tuple[Number, ...]] = []
    for env_id, prefix in _PREFIX.items():
        plain, robust = (results[f"{env_id} {law}"] for law in ("plain", "robust"))
        for name, quantity in (("draw_sum_reduction", "tracking_error"), ("draw_max_reduction", "tracking_error_peak")):
            numbers[prefix + name] = _reduced(plain, robust, quantity)
        for law, loop in (("plain", plain), ("robust", robust)):
            numbers[f"{prefix}draw_{law}_peak_mm"] = 1e3 * float(loop.arrays["tracking_error_peak"].max())
        difference = plain.arrays["pose"] - plain.arrays["reference_pose"]
        numbers[f"{prefix}draw_plain_peak_xy_mm"] = 1e3 * float(np.linalg.norm(difference[:, :2], axis=1).max())
        for point in results[f"{env_id} layers"]:
            fractions: list[Number] = []
            for name, fraction in (("sum", point.total), ("max", point.largest)):
                key = f"{prefix}{name}_reduction_{_named(point.layer)}"
                numbers |= {key: fraction.mean, f"{key}_low": fraction.low, f"{key}_high": fraction.high}
                fractions += (100 * fraction.mean, f"{100 * fraction.low:.1f} to {100 * fraction.high:.1f}")
            rows.append((_robot_title(interpretation, env_id), point.layer, *fractions, *point.lost))
    for law in ("plain", "robust"):
        error = results[f"{_EQ22} {law}"].arrays["tracking_error_peak"]
        numbers[f"{_EQ22}_draw_{law}_peak_mm"] = 1e3 * float(error.max())
    each = (" [%]", f", {CONFIDENCE:.0%} interval")
    fractions_of = (f"reduction of {name}{end}" for name in ("the summed error", "the largest error") for end in each)
    header = (
        "robot",
        "ε",
        *fractions_of,
        "fraction of episodes ended early, ordinary law",
        "fraction of episodes ended early, robust law",
    )
    title = f"Error reduction of the robust law relative to the ordinary law over {DRAWS} draws of Table 6"
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=tuple(rows)),))


def _draw_tracking(interpretation: Interpretation, results: CellResults) -> Figure:
    figure = new_figure(11.4)
    grid = figure.add_gridspec(3, 2, height_ratios=[1.15, 1.15, 1])
    last: Axes | None = None
    for row, env_id in enumerate(_PREFIX):
        loops = {law: results[f"{env_id} {law}"] for law in ("plain", "robust")}
        plane, over_time = figure.add_subplot(grid[row, 0]), figure.add_subplot(grid[row, 1])
        _draw_plane(plane, loops)
        _draw_errors(over_time, loops)
        for axes in (plane, over_time):
            axes.set_title(f"{_robot_title(interpretation, env_id)}, {axes.get_title()}", fontsize=10)
        last = figure.add_subplot(grid[2, row], sharey=last)
        _draw_layers(last, results[f"{env_id} layers"])
        last.set_title(f"{_robot_title(interpretation, env_id)}, {DRAWS} draws", fontsize=10)
    mass = interpretation.spatial("control").mass
    title = f"Tracking with the uncertainty of Table 6, nominal mass {mass:g} kg known: ordinary and robust law"
    legend = f"top and middle: one draw, ε = {RobustPD.boundary_layer:g}; bottom: all draws versus boundary layer"
    set_title(figure, title, legend, *notes(interpretation))
    return figure


_NAMES = {"plain": "ordinary", "robust": "robust"}
_COLOURS = {"plain": VERMILLION, "robust": _GREEN}
_DASHES = {"plain": "-", "robust": ":"}


def _draw_plane(axes: Axes, loops: dict[str, Rollout]) -> None:
    """Path seen along z with magnified deviations."""
    poses = {law: (loop.arrays["pose"][:, :2], loop.arrays["reference_pose"][:, :2]) for law, loop in loops.items()}
    reference = max((pair[1] for pair in poses.values()), key=len)
    size = float(np.ptp(reference, axis=0).max())
    most = max(float(np.abs(pose - reference_pose).max()) for pose, reference_pose in poses.values())
    steps = [1, 2, 5, 10, 20, 50, 100, 200, 500]
    magnified = max([step for step in steps if step * most <= 0.22 * size], default=1)
    axes.plot(*reference.T, color="black", linewidth=0.8, label="reference")
    for law, (pose, reference_pose) in poses.items():
        drawn = reference_pose + magnified * (pose - reference_pose)
        axes.plot(*drawn.T, _DASHES[law], color=_COLOURS[law], linewidth=2.0, label=_NAMES[law])
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.locator_params(nbins=5)
    axes.set_title(f"deviations × {magnified}" if magnified > 1 else "path")
    axes.legend(frameon=False, fontsize=9, loc="center")


def _draw_errors(axes: Axes, loops: dict[str, Rollout]) -> None:
    for law, loop in loops.items():
        time, error = loop.arrays["time"], 1e3 * loop.arrays["tracking_error"]
        axes.plot(time, error, _DASHES[law], color=_COLOURS[law], linewidth=2.0, label=_NAMES[law])
    radius = 1e3 * ErrorBounds().position
    axes.axhline(radius, color="black", linewidth=1.0, label=f"R = {radius:g} mm")
    top = max(radius, *(1e3 * float(loop.arrays["tracking_error"].max()) for loop in loops.values()))
    axes.set(xlim=(0, 1), ylim=(0, 1.1 * top), xlabel="time [s]", ylabel="position error ‖e‖ [mm]")
    axes.set_title("error")
    axes.legend(frameon=False, fontsize=9, loc="upper left")


def _draw_layers(axes: Axes, points: tuple[Reduction, ...]) -> None:
    layers = [point.layer for point in points]
    kinds = (("total", "sum of the error", BLUE, "-"), ("largest", "largest error", GREY, "--"))
    for name, label, colour, style in kinds:
        fractions: list[Estimate] = [getattr(point, name) for point in points]
        low, mean, high = ([100 * getattr(fraction, end) for fraction in fractions] for end in ("low", "mean", "high"))
        axes.fill_between(layers, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(layers, mean, style, marker="o", markersize=4, color=colour, linewidth=1.6, label=label)
    axes.axhline(PUBLISHED, color="black", linewidth=1.0, label="paper: more than 60 %")
    axes.set(xscale="log", xlabel="boundary layer ε", ylabel="error reduction [%]", ylim=(0, 100))
    axes.invert_xaxis()
    axes.legend(frameon=False, fontsize=9, loc="lower right")


PARTS: tuple[Part, ...] = (
    Part(
        name="fig8",
        title="Fig. 8: robust term in the input",
        text="Δv of the robust law in one draw of Table 6 (seed 0: mass, K and disturbing forces). It is computed from "
        "the recorded motion as the difference between the robust and the ordinary outer loop, with Eqs. 34–36 as "
        "corrected in the errata (sign of Eq. 34, −k_p and −k_d in A). Left: rigid robot. Right: robot with joint "
        "springs, where the composite law replaces the ordinary law of the paper, because Eq. 22 does not stabilise "
        "the springs. The norm of Δv is ρ if ‖BᵀPe‖ exceeds the boundary layer ε, and decreases with ‖BᵀPe‖ inside the "
        "layer. The paper prints no values of ε, ζ and φ. This project uses ζ = 0.12 and φ = 1.2 for Table 6. Without "
        "springs the motion stays inside the layer (`outside_layer`), and the term is a stiffer PD controller. With "
        "springs the term excites their oscillation. `chatter` is the RMS change of Δv between control instants "
        "divided by the RMS of Δv.",
        cells=_term_cells,
        outcome=_term_outcome,
        draw=_draw_term,
    ),
    Part(
        name="fig9",
        title="Fig. 9: tracking under uncertainty, ordinary and robust law",
        text="The draw of Fig. 8 with the ordinary law (solid, as in the paper) and the robust law (dotted), with "
        "magnified deviations in the x–y plane. Most of the error is along z, because the mass is uncertain. The path "
        "in the plane therefore shows little of it (compare `draw_plain_peak_xy_mm` and `draw_plain_peak_mm`). Bottom: "
        "reduction of the sum and of the maximum of the error by the robust law over 200 draws versus the boundary "
        "layer ε, which the paper does not print. The bands are confidence intervals. For the rigid robot they are "
        "narrower than the lines, because the reduction hardly depends on the draw. The reduction depends mainly on ε, "
        'so the choice of ε determines whether "more than 60 %" (§4.4) holds. For the robot with springs, the subject '
        "of §4.4, the composite law again replaces the ordinary law. Eq. 22 is unstable, and Δv makes the instability "
        "worse (`eq22_draw_plain_peak_mm`, `eq22_draw_robust_peak_mm`). With springs a thinner layer has no further "
        "benefit once the term excites the springs. These values hold for the ζ and φ of this project; the paper "
        "prints none.",
        cells=_tracking_cells,
        outcome=_tracking_outcome,
        draw=_draw_tracking,
    ),
)
