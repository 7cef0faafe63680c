"""Curves as polynomials of pieces of equal duration, evaluated for a whole batch at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """Curves over time. The pieces of all curves have the same degree and the same size."""

    coefficients: Array
    """Coefficients of the powers of the fraction of a piece, (pieces, degree + 1, size)."""
    durations: Array
    """Duration of each curve, (curves,) [s]."""
    counts: Array
    """Number of its pieces, (curves,)."""

    @classmethod
    def of_spline(cls, knots: Array, points: Array, degree: int) -> Pieces:
        """The curve of a spline with equally spaced knots, clamped at both ends, and control points
        (count, size)."""
        from scipy.interpolate import BSpline  # slow to import

        spline = BSpline(knots, points, degree)
        starts = knots[degree : -degree - 1]
        width = knots[-1] / len(starts)
        series = []
        for power in range(degree + 1):
            series.append(spline(starts, nu=power) * width**power / math.factorial(power))
        return cls(
            coefficients=np.stack(series, axis=1),
            durations=knots[-1:],
            counts=np.array([len(starts)]),
        )

    @classmethod
    def of_samples(cls, samples: Array, duration: float) -> Pieces:
        """Straight lines between samples at equal distances in time, (count + 1, size)."""
        return cls(
            coefficients=np.stack([samples[:-1], np.diff(samples, axis=0)], axis=1),
            durations=np.array([duration]),
            counts=np.array([len(samples) - 1]),
        )

    @classmethod
    def joined(cls, curves: Sequence[Pieces]) -> Pieces:
        """The curves of several."""
        return cls(
            coefficients=np.concatenate([each.coefficients for each in curves]),
            durations=np.concatenate([each.durations for each in curves]),
            counts=np.concatenate([each.counts for each in curves]),
        )

    def __call__(self, curve: int | NDArray[np.int64], times: Array, orders: int) -> Array:
        """Value and derivatives below an order, shape (orders, ..., size). A curve rests after its end.

        Args:
            curve: index of the curve, shape (...) or one for all.
            times: times since the start, shape (...) [s].
            orders: number of derivatives, with the value.
        """
        degree = self.coefficients.shape[1] - 1
        first = np.cumsum(self.counts) - self.counts
        count = self.counts[curve]
        duration = self.durations[curve]
        position = np.clip(times, 0.0, duration) * (count / duration)
        piece = np.minimum(position.astype(np.int64), count - 1)
        powers = np.vander((position - piece).reshape(-1), degree + 1, increasing=True)
        factors = np.zeros((len(powers), orders, degree + 1))
        for order in range(min(orders, degree + 1)):
            for power in range(order, degree + 1):
                factors[:, order, power] = math.perm(power, order) * powers[:, power - order]
        values = factors @ self.coefficients[(first[curve] + piece).reshape(-1)]
        shape = (*position.shape, values.shape[-1])
        results: Array = np.moveaxis(values, 1, 0).reshape(orders, *shape)
        rate = np.where(times > duration, 0.0, count / duration)
        for order in range(1, orders):
            results[order] *= (rate**order)[..., None]
        return results
