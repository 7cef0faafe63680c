"""The figures of the pages on DLCC and uncertainty, simulated when the pages are built."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.rollout import Rollout, record_rollout
from cablebot_gym.plotting.figures import DPI, TravelledPath, draw_success, new_figure, path_panels
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import SPATIAL
from cablebot_gym.task import ErrorBounds, payload_model_text
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.utils.palette import BLUE, GREEN, GREY, ORANGE, SHADE, VERMILLION
from generate.folder import Folder

ENV_ID, POLICY = "CableBot-Spatial-v0", "fl"

SHOWN = {4.0: BLUE, 5.0: VERMILLION}
"""A payload that is carried, one that is not [kg], and their colours."""

MOTOR = 1
"""Motor that saturates first, from 0."""

SCANNED = np.linspace(0, 8, 65)
"""Payloads of the scan [kg]."""


def write(folder: Folder) -> None:
    """Writes all figures."""
    episodes = {payload: record_rollout(POLICY, ENV_ID, payload=payload) for payload in SHOWN}
    pictures = {
        "line": torque_speed_line(episodes),
        "errors": errors(episodes),
        "payloads": payloads(),
        "draws": draw_success(evaluate_dlcc("fl-tuned", ENV_ID, uncertainty="table6", draws=64, payload_max=6)),
    }
    for name, figure in pictures.items():
        figure.savefig(folder.path(f"figures/{name}.png"), dpi=DPI, metadata={"Software": None})


def torque_speed_line(episodes: dict[float, Rollout]) -> Figure:
    """Requested torque of one motor versus its speed, and its action versus time, with their limits."""
    figure = new_figure(4.6)
    plane, clock = figure.subplots(1, 2)
    stall, slope = SPATIAL.stall_torque[MOTOR], SPATIAL.speed_slope[MOTOR]
    widest = max(np.abs(episode.arrays["motor_speeds"][:, MOTOR]).max() for episode in episodes.values())
    speed = np.array([-1.15, 1.15]) * widest
    for sign, name in ((1, "U⁺"), (-1, "U⁻")):
        plane.plot(speed, sign * stall - slope * speed, color="black", linewidth=1.4)
        plane.annotate(
            name, (speed[1], sign * stall - slope * speed[1]), (-2, 5), textcoords="offset points", ha="right"
        )
    plane.fill_between(speed, stall - slope * speed, 1.35 * stall, color=SHADE, zorder=0)
    plane.fill_between(speed, -stall - slope * speed, -1.35 * stall, color=SHADE, zorder=0)
    for payload, colour in SHOWN.items():
        arrays = episodes[payload].arrays
        action, speeds = arrays["commanded_action"][:, MOTOR], arrays["motor_speeds"][:, MOTOR]
        plane.plot(speeds, stall * action - slope * speeds, color=colour, linewidth=1.4, label=f"{payload:g} kg")
        clock.plot(arrays["action_time"], action, color=colour, linewidth=1.4, label=f"{payload:g} kg")
    for level in (1, -1):
        clock.axhline(level, color="black", linewidth=1.4)
    clock.axhspan(1, 2, color=SHADE, zorder=0)
    clock.axhspan(-2, -1, color=SHADE, zorder=0)
    plane.set(xlabel=f"speed of motor {MOTOR + 1} [rad/s]", ylabel="requested torque [N·m]", xlim=speed)
    plane.set(ylim=(-1.3 * stall, 1.3 * stall), title="torque-speed line")
    clock.set(xlabel="time [s]", ylabel=f"action a of motor {MOTOR + 1}", xlim=(0, 1), ylim=(-1.35, 1.35))
    clock.set(title="action")
    plane.legend(loc="lower left")
    return figure


def errors(episodes: dict[float, Rollout]) -> Figure:
    """Paths within the position bound, and errors with their bounds."""
    figure, error_bounds = new_figure(4.6), ErrorBounds()
    travelled = [_travelled(episodes[payload], payload, colour) for payload, colour in SHOWN.items()]
    trajectory = find_trajectory("paper-spatial", SPATIAL.coordinates)
    path_panels(figure, trajectory, travelled, position=error_bounds.position, rotation=error_bounds.rotation)
    return figure


def _travelled(episode: Rollout, payload: float, colour: str) -> TravelledPath:
    arrays = episode.arrays
    return TravelledPath(
        times=arrays["time"],
        pose=arrays["pose"],
        position_error=arrays["tracking_error"],
        rotation_error=arrays["rotation_error"],
        name=f"{payload:g} kg",
        color=colour,
    )


def payloads() -> Figure:
    """Largest action and errors as fractions of their bounds, versus the payload."""
    figure = new_figure(4.6)
    for axes, known in zip(figure.subplots(1, 2, sharey=True), (True, False), strict=True):
        _scan(axes, known)
    figure.axes[0].set(ylabel="largest value, fraction of its bound")
    figure.axes[1].legend(loc="upper right")
    return figure


def _scan(axes: Axes, known: bool) -> None:
    action, position, rotation = _peaks(known)
    curves = (
        ("action |a|", action, ORANGE),
        ("position error", position, BLUE),
        ("rotation error", rotation, GREEN),
    )
    for name, values, colour in curves:
        axes.plot(SCANNED, values, color=colour, linewidth=1.6, label=name)
    found = {
        criterion: evaluate_dlcc(POLICY, ENV_ID, criterion=criterion, payload_known=known).feasible
        for criterion in ("paper", "task")
    }
    for level in (0, 1):
        axes.axhline(level, color="black", linewidth=1)
    for height, (criterion, feasible) in zip((-0.18, -0.42), found.items(), strict=True):
        for low, high in feasible:
            axes.plot([low, high], [height, height], color=GREY, linewidth=8, solid_capstyle="butt")
        text = f"{criterion} criterion: {feasible[0][1]:.2f} kg"
        axes.annotate(text, (feasible[0][1], height), (6, 0), textcoords="offset points", va="center")
    title = payload_model_text(known)
    axes.set(xlabel="payload [kg]", xlim=(0, SCANNED[-1]), ylim=(-0.6, 2.5), title=title)


def _peaks(known: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest |a|, position and rotation error over their bounds for each payload; infinite after termination."""
    error_bounds, count = ErrorBounds(), len(SCANNED)
    envs = gym.make_vec(ENV_ID, num_envs=count, payload=SCANNED, payload_known=known)
    policy = load_policy(POLICY, SPATIAL)
    observation, info = envs.reset(seed=0)
    peaks, ended = np.zeros((3, count)), np.zeros(count, np.bool_)
    for _ in range(500):
        observation, _, terminated, _, info = envs.step(policy.predict(observation)[0])
        now = (
            np.abs(info["commanded_action"]).max(axis=1),
            info["tracking_error_peak"] / error_bounds.position,
            info["rotation_error_peak"] / error_bounds.rotation,
        )
        peaks = np.where(ended, peaks, np.maximum(peaks, now))
        ended |= terminated
    envs.close()
    action, position, rotation = np.where(ended, np.inf, peaks)
    return action, position, rotation
