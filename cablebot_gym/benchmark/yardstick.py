"""Yardstick under uncertainty: the fraction of the payload of the nominal robot that a planner reaches
on 95 % of the random robots, because it knows each of them.

Policies do not know the random robot, so they can hope for this fraction at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from cablebot_gym.benchmark.ranking import CONFIDENCE
from cablebot_gym.benchmark.rows import Row
from cablebot_gym.evaluation.batch import draw_seeds
from cablebot_gym.evaluation.survey import motion_seeds

PROBABILITY = 0.05
"""Fraction of the draws below the yardstick."""

FEWEST = 72
"""Least number of random robots of all motions: the interval of the quantile has a lower end above 0.
The ratios of one motion are hardly correlated."""


@dataclass(frozen=True, kw_only=True)
class Yardstick:
    """The 5 % quantile of the ratios of drawn to nominal payloads."""

    quantile: float
    """Quantile of the draws with a payload."""
    low: float
    """Lower end of its interval. Draws without a payload count as 0."""
    high: float
    """Upper end of its interval. Draws without a payload are left out."""
    mean: float
    """Mean ratio."""
    draws: int
    """Number of draws with a payload."""
    missing: int
    """Number of draws without a payload."""


def yardstick(ratios: Sequence[float | None]) -> Yardstick:
    """The yardstick of the ratios of independent draws of motions and robots.

    The interval has order statistics as its ends, so it covers the quantile of any distribution with
    a probability of at least 95 %. A normal distribution would give half its width, but covers only
    40 to 80 % where the ratios are skewed or some motions are hard.

    Args:
        ratios: ratio of each draw; None where there is no payload.

    Raises:
        ValueError: if no draw has a ratio.
    """
    found = np.sort([ratio for ratio in ratios if ratio is not None])
    missing = len(ratios) - len(found)
    if not len(found):
        raise ValueError("the yardstick needs at least one draw with a payload")
    pessimistic = np.concatenate([np.zeros(missing), found])
    lower_rank, _ = _ranks(len(pessimistic))
    _, upper_rank = _ranks(len(found))
    low = 0.0
    if lower_rank > 0:
        low = float(pessimistic[lower_rank - 1])
    return Yardstick(
        quantile=float(np.quantile(found, PROBABILITY, method="median_unbiased")),
        low=low,
        high=float(found[min(upper_rank, len(found)) - 1]),
        mean=float(found.mean()),
        draws=len(found),
        missing=missing,
    )


def _ranks(count: int) -> tuple[int, int]:
    """Ranks of the ends of the interval among sorted ratios, from 1. A rank of 0 or above ``count``
    means that there is no such ratio."""
    from scipy.stats import binom  # slow to import

    # The number of ratios below the quantile is binomial.
    lower = int(binom.ppf((1 - CONFIDENCE) / 2, count, PROBABILITY))
    upper = int(binom.ppf((1 + CONFIDENCE) / 2, count, PROBABILITY))
    return lower, upper + 1


def drawn_rows(optima: Sequence[Row], uncertainty: str, seed: int) -> list[Row]:
    """The rows of the yardstick: the first random robots that policies meet on each motion.

    Args:
        optima: rows of the optima of the motions.
        uncertainty: name of the uncertainty.
        seed: evaluation seed, from which the seeds of all robots follow as in a survey.
    """
    draws = ceil(FEWEST / len(optima))
    rows = []
    for row, motion_seed in zip(optima, motion_seeds(seed, len(optima)), strict=True):
        for draw_seed in draw_seeds(motion_seed, draws):
            conditions = replace(row.conditions, uncertainty=uncertainty, seed=draw_seed)
            rows.append(Row(measure="drawn", conditions=conditions))
    return rows


def yardsticks(rows: Sequence[Row]) -> dict[tuple[str, str], Yardstick]:
    """The yardsticks by environment id and name of the uncertainty.

    Motions without an optimum are left out, as in the tables. A failed computation
    counts as a draw without a payload, and there is no yardstick where all draws are.

    Args:
        rows: those of :func:`drawn_rows` and of the optima; others have no effect.
    """
    counted = set()
    for row in rows:
        if row.measure == "optimum" and row.result.get("payload"):
            counted.add(row.motion_key)
    ratios: dict[tuple[str, str], list[float | None]] = {}
    for row in rows:
        if row.measure == "drawn" and row.motion_key in counted:
            key = row.conditions.env_id, row.conditions.uncertainty
            ratios.setdefault(key, []).append(row.result.get("ratio"))
    by_environment = {}
    for key, group in ratios.items():
        if any(ratio is not None for ratio in group):
            by_environment[key] = yardstick(group)
    return by_environment
