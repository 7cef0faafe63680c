"""Cable tensions that hold a load within bounds, for any number of cables, batched and compiled.

m cables hold the load w on n ≤ m coordinates if ``−Sᵀ T = w``. The r = m − n redundant cables leave
a choice::

    least_norm       the tensions nearest to reference tensions
    central          tensions away from all bounds, which change smoothly along a motion
    largest_scale    the interval of s for which they hold ``w₀ + s w₁``, e.g. the payload; with
                     w₁ = 0 whether they hold w₀
    unchecked_least_largest_action
                     the tensions whose largest motor action is the least

For example, the least tensions of eight cables on six coordinates, each at least 100 N::

    result = least_norm(structure, load, 100.0, 5000.0)
    result.tensions, result.status == HELD

All arrays broadcast: structure (..., m, n), load (..., n), values of cables (..., m) or one number.
Bounds may be infinite. With ``m == n`` the tensions are the unique solution.

The compiled solutions are in ``tension_problems`` and ``central_tensions``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics.tensions import central_tensions, nearest_point
from cablebot_gym.physics.tensions.tension_problems import (
    solve_interval,
    solve_least_largest,
    solve_least_norm,
)
from cablebot_gym.utils.checks import all_finite

HELD = nearest_point.HELD
"""Status of an item whose load tensions within the bounds hold."""

INFEASIBLE = nearest_point.INFEASIBLE
"""Status of an item whose load no tensions within the bounds hold."""

SINGULAR = nearest_point.SINGULAR
"""Status of an item whose S has a rank below n."""

SMOOTHING = 1e-2
"""Default weight ε of the sum of the squared actions in :func:`unchecked_least_largest_action`."""

BARRIER = 1e-2
"""Default barrier parameter μ of :func:`unchecked_central`."""

RELAXED = central_tensions.RELAXED
"""Distance from a bound below which a parabola continues the barrier of :func:`unchecked_central`, as a
fraction of μ."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution:
    """Tensions for a load."""

    tensions: Array
    """Tensions T within the bounds, shape (..., m) [N]."""
    status: Array
    """:data:`HELD`, :data:`INFEASIBLE` or :data:`SINGULAR`, shape (...)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScaleInterval:
    """Interval of the scales s for which tensions within the bounds hold a load; one interval, by
    convexity."""

    least: Array
    """Lower end, shape (...); NaN if the interval is empty or S is singular."""
    largest: Array
    """Upper end, shape (...); NaN as above."""
    status: Array
    """:data:`HELD`, :data:`INFEASIBLE` (the interval is empty) or :data:`SINGULAR`, shape (...)."""
    coefficients: Array
    """Cables that limit s at the upper end, largest magnitude 1, shape (..., m): positive by the
    upper bound of the cable, negative by its lower bound. All are 0 if only the end of the search
    limits it. If the interval is empty: cables that exclude every s."""


def least_norm(
    structure: ArrayLike,
    load: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike = np.inf,
    reference: ArrayLike | None = None,
) -> Distribution:
    """Tensions T that minimise ``Σ (T_i − reference_i)²`` with ``−Sᵀ T = w`` and ``lower ≤ T ≤
    upper``.

    T is continuous in S, w and the bounds where S has full rank and some tensions strictly within
    the bounds hold w: it is the projection on a polyhedron that changes continuously there.

    Args:
        structure: S, shape (..., m, n), m ≥ n.
        load: w, shape (..., n) [N, N·m].
        lower: lower bounds, shape (..., m) [N].
        upper: upper bounds, shape (..., m) [N].
        reference: reference tensions, shape (..., m) [N]; None: the lower bounds where finite, else
            0. They are the result, within the bounds, where no tensions hold the load.

    Raises:
        ValueError: if the shapes do not match, or a number is not finite. A bound may be infinite.
    """
    _check_problem(structure, load, lower, upper)
    shape, matrices, loads, (low, high) = _arrays(structure, load, lower, upper)
    if reference is None:
        nearest_to = np.where(np.isfinite(low), low, 0.0)
    else:
        all_finite("reference", reference)
        nearest_to = _values(reference, shape, low.shape[1])
    tensions = np.empty_like(low)
    status = np.empty(len(low), np.int64)
    solve_least_norm(matrices, loads, low, high, nearest_to, tensions, status)
    return Distribution(tensions=tensions.reshape(*shape, -1), status=status.reshape(shape))


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
    """Tensions T with the least largest action ``max |a_i|``, ``a_i = slope_i T_i + offset_i``,
    that hold the load.

    The exact minimum jumps: along a smooth motion a change of the cables with the largest action
    moves the solution at once from one end of an edge to the other, and a rule that chooses among
    several solutions, such as lexicographic order, cannot prevent it. For example, ``T₁ + δ T₂ =
    1`` with a = T and T ≥ −1 has the only solution T₂ ≈ 1 for small δ > 0, and T₂ ≈ −1 for δ < 0.
    So T minimises ``t² + ε Σ a_i²`` with ``|a_i| ≤ t`` and ε = ``smoothing``. This problem is
    strictly convex. Therefore T is unique, and it is Lipschitz continuous in S, w, the bounds,
    slope and offset where S has full rank and some tensions strictly within the bounds hold w. It
    crosses the edge while the relevant multiplier is of the order of ε.

    With t* the exact least largest action, ``t ≤ t* √((1 + ε m)/(1 + ε))``, i.e. at most 3.4 % more
    for eight cables and the default: T* has ``t*² + ε Σ a_i² ≤ t*² (1 + ε m)``, and T has at least
    ``t² (1 + ε)``. Away from these changes the largest action is exact. A smaller ε is closer to t*
    and faster at a change.

    If no tensions hold the load, the tensions within the bounds leave the least wrench error ``Σ
    (weights_j e_j)²``, e = w + Sᵀ T, plus a small multiple of their distance from those at zero
    action, which makes them unique and changes the wrench by about 1e-6 of the tensions. A lower
    bound above the upper bound takes precedence.

    Args:
        structure: S, shape (..., m, n), m ≥ n.
        load: w, shape (..., n) [N, N·m].
        lower: lower bounds, shape (..., m) [N].
        slope: action per tension, shape (..., m) [1/N]; any but 0.
        offset: action at zero tension, shape (..., m).
        upper: upper bounds, shape (..., m) [N].
        smoothing: ε; at least 1e-9.
        weights: weights of the coordinates if the load is infeasible, shape (..., n); > 0. For
            moments, one over a length [1/m].

    It is for laws, whose numbers are finite: checks would take a tenth of the time. If S is not
    finite, as in a pose where a cable has no length, the status is :data:`SINGULAR`.
    """
    shape, matrices, loads, (low, high, slopes, offsets) = _arrays(
        structure, load, lower, upper, slope, offset
    )
    tensions = np.empty_like(low)
    status = np.empty(len(low), np.int64)
    coordinate_weights = _values(weights, shape, loads.shape[1])
    solve_least_largest(
        matrices,
        loads,
        low,
        high,
        slopes,
        offsets,
        float(smoothing),
        coordinate_weights,
        tensions,
        status,
    )
    return Distribution(tensions=tensions.reshape(*shape, -1), status=status.reshape(shape))


def unchecked_central(
    structure: ArrayLike,
    load: ArrayLike,
    minimum: ArrayLike,
    slope: ArrayLike,
    offset: ArrayLike,
    *,
    barrier: float = BARRIER,
) -> Array:
    """Tensions that hold the load away from their bounds, shape (..., m) [N].

    They minimise ``½ Σ a_i² − μ Σ [log(a_i − a_i(minimum)) + log(1 − a_i)]`` with the actions ``a_i =
    slope_i T_i + offset_i``. The least of a smooth, strictly convex function is a smooth function
    of S, w, slope and offset where S has full rank, whereas :func:`unchecked_least_largest_action` crosses
    its edges fast. A cable keeps a distance of about μ over the gradient of the rest from its
    bounds. For μ → 0 the tensions become those of the least squared actions within the bounds; for
    μ → ∞ the analytic centre of the tensions that hold the load.

    Closer to a bound than a tenth of μ, a parabola continues the logarithm, so that also a load
    beyond the bounds has a solution: it holds the load, with tensions below ``minimum`` and actions
    above 1.

    Args:
        structure: S, shape (..., m, n), m ≥ n.
        load: w, shape (..., n) [N, N·m].
        minimum: lower bounds, shape (..., m) [N].
        slope: action per tension, shape (..., m) [1/N]; > 0.
        offset: action at zero tension, shape (..., m).
        barrier: μ; > 0.

    It is for laws, whose numbers are finite. NaN if S has a rank below n.
    """
    shape, matrices, loads, (low, slopes, offsets) = _arrays(
        structure, load, minimum, slope, offset
    )
    tensions = np.empty_like(low)
    central_tensions.solve_central(matrices, loads, low, slopes, offsets, float(barrier), tensions)
    return tensions.reshape(*shape, -1)


def largest_scale(
    structure: ArrayLike,
    load: ArrayLike,
    unit_load: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    largest: ArrayLike,
) -> ScaleInterval:
    """Interval of s in [0, largest] for which tensions within the bounds hold ``w₀ + s w₁``,
    exactly. With w₁ the load of 1 kg, s is the payload or the mass.

    Bounds may be exceeded by 1e-10 of the largest tension.

    Args:
        structure: S, shape (..., m, n), m ≥ n.
        load: w₀, shape (..., n) [N, N·m].
        unit_load: w₁, shape (..., n).
        lower: lower bounds, shape (..., m) [N].
        upper: upper bounds, shape (..., m) [N].
        largest: upper end of the search, shape (...); ≥ 0 and finite.

    Raises:
        ValueError: if the shapes do not match, or a number is not finite or out of its range. A
            bound may be infinite.
    """
    all_finite("unit_load", unit_load)
    _check_problem(structure, load, lower, upper)
    end = np.asarray(largest, float)
    if not np.all(np.isfinite(end)) or not np.all(end >= 0):
        raise ValueError("largest must be finite and at least 0")
    batch = np.shape(unit_load)[:-1], end.shape
    shape, matrices, loads, (low, high) = _arrays(structure, load, lower, upper, batch=batch)
    items, m, n = matrices.shape
    interval = np.empty((items, 2))
    status = np.zeros(items, np.int64)
    coefficients = np.zeros((items, m))
    units = _values(unit_load, shape, n)
    ends = _values(end[..., None], shape, 1)[:, 0]
    solve_interval(matrices, loads, units, low, high, ends, interval, status, coefficients)
    return ScaleInterval(
        least=interval[:, 0].reshape(shape),
        largest=interval[:, 1].reshape(shape),
        status=status.reshape(shape),
        coefficients=coefficients.reshape(*shape, m),
    )


def _values(values: ArrayLike, shape: tuple[int, ...], last: int) -> Array:
    """Values as a contiguous array of shape (items, last)."""
    array = np.empty((*shape, last))
    array[...] = values
    return array.reshape(-1, last)


def _check_problem(
    structure: ArrayLike, load: ArrayLike, lower: ArrayLike, upper: ArrayLike
) -> None:
    """Checks that S and w are finite, and that no bound is NaN or excludes every tension."""
    all_finite("structure (NaN for a cable without length)", structure)
    all_finite("load", load)
    # A lower bound of +inf or an upper bound of −inf excludes every tension; comparisons with NaN
    # are false.
    if not np.all(np.less(lower, np.inf)) or not np.all(np.greater(upper, -np.inf)):
        raise ValueError(
            "bounds of tensions must be numbers, with lower below inf and upper above -inf"
        )


def _arrays(
    structure: ArrayLike,
    load: ArrayLike,
    *cables: ArrayLike,
    batch: tuple[tuple[int, ...], ...] = (),
) -> tuple[tuple[int, ...], Array, Array, list[Array]]:
    """Leading shape, then the arrays with one leading axis: S, w and the values of cables."""
    matrices = np.asarray(structure, float)
    vectors = np.asarray(load, float)
    m, n = matrices.shape[-2:]
    if m < n or vectors.shape[-1:] != (n,):
        raise ValueError(
            f"structure {matrices.shape} and load {vectors.shape} do not match: use (..., m, n) and (..., n), m >= n"
        )
    batch += tuple(np.shape(values)[:-1] for values in cables)
    shape = np.broadcast_shapes(matrices.shape[:-2], vectors.shape[:-1], *batch)
    matrices = _values(matrices, (*shape, m), n).reshape(-1, m, n)
    values_of_cables = [_values(values, shape, m) for values in cables]
    return shape, matrices, _values(vectors, shape, n), values_of_cables
