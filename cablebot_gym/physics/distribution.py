"""Cable tensions that hold a load within bounds, for any number of cables, batched and compiled.

m cables hold the load w on n ≤ m coordinates if ``−Sᵀ T = w``. The r = m − n redundant cables leave a choice::

    least_norm             the tensions nearest to reference tensions
    least_largest_action   the tensions whose largest motor action is the least
    feasible               whether some tensions within the bounds hold the load, and if not, why
    largest_scale          the interval of s for which they hold ``w₀ + s w₁``, e.g. the payload

For example, the least tensions of eight cables on six coordinates, each at least 100 N::

    found = least_norm(structure, load, 100.0, 5000.0)
    found.tensions, found.status == HELD, found.missing

All arrays broadcast: structure (..., m, n), load (..., n), values of cables (..., m) or one number. Bounds may be
infinite. With ``m == n`` the tensions are the unique solution.

All four are one problem: the point of a polyhedron ``C x ≥ d`` that is nearest to a given point. A QR factorisation
of S gives the tensions that hold the load, ``T = T_p + N λ``, so x has r or r + 1 components. The dual active-set
method of Goldfarb and Idnani finds the point after finitely many steps, or a combination of constraints that excludes
every point. Bounds count as satisfied within 1e-10 of the largest tension.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics.inlining import compiled_when_frequent, helper
from cablebot_gym.utils.checks import all_finite

HELD, INFEASIBLE, SINGULAR = 0, 1, 2
"""Status of an item: tensions within the bounds hold the load; none do; S has a rank below n."""

SMOOTHING = 1e-2
"""Default weight ε of the sum of the squared actions in :func:`least_largest_action`."""

_TOLERANCE = 1e-10  # of constraints, relative to 1 + the largest value
_INDEPENDENT = 1e-10  # least distance of a normal or column from the span of the others, relative to its length
_WRENCH_FIRST = 1e-3  # weight of tensions against a wrench error, see _approximate
_FARTHEST = 1e4  # longest step to the end of an interval in _extreme, relative to the largest value


# ----------------------------------------------------------------------------------------- the nearest point


@helper
def _copy(source, target):
    """Copies a vector; a slice would make numba compile its error message, which takes seconds."""
    for i in range(len(source)):
        target[i] = source[i]


@helper
def _negate(source, target):
    """Copies minus a matrix, as :func:`_copy`."""
    for i in range(len(source)):
        for j in range(source.shape[1]):
            target[i, j] = -source[i, j]


@helper
def _orthogonalise(normal, basis, count, components, rest):
    """Splits a normal into components along ``count`` basis vectors and the rest; two passes for full precision."""
    _copy(normal, rest)
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
    """Extends the factorisation of the active normals, normals = basisᵀ · triangle, by one normal."""
    length = math.sqrt(square)
    for l in range(len(rest)):
        basis[count, l] = rest[l] / length
    for j in range(count):
        triangle[j, count] = components[j]
    triangle[count, count] = length


@helper
def _project(problem, tolerance):
    """Moves x to the nearest point of ``normals x ≥ limits``; returns its status and the number of active constraints.

    Afterwards ``x_new − x = Σ multipliers · normals`` over the active constraints. If no point exists, the positive
    multipliers of the active constraints and the next one satisfy ``Σ multipliers · normals = 0`` and
    ``Σ multipliers · limits > 0``.
    """
    normals, limits, x, active, multipliers, basis, triangle, used, components, rest, change = problem
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
def _new_problem(size, constraints):
    """Memory of :func:`_project`."""
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


# ---------------------------------------------------------------------------------------- tensions that hold the load


@helper
def _new_factors(cables, coordinates):
    """Memory of :func:`_factor`."""
    return (
        np.zeros((cables, coordinates)),
        np.zeros((cables, cables)),
        np.zeros(coordinates, np.int64),
        np.zeros(max(cables, coordinates)),
        np.zeros(max(cables, coordinates)),
    )


@helper
def _factor(factors):
    """Householder QR with column pivoting of the first array, in place; returns its rank.

    The rows of the second array are the columns of Q: those from n on are the null space. A column counts as dependent
    relative to its own length, so that the units of the coordinates have no effect.
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
def _particular(factors, load, u):
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
def _coordinates_of(factors, coefficients, direction):
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
def _bound(problem, factors, u, per_unit, low, high):
    """Constraints ``low ≤ (u + N λ)·per_unit ≤ high``: row i is the lower bound of cable i, row m + i the upper."""
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
def _largest(values):
    """Largest magnitude; NaN if any value is NaN."""
    largest = 0.0
    for value in values:
        if not abs(value) <= largest:
            largest = abs(value)
            if math.isnan(largest):
                return largest
    return largest


