"""Figs. 14 and 15: the robot with joint springs at the largest payload that saturates no motor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flex_eq22 import PaperFlexible
from cablebot_baselines.classical.flexible import Composite, FourthOrder, MotorPD
from cablebot_gym.benchmark.engine import Job
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import (
    TravelledPath,
    add_legend,
    draw_plane,
    mark_bound,
    new_figure,
    torques_height,
)
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cablebot_reproduction.exact import (
    exact_limit,
    paper_circle,
    state_space_limit,
    state_space_profile,
)
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.part import Jobs, Number, Outcome, Results, job
from cablebot_reproduction.parts import profiles
from cablebot_reproduction.parts.interpretations import evidence_of_combinations
from cablebot_reproduction.parts.plotting import add_title
from cablebot_reproduction.parts.profiles import PayloadSummary
from cablebot_reproduction.published import ABOUT, LOADS, MOTORS, published_value, within
from cablebot_reproduction.runs import FLEX, SPATIAL, Law, closed_loop, largest_payload

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EQ22 = partial(PaperFlexible, as_printed=True)

_FAR = 4.0
"""Upper end of the error axis as a multiple of the bound, so that small errors remain visible."""

_PANELS = (("position", "mm"), ("z", "mm"), ("ψ", "mrad"), ("θ", "mrad"), ("φ", "mrad"))
"""Error panels besides the plane with their units of display."""

_METHODS = {
    "motor_pd": "motor-pd, paper criterion",
    "composite": "composite, paper criterion",
    "eq22": "Eq. 22 as printed, paper criterion",
    "eq22_friction": "Eq. 22 with the motor friction of Table 4, paper criterion",
    "task": "fl4, task criterion",
}
"""Rows of the table after those of ``fl4`` under the paper criterion, by job."""


def with_friction(interpretation: Interpretation, robot: Robot) -> Robot:
    """The robot with the damping c of Table 4 as motor friction c′, for which the paper prints no
    value."""
    friction = tuple(interpretation.spatial("payload").damping.tolist())
    return robot.replace(transmission=robot.transmission.replace(motor_damping=friction))


def _payload(robot: Robot, law: Law, name: str, criterion: str = "paper") -> Job:
    return job(largest_payload, env_id=FLEX, law=law, robot=robot, name=name, criterion=criterion)


def _episode(robot: Robot, law: Law) -> Job:
    return job(closed_loop, env_id=FLEX, law=law, robot=robot)


def path_jobs(interpretation: Interpretation) -> Jobs:
    """Episodes of Fig. 14."""
    if not interpretation.flexible_loop_possible:
        return {}
    robot = interpretation.closed_loop_robot(interpretation.flexible("payload"))
    return {
        "fl4": _payload(robot, FourthOrder, "fl4"),
        "empty": _episode(robot, FourthOrder),
        "eq22": _episode(robot, _EQ22),
        "eq22_friction": _episode(with_friction(interpretation, robot), _EQ22),
    }


def path_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 14."""
    if not interpretation.flexible_loop_possible:
        return Outcome(numbers=profiles.NO_PATH)
    shown = _shown(results)
    _, rotation = shown.peaks
    numbers = profiles.path_numbers(shown)
    numbers["peak_rotation_mrad"] = 1e3 * rotation
    depths = _errors(interpretation, shown.arrays)[:, 2]
    numbers["peak_z_mm"] = 1e3 * float(np.abs(depths).max())
    for name in ("eq22", "eq22_friction"):
        for quantity, value in _eq22_numbers(results[name]).items():
            numbers[f"{name}_{quantity}"] = value
    return Outcome(numbers=numbers)


def _eq22_numbers(loop: Rollout) -> dict[str, Number]:
    """Numbers of an episode of the law of the paper."""
    arrays = loop.arrays
    error = arrays["tracking_error_peak"]
    times_outside = arrays["time"][error > ErrorBounds().position].tolist()
    end = None
    if loop.reason:
        end = float(arrays["time"][-1])
    return {
        "peak_error_mm": 1e3 * float(error.max()),
        "within": not loop.reason and not times_outside,
        "leaves_s": next(iter(times_outside), None),
        "ends_s": end,
        "slack": bool(arrays["slack"].any()),
        "peak_action": float(np.abs(arrays["commanded_action"]).max()),
    }


