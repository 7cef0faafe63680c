"""Simulates and draws the figures of the pages on DLCC and uncertainty, docs/figures/*.png.

python scripts/page_figures.py
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.plotting.figures import (
    DPI,
    TravelledPath,
    draw_torques,
    new_figure,
    path_panels,
)
from cablebot_gym.task import payload_model_text
from cablebot_gym.utils.palette import BLUE, GREEN, GREY, ORANGE, VERMILLION

ENV_ID, POLICY = "CableBot-Spatial-v0", "fl"

SHOWN = {4.0: BLUE, 5.0: VERMILLION}
"""A payload that is carried, one that is not [kg], and their colours."""

SCANNED = np.linspace(0, 8, 33)
"""Payloads of the scan [kg]."""


FOLDER = Path(__file__).resolve().parents[1] / "docs" / "figures"


def write(folder: Path) -> list[Path]:
    """Writes all figures to a folder and returns their paths."""
    figures = {
        "torques": draw_torques(evaluate_dlcc(POLICY, ENV_ID, criterion="task")),
        "errors": errors(),
        "payloads": payloads(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        figure.savefig(path, dpi=DPI, metadata={"Software": None})
        paths.append(path)
    return paths


def errors() -> Figure:
    """Paths within the position bound, and errors with their bounds."""
    figure = new_figure(4.6)
    paths = []
    for payload, colour in SHOWN.items():
        episode = record_rollout(POLICY, ENV_ID, payload=payload)
        arrays = episode.arrays
        path = TravelledPath(
            times=arrays["time"],
            pose=arrays["true_pose"],
            position_error=arrays["tracking_error"],
            rotation_error=arrays["rotation_error"],
            name=f"{payload:g} kg",
            color=colour,
        )
        paths.append(path)
    path_panels(figure, episode.task.trajectory, paths, **vars(episode.task.error_bounds))
    return figure


def payloads() -> Figure:
    """Largest action and errors as fractions of their bounds, versus the payload."""
    figure = new_figure(4.6)
    for axes, known in zip(figure.subplots(1, 2, sharey=True), (True, False), strict=True):
        _scan(axes, known)
    figure.axes[0].set(ylabel="largest value, fraction of its bound")
    figure.axes[1].legend(loc="upper right")
    return figure


def _scan(axes: Axes, known: bool) -> None:
    episodes = [
        record_rollout(POLICY, ENV_ID, payload=payload, payload_known=known) for payload in SCANNED
    ]
    bounds = episodes[0].task.error_bounds
    curves = (
        ("action |a|", "commanded_action", 1.0, ORANGE),
        ("position error", "tracking_error_peak", bounds.position, BLUE),
        ("rotation error", "rotation_error_peak", bounds.rotation, GREEN),
    )
    for label, name, bound, colour in curves:
        values = []
        for episode in episodes:
            value = np.inf  # the policy failed
            if not episode.reason:
                value = np.abs(episode.arrays[name]).max() / bound
            values.append(value)
        axes.plot(SCANNED, values, color=colour, linewidth=1.6, label=label)
    for level in (0, 1):
        axes.axhline(level, color="black", linewidth=1)
    for height, criterion in ((-0.18, "paper"), (-0.42, "task")):
        feasible = evaluate_dlcc(
            POLICY, ENV_ID, criterion=criterion, payload_known=known
        ).details.feasible
        for low, high in feasible:
            axes.plot([low, high], [height, height], color=GREY, linewidth=8, solid_capstyle="butt")
        text = f"{criterion} criterion: {feasible[0][1]:.2f} kg"
        axes.annotate(
            text, (feasible[0][1], height), (6, 0), textcoords="offset points", va="center"
        )
    title = payload_model_text(known)
    axes.set(xlabel="payload [kg]", xlim=(0, SCANNED[-1]), ylim=(-0.6, 2.5), title=title)


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    write(FOLDER)