@helper
def _approximate(problem, factors, structure, load, low, high, weights, u):
    """Tensions u within the bounds with the least wrench error ``Σ (weights e)²``, e = load + Sᵀu.

    The tensions that leave the least error are not always unique. A term ``η² Σ u²`` selects short ones. With η = 1e-3
    of the effect of a cable it changes the wrench by about 1e-6 of the tensions. A smaller η makes the tensions jump
    where the set of cables between their bounds changes; a larger one makes them jump where the load becomes feasible.
    """
    matrix, x = factors[0], problem[2]
    m, n = structure.shape
    total = 0.0
    for i in range(m):
        for j in range(n):
            weighted = weights[j] * structure[i, j]
            total += weighted * weighted
    eta = _WRENCH_FIRST * (math.sqrt(total / (m * n)) if total > 0.0 else 1.0)
    for i in range(m):
        for j in range(n):
            matrix[i, j] = -structure[i, j] / eta
    for i in range(n):
        for j in range(n):
            matrix[m + i, j] = 1.0 / weights[j] if i == j else 0.0
    _factor(factors)
    _particular(factors, load, u)
    x[:] = 0.0
    _bound(problem, factors, u, 1.0 / eta, low, high)
    state, _ = _project(problem, _TOLERANCE * (1.0 + _largest(u[:m]) / eta))
    normals = problem[0]
    for i in range(m):
        value = u[i] / eta
        for l in range(len(x)):
            value += normals[i, l] * x[l]
        u[i] = value
    return state


@helper
def _start(structure, load, low, high, reference, below, above, rest):
    """Bounds and load relative to the reference tensions; returns whether each lower bound is below the upper."""
    m, n = structure.shape
    ordered = True
    for j in range(n):
        rest[j] = load[j]
    for i in range(m):
        below[i], above[i] = low[i] - reference[i], high[i] - reference[i]
        if below[i] > above[i]:
            ordered, above[i] = False, below[i]
        for j in range(n):
            rest[j] += structure[i, j] * reference[i]
    return ordered


@helper
def _within(value, low, high):
    """Value without the rounding that would exceed a bound; the lower bound takes precedence and replaces NaN."""
    return min(value, high) if min(value, high) > low else low


@compiled_when_frequent
def _least_norm(structure, load, lower, upper, reference, weights, tensions, status):
    items, m, n = structure.shape
    problem, factors, u = _new_problem(m - n, 2 * m), _new_factors(m, n), np.zeros(m + n)
    spare, spare_factors = _new_problem(m, 2 * m), _new_factors(m + n, n)
    below, above, rest = np.zeros(m), np.zeros(m), np.zeros(n)
    normals, x = problem[0], problem[2]
    for item in range(items):
        s = structure[item]
        state = INFEASIBLE
        if _start(s, load[item], lower[item], upper[item], reference[item], below, above, rest):
            _negate(s, factors[0])
            state = SINGULAR
            if _factor(factors) == n:
                _particular(factors, rest, u)
                _bound(problem, factors, u, 1.0, below, above)
                x[:] = 0.0
                state, _ = _project(problem, _TOLERANCE * (1.0 + _largest(u[:m])))
                for i in range(m):
                    for l in range(m - n):
                        u[i] += normals[i, l] * x[l]
        if state != HELD:
            _approximate(spare, spare_factors, s, rest, below, above, weights[item], u)
        status[item] = state
        for i in range(m):
            tensions[item, i] = _within(reference[item, i] + u[i], lower[item, i], upper[item, i])


