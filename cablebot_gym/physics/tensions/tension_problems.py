"""Compiled problems of cable tensions, batched: the work of
:mod:`cablebot_gym.physics.tensions.distribution`.

All three are one problem: the point of a polyhedron ``C x ≥ d`` that is nearest to a given point. A
QR factorisation of S gives the tensions that hold the load, ``T = T_p + N λ``, so x has r or r + 1
components. The dual active-set method of Goldfarb and Idnani finds the point after finitely many
steps, or a combination of constraints that excludes every point. Bounds count as satisfied within
1e-10 of the largest tension.
"""

from __future__ import annotations

import math

import numpy as np

from cablebot_gym.physics.compiling import entry_point, helper
from cablebot_gym.physics.tensions.nearest_point import (
    HELD,
    INFEASIBLE,
    SINGULAR,
    TOLERANCE,
    copy_negated,
    copy_vector,
    distribution_seconds,
    factorise,
    largest_magnitude,
    new_factors,
    new_problem,
    particular_solution,
    project,
    set_bounds,
)

_WRENCH_FIRST = 1e-3  # weight of tensions against a wrench error, see _approximate
_FARTHEST = 1e4  # longest step to the end of an interval in _extreme, relative to the largest value


@helper
def _approximate(problem, factors, structure, load, low, high, weights, u):
    """Tensions u within the bounds with the least wrench error ``Σ (weights e)²``, e = load + Sᵀu.

    The tensions that leave the least error are not always unique. A term ``η² Σ u²`` selects short
    ones. With η = 1e-3 of the effect of a cable it changes the wrench by about 1e-6 of the
    tensions. A smaller η makes the tensions jump where the set of cables between their bounds
    changes; a larger one makes them jump where the load becomes feasible.
    """
    matrix, x = factors.matrix, problem.x
    m, n = structure.shape
    total = 0.0
    for i in range(m):
        for j in range(n):
            weighted = weights[j] * structure[i, j]
            total += weighted * weighted
    effect = 1.0
    if total > 0.0:
        effect = math.sqrt(total / (m * n))
    eta = _WRENCH_FIRST * effect
    for i in range(m):
        for j in range(n):
            matrix[i, j] = -structure[i, j] / eta
    matrix[m:] = 0.0
    for i in range(n):
        matrix[m + i, i] = 1.0 / weights[i]
    factorise(factors)
    particular_solution(factors, load, u)
    x[:] = 0.0
    set_bounds(problem, factors, u, 1.0 / eta, low, high)
    state, _ = project(problem, TOLERANCE * (1.0 + largest_magnitude(u[:m]) / eta))
    normals = problem.normals
    for i in range(m):
        value = u[i] / eta
        for l in range(len(x)):
            value += normals[i, l] * x[l]
        u[i] = value
    return state


@helper
def _start(structure, load, low, high, reference, below, above, shifted_load):
    """Bounds and load relative to the reference tensions; returns whether each lower bound is below
    the upper."""
    m, n = structure.shape
    ordered = True
    copy_vector(load, shifted_load)
    for i in range(m):
        below[i] = low[i] - reference[i]
        above[i] = high[i] - reference[i]
        if below[i] > above[i]:
            ordered = False
            above[i] = below[i]
        for j in range(n):
            shifted_load[j] += structure[i, j] * reference[i]
    return ordered


@helper
def _within(value, low, high):
    """Value without the rounding that would exceed a bound; the lower bound takes precedence and
    replaces NaN."""
    if min(value, high) > low:
        return min(value, high)
    return low


