"""What a number of successes says of their probability."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import beta

from cablebot_gym.kinematics import Array


def lower_bound(successes: ArrayLike, draws: int, confidence: float) -> Array:
    """One-sided lower bound of the probability after ``successes`` out of ``draws`` (Clopper and Pearson), (...)."""
    successes = np.asarray(successes)
    with np.errstate(invalid="ignore"):  # beta is not defined for no success, whose bound is 0
        return np.where(successes > 0, beta.ppf(1 - confidence, successes, draws - successes + 1), 0.0)


def interval(successes: int, draws: int, confidence: float) -> tuple[float, float]:
    """Two-sided interval of the probability, from successes among draws (Clopper and Pearson)."""
    low = float(lower_bound(successes, draws, (1 + confidence) / 2))
    high = 1 - float(lower_bound(draws - successes, draws, (1 + confidence) / 2))
    return low, high


def fewest_draws(probability: float, confidence: float) -> int:
    """How many draws it takes, all carried, for a lower bound of at least ``probability``."""
    return math.ceil(math.log(1 - confidence) / math.log(probability) - 1e-9)


@dataclass(frozen=True, kw_only=True)
class Needed:
    """How many draws have to carry a payload."""

    share: int
    """For the payload itself: the share of the draws."""
    assured: int | None
    """For its lower bound; None if there are too few draws for any."""

    @classmethod
    def of(cls, draws: int, probability: float, confidence: float) -> Needed:
        """Numbers out of ``draws`` for a probability and a confidence; of one draw, one."""
        if draws == 1:
            return cls(share=1, assured=None)
        carried = np.arange(1, draws + 1)
        enough = carried[lower_bound(carried, draws, confidence) >= probability]
        share = max(1, math.ceil(draws * probability - 1e-9))
        return cls(share=share, assured=int(enough[0]) if enough.size else None)
