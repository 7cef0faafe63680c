"""Confidence bounds of a success probability after a number of draws."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array


def lower_bound(successes: ArrayLike, draws: int, confidence: float) -> Array:
    """One-sided lower confidence bound of the success probability (Clopper and Pearson), shape of ``successes``."""
    from scipy.special import betaincinv  # slow to import

    successes = np.asarray(successes)
    # The quantile is undefined without a success, and the bound is 0.
    return np.where(successes > 0, betaincinv(np.maximum(successes, 1), draws - successes + 1, 1 - confidence), 0.0)


def interval(successes: int, draws: int, confidence: float) -> tuple[float, float]:
    """Two-sided confidence interval of the success probability (Clopper and Pearson)."""
    low = float(lower_bound(successes, draws, (1 + confidence) / 2))
    high = 1 - float(lower_bound(draws - successes, draws, (1 + confidence) / 2))
    return low, high


def fewest_draws(probability: float, confidence: float) -> int:
    """Least number of draws that, if all succeed, give a lower bound of at least ``probability``."""
    return math.ceil(math.log(1 - confidence) / math.log(probability) - 1e-9)


@dataclass(frozen=True, kw_only=True)
class RequiredDraws:
    """Required numbers of draws that carry a payload."""

    fraction: int
    """Required number for the payload: the fraction ``probability`` of the draws, rounded up."""
    assured: int | None
    """Required number for the assured payload; None if there are too few draws."""

    @classmethod
    def of(cls, draws: int, probability: float, confidence: float) -> RequiredDraws:
        """Required numbers out of ``draws`` for a probability and a confidence. A single draw has to carry."""
        if draws == 1:
            return cls(fraction=1, assured=None)
        carried = np.arange(1, draws + 1)
        enough = carried[lower_bound(carried, draws, confidence) >= probability]
        fraction = max(1, math.ceil(draws * probability - 1e-9))
        return cls(fraction=fraction, assured=int(enough[0]) if enough.size else None)
