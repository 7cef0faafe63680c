"""Figs. 5 to 7: the closed loops of §4, and what joint springs make of the motors' torques."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.classical import FeedbackLinearization, PaperFlexible
from cablebot_baselines.paper.exact import Profile, exact_profile, state_space_profile
from cablebot_baselines.paper.part import Cell, Found, Number, Outcome, Part
from cablebot_baselines.paper.parts.drawings import MOTORS
from cablebot_baselines.paper.readings import Readings
from cablebot_baselines.paper.runs import closed_loop
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import add_legend, entitle, new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

JUMP = 0.5
"""When the acceleration of Tables 1 and 3 jumps [s]."""

WINDOW = 0.2
"""Before and after the jump and at the end, in which the springs' ripple is measured [s]."""

COORDINATES = ("x", "y", "z", "ψ", "θ", "φ")

_LINE_STYLES = ("-", "--", "-.")
_SMOOTH, _RINGING = 0.01, 0.004
"""Between the instants at which limits are drawn [s], to keep figures small."""


def rigid_loop(readings: Readings) -> Cell:
    """The spatial robot of Table 4 under feedback linearization."""
    robot = readings.moved(readings.spatial("control"))
    return partial(closed_loop, env_id="CableBot-Spatial-v0", law=FeedbackLinearization, robot=robot, payload=0.0)


def line_limits(readings: Readings, robot: Robot, loop: Rollout) -> tuple[Array, Array]:
    """U⁻ and U⁺ of the reading at the motors' speeds of an episode of a rigid robot, each (steps, m) [N·m]."""
    return textbook.torque_limits(robot, readings.line_speed(robot) * loop.arrays["motor_speeds"])


def notes(readings: Readings, *, planar: bool = False) -> list[str]:
    """Lines of a title on readings that are not the default, and on what a closed loop does not follow of them."""
    lines = [] if readings == Readings() else [f"readings: {readings.words()}"]
    if not readings.plays:
        lines.append(
            f"no motor has the line {readings.line!r}: limits drawn by it, the loop run with the physical line"
        )
    if planar and readings.alpha == "constant":
        lines.append("the loop takes the least α at each instant; one α for all times is for exact tracking alone")
    return lines


def _measured(loop: Rollout) -> dict[str, Number]:
    """Numbers that every closed loop has."""
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


def _loop_outcome(readings: Readings, found: Found) -> Outcome:
    return Outcome(numbers=_measured(found["loop"]))


# Figs. 5 and 6


def _planar_cells(readings: Readings) -> dict[str, Cell]:
    law = partial(FeedbackLinearization, minimum_tension=readings.minimum_tension)
    robot = readings.moved(readings.planar)
    return {"loop": partial(closed_loop, env_id="CableBot-Planar-v0", law=law, robot=robot, payload=0.0)}


def _spatial_cells(readings: Readings) -> dict[str, Cell]:
    return {"loop": rigid_loop(readings)}


def _draw_planar(readings: Readings, found: Found) -> Figure:
    head = "Planar robot (Tables 1 and 2): feedback linearization, no payload"
    return _draw_loop(readings, readings.planar, found["loop"], head, readings.minimum_tension)


def _draw_spatial(readings: Readings, found: Found) -> Figure:
    robot = readings.spatial("control")
    head = f"Spatial robot (Tables 3 and 4): feedback linearization, total mass {robot.mass:g} kg"
    return _draw_loop(readings, robot, found["loop"], head, 0.0)


def _draw_loop(readings: Readings, robot: Robot, loop: Rollout, head: str, minimum_tension: float) -> Figure:
    """Torques with their limits, tensions with theirs, errors with theirs."""
    rows = robot.cables // 3
    heights = [2.1 * rows + 0.7, 4.6]
    figure = new_figure(sum(heights) + 0.4)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    panels = motor_panels(above, robot)
    lower, upper = line_limits(readings, robot, loop)
    times = loop.arrays["command_time"]
    limit_panels(panels, times, lower, upper)
    for motor, axes in enumerate(panels):
        axes.plot(times, loop.arrays["torques"][:, motor], color=MOTORS[motor], linewidth=1.8)
    panels[0].plot([], [], color=BLUE, linewidth=1.8, label="torque, in the motor's colour")
    low, high = float(lower.min()), float(upper.max())
    panels[0].set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    add_legend(above, panels[0])
    columns = 2 if robot.planar else 3
    grid = below.add_gridspec(2, columns)
    _draw_tensions(below.add_subplot(grid[:, 0]), loop, minimum_tension)
    limits, arrays, end = Limits(), loop.arrays, loop.arrays["time"]
    difference = arrays["pose"] - arrays["reference_pose"]
    kinds = [("position", "mm", slice(0, 2 if robot.planar else 3), "tracking_error", limits.position)]
    if not robot.planar:
        kinds.append(("rotation", "mrad", slice(3, 6), "rotation_error", limits.rotation))
    for column, (name, unit, part, norm, bound) in enumerate(kinds, 1):
        axes = below.add_subplot(grid[0, column])
        for place, coordinate in enumerate(COORDINATES[part]):
            style = _LINE_STYLES[place]
            error = -1e3 * difference[:, part][:, place]
            axes.plot(end, error, style, color=MOTORS[place], linewidth=1.5, label=coordinate)
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
    reason = [f"the episode ended at {end[-1]:.3f} s: {loop.reason}"] if loop.reason else []
    entitle(figure, head, *notes(readings, planar=robot.planar), *reason)
    return figure


