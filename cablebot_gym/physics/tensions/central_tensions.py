"""Compiled tensions in the interior of their bounds, batched: the work of
:func:`cablebot_gym.physics.tensions.distribution.unchecked_central`.

A QR factorisation of S gives the tensions that hold the load; Newton's method with a line search
finds among them the least of a strictly convex function.
"""

from __future__ import annotations

import math

import numpy as np

from cablebot_gym.physics.compiling import entry_point, helper
from cablebot_gym.physics.tensions.nearest_point import (
    distribution_seconds,
    factorise,
    new_factors,
    particular_solution,
)

RELAXED = 0.1
"""Distance from a bound below which a parabola continues the barrier, per barrier parameter."""

_ITERATIONS = 60
"""Largest number of steps. Near the end, the error of a step is about the square of the last."""

_LAST = 1e-12
"""Squared Newton decrement of the last step."""

_SHORTEST = 1e-9
"""Shortest part of a step; a shorter one only rounds."""


@helper
def _barrier(distance, relaxed):
    """−log of a distance and its first two derivatives, continued by a parabola below
    ``relaxed``."""
    if distance > relaxed:
        inverse = 1.0 / distance
        return -math.log(distance), -inverse, inverse * inverse
    beyond = distance / relaxed - 2.0
    value = 0.5 * (beyond * beyond - 1.0) - math.log(relaxed)
    return value, beyond / relaxed, 1.0 / (relaxed * relaxed)


@helper
def _value(actions, lows, barrier):
    """The function of :func:`~cablebot_gym.physics.tensions.distribution.unchecked_central` at some actions."""
    total = 0.0
    for i in range(len(actions)):
        below, _, _ = _barrier(actions[i] - lows[i], RELAXED * barrier)
        above, _, _ = _barrier(1.0 - actions[i], RELAXED * barrier)
        total += 0.5 * actions[i] * actions[i] + barrier * (below + above)
    return total


@helper
def _derivatives(actions, lows, barrier, null, gradient, hessian):
    """Gradient and Hessian of :func:`_value` along the rows of ``null``, a basis of the null
    space."""
    size = len(gradient)
    gradient[:] = 0.0
    hessian[:] = 0.0
    for i in range(len(actions)):
        _, below, below_curve = _barrier(actions[i] - lows[i], RELAXED * barrier)
        _, above, above_curve = _barrier(1.0 - actions[i], RELAXED * barrier)
        slope = actions[i] + barrier * (below - above)
        curve = 1.0 + barrier * (below_curve + above_curve)
        for j in range(size):
            gradient[j] += null[j, i] * slope
            for k in range(j + 1):
                hessian[j, k] += null[j, i] * null[k, i] * curve


@helper
def _newton_step(gradient, hessian, step):
    """Solves for the step by Cholesky's method, in place; returns the squared Newton decrement."""
    size = len(gradient)
    for j in range(size):
        for k in range(j + 1):
            total = hessian[j, k]
            for l in range(k):
                total -= hessian[j, l] * hessian[k, l]
            if j == k:
                hessian[j, j] = math.sqrt(total)
            else:
                hessian[j, k] = total / hessian[k, k]
    decrement = 0.0
    for j in range(size):
        step[j] = -gradient[j]
        for l in range(j):
            step[j] -= hessian[j, l] * step[l]
        step[j] /= hessian[j, j]
        decrement += step[j] * step[j]
    for j in range(size - 1, -1, -1):
        for l in range(j + 1, size):
            step[j] -= hessian[l, j] * step[l]
        step[j] /= hessian[j, j]
    return decrement


@helper
def _move(start, null, step, length, actions):
    """Actions after a part of a step."""
    for i in range(len(start)):
        actions[i] = start[i]
        for j in range(len(step)):
            actions[i] += length * null[j, i] * step[j]


@entry_point(seconds=distribution_seconds)
def solve_central(structure, load, lower, slope, offset, barrier, tensions):
    """Central tensions, see :func:`~cablebot_gym.physics.tensions.distribution.unchecked_central`; NaN if S is
    singular."""
    items, m, n = structure.shape
    factors = new_factors(m, n)
    null = factors.q[n:]
    shifted_load = np.zeros(n)
    lows = np.zeros(m)
    actions = np.zeros(m)
    trial = np.zeros(m)
    gradient = np.zeros(m - n)
    step = np.zeros(m - n)
    hessian = np.zeros((m - n, m - n))
    for item in range(items):
        for j in range(n):
            shifted_load[j] = load[item, j]
        for i in range(m):
            lows[i] = slope[item, i] * lower[item, i] + offset[item, i]
            for j in range(n):
                factors.matrix[i, j] = -structure[item, i, j] / slope[item, i]
                shifted_load[j] += factors.matrix[i, j] * offset[item, i]
        if factorise(factors) < n:
            tensions[item] = np.nan
            continue
        particular_solution(factors, shifted_load, actions)
        value = _value(actions, lows, barrier)
        for _ in range(_ITERATIONS):
            _derivatives(actions, lows, barrier, null, gradient, hessian)
            decrement = _newton_step(gradient, hessian, step)
            length = 1.0
            _move(actions, null, step, length, trial)
            now = _value(trial, lows, barrier)
            while decrement > _LAST and now > value - 0.1 * length * decrement:
                length *= 0.5
                if length < _SHORTEST:
                    break
                _move(actions, null, step, length, trial)
                now = _value(trial, lows, barrier)
            value = now
            for i in range(m):
                actions[i] = trial[i]
            if not decrement > _LAST:
                break
        for i in range(m):
            tensions[item, i] = (actions[i] - offset[item, i]) / slope[item, i]