@entry_point(seconds=distribution_seconds)
def solve_least_norm(structure, load, lower, upper, reference, tensions, status):
    """Tensions nearest to the reference, see
    :func:`~cablebot_gym.physics.tensions.distribution.least_norm`."""
    items, m, n = structure.shape
    problem = new_problem(m - n, 2 * m)
    factors = new_factors(m, n)
    u = np.zeros(m)
    below = np.zeros(m)
    above = np.zeros(m)
    shifted_load = np.zeros(n)
    normals, x = problem.normals, problem.x
    for item in range(items):
        s = structure[item]
        state = INFEASIBLE
        if _start(
            s, load[item], lower[item], upper[item], reference[item], below, above, shifted_load
        ):
            copy_negated(s, factors.matrix)
            state = SINGULAR
            if factorise(factors) == n:
                particular_solution(factors, shifted_load, u)
                set_bounds(problem, factors, u, 1.0, below, above)
                x[:] = 0.0
                state, _ = project(problem, TOLERANCE * (1.0 + largest_magnitude(u)))
                for i in range(m):
                    for l in range(m - n):
                        u[i] += normals[i, l] * x[l]
        if state != HELD:
            u[:] = 0.0
        status[item] = state
        for i in range(m):
            tensions[item, i] = _within(reference[item, i] + u[i], lower[item, i], upper[item, i])


@entry_point(seconds=distribution_seconds)
def solve_least_largest(
    structure, load, lower, upper, slope, offset, smoothing, weights, tensions, status
):
    """Tensions whose largest action is the least, see
    :func:`~cablebot_gym.physics.tensions.distribution.unchecked_least_largest_action`.
    """
    items, m, n = structure.shape
    size, root = m - n + 1, math.sqrt(smoothing)
    problem = new_problem(size, 4 * m)
    factors = new_factors(m, n)
    u = np.zeros(m + n)
    spare = new_problem(m, 2 * m)
    spare_factors = new_factors(m + n, n)
    below = np.zeros(m)
    above = np.zeros(m)
    shifted_load = np.zeros(n)
    idle = np.zeros(m)
    low = np.zeros(m)
    high = np.zeros(m)
    normals, limits, x = problem.normals, problem.limits, problem.x
    for item in range(items):
        s = structure[item]
        for i in range(m):
            idle[i] = -offset[item, i] / slope[item, i]  # the tension at zero action
        state = INFEASIBLE
        if _start(s, load[item], lower[item], upper[item], idle, below, above, shifted_load):
            for i in range(m):  # in actions, which are slope · (T − idle)
                factor = slope[item, i]
                low[i] = below[i] * factor
                high[i] = above[i] * factor
                if factor < 0.0:
                    low[i], high[i] = high[i], low[i]
                for j in range(n):
                    factors.matrix[i, j] = -s[i, j] / factor
            state = SINGULAR
            if factorise(factors) == n:
                particular_solution(factors, shifted_load, u)
                set_bounds(problem, factors, u, 1.0, low, high)
                # x = (√ε λ, t) makes the objective the distance from the origin
                for i in range(m):
                    for l in range(size - 1):
                        normals[i, l] /= root
                        normals[m + i, l] /= root
                        normals[2 * m + i, l] = -normals[i, l]
                        normals[3 * m + i, l] = normals[i, l]
                    normals[i, size - 1] = 0.0
                    normals[m + i, size - 1] = 0.0
                    normals[2 * m + i, size - 1] = 1.0
                    normals[3 * m + i, size - 1] = 1.0
                    limits[2 * m + i] = u[i]
                    limits[3 * m + i] = -u[i]
                x[:] = 0.0
                state, _ = project(problem, TOLERANCE * (1.0 + largest_magnitude(u[:m])))
                for i in range(m):
                    for l in range(size - 1):
                        u[i] += normals[i, l] * x[l]
                    u[i] /= slope[item, i]
        if state != HELD:
            _approximate(spare, spare_factors, s, shifted_load, below, above, weights[item], u)
        status[item] = state
        for i in range(m):
            tensions[item, i] = _within(idle[i] + u[i], lower[item, i], upper[item, i])


