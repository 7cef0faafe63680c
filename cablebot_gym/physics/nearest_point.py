"""The point of a polyhedron ``C x ≥ d`` that is nearest to a given point, and the factorisation of
a structure matrix.

The dual active-set method of Goldfarb and Idnani finds the point after finitely many steps, or a
combination of constraints that excludes every point.
"""

from __future__ import annotations

import math

import numpy as np

from cablebot_gym.physics.inlining import helper

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


@helper
def _orthogonalise(normal, basis, count, components, rest):
    """Splits a normal into components along ``count`` basis vectors and the rest; two passes for
    full precision."""
    copy_vector(normal, rest)
    components[:count] = 0.0
    for _ in range(2):
        for j in range(count):
            along = 0.0
            for l in range(len(rest)):
                along += basis[j, l] * rest[l]
            for l in range(len(rest)):
                rest[l] -= along * basis[j, l]
            components[j] += along
    square = 0.0
    for l in range(len(rest)):
        square += rest[l] * rest[l]
    return square


@helper
def _append(basis, triangle, count, components, rest, square):
    """Extends the factorisation of the active normals, normals = basisᵀ · triangle, by one
    normal."""
    length = math.sqrt(square)
    for l in range(len(rest)):
        basis[count, l] = rest[l] / length
    for j in range(count):
        triangle[j, count] = components[j]
    triangle[count, count] = length


@helper
def project(problem, tolerance):
    """Moves x to the nearest point of ``normals x ≥ limits``; returns its status and the number of
    active constraints.

    Afterwards ``x_new − x = Σ multipliers · normals`` over the active constraints. If no point
    exists, the positive multipliers of the active constraints and the next one satisfy ``Σ
    multipliers · normals = 0`` and ``Σ multipliers · limits > 0``.
    """
    normals, limits, x, active, multipliers, basis, triangle, used, components, rest, change = (
        problem
    )
    constraints, size = normals.shape
    if not math.isfinite(tolerance):
        return SINGULAR, 0
    used[:] = False
    count = 0
    for _ in range(20 * (constraints + size)):
        worst, least = -1, -tolerance
        for i in range(constraints):
            slack = -limits[i]
            for l in range(size):
                slack += normals[i, l] * x[l]
            if slack < least and not used[i]:
                worst, least = i, slack
        if worst < 0:
            return HELD, count
        active[count], multipliers[count] = worst, 0.0
        while True:
            square = _orthogonalise(normals[worst], basis, count, components, rest)
            total = 0.0
            slack = -limits[worst]
            for l in range(size):
                total += normals[worst, l] * normals[worst, l]
                slack += normals[worst, l] * x[l]
            dependent = count == size or square <= _INDEPENDENT * _INDEPENDENT * total
            step, drop = np.inf, -1
            for j in range(count - 1, -1, -1):
                rate = components[j]
                for l in range(j + 1, count):
                    rate -= triangle[j, l] * change[l]
                change[j] = rate / triangle[j, j]
            for j in range(count):
                if change[j] > 0.0 and multipliers[j] < step * change[j]:
                    step, drop = multipliers[j] / change[j], j
            if dependent and drop < 0:
                for j in range(count):
                    multipliers[j] = -change[j]
                multipliers[count] = 1.0
                return INFEASIBLE, count
            full = not dependent and -slack <= step * square
            if full:
                step = -slack / square
            for j in range(count):
                multipliers[j] = max(multipliers[j] - step * change[j], 0.0)
            multipliers[count] += step
            if not dependent:
                for l in range(size):
                    x[l] += step * rest[l]
            if full:
                _append(basis, triangle, count, components, rest, square)
                used[worst] = True
                count += 1
                break
            used[active[drop]] = False
            for j in range(drop, count):
                active[j], multipliers[j] = active[j + 1], multipliers[j + 1]
            count -= 1
            for j in range(drop, count):
                square = _orthogonalise(normals[active[j]], basis, j, components, rest)
                _append(basis, triangle, j, components, rest, square)
    return SINGULAR, 0  # only if rounding makes the method cycle


@helper
def new_problem(size, constraints):
    """Memory of :func:`project`."""
    return (
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
    return (
        np.zeros((cables, coordinates)),
        np.zeros((cables, cables)),
        np.zeros(coordinates, np.int64),
        np.zeros(max(cables, coordinates)),
        np.zeros(max(cables, coordinates)),
    )


@helper
def factorise(factors):
    """Householder QR with column pivoting of the first array, in place; returns its rank.

    The rows of the second array are the columns of Q: those from n on are the null space. A column
    counts as dependent relative to its own length, so that the units of the coordinates have no
    effect.
    """
    matrix, q, order, scale, work = factors
    rows, n = matrix.shape
    q[:] = 0.0
    for i in range(rows):
        q[i, i] = 1.0
    for j in range(n):
        order[j], scale[j] = j, 0.0
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
def solve_coordinates(factors, coefficients, direction):
    """The y with ``matrix y = coefficients``, which are orthogonal to the null space."""
    matrix, q, order, _, z = factors
    rows, n = matrix.shape
    for k in range(n - 1, -1, -1):
        z[k] = 0.0
        for i in range(rows):
            z[k] += q[k, i] * coefficients[i]
        for j in range(k + 1, n):
            z[k] -= matrix[k, j] * z[j]
        z[k] /= matrix[k, k]
        direction[order[k]] = z[k]


@helper
def set_bounds(problem, factors, u, per_unit, low, high):
    """Constraints ``low ≤ (u + N λ)·per_unit ≤ high``: row i is the lower bound of cable i, row m +
    i the upper."""
    normals, limits = problem[0], problem[1]
    matrix, q = factors[0], factors[1]
    m, n = len(low), matrix.shape[1]
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
