"""Intervals of mean fractions over motions, and simultaneous comparisons of policies.

Motions are the random sample: they are drawn from a family, and all policies run the same ones.
``tests/benchmark/simulated_boards.py`` simulates how often intervals cover and orders are false.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.evaluation.statistics import mid_p_interval
from cablebot_gym.kinematics import Array

CONFIDENCE = 0.95
"""Confidence of the intervals, and of all orders of a board together."""

RANKED_MOTIONS = 20
"""Least number of motions for ranks. Fewer do not tell policies apart."""


@dataclass(frozen=True, kw_only=True)
class Fraction:
    """Fractions of the optimum over one motion or several."""

    mean: float
    """Mean over the motions."""
    low: float
    """Lower end of the interval of the mean."""
    high: float
    """Upper end of the interval."""
    worst: float
    """Minimum over the motions."""


def fraction(fractions: Array) -> Fraction:
    """Mean fraction and its interval.

    Args:
        fractions: fractions of the motions, ≥ 0.
    """
    low, high = _interval(fractions)
    return Fraction(mean=float(fractions.mean()), low=low, high=high, worst=float(fractions.min()))


def _interval(fractions: Array) -> tuple[float, float]:
    """Interval of the mean of fractions.

    A failure is a fraction of 0. A policy that fails on a rare motion may show none on the board,
    and the spread of its fractions then says nothing about it. The interval therefore combines the
    mid-P interval of the success rate with Student's interval of the mean of the successes, as
    logarithms of their product (Zou and Donner 2008).
    """
    from scipy.stats import t  # slow to import

    motions = len(fractions)
    if motions == 1:
        only = float(fractions[0])
        return only, only
    successes = fractions[fractions > 0]
    count = len(successes)
    rate_low, rate_high = mid_p_interval(count, motions, CONFIDENCE)
    if count < 2:
        return 0.0, rate_high  # nothing is known about the spread of the successes
    rate = count / motions
    mean = float(successes.mean())
    spread = float(successes.std(ddof=1))
    half_width = float(t.ppf((1 + CONFIDENCE) / 2, count - 1)) * spread / math.sqrt(count)
    mean_low = max(mean - half_width, 1e-9)
    below = math.hypot(math.log(rate / rate_low), math.log(mean / mean_low))
    above = math.hypot(math.log(rate_high / rate), math.log(1 + half_width / mean))
    product = rate * mean
    return product * math.exp(-below), product * math.exp(above)


def ranks(fractions: Mapping[str, Array]) -> dict[str, int]:
    """Ranks of policies, in the order of decreasing mean fractions.

    The rank of a policy is 1 plus the number of better policies. All comparisons of a
    board are right together with :data:`CONFIDENCE`. A policy with a larger mean never has a larger
    rank: where the comparisons alone would give it one, it gets that of the policy below it.

    Args:
        fractions: fractions of the same motions by policy, each (motions,); NaN for the motions
            that a policy has not run.
    """
    names = sorted(fractions, key=lambda name: (-np.nanmean(fractions[name]), name))
    if not names:
        return {}
    values = np.stack([fractions[name] for name in names])
    better = better_policies(values)
    policy_ranks: dict[str, int] = {}
    least = len(names)
    # From the last row up, so that a rank is at most that of the row below.
    for index in reversed(range(len(names))):
        least = min(least, 1 + int(better[:, index].sum()))
        policy_ranks[names[index]] = least
    return {name: policy_ranks[name] for name in names}


def better_policies(values: Array) -> NDArray[np.bool_]:
    """Whether policy i is better than policy j, shape (p, p), simultaneously for all pairs.

    A pair is compared by Student's t-test of the differences on the motions that both have run, at
    least two, and all pairs by the step-down procedure of Holm (1979).

    Args:
        values: fractions, (p, motions); NaN for the motions that a policy has not run.
    """
    from scipy.special import stdtr  # slow to import

    policies = len(values)
    first, second = np.triu_indices(policies, 1)
    difference = values[first] - values[second]
    motions = np.isfinite(difference).sum(axis=1)
    mean = np.nanmean(difference, axis=1)
    error = np.nanstd(difference, axis=1, ddof=1) / np.sqrt(motions)
    # A constant difference has no standard error, up to rounding: its order is certain.
    statistic = np.abs(mean) / np.maximum(error, 1e-12)
    statistic[np.abs(mean) < 1e-9] = 0.0
    probability = 2 * stdtr(motions - 1, -statistic)
    order = np.argsort(probability, kind="stable")
    pairs = len(order)
    allowed = (1 - CONFIDENCE) / (pairs - np.arange(pairs))
    is_apart = probability[order] <= allowed
    is_ordered = np.zeros(pairs, np.bool_)
    # Holm stops at the first pair that is not apart.
    is_ordered[order] = np.logical_and.accumulate(is_apart)
    better = np.zeros((policies, policies), np.bool_)
    better[first, second] = is_ordered & (mean > 0)
    better[second, first] = is_ordered & (mean < 0)
    return better
