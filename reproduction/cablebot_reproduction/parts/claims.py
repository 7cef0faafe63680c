"""Claims of the text about the controller: payloads and errors with and without feedback, poles,
affine torques."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_baselines.laws.outer_loop import PAPER_GAINS
from cablebot_gym.evaluation import Comparison
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, Robot
from cablebot_reproduction.fourth_order import FourthOrder
from cablebot_reproduction.outcome import Number, Numbers, Outcome, Table
from cablebot_reproduction.profiles import limiting_violation, violation_text
from cablebot_reproduction.robots import flexible_robot, paper_circle, spatial_robot
from cablebot_reproduction.simulation import (
    CONTROL_FREQUENCY,
    FeedForward,
    Law,
    compared,
    composite,
    episode,
    largest_payload,
)

FAST = 10_000.0
"""Control frequency that resolves the poles of Eqs. 14 and 19 [Hz]."""

_OFFSET = 1e-3
"""Initial position error [m]."""

_DRAWS = 64
"""Number of draws of Table 6."""


def affinity(robot: Robot) -> float:
    """Largest ratio of the second to the first difference of τ in the mass for exact tracking; 0 if
    τ is affine."""
    motion = paper_circle(robot)(np.arange(500) / 500)
    state = (motion.position, motion.velocity, motion.acceleration)
    torques = []
    for count in (1, 2, 3):
        required = textbook.inverse_dynamics(
            robot, count * robot.mass, *state, minimum=textbook.MINIMUM_TENSION
        )
        torques.append(required.torques)
    second = torques[2] - 2 * torques[1] + torques[0]
    return float(np.abs(second).max() / np.abs(torques[1] - torques[0]).max())


def decay_error(rollout: Rollout, gains: tuple[float, float]) -> float:
    """Largest deviation from ë + K_D ė + K_P e = 0 after an initial error, as a fraction of this
    error."""
    stiffness, damping = gains
    time = rollout.arrays["time"]
    poles = np.roots([1.0, damping, stiffness])
    weights = np.linalg.solve(np.stack([np.ones(2), poles]), [1.0, 0.0])
    expected = _OFFSET * np.real(np.exp(np.outer(time, poles)) @ weights)
    actual = rollout.arrays["pose"][:, 0] - rollout.arrays["reference_pose"][:, 0]
    return float(np.abs(actual - expected).max() / _OFFSET)


def claims() -> Outcome:
    """Payloads, errors, poles and affinity."""
    numbers: Numbers = {}
    rows: list[tuple[Number, ...]] = []
    for kind, robot in (("planar", PLANAR), ("spatial", spatial_robot())):
        rows += _payload_rows(kind, robot, numbers)
        laws: dict[str, Law] = {"closed": FeedbackLinearization, "open": FeedForward}
        errors = compared(laws, robot, payload=robot.mass / 10, uncertainty="table6", draws=_DRAWS)
        numbers[f"closed_loop_{kind}_error_mm"] = _mean_error_mm(errors, 0)
        numbers[f"open_loop_{kind}_error_mm"] = _mean_error_mm(errors, 1)
        gains = PAPER_GAINS[kind]
        dwell: Any = find_trajectory({"name": f"dwell-{kind}", "duration": 0.5}, robot.coordinates)
        for prefix, frequency in (("", FAST), ("sampled_", CONTROL_FREQUENCY)):
            loop = episode(
                FeedbackLinearization,
                robot,
                trajectory=dwell,
                initial_error=(_OFFSET,) + (0.0,) * (robot.coordinates - 1),
                control_frequency=frequency,
            )
            numbers[f"{prefix}pole_error_{kind}"] = decay_error(loop, gains)
        stiffness, damping = gains
        poles = [f"{pole:.2f}" for pole in np.roots([1.0, damping, stiffness])]
        numbers[f"poles_{kind}"] = ", ".join(poles).replace("j", "i")
        numbers[f"affine_{kind}"] = affinity(robot)
    flexible_laws: dict[str, Law] = {"fl4": FourthOrder, "composite": composite}
    for name, uncertainty, draws in (("nominal", None, None), ("table6", "table6", _DRAWS)):
        errors = compared(
            flexible_laws, flexible_robot(), payload=1.0, uncertainty=uncertainty, draws=draws
        )
        for index, law in enumerate(flexible_laws):
            numbers[f"flex_{law}_error_{name}_mm"] = _mean_error_mm(errors, index)
    table = Table(
        title="Payloads with feedback, without feedback, and with feedback and unknown payload",
        header=("robot", "law", "payload known", "criterion", "payload [kg]", "limiting violation"),
        rows=rows,
    )
    return Outcome(numbers=numbers, tables=(table,))


def _payload_rows(kind: str, robot: Robot, numbers: Numbers) -> list[tuple[Number, ...]]:
    """Rows of the table of payloads; adds the payloads to the numbers."""
    rows: list[tuple[Number, ...]] = []
    loops: dict[str, tuple[str, Law, dict[str, Any]]] = {
        "closed_loop": ("fl", FeedbackLinearization, {}),
        "payload_unknown": ("fl", FeedbackLinearization, {"payload_known": False}),
        "open_loop": ("open loop", FeedForward, {}),
    }
    for criterion, suffix in (("task", ""), ("paper", "_paper")):
        for number, (name, law, options) in loops.items():
            result = largest_payload(law, robot, criterion=criterion, **options)
            numbers[f"{number}_{kind}{suffix}_kg"] = result.payload
            violation = violation_text(limiting_violation(result))
            rows.append((kind, name, not options, criterion, result.payload, violation))
    return rows


def _mean_error_mm(comparison: Comparison, index: int) -> float:
    """Mean position error over time and draws [mm]."""
    return 1e3 * comparison.metrics[index].estimate("mean_error").mean
