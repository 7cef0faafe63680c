"""Figs. 5 to 7: closed loops of §4 and effect of joint springs on the motor torques."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.classical import FeedbackLinearization, PaperFlexible
from cablebot_baselines.paper.exact import Profile, exact_profile, state_space_profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Cell, CellResults, Number, Outcome, Part
from cablebot_baselines.paper.parts.drawings import MOTORS
from cablebot_baselines.paper.runs import closed_loop
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
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

COORDINATES = ("x", "y", "z", "ψ", "θ", "φ")

_LINE_STYLES = ("-", "--", "-.")
_SMOOTH, _RINGING = 0.01, 0.004
"""Time steps of the drawn torque limits, large enough to keep the figure files small [s]."""


def rigid_loop(interpretation: Interpretation) -> Cell:
    """Cell of the spatial robot of Table 4 with feedback linearization."""
    robot = interpretation.closed_loop_robot(interpretation.spatial("control"))
    return partial(closed_loop, env_id="CableBot-Spatial-v0", law=FeedbackLinearization, robot=robot, payload=0.0)


def line_limits(interpretation: Interpretation, robot: Robot, loop: Rollout) -> tuple[Array, Array]:
    """U⁻ and U⁺ of the interpretation at the motor speeds of a rigid episode, each of shape (steps, m) [N·m]."""
    return textbook.torque_limits(robot, interpretation.line_speed(robot) * loop.arrays["motor_speeds"])


def notes(interpretation: Interpretation, *, planar: bool = False) -> list[str]:
    """Title lines on options that differ from the default and on options that the closed loop cannot use."""
    lines = [] if interpretation == Interpretation() else [f"interpretation: {interpretation.text()}"]
    if not interpretation.closed_loop_possible:
        lines.append(
            f"no motor can have the line {interpretation.line!r}: the limits show this line, the loop uses the "
            "physical line"
        )
    if planar and interpretation.alpha == "constant":
        lines.append("the loop uses the smallest α at each instant; a constant α applies to exact tracking only")
    return lines


def _loop_numbers(loop: Rollout) -> dict[str, Number]:
    """Numbers of a closed loop."""
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
    return numbers | {f"peak_torque_{motor}_Nm": float(peak) for motor, peak in enumerate(peaks, 1)}


def _loop_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    return Outcome(numbers=_loop_numbers(results["loop"]))


# Figs. 5 and 6


def _planar_cells(interpretation: Interpretation) -> dict[str, Cell]:
    law = partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)
    robot = interpretation.closed_loop_robot(interpretation.planar)
    return {"loop": partial(closed_loop, env_id="CableBot-Planar-v0", law=law, robot=robot, payload=0.0)}


def _spatial_cells(interpretation: Interpretation) -> dict[str, Cell]:
    return {"loop": rigid_loop(interpretation)}


def _draw_planar(interpretation: Interpretation, results: CellResults) -> Figure:
    title = "Planar robot (Tables 1 and 2): feedback linearization, no payload"
    return _draw_loop(interpretation, interpretation.planar, results["loop"], title, interpretation.minimum_tension)


def _draw_spatial(interpretation: Interpretation, results: CellResults) -> Figure:
    robot = interpretation.spatial("control")
    title = f"Spatial robot (Tables 3 and 4): feedback linearization, total mass {robot.mass:g} kg"
    return _draw_loop(interpretation, robot, results["loop"], title, 0.0)


def _draw_loop(
    interpretation: Interpretation, robot: Robot, loop: Rollout, title: str, minimum_tension: float
) -> Figure:
    """Draws torques, tensions and errors, each with its limits."""
    rows = robot.cables // 3
    heights = [2.1 * rows + 0.7, 4.6]
    figure = new_figure(sum(heights) + 0.4)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    panels = motor_panels(above, robot)
    lower, upper = line_limits(interpretation, robot, loop)
    times = loop.arrays["action_time"]
    limit_panels(panels, times, lower, upper)
    for motor, axes in enumerate(panels):
        axes.plot(times, loop.arrays["torques"][:, motor], color=MOTORS[motor], linewidth=1.8)
    panels[0].plot([], [], color=BLUE, linewidth=1.8, label="torque, in the colour of the motor")
    low, high = float(lower.min()), float(upper.max())
    panels[0].set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    add_legend(above, panels[0])
    columns = 2 if robot.planar else 3
    grid = below.add_gridspec(2, columns)
    _draw_tensions(below.add_subplot(grid[:, 0]), loop, minimum_tension)
    bounds, arrays, end = ErrorBounds(), loop.arrays, loop.arrays["time"]
    difference = arrays["pose"] - arrays["reference_pose"]
    kinds = [("position", "mm", slice(0, 2 if robot.planar else 3), "tracking_error", bounds.position)]
    if not robot.planar:
        kinds.append(("rotation", "mrad", slice(3, 6), "rotation_error", bounds.rotation))
    for column, (name, unit, part, norm, bound) in enumerate(kinds, 1):
        axes = below.add_subplot(grid[0, column])
        for index, coordinate in enumerate(COORDINATES[part]):
            style = _LINE_STYLES[index]
            error = -1e3 * difference[:, part][:, index]
            axes.plot(end, error, style, color=MOTORS[index], linewidth=1.5, label=coordinate)
        axes.axhline(0, color=GREY, linewidth=0.6)
        axes.tick_params(labelbottom=False)
        axes.set_title(f"{name} errors X_d − X", fontsize=10)
        axes.set(xlim=(0, end[-1]), ylabel=f"error [{unit}]")
        axes.legend(frameon=False, fontsize=9, ncols=3, loc="lower left", handlelength=1.6, columnspacing=1.0)
        low, high = axes.get_ylim()
        axes.set_ylim(bottom=low - 0.25 * (high - low))
        against = below.add_subplot(grid[1, column], sharex=axes)
        size = "‖e‖" if name == "position" else "max |e|"
        _draw_size(against, end, 1e3 * arrays[norm], 1e3 * bound, f"{size} [{unit}]", "R" if unit == "mm" else "bound")
    reason = [f"the episode ends at {end[-1]:.3f} s: {loop.reason}"] if loop.reason else []
    set_title(figure, title, *notes(interpretation, planar=robot.planar), *reason)
    return figure


def motor_panels(figure: Figure | SubFigure, robot: Robot) -> list[Axes]:
    """One panel for each motor, three per row, with shared axes."""
    grid = figure.subplots(robot.cables // 3, 3, sharex=True, sharey=True, squeeze=False)
    for motor, axes in enumerate(grid.flat):
        axes.set_title(f"motor {motor + 1}", fontsize=11, color=MOTORS[motor], weight="bold")
        if motor % 3 == 0:
            axes.set_ylabel("torque [N·m]")
        axes.locator_params(axis="x", nbins=5, prune="upper")  # otherwise the last label touches the next panel
    for axes in grid[-1, :]:
        axes.set_xlabel("time [s]")
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
    for cable in range(tensions.shape[1]):
        axes.plot(times, tensions[:, cable], color=MOTORS[cable], linewidth=1.6, label=f"cable {cable + 1}")
    name = f"T_min = {minimum:g} N" if minimum > 0 else "slack at 0 N"
    axes.axhline(minimum, color="black", linewidth=1.0, linestyle="--", label=name)
    top = float(tensions.max())
    axes.set(xlim=(0, loop.arrays["time"][-1]), ylim=(-0.04 * top, 1.38 * top), xlabel="time [s]", ylabel="tension [N]")
    axes.set_title("tensions", fontsize=10)
    legend = axes.legend(frameon=False, fontsize=9, ncols=2, loc="upper left", handlelength=1.6, columnspacing=1.0)
    for text in legend.get_texts():
        text.set_parse_math(False)


def _draw_size(axes: Axes, times: Array, error: Array, bound: float, label: str, name: str) -> None:
    """Draws an error and its bound on a logarithmic axis."""
    least = 1e-4 * bound
    axes.plot(times, np.maximum(error, least), color=BLUE, linewidth=1.5)
    axes.axhline(bound, color="black", linewidth=1.0)
    unit = label.partition("[")[2].rstrip("]")
    axes.annotate(
        f"{name} = {bound:g} {unit}",
        (0.98, bound),
        xycoords=("axes fraction", "data"),
        xytext=(0, 2),
        textcoords="offset points",
        ha="right",
        va="bottom",
        fontsize=9,
    )
    axes.set(yscale="log", ylim=(least, max(4 * bound, 2 * error.max())), xlabel="time [s]", ylabel=label)


# Fig. 7


def _flexible_cells(interpretation: Interpretation) -> dict[str, Cell]:
    robot, rigid = interpretation.flexible("control"), interpretation.spatial("control")
    law = partial(PaperFlexible, as_printed=True)
    return {
        "rigid": rigid_loop(interpretation),
        "rigid_exact": partial(exact_profile, interpretation=interpretation, robot=rigid, payload=0.0),
        "state_space": partial(state_space_profile, interpretation=interpretation, robot=robot, payload=0.0),
        "loop": partial(
            closed_loop,
            env_id="CableBot-FlexSpatial-v0",
            law=law,
            robot=interpretation.closed_loop_robot(robot),
            payload=0.0,
        ),
    }


def ripple(flexible: Profile, rigid: Profile, start: float) -> float:
    """RMS difference of the torques over all motors in the window that begins at ``start`` [s], in N·m."""
    inside = (flexible.times > start) & (flexible.times <= start + WINDOW)
    difference = flexible.torques[inside] - rigid.torques[inside]
    return float(np.sqrt(np.mean(difference**2)))


def _flexible_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
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


def _draw_flexible(interpretation: Interpretation, results: CellResults) -> Figure:
    robot, state_space, rigid, loop = (
        interpretation.flexible("control"),
        results["state_space"],
        results["rigid"].arrays,
        results["loop"],
    )
    figure = new_figure(5.9)
    panels = motor_panels(figure, robot)
    jump = int(np.searchsorted(state_space.times, JUMP))
    chosen = np.union1d(_thinned(state_space.times, 1e-3), [jump, jump + 1])
    names = {
        "state_space": "with springs, Eqs. 22–25",
        "loop": "Eq. 22 as printed, closed loop",
        "rigid": "rigid (Table 4)",
        "limits": "limits U± of the blue curve",
    }
    curves = {
        "state_space": (state_space.times[chosen], state_space.torques[chosen], BLUE, 1.2),
        "loop": (loop.arrays["action_time"], loop.arrays["torques"], VERMILLION, 0.6),
        "rigid": (rigid["action_time"], rigid["torques"], "black", 1.4),
    }
    limits = (state_space.lower[chosen], state_space.upper[chosen])
    limit_panels(panels, state_space.times[chosen], *limits, step=_RINGING, colour=GREY, label=names["limits"])
    for motor, axes in enumerate(panels):
        for name, (times, torques, colour, width) in curves.items():
            axes.plot(times, torques[:, motor], color=colour, linewidth=width, label=names[name])
        axes.axvline(JUMP, color=GREY, linestyle=":", linewidth=1.2, label="jump of the reference")
    seen = np.concatenate([state_space.torques, rigid["torques"]])
    low, high = float(seen.min()), float(seen.max())
    panels[0].set_ylim(min(0.0, low) - 0.1 * (high - low), high + 0.15 * (high - low))
    add_legend(figure, panels[0])
    title = (
        f"Spatial robot with joint springs K = {robot.stiffness[0]:g} N·m/rad (Table 5), total mass {robot.mass:g} kg"
    )
    set_title(figure, title, *notes(interpretation))
    return figure


PARTS: tuple[Part, ...] = (
    Part(
        name="fig5",
        title="Fig. 5: closed loop of the planar robot",
        text="Torques, tensions and errors of the planar robot with the feedback linearization of the paper (Eqs. "
        "10–13, gains of Table 2, 500 Hz), without payload on the circle of Table 1. The torque limits are those of "
        "Table 7. The tensions are the smallest ones that keep T_min (Eq. 11 with the smallest α). The error results "
        "only from sampling and from the jump of the reference acceleration at 0.5 s (`peak_error_mm`). The data of "
        "the published curves are not available, so no value can be compared. Fig. 4 is the block diagram of this "
        "loop.",
        cells=_planar_cells,
        outcome=_loop_outcome,
        draw=_draw_planar,
    ),
    Part(
        name="fig6",
        title="Fig. 6: closed loop of the spatial robot",
        text="The same for the spatial robot with Eqs. 16–18, the gains and the mass of Table 4 and the motors of "
        "Table 8, on the circle of Table 3. The rotation bound of 10 mrad is a choice of this project; the paper "
        "defines none. The platform hangs by its weight, so the tensions are unique and positive. The jump of the "
        "reference at 0.5 s is visible in every torque. The data of the published curves are not available.",
        cells=_spatial_cells,
        outcome=_loop_outcome,
        draw=_draw_spatial,
    ),
    Part(
        name="fig7",
        title="Fig. 7: torques with joint springs and with rigid joints",
        text="Torque of each motor with the springs of Table 5, compared with the rigid robot of Fig. 6. Blue: state "
        "space of the paper. The platform is exactly on the reference (Eq. 23), the motors move behind their springs "
        "by Eqs. 24 and 25, and Eq. 22 gives the torque. The jump of the reference at 0.5 s excites an undamped "
        "oscillation "
        'of the motors with the frequency √(K/J′). The cause agrees with "vibration is considerable just during input '
        'change" (§4.3), but the oscillation persists until the end. `ripple_before_Nm`, `ripple_after_Nm` and '
        "`ripple_late_Nm` are the RMS differences from rigid exact tracking in the 0.2 s before the jump, after the "
        "jump and at the end. The difference before the jump results from the friction of the pulleys, which Table 5 "
        "omits, and from the oscillation after the start from rest. No physical robot moves like this state space, and "
        "the torque limits at the speeds of the oscillating motors need not allow it (`flexible_margin_Nm` is the "
        "smallest margin; a negative value is a violation). Orange: closed loop with Eq. 22 as printed, which does not "
        "stabilise the springs (`closed_loop_lost_s` is the time at which the error exceeds R, "
        "`closed_loop_peak_error_mm` the largest error). The data of the published curves are not available.",
        cells=_flexible_cells,
        outcome=_flexible_outcome,
        draw=_draw_flexible,
    ),
)
