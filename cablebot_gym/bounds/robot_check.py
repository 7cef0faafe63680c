"""Checks of a robot before anything is simulated: payload along its motion, workspace, modes, sag, and doubtful values.

The checks are static or follow the reference exactly; no controller is involved.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.linalg import eigh

from cablebot_gym.bounds.closed_form import tension_bounds
from cablebot_gym.envs.settings import default_trajectory, make_settings
from cablebot_gym.kinematics import Array, turned
from cablebot_gym.physics import textbook
from cablebot_gym.physics.distribution import HELD, SINGULAR, feasible, largest_scale, least_norm
from cablebot_gym.physics.sag import sag, settle
from cablebot_gym.planning.program import HEAVIEST
from cablebot_gym.robots import COORDINATE_NAMES, RPM, Robot, reach_and_gyration
from cablebot_gym.task import check_workspace, find_error_bounds
from cablebot_gym.trajectories import Reference, Trajectory, find_trajectory
from cablebot_gym.utils.checks import number

SAMPLES = 201
"""Number of instants of a motion that are checked, evenly spaced."""

GRID = {2: 41, 3: 17}
"""Number of positions along each axis of the workspace, by the number of axes."""

CLOSE = 0.01
"""Distance of two cables below which they may touch [m]."""


@dataclass(frozen=True, kw_only=True)
class PayloadLimit:
    """Payloads with which cables and motors can follow a motion exactly."""

    least: float
    """Least payload [kg]; infinite if there is none."""
    largest: float
    """Largest payload [kg]; minus infinite if there is none."""
    time: float
    """Time of the instant that limits the largest payload, or at which none can be held [s]."""
    pose: tuple[float, ...]
    """Pose at this instant [m, rad]."""
    reason: str
    """Cables and limits that are active at this instant."""


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A natural oscillation at the home pose, without the stiffness that cable tensions add."""

    frequency: float
    """Natural frequency [Hz]."""
    direction: str
    """Symbol of the coordinate with most of the energy, or ``motors``."""
    locked: bool
    """Whether the motors stand still."""


@dataclass(frozen=True, kw_only=True)
class CableSag:
    """Sag of one cable at its least tension on the motion."""

    length: float
    """Length of the cable [m]."""
    tension: float
    """Least tension [N]."""
    sag: float
    """Largest distance from the straight line [m]."""
    extra_length: float
    """Length that the straight line leaves out [m]."""
    stiffness_factor: float | None
    """Stiffness over that of a straight cable; None if the robot's cables do not stretch."""


