"""Largest payload with which a rigid robot can track a motion exactly, in closed form.

On the reference, lengths and speeds of the cables do not depend on the payload, and the required
torques are piecewise affine in it. Therefore no simulation and no search is necessary. The margin
of each limit is piecewise affine, too, and its zeros are the ends of the intervals of payloads that
violate the limit. The result is the end of an interval without violations.

Where redundant cables leave a choice of tensions,
:func:`~cablebot_gym.physics.tensions.distribution.largest_scale` gives the feasible interval of each
instant. The result is the upper end of the intersection of these intervals.

The episode starts on the reference, as with the environment option ``initial_error=0``. By default
a robot under gravity whose motion starts at rest starts lower
(:func:`~cablebot_gym.task.start_pose`), which exact tracking excludes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Reference, Trajectory, find_trajectory
from cablebot_gym.motions.base import ORDERS
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics as compiled_inverse_dynamics
from cablebot_gym.physics.statics import tension_bounds
from cablebot_gym.physics.tensions.distribution import HELD, SINGULAR, largest_scale
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import number, numbers

GRID = 2000.0
"""Default frequency of the instants that approximate all times [Hz]. The error at a smooth extremum
is proportional to the square of the period between two instants."""

_HEAVIEST = 1e6
"""Largest total mass in the search with the best tensions [kg]. If it is feasible, no limit is
active."""


@dataclass(frozen=True, kw_only=True)
class ExactPayload:
    """Interval of payloads for which exact tracking satisfies every limit, and the limit at its
    upper end."""

    payload: float
    """Largest payload [kg].

    * Negative: the platform alone is too heavy by this mass.
    * ``inf``: no limit is active.
    * ``-inf``: the motion is infeasible for every mass; ``motor`` and ``time`` name one violated
      limit.
    """
    lowest: float
    """Least payload of the same interval [kg].

    * Minus the platform mass: every lighter mass is feasible.
    * Positive: the platform needs ballast.
    * ``inf``: the motion is infeasible for every mass.
    """
    motor: int | None
    """Number of the motor or cable of the limit at the upper end, from 1; None without a limit."""
    time: float | None
    """Earliest time at which the limit is active [s]; None without a limit."""


def exact_payload(
    robot: Robot,
    trajectory: Trajectory,
    *,
    minimum_tension: float = 0.0,
    frequency: float | None = None,
    line_speed: ArrayLike = 1.0,
    grid: float = GRID,
) -> ExactPayload:
    """Computes the largest payload with which ``robot`` tracks ``trajectory`` exactly within its
    limits.

    The limits are ``U⁻ ≤ τ ≤ U⁺`` with ``U± = ±τ_s − (τ_s/ω_n) β̇``, ``T ≥ minimum_tension`` and
    ``T ≤ robot.maximum_tension``. They apply at all times from 0 up to, but excluding,
    ``duration``. A fine grid approximates these times. It has both sides of each instant, because
    both accelerations count where the acceleration of the paper's circles jumps. With ``frequency``
    the limits apply only at the control instants of a simulated episode: of a jump they contain one
    side, and the other at most one period away.

    The tensions determine how many intervals of payloads are feasible:

    * As many cables as coordinates: one interval, because the tensions are affine in the mass.
    * More cables: one interval, with the best tensions at each instant, see
      :func:`~cablebot_gym.physics.tensions.distribution.largest_scale`.
    * More cables on a planar point mass: possibly several intervals, because it uses the least
      tensions, which have kinks.

    The result is the interval that contains zero payload, or the one nearest to it.

    Args:
        robot: robot with a rigid transmission.
        trajectory: reference motion with as many coordinates as the robot.
        minimum_tension: minimum tension of every cable [N]; ≥ 0. ``robot.minimum_tension`` for the
            task criterion, 0 for the paper's. Planar point masses use the least tensions that
            satisfy it.
        frequency: control instants per second [Hz]; None for all times.
        line_speed: factor of β̇ in the torque-speed lines, one value or one per motor; 0 for limits
            independent of the speed.
        grid: frequency of the instants that approximate all times [Hz]; no effect with
            ``frequency``. 100 suffices for a map.

    Raises:
        ValueError: if an argument is invalid, or if no tensions produce the accelerations of the
            motion.
    """
    minimum_tension = number("minimum_tension", minimum_tension, least=0, unit="N")
    line_speed = numbers("line_speed", line_speed)
    grid = number("grid", grid, above=0, unit="Hz")
    if frequency is None:
        times, reference = _all_times(robot, trajectory, grid)
    else:
        times, reference = control_instants(robot, trajectory, frequency)
    if robot.cables > robot.coordinates and robot.kind != "planar":
        return _payload_of_best_tensions(robot, times, reference, minimum_tension, line_speed)
    return _payload_of_affine_tensions(robot, times, reference, minimum_tension, line_speed)


def _uses_least_tensions(robot: Robot) -> bool:
    """Whether the tensions are the least ones: redundant cables on a planar point mass."""
    return robot.cables > robot.coordinates and robot.kind == "planar"


def control_instants(
    robot: Robot, trajectory: Trajectory, frequency: float
) -> tuple[Array, Reference]:
    """Control instants of an episode [s], shape (K,), at a control frequency [Hz], and the
    reference at these times.

    Raises:
        ValueError: if the trajectory is for another kind of robot, or if there is no control
            instant.
    """
    trajectory = find_trajectory(trajectory, robot.kind)
    # At 0.5 / duration and below, the number of instants rounds to 0.
    frequency = number("frequency", frequency, above=0.5 / trajectory.duration, unit="Hz")
    times = np.arange(round(trajectory.duration * frequency)) / frequency
    return times, trajectory(times)


def _all_times(robot: Robot, trajectory: Trajectory, grid: float) -> tuple[Array, Reference]:
    """Instants at a frequency [Hz], each with a time just before and just after it, shape (K,) [s],
    and the reference at these times."""
    trajectory = find_trajectory(trajectory, robot.kind)
    # An even number, so that half time, where circles jump, is an instant.
    count = 2 * max(1, round(grid / 4), round(grid * trajectory.duration / 2))
    instants = np.arange(count) * (trajectory.duration / count)
    offset = 1e-9 * trajectory.duration
    times = np.stack([instants - offset, instants, instants + offset], axis=1).ravel()
    times = times[1:]  # the first one is before the motion
    return times, trajectory(times)


class _ActiveLimit(NamedTuple):
    """An active or violated limit, as indices."""

    instant: int
    motor: int


@dataclass(frozen=True, eq=False)
class _Violations:
    """Intervals of total masses, each of which violates one limit."""

    low: Array
    """Lower ends, shape (count,) [kg]."""
    high: Array
    """Upper ends, shape (count,) [kg]."""
    limits: Array
    """Limits as in :class:`_ActiveLimit`, shape (count, 2), the earliest first."""


def _payload_of_affine_tensions(
    robot: Robot, times: Array, reference: Reference, minimum_tension: float, line_speed: Array
) -> ExactPayload:
    """Result with tensions that are affine in the mass between nodes: the unique ones, or the least
    ones of a planar point mass."""
    node_masses = _nodes(robot, reference, minimum_tension)
    margins = _margins(robot, reference, node_masses, minimum_tension, line_speed)
    violations = _violations(node_masses, margins)
    intervals = _feasible_masses(violations)
    if not intervals:
        # Of the violations that reach the largest mass, the one that begins at the least mass.
        # lexsort sorts by its last key first.
        order = np.lexsort((violations.low, -violations.high))
        limit = _ActiveLimit(*violations.limits[order[0]])
        return _result(robot, times, low=math.inf, high=-math.inf, active_limit=limit)

    def distance_from_no_payload(interval: tuple[float, float]) -> float:
        low, high = interval
        return max(low - robot.mass, robot.mass - high, 0.0)

    low, high = min(intervals, key=distance_from_no_payload)
    if high == math.inf:
        return _result(robot, times, low=low, high=high, active_limit=None)
    # Several violations can begin here together, up to rounding. The first one is the earliest.
    begins_here = (violations.low >= high) & (violations.low <= high + 1e-9 * (1 + high))
    limit = _ActiveLimit(*violations.limits[begins_here][0])
    return _result(robot, times, low=low, high=high, active_limit=limit)


def _nodes(robot: Robot, reference: Reference, minimum_tension: float) -> Array:
    """Total masses between which every tension is affine, ascending from 0, shape (K, nodes) [kg].

    The last node only defines the slope beyond the previous one.
    """
    nodes = np.zeros((len(reference.position), 1))
    if _uses_least_tensions(robot):
        nodes = np.concatenate([nodes, _kinks(robot, reference, minimum_tension)], axis=1)
    beyond = 2 * nodes[:, -1:] + robot.mass
    return np.concatenate([nodes, beyond], axis=1)


def _kinks(robot: Robot, reference: Reference, minimum_tension: float) -> Array:
    """Total masses at which the least tensions of a planar robot may have a kink, one per cable,
    ascending, shape (K, m) [kg]; 0 without a kink.

    A pair of cables applies the force ``w(M) = −Sᵀ(T − minimum_tension)`` in addition to the
    minimum tension. Where w is parallel to a cable, a different pair becomes active.
    """
    structure = textbook.jacobian(robot, reference.position)
    # w is affine in the mass M, so that its values at two masses determine it.
    sample_masses = np.broadcast_to([0.0, robot.mass], (len(structure), 2))
    motion = _repeated(reference, 2)
    tensions = textbook.required_tensions(
        robot,
        sample_masses,
        motion.position,
        motion.velocity,
        motion.acceleration,
        minimum=minimum_tension,
    )
    # k instants, s samples of the mass, c cables, i coordinates
    force = -np.einsum("kci,ksc->ksi", structure, tensions - minimum_tension)
    # Zero where w is parallel to the cable, shape (K, 2, m).
    cross_product = (
        force[..., None, 0] * structure[:, None, :, 1]
        - force[..., None, 1] * structure[:, None, :, 0]
    )
    unloaded = cross_product[:, 0]
    loaded = cross_product[:, 1]
    # If the cross product does not change with the mass, the zero is infinite or NaN: no kink.
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = robot.mass * unloaded / (unloaded - loaded)
    is_kink = np.isfinite(zeros) & (zeros > 0)
    return np.sort(np.where(is_kink, zeros, 0.0), axis=1)


def _repeated(reference: Reference, count: int) -> Reference:
    """The reference for ``count`` masses at each instant, each array of shape (K, count, n)."""
    arrays = {}
    for order in ORDERS:
        arrays[order] = np.repeat(getattr(reference, order)[:, None], count, axis=1)
    return Reference(**arrays)


def _margins(
    robot: Robot,
    reference: Reference,
    node_masses: Array,
    minimum_tension: float,
    line_speed: Array,
) -> Array:
    """Margin of each limit for each mass, shape (K, nodes, m, limits) [N·m or N]; negative if the
    limit is violated."""
    repeated = _repeated(reference, node_masses.shape[1])
    motion = repeated.position, repeated.velocity, repeated.acceleration
    if _uses_least_tensions(robot):
        # The textbook raises an error if no tensions produce the motion.
        required = textbook.inverse_dynamics(robot, node_masses, *motion, minimum=minimum_tension)
        # The tensions satisfy the minimum by construction; rounding must not violate it.
        tension_margin = np.zeros_like(required.tensions)
    else:
        required = compiled_inverse_dynamics(robot, node_masses, *motion)
        tension_margin = required.tensions - minimum_tension
    if not np.all(np.isfinite(required.torques)):
        raise _singular_error(robot)
    lower, upper = textbook.torque_limits(robot, line_speed * required.speeds)
    margins = [upper - required.torques, required.torques - lower, tension_margin]
    if robot.maximum_tension != math.inf:  # an infinite margin has no slope
        margins.append(robot.maximum_tension - required.tensions)
    return np.stack(margins, axis=-1)


def _singular_error(robot: Robot) -> ValueError:
    """Error for a motion on which some pose has no unique tensions."""
    return ValueError(f"robot {robot.name!r} is singular on the motion: choose another trajectory")


def _violations(node_masses: Array, margins: Array) -> _Violations:
    """Intervals of total masses with a violated limit, one per limit and piece between two nodes.

    A margin is affine on a piece. The last piece continues without end.
    """
    # shape (K, pieces, m, limits), the masses (K, pieces, 1, 1)
    piece_start = node_masses[:, :-1, None, None]
    piece_end = node_masses[:, 1:, None, None].copy()
    start_margin = margins[:, :-1]
    end_margin = margins[:, 1:].copy()
    change = end_margin - start_margin
    # A change within the rounding of the margins counts as none. On the last piece, which has no
    # end, even a tiny change decides the sign of the margin at infinity.
    rounding = 1e-12 * (np.abs(end_margin) + np.abs(start_margin))
    change = np.where(np.abs(change) > rounding, change, 0.0)
    # Without a change there is no zero, and the margin has one sign on the piece.
    with np.errstate(divide="ignore", invalid="ignore"):
        zero = piece_start - start_margin * (piece_end - piece_start) / change
    piece_end[:, -1] = np.inf
    last_change = change[:, -1]
    margin_at_infinity = np.copysign(np.inf, last_change)
    end_margin[:, -1] = np.where(last_change == 0, start_margin[:, -1], margin_at_infinity)
    low = np.where(start_margin < 0, piece_start, zero)
    high = np.where(end_margin < 0, piece_end, zero)
    is_violated = (start_margin < 0) | (end_margin < 0)
    instant_piece_motor_limit = np.argwhere(is_violated)
    limits = instant_piece_motor_limit[:, [0, 2]]
    return _Violations(low=low[is_violated], high=high[is_violated], limits=limits)


def _feasible_masses(violations: _Violations) -> list[tuple[float, float]]:
    """Intervals of total masses from 0 that violate no limit, ascending [kg]."""
    order = np.argsort(violations.low)
    # An interval begins where all violations so far have ended, and ends where the next one begins.
    lows = np.maximum.accumulate(np.append(0.0, violations.high[order]))
    highs = np.append(violations.low[order], np.inf)
    return [(float(low), float(high)) for low, high in zip(lows, highs, strict=True) if low < high]


def _payload_of_best_tensions(
    robot: Robot, times: Array, reference: Reference, minimum_tension: float, line_speed: Array
) -> ExactPayload:
    """Result with the best tensions of redundant cables at each instant."""
    motion = reference.position, reference.velocity, reference.acceleration
    lower, upper = tension_bounds(robot, reference, minimum_tension, line_speed=line_speed)
    if np.any(np.isnan(lower)):  # tension_bounds marks a cable without length by NaN
        raise ValueError(
            f"a cable of robot {robot.name!r} has no length on the motion: choose another trajectory"
        )
    massless_load = textbook.load(robot, 0.0, *motion)
    unit_load = textbook.load(robot, 1.0, *motion) - massless_load
    structure = textbook.jacobian(robot, reference.position)
    # the interval of total masses at each instant
    intervals = largest_scale(structure, massless_load, unit_load, lower, upper, _HEAVIEST)
    if np.any(intervals.status == SINGULAR):
        raise _singular_error(robot)
    is_feasible = intervals.status == HELD
    if np.all(is_feasible):
        low = float(max(intervals.least))
        high = float(min(intervals.largest))
        instant = int(np.argmin(intervals.largest))
    else:
        low = math.inf  # no mass at all
        high = -math.inf
        instant = int(np.argmin(is_feasible))  # the first infeasible one
    if high == _HEAVIEST:
        return _result(robot, times, low=low, high=math.inf, active_limit=None)
    if low > high:  # no mass is feasible at all instants
        low = math.inf
        high = -math.inf
    motor = int(np.argmax(np.abs(intervals.coefficients[instant])))
    limit = _ActiveLimit(instant, motor)
    return _result(robot, times, low=low, high=high, active_limit=limit)


def _result(
    robot: Robot, times: Array, *, low: float, high: float, active_limit: _ActiveLimit | None
) -> ExactPayload:
    """Result from the ends of an interval of total masses [kg] and the limit at its upper end."""
    motor = time = None
    if active_limit is not None:
        motor = int(active_limit.motor) + 1
        # without the offset of the times just before and after an instant
        time = round(float(times[active_limit.instant]), 7)
    return ExactPayload(payload=high - robot.mass, lowest=low - robot.mass, motor=motor, time=time)
