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
from cablebot_baselines.paper.part import Cell, Found, Number, Outcome, Part
from cablebot_baselines.paper.parts.profiles import (
    Carried,
    computed_profile,
    draw_panels,
    early_end,
    first_saturation,
    head,
    on_reference,
    payload_table,
    peaks,
    run_of,
    simulated_profile,
    stays_within,
    travelled,
)
from cablebot_baselines.paper.readings import Readings
from cablebot_baselines.paper.runs import Law, closed_loop, largest_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import Travelled, add_legend, draw_plane, mark_bound, new_figure, torques_height
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ENV_ID = "CableBot-FlexSpatial-v0"

_LAWS: dict[str, Law] = {"fl4": FourthOrder, "motor_pd": MotorPD, "composite": Composite}
"""Laws that work, by their names in results.json."""

_EQ22 = partial(PaperFlexible, as_printed=True)

_FAR = 4.0
"""How many bounds away an error is still shown, not to flatten the others."""

_OTHERS = (("z", "mm"), ("ψ", "mrad"), ("θ", "mrad"), ("φ", "mrad"))
"""Coordinates beside x and y, and the thousandths of their units."""


def with_friction(readings: Readings, robot: Robot) -> Robot:
    """The robot with the c of Table 4 on its motors' side of the springs, c′, where no table has any."""
    friction = tuple(readings.spatial("payload").damping.tolist())
    return robot.replace(transmission=robot.transmission.replace(motor_damping=friction))


def _run(robot: Robot, law: Law) -> Cell:
    return partial(closed_loop, env_id=_ENV_ID, law=law, robot=robot, payload=0.0)


def _payload(robot: Robot, law: Law, name: str, criterion: str = "paper") -> Cell:
    return partial(largest_payload, env_id=_ENV_ID, law=law, robot=robot, name=name, criterion=criterion)


def _path_cells(readings: Readings) -> dict[str, Cell]:
    if not readings.springs_play:
        return {}
    robot = readings.motors(readings.flexible("payload"))
    return {
        "fl4": _payload(robot, FourthOrder, "fl4"),
        "empty": _run(robot, FourthOrder),
        "eq22": _run(robot, _EQ22),
        "eq22_friction": _run(with_friction(readings, robot), _EQ22),
    }


def _path_outcome(readings: Readings, found: Found) -> Outcome:
    bounds = Limits()
    if not readings.springs_play:
        return Outcome(numbers={"peak_error_mm": None, "bound_mm": 1e3 * bounds.position, "within": None})
    position, rotation = peaks(found["fl4"], found["empty"])
    run = run_of(found["fl4"], found["empty"])
    numbers: dict[str, Number] = {
        "payload_kg": found["fl4"].payload,
        "peak_error_mm": 1e3 * position,
        "bound_mm": 1e3 * bounds.position,
        "within": stays_within(found["fl4"], found["empty"]),
        "peak_rotation_mrad": 1e3 * rotation,
        "peak_z_mm": 1e3 * float(np.abs(_errors(readings, run)[:, 2]).max()),
    }
    for name in ("eq22", "eq22_friction"):
        arrays = found[name].arrays
        outside = arrays["tracking_error_peak"] > bounds.position
        numbers |= {
            f"{name}_peak_error_mm": 1e3 * float(arrays["tracking_error_peak"].max()),
            f"{name}_within": found[name].verdict.complete and not outside.any(),
            f"{name}_leaves_s": float(arrays["time"][np.argmax(outside)]) if outside.any() else None,
            f"{name}_ends_s": None if found[name].verdict.complete else float(arrays["time"][-1]),
            f"{name}_slack": bool(arrays["slack"].any()),
            f"{name}_peak_demand": float(np.abs(arrays["drive_demand"]).max()),
        }
    return Outcome(numbers=numbers)