@compiled_when_frequent
def _least_largest(structure, load, lower, upper, slope, offset, smoothing, weights, tensions, status):
    items, m, n = structure.shape
    size, root = m - n + 1, math.sqrt(smoothing)
    problem, factors, u = _new_problem(size, 4 * m), _new_factors(m, n), np.zeros(m + n)
    spare, spare_factors = _new_problem(m, 2 * m), _new_factors(m + n, n)
    below, above, rest, idle = np.zeros(m), np.zeros(m), np.zeros(n), np.zeros(m)
    low, high = np.zeros(m), np.zeros(m)
    normals, limits, x = problem[0], problem[1], problem[2]
    for item in range(items):
        s = structure[item]
        for i in range(m):
            idle[i] = -offset[item, i] / slope[item, i]  # the tension at zero action
        state = INFEASIBLE
        if _start(s, load[item], lower[item], upper[item], idle, below, above, rest):
            for i in range(m):  # in actions, which are slope · (T − idle)
                factor = slope[item, i]
                low[i], high[i] = below[i] * factor, above[i] * factor
                if factor < 0.0:
                    low[i], high[i] = high[i], low[i]
                for j in range(n):
                    factors[0][i, j] = -s[i, j] / factor
            state = SINGULAR
            if _factor(factors) == n:
                _particular(factors, rest, u)
                _bound(problem, factors, u, 1.0, low, high)
                # x = (√ε λ, t) makes the objective the distance from the origin
                for i in range(m):
                    for l in range(size - 1):
                        normals[i, l] /= root
                        normals[m + i, l] /= root
                        normals[2 * m + i, l] = -normals[i, l]
                        normals[3 * m + i, l] = normals[i, l]
                    normals[i, size - 1] = normals[m + i, size - 1] = 0.0
                    normals[2 * m + i, size - 1] = normals[3 * m + i, size - 1] = 1.0
                    limits[2 * m + i], limits[3 * m + i] = u[i], -u[i]
                x[:] = 0.0
                state, _ = _project(problem, _TOLERANCE * (1.0 + _largest(u[:m])))
                for i in range(m):
                    for l in range(size - 1):
                        u[i] += normals[i, l] * x[l]
                    u[i] /= slope[item, i]
        if state != HELD:
            _approximate(spare, spare_factors, s, rest, below, above, weights[item], u)
        status[item] = state
        for i in range(m):
            tensions[item, i] = _within(idle[i] + u[i], lower[item, i], upper[item, i])


@helper
def _combine(problem, count, m, coefficients):
    """Combination of cables in the multipliers, scaled to a largest magnitude of 1; returns the scale."""
    active, multipliers = problem[3], problem[4]
    coefficients[:] = 0.0
    other = 0.0
    for j in range(count):
        if active[j] < m:
            coefficients[active[j]] -= multipliers[j]
        elif active[j] < 2 * m:
            coefficients[active[j] - m] += multipliers[j]
        else:
            other = multipliers[j]
    scale = _largest(coefficients)
    if scale <= 1e-9 * other:  # rounding
        scale = 0.0
        coefficients[:] = 0.0
    if scale > 0.0:
        for i in range(m):
            coefficients[i] /= scale
    return scale


@helper
def _unreachable(factors, rank, load, direction):
    """Direction of coordinates on which no cable acts, largest component 1, along which the load is the largest."""
    matrix, order, z = factors[0], factors[2], factors[4]
    n, best = matrix.shape[1], -1.0
    for free in range(rank, n):
        z[:n] = 0.0
        z[free] = 1.0
        for k in range(rank - 1, -1, -1):
            for j in range(k + 1, rank):
                z[k] -= matrix[k, j] * z[j]
            z[k] = (z[k] - matrix[k, free]) / matrix[k, k]
        along, scale = 0.0, _largest(z[:n])
        for k in range(n):
            along += z[k] * load[order[k]]
        if abs(along) / scale > best:
            best = abs(along) / scale
            for k in range(n):
                direction[order[k]] = math.copysign(z[k] / scale, z[k] * along)
    return max(best, 0.0)


@compiled_when_frequent
def _feasible(structure, load, lower, upper, reference, status, excess, direction, coefficients):
    items, m, n = structure.shape
    problem, factors, u = _new_problem(m - n, 2 * m), _new_factors(m, n), np.zeros(m)
    below, above, rest = np.zeros(m), np.zeros(m), np.zeros(n)
    limits, x, active, multipliers = problem[1], problem[2], problem[3], problem[4]
    for item in range(items):
        if not _start(structure[item], load[item], lower[item], upper[item], reference[item], below, above, rest):
            status[item] = INFEASIBLE
            for i in range(m):
                excess[item] = max(excess[item], lower[item, i] - upper[item, i])
            continue
        _negate(structure[item], factors[0])
        rank = _factor(factors)
        if rank < n:
            status[item] = SINGULAR
            excess[item] = _unreachable(factors, rank, load[item], direction[item])
            continue
        _particular(factors, rest, u)
        _bound(problem, factors, u, 1.0, below, above)
        x[:] = 0.0
        status[item], count = _project(problem, _TOLERANCE * (1.0 + _largest(u)))
        if status[item] == INFEASIBLE:
            scale = _combine(problem, count + 1, m, coefficients[item])
            for j in range(count + 1):
                excess[item] += multipliers[j] * limits[active[j]] / scale
            _coordinates_of(factors, coefficients[item], direction[item])


