"""Boards of simulated policies: how often intervals cover the mean, and orders are false."""

from __future__ import annotations

import numpy as np

from cablebot_gym.benchmark.ranking import better_policies, fraction

FAMILIES = {
    "1 − exponential(0.1)": lambda random, size: 1 - random.exponential(0.1, size).clip(0, 0.95),
    "beta(20, 5), fails on 2 % of the motions": lambda random, size: _failing(random, size, 0.02),
}
"""Distributions of the fractions of one policy over the motions."""

TRUTH = 2_000_000
"""Number of motions of the true mean of fractions."""

FEWER_MOTIONS = 20
"""Number of motions of half of the policies of a board."""


def _failing(random, size, rate):
    return np.where(random.random(size) < rate, 0.0, random.beta(20, 5, size))


def coverage(draw, motions, boards):
    """Fractions of boards whose interval covers the true mean, lies below and lies above it.

    ``draw`` returns fractions of independent motions from a random generator and their number.
    """
    random = np.random.default_rng(1)
    truth = draw(random, TRUTH).mean()
    below = above = 0
    for _ in range(boards):
        interval = fraction(draw(random, motions))
        below += interval.high < truth
        above += interval.low > truth
    return 1 - (below + above) / boards, below / boards, above / boards


def false_boards(policies, motions, rate, boards, fewer):
    """Fraction of boards of equal policies with at least one order; if ``fewer``, the second half
    of the policies has run :data:`FEWER_MOTIONS` only."""
    random = np.random.default_rng(2)
    false = 0
    for _ in range(boards):
        difficulty = random.beta(6, 2, motions)
        values = (difficulty + random.normal(0, 0.03, (policies, motions))).clip(0, 1)
        values[random.random(values.shape) < rate] = 0.0
        if fewer:
            values[policies // 2 :, FEWER_MOTIONS:] = np.nan
        false += better_policies(values).any()
    return false / boards