@dataclass(frozen=True, kw_only=True)
class RobotCheck:
    """Result of :func:`check_model`."""

    robot: Robot
    """The robot."""
    trajectory: Trajectory
    """The motion."""
    payload: float
    """Payload of workspace, motion and sag [kg]."""
    limit: PayloadLimit
    """Payloads of the motion."""
    workspace: float
    """Fraction of the workspace, at the home orientation, where cables and motors hold the payload at rest."""
    modes: tuple[Mode, ...]
    """Softest and stiffest mode with locked and with free motors; empty for a rigid robot."""
    substeps: int
    """Suggested number of physics steps per control period."""
    physics_step: float
    """Suggested physics step [s]."""
    cables: tuple[CableSag, ...]
    """Sag of each cable; empty if the cables have no mass or the motion cannot be held."""
    settled: tuple[float, ...] | None
    """Change of the home pose by the sag and the weight of the cables [m, rad]; None if unknown."""
    settled_tension: float | None
    """Largest relative change of a tension at the home pose by sag and weight; None if unknown."""
    questions: tuple[str, ...]
    """Doubtful values, each with a remedy."""

    @property
    def held(self) -> bool:
        """Whether the payload can be carried along the motion."""
        return self.limit.least <= self.payload <= self.limit.largest

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON-able data; None for an infinite number."""
        limit = {name: value if finite(value) else None for name, value in vars(self.limit).items()}
        return {
            "robot": self.robot.to_dict(),
            "kind": self.robot.kind,
            "trajectory": self.trajectory.name,
            "payload": self.payload,
            "held": self.held,
            "limit": limit,
            "workspace": self.workspace,
            "modes": [vars(mode) for mode in self.modes],
            "substeps": self.substeps,
            "physics_step": self.physics_step,
            "cables": [vars(cable) for cable in self.cables],
            "settled": self.settled,
            "settled_tension": self.settled_tension,
            "questions": list(self.questions),
        }


def finite(value: Any) -> bool:
    """Whether a value is anything but an infinite number."""
    return not isinstance(value, float) or math.isfinite(value)


def check_model(robot: Robot, *, payload: float | None = None, trajectory: Any = None) -> RobotCheck:
    """Checks a robot and its motion.

    Args:
        robot: the robot.
        payload: payload [kg]; None for the least one of the robot's payload range, else 0.
        trajectory: motion, as for :func:`~cablebot_gym.trajectories.find_trajectory`; None for the robot's default.

    Raises:
        ValueError: if the payload or the motion is invalid.
    """
    motion = find_trajectory(default_trajectory(robot) if trajectory is None else trajectory, robot.kind)
    payload = number("payload", robot.defaults.payload(0.0) if payload is None else payload, least=0, unit="kg")
    check_workspace(robot, motion, find_error_bounds(None, robot))
    times = np.linspace(0, motion.duration, SAMPLES)
    reference = motion(times)
    limit = payload_limit(robot, times, reference)
    settings = make_settings(robot=robot, count=1, trajectory=motion)
    cables, settled, tension = _sag(robot, reference, payload) if np.any(robot.cable_density) else ((), None, None)
    return RobotCheck(
        robot=robot,
        trajectory=motion,
        payload=payload,
        limit=limit,
        workspace=float(np.mean(holds(robot, _grid(robot), payload))),
        modes=tuple(modes(robot)),
        substeps=settings.substeps,
        physics_step=settings.physics_step,
        cables=cables,
        settled=settled,
        settled_tension=tension,
        questions=tuple([*_doubtful_values(robot, payload), *_close_cables(robot, times, reference)]),
    )


# --- loads and limits ---------------------------------------------------------------------------------------------


def _required(robot: Robot, reference: Reference, payload: float) -> Array:
    """Required generalised force with a payload, (K, n)."""
    mass = np.full(len(reference.position), robot.mass + payload)
    return textbook.load(robot, mass, reference.position, reference.velocity, reference.acceleration)


def payload_limit(robot: Robot, times: Array, reference: Reference) -> PayloadLimit:
    """Interval of the payloads with which cables and motors can follow a reference, and what limits it.

    Args:
        robot: the robot; joint springs and stretch of the cables are left out.
        times: times (K,) [s].
        reference: the motion at these times.
    """
    empty = _required(robot, reference, 0.0)
    found = largest_scale(
        textbook.jacobian(robot, reference.position),
        empty,
        _required(robot, reference, 1.0) - empty,
        *tension_bounds(robot, reference, robot.minimum_tension),
        HEAVIEST * robot.mass,
    )
    failed = np.flatnonzero(found.status != HELD)
    index = int(failed[0]) if len(failed) else int(np.argmin(found.largest))
    singular = found.status[index] == SINGULAR
    return PayloadLimit(
        least=math.inf if len(failed) else float(found.least.max()),
        largest=-math.inf if len(failed) else float(found.largest[index]),
        time=float(times[index]),
        pose=tuple(reference.position[index].tolist()),
        reason="the cables are singular" if singular else limiting_cables(robot, found.coefficients[index]),
    )


def limiting_cables(robot: Robot, coefficients: Array) -> str:
    """Cables with an active limit as text, from the coefficients of :mod:`cablebot_gym.physics.distribution`."""
    parts = []
    for sign, text in ((1, "at the torque limit"), (-1, f"at the minimum tension of {robot.minimum_tension:g} N")):
        numbers = [str(index + 1) for index in np.flatnonzero(sign * coefficients > 1e-6)]
        if numbers:
            parts.append(f"cable{'s' if len(numbers) > 1 else ''} {', '.join(numbers)} {text}")
    return " and ".join(parts) or "no limit was reached"


def holds(robot: Robot, poses: Array, payload: float) -> Array:
    """Whether cables and motors hold a payload [kg] at rest at poses (K, n), shape (K,)."""
    rest = np.zeros_like(poses)
    still = Reference(position=poses, velocity=rest, acceleration=rest, jerk=rest, snap=rest)
    with np.errstate(invalid="ignore", divide="ignore"):  # anchors and swivel pulleys
        structure, load = textbook.jacobian(robot, poses), _required(robot, still, payload)
        bounds = tension_bounds(robot, still, robot.minimum_tension)
    known = np.isfinite(structure).all(axis=(1, 2))
    held = np.zeros(len(poses), bool)
    found = feasible(structure[known], load[known], *(bound[known] for bound in bounds))
    held[known] = found.status == HELD
    return held


def _grid(robot: Robot) -> Array:
    """Poses at the home orientation in the workspace, (K, n)."""
    d, (low, high) = robot.dimensions, robot.pose_bounds
    axes = [np.linspace(low[axis], high[axis], GRID[d]) for axis in range(d)]
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    poses = np.tile(robot.home, (len(positions), 1))
    poses[:, :d] = positions
    return poses


# --- modes --------------------------------------------------------------------------------------------------------


def modes(robot: Robot) -> list[Mode]:
    """Softest and stiffest mode with locked motors, then with free motors; empty for a rigid robot.

    With free motors the platform can also move without any stiffness; these motions are left out.
    """
    if not robot.flexible:
        return []
    model = textbook.linear_model(robot)
    n, size = robot.coordinates, len(model.inertia)
    moving = size - robot.cables  # the motors are the last coordinates
    found = []
    for locked, count in ((True, moving), (False, size)):
        squares, shapes = eigh(model.stiffness[:count, :count], model.inertia[:count, :count])
        real = np.flatnonzero(squares > 1e-9 * squares.max())
        for index in (real[0], real[-1]):
            shape = shapes[:, index]
            energy = shape * (model.inertia[:count, :count] @ shape)
            symbols = [*COORDINATE_NAMES[robot.kind], "motors"]
            parts = [*energy[:n], energy[n:].sum()]
            direction = symbols[int(np.argmax(parts))]
            frequency = math.sqrt(squares[index]) / (2 * math.pi)
            found.append(Mode(frequency=frequency, direction=direction, locked=locked))
    return found


# --- sag ----------------------------------------------------------------------------------------------------------


def _sag(
    robot: Robot, reference: Reference, payload: float
) -> tuple[tuple[CableSag, ...], tuple[float, ...] | None, float | None]:
    """Sag of each cable, and change of pose and tensions at home; nothing if the motion or the pose is not held."""
    lower, upper = tension_bounds(robot, reference, robot.minimum_tension)
    structure = textbook.jacobian(robot, reference.position)
    found = least_norm(structure, _required(robot, reference, payload), lower, upper)
    if np.any(found.status != HELD):
        return (), None, None
    least, every = found.tensions.argmin(axis=0), np.arange(robot.cables)
    loose = sag(robot, reference.position, found.tensions)
    cables = tuple(
        CableSag(
            length=float(loose.length[k, i]),
            tension=float(found.tensions[k, i]),
            sag=float(loose.sag[k, i]),
            extra_length=float(loose.extra_length[k, i]),
            stiffness_factor=float(loose.stiffness_factor[k, i]) if robot.elastic else None,
        )
        for k, i in zip(least, every, strict=True)
    )
    mass, rest = robot.mass + payload, np.zeros(robot.coordinates)
    home = least_norm(
        textbook.jacobian(robot, robot.home), textbook.bias(robot, mass, robot.home, rest), robot.minimum_tension
    )
    if home.status != HELD:
        return cables, None, None
    try:
        settled = settle(robot, mass, robot.home, home.tensions)
    except ValueError:
        return cables, None, None
    change = float(np.max(np.abs(settled.tensions / home.tensions - 1)))
    return cables, tuple(settled.pose_change.tolist()), change


# --- doubtful values ----------------------------------------------------------------------------------------------


def _doubtful_values(robot: Robot, payload: float) -> Iterator[str]:
    """Values that are possible but unusual, with the unit that was probably meant."""
    fastest = float(np.max(robot.per_motor(robot.motors.free_speed) * robot.pulley_radius))
    if fastest > 60:
        yield (
            f"motors.free_speed gives {fastest:.0f} m/s at the cable: is it in rad/s at the pulley? "
            f"Multiply rpm by {RPM:.4f} and divide by the gear ratio"
        )
    strongest = float(np.max(robot.stall_torque / robot.pulley_radius))
    weight = (robot.mass + payload) * robot.gravity
    if not robot.weightless and strongest > 100 * weight:
        yield (
            f"motors.stall_torque gives {strongest:.3g} N at the cable, over 100 times the weight of {weight:.3g} N: "
            "is it in N·m, and pulley_radius in m?"
        )
    if not robot.weightless and robot.cables * strongest < weight:
        yield (
            f"all motors together pull with {robot.cables * strongest:.3g} N and the weight is {weight:.3g} N: is "
            "motors.stall_torque in N·m at the pulley, and mass in kg?"
        )
    if not robot.point_mass:
        reach, gyration = reach_and_gyration(robot)
        if gyration > 2 * reach or gyration < 0.1 * reach:
            yield (
                f"the radius of gyration is {gyration:.3g} m and the platform anchors reach {reach:.3g} m from the "
                "centre of mass: is inertia in kg·m², about the centre of mass?"
            )
        angles = robot.pose_bounds[:, robot.dimensions :]
        if np.max(np.abs(angles)) > 2 * math.pi:
            yield "the angles of workspace exceed 2π: are they in rad?"
    if robot.elastic:
        strain = float(np.max(max(robot.minimum_tension, weight / robot.cables) / robot.axial_stiffness))
        if strain > 0.05:
            yield (
                f"the cables stretch by {strain:.0%} under the platform: is transmission.axial_stiffness EA in N? "
                "Multiply a stiffness in N/m by the length"
            )
    low, high = robot.pose_bounds
    box = robot.base.min(axis=0), robot.base.max(axis=0)
    sides = robot.dimensions - (not robot.weightless)
    if np.any(low[:sides] < box[0][:sides] - 1e-9) or np.any(high[:sides] > box[1][:sides] + 1e-9):
        yield "workspace is wider than the base anchors: give (low, high) within them"


def _close_cables(robot: Robot, times: Array, reference: Reference) -> Iterator[str]:
    """Pairs of cables that come close at home or on the motion, other than at a common anchor."""
    poses = np.concatenate([robot.home[None], reference.position])
    d = robot.dimensions
    ends = poses[:, None, :d] + turned(poses, robot.platform)
    for i, j in combinations(range(robot.cables), 2):
        if np.allclose(robot.base[i], robot.base[j]) or np.allclose(robot.platform[i], robot.platform[j]):
            continue
        distance = segment_distance(robot.base[i], ends[:, i], robot.base[j], ends[:, j])
        index = int(np.argmin(distance))
        if distance[index] < CLOSE:
            place = "at home_pose" if index == 0 else f"at t = {times[index - 1]:.2f} s of the motion"
            yield (
                f"cables {i + 1} and {j + 1} come within {1e3 * distance[index]:.0f} mm {place}: do they touch? If so, "
                "move an anchor or change the motion"
            )


def segment_distance(start: Array, end: Array, other_start: Array, other_end: Array) -> Array:
    """Distance of two segments, arrays (..., d), shape (...) [m]."""
    first, second, between = end - start, other_end - other_start, start - other_start
    a, e = np.sum(first**2, axis=-1), np.sum(second**2, axis=-1)
    b, c, f = np.sum(first * second, axis=-1), np.sum(first * between, axis=-1), np.sum(second * between, axis=-1)
    denominator = a * e - b * b
    parallel = denominator <= 1e-12 * a * e
    s = np.where(parallel, 0.0, np.clip((b * f - c * e) / np.where(parallel, 1.0, denominator), 0, 1))
    t = np.clip((b * s + f) / e, 0, 1)
    s = np.clip((b * t - c) / a, 0, 1)
    gap = between + s[..., None] * first - t[..., None] * second
    distance: Array = np.linalg.norm(gap, axis=-1)
    return distance