@helper
def _extreme(problem, step, tolerance, scale, x, before):
    """Moves x, which satisfies the constraints, as far along its last axis as they permit.

    It projects a point ahead of x until x stays in place, which is so only at the end. Returns the number of active
    constraints; −1 if rounding stops it.
    """
    count = 0
    for _ in range(100):
        _copy(x, before)
        x[-1] += step
        state, count = _project(problem, tolerance)
        if state != HELD:
            _copy(before, x)
            return -1
        change = 0.0
        for l in range(len(x)):
            change = max(change, abs(x[l] - before[l]))
        if change <= 1e-10 * scale + 1e-14 * abs(x[-1]):
            break
        if abs(step) < _FARTHEST * scale:
            step *= 4.0
    return count


@compiled_when_frequent
def _interval(structure, load, unit_load, lower, upper, unit_lower, unit_upper, ends, found, status, coefficients):
    items, m, n = structure.shape
    size = m - n + 1
    problem, factors = _new_problem(size, 2 * m + 2), _new_factors(m, n)
    fixed, unit, before = np.zeros(m), np.zeros(m), np.zeros(size)
    normals, limits, x = problem[0], problem[1], problem[2]
    for item in range(items):
        found[item, 0] = found[item, 1] = np.nan
        _negate(structure[item], factors[0])
        if _factor(factors) < n:
            status[item] = SINGULAR
            continue
        _particular(factors, load[item], fixed)
        _particular(factors, unit_load[item], unit)
        _bound(problem, factors, fixed, 1.0, lower[item], upper[item])
        largest, scale = 0.0, 0.0
        for i in range(m):
            normals[i, size - 1] = unit[i] - unit_lower[item, i]
            normals[m + i, size - 1] = unit_upper[item, i] - unit[i]
        for i in range(2 * m):
            if math.isfinite(limits[i]):
                largest, scale = max(largest, abs(normals[i, size - 1])), max(scale, abs(limits[i]))
        # s is measured by its effect on the tensions [N]
        effect = largest if largest > 0.0 else 1.0
        scale = max(scale, 1.0)
        for i in range(2 * m):
            normals[i, size - 1] /= effect
        normals[2 * m :] = 0.0
        normals[2 * m, size - 1], normals[2 * m + 1, size - 1] = 1.0, -1.0
        limits[2 * m], limits[2 * m + 1] = ends[item, 0] * effect, -ends[item, 1] * effect
        tolerance = _TOLERANCE * (1.0 + _largest(fixed))
        x[:] = 0.0
        x[size - 1] = limits[2 * m]
        status[item], count = _project(problem, tolerance)
        if status[item] != HELD:
            _combine(problem, count + 1, m, coefficients[item])
            continue
        _extreme(problem, -100.0 * scale, tolerance, scale, x, before)
        found[item, 0] = min(max(x[size - 1] / effect, ends[item, 0]), ends[item, 1])
        count = _extreme(problem, 100.0 * scale, tolerance, scale, x, before)
        found[item, 1] = min(max(x[size - 1] / effect, ends[item, 0]), ends[item, 1])
        if _combine(problem, count, m, coefficients[item]) == 0.0 and count > 0:
            found[item, 1] = ends[item, 1]