def draw_path(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 14."""
    robot = interpretation.flexible("payload")
    if not interpretation.flexible_loop_possible:
        still = profiles.on_reference(paper_circle(robot), name="state space")
        title = [
            "Robot with joint springs, no closed loop",
            "the path equals the reference by assumption",
        ]
        return _draw_errors(interpretation, [still], [np.zeros_like(still.pose)], title)
    shown = _shown(results)
    summary = PayloadSummary.simulated(results["fl4"])
    friction = f"Eq. 22, motors with friction {interpretation.spatial('payload').damping[0]:g} N·m·s/rad, 0 kg"
    runs = (
        (shown.arrays, f"fl4, {summary.payload or 0.0:.3f} kg", BLUE),
        (results["eq22"].arrays, "Eq. 22 as printed, 0 kg", VERMILLION),
        (results["eq22_friction"].arrays, friction, GREY),
    )
    paths, errors = [], []
    for run, name, color in runs:
        paths.append(profiles.travelled(run, name=name, color=color))
        errors.append(_errors(interpretation, run))
    title = [
        "Robot with joint springs in closed loop",
        "blue, fl4: " + summary.sentence(robot),
        *shown.end_reason,
    ]
    return _draw_errors(interpretation, paths, errors, title)


def _shown(results: Results) -> profiles.Shown:
    return profiles.Shown(result=results["fl4"], empty=results["empty"])


def _draw_errors(
    interpretation: Interpretation,
    paths: Sequence[TravelledPath],
    errors: Sequence[Array],
    title: Sequence[str],
) -> Figure:
    """Draws the plane, the position error, and the errors of the other coordinates with their
    bounds."""
    bounds = ErrorBounds()
    trajectory = paper_circle(interpretation.flexible("payload"))
    figure = new_figure(7.4)
    grid = figure.add_gridspec(4, 2, width_ratios=[1, 1.15])
    plane = figure.add_subplot(grid[:3, 0])
    draw_plane(plane, trajectory, paths, bounds.position)
    limits = {"mm": bounds.position, "mrad": bounds.rotation}
    for index, (name, unit) in enumerate(_PANELS):
        is_norm = index == 0
        is_lowest = index in (0, len(_PANELS) - 1)
        if is_norm:
            axes = figure.add_subplot(grid[3, 0])
            columns = [path.position_error for path in paths]
        else:
            axes = figure.add_subplot(grid[index - 1, 1])
            columns = [error[:, index + 1] for error in errors]
        for path, column in zip(paths, columns, strict=True):
            axes.plot(path.times, 1e3 * column, **path.line)
        bound = limits[unit]
        mark_bound(axes, bound, unit, side="left")  # the curves start at zero
        axes.axhline(-1e3 * bound, color="black", linewidth=1.0)
        far = np.clip(max(np.abs(column).max() for column in columns), 1.15 * bound, _FAR * bound)
        axes.set_ylabel(f"{name} error\n[{unit}]")
        axes.set_ylim(-1e3 * far, 1e3 * max(far, 1.8 * bound))
        axes.set_xlim(0, trajectory.duration)
        axes.tick_params(labelbottom=is_lowest)
        if is_norm:
            axes.set_ylim(bottom=0.0)
        if is_lowest:
            axes.set_xlabel("time [s]")
    add_legend(figure, plane)
    add_title(figure, interpretation, *title)
    return figure


def _errors(interpretation: Interpretation, run: Mapping[str, Array]) -> Array:
    """Pose minus reference at the end of each step, shape (K, n)."""
    times = run["action_time"] + run["action_time"][1]
    return np.asarray(
        run["pose"] - paper_circle(interpretation.flexible("payload"))(times).position
    )


def torque_jobs(interpretation: Interpretation) -> Jobs:
    """Largest payloads of Fig. 15."""
    rigid = interpretation.spatial("payload")
    robot = interpretation.flexible("payload")
    jobs = {
        "rigid_exact": job(exact_limit, interpretation=interpretation, robot=rigid),
        "state_space": job(state_space_limit, interpretation=interpretation, robot=robot),
    }
    if not interpretation.flexible_loop_possible:
        return jobs
    rigid = interpretation.closed_loop_robot(rigid)
    robot = interpretation.closed_loop_robot(robot)
    loop = {"env_id": SPATIAL, "law": FeedbackLinearization, "robot": rigid, "name": "fl"}
    return jobs | {
        "fl4": _payload(robot, FourthOrder, "fl4"),
        "motor_pd": _payload(robot, MotorPD, "motor-pd"),
        "composite": _payload(robot, Composite, "composite"),
        "empty": _episode(robot, FourthOrder),
        "task": _payload(robot, FourthOrder, "fl4", "task"),
        "eq22": _payload(robot, _EQ22, "flex-eq22"),
        "eq22_friction": _payload(with_friction(interpretation, robot), _EQ22, "flex-eq22"),
        "rigid": job(largest_payload, **loop, criterion="paper"),
    }


def torque_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Numbers of Fig. 15."""
    rigid = interpretation.spatial("payload")
    robot = interpretation.flexible("payload")
    space = PayloadSummary.computed(results["state_space"])
    exact = PayloadSummary.computed(results["rigid_exact"])
    numbers = space.numbers(interpretation, robot, "state_space_")
    numbers |= exact.numbers(interpretation, rigid, "rigid_exact_")
    rows = {"rigid, exact tracking": (rigid, exact), "state space of Eqs. 23–25": (robot, space)}
    springs, stiff = space, exact
    if interpretation.flexible_loop_possible:
        springs = PayloadSummary.simulated(results["fl4"])
        stiff = PayloadSummary.simulated(results["rigid"])
        rows["rigid, fl, paper criterion"] = rigid, stiff
        rows["fl4, paper criterion"] = robot, springs
        for name, description in _METHODS.items():
            rows[description] = robot, PayloadSummary.simulated(results[name])
        for name in ("motor_pd", "composite", "task", "eq22", "eq22_friction"):
            numbers |= PayloadSummary.simulated(results[name]).numbers(
                interpretation, robot, f"{name}_"
            )
    numbers |= springs.numbers(interpretation, robot)
    numbers |= stiff.numbers(interpretation, rigid, "rigid_")
    numbers["simulated"] = interpretation.flexible_loop_possible
    numbers["drop_fraction"] = _drop(numbers, "counted_kg", "rigid_counted_kg")
    numbers["state_space_drop_fraction"] = _drop(
        numbers, "state_space_counted_kg", "rigid_exact_counted_kg"
    )
    table = profiles.payload_table("Largest payloads with and without joint springs.", rows)
    return Outcome(numbers=numbers, tables=(table,))


def _drop(numbers: Mapping[str, Number], flexible: str, rigid: str) -> float | None:
    """Payload reduction by the springs as a fraction of the payload of the rigid robot."""
    reduced, full = numbers[flexible], numbers[rigid]
    if not full:
        return None
    return 1 - float(reduced or 0.0) / float(full)


def draw_torques(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 15."""
    robot = interpretation.flexible("payload")
    height = torques_height(robot.cables) + 0.3
    halves = 2 if interpretation.flexible_loop_possible else 1
    figure = new_figure(halves * height)
    panels = list(figure.subfigures(halves, 1, squeeze=False)[:, 0])
    if interpretation.flexible_loop_possible:
        summary = PayloadSummary.simulated(results["fl4"])
        shown = _shown(results)
        profile = profiles.simulated_profile(interpretation.closed_loop_robot(robot), shown.arrays)
        profiles.draw_panels(panels[0], profile, profiles.first_saturation(profile, summary))
        title = "Robot with joint springs, fl4 in closed loop, paper criterion: |a| ≤ 1 at every control instant"
        rigid = results["rigid"].payload
        stiff = "fails unloaded" if rigid is None else f"{rigid:.3f} kg"
        comparison = f"rigid robot with fl, paper criterion: {stiff}"
        add_title(
            panels[0], interpretation, title, summary.sentence(robot), *shown.end_reason, comparison
        )
    summary = PayloadSummary.computed(results["state_space"])
    profile = profiles.computed_profile(
        state_space_profile(interpretation, robot, summary.payload or 0.0)
    )
    profiles.draw_panels(panels[-1], profile, profiles.first_saturation(profile, summary))
    title = "Robot with joint springs, state space of Eqs. 23–25, no closed loop"
    add_title(panels[-1], interpretation, title, summary.sentence(robot))
    return figure


# --- verdicts ---------------------------------------------------------------------------------------------------------

_OPTIONS = ("line", "platform_mass", "triangles", "sides", "stiffness", "eq24")
_DROP_OPTIONS = ("payload", *_OPTIONS, "pulleys")


@verdict("5.2.3.payload", "fig15", options=("payload", *_OPTIONS), choice="Eqs. 23–25")
def payload_with_springs(run: Run) -> Judgement:
    """The state space of the paper gives the published payload."""
    payload = run.payload("fig15.state_space_counted_kg")
    evidence = (
        "The reference acceleration jumps at half time. No robot with joint springs can follow this jump exactly.",
        "The paper may have computed its number from Eqs. 23–25, but no physical robot moves like this.",
        "DLCC of Eq. 22 on the robot: {fig15.eq22_counted_kg}.",
        run.sentence_if(
            "fig15.simulated",
            "DLCC of the stable law `fl4`: {fig15.counted_kg:vs 5.2.3.payload}; see Interpretations.",
        ),
        *evidence_of_combinations(run, "flexible"),
    )
    return Judgement(payload, within(payload, LOADS["flexible"]), evidence)


@verdict("5.2.3.motor", "fig15", options=_OPTIONS, choice="Eqs. 23–25")
def motor_with_springs(run: Run) -> Judgement:
    """The published motor saturates first in the state space of the paper."""
    motor = run.number("fig15.state_space_motor")
    fl4 = run.sentence_if("fig15.simulated", "`fl4`: limiting violation {fig15.violation}.")
    return Judgement(
        motor,
        motor == MOTORS["flexible"],
        evidence=("State space of the paper.", fl4),
        text="motor {fig15.state_space_motor} at {fig15.state_space_time_s}",
    )


@verdict("6.drop", "fig15", options=_DROP_OPTIONS, choice="Eqs. 23–25")
def payload_drops(run: Run) -> Judgement:
    """Joint springs reduce the payload by the published percentage."""
    drop = run.number("fig15.state_space_drop_fraction")
    evidence = (
        "Rigid by exact tracking: {fig15.rigid_exact_counted_kg}; with springs by Eqs. 23–25: "
        "{fig15.state_space_counted_kg}.",
        run.sentence_if(
            "fig15.simulated",
            "Rigid in closed loop: {fig15.rigid_counted_kg}; with springs and `fl4`: {fig15.counted_kg} "
            "(reduction {fig15.drop_fraction:%}).",
        ),
        "The published 1.4 kg are 45.3 % less than the published 2.56 kg.",
    )
    return Judgement(drop, within(drop, 0.01 * published_value("6.drop")), evidence)


@verdict("5.2.3.less", "fig15", unit="%", options=_DROP_OPTIONS, choice="Eqs. 23–25")
def payload_is_considerably_less(run: Run) -> Judgement:
    """Joint springs reduce the payload by more than 5 %."""
    drop = run.number("fig15.state_space_drop_fraction")
    return Judgement(
        drop, drop > ABOUT, ("See §6: reduction of the payload by joint springs.",), "{ours} less"
    )


@verdict("5.2.3.path", "fig14", unit="mm", options=("stiffness", "platform_mass"), choice="Eq. 22")
def path_with_springs(run: Run) -> Judgement:
    """Eq. 22 as printed keeps the path within R."""
    evidence = (
        "Eq. 22 as printed; bound 10 mm.",
        "With the friction of Table 4 at the motors: {fig14.eq22_friction_peak_error_mm}.",
        "With `fl4`: {fig14.peak_error_mm}.",
    )
    return Judgement(
        run.number("fig14.eq22_peak_error_mm"), run.number("fig14.eq22_within"), evidence
    )
