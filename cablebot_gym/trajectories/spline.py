"""A spline through waypoints."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.trajectories.base import POSE_SHAPES, Motion
from cablebot_gym.utils.checks import numbers

SPLINE_DEGREE = 5
"""Degree of the spline of :class:`Waypoints`: the least one with a continuous snap, which swings
the least."""

SPLINE_ERROR = 1e-7
"""Largest distance of the spline from a waypoint, as a fraction of the largest coordinate or of
1."""


@dataclass(frozen=True, kw_only=True)
class Waypoints(Motion):
    """A spline through waypoints, from rest at the first one to rest at the last one; the motion is
    C⁴.

    Between waypoints the spline may swing, the more the less evenly they are spaced.

    Raises:
        ValueError: if there are fewer than two waypoints, a number is not finite, or the times do
            not increase from 0.
    """

    times: tuple[float, ...]
    """Times of the waypoints [s]; the first one is 0."""
    poses: tuple[tuple[float, ...], ...]
    """Poses of the waypoints, shape (k, n)."""
    name: str = "waypoints"
    """Name shown in tables and error messages."""
    duration: float = dataclasses.field(init=False)
    """Time of the last waypoint [s]."""
    _POSES = ()

    def __post_init__(self) -> None:
        times = numbers("times", self.times)
        if times.ndim != 1 or len(times) < 2 or times[0] != 0 or np.any(np.diff(times) <= 0):
            raise ValueError("times must be at least two numbers that increase from 0")
        shapes = [(len(times), *shape) for shape in POSE_SHAPES]
        poses = numbers("poses", self.poses, shapes=shapes, form="one pose per time")
        object.__setattr__(self, "times", tuple(times.tolist()))
        object.__setattr__(self, "poses", tuple(map(tuple, poses.tolist())))
        object.__setattr__(self, "duration", float(times[-1]))
        super().__post_init__()
        missed = np.max(np.abs(self._spline(times / self.duration) - poses))
        if not missed <= SPLINE_ERROR * max(1.0, float(np.max(np.abs(poses)))):
            raise ValueError(
                "no smooth curve was found: the waypoints are spaced too unevenly in time; leave some out"
            )

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.poses[0])

    @cached_property
    def _spline(self) -> Any:
        """The spline over the fraction of the duration, of which equations are better conditioned
        than over time."""
        from scipy.interpolate import make_interp_spline  # slow to import

        at_rest: Any = [(order, np.zeros(self.coordinates)) for order in range(1, 5)]
        fractions = np.array(self.times) / self.duration
        # The spline has a knot at each waypoint. Rest at both ends takes four more, two near each
        # end.
        inner = fractions[1:-1]
        if len(inner):
            thirds = np.array([1.0, 2.0]) / 3
            inner = np.concatenate([inner[0] * thirds, inner, inner[-1] + (1 - inner[-1]) * thirds])
        else:
            inner = np.linspace(0.0, 1.0, 6)[1:-1]
        # A clamped spline repeats the knots at both ends once more than its degree.
        ends = np.ones(SPLINE_DEGREE + 1)
        knots = np.concatenate([0 * ends, inner, ends])
        return make_interp_spline(
            fractions, self.poses, SPLINE_DEGREE, t=knots, bc_type=(at_rest, at_rest)
        )

    def _derivatives(self, time: Array) -> Array:
        fraction = time / self.duration
        derivatives = np.stack(
            [self._spline(fraction, nu=order) / self.duration**order for order in range(5)]
        )
        at_end = (time <= 0) | (time >= self.duration)
        derivatives[1:, at_end] = 0.0  # exactly at rest, without rounding
        return derivatives
