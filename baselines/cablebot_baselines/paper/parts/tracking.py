"""Figs. 5 to 7: closed loops of §4 and effect of joint springs on the motor torques."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.classical import FeedbackLinearization, PaperFlexible
from cablebot_baselines.paper.exact import Profile, exact_profile, state_space_profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Jobs, Number, Outcome, Results, job
from cablebot_baselines.paper.parts import plotting
from cablebot_baselines.paper.runs import FLEX, PLANAR, SPATIAL, closed_loop
from cablebot_gym.benchmark.engine import Job
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import add_legend, new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

JUMP = 0.5
"""Time of the jump in the acceleration of Tables 1 and 3 [s]."""

WINDOW = 0.2
"""Duration of the windows before the jump, after it and at the end for the ripple of the torques [s]."""

_SMOOTH, _RINGING = 0.01, 0.004
"""Time steps of the drawn torque limits, large enough to keep the figure files small [s]."""


def _rigid_loop(interpretation: Interpretation) -> Job:
    """The spatial robot of Table 4 with feedback linearization."""
    robot = interpretation.closed_loop_robot(interpretation.spatial("control"))
    return job(closed_loop, env_id=SPATIAL, law=FeedbackLinearization, robot=robot)


def loop_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Figs. 5 and 6."""
    loop: Rollout = results["loop"]
    arrays = loop.arrays
    numbers: dict[str, Number] = {
        "peak_error_mm": 1e3 * float(arrays["tracking_error_peak"].max()),
        "mean_error_mm": 1e3 * float(arrays["tracking_error"].mean()),
    }
    if arrays["pose"].shape[1] > 2:
        numbers["peak_rotation_mrad"] = 1e3 * float(arrays["rotation_error_peak"].max())
    numbers |= {
        "least_tension_N": float(arrays["tensions"].min()),
        "slack": bool(arrays["slack"].any()),
        "carried": loop.verdict.carried,
    }
    peaks = np.abs(arrays["torques"]).max(axis=0)
    return Outcome(numbers=numbers | {f"peak_torque_{motor}_Nm": float(peak) for motor, peak in enumerate(peaks, 1)})


# Figs. 5 and 6


def planar_jobs(interpretation: Interpretation) -> Jobs:
    """Episode of Fig. 5."""
    law = partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)
    robot = interpretation.closed_loop_robot(interpretation.planar)
    return {"loop": job(closed_loop, env_id=PLANAR, law=law, robot=robot)}


def spatial_jobs(interpretation: Interpretation) -> Jobs:
    """Episode of Fig. 6."""
    return {"loop": _rigid_loop(interpretation)}