def _draw_path(readings: Readings, found: Found) -> Figure:
    robot = readings.flexible("payload")
    if not readings.springs_play:
        still = on_reference(paper_circle(robot), name="state space")
        lines = ("Robot with joint springs, no closed loop", "the path is the reference by assumption")
        return _drawn(readings, [still], [np.zeros_like(still.pose)], lines)
    carried = Carried.simulated(found["fl4"])
    friction = readings.spatial("payload").damping[0]
    runs: tuple[tuple[Mapping[str, Array], str, str], ...] = (
        (run_of(found["fl4"], found["empty"]), f"fl4, {carried.payload or 0.0:.3f} kg", BLUE),
        (found["eq22"].arrays, "Eq. 22 as printed, 0 kg", VERMILLION),
        (found["eq22_friction"].arrays, f"Eq. 22, motors with friction {friction:g} N·m·s/rad, 0 kg", GREY),
    )
    shown = [travelled(run, name=name, color=color) for run, name, color in runs]
    title = (
        "Robot with joint springs in closed loop",
        "blue, fl4: " + carried.sentence(robot),
        *early_end(found["fl4"], found["empty"]),
    )
    return _drawn(readings, shown, [_errors(readings, run) for run, _, _ in runs], title)


def _drawn(readings: Readings, shown: Sequence[Travelled], errors: Sequence[Array], title: Sequence[str]) -> Figure:
    bounds, trajectory = Limits(), paper_circle(readings.flexible("payload"))
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
    head(figure, readings, *title)
    return figure


def _curves(
    axes: Axes, shown: Sequence[Travelled], errors: Sequence[Array], bound: float, name: str, unit: str
) -> None:
    """Errors of one kind against their bound; far beyond it they leave the panel."""
    for one, error in zip(shown, errors, strict=True):
        axes.plot(one.times, 1e3 * error, **one.line)
    mark_bound(axes, bound, unit, side="left")  # errors start at zero
    far = np.clip(max(float(np.abs(error).max()) for error in errors), 1.15 * bound, _FAR * bound)
    axes.set(ylabel=f"{name} error\n[{unit}]", ylim=(-1e3 * far, 1e3 * max(far, 1.8 * bound)))


def _errors(readings: Readings, run: Mapping[str, Array]) -> Array:
    """Pose less reference at the end of each step, (K, n)."""
    times = run["command_time"] + run["command_time"][1]
    return np.asarray(run["pose"] - paper_circle(readings.flexible("payload"))(times).position)


