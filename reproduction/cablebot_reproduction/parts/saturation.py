"""Figs. 10 to 15: the robots at the largest payload that saturates no motor."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines.laws import FeedbackLinearization, MotorPD
from cablebot_gym.evaluation import DLCCResult
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import (
    TravelledPath,
    add_legend,
    draw_plane,
    mark_bound,
    new_figure,
    path_panels,
    set_title,
    torques_height,
)
from cablebot_gym.robots import PLANAR, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cablebot_reproduction.exact import exact_limit, state_space_limit, state_space_profile
from cablebot_reproduction.fourth_order import FourthOrder
from cablebot_reproduction.outcome import Numbers, Outcome
from cablebot_reproduction.profiles import (
    PayloadSummary,
    draw_torques,
    first_saturation,
    path_numbers,
    payload_table,
    simulated_profile,
    travelled,
)
from cablebot_reproduction.robots import flexible_robot, paper_circle, spatial_robot
from cablebot_reproduction.simulation import (
    composite,
    episode,
    eq22,
    largest_payload,
    peak_error_mm,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure, FigureBase

RIGID = spatial_robot()
FLEXIBLE = flexible_robot()
WITH_FRICTION = flexible_robot(motor_damping=float(RIGID.damping[0]))
"""The robot of §5.2.3 with the damping of Table 4 at its motors, for which the paper prints no
value."""

_FAR = 4.0
"""Upper end of an error axis of Fig. 14 as a multiple of the bound, so that small errors remain
visible."""


_LOOPS: dict[str, tuple[str, dict[str, Any], str]] = {
    "": ("paper criterion", {"criterion": "paper"}, BLUE),
    "task_": ("task criterion", {"criterion": "task"}, VERMILLION),
    "payload_unknown_": (
        "task criterion, payload unknown",
        {"criterion": "task", "payload_known": False},
        GREY,
    ),
}
"""Text, conditions and colour of each closed loop of a rigid robot, by the prefix of its numbers."""


def fig10() -> Outcome:
    """Torques of the planar robot."""
    return _rigid_torques(PLANAR, "Planar")


def fig11() -> Outcome:
    """Path of the planar robot."""
    return _rigid_path(PLANAR, "Planar", rotation=None)


def fig12() -> Outcome:
    """Torques of the spatial robot."""
    return _rigid_torques(RIGID, "Spatial")


def fig13() -> Outcome:
    """Path of the spatial robot."""
    return _rigid_path(RIGID, "Spatial", rotation=ErrorBounds().rotation)


def _rigid_torques(robot: Robot, name: str) -> Outcome:
    exact = PayloadSummary.computed(robot, exact_limit(robot))
    numbers = exact.numbers("exact_")
    rows = {"exact tracking": exact}
    for prefix, (text, conditions, _) in _LOOPS.items():
        result = largest_payload(FeedbackLinearization, robot, **conditions)
        found = PayloadSummary.simulated(result)
        numbers |= found.numbers(prefix)
        rows[f"closed loop, {text}"] = found
    figure = new_figure(torques_height(robot.cables))
    _draw_result(figure, robot, _paper(robot), f"{name} robot in closed loop with fl")
    table = payload_table(f"Largest payloads of the {name.lower()} robot", rows)
    return Outcome(numbers=numbers, tables=(table,), figure=figure)


def _paper(robot: Robot) -> DLCCResult:
    """Feedback linearization under the paper criterion."""
    return largest_payload(FeedbackLinearization, robot, criterion="paper")


def _draw_result(figure: FigureBase, robot: Robot, result: DLCCResult, name: str) -> None:
    """Draws the torques at the largest payload under the paper criterion."""
    found = PayloadSummary.simulated(result)
    profile = simulated_profile(robot, result.rollout.arrays)
    draw_torques(figure, profile, first_saturation(profile, found))
    criterion = "paper criterion: |a| ≤ 1 at every control instant"
    set_title(figure, f"{name}, {criterion}", found.sentence())


def _rigid_path(robot: Robot, name: str, *, rotation: float | None) -> Outcome:
    paths = []
    for text, conditions, color in _LOOPS.values():
        result = largest_payload(FeedbackLinearization, robot, **conditions)
        label = f"{result.payload:.3f} kg, {text}"
        paths.append(travelled(result.rollout.arrays, name=label, color=color))
    figure = new_figure(4.9)
    bound = ErrorBounds().position
    path_panels(figure, paper_circle(robot), paths, position=bound, rotation=rotation)
    sentence = PayloadSummary.simulated(_paper(robot)).sentence()
    set_title(figure, f"{name} robot in closed loop with fl", f"blue: {sentence}")
    return Outcome(numbers=path_numbers(_paper(robot)), figure=figure)


def fig14() -> Outcome:
    """Path and other coordinates of the robot with joint springs."""
    fourth_order = largest_payload(FourthOrder, FLEXIBLE, criterion="paper")
    printed = episode(eq22, FLEXIBLE)
    damped = episode(eq22, WITH_FRICTION)
    found = PayloadSummary.simulated(fourth_order)
    paths = []
    for name, run, color in (
        (f"fourth order, {found.payload_kg:.3f} kg", fourth_order.rollout, BLUE),
        ("Eq. 22 as printed, 0 kg", printed, VERMILLION),
        ("Eq. 22, motors with friction 0.01 N·m·s/rad, 0 kg", damped, GREY),
    ):
        paths.append(travelled(run.arrays, name=name, color=color))
    numbers = path_numbers(fourth_order)
    numbers["peak_z_mm"] = 1e3 * np.abs(_errors(paths[0])[:, 2]).max()
    numbers |= _eq22_numbers("eq22_", printed) | _eq22_numbers("eq22_friction_", damped)
    figure = _draw_coordinates(paths)
    set_title(figure, "Robot with joint springs in closed loop", f"blue: {found.sentence()}")
    return Outcome(numbers=numbers, figure=figure)


def _eq22_numbers(prefix: str, loop: Rollout) -> Numbers:
    """Numbers of an episode of the law of the paper."""
    arrays = loop.arrays
    outside = arrays["time"][arrays["tracking_error_peak"] > ErrorBounds().position]
    return {
        f"{prefix}peak_error_mm": peak_error_mm(loop),
        f"{prefix}within": not loop.reason and not outside.size,
        f"{prefix}leaves_s": float(outside[0]) if outside.size else None,
        f"{prefix}slack": arrays["slack"].any(),
        f"{prefix}peak_action": np.abs(arrays["commanded_action"]).max(),
    }


def _errors(path: TravelledPath) -> Array:
    """Pose minus reference, shape (K, n)."""
    return np.asarray(path.pose - paper_circle(FLEXIBLE)(path.times).position)


def _draw_coordinates(paths: list[TravelledPath]) -> Figure:
    """Draws the plane, and the errors of the other coordinates with their bounds."""
    bounds = ErrorBounds()
    figure = new_figure(6.4)
    grid = figure.add_gridspec(4, 2, width_ratios=[1, 1.15])
    plane = figure.add_subplot(grid[:, 0])
    draw_plane(plane, paper_circle(FLEXIBLE), paths, bounds.position)
    for row, name in enumerate(("z", "ψ", "θ", "φ")):
        axes = figure.add_subplot(grid[row, 1])
        bound, unit = bounds.rotation, "mrad"
        if name == "z":
            bound, unit = bounds.position, "mm"
        for path in paths:
            axes.plot(path.times, 1e3 * _errors(path)[:, 2 + row], **path.line)
        mark_bound(axes, bound, unit, side="left")
        axes.axhline(-1e3 * bound, color="black", linewidth=1.0)
        limit = 1e3 * _FAR * bound
        axes.set(ylabel=f"{name} error\n[{unit}]", xlim=(0, 1), ylim=(-limit, limit))
        axes.tick_params(labelbottom=name == "φ")
    axes.set_xlabel("time [s]")
    add_legend(figure, plane)
    return figure


def fig15() -> Outcome:
    """Torques of the robot with joint springs."""
    exact = PayloadSummary.computed(RIGID, exact_limit(RIGID))
    space = PayloadSummary.computed(FLEXIBLE, state_space_limit(FLEXIBLE))
    fourth_order = largest_payload(FourthOrder, FLEXIBLE, criterion="paper")
    paper = partial(largest_payload, criterion="paper")
    simulated = {
        "rigid_": ("rigid, fl", _paper(RIGID)),
        "": ("fourth order", fourth_order),
        "motor_pd_": ("motor-pd", paper(MotorPD, FLEXIBLE)),
        "composite_": ("composite", paper(composite, FLEXIBLE)),
        "eq22_": ("Eq. 22 as printed", paper(eq22, FLEXIBLE)),
        "eq22_friction_": ("Eq. 22, motor friction of Table 4", paper(eq22, WITH_FRICTION)),
        "task_": ("fourth order", largest_payload(FourthOrder, FLEXIBLE, criterion="task")),
    }
    numbers = space.numbers("state_space_") | exact.numbers("rigid_exact_")
    rows = {"rigid, exact tracking": exact, "state space of Eqs. 23–25": space}
    for prefix, (law, result) in simulated.items():
        found = PayloadSummary.simulated(result)
        numbers |= found.numbers(prefix)
        rows[f"{law}, {result.criterion} criterion"] = found
    numbers["drop_fraction"] = 1 - numbers["payload_kg"] / numbers["rigid_payload_kg"]
    payload = numbers["state_space_payload_kg"]
    numbers["state_space_drop_fraction"] = 1 - payload / numbers["rigid_exact_payload_kg"]
    figure = new_figure(2 * torques_height(FLEXIBLE.cables))
    above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
    name = "Robot with joint springs, fourth-order law in closed loop"
    _draw_result(above, FLEXIBLE, fourth_order, name)
    profile = state_space_profile(FLEXIBLE, payload)
    draw_torques(below, profile, first_saturation(profile, space))
    title = "Robot with joint springs, state space of Eqs. 23–25, no closed loop"
    set_title(below, title, space.sentence())
    table = payload_table("Largest payloads with and without joint springs", rows)
    return Outcome(numbers=numbers, tables=(table,), figure=figure)
