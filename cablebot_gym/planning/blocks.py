"""Splines of the nonlinear program, and constraints on functions of a few numbers at one instant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.sparse import csr_matrix

from cablebot_gym.kinematics import Array

Limits = Callable[[Any], tuple[Array, Array]]
"""Returns lower and upper bounds for the program. A function that kept the program would keep its
memory until Python looks for cycles: megabytes for each plan."""


class Spline:
    """One spline of the program. Its control points are ``base + scale * z[at]`` of the variables
    z."""

    def __init__(self, knots: Array, degree: int, at: Array, base: Array, scale: Array) -> None:
        self.knots = knots
        self.degree = degree
        self.at = at
        self.base = base
        self.scale = scale

    def rows(self, times: Array, orders: Sequence[int]) -> list[ProgramRow]:
        """Values or derivatives of the spline at the times, one row per order and coordinate."""
        rows = []
        for order in orders:
            derivatives = basis(self.knots, self.degree, times, order)
            for channel, scale in enumerate(self.scale):
                rows.append(
                    ProgramRow(
                        derivatives * scale,
                        self.at[:, channel],
                        derivatives @ self.base[:, channel],
                    )
                )
        return rows

    def control_points(self, z: Array) -> Array:
        """Control points for the variables, shape (count, channels)."""
        points: Array = self.base + self.scale * z[self.at]
        return points


@dataclass(frozen=True)
class ProgramRow:
    """One number at each of several instants: ``matrix @ z[at] + constant``."""

    matrix: Array
    at: Array
    constant: Array


@dataclass(frozen=True, kw_only=True)
class ConstraintBlock:
    """Constraints on a function of a few numbers at each of several instants."""

    times: Array
    """The instants, shape (k,) [s]."""

    function: Any
    """SX function from the numbers to the constrained values."""
    matrix: csr_matrix
    """Matrix from the variables to all numbers, one instant after the other."""
    offset: Array
    """Constant part of the numbers."""
    limits: Limits
    """Lower and upper bounds of the values, each (values,) or (k, values). They follow from the
    margins, which change between solutions."""
    values: int
    """Number of values of the function."""

    def bounds(self, program: Any) -> tuple[Array, Array]:
        """Lower and upper bounds at all instants for the program, one instant after the other."""
        shape = (len(self.times), self.values)
        low, high = (np.broadcast_to(limit, shape).ravel() for limit in self.limits(program))
        return low, high


def make_block(
    times: Array, function: Any, rows: list[ProgramRow], limits: Limits, variables: int
) -> ConstraintBlock:
    """A block for a program with a number of variables.

    It has the numbers of one instant after the other: row k·d + i is number i at instant k.

    Args:
        times: the instants, shape (k,) [s].
        function: SX function from d numbers to the constrained values.
        rows: d rows, one for each number.
        limits: lower and upper bounds of the values, see :class:`Block`.
        variables: number of variables.
    """
    d = len(rows)
    indices = []
    columns = []
    values = []
    for number, row in enumerate(rows):
        k, j = np.nonzero(row.matrix)
        indices.append(k * d + number)
        columns.append(row.at[j])
        values.append(row.matrix[k, j])
    entries = np.concatenate(values), (np.concatenate(indices), np.concatenate(columns))
    matrix = csr_matrix(entries, (len(times) * d, variables))
    offset = np.stack([row.constant for row in rows], axis=1).ravel()
    return ConstraintBlock(
        times=times,
        function=function,
        matrix=matrix,
        offset=offset,
        limits=limits,
        values=function.size1_out(0),
    )


def greville(knots: Array, degree: int) -> Array:
    """Greville points of a spline, one per control point. The values at these points determine the
    spline."""
    count = len(knots) - degree - 1
    return np.array([knots[index + 1 : index + degree + 1].mean() for index in range(count)])


def clamped_knots(duration: float, intervals: int, degree: int) -> Array:
    """Equally spaced knots, clamped at both ends."""
    return np.r_[
        np.zeros(degree), np.linspace(0.0, duration, intervals + 1), np.full(degree, duration)
    ]


def basis(knots: Array, degree: int, times: Array, order: int) -> Array:
    """Matrix from the control points to a derivative at each time, shape (times, control
    points)."""
    spline = BSpline(knots, np.eye(len(knots) - degree - 1), degree)
    if order > 0:
        spline = spline.derivative(order)
    values = spline(times)
    return np.where(np.abs(values) > 1e-12 * np.abs(values).max(), values, 0.0)


def interpolate(knots: Array, degree: int, values: Array) -> Array:
    """Control points of the spline with given values at its Greville points."""
    # Rounding puts the last of these points behind the end.
    points_at = np.minimum(greville(knots, degree), knots[-1])
    spline = make_interp_spline(points_at, values, k=degree, t=knots)
    points: Array = spline.c
    return points
