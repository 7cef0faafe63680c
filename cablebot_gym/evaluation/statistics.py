"""Confidence bounds of a success probability after a number of draws."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array


def lower_bound(successes: ArrayLike, draws: int, confidence: float) -> Array:
    """One-sided lower confidence bound of the success probability (Clopper and Pearson), shape of
    ``successes``."""
    from scipy.special import betaincinv  # slow to import

    successes = np.asarray(successes)
    at_least_one = np.maximum(successes, 1)
    quantile = betaincinv(at_least_one, draws - successes + 1, 1 - confidence)
    # The quantile is undefined without a success, and the bound is 0.
    return np.where(successes > 0, quantile, 0.0)


@cache
def mid_p_interval(successes: int, draws: int, confidence: float) -> tuple[float, float]:
    """Two-sided mid-P interval of the success probability.

    It covers the probability with about ``confidence`` on average, where that of Clopper and Pearson
    covers it at least so often.
    """
    from scipy.optimize import brentq  # slow to import
    from scipy.special import bdtr

    outside = (1 - confidence) / 2

    def excess(probability: float, count: int) -> float:
        """Probability of fewer successes and of half of the present ones, minus ``outside``."""
        fewer = 0.0
        if count > 0:
            fewer = float(bdtr(count - 1, draws, probability))
        at_most = float(bdtr(count, draws, probability))
        return (fewer + at_most) / 2 - outside

    low = 0.0
    high = 1.0
    if successes > 0:
        low = 1 - brentq(excess, 0.0, 1.0, args=(draws - successes,))
    if successes < draws:
        high = brentq(excess, 0.0, 1.0, args=(successes,))
    return low, high


def fewest_draws(probability: float, confidence: float) -> int:
    """Least number of draws that, if all succeed, give a lower bound of at least
    ``probability``."""
    return math.ceil(math.log(1 - confidence) / math.log(probability) - 1e-9)


def plausible_successes(successes: int, draws: int, repeats: int, risk: float) -> int:
    """Least plausible number of successes in ``repeats`` further draws after ``successes`` of
    ``draws``.

    The success probability is below its lower confidence bound with the probability ``risk``. If it
    is not, fewer successes have at most the probability ``risk``.
    """
    from scipy.special import bdtr  # slow to import

    least = float(lower_bound(successes, draws, 1 - risk))
    return int((bdtr(np.arange(repeats), repeats, least) < risk).sum())


def required_successes(draws: int, probability: float, confidence: float) -> tuple[int, bool]:
    """Number of draws that have to carry a payload, and whether they assure it.

    With enough draws, the number whose lower confidence bound is at least ``probability``.
    Otherwise the fraction ``probability`` of the draws, rounded up, which assures nothing.
    """
    carried = np.arange(1, draws + 1)
    enough = carried[lower_bound(carried, draws, confidence) >= probability]
    if enough.size:
        return int(enough[0]), True
    return max(1, math.ceil(draws * probability - 1e-9)), False
