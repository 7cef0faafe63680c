"""Figs. 14 and 15: the robot with joint springs at the largest payload that saturates no motor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flex_eq22 import PaperFlexible
from cablebot_baselines.classical.flexible import Composite, FourthOrder, MotorPD
from cablebot_baselines.paper.exact import exact_limit, paper_circle, state_space_limit, state_space_profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Cell, CellResults, Number, Outcome, Part
from cablebot_baselines.paper.parts.profiles import (
    PayloadSummary,
    add_title,
    computed_profile,
    draw_panels,
    drawn_run,
    early_end,
    first_saturation,
    on_reference,
    payload_table,
    peaks,
    simulated_profile,
    stays_within,
    travelled,
)
from cablebot_baselines.paper.runs import Law, closed_loop, largest_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import TravelledPath, add_legend, draw_plane, mark_bound, new_figure, torques_height
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ENV_ID = "CableBot-FlexSpatial-v0"

_LAWS: dict[str, Law] = {"fl4": FourthOrder, "motor_pd": MotorPD, "composite": Composite}
"""Stable laws by their names in results.json."""

_EQ22 = partial(PaperFlexible, as_printed=True)

_FAR = 4.0
"""Upper end of the error axis as a multiple of the bound, so that small errors remain visible."""

_OTHERS = (("z", "mm"), ("ψ", "mrad"), ("θ", "mrad"), ("φ", "mrad"))
"""Coordinates besides x and y with their units of display."""


def with_friction(interpretation: Interpretation, robot: Robot) -> Robot:
    """The robot with the damping c of Table 4 as motor friction c′, for which the paper prints no value."""
    friction = tuple(interpretation.spatial("payload").damping.tolist())
    return robot.replace(transmission=robot.transmission.replace(motor_damping=friction))


def _run(robot: Robot, law: Law) -> Cell:
    return partial(closed_loop, env_id=_ENV_ID, law=law, robot=robot, payload=0.0)


def _payload(robot: Robot, law: Law, name: str, criterion: str = "paper") -> Cell:
    return partial(largest_payload, env_id=_ENV_ID, law=law, robot=robot, name=name, criterion=criterion)


def _path_cells(interpretation: Interpretation) -> dict[str, Cell]:
    if not interpretation.flexible_loop_possible:
        return {}
    robot = interpretation.motors(interpretation.flexible("payload"))
    return {
        "fl4": _payload(robot, FourthOrder, "fl4"),
        "empty": _run(robot, FourthOrder),
        "eq22": _run(robot, _EQ22),
        "eq22_friction": _run(with_friction(interpretation, robot), _EQ22),
    }


def _path_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    bounds = ErrorBounds()
    if not interpretation.flexible_loop_possible:
        return Outcome(numbers={"peak_error_mm": None, "bound_mm": 1e3 * bounds.position, "within": None})
    position, rotation = peaks(results["fl4"], results["empty"])
    run = drawn_run(results["fl4"], results["empty"])
    numbers: dict[str, Number] = {
        "payload_kg": results["fl4"].payload,
        "peak_error_mm": 1e3 * position,
        "bound_mm": 1e3 * bounds.position,
        "within": stays_within(results["fl4"], results["empty"]),
        "peak_rotation_mrad": 1e3 * rotation,
        "peak_z_mm": 1e3 * float(np.abs(_errors(interpretation, run)[:, 2]).max()),
    }
    for name in ("eq22", "eq22_friction"):
        arrays = results[name].arrays
        outside = arrays["tracking_error_peak"] > bounds.position
        numbers |= {
            f"{name}_peak_error_mm": 1e3 * float(arrays["tracking_error_peak"].max()),
            f"{name}_within": results[name].verdict.complete and not outside.any(),
            f"{name}_leaves_s": float(arrays["time"][np.argmax(outside)]) if outside.any() else None,
            f"{name}_ends_s": None if results[name].verdict.complete else float(arrays["time"][-1]),
            f"{name}_slack": bool(arrays["slack"].any()),
            f"{name}_peak_action": float(np.abs(arrays["commanded_action"]).max()),
        }
    return Outcome(numbers=numbers)


def _draw_path(interpretation: Interpretation, results: CellResults) -> Figure:
    robot = interpretation.flexible("payload")
    if not interpretation.flexible_loop_possible:
        still = on_reference(paper_circle(robot), name="state space")
        lines = ("Robot with joint springs, no closed loop", "the path equals the reference by assumption")
        return _drawn(interpretation, [still], [np.zeros_like(still.pose)], lines)
    summary = PayloadSummary.simulated(results["fl4"])
    friction = interpretation.spatial("payload").damping[0]
    runs: tuple[tuple[Mapping[str, Array], str, str], ...] = (
        (drawn_run(results["fl4"], results["empty"]), f"fl4, {summary.payload or 0.0:.3f} kg", BLUE),
        (results["eq22"].arrays, "Eq. 22 as printed, 0 kg", VERMILLION),
        (results["eq22_friction"].arrays, f"Eq. 22, motors with friction {friction:g} N·m·s/rad, 0 kg", GREY),
    )
    shown = [travelled(run, name=name, color=color) for run, name, color in runs]
    title = (
        "Robot with joint springs in closed loop",
        "blue, fl4: " + summary.sentence(robot),
        *early_end(results["fl4"], results["empty"]),
    )
    return _drawn(interpretation, shown, [_errors(interpretation, run) for run, _, _ in runs], title)


def _drawn(
    interpretation: Interpretation, shown: Sequence[TravelledPath], errors: Sequence[Array], title: Sequence[str]
) -> Figure:
    bounds, trajectory = ErrorBounds(), paper_circle(interpretation.flexible("payload"))
    figure = new_figure(7.4)
    grid = figure.add_gridspec(4, 2, width_ratios=[1, 1.15])
    plane, away = figure.add_subplot(grid[:3, 0]), figure.add_subplot(grid[3, 0])
    draw_plane(plane, trajectory, shown, bounds.position)
    _curves(away, shown, [one.position_error for one in shown], bounds.position, "position", "mm")
    away.set_ylim(bottom=0.0)
    others = [figure.add_subplot(grid[row, 1], sharex=away) for row in range(len(_OTHERS))]
    for place, (axes, (name, unit)) in enumerate(zip(others, _OTHERS, strict=True), start=2):
        bound = bounds.position if unit == "mm" else bounds.rotation
        _curves(axes, shown, [error[:, place] for error in errors], bound, name, unit)
        axes.axhline(-1e3 * bound, color="black", linewidth=1.0)
        axes.tick_params(labelbottom=axes is others[-1])
    for axes in (away, others[-1]):
        axes.set(xlabel="time [s]", xlim=(0, trajectory.duration))
    add_legend(figure, plane)
    add_title(figure, interpretation, *title)
    return figure


def _curves(
    axes: Axes, shown: Sequence[TravelledPath], errors: Sequence[Array], bound: float, name: str, unit: str
) -> None:
    """Draws errors of one kind with their bound; much larger errors leave the panel."""
    for one, error in zip(shown, errors, strict=True):
        axes.plot(one.times, 1e3 * error, **one.line)
    mark_bound(axes, bound, unit, side="left")  # the curves start at zero
    far = np.clip(max(float(np.abs(error).max()) for error in errors), 1.15 * bound, _FAR * bound)
    axes.set(ylabel=f"{name} error\n[{unit}]", ylim=(-1e3 * far, 1e3 * max(far, 1.8 * bound)))


def _errors(interpretation: Interpretation, run: Mapping[str, Array]) -> Array:
    """Pose minus reference at the end of each step, shape (K, n)."""
    times = run["action_time"] + run["action_time"][1]
    return np.asarray(run["pose"] - paper_circle(interpretation.flexible("payload"))(times).position)


def _torque_cells(interpretation: Interpretation) -> dict[str, Cell]:
    rigid, robot = interpretation.spatial("payload"), interpretation.flexible("payload")
    cells: dict[str, Cell] = {
        "rigid_exact": partial(exact_limit, interpretation=interpretation, robot=rigid),
        "state_space": partial(state_space_limit, interpretation=interpretation, robot=robot),
    }
    if not interpretation.flexible_loop_possible:
        return cells
    rigid, robot = interpretation.motors(rigid), interpretation.motors(robot)
    return (
        cells
        | {name: _payload(robot, law, name.replace("_", "-")) for name, law in _LAWS.items()}
        | {
            "empty": _run(robot, FourthOrder),
            "task": _payload(robot, FourthOrder, "fl4", "task"),
            "eq22": _payload(robot, _EQ22, "flex-eq22"),
            "eq22_friction": _payload(with_friction(interpretation, robot), _EQ22, "flex-eq22"),
            "rigid": partial(
                largest_payload,
                env_id="CableBot-Spatial-v0",
                law=FeedbackLinearization,
                robot=rigid,
                name="fl",
                criterion="paper",
            ),
        }
    )


def _torque_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    rigid, robot = interpretation.spatial("payload"), interpretation.flexible("payload")
    space, exact = PayloadSummary.computed(results["state_space"]), PayloadSummary.computed(results["rigid_exact"])
    numbers = space.numbers(interpretation, robot, "state_space_") | exact.numbers(
        interpretation, rigid, "rigid_exact_"
    )
    rows = {"rigid, exact tracking": (rigid, exact), "state space of Eqs. 23–25": (robot, space)}
    simulated, stiff = (space, exact)
    if interpretation.flexible_loop_possible:
        simulated, stiff = PayloadSummary.simulated(results["fl4"]), PayloadSummary.simulated(results["rigid"])
        others = ("motor_pd", "composite", "task", "eq22", "eq22_friction")
        for name in others:
            numbers |= PayloadSummary.simulated(results[name]).numbers(interpretation, robot, f"{name}_")
        rows |= {
            "rigid, fl, paper criterion": (rigid, stiff),
            "fl4, paper criterion": (robot, simulated),
            "motor-pd, paper criterion": (robot, PayloadSummary.simulated(results["motor_pd"])),
            "composite, paper criterion": (robot, PayloadSummary.simulated(results["composite"])),
            "Eq. 22 as printed, paper criterion": (robot, PayloadSummary.simulated(results["eq22"])),
            "Eq. 22 with the motor friction of Table 4, paper criterion": (
                robot,
                PayloadSummary.simulated(results["eq22_friction"]),
            ),
            "fl4, task criterion": (robot, PayloadSummary.simulated(results["task"])),
        }
    numbers |= simulated.numbers(interpretation, robot) | stiff.numbers(interpretation, rigid, "rigid_")
    numbers |= {
        "simulated": interpretation.flexible_loop_possible,
        "drop_fraction": _drop(numbers, "counted_kg", "rigid_counted_kg"),
        "state_space_drop_fraction": _drop(numbers, "state_space_counted_kg", "rigid_exact_counted_kg"),
    }
    return Outcome(numbers=numbers, tables=(payload_table("Largest payloads with and without joint springs.", rows),))


def _drop(numbers: Mapping[str, Number], flexible: str, rigid: str) -> float | None:
    """Payload reduction by the springs as a fraction of the payload of the rigid robot."""
    reduced, full = numbers[flexible], numbers[rigid]
    return 1 - float(reduced or 0.0) / float(full) if full else None


def _draw_torques(interpretation: Interpretation, results: CellResults) -> Figure:
    robot = interpretation.flexible("payload")
    height = torques_height(robot.cables) + 0.3
    figure = new_figure(2 * height if interpretation.flexible_loop_possible else height)
    parts = list(figure.subfigures(2, 1, squeeze=False)[:, 0]) if interpretation.flexible_loop_possible else [figure]
    if interpretation.flexible_loop_possible:
        summary = PayloadSummary.simulated(results["fl4"])
        profile = simulated_profile(interpretation.motors(robot), drawn_run(results["fl4"], results["empty"]))
        draw_panels(parts[0], profile, first_saturation(profile, summary))
        title = "Robot with joint springs, fl4 in closed loop, paper criterion: |a| ≤ 1 at every control instant"
        ended = early_end(results["fl4"], results["empty"])
        add_title(
            parts[0], interpretation, title, summary.sentence(robot), *ended, _rigid_line(interpretation, results)
        )
    summary = PayloadSummary.computed(results["state_space"])
    profile = computed_profile(state_space_profile(interpretation, robot, summary.payload or 0.0))
    draw_panels(parts[-1], profile, first_saturation(profile, summary))
    add_title(
        parts[-1],
        interpretation,
        "Robot with joint springs, state space of Eqs. 23–25, no closed loop",
        summary.sentence(robot),
    )
    return figure


def _rigid_line(interpretation: Interpretation, results: CellResults) -> str:
    """Title line on the rigid robot."""
    payload, drop = results["rigid"].payload, _torque_outcome(interpretation, results).numbers["drop_fraction"]
    change = "" if drop is None else f", with springs {abs(float(drop)):.0%} {'less' if float(drop) > 0 else 'more'}"
    text = "fails unloaded" if payload is None else f"{payload:.3f} kg"
    return f"rigid robot with fl, paper criterion: {text}{change}"


_FIG14 = Part(
    name="fig14",
    title="Fig. 14: path and other coordinates of the robot with joint springs",
    text="""\