def _torque_cells(readings: Readings) -> dict[str, Cell]:
    rigid, robot = readings.spatial("payload"), readings.flexible("payload")
    cells: dict[str, Cell] = {
        "rigid_exact": partial(exact_limit, readings=readings, robot=rigid),
        "state_space": partial(state_space_limit, readings=readings, robot=robot),
    }
    if not readings.springs_play:
        return cells
    rigid, robot = readings.motors(rigid), readings.motors(robot)
    return (
        cells
        | {name: _payload(robot, law, name.replace("_", "-")) for name, law in _LAWS.items()}
        | {
            "empty": _run(robot, FourthOrder),
            "task": _payload(robot, FourthOrder, "fl4", "task"),
            "eq22": _payload(robot, _EQ22, "flex-eq22"),
            "eq22_friction": _payload(with_friction(readings, robot), _EQ22, "flex-eq22"),
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


def _torque_outcome(readings: Readings, found: Found) -> Outcome:
    rigid, robot = readings.spatial("payload"), readings.flexible("payload")
    space, exact = Carried.computed(found["state_space"]), Carried.computed(found["rigid_exact"])
    numbers = space.numbers(readings, robot, "state_space_") | exact.numbers(readings, rigid, "rigid_exact_")
    rows = {"rigid, exact tracking": (rigid, exact), "state space of Eqs. 23–25": (robot, space)}
    simulated, stiff = (space, exact)
    if readings.springs_play:
        simulated, stiff = Carried.simulated(found["fl4"]), Carried.simulated(found["rigid"])
        others = ("motor_pd", "composite", "task", "eq22", "eq22_friction")
        for name in others:
            numbers |= Carried.simulated(found[name]).numbers(readings, robot, f"{name}_")
        rows |= {
            "rigid, fl, paper criterion": (rigid, stiff),
            "fl4, paper criterion": (robot, simulated),
            "motor-pd, paper criterion": (robot, Carried.simulated(found["motor_pd"])),
            "composite, paper criterion": (robot, Carried.simulated(found["composite"])),
            "Eq. 22 as printed, paper criterion": (robot, Carried.simulated(found["eq22"])),
            "the same, motors with Table 4's friction": (robot, Carried.simulated(found["eq22_friction"])),
            "fl4, task criterion": (robot, Carried.simulated(found["task"])),
        }
    numbers |= simulated.numbers(readings, robot) | stiff.numbers(readings, rigid, "rigid_")
    numbers |= {
        "simulated": readings.springs_play,
        "drop_share": _drop(numbers, "counted_kg", "rigid_counted_kg"),
        "state_space_drop_share": _drop(numbers, "state_space_counted_kg", "rigid_exact_counted_kg"),
    }
    return Outcome(numbers=numbers, tables=(payload_table("Largest payloads with joint springs, and without.", rows),))


def _drop(numbers: Mapping[str, Number], flexible: str, rigid: str) -> float | None:
    """Share of the rigid robot's payload that the springs cost."""
    less, all_of_it = numbers[flexible], numbers[rigid]
    return 1 - float(less or 0.0) / float(all_of_it) if all_of_it else None


def _draw_torques(readings: Readings, found: Found) -> Figure:
    robot = readings.flexible("payload")
    height = torques_height(robot.cables) + 0.3
    figure = new_figure(2 * height if readings.springs_play else height)
    parts = list(figure.subfigures(2, 1, squeeze=False)[:, 0]) if readings.springs_play else [figure]
    if readings.springs_play:
        carried = Carried.simulated(found["fl4"])
        profile = simulated_profile(readings.motors(robot), run_of(found["fl4"], found["empty"]))
        draw_panels(parts[0], profile, first_saturation(profile, carried))
        how = "Robot with joint springs, fl4 in closed loop, paper criterion: |a| ≤ 1 at every control instant"
        ended = early_end(found["fl4"], found["empty"])
        head(parts[0], readings, how, carried.sentence(robot), *ended, _beside(readings, found))
    carried = Carried.computed(found["state_space"])
    profile = computed_profile(state_space_profile(readings, robot, carried.payload or 0.0))
    draw_panels(parts[-1], profile, first_saturation(profile, carried))
    head(
        parts[-1],
        readings,
        "Robot with joint springs, state space of Eqs. 23–25, no closed loop",
        carried.sentence(robot),
    )
    return figure


def _beside(readings: Readings, found: Found) -> str:
    """The rigid robot in words."""
    payload, drop = found["rigid"].payload, _torque_outcome(readings, found).numbers["drop_share"]
    change = "" if drop is None else f", with springs {abs(float(drop)):.0%} {'less' if float(drop) > 0 else 'more'}"
    return f"rigid robot with fl, paper criterion: {'nothing' if payload is None else f'{payload:.3f} kg'}{change}"


_FIG14 = Part(
    name="fig14",
    title="Fig. 14: path and other coordinates of the robot with joint springs",
    text="""\
The paper shows a circle within R and "responses that are stable" with K = 3. The law of its Eq. 22 does not give them:
as printed, it has a pole in the right half plane whatever K is, and even without a payload it leaves the tube (orange).
What it lacks is damping of the motors: with the c of Table 4 put on their side of the springs, which no table says, the
same law can stay inside (grey). Blue is the fourth-order feedback linearization, the law that does what the paper says
of its own, at its largest payload under the paper's criterion. The bound of z is R; those of the angles are ours.
""",
    cells=_path_cells,
    outcome=_path_outcome,
    draw=_draw_path,
)

_FIG15 = Part(
    name="fig15",
    title="Fig. 15: torques of the robot with joint springs at its largest payload",
    text="""\
Each panel has one motor's torque and its limits U± at the motor's own speed β̇′; the dot is the first saturation. Above,
the closed loop with the fourth-order feedback linearization, at the largest payload with |a| ≤ 1 at every control
instant, 500 Hz. Below, the paper's own way, its state space (Eqs. 23–25): the platform stays on the reference by
assumption while undamped motors ring behind their springs, which is the motion of no robot. The table has the other
laws, Eq. 22 as printed among them, and the rigid robot. The drop is one less the ratio of the payloads with springs and
without, each found in the same way. Even where a closed loop comes near the published load, it starts from another
rigid payload than the paper. *Readings* shows how much the state space's payload depends on the stiffness, the divisor
of Eq. 24 and the speed that U± takes.
""",
    cells=_torque_cells,
    outcome=_torque_outcome,
    draw=_draw_torques,
)

PARTS: tuple[Part, ...] = (_FIG14, _FIG15)
