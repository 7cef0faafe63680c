"""What several training seeds carry, summed up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.runs import rank

CONFIDENCE = 0.95
"""Of intervals."""

RESAMPLES = 10_000
"""Of the bootstrap."""


def iqm(values: ArrayLike) -> Array:
    """Interquartile mean along the last axis: a quarter of the values, rounded down, is left out at either end.

    Args:
        values: (..., N).
    """
    ordered = np.sort(np.asarray(values, float), axis=-1)
    cut = ordered.shape[-1] // 4
    mean: Array = ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1)
    return mean


def iqm_interval(
    strata: Sequence[ArrayLike], *, resamples: int = RESAMPLES, confidence: float = CONFIDENCE, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval (low, high) of the interquartile mean of all values together.

    Args:
        strata: values by task, each (seeds,); values are drawn anew within each.
        resamples: how many.
        confidence: of the interval.
        seed: of the draws, which are the same with every version of numpy.
    """
    drawn = []
    for place, values in enumerate(np.asarray(stratum, float) for stratum in strata):
        # Raw bits: of these alone numpy promises that they stay the same.
        bits = np.random.Philox(np.random.SeedSequence([seed, place])).random_raw(resamples * len(values))
        index = ((bits >> np.uint64(11)) * 2.0**-53 * len(values)).astype(int)
        drawn.append(values[index.reshape(resamples, len(values))])
    ends = np.quantile(iqm(np.concatenate(drawn, axis=1)), [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(ends[0]), float(ends[1])


def typical(payloads: Mapping[int, float | None]) -> int:
    """The seed with the median payload; of two in the middle the one that carries less, of equal ones the smallest.

    Args:
        payloads: by seed [kg]; None where not even zero is carried.
    """
    ordered = sorted(payloads, key=lambda seed: (rank(payloads[seed]), seed))
    return ordered[(len(ordered) - 1) // 2]


def scores(payloads: Sequence[float | None]) -> list[float]:
    """Payloads [kg], 0 where not even zero is carried."""
    return [payload or 0.0 for payload in payloads]