The paper shows a circle within R and "responses that are stable" with K = 3. Its law, Eq. 22, does not produce these
responses. As printed it has a pole in the right half plane for every K, and without payload its path leaves the tube
(orange). The law lacks damping of the motors. With the damping c of Table 4 as motor friction, which no table states,
the same law can stay within the tube (grey). Blue is the fourth-order feedback linearization at its largest payload
under the paper criterion; this law has the properties that the paper claims for Eq. 22. The bound of z is R. The bounds
of the angles are a choice of this project.
""",
    cells=_path_cells,
    outcome=_path_outcome,
    draw=_draw_path,
)

_FIG15 = Part(
    name="fig15",
    title="Fig. 15: torques of the robot with joint springs at its largest payload",
    text="""\
Each panel shows the torque of one motor and its limits U± at the motor speed β̇′; the dot marks the first saturation.
Top: closed loop with the fourth-order feedback linearization at 500 Hz, at the largest payload with |a| ≤ 1 at every
control instant. Bottom: state space of the paper (Eqs. 23–25). There the platform is on the reference by assumption,
and the undamped motors oscillate behind their springs; no physical robot moves like this. The table also contains the
other laws, including Eq. 22 as printed, and the rigid robot. The reduction is one minus the ratio of the payloads with
and without springs, both computed by the same method. A closed loop may come close to the published payload, but its
rigid payload differs from the published one. The section *Interpretations* shows the effect of the stiffness, the
divisor of Eq. 24 and the speed in U± on the payload of the state space.
""",
    cells=_torque_cells,
    outcome=_torque_outcome,
    draw=_draw_torques,
)

PARTS: tuple[Part, ...] = (_FIG14, _FIG15)