def motor_panels(figure: Figure | SubFigure, robot: Robot) -> list[Axes]:
    """One panel for each motor, three in a row, axes shared."""
    grid = figure.subplots(robot.cables // 3, 3, sharex=True, sharey=True, squeeze=False)
    for motor, axes in enumerate(grid.flat):
        axes.set_title(f"motor {motor + 1}", fontsize=11, color=MOTORS[motor], weight="bold")
        if motor % 3 == 0:
            axes.set_ylabel("torque [N·m]")
        axes.locator_params(axis="x", nbins=5, prune="upper")  # the last label would touch the next panel's first
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
    """Draws U± and shades what lies beyond."""
    far = 3 * float(np.abs([lower, upper]).max())
    chosen = _thinned(times, step)
    times, lower, upper = times[chosen], lower[chosen], upper[chosen]
    for motor, axes in enumerate(panels):
        axes.fill_between(times, upper[:, motor], far, color=SHADE, linewidth=0, label="beyond the motor")
        axes.fill_between(times, -far, lower[:, motor], color=SHADE, linewidth=0)
        axes.plot(times, upper[:, motor], color=colour, linewidth=1.0, label=label)
        axes.plot(times, lower[:, motor], color=colour, linewidth=1.0)


def _thinned(times: Array, step: float) -> Array:
    """Places of some instants, about ``step`` [s] apart, with the first and the last."""
    stride = max(1, round(step / float(np.median(np.diff(times)))))
    return np.union1d(np.arange(0, len(times), stride), len(times) - 1)


def _draw_tensions(axes: Axes, loop: Rollout, minimum: float) -> None:
    times, tensions = loop.arrays["command_time"], loop.arrays["tensions"]
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
    """An error against its bound; both are seen on a logarithmic axis."""
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


def _flexible_cells(readings: Readings) -> dict[str, Cell]:
    robot, rigid = readings.flexible("control"), readings.spatial("control")
    law = partial(PaperFlexible, as_printed=True)
    return {
        "rigid": rigid_loop(readings),
        "rigid_exact": partial(exact_profile, readings=readings, robot=rigid, payload=0.0),
        "state_space": partial(state_space_profile, readings=readings, robot=robot, payload=0.0),
        "loop": partial(
            closed_loop, env_id="CableBot-FlexSpatial-v0", law=law, robot=readings.moved(robot), payload=0.0
        ),
    }


def ripple(flexible: Profile, rigid: Profile, start: float) -> float:
    """Root mean square over motors of the torques' difference in the window from ``start`` [s] on [N·m]."""
    inside = (flexible.times > start) & (flexible.times <= start + WINDOW)
    difference = flexible.torques[inside] - rigid.torques[inside]
    return float(np.sqrt(np.mean(difference**2)))


def _flexible_outcome(readings: Readings, found: Found) -> Outcome:
    state_space, rigid, loop = found["state_space"], found["rigid_exact"], found["loop"]
    robot = readings.flexible("control")
    divisor = robot.motor_inertia if readings.eq24 == "corrected" else 1 + robot.motor_inertia
    error, times = loop.arrays["tracking_error_peak"], loop.arrays["time"]
    margin = np.minimum(state_space.upper - state_space.torques, state_space.torques - state_space.lower)
    lost = np.flatnonzero(error > Limits().position)
    return Outcome(
        numbers={
            "stiffness_Nm_per_rad": float(robot.stiffness[0]),
            "rigid_peak_Nm": float(np.abs(found["rigid"].arrays["torques"]).max()),
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


def _draw_flexible(readings: Readings, found: Found) -> Figure:
    robot, state_space, rigid, loop = (
        readings.flexible("control"),
        found["state_space"],
        found["rigid"].arrays,
        found["loop"],
    )
    figure = new_figure(5.9)
    panels = motor_panels(figure, robot)
    jump = int(np.searchsorted(state_space.times, JUMP))
    chosen = np.union1d(_thinned(state_space.times, 1e-3), [jump, jump + 1])
    names = {
        "state_space": "with springs, by Eqs. 22–25",
        "loop": "Eq. 22 as printed, run on the robot",
        "rigid": "rigid (Table 4)",
        "limits": "limits U± of the blue motion",
    }
    curves = {
        "state_space": (state_space.times[chosen], state_space.torques[chosen], BLUE, 1.2),
        "loop": (loop.arrays["command_time"], loop.arrays["torques"], VERMILLION, 0.6),
        "rigid": (rigid["command_time"], rigid["torques"], "black", 1.4),
    }
    limits = (state_space.lower[chosen], state_space.upper[chosen])
    limit_panels(panels, state_space.times[chosen], *limits, step=_RINGING, colour=GREY, label=names["limits"])
    for motor, axes in enumerate(panels):
        for name, (times, torques, colour, width) in curves.items():
            axes.plot(times, torques[:, motor], color=colour, linewidth=width, label=names[name])
        axes.axvline(JUMP, color=GREY, linestyle=":", linewidth=1.2, label="the reference's jump")
    seen = np.concatenate([state_space.torques, rigid["torques"]])
    low, high = float(seen.min()), float(seen.max())
    panels[0].set_ylim(min(0.0, low) - 0.1 * (high - low), high + 0.15 * (high - low))
    add_legend(figure, panels[0])
    head = (
        f"Spatial robot with joint springs K = {robot.stiffness[0]:g} N·m/rad (Table 5), total mass {robot.mass:g} kg"
    )
    entitle(figure, head, *notes(readings))
    return figure


PARTS: tuple[Part, ...] = (
    Part(
        name="fig5",
        title="Fig. 5: closed loop of the planar robot",
        text="Torques, tensions and errors of the planar robot under the paper's feedback linearization (Eqs. 10–13, "
        "the gains of Table 2, 500 commands a second), without payload on Table 1's circle. The limits are "
        "those of Table 7. Tensions are the least that keep T_min (Eq. 11 with the least α). The "
        "error comes from the sampling and from the jump of the reference's acceleration at 0.5 s alone "
        "(`peak_error_mm`). The paper's curves are not published, so that no value can be "
        "compared. Fig. 4 is the block diagram of this loop.",
        cells=_planar_cells,
        outcome=_loop_outcome,
        draw=_draw_planar,
    ),
    Part(
        name="fig6",
        title="Fig. 6: closed loop of the spatial robot",
        text="The same for the spatial robot under Eqs. 16–18 with the gains and the mass of Table 4 and the motors "
        "of Table 8, on Table 3's circle. The rotation bound of 10 mrad is this project's; the paper has none. "
        "The platform hangs by its weight, so that the tensions are given and positive. The jump of the "
        "reference at 0.5 s shows in every torque. The paper's curves are not published.",
        cells=_spatial_cells,
        outcome=_loop_outcome,
        draw=_draw_spatial,
    ),
    Part(
        name="fig7",
        title="Fig. 7: torques with joint springs against rigid joints",
        text="Each motor's torque with the springs of Table 5 against the rigid robot of Fig. 6. Blue is the paper's "
        "own state space: the platform is taken to be exactly on the reference (Eq. 23), the motors turn behind "
        "their springs by Eqs. 24 and 25, and Eq. 22 gives the torque. In it the jump of the reference at 0.5 s "
        'makes the motors ring at √(K/J′), and nothing damps that: "vibration is considerable just during input '
        'change" (§4.3) holds for the cause, but the ringing stays until the end (`ripple_before_Nm`, '
        "`ripple_after_Nm` and `ripple_late_Nm`: root mean square of the difference to rigid exact tracking in "
        "the 0.2 s before the jump, after it and at the end; before it, the difference is the pulleys' "
        "friction, which Table 5 leaves out, and the ripple of a start from rest). That state space is no "
        "robot's motion; nor need the limits, drawn at the speeds of its ringing motors, allow it "
        "(`flexible_margin_Nm` is the least distance to them, negative beyond). Run on the robot, the "
        "law of Eq. 22 as printed does not stabilise the springs (orange; `closed_loop_lost_s` is when its error "
        "leaves R, `closed_loop_peak_error_mm` how large it gets). The curves of the paper are not published.",
        cells=_flexible_cells,
        outcome=_flexible_outcome,
        draw=_draw_flexible,
    ),
)
