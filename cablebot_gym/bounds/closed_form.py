"""The payload with which a rigid robot can still follow a motion exactly, in closed form.

On the reference, lengths and speeds of the cables do not depend on the payload, and what the motors have to give is
piecewise affine in it. So nothing is simulated or searched: every limit is broken on intervals of payloads whose ends
are ratios, and the answer is an end of one of the gaps that are left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference, Trajectory, find_trajectory

Kind = Literal["torque", "tension"]
Line = Literal["upper", "lower"]

GRID = 2000.0
"""Instants per second that stand for all times [Hz]; smooth extrema are met to the square of their distance."""

_LIMITS: tuple[tuple[Kind, Line], ...] = (("torque", "upper"), ("torque", "lower"), ("tension", "lower"))
"""The last axis of :func:`_margins`."""


@dataclass(frozen=True, kw_only=True)
class ExactPayload:
    """The interval of payloads with which exact tracking respects every limit, and what ends it."""

    payload: float
    """Largest payload [kg]. Negative: the platform alone is too heavy by that much. ``inf``: nothing limits it.
    ``-inf``: no mass makes the motion possible, and the next fields name one limit in its way."""
    lowest: float
    """Least payload of the same interval [kg]: minus the platform's mass if lighter is always possible, positive if
    the platform needs ballast, ``inf`` if ``payload`` is ``-inf``."""
    platform_mass: float
    """Mass without payload [kg]."""
    motor: int | None
    """Motor that a larger payload saturates, or whose cable it slackens, counted from 1; None if nothing limits."""
    time: float | None
    """When it does [s]; the earliest, if there are more."""
    kind: Kind | None
    """Whether the motor's torque or the cable's tension is the limit."""
    line: Line | None
    """Which limit of it: U⁺ or U⁻ of the torque, and always "lower" of the tension."""

    @property
    def total_mass(self) -> float:
        """Platform and payload [kg]."""
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
    """The largest payload with which ``robot`` follows ``trajectory`` exactly inside its motors' limits.

    The limits are ``U⁻ ≤ τ ≤ U⁺`` with ``U± = ±τ_s − (τ_s/ω_n) β̇`` and ``T ≥ minimum_tension``. The infimum is over
    all times from 0 to ``duration``, that itself left out: over a fine grid with both sides of each of its instants, so
    that where the paper's circles jump, both accelerations count. With ``frequency`` it is over the control instants of
    a simulated episode alone, which sees one side of a jump and comes close to the other.

    The feasible payloads of a spatial robot are one interval, since its tensions are affine in the mass. The least
    tensions of a planar robot have kinks, and there may be more intervals; the one taken holds zero payload, or is the
    nearest to it.

    Args:
        robot: with a rigid transmission.
        trajectory: for a robot with as many coordinates.
        minimum_tension: that every cable has to keep [N]; ≥ 0. Planar: the least tensions of all that keep it are used.
        frequency: control instants per second [Hz]; None for all times.
        line_speed: the speed in the torque-speed lines, as a multiple of β̇, one or one per motor: 0 for limits that do
            not depend on it.
        grid: instants per second that stand for all times, without ``frequency`` [Hz]; 100 is enough for a map.

    Raises:
        ValueError: if an argument is not valid, or no tensions give the motion's accelerations at all.
    """
    if not 0 <= minimum_tension < np.inf:
        raise ValueError(f"minimum_tension must be finite and at least 0 N, not {minimum_tension}")
    times, reference = (
        _all_times(robot, trajectory, grid) if frequency is None else control_instants(robot, trajectory, frequency)
    )
    masses = _nodes(robot, reference, minimum_tension)
    margins = _margins(robot, reference, masses, minimum_tension, np.asarray(line_speed, float))
    starts, ends, where = _broken(masses, margins)

    gaps = _gaps(starts, ends)
    if not gaps:
        first = np.lexsort((starts, -ends))[0]  # the limit that is broken from the least mass on upwards for ever
        return _result(robot, -np.inf, np.inf, times, where[first])
    low, high = min(gaps, key=lambda gap: max(gap[0] - robot.mass, robot.mass - gap[1], 0.0))
    # Of limits that end the interval together, but for rounding, ``where`` has the earliest first.
    ending = where[(starts >= high) & (starts <= high + 1e-9 * (1 + high)) & np.isfinite(starts)]
    return _result(robot, high - robot.mass, low - robot.mass, times, ending[0] if len(ending) else None)


def control_instants(robot: Robot, trajectory: Trajectory, frequency: float) -> tuple[Array, Reference]:
    """The times at which an episode commands the motors [s], shape (K,), at a frequency [Hz], and the motion then.

    Raises:
        ValueError: if the trajectory is for another kind of robot, or there is no such instant.
    """
    trajectory = find_trajectory(trajectory, robot.coordinates)
    if not 0 < frequency < np.inf or round(trajectory.duration * frequency) < 1:
        raise ValueError(f"frequency must give at least one instant in {trajectory.duration} s, not {frequency} Hz")
    times = np.arange(round(trajectory.duration * frequency)) / frequency
    return times, trajectory(times)


def _all_times(robot: Robot, trajectory: Trajectory, grid: float) -> tuple[Array, Reference]:
    """A grid that stands for all times, each instant with its two sides; half time, where circles jump, is on it."""
    trajectory = find_trajectory(trajectory, robot.coordinates)
    if not 0 < grid < np.inf:
        raise ValueError(f"grid must be greater than 0 Hz, not {grid}")
    count = 2 * max(1, round(grid / 4), round(grid * trajectory.duration / 2))
    instants = np.arange(count) * (trajectory.duration / count)
    side = 1e-9 * trajectory.duration
    times = np.stack([instants - side, instants, instants + side], axis=1).ravel()[1:]
    return times, trajectory(times)


def _repeated(reference: Reference, count: int) -> tuple[Array, Array, Array]:
    """Pose, velocity and acceleration, each once per mass, shape (K, count, n)."""
    x, v, a = (
        np.repeat(array[:, None], count, axis=1)
        for array in (reference.position, reference.velocity, reference.acceleration)
    )
    return x, v, a


def _nodes(robot: Robot, reference: Reference, minimum: float) -> Array:
    """Total masses between which every tension is affine, ascending from 0, shape (K, nodes) [kg].

    The last only shows the slope beyond the last but one. The least tensions of a planar robot have a kink where the
    force ``w(M) = −Sᵀ(T − minimum)``, which is affine in the mass M, turns from one pair of cables to the next: where
    it is parallel to a cable.
    """
    kinks = np.zeros((len(reference.position), 0))
    if robot.planar:
        structure = textbook.jacobian(robot, reference.position)
        masses = np.broadcast_to([0.0, robot.mass], (len(structure), 2))
        tensions = textbook.required_tensions(robot, masses, *_repeated(reference, 2), minimum=minimum)
        force = -np.einsum("kci,kbc->kbi", structure, tensions - minimum)
        across = force[..., None, 0] * structure[:, None, :, 1] - force[..., None, 1] * structure[:, None, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            kinks = robot.mass * across[:, 0] / (across[:, 0] - across[:, 1])
        kinks = np.sort(np.where(np.isfinite(kinks), np.maximum(kinks, 0.0), 0.0), axis=1)
    kinks = np.concatenate([np.zeros((len(kinks), 1)), kinks], axis=1)
    return np.concatenate([kinks, 2 * kinks[:, -1:] + robot.mass], axis=1)


def _margins(robot: Robot, reference: Reference, masses: Array, minimum: float, line_speed: Array) -> Array:
    """How far each limit is from being broken with each mass, shape (K, nodes, m, limits), negative if it is."""
    motion = _repeated(reference, masses.shape[1])
    if robot.planar:  # refuses what no tensions can give
        needed = textbook.inverse_dynamics(robot, masses, *motion, minimum=minimum)
    else:
        needed = inverse_dynamics(robot, masses, *motion)
    if not np.all(np.isfinite(needed.torques)):
        raise ValueError(f"{robot.name} is singular on the motion: no tensions give its accelerations")
    lower, upper = textbook.torque_limits(robot, line_speed * needed.speeds)
    # The least tensions of a planar robot keep the minimum by construction; rounding must not say that they do not.
    surplus = np.zeros_like(needed.tensions) if robot.planar else needed.tensions - minimum
    return np.stack([upper - needed.torques, needed.torques - lower, surplus], axis=-1)


def _broken(masses: Array, margins: Array) -> tuple[Array, Array, Array]:
    """Where limits are broken: intervals of total masses, first and last (count,), and their (k, motor, limit).

    One interval per limit and piece between two nodes; a margin is affine there, and goes on beyond the last.
    """
    start, end = masses[:, :-1, None, None], masses[:, 1:, None, None]
    first, last = margins[:, :-1], margins[:, 1:].copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.where(np.abs(last - first) > 1e-12 * (np.abs(last) + np.abs(first)), last - first, 0.0)
        zero = start - first * (end - start) / change
    last[:, -1] = np.where(change[:, -1] == 0, first[:, -1], np.copysign(np.inf, change[:, -1]))
    end = np.concatenate([end[:, :-1], np.full_like(end[:, -1:], np.inf)], axis=1)
    starts = np.where(first < 0, start, zero)
    ends = np.where(last < 0, end, zero)
    broken = (first < 0) | (last < 0)
    k, _, motor, limit = np.nonzero(broken)
    return starts[broken], ends[broken], np.stack([k, motor, limit], axis=-1)


def _gaps(starts: Array, ends: Array) -> list[tuple[float, float]]:
    """What some intervals leave of the half line from 0, ascending."""
    order = np.argsort(starts)
    lows = np.maximum.accumulate(np.append(0.0, ends[order]))
    highs = np.append(starts[order], np.inf)
    return [(float(low), float(high)) for low, high in zip(lows, highs, strict=True) if low < high]


def _result(robot: Robot, payload: float, lowest: float, times: Array, where: Array | None) -> ExactPayload:
    if where is None:
        motor, time, kind, line = None, None, None, None
    else:
        motor, time = int(where[1]) + 1, round(float(times[where[0]]), 7)
        kind, line = _LIMITS[where[2]]
    return ExactPayload(
        payload=payload, lowest=lowest, platform_mass=robot.mass, motor=motor, time=time, kind=kind, line=line
    )