def draw_planar(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 5."""
    title = "Planar robot (Tables 1 and 2): feedback linearization, no payload"
    return _draw_loop(interpretation, interpretation.planar, results["loop"], title, interpretation.minimum_tension)


def draw_spatial(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 6."""
    robot = interpretation.spatial("control")
    title = f"Spatial robot (Tables 3 and 4): feedback linearization, total mass {robot.mass:g} kg"
    return _draw_loop(interpretation, robot, results["loop"], title, 0.0)


def _draw_loop(
    interpretation: Interpretation, robot: Robot, loop: Rollout, title: str, minimum_tension: float
) -> Figure:
    """Draws torques, tensions and errors, each with its limits."""
    arrays, times = loop.arrays, loop.arrays["action_time"]
    heights = [2.1 * (robot.cables // 3) + 0.7, 4.6]
    figure = new_figure(sum(heights) + 0.4)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    panels = motor_panels(above, robot)
    lower, upper = textbook.torque_limits(robot, interpretation.line_speed(robot) * arrays["motor_speeds"])
    limit_panels(panels, times, lower, upper)
    for motor, axes in enumerate(panels):
        axes.plot(times, arrays["torques"][:, motor], color=plotting.MOTORS[motor], linewidth=1.8)
    panels[0].plot([], [], color=BLUE, linewidth=1.8, label="torque, in the colour of the motor")
    panels[0].set_ylim(float(lower.min()), float(upper.max()))
    plotting.add_headroom(panels[0], above=0.05, below=0.05)
    add_legend(above, panels[0])
    grid = below.add_gridspec(2, 2 if robot.planar else 3)
    _draw_tensions(below.add_subplot(grid[:, 0]), loop, minimum_tension)
    bounds, end = ErrorBounds(), arrays["time"]
    error = -1e3 * (arrays["pose"] - arrays["reference_pose"])
    kinds = [("position", "mm", slice(0, 2 if robot.planar else 3), "tracking_error", bounds.position, "‖e‖", "R")]
    if not robot.planar:
        kinds.append(("rotation", "mrad", slice(3, 6), "rotation_error", bounds.rotation, "max |e|", "bound"))
    for column, (name, unit, block, norm, bound, size, symbol) in enumerate(kinds, 1):
        axes = below.add_subplot(grid[0, column])
        plotting.coordinate_curves(axes, end, error[:, block], block.start)
        axes.tick_params(labelbottom=False)
        axes.set_title(f"{name} errors X_d − X", fontsize=10)
        axes.set(xlim=(0, end[-1]), ylabel=f"error [{unit}]")
        axes.legend(**plotting.LEGEND, ncols=3, loc="lower left")
        plotting.add_headroom(axes, below=0.25)
        axes = below.add_subplot(grid[1, column], sharex=axes)
        axes.semilogy(end, np.maximum(1e3 * arrays[norm], 0.1 * bound), color=BLUE, linewidth=1.5)
        axes.axhline(1e3 * bound, color="black", linewidth=1.0, label=f"{symbol} = {1e3 * bound:g} {unit}")
        axes.set(xlabel="time [s]", ylabel=f"{size} [{unit}]")
        axes.legend(**plotting.LEGEND)
    reason = [f"the episode ends at {end[-1]:.3f} s: {loop.reason}"] if loop.reason else []
    plotting.add_loop_title(figure, interpretation, title, *reason)
    return figure


def motor_panels(figure: Figure | SubFigure, robot: Robot) -> list[Axes]:
    """One panel for each motor, three per row, with shared axes."""
    grid = figure.subplots(robot.cables // 3, 3, sharex=True, sharey=True, squeeze=False)
    for motor, axes in enumerate(grid.flat):
        axes.set_title(f"motor {motor + 1}", fontsize=11, color=plotting.MOTORS[motor], weight="bold")
        axes.locator_params(axis="x", nbins=5, prune="upper")  # otherwise the last label touches the next panel
        axes.label_outer()
        axes.set(xlabel="time [s]" if axes in grid[-1] else "", ylabel="" if motor % 3 else "torque [N·m]")
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
    chosen = _thinned(times, step)
    times, lower, upper = times[chosen], lower[chosen], upper[chosen]
    for motor, axes in enumerate(panels):
        axes.fill_between(times, upper[:, motor], far, color=SHADE, linewidth=0, label="beyond the torque limits")
        axes.fill_between(times, -far, lower[:, motor], color=SHADE, linewidth=0)
        axes.plot(times, upper[:, motor], color=colour, linewidth=1.0, label=label)
        axes.plot(times, lower[:, motor], color=colour, linewidth=1.0)


def _thinned(times: Array, step: float) -> Array:
    """Indices of instants about ``step`` [s] apart, including the first and the last."""
    stride = max(1, round(step / float(np.median(np.diff(times)))))
    return np.union1d(np.arange(0, len(times), stride), len(times) - 1)


def _draw_tensions(axes: Axes, loop: Rollout, minimum: float) -> None:
    times, tensions = loop.arrays["action_time"], loop.arrays["tensions"]
    plotting.curves(axes, times, tensions, [f"cable {cable + 1}" for cable in range(tensions.shape[1])])
    name = f"T_min = {minimum:g} N" if minimum > 0 else "slack at 0 N"
    axes.axhline(minimum, color="black", linewidth=1.0, linestyle="--", label=name)
    top = float(tensions.max())
    axes.set(xlim=(0, loop.arrays["time"][-1]), ylim=(-0.04 * top, 1.38 * top), xlabel="time [s]", ylabel="tension [N]")
    axes.set_title("tensions", fontsize=10)
    axes.legend(**plotting.LEGEND, ncols=2, loc="upper left")


# Fig. 7


def flexible_jobs(interpretation: Interpretation) -> Jobs:
    """Episodes and torque profiles of Fig. 7."""
    robot, rigid = interpretation.flexible("control"), interpretation.spatial("control")
    loop = {"law": partial(PaperFlexible, as_printed=True), "robot": interpretation.closed_loop_robot(robot)}
    return {
        "rigid": _rigid_loop(interpretation),
        "rigid_exact": job(exact_profile, interpretation=interpretation, robot=rigid, payload=0.0),
        "state_space": job(state_space_profile, interpretation=interpretation, robot=robot, payload=0.0),
        "loop": job(closed_loop, env_id=FLEX, **loop),
    }


def ripple(flexible: Profile, rigid: Profile, start: float) -> float:
    """RMS difference of the torques over all motors in the window that begins at ``start`` [s], in N·m."""
    inside = (flexible.times > start) & (flexible.times <= start + WINDOW)
    difference = flexible.torques[inside] - rigid.torques[inside]
    return float(np.sqrt(np.mean(difference**2)))


def flexible_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 7."""
    state_space, rigid, loop = results["state_space"], results["rigid_exact"], results["loop"]
    robot = interpretation.flexible("control")
    divisor = robot.motor_inertia if interpretation.eq24 == "corrected" else 1 + robot.motor_inertia
    error, times = loop.arrays["tracking_error_peak"], loop.arrays["time"]
    margin = np.minimum(state_space.upper - state_space.torques, state_space.torques - state_space.lower)
    lost = np.flatnonzero(error > ErrorBounds().position)
    return Outcome(
        numbers={
            "stiffness_Nm_per_rad": float(robot.stiffness[0]),
            "rigid_peak_Nm": float(np.abs(results["rigid"].arrays["torques"]).max()),
            "flexible_peak_Nm": float(np.abs(state_space.torques).max()),
            "ripple_before_Nm": ripple(state_space, rigid, JUMP - WINDOW),
            "ripple_after_Nm": ripple(state_space, rigid, JUMP),
            "ripple_late_Nm": ripple(state_space, rigid, 1 - WINDOW),
            "flexible_margin_Nm": float(margin.min()),
            "ripple_Hz": float(np.sqrt(robot.stiffness / divisor).max() / (2 * np.pi)),
            "closed_loop_peak_error_mm": 1e3 * float(error.max()),
            "closed_loop_carried": loop.verdict.carried,
            "closed_loop_lost_s": float(times[lost[0]]) if len(lost) else None,
            "closed_loop_slack": bool(loop.arrays["slack"].any()),
        }
    )


def draw_flexible(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 7."""
    robot, space = interpretation.flexible("control"), results["state_space"]
    rigid, loop = results["rigid"].arrays, results["loop"].arrays
    figure = new_figure(5.9)
    panels = motor_panels(figure, robot)
    jump = int(np.searchsorted(space.times, JUMP))
    chosen = np.union1d(_thinned(space.times, 1e-3), [jump, jump + 1])
    times, limits = space.times[chosen], (space.lower[chosen], space.upper[chosen])
    limit_panels(panels, times, *limits, step=_RINGING, colour=GREY, label="limits U± of the blue curve")
    for motor, axes in enumerate(panels):
        for x, torques, colour, width, name in (
            (times, space.torques[chosen], BLUE, 1.2, "with springs, Eqs. 22–25"),
            (loop["action_time"], loop["torques"], VERMILLION, 0.6, "Eq. 22 as printed, closed loop"),
            (rigid["action_time"], rigid["torques"], "black", 1.4, "rigid (Table 4)"),
        ):
            axes.plot(x, torques[:, motor], color=colour, linewidth=width, label=name)
        axes.axvline(JUMP, color=GREY, linestyle=":", linewidth=1.2, label="jump of the reference")
    seen = np.concatenate([space.torques, rigid["torques"]])
    panels[0].set_ylim(min(0.0, float(seen.min())), float(seen.max()))
    plotting.add_headroom(panels[0], above=0.15, below=0.1)
    add_legend(figure, panels[0])
    springs = f"joint springs K = {robot.stiffness[0]:g} N·m/rad (Table 5)"
    plotting.add_loop_title(figure, interpretation, f"Spatial robot with {springs}, total mass {robot.mass:g} kg")
    return figure
