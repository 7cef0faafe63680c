"""Largest payload with which a rigid robot can track a motion exactly, in closed form.

On the reference, lengths and speeds of the cables do not depend on the payload, and the required
torques are piecewise affine in it. Therefore no simulation and no search is necessary. Each limit
is violated on intervals of payloads whose ends are ratios. The result is an end of one of the
remaining intervals.

The episode starts on the reference, as with the environment option ``initial_error=0``. By default
a spatial robot whose motion starts at rest starts lower (:func:`~cablebot_gym.task.start_pose`),
which exact tracking excludes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.distribution import HELD, SINGULAR, largest_scale
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.statics import tension_bounds
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference, Trajectory, find_trajectory
from cablebot_gym.utils.checks import number, numbers

Kind = Literal["torque", "tension"]
Line = Literal["upper", "lower"]

GRID = 2000.0
"""Default number of instants per second that approximate all times [Hz]. The error at smooth
extrema is quadratic in their distance."""

_LIMITS: tuple[tuple[Kind, Line], ...] = (
    ("torque", "upper"),
    ("torque", "lower"),
    ("tension", "lower"),
)
"""Limits along the last axis of :func:`_margins`."""


@dataclass(frozen=True, kw_only=True)
class ExactPayload:
    """Interval of payloads for which exact tracking satisfies every limit, and the limit at its
    upper end."""

    payload: float
    """Largest payload [kg]. A negative value means that the platform alone is too heavy by this
    mass. ``inf``: no limit is active. ``-inf``: the motion is infeasible for every mass, and the
    next fields name one violated limit."""
    lowest: float
    """Least payload of the same interval [kg]: minus the platform mass if every lighter mass is
    feasible, positive if the platform needs ballast, ``inf`` if ``payload`` is ``-inf``."""
    platform_mass: float
    """Mass of the platform [kg]."""
    motor: int | None
    """Number of the motor or cable of the limit at the upper end, from 1; None without a limit."""
    time: float | None
    """Earliest time of the limit [s]; None without a limit."""
    kind: Kind | None
    """Kind of the limit: torque of the motor or tension of the cable; None without a limit."""
    line: Line | None
    """Side of the limit: U⁺ or U⁻ of the torque, always "lower" for the tension; None without a
    limit."""

    @property
    def total_mass(self) -> float:
        """Mass of platform and payload [kg]."""
        return self.platform_mass + self.payload


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

    The limits are ``U⁻ ≤ τ ≤ U⁺`` with ``U± = ±τ_s − (τ_s/ω_n) β̇`` and ``T ≥ minimum_tension``.
    The infimum covers all times from 0 up to, but excluding, ``duration``. It uses a fine grid with
    both sides of each instant, so that both accelerations count where the circles of the paper
    jump. With ``frequency`` it covers only the control instants of a simulated episode, which
    contain one side of a jump and a point close to the other side.

    With as many cables as coordinates the feasible payloads form one interval, because the tensions
    are affine in the mass. So they do with more cables, for which the limits are those of the best
    tensions at each instant, see :func:`~cablebot_gym.physics.distribution.largest_scale`. A planar
    point mass uses the least tensions, which have kinks, so there can be several intervals. The
    result is the interval that contains zero payload, or the one nearest to it.

    Args:
        robot: robot with a rigid transmission.
        trajectory: reference motion with as many coordinates as the robot.
        minimum_tension: minimum tension of every cable [N]; ≥ 0. ``robot.minimum_tension`` for the
            task criterion, 0 for the paper's. Planar point masses use the least tensions that
            satisfy it.
        frequency: control instants per second [Hz]; None for all times.
        line_speed: speed in the torque-speed lines as a multiple of β̇, one value or one per motor;
            0 for limits independent of the speed.
        grid: instants per second that approximate all times, without ``frequency`` [Hz]; 100
            suffices for a map.

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
        return _redundant(robot, times, reference, minimum_tension, line_speed)
    return _affine(robot, times, reference, minimum_tension, line_speed)


def _affine(
    robot: Robot, times: Array, reference: Reference, minimum: float, line_speed: Array
) -> ExactPayload:
    """Result with tensions that are affine in the mass between nodes."""
    masses = _nodes(robot, reference, minimum)
    margins = _margins(robot, reference, masses, minimum, line_speed)
    starts, ends, indices = _violated(masses, margins)
    gaps = _gaps(starts, ends)
    if not gaps:
        # the limit that is violated from the least mass upwards
        lowest_limit = np.lexsort((starts, -ends))[0]
        return _result(robot, -np.inf, np.inf, times, indices[lowest_limit])
    low, high = min(gaps, key=lambda gap: max(gap[0] - robot.mass, robot.mass - gap[1], 0.0))
    # Several limits can end the interval together, up to rounding; ``indices`` lists the earliest
    # first.
    at_end = (starts >= high) & (starts <= high + 1e-9 * (1 + high)) & np.isfinite(starts)
    limit = None
    if np.any(at_end):
        limit = indices[at_end][0]
    return _result(robot, high - robot.mass, low - robot.mass, times, limit)


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
    frequency = number("frequency", frequency, above=0.5 / trajectory.duration, unit="Hz")
    times = np.arange(round(trajectory.duration * frequency)) / frequency
    return times, trajectory(times)


def _all_times(robot: Robot, trajectory: Trajectory, grid: float) -> tuple[Array, Reference]:
    """Grid that approximates all times, with both sides of each instant. It contains half time,
    where circles jump."""
    trajectory = find_trajectory(trajectory, robot.kind)
    grid = number("grid", grid, above=0, unit="Hz")
    count = 2 * max(1, round(grid / 4), round(grid * trajectory.duration / 2))
    instants = np.arange(count) * (trajectory.duration / count)
    side = 1e-9 * trajectory.duration
    times = np.stack([instants - side, instants, instants + side], axis=1).ravel()[1:]
    return times, trajectory(times)


def _repeated(reference: Reference, count: int) -> tuple[Array, Array, Array]:
    """Pose, velocity and acceleration, repeated for each mass, shape (K, count, n)."""
    pose = np.repeat(reference.position[:, None], count, axis=1)
    velocity = np.repeat(reference.velocity[:, None], count, axis=1)
    acceleration = np.repeat(reference.acceleration[:, None], count, axis=1)
    return pose, velocity, acceleration


def _nodes(robot: Robot, reference: Reference, minimum: float) -> Array:
    """Total masses between which every tension is affine, ascending from 0, shape (K, nodes) [kg].

    The last node only defines the slope beyond the previous one. The force ``w(M) = −Sᵀ(T −
    minimum)`` is affine in the mass M. The least tensions of a planar robot have a kink where it is
    parallel to a cable, because a different pair of cables becomes active.
    """
    kinks = np.zeros((len(reference.position), 0))
    if _pairs(robot):
        structure = textbook.jacobian(robot, reference.position)
        masses = np.broadcast_to([0.0, robot.mass], (len(structure), 2))
        tensions = textbook.required_tensions(
            robot, masses, *_repeated(reference, 2), minimum=minimum
        )
        force = -np.einsum("kci,kbc->kbi", structure, tensions - minimum)
        across = force[..., None, 0] * structure[:, None, :, 1]
        across = across - force[..., None, 1] * structure[:, None, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            kinks = robot.mass * across[:, 0] / (across[:, 0] - across[:, 1])
        kinks = np.sort(np.where(np.isfinite(kinks), np.maximum(kinks, 0.0), 0.0), axis=1)
    kinks = np.concatenate([np.zeros((len(kinks), 1)), kinks], axis=1)
    return np.concatenate([kinks, 2 * kinks[:, -1:] + robot.mass], axis=1)


def _margins(
    robot: Robot, reference: Reference, masses: Array, minimum: float, line_speed: Array
) -> Array:
    """Margin of each limit for each mass, shape (K, nodes, m, limits); negative if the limit is
    violated."""
    motion = _repeated(reference, masses.shape[1])
    if _pairs(robot):  # raises an error if no tensions produce the motion
        required = textbook.inverse_dynamics(robot, masses, *motion, minimum=minimum)
    else:
        required = inverse_dynamics(robot, masses, *motion)
    if not np.all(np.isfinite(required.torques)):
        raise ValueError(
            f"robot {robot.name!r} is singular on the motion: choose another trajectory"
        )
    lower, upper = textbook.torque_limits(robot, line_speed * required.speeds)
    # The least tensions of a planar robot satisfy the minimum by construction; rounding must not
    # violate it.
    surplus = required.tensions - minimum
    if _pairs(robot):
        surplus = np.zeros_like(surplus)
    return np.stack([upper - required.torques, required.torques - lower, surplus], axis=-1)


def _pairs(robot: Robot) -> bool:
    """Whether the tensions are the least ones of a planar point mass with redundant cables."""
    return robot.kind == "planar" and robot.cables > robot.coordinates


def _redundant(
    robot: Robot,
    times: Array,
    reference: Reference,
    minimum: float,
    line_speed: Array,
    heaviest: float = 1e6,
) -> ExactPayload:
    """Result with redundant cables."""
    motion = reference.position, reference.velocity, reference.acceleration
    lower, upper = tension_bounds(robot, reference, minimum, line_speed=line_speed)
    massless_load = textbook.load(robot, 0.0, *motion)
    unit_load = textbook.load(robot, 1.0, *motion) - massless_load
    if np.any(np.isnan(lower)):
        raise ValueError(
            f"a cable of robot {robot.name!r} has no length on the motion: choose another trajectory"
        )
    structure = textbook.jacobian(robot, reference.position)
    masses = largest_scale(structure, massless_load, unit_load, lower, upper, heaviest)
    if np.any(masses.status == SINGULAR):
        raise ValueError(
            f"robot {robot.name!r} is singular on the motion: choose another trajectory"
        )
    held = masses.status == HELD
    if np.all(held):
        low, high = float(max(masses.least)), float(min(masses.largest))
        limiting_instant = int(np.argmin(masses.largest))
    else:
        low, high = math.inf, -math.inf
        limiting_instant = int(np.argmin(held))
    payload, lowest_payload = -math.inf, math.inf
    if low <= high:
        payload, lowest_payload = high - robot.mass, low - robot.mass
    if high == heaviest:
        return _result(robot, math.inf, lowest_payload, times, None)
    coefficients = masses.coefficients[limiting_instant]
    motor = int(np.argmax(np.abs(coefficients)))
    limit: tuple[Kind, Line] = ("tension", "lower")
    if coefficients[motor] > 0:
        limit = ("torque", "upper")
    elif lower[limiting_instant, motor] > minimum:
        limit = ("torque", "lower")
    index = np.array([limiting_instant, motor, _LIMITS.index(limit)])
    return _result(robot, payload, lowest_payload, times, index)


def _violated(masses: Array, margins: Array) -> tuple[Array, Array, Array]:
    """Intervals of total masses with a violated limit: lower ends, upper ends (count,), and indices
    (k, motor, limit).

    There is one interval per limit and piece between two nodes. A margin is affine there and beyond
    the last node.
    """
    start = masses[:, :-1, None, None]
    end = masses[:, 1:, None, None]
    start_margin = margins[:, :-1]
    end_margin = margins[:, 1:].copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        change = end_margin - start_margin
        rounding = 1e-12 * (np.abs(end_margin) + np.abs(start_margin))
        change = np.where(np.abs(change) > rounding, change, 0.0)
        zero = start - start_margin * (end - start) / change
    beyond = np.copysign(np.inf, change[:, -1])
    end_margin[:, -1] = np.where(change[:, -1] == 0, start_margin[:, -1], beyond)
    end = np.concatenate([end[:, :-1], np.full_like(end[:, -1:], np.inf)], axis=1)
    starts = np.where(start_margin < 0, start, zero)
    ends = np.where(end_margin < 0, end, zero)
    violated = (start_margin < 0) | (end_margin < 0)
    k, _, motor, limit = np.nonzero(violated)
    return starts[violated], ends[violated], np.stack([k, motor, limit], axis=-1)


def _gaps(starts: Array, ends: Array) -> list[tuple[float, float]]:
    """Complement of intervals in the half line from 0, ascending."""
    order = np.argsort(starts)
    lows = np.maximum.accumulate(np.append(0.0, ends[order]))
    highs = np.append(starts[order], np.inf)
    return [(float(low), float(high)) for low, high in zip(lows, highs, strict=True) if low < high]


def _result(
    robot: Robot, payload: float, lowest: float, times: Array, index: Array | None
) -> ExactPayload:
    if index is None:
        motor, time, kind, line = None, None, None, None
    else:
        motor = int(index[1]) + 1
        time = round(float(times[index[0]]), 7)
        kind, line = _LIMITS[index[2]]
    return ExactPayload(
        payload=payload,
        lowest=lowest,
        platform_mass=robot.mass,
        motor=motor,
        time=time,
        kind=kind,
        line=line,
    )