# ------------------------------------------------------------------------------------------------ public functions


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution:
    """Tensions for a load."""

    tensions: Array
    """Tensions T within the bounds, shape (..., m) [N]."""
    status: Array
    """:data:`HELD`, :data:`INFEASIBLE` or :data:`SINGULAR`, shape (...)."""
    missing: Array
    """Part of the load that the tensions do not hold, ``w + Sᵀ T``, shape (..., n) [N, N·m]; zero if held."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Feasibility:
    """Whether tensions within the bounds hold a load, with a proof if none do.

    With y the ``direction`` and g the ``coefficients``, all tensions that hold the load satisfy ``g·T = y·w``. The
    largest ``g·T`` within the bounds is less by ``excess``. At most r + 1 cables have a coefficient. With ``m == n`` it
    is one: the cable needs ``y·w`` but has ``y·w − excess``.
    """

    status: Array
    """:data:`HELD`, :data:`INFEASIBLE` or :data:`SINGULAR`, shape (...)."""
    excess: Array
    """Amount by which the load exceeds the bounds along ``direction``, shape (...) [N]; 0 if held.

    If S is singular: the load along ``direction`` [N or N·m], where no cable acts, which may be 0.
    If a lower bound is above the upper bound: the largest difference, and ``direction`` is 0.
    """
    direction: Array
    """Direction y of the load, shape (..., n): [1, 1/m] so that ``y·w`` is a tension; 0 if held."""
    coefficients: Array
    """g = −S y, largest magnitude 1, shape (..., m); 0 if held. A positive one: the upper bound of this cable limits;
    a negative one: its lower bound."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScaleInterval:
    """Interval of the scales s for which tensions within the bounds hold a load; one interval, by convexity."""

    least: Array
    """Lower end, shape (...); NaN if the interval is empty or S is singular."""
    largest: Array
    """Upper end, shape (...); NaN as above."""
    status: Array
    """:data:`HELD`, :data:`INFEASIBLE` (the interval is empty) or :data:`SINGULAR`, shape (...)."""
    coefficients: Array
    """Cables that limit s at the upper end, as in :class:`Feasibility`, shape (..., m). All are 0 if only the
    end of the search does. If the interval is empty: cables that exclude every s."""


def least_norm(
    structure: ArrayLike,
    load: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike = np.inf,
    reference: ArrayLike | None = None,
    *,
    weights: ArrayLike = 1.0,
) -> Distribution:
    """Tensions T that minimise ``Σ (T_i − reference_i)²`` with ``−Sᵀ T = w`` and ``lower ≤ T ≤ upper``.

    If none hold the load, the tensions within the bounds leave the least wrench error ``Σ (weights_j missing_j)²``,
    plus a small multiple of the objective above. It makes them unique and changes the wrench by about 1e-6 of the
    tensions. A lower bound above the upper bound takes precedence.

    T is continuous in S, w and the bounds where S has full rank and some tensions strictly within the bounds hold w: it
    is the projection on a polyhedron that changes continuously there. It is also continuous among infeasible loads, as
    the solution of a strictly convex problem, but fast where the set of cables between their bounds changes. Where a
    load becomes infeasible, T changes by about 1e-6 of its size, and more only if the cables between their bounds are
    nearly dependent.

    Args:
        structure: S, shape (..., m, n), m ≥ n.
        load: w, shape (..., n) [N, N·m].
        lower: lower bounds, shape (..., m) [N].
        upper: upper bounds, shape (..., m) [N].
        reference: reference tensions, shape (..., m) [N]; None: the lower bounds where finite, else 0.
        weights: weights of the coordinates if the load is infeasible, shape (..., n); > 0. For moments, one over a
            length [1/m].

    Raises:
        ValueError: if the shapes do not match, or a number is not finite. A bound may be infinite.
    """
    _check_problem(structure, load, lower, upper)
    shape, matrices, loads, (low, high) = _arrays(structure, load, lower, upper)
    if reference is not None:
        all_finite("reference", reference)
    all_finite("weights", weights)
    start = _finite(low) if reference is None else _values(reference, shape, low.shape[1])
    tensions, status = np.empty_like(low), np.empty(len(low), np.int64)
    _least_norm(matrices, loads, low, high, start, _values(weights, shape, loads.shape[1]), tensions, status)
    return _distribution(shape, matrices, loads, tensions, status)


