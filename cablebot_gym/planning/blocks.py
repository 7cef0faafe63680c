"""Splines of the nonlinear program, and constraints on functions of a few numbers at one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix

from cablebot_gym.kinematics import Array


class Spline:
    """One spline of the program. Its control points are ``base + scale * z[at]`` of the variables
    z."""

    def __init__(self, knots: Array, degree: int, at: Array, base: Array, scale: Array) -> None:
        self.knots, self.degree = knots, degree
        self.at, self.base, self.scale = at, base, scale

    def rows(self, times: Array, orders: Sequence[int]) -> list[Row]:
        """Values or derivatives of the spline at the times, one row per order and coordinate."""
        rows = []
        for order in orders:
            derivatives = basis(self.knots, self.degree, times, order)
            for channel, scale in enumerate(self.scale):
                rows.append(
                    Row(
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
class Row:
    """One number at each of several instants: ``matrix @ z[at] + constant``."""

    matrix: Array
    at: Array
    constant: Array


@dataclass(frozen=True, kw_only=True)
class Block:
    """Constraints on a function of a few numbers at each of several instants."""

    function: Any
    """SX function from the numbers to the constrained values."""
    matrix: csr_matrix
    """Matrix from the variables to all numbers, one instant after the other."""
    offset: Array
    """Constant part of the numbers."""
    low: Array
    """Lower bounds at every instant, shape (instants, values)."""
    high: Array
    """Upper bounds at every instant, shape (instants, values)."""
    instants: int
    """Number of instants."""


def make_block(function: Any, rows: list[Row], low: Array, high: Array, variables: int) -> Block:
    """A block for a program with a number of variables.

    It has the numbers of one instant after the other: row k·d + i is number i at instant k.

    Args:
        function: SX function from d numbers to the constrained values.
        rows: d rows, one for each number.
        low: lower bounds of the values, shape (values,) or (instants, values).
        high: upper bounds in the same shapes.
        variables: number of variables.
    """
    d = len(rows)
    instants = len(rows[0].constant)
    indices = []
    columns = []
    values = []
    for number, row in enumerate(rows):
        k, j = np.nonzero(row.matrix)
        indices.append(k * d + number)
        columns.append(row.at[j])
        values.append(row.matrix[k, j])
    entries = np.concatenate(values), (np.concatenate(indices), np.concatenate(columns))
    matrix = csr_matrix(entries, (instants * d, variables))
    offset = np.stack([row.constant for row in rows], axis=1).ravel()
    shape = (instants, np.shape(low)[-1])
    return Block(
        function=function,
        matrix=matrix,
        offset=offset,
        low=np.broadcast_to(low, shape),
        high=np.broadcast_to(high, shape),
        instants=instants,
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
    points: Array = np.linalg.solve(basis(knots, degree, greville(knots, degree), 0), values)
    return points
