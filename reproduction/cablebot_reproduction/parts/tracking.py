"""Figs. 5 to 7: closed loops of §4 and effect of joint springs on the motor torques."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines.classical import FeedbackLinearization, PaperFlexible
from cablebot_gym.benchmark.engine import Job
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import add_legend, new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, VERMILLION
from cablebot_reproduction.exact import (
    Profile,
    eq24_divisor,
    exact_profile,
    reserve,
    state_space_profile,
)
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.part import Jobs, Number, Outcome, Results, job
from cablebot_reproduction.parts import plotting
from cablebot_reproduction.published import ABOUT
from cablebot_reproduction.runs import FLEX, PLANAR, SPATIAL, closed_loop

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.gridspec import GridSpec

JUMP = 0.5
"""Time of the jump in the acceleration of Tables 1 and 3 [s]."""

WINDOW = 0.2
"""Duration of the windows before the jump, after it and at the end for the ripple of the torques
[s]."""

_SMOOTH, _RINGING = 0.01, 0.004
"""Time steps of the drawn torque limits, large enough to keep the figure files small [s]."""


# --- Figs. 5 and 6 ----------------------------------------------------------------------------------------------------


def planar_jobs(interpretation: Interpretation) -> Jobs:
    """Episode of Fig. 5."""
    law = partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)
    robot = interpretation.closed_loop_robot(interpretation.planar)
    return {"loop": job(closed_loop, env_id=PLANAR, law=law, robot=robot)}


def spatial_jobs(interpretation: Interpretation) -> Jobs:
    """Episode of Fig. 6."""
    return {"loop": _rigid_loop(interpretation)}


def _rigid_loop(interpretation: Interpretation) -> Job:
    """The spatial robot of Table 4 with feedback linearization."""
    nominal = interpretation.spatial("control")
    robot = interpretation.closed_loop_robot(nominal)
    return job(closed_loop, env_id=SPATIAL, law=FeedbackLinearization, robot=robot)


def loop_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Figs. 5 and 6."""
    loop: Rollout = results["loop"]
    arrays = loop.arrays
    peak_error = float(arrays["tracking_error_peak"].max())
    mean_error = float(arrays["tracking_error"].mean())
    peak_torques = np.abs(arrays["torques"]).max(axis=0)
    numbers: dict[str, Number] = {}
    numbers["peak_error_mm"] = 1e3 * peak_error
    numbers["mean_error_mm"] = 1e3 * mean_error
    if arrays["pose"].shape[1] > 2:
        peak_rotation = float(arrays["rotation_error_peak"].max())
        numbers["peak_rotation_mrad"] = 1e3 * peak_rotation
    numbers["least_tension_N"] = float(arrays["tensions"].min())
    numbers["slack"] = bool(arrays["slack"].any())
    numbers["carried"] = loop.verdict.carried
    for motor, peak in enumerate(peak_torques, 1):
        numbers[f"peak_torque_{motor}_Nm"] = float(peak)
    return Outcome(numbers=numbers)