def least_largest_action(
    structure: ArrayLike,
    load: ArrayLike,
    lower: ArrayLike,
    slope: ArrayLike,
    offset: ArrayLike,
    upper: ArrayLike = np.inf,
    *,
    smoothing: float = SMOOTHING,
    weights: ArrayLike = 1.0,
) -> Distribution:
    """Tensions T with the least largest action ``max |a_i|``, ``a_i = slope_i T_i + offset_i``, that hold the load.

    The exact minimum jumps: along a smooth motion a change of the cables with the largest action moves the solution at
    once from one end of an edge to the other, and a rule that chooses among several solutions, such as lexicographic
    order, cannot prevent it. For example, ``T₁ + δ T₂ = 1`` with a = T and T ≥ −1 has the only solution T₂ ≈ 1 for
    small δ > 0, and T₂ ≈ −1 for δ < 0. So T minimises ``t² + ε Σ a_i²`` with ``|a_i| ≤ t`` and ε = ``smoothing``. This
    problem is strictly convex. Therefore T is unique, and it is Lipschitz continuous in S, w, the bounds, slope and
    offset where S has full rank and some tensions strictly within the bounds hold w. It crosses the edge while the
    relevant multiplier is of the order of ε.

    With t* the exact least largest action, ``t ≤ t* √((1 + ε m)/(1 + ε))``, i.e. at most 3.4 % more for eight cables
    and the default: T* has ``t*² + ε Σ a_i² ≤ t*² (1 + ε m)``, and T has at least ``t² (1 + ε)``. Away from these
    changes the largest action is exact. A smaller ε is closer to t* and faster at a change.

    If no tensions hold the load, the result is as in :func:`least_norm`, with the tensions at zero action as reference.

    Args:
        structure: S, shape (..., m, n), m ≥ n.
        load: w, shape (..., n) [N, N·m].
        lower: lower bounds, shape (..., m) [N].
        slope: action per tension, shape (..., m) [1/N]; any but 0.
        offset: action at zero tension, shape (..., m).
        upper: upper bounds, shape (..., m) [N].
        smoothing: ε; at least 1e-9.
        weights: as in :func:`least_norm`.

    Raises:
        ValueError: if the shapes do not match, a number is not finite, or ``smoothing`` is too small. A bound may be
            infinite.
    """
    if not 1e-9 <= smoothing < math.inf:
        raise ValueError(f"smoothing is {smoothing}; it must be finite and at least 1e-9")
    for name, values in (("slope", slope), ("offset", offset), ("weights", weights)):
        all_finite(name, values)
    _check_problem(structure, load, lower, upper)
    return unchecked_least_largest_action(
        structure, load, lower, slope, offset, upper, smoothing=smoothing, weights=weights
    )


def unchecked_least_largest_action(
    structure: ArrayLike,
    load: ArrayLike,
    lower: ArrayLike,
    slope: ArrayLike,
    offset: ArrayLike,
    upper: ArrayLike = np.inf,
    *,
    smoothing: float = SMOOTHING,
    weights: ArrayLike = 1.0,
) -> Distribution:
    """As :func:`least_largest_action`, for laws, whose numbers are finite: the checks would take a tenth of the time.

    If S is not finite, as in a pose where a cable has no length, the status is :data:`SINGULAR`.
    """
    shape, matrices, loads, (low, high, slopes, offsets) = _arrays(structure, load, lower, upper, slope, offset)
    tensions, status = np.empty_like(low), np.empty(len(low), np.int64)
    per = _values(weights, shape, loads.shape[1])
    _least_largest(matrices, loads, low, high, slopes, offsets, float(smoothing), per, tensions, status)
    return _distribution(shape, matrices, loads, tensions, status)


def feasible(structure: ArrayLike, load: ArrayLike, lower: ArrayLike, upper: ArrayLike = np.inf) -> Feasibility:
    """Whether some tensions within the bounds hold the load, exactly, and a proof if none do.

    Bounds may be exceeded by 1e-10 of the largest tension. The arguments are as in :func:`least_norm`.

    Raises:
        ValueError: if the shapes do not match, or a number is not finite. A bound may be infinite.
    """
    _check_problem(structure, load, lower, upper)
    shape, matrices, loads, (low, high) = _arrays(structure, load, lower, upper)
    items, m, n = matrices.shape
    status, excess = np.zeros(items, np.int64), np.zeros(items)
    direction, coefficients = np.zeros((items, n)), np.zeros((items, m))
    _feasible(matrices, loads, low, high, _finite(low), status, excess, direction, coefficients)
    return Feasibility(
        status=status.reshape(shape),
        excess=excess.reshape(shape),
        direction=direction.reshape(*shape, n),
        coefficients=coefficients.reshape(*shape, m),
    )


