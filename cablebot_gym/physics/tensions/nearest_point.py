"""The point of a polyhedron ``C x ≥ d`` that is nearest to a given point, and the factorisation of
a structure matrix.

The dual active-set method of Goldfarb and Idnani finds the point after finitely many steps, or a
combination of constraints that excludes every point.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from cablebot_gym.physics.compiling import helper

HELD, INFEASIBLE, SINGULAR = 0, 1, 2
"""Status of an item: tensions within the bounds hold the load; none do; S has a rank below n."""

TOLERANCE = 1e-10  # of constraints, relative to 1 + the largest value
_INDEPENDENT = 1e-10  # least distance of a normal or column from the span of the others, relative to its length


@helper
def copy_vector(source, target):
    """Copies a vector; a slice would make numba compile its error message, which takes seconds."""
    for i in range(len(source)):
        target[i] = source[i]


@helper
def copy_negated(source, target):
    """Copies minus a matrix, as :func:`copy_vector`."""
    for i in range(len(source)):
        for j in range(source.shape[1]):
            target[i, j] = -source[i, j]


class Problem(NamedTuple):
    """Memory of :func:`project`."""

    normals: Any
    """C, shape (constraints, size)."""
    limits: Any
    """d, shape (constraints,)."""
    x: Any
    """The point, shape (size,)."""
    active: Any
    """Active constraints in the order of their activation, shape (size + 1,)."""
    multipliers: Any
    """Multipliers of the active constraints, shape (size + 1,)."""
    basis: Any
    """Orthonormal basis of the normals of the active constraints, as rows, shape (size, size)."""
    triangle: Any
    """Components of these normals along the basis, as columns, shape (size, size)."""
    used: Any
    """Whether each constraint is active, shape (constraints,)."""
    components: Any
    """Components of the normal of the next constraint along the basis, shape (size,)."""
    remainder: Any
    """The part of this normal that is orthogonal to the basis, shape (size,)."""
    change: Any
    """Decrease of the multipliers per step, shape (size,)."""


class Factors(NamedTuple):
    """Memory of :func:`factorise`."""

    matrix: Any
    """The matrix, then R, shape (rows, n)."""
    q: Any
    """Qᵀ, shape (rows, rows)."""
    order: Any
    """Column of the matrix in each column of R, shape (n,)."""
    scale: Any
    """Squared length of each column, shape (max(rows, n),)."""
    work: Any
    """Memory for intermediate results, shape (max(rows, n),)."""


@helper
def _orthogonalise(problem, normal, count):
    """Splits a normal into components along ``count`` basis vectors and the remainder; two passes
    for full precision. Returns the squared length of the remainder."""
    basis, components, remainder = problem.basis, problem.components, problem.remainder
    copy_vector(normal, remainder)
    components[:count] = 0.0
    for _ in range(2):
        for j in range(count):
            along = 0.0
            for l in range(len(remainder)):
                along += basis[j, l] * remainder[l]
            for l in range(len(remainder)):
                remainder[l] -= along * basis[j, l]
            components[j] += along
    square = 0.0
    for l in range(len(remainder)):
        square += remainder[l] * remainder[l]
    return square


@helper
def _append(problem, count, square):
    """Extends the factorisation of the active normals, normals = basisᵀ · triangle, by one
    normal."""
    length = math.sqrt(square)
    for l in range(len(problem.remainder)):
        problem.basis[count, l] = problem.remainder[l] / length
    for j in range(count):
        problem.triangle[j, count] = problem.components[j]
    problem.triangle[count, count] = length


@helper
def _slack(problem, constraint):
    """By how much x satisfies a constraint."""
    slack = -problem.limits[constraint]
    for l in range(len(problem.x)):
        slack += problem.normals[constraint, l] * problem.x[l]
    return slack


@helper
def _most_violated(problem, tolerance):
    """The inactive constraint that x violates most; −1 if none by more than the tolerance."""
    worst, least = -1, -tolerance
    for i in range(len(problem.limits)):
        slack = _slack(problem, i)
        if slack < least and not problem.used[i]:
            worst, least = i, slack
    return worst


@helper
def _multiplier_rates(problem, count):
    """Decrease of the active multipliers per step along the remainder of a normal, by back
    substitution."""
    change = problem.change
    for j in range(count - 1, -1, -1):
        rate = problem.components[j]
        for l in range(j + 1, count):
            rate -= problem.triangle[j, l] * change[l]
        change[j] = rate / problem.triangle[j, j]


@helper
def _drop(problem, position, count):
    """Removes an active constraint and factorises the later ones again; returns the new count."""
    active, multipliers = problem.active, problem.multipliers
    problem.used[active[position]] = False
    for j in range(position, count):
        active[j] = active[j + 1]
        multipliers[j] = multipliers[j + 1]
    for j in range(position, count - 1):
        square = _orthogonalise(problem, problem.normals[active[j]], j)
        _append(problem, j, square)
    return count - 1


@helper
def project(problem, tolerance):
    """Moves x to the nearest point of ``normals x ≥ limits``; returns its status and the number of
    active constraints.

    Afterwards ``x_new − x = Σ multipliers · normals`` over the active constraints. If no point
    exists, the positive multipliers of the active constraints and the next one satisfy ``Σ
    multipliers · normals = 0`` and ``Σ multipliers · limits > 0``.
    """
    if not math.isfinite(tolerance):
        return SINGULAR, 0
    problem.used[:] = False
    count = 0
    for _ in range(20 * (len(problem.limits) + len(problem.x))):
        worst = _most_violated(problem, tolerance)
        if worst < 0:
            return HELD, count
        feasible, count = _activate(problem, worst, count)
        if not feasible:
            return INFEASIBLE, count
    return SINGULAR, 0  # only if rounding makes the method cycle


@helper
def _activate(problem, worst, count):
    """Moves x until it satisfies a violated constraint, which becomes active; drops constraints
    whose multiplier becomes zero on the way.

    Returns whether that is possible, and the number of active constraints.
    """
    x, multipliers, change = problem.x, problem.multipliers, problem.change
    problem.active[count] = worst
    multipliers[count] = 0.0
    while True:
        square = _orthogonalise(problem, problem.normals[worst], count)
        total = 0.0
        for l in range(len(x)):
            total += problem.normals[worst, l] * problem.normals[worst, l]
        slack = _slack(problem, worst)
        dependent = count == len(x) or square <= _INDEPENDENT * _INDEPENDENT * total
        _multiplier_rates(problem, count)
        step, dropped = np.inf, -1
        for j in range(count):
            if change[j] > 0.0 and multipliers[j] < step * change[j]:
                step, dropped = multipliers[j] / change[j], j
        if dependent and dropped < 0:
            for j in range(count):
                multipliers[j] = -change[j]
            multipliers[count] = 1.0
            return False, count
        full = not dependent and -slack <= step * square
        if full:
            step = -slack / square
        for j in range(count):
            multipliers[j] = max(multipliers[j] - step * change[j], 0.0)
        multipliers[count] += step
        if not dependent:
            for l in range(len(x)):
                x[l] += step * problem.remainder[l]
        if full:
            _append(problem, count, square)
            problem.used[worst] = True
            return True, count + 1
        count = _drop(problem, dropped, count)


@helper
def new_problem(size, constraints):
    """Memory of :func:`project`."""
    return Problem(
        np.zeros((constraints, size)),
        np.zeros(constraints),
        np.zeros(size),
        np.zeros(size + 1, np.int64),
        np.zeros(size + 1),
        np.zeros((size, size)),
        np.zeros((size, size)),
        np.zeros(constraints, np.bool_),
        np.zeros(size),
        np.zeros(size),
        np.zeros(size),
    )


@helper
def new_factors(cables, coordinates):
    """Memory of :func:`factorise`."""
    return Factors(
        np.zeros((cables, coordinates)),
        np.zeros((cables, cables)),
        np.zeros(coordinates, np.int64),
        np.zeros(max(cables, coordinates)),
        np.zeros(max(cables, coordinates)),
    )


@helper
def factorise(factors):
    """Householder QR with column pivoting of the matrix, in place; returns its rank.

    The rows of ``q`` are the columns of Q: those from n on are the null space. A column
    counts as dependent relative to its own length, so that the units of the coordinates have no
    effect.
    """
    matrix, q, order, scale, work = factors
    rows, n = matrix.shape
    q[:] = 0.0
    for i in range(rows):
        q[i, i] = 1.0
    for j in range(n):
        order[j] = j
        scale[j] = 0.0
        for i in range(rows):
            scale[j] += matrix[i, j] * matrix[i, j]
    for k in range(n):
        best, largest, square = -1, _INDEPENDENT * _INDEPENDENT, 0.0
        for j in range(k, n):
            total = 0.0
            for i in range(k, rows):
                total += matrix[i, j] * matrix[i, j]
            if total > largest * scale[j]:
                best, largest, square = j, total / scale[j], total
        if best < 0:
            return k
        order[k], order[best] = order[best], order[k]
        scale[k], scale[best] = scale[best], scale[k]
        for i in range(rows):
            matrix[i, k], matrix[i, best] = matrix[i, best], matrix[i, k]
        length = math.sqrt(square)
        diagonal = -length if matrix[k, k] > 0 else length
        factor = 1.0 / (length * (length + abs(matrix[k, k])))
        matrix[k, k] -= diagonal  # the reflector lies in the column for a moment
        for j in range(k + 1, n):
            along = 0.0
            for i in range(k, rows):
                along += matrix[i, k] * matrix[i, j]
            for i in range(k, rows):
                matrix[i, j] -= factor * along * matrix[i, k]
        work[:rows] = 0.0
        for i in range(k, rows):
            for j in range(rows):
                work[j] += matrix[i, k] * q[i, j]
        for i in range(k, rows):
            for j in range(rows):
                q[i, j] -= factor * matrix[i, k] * work[j]
        matrix[k, k] = diagonal
    return n


@helper
def particular_solution(factors, load, u):
    """Shortest u with ``matrixᵀ u = load``."""
    matrix, q, order, _, z = factors
    rows, n = matrix.shape
    u[:rows] = 0.0
    for k in range(n):
        z[k] = load[order[k]]
        for j in range(k):
            z[k] -= matrix[j, k] * z[j]
        z[k] /= matrix[k, k]
        for i in range(rows):
            u[i] += z[k] * q[k, i]


@helper
def set_bounds(problem, factors, u, per_unit, low, high):
    """Constraints ``low ≤ (u + N λ)·per_unit ≤ high``: row i is the lower bound of cable i, row m +
    i the upper."""
    normals, limits, q = problem.normals, problem.limits, factors.q
    m, n = len(low), factors.matrix.shape[1]
    for i in range(m):
        for l in range(len(q) - n):
            normals[i, l] = q[n + l, i] * per_unit
            normals[m + i, l] = -normals[i, l]
        limits[i] = low[i] - u[i] * per_unit
        limits[m + i] = u[i] * per_unit - high[i]


@helper
def largest_magnitude(values):
    """Largest magnitude; NaN if any value is NaN."""
    largest = 0.0
    for value in values:
        if not abs(value) <= largest:
            largest = abs(value)
            if math.isnan(largest):
                return largest
    return largest


def distribution_seconds(structure, *_):
    """Estimated time of Python for the tensions of all items [s]."""
    return 5e-5 * structure.size
