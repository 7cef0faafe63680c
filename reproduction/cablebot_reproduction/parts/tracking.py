"""Figs. 5 to 7: closed loops of §4 and effect of joint springs on the motor torques."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.comparison import COLOURS
from cablebot_gym.plotting.figures import TorqueProfile, new_figure, set_title, torques_height
from cablebot_gym.robots import PLANAR, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLACK, GREY, VERMILLION
from cablebot_reproduction.exact import eq24_divisor, exact_torques, reserve, state_space_profile
from cablebot_reproduction.outcome import Numbers, Outcome
from cablebot_reproduction.profiles import draw_torques, simulated_profile
from cablebot_reproduction.robots import FLEXIBLE_OF_4, RIGID_OF_4
from cablebot_reproduction.simulation import episode, eq22, peak_error_mm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JUMP = 0.5
"""Time of the jump in the acceleration of Tables 1 and 3 [s]."""

WINDOW = 0.2
"""Duration of the windows before the jump, after it and at the end for the ripple of the torques
[s]."""


def fig5() -> Outcome:
    """Closed loop of the planar robot."""
    title = "Planar robot (Tables 1 and 2): feedback linearization, no payload"
    return _closed_loop(PLANAR, title)


def fig6() -> Outcome:
    """Closed loop of the spatial robot."""
    title = "Spatial robot (Tables 3 and 4): feedback linearization, total mass 11 kg"
    return _closed_loop(RIGID_OF_4, title)


def _closed_loop(robot: Robot, title: str) -> Outcome:
    loop = episode(FeedbackLinearization, robot)
    arrays = loop.arrays
    numbers: Numbers = {
        "peak_error_mm": peak_error_mm(loop),
        "mean_error_mm": 1e3 * arrays["tracking_error"].mean(),
        "least_tension_N": arrays["least_tensions"].min(),
        "slack": arrays["slack"].any(),
        "carried": loop.verdict.carried,
    }
    if not robot.planar:
        numbers["peak_rotation_mrad"] = 1e3 * arrays["rotation_error_peak"].max()
    for motor, peak in enumerate(np.abs(arrays["torques"]).max(axis=0), 1):
        numbers[f"peak_torque_{motor}_Nm"] = peak
    return Outcome(numbers=numbers, figure=_draw_loop(robot, loop, title))


def _draw_loop(robot: Robot, loop: Rollout, title: str) -> Figure:
    """Draws torques with their limits, tensions and errors."""
    heights = [torques_height(robot.cables), 3.2]
    figure = new_figure(sum(heights))
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    draw_torques(above, simulated_profile(robot, loop.arrays))
    errors = 1e3 * (loop.arrays["reference_pose"] - loop.arrays["pose"])
    position, rotation = np.split(errors, [robot.dimensions], axis=1)
    curves = [
        ("tension [N]", loop.arrays["action_time"], loop.arrays["tensions"], "123456"),
        ("position error [mm]", loop.arrays["time"], position, "xyz"),
        ("rotation error [mrad]", loop.arrays["time"], rotation, "ψθφ"),
    ]
    panels = below.subplots(1, 2 if robot.planar else 3)
    for axes, (quantity, times, values, names) in zip(panels, curves, strict=False):
        for name, colour, column in zip(names, COLOURS, values.T, strict=False):
            axes.plot(times, column, color=colour, linewidth=1.4, label=name)
        axes.set(xlabel="time [s]", ylabel=quantity, xlim=(0, 1))
        axes.legend(fontsize=8, ncols=3)
    set_title(figure, title)
    return figure


def ripple(flexible: TorqueProfile, rigid: Array, start: float) -> float:
    """RMS difference of the torques over all motors in the window that begins at ``start`` [s], in
    N·m."""
    times = flexible.times
    inside = (times > start) & (times <= start + WINDOW)
    difference = flexible.torques[inside] - rigid[inside]
    return float(np.sqrt(np.mean(difference**2)))


def fig7() -> Outcome:
    """Torques with joint springs and with rigid joints."""
    robot = FLEXIBLE_OF_4
    space = state_space_profile(robot, 0.0)
    rigid = exact_torques(RIGID_OF_4)
    rigid_loop = episode(FeedbackLinearization, RIGID_OF_4)
    loop = episode(eq22, robot)
    lost = loop.arrays["tracking_error_peak"] > ErrorBounds().position
    frequency = np.sqrt(robot.stiffness / eq24_divisor(robot)).max()
    numbers: Numbers = {
        "rigid_peak_Nm": np.abs(rigid_loop.arrays["torques"]).max(),
        "flexible_peak_Nm": np.abs(space.torques).max(),
        "ripple_before_Nm": ripple(space, rigid, JUMP - WINDOW),
        "ripple_after_Nm": ripple(space, rigid, JUMP),
        "ripple_late_Nm": ripple(space, rigid, 1 - WINDOW),
        "flexible_margin_Nm": reserve(space).min(),
        "ripple_Hz": frequency / (2 * np.pi),
        "closed_loop_peak_error_mm": peak_error_mm(loop),
        "closed_loop_carried": loop.verdict.carried,
        "closed_loop_lost_s": loop.arrays["time"][np.argmax(lost)],
        "closed_loop_slack": loop.arrays["slack"].any(),
    }
    figure = new_figure(torques_height(robot.cables))
    draw_torques(figure, space)
    for motor, axes in enumerate(figure.axes):
        for run, colour in ((loop.arrays, VERMILLION), (rigid_loop.arrays, BLACK)):
            axes.plot(run["action_time"], run["torques"][:, motor], color=colour, linewidth=0.8)
        axes.axvline(JUMP, color=GREY, linestyle=":")
    set_title(
        figure,
        "Spatial robot with joint springs K = 2 N·m/rad (Table 5), total mass 11 kg",
        "blue: springs, Eqs. 22–25; orange: Eq. 22 as printed in closed loop; black: rigid (Table 4); "
        "dotted: jump of the reference",
    )
    return Outcome(numbers=numbers, figure=figure)