def largest_scale(
    structure: ArrayLike,
    load: ArrayLike,
    unit_load: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    largest: ArrayLike,
    *,
    least: ArrayLike = 0.0,
    unit_lower: ArrayLike = 0.0,
    unit_upper: ArrayLike = 0.0,
) -> ScaleInterval:
    """Interval of s in [least, largest] for which tensions within the bounds hold ``w₀ + s w₁``, exactly.

    The bounds may depend on s: ``lower + s unit_lower ≤ T ≤ upper + s unit_upper``. With w₁ the load of 1 kg, s is the
    payload or the mass.

    Args:
        structure: S, shape (..., m, n), m ≥ n.
        load: w₀, shape (..., n) [N, N·m].
        unit_load: w₁, shape (..., n).
        lower: lower bounds at s = 0, shape (..., m) [N].
        upper: upper bounds at s = 0, shape (..., m) [N].
        largest: upper end of the search, shape (...); finite.
        least: lower end of the search, shape (...); finite.
        unit_lower: change of the lower bounds per s, shape (..., m); finite.
        unit_upper: change of the upper bounds per s, shape (..., m); finite.

    Raises:
        ValueError: if the shapes do not match, a number is not finite, or the search is unbounded or empty. A bound may
            be infinite.
    """
    for name, values in (("unit_load", unit_load), ("unit_lower", unit_lower), ("unit_upper", unit_upper)):
        all_finite(name, values)
    _check_problem(structure, load, lower, upper)
    ends = np.stack(np.broadcast_arrays(np.asarray(least, float), np.asarray(largest, float)), axis=-1)
    if not (np.all(np.isfinite(ends)) and np.all(ends[..., 0] <= ends[..., 1])):
        raise ValueError("the search needs finite ends with least <= largest")
    batch = np.shape(unit_load)[:-1], ends.shape[:-1]
    shape, matrices, loads, (low, high, unit_low, unit_high) = _arrays(
        structure, load, lower, upper, unit_lower, unit_upper, batch=batch
    )
    items, m, n = matrices.shape
    found, status, coefficients = np.empty((items, 2)), np.zeros(items, np.int64), np.zeros((items, m))
    units, search = _values(unit_load, shape, n), _values(ends, shape, 2)
    _interval(matrices, loads, units, low, high, unit_low, unit_high, search, found, status, coefficients)
    return ScaleInterval(
        least=found[:, 0].reshape(shape),
        largest=found[:, 1].reshape(shape),
        status=status.reshape(shape),
        coefficients=coefficients.reshape(*shape, m),
    )


def _finite(lower: Array) -> Array:
    """The default reference: the lower bounds where finite, else 0."""
    return np.where(np.isfinite(lower), lower, 0.0)


def _values(values: ArrayLike, shape: tuple[int, ...], last: int) -> Array:
    """Values as a contiguous array of shape (items, last)."""
    array = np.empty((*shape, last))
    array[...] = values
    return array.reshape(-1, last)


def _check_problem(structure: ArrayLike, load: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> None:
    """Checks that S and w are finite, and that no bound is NaN or excludes every tension."""
    all_finite("structure (NaN for a cable without length)", structure)
    all_finite("load", load)
    # A lower bound of +inf or an upper bound of −inf excludes every tension; comparisons with NaN are false.
    if not np.all(np.less(lower, np.inf)) or not np.all(np.greater(upper, -np.inf)):
        raise ValueError("bounds of tensions must be numbers, with lower below inf and upper above -inf")


def _arrays(
    structure: ArrayLike, load: ArrayLike, *cables: ArrayLike, batch: tuple[tuple[int, ...], ...] = ()
) -> tuple[tuple[int, ...], Array, Array, list[Array]]:
    """Leading shape, then the arrays with one leading axis: S, w and the values of cables."""
    matrices, vectors = np.asarray(structure, float), np.asarray(load, float)
    m, n = matrices.shape[-2:]
    if m < n or vectors.shape[-1:] != (n,):
        raise ValueError(
            f"structure {matrices.shape} and load {vectors.shape} do not match: use (..., m, n) and (..., n), m >= n"
        )
    shape = np.broadcast_shapes(matrices.shape[:-2], vectors.shape[:-1], *(np.shape(c)[:-1] for c in cables), *batch)
    matrices = _values(matrices, (*shape, m), n).reshape(-1, m, n)
    return shape, matrices, _values(vectors, shape, n), [_values(c, shape, m) for c in cables]


def _distribution(
    shape: tuple[int, ...], structure: Array, load: Array, tensions: Array, status: Array
) -> Distribution:
    missing = load + (tensions[:, None, :] @ structure)[:, 0]
    return Distribution(
        tensions=tensions.reshape(*shape, tensions.shape[1]),
        status=status.reshape(shape),
        missing=missing.reshape(*shape, load.shape[1]),
    )
