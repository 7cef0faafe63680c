"""Statistics of payloads over training seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import trim_mean

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.runs import rank

CONFIDENCE = 0.95
"""Confidence level of intervals."""

RESAMPLES = 10_000
"""Number of bootstrap resamples."""


def iqm(values: ArrayLike) -> Array:
    """Interquartile mean along the last axis: it omits a quarter of the values, rounded down, at
    either end."""
    mean: Array = trim_mean(np.asarray(values, float), 0.25, axis=-1)
    return mean


def iqm_interval(values: ArrayLike, *, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Percentile bootstrap interval (low, high) of the interquartile mean.

    Args:
        values: values, (seeds,).
        confidence: confidence level.
    """
    values = np.asarray(values, float)
    # NumPy guarantees reproducibility across versions for raw bits only.
    bits = np.random.Philox(np.random.SeedSequence([0, 0])).random_raw(RESAMPLES * len(values))
    index = ((bits >> np.uint64(11)) * 2.0**-53 * len(values)).astype(int)
    resampled = values[index.reshape(RESAMPLES, len(values))]
    ends = np.quantile(iqm(resampled), [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(ends[0]), float(ends[1])


def median_seed(payloads: Mapping[int, float | None]) -> int:
    """The seed with the median payload, for an even number the lower median; ties go to the
    smallest seed.

    Args:
        payloads: payload of each seed [kg]; None if the policy fails unloaded.
    """
    ordered = sorted(payloads, key=lambda seed: (rank(payloads[seed]), seed))
    return ordered[(len(ordered) - 1) // 2]


def scores(payloads: Sequence[float | None]) -> list[float]:
    """Payloads [kg] with 0 for None (fails unloaded)."""
    return [payload or 0.0 for payload in payloads]