@helper
def _combine(problem, count, m, coefficients):
    """Combination of cables in the multipliers, scaled to a largest magnitude of 1; returns the
    scale."""
    active, multipliers = problem.active, problem.multipliers
    coefficients[:] = 0.0
    end_multiplier = 0.0  # of the ends of the search
    for j in range(count):
        if active[j] < m:
            coefficients[active[j]] -= multipliers[j]
        elif active[j] < 2 * m:
            coefficients[active[j] - m] += multipliers[j]
        else:
            end_multiplier = multipliers[j]
    scale = largest_magnitude(coefficients)
    if scale <= 1e-9 * end_multiplier:  # rounding
        scale = 0.0
        coefficients[:] = 0.0
    if scale > 0.0:
        for i in range(m):
            coefficients[i] /= scale
    return scale


@helper
def _extreme(problem, step, tolerance, scale, x, before):
    """Moves x, which satisfies the constraints, as far along its last axis as they permit.

    It projects a point ahead of x until x stays in place, which is so only at the end. Returns the
    number of active constraints; −1 if rounding stops it.
    """
    count = 0
    for _ in range(100):
        copy_vector(x, before)
        x[-1] += step
        state, count = project(problem, tolerance)
        if state != HELD:
            copy_vector(before, x)
            return -1
        change = 0.0
        for l in range(len(x)):
            change = max(change, abs(x[l] - before[l]))
        if change <= 1e-10 * scale + 1e-14 * abs(x[-1]):
            break
        if abs(step) < _FARTHEST * scale:
            step *= 4.0
    return count


@entry_point(seconds=distribution_seconds)
def solve_interval(structure, load, unit_load, lower, upper, ends, interval, status, coefficients):
    """Ends of the interval, see :func:`~cablebot_gym.physics.tensions.distribution.largest_scale`."""
    items, m, n = structure.shape
    size = m - n + 1  # the redundant cables and s
    problem = new_problem(size, 2 * m + 2)
    factors = new_factors(m, n)
    fixed = np.zeros(m)
    unit = np.zeros(m)
    before = np.zeros(size)
    normals, limits, x = problem.normals, problem.limits, problem.x
    for item in range(items):
        interval[item] = np.nan
        copy_negated(structure[item], factors.matrix)
        if factorise(factors) < n:
            status[item] = SINGULAR
            continue
        particular_solution(factors, load[item], fixed)
        particular_solution(factors, unit_load[item], unit)
        set_bounds(problem, factors, fixed, 1.0, lower[item], upper[item])
        largest, scale = 0.0, 0.0
        for i in range(m):
            normals[i, size - 1] = unit[i]
            normals[m + i, size - 1] = -unit[i]
        for i in range(2 * m):
            if math.isfinite(limits[i]):
                largest = max(largest, abs(normals[i, size - 1]))
                scale = max(scale, abs(limits[i]))
        # s is measured by its effect on the tensions [N]
        effect = 1.0
        if largest > 0.0:
            effect = largest
        scale = max(scale, 1.0)
        for i in range(2 * m):
            normals[i, size - 1] /= effect
        normals[2 * m :] = 0.0
        normals[2 * m, size - 1] = 1.0
        normals[2 * m + 1, size - 1] = -1.0
        limits[2 * m] = 0.0
        limits[2 * m + 1] = -ends[item] * effect
        tolerance = TOLERANCE * (1.0 + largest_magnitude(fixed))
        x[:] = 0.0
        status[item], count = project(problem, tolerance)
        if status[item] != HELD:
            _combine(problem, count + 1, m, coefficients[item])
            continue
        _extreme(problem, -100.0 * scale, tolerance, scale, x, before)
        interval[item, 0] = min(max(x[size - 1] / effect, 0.0), ends[item])
        count = _extreme(problem, 100.0 * scale, tolerance, scale, x, before)
        interval[item, 1] = min(max(x[size - 1] / effect, 0.0), ends[item])
        if _combine(problem, count, m, coefficients[item]) == 0.0 and count > 0:
            interval[item, 1] = ends[item]