def draw_planar(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 5."""
    title = "Planar robot (Tables 1 and 2): feedback linearization, no payload"
    return _draw_loop(interpretation, interpretation.planar, results["loop"], title)


def draw_spatial(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 6."""
    robot = interpretation.spatial("control")
    title = f"Spatial robot (Tables 3 and 4): feedback linearization, total mass {robot.mass:g} kg"
    return _draw_loop(interpretation, robot, results["loop"], title)


def _draw_loop(interpretation: Interpretation, robot: Robot, loop: Rollout, title: str) -> Figure:
    """Draws torques, tensions and errors, each with its limits."""
    rows = robot.cables // 3
    heights = [2.1 * rows + 0.7, 4.6]
    figure = new_figure(sum(heights) + 0.4)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    panels = motor_panels(above, robot)
    times = loop.arrays["action_time"]
    torques = loop.arrays["torques"]
    speeds = interpretation.line_speed(robot) * loop.arrays["motor_speeds"]
    lower, upper = textbook.torque_limits(robot, speeds)
    limit_panels(panels, times, lower, upper)
    for motor, axes in enumerate(panels):
        axes.plot(times, torques[:, motor], color=plotting.MOTORS[motor], linewidth=1.8)
    panel = panels[0]
    panel.plot([], [], color=BLUE, linewidth=1.8, label="torque, in the colour of the motor")
    panel.set_ylim(float(lower.min()), float(upper.max()))
    plotting.add_headroom(panel, above=0.05, below=0.05)
    add_legend(above, panel)
    titles = [title]
    if loop.reason:
        end = loop.arrays["time"][-1]
        titles.append(f"the episode ends at {end:.3f} s: {loop.reason}")
    columns = 3
    minimum_tension = 0.0
    if robot.planar:
        columns = 2
        minimum_tension = interpretation.minimum_tension
    grid = below.add_gridspec(2, columns)
    tensions = below.add_subplot(grid[:, 0])
    _draw_tensions(tensions, loop, minimum_tension)
    _draw_position_error(below, grid, loop, slice(0, robot.dimensions))
    if not robot.planar:
        _draw_rotation_error(below, grid, loop)
    plotting.add_loop_title(figure, interpretation, *titles)
    return figure


def motor_panels(figure: Figure | SubFigure, robot: Robot) -> list[Axes]:
    """One panel for each motor, three per row, with shared axes."""
    grid = figure.subplots(robot.cables // 3, 3, sharex=True, sharey=True, squeeze=False)
    for motor, axes in enumerate(grid.flat):
        colour = plotting.MOTORS[motor]
        axes.set_title(f"motor {motor + 1}", fontsize=11, color=colour, weight="bold")
        # Otherwise the last label touches the next panel.
        axes.locator_params(axis="x", nbins=5, prune="upper")
        axes.label_outer()
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    for axes in grid[:, 0]:
        axes.set_ylabel("torque [N·m]")
    grid[0, 0].set_xlim(0, 1)
    return list(grid.flat)


def limit_panels(
    panels: list[Axes],
    times: Array,
    lower: Array,
    upper: Array,
    *,
    step: float = _SMOOTH,
    colour: str = "black",
    label: str = "limits U±",
) -> None:
    """Draws U± and shades the torques beyond the limits."""
    far = 3 * float(np.abs([lower, upper]).max())
    drawn = _thinned(times, step)
    times = times[drawn]
    lower = lower[drawn]
    upper = upper[drawn]
    shade: dict[str, Any] = {"color": SHADE, "linewidth": 0}
    line: dict[str, Any] = {"color": colour, "linewidth": 1.0}
    for axes, least, most in zip(panels, lower.T, upper.T, strict=True):
        axes.fill_between(times, most, far, **shade, label="beyond the torque limits")
        axes.fill_between(times, -far, least, **shade)
        axes.plot(times, most, **line, label=label)
        axes.plot(times, least, **line)


def _thinned(times: Array, step: float) -> Array:
    """Indices of instants about ``step`` [s] apart, including the first and the last."""
    period = float(np.median(np.diff(times)))
    stride = max(1, round(step / period))
    indices = np.arange(0, len(times), stride)
    return np.union1d(indices, len(times) - 1)


def _draw_tensions(axes: Axes, loop: Rollout, minimum: float) -> None:
    tensions = loop.arrays["tensions"]
    labels = [f"cable {cable + 1}" for cable in range(tensions.shape[1])]
    plotting.curves(axes, loop.arrays["action_time"], tensions, labels)
    name = "slack at 0 N"
    if minimum > 0:
        name = f"T_min = {minimum:g} N"
    axes.axhline(minimum, color="black", linewidth=1.0, linestyle="--", label=name)
    end = loop.arrays["time"][-1]
    largest = float(tensions.max())
    axes.set_xlim(0, end)
    axes.set_ylim(-0.04 * largest, 1.38 * largest)
    axes.set(xlabel="time [s]", ylabel="tension [N]")
    axes.set_title("tensions", fontsize=10)
    axes.legend(**plotting.LEGEND, ncols=2, loc="upper left")


def _draw_position_error(
    figure: SubFigure, grid: GridSpec, loop: Rollout, coordinates: slice
) -> None:
    bound = 1e3 * ErrorBounds().position
    above, below = _error_panels(figure, grid[0, 1], grid[1, 1], loop, coordinates)
    above.set_title("position errors X_d − X", fontsize=10)
    above.set_ylabel("error [mm]")
    _draw_norm(below, loop, "tracking_error", bound, f"R = {bound:g} mm")
    below.set_ylabel("‖e‖ [mm]")


def _draw_rotation_error(figure: SubFigure, grid: GridSpec, loop: Rollout) -> None:
    bound = 1e3 * ErrorBounds().rotation
    above, below = _error_panels(figure, grid[0, 2], grid[1, 2], loop, slice(3, 6))
    above.set_title("rotation errors X_d − X", fontsize=10)
    above.set_ylabel("error [mrad]")
    _draw_norm(below, loop, "rotation_error", bound, f"bound = {bound:g} mrad")
    below.set_ylabel("max |e| [mrad]")


def _error_panels(
    figure: SubFigure, upper: Any, lower: Any, loop: Rollout, coordinates: slice
) -> tuple[Axes, Axes]:
    """Panel of the errors of some coordinates, and an empty panel of their norm."""
    arrays = loop.arrays
    times = arrays["time"]
    errors = -1e3 * (arrays["pose"] - arrays["reference_pose"])
    above = figure.add_subplot(upper)
    plotting.coordinate_curves(above, times, errors[:, coordinates], coordinates.start)
    above.tick_params(labelbottom=False)
    above.set_xlim(0, times[-1])
    above.legend(**plotting.LEGEND, ncols=3, loc="lower left")
    plotting.add_headroom(above, below=0.25)
    return above, figure.add_subplot(lower, sharex=above)


def _draw_norm(axes: Axes, loop: Rollout, name: str, bound: float, label: str) -> None:
    norm = 1e3 * loop.arrays[name]
    norm = np.maximum(norm, 1e-4 * bound)  # the errors start at zero
    axes.semilogy(loop.arrays["time"], norm, color=BLUE, linewidth=1.5)
    axes.axhline(bound, color="black", linewidth=1.0, label=label)
    axes.set_xlabel("time [s]")
    axes.legend(**plotting.LEGEND)


# --- Fig. 7 -----------------------------------------------------------------------------------------------------------


def flexible_jobs(interpretation: Interpretation) -> Jobs:
    """Episodes and torque profiles of Fig. 7."""
    robot = interpretation.flexible("control")
    rigid = interpretation.spatial("control")
    unloaded = partial(job, interpretation=interpretation, payload=0.0)
    law = partial(PaperFlexible, as_printed=True)
    loop_robot = interpretation.closed_loop_robot(robot)
    return {
        "rigid": _rigid_loop(interpretation),
        "rigid_exact": unloaded(exact_profile, robot=rigid),
        "state_space": unloaded(state_space_profile, robot=robot),
        "loop": job(closed_loop, env_id=FLEX, law=law, robot=loop_robot),
    }


def ripple(flexible: Profile, rigid: Profile, start: float) -> float:
    """RMS difference of the torques over all motors in the window that begins at ``start`` [s], in
    N·m."""
    times = flexible.times
    inside = (times > start) & (times <= start + WINDOW)
    difference = flexible.torques[inside] - rigid.torques[inside]
    return float(np.sqrt(np.mean(difference**2)))


def flexible_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 7."""
    state_space = results["state_space"]
    rigid = results["rigid_exact"]
    loop = results["loop"]
    robot = interpretation.flexible("control")
    divisor = eq24_divisor(interpretation, robot)
    error = loop.arrays["tracking_error_peak"]
    times = loop.arrays["time"]
    margin = reserve(state_space)
    rigid_torques = results["rigid"].arrays["torques"]
    frequencies = np.sqrt(robot.stiffness / divisor)
    lost = times[error > ErrorBounds().position].tolist()
    return Outcome(
        numbers={
            "stiffness_Nm_per_rad": float(robot.stiffness[0]),
            "rigid_peak_Nm": float(np.abs(rigid_torques).max()),
            "flexible_peak_Nm": float(np.abs(state_space.torques).max()),
            "ripple_before_Nm": ripple(state_space, rigid, JUMP - WINDOW),
            "ripple_after_Nm": ripple(state_space, rigid, JUMP),
            "ripple_late_Nm": ripple(state_space, rigid, 1 - WINDOW),
            "flexible_margin_Nm": float(margin.min()),
            "ripple_Hz": float(frequencies.max() / (2 * np.pi)),
            "closed_loop_peak_error_mm": 1e3 * float(error.max()),
            "closed_loop_carried": loop.verdict.carried,
            "closed_loop_lost_s": next(iter(lost), None),
            "closed_loop_slack": bool(loop.arrays["slack"].any()),
        }
    )


def draw_flexible(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 7."""
    robot = interpretation.flexible("control")
    space = results["state_space"]
    rigid = results["rigid"].arrays
    loop = results["loop"].arrays
    figure = new_figure(5.9)
    panels = motor_panels(figure, robot)
    jump = int(np.searchsorted(space.times, JUMP))
    drawn = np.union1d(_thinned(space.times, 1e-3), [jump, jump + 1])
    times = space.times[drawn]
    lower = space.lower[drawn]
    upper = space.upper[drawn]
    label = "limits U± of the blue curve"
    limit_panels(panels, times, lower, upper, step=_RINGING, colour=GREY, label=label)
    for motor, axes in enumerate(panels):
        axes.plot(
            times,
            space.torques[drawn, motor],
            color=BLUE,
            linewidth=1.2,
            label="with springs, Eqs. 22–25",
        )
        axes.plot(
            loop["action_time"],
            loop["torques"][:, motor],
            color=VERMILLION,
            linewidth=0.6,
            label="Eq. 22 as printed, closed loop",
        )
        axes.plot(
            rigid["action_time"],
            rigid["torques"][:, motor],
            color="black",
            linewidth=1.4,
            label="rigid (Table 4)",
        )
        axes.axvline(JUMP, color=GREY, linestyle=":", linewidth=1.2, label="jump of the reference")
    visible = np.concatenate([space.torques, rigid["torques"]])
    lowest = min(0.0, float(visible.min()))
    panels[0].set_ylim(lowest, float(visible.max()))
    plotting.add_headroom(panels[0], above=0.15, below=0.1)
    add_legend(figure, panels[0])
    springs = f"joint springs K = {robot.stiffness[0]:g} N·m/rad (Table 5)"
    title = f"Spatial robot with {springs}, total mass {robot.mass:g} kg"
    plotting.add_loop_title(figure, interpretation, title)
    return figure


# --- verdicts ---------------------------------------------------------------------------------------------------------


@verdict("abstract.accuracy", "fig5", "fig6", "claims", unit="mm")
def accuracy_is_perfect(run: Run) -> Judgement:
    """No error is larger than 5 % of R."""
    planar = run.number("fig5.peak_error_mm")
    spatial = run.number("fig6.peak_error_mm")
    largest = max(planar, spatial, run.number("claims.closed_loop_spatial_error_mm"))
    evidence = (
        "Largest error without uncertainty: planar {fig5.peak_error_mm}, spatial {fig6.peak_error_mm}.",
        "Mean error of the spatial robot with the uncertainty of Table 6: {claims.closed_loop_spatial_error_mm}.",
        "The threshold is 0.5 mm, 5 % of R. The causes are sampling and the jump at half time.",
    )
    return Judgement(largest, largest <= 0.5, evidence)


@verdict("1.tension", "fig5", "fig6", unit="N", options=("minimum_tension",))
def no_tension_is_negative(run: Run) -> Judgement:
    """The cables of both robots remain taut on the paths of the paper."""
    least = min(run.number("fig5.least_tension_N"), run.number("fig6.least_tension_N"))
    is_slack = max(run.number("fig5.slack"), run.number("fig6.slack"))
    evidence = (
        "Smallest tension: planar {fig5.least_tension_N}, spatial {fig6.least_tension_N}.",
        "For the planar robot this is T_min, because α keeps the tensions above it.",
    )
    return Judgement(least, least > 0 and not is_slack, evidence, "≥ {ours}")


@verdict("4.1.tension", "fig5", unit="N", options=("minimum_tension",))
def planar_tensions_are_positive(run: Run) -> Judgement:
    """The cables of the planar robot remain taut."""
    least = run.number("fig5.least_tension_N")
    is_slack = run.number("fig5.slack")
    evidence = ("The smallest tension is T_min, because α keeps the tensions above it.",)
    return Judgement(least, least > 0 and not is_slack, evidence, "≥ {ours}")


@verdict("1.elasticity", "fig7")
def elasticity_matters_in_joints_and_cables(run: Run) -> Judgement:
    """This project has no model of elastic cables."""
    evidence = ("The paper has no model of elastic cables. §4.3 and §5.2.3 treat the joints.",)
    return Judgement(None, None, evidence, "joints only")


@verdict("4.3.vibration", "fig7", unit="N·m", options=("stiffness", "eq24"))
def torques_vibrate_only_when_the_input_changes(run: Run) -> Judgement:
    """The torques of both robots differ by more than 5 % of the largest rigid torque after the jump
    only."""
    late = run.number("fig7.ripple_late_Nm")
    before = run.number("fig7.ripple_before_Nm")
    after = run.number("fig7.ripple_after_Nm")
    threshold = ABOUT * run.number("fig7.rigid_peak_Nm")
    evidence = (
        "RMS difference between the torques of Eqs. 23–25 and the rigid torques: {fig7.ripple_before_Nm} in the 0.2 s "
        "before the jump, {fig7.ripple_after_Nm} in the 0.2 s after it, {fig7.ripple_late_Nm} in the last 0.2 s.",
        "The threshold is 5 % of the largest rigid torque of {fig7.rigid_peak_Nm}.",
        "The jump excites the vibration, and these equations have no damping.",
    )
    text = "{fig7.ripple_after_Nm} after the change, {fig7.ripple_late_Nm} at the end"
    return Judgement(late, max(before, late) <= threshold < after, evidence, text)


@verdict("6.torque", "fig7", unit="N·m", options=("stiffness", "eq24"))
def elasticity_changes_the_torques(run: Run) -> Judgement:
    """After the jump the torques of both robots differ by more than 5 % of the largest rigid
    torque."""
    after = run.number("fig7.ripple_after_Nm")
    threshold = ABOUT * run.number("fig7.rigid_peak_Nm")
    evidence = (
        "RMS difference in the 0.2 s after the jump.",
        "Largest torque: {fig7.flexible_peak_Nm} with springs, {fig7.rigid_peak_Nm} without springs.",
    )
    return Judgement(after, after > threshold, evidence)
