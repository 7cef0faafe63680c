"""Motions through waypoints: a spline, or straight lines with blends; and CSV files of waypoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array, segment_distance
from cablebot_gym.motions.base import POSE_SHAPES, Motion
from cablebot_gym.utils.checks import number, numbers
from cablebot_gym.utils.csv_table import Table, column_name, read_table

SPLINE_DEGREE = 5
"""Degree of the spline of :class:`Waypoints`: the lowest with a continuous snap. Splines of higher
degrees swing more."""

SPLINE_ERROR = 1e-7
"""Largest distance of the spline from a waypoint, as a fraction of the largest coordinate, or of 1
if that is larger."""


@dataclass(frozen=True, kw_only=True)
class Waypoints(Motion):
    """A motion from rest at the first waypoint to rest at the last one; it is C⁴.

    Without ``blend`` it is a spline through the waypoints. A spline swings between them: it rounds
    corners on their outer side, see :meth:`deviation`. With ``blend`` it follows the straight lines
    between them, each at constant speed. A blend from one velocity to the next cuts each corner on
    its inner side.

    Raises:
        ValueError: if there are fewer than two waypoints, a number is not finite, the times do not
            increase from 0, or the blends overlap.
    """

    times: tuple[float, ...]
    """Times of the waypoints [s]; the first one is 0."""
    poses: tuple[tuple[float, ...], ...]
    """Poses of the waypoints, shape (k, n)."""
    blend: float = 0.0
    """Duration of the blends of the straight lines [s], at the start, at each corner and at the
    end; 0 for a spline. The duration of the motion stays: all lines together take one blend less
    time."""
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
        if self.blend:
            # Blends overlap if they last longer than the shortest line, whose time they shorten.
            shortest = float(np.diff(times).min())
            largest_blend = shortest / (1 + shortest / self.duration)
            number("blend", self.blend, above=0, below=largest_blend, unit="s")
            return
        error = np.max(np.abs(self._curve(times / self.duration) - poses))
        # also if the error is NaN
        if not error <= SPLINE_ERROR * max(1.0, float(np.max(np.abs(poses)))):
            raise ValueError(
                "no smooth curve was found: the waypoints are spaced too unevenly in time; leave some out"
            )

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.poses[0])

    @cached_property
    def passing(self) -> Array:
        """Times at which the motion is at the waypoints, or beside them in the middle of a blend,
        shape (k,) [s]."""
        return self.blend / 2 + np.array(self.times) * (1 - self.blend / self.duration)

    def deviation(self, dimensions: int) -> tuple[float, float, float]:
        """Largest distance of the position from the straight lines between the waypoints [m], its
        time [s], and the length of the longest of the three lines around it [m].

        Args:
            dimensions: number of coordinates of a position: 2 in a plane, 3 in space.
        """
        corners = np.array(self.poses)[:, :dimensions]
        times = np.linspace(0.0, self.duration, 20 * len(corners) + 1)
        # index of the line at each time; it changes in the middle of a blend
        index = np.searchsorted(self.passing[1:-1], times)
        position = self(times).position[:, :dimensions]
        # A point is a segment of length 0.
        distance = segment_distance(position, position, corners[index], corners[index + 1])
        worst = np.argmax(distance)
        near = corners[max(0, index[worst] - 1) : index[worst] + 3]
        length = np.linalg.norm(np.diff(near, axis=0), axis=1).max()
        return float(distance[worst]), float(times[worst]), float(length)

    @cached_property
    def _curve(self) -> Any:
        """The motion as a function of the fraction of the duration. Its equations are better
        conditioned than those of a function of time."""
        if self.blend:
            return self._lines()
        return self._spline()

    def _lines(self) -> Any:
        """Straight lines with blends."""
        from scipy.interpolate import BPoly  # slow to import

        fractions = self.passing / self.duration
        sides = np.array([-0.5, 0.5]) * self.blend / self.duration
        velocities = np.diff(self.poses, axis=0) / np.diff(fractions)[:, None]
        velocities = np.pad(velocities, ((1, 1), (0, 0)))  # it rests before and after
        # A blend runs from the end of a line to the start of the next one: position, velocity, and
        # zeros up to the snap at each end.
        ends = np.zeros((len(fractions), 2, 5, self.coordinates))
        ends[:, :, 1] = np.stack([velocities[:-1], velocities[1:]], axis=1)
        ends[:, :, 0] = np.array(self.poses)[:, None] + sides[:, None] * ends[:, :, 1]
        breaks = np.add.outer(fractions, sides).ravel()
        return BPoly.from_derivatives(breaks, ends.reshape(len(breaks), 5, -1))

    def _spline(self) -> Any:
        """The spline through the waypoints."""
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
        knots = np.pad(inner, SPLINE_DEGREE + 1, constant_values=(0, 1))
        return make_interp_spline(
            fractions, self.poses, SPLINE_DEGREE, t=knots, bc_type=(at_rest, at_rest)
        )

    def _derivatives(self, time: Array) -> Array:
        fraction = time / self.duration
        derivatives = np.stack(
            [self._curve(fraction, nu=order) / self.duration**order for order in range(5)]
        )
        at_end = (time <= 0) | (time >= self.duration)
        derivatives[1:, at_end] = 0.0  # exactly at rest, without rounding
        return derivatives


def is_waypoint_file(name: object) -> bool:
    """Whether the name of a motion is that of a file with waypoints."""
    return isinstance(name, str) and name.lower().endswith(".csv")


def read_waypoints(path: str | Path, kinds: Sequence[str]) -> tuple[Array | None, Array]:
    """Times and poses of the waypoints in a CSV file.

    Its columns are ``t`` [s] and the coordinates [m, rad], z down; see
    :func:`~cablebot_gym.utils.csv_table.read_table`.

    Args:
        path: the file.
        kinds: symbols of the coordinates, such as ``xyφ``, for each kind of robot that fits.

    Returns:
        Times from 0 on, shape (k,) [s], None if the file has no column ``t``; poses, shape (k, n)
        [m, rad].

    Raises:
        ValueError: if the table is invalid. The message names the line.
    """
    units = {"t": "s"}
    for symbol in "".join(kinds):
        units[column_name(symbol)] = "m" if symbol in "xyz" else "rad"
    table = read_table(path, "trajectory file", units)
    poses = _poses(table, kinds)
    for name, values in table.columns.items():
        table.refuse(name, np.isnan(values), ". A waypoint has a number in each column")
    times = table.columns.get("t")
    if times is None:
        return None, poses
    table.refuse_decrease("t", np.arange(len(times)))
    return times - times[0], poses


def _poses(table: Table, kinds: Sequence[str]) -> Array:
    """Poses of a table, shape (k, n), whose columns must be those of one of the kinds."""
    valid_headers = []
    for symbols in kinds:
        names = [column_name(symbol) for symbol in symbols]
        valid_headers.append(",".join(["t", *names]))
        if set(names) == table.columns.keys() - {"t"}:
            poses = np.stack([table.columns[name] for name in names], axis=1)
            if len(poses) < 2:
                raise ValueError(f"{table.name}: it needs at least two waypoints")
            return poses
    raise ValueError(
        f"{table.name}: its first line is '{','.join(table.columns)}'. It must be {' or '.join(valid_headers)} "
        "(t in s, lengths in m, angles in rad; without t, give a duration)"
    )
