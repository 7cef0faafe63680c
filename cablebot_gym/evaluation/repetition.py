"""Comparison of episodes with their repetitions among other episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablebot_gym.evaluation.judge import Verdict
from cablebot_gym.kinematics import Array
from cablebot_gym.task import ErrorBounds

REPEAT_TOLERANCE = 1e-6
"""Largest difference between the peaks of an episode and of its repetition: as a fraction of the
bound, or of the peak if that is larger. Matrix products round differently if the rows of a batch have
another order."""


def first_difference(
    originals: Sequence[Verdict], repetitions: Sequence[Verdict], bounds: ErrorBounds
) -> str | None:
    """The first difference between episodes and their repetitions as text; None if there is none.

    Args:
        originals: outcomes of the episodes.
        repetitions: outcomes of their repetitions.
        bounds: bounds of the tracking errors.
    """
    scale = 1 / np.array([bounds.position, bounds.rotation])
    for original, repetition in zip(originals, repetitions, strict=True):
        peaks = _peaks(original, scale)
        tolerance = REPEAT_TOLERANCE * np.maximum(1.0, np.abs(peaks))
        apart = np.abs(_peaks(repetition, scale) - peaks) > tolerance
        if _end(original) == _end(repetition) and not apart.any():
            continue
        outcomes = f"{original.outcome} and then {repetition.outcome}"
        return f"at {original.payload:.3f} kg: {outcomes}, with other largest errors or actions"
    return None


def _end(verdict: Verdict) -> tuple[str, float | None] | None:
    """Kind and time of the violation; None without one."""
    if verdict.violation is None:
        return None
    return verdict.violation.kind, verdict.violation.time


def _peaks(verdict: Verdict, scale: Array) -> Array:
    """Largest errors as fractions of their bounds, then the largest |a| of each motor."""
    errors = scale * [verdict.position_peak, verdict.rotation_peak]
    return np.array([*errors, *verdict.peak_action])
