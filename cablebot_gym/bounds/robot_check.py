"""Checks of a robot before anything is simulated: payload along its motion, workspace, modes, sag,
and cables that touch.

The checks are static or follow the reference exactly; no controller is involved.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from cablebot_gym.envs.settings import check_simulated, default_trajectory, fewest_substeps
from cablebot_gym.kinematics import Array, segment_distance
from cablebot_gym.motions import Reference, Trajectory, find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.sag import sag
from cablebot_gym.physics.statics import (
    feasible_payloads,
    holds,
    payload_ceiling,
    payload_interval,
    required_load,
    resting,
    status_with_payload,
    tension_bounds,
)
from cablebot_gym.physics.tensions.distribution import HELD, SINGULAR, least_norm
from cablebot_gym.rendering.projection import attached_points
from cablebot_gym.robots import COORDINATE_NAMES, Robot
from cablebot_gym.robots.ranges import with_values
from cablebot_gym.task import (
    ErrorBounds,
    check_workspace,
    find_error_bounds,
    motion_questions,
)
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.results import Printed

SAMPLES = 201
"""Number of instants of a motion that are checked, evenly spaced."""

GRID = {2: 41, 3: 17}
"""Number of positions along each axis of the workspace, by the number of axes."""

CLOSE = 0.01
"""Distance of two cables below which they may touch [m]."""


def _finite_or_none(value: float) -> float | None:
    """A number for JSON, which has no infinite ones."""
    return value if math.isfinite(value) else None


@dataclass(frozen=True, kw_only=True)
class PayloadLimit:
    """Payloads with which cables and motors can follow a motion exactly."""

    least: float
    """Least payload [kg]; infinite if some instant allows none."""
    largest: float
    """Largest payload [kg]; minus infinite if some instant allows none."""
    time: float
    """Time of the instant that limits the largest payload, or excludes the payload that was asked
    for [s]."""
    pose: tuple[float, ...]
    """Pose at this instant [m, rad]."""
    reason: str
    """Cables and limits that are active at this instant."""

    def to_dict(self) -> dict[str, Any]:
        """The limit as JSON-able data; None for an infinite number."""
        least, largest = map(_finite_or_none, (self.least, self.largest))
        return vars(self) | {"least": least, "largest": largest}


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A natural oscillation at the home pose with a payload, with the stiffness that springs, cable
    tensions and weight give it; sag softens elastic cables."""

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


@dataclass(frozen=True, kw_only=True, repr=False)
class RobotCheck(Printed):
    """Result of :func:`check_model`: all that needs no motion."""

    robot: Robot
    """The robot."""
    payload: float
    """Payload of workspace, home pose and modes [kg]."""
    home: PayloadLimit
    """Payloads that cables and motors hold at rest at the home pose."""
    workspace: float
    """Fraction of the workspace, at the home orientation, where cables and motors hold the payload
    at rest."""
    modes: tuple[Mode, ...]
    """Softest and stiffest mode with locked and with free motors, see :func:`modes`."""
    substeps: int | None
    """Suggested number of physics steps per control period; None if the springs need too many."""

    def __str__(self) -> str:
        return (
            f"{self.robot.name}: holds {self.home.least:.4g} to {self.home.largest:.4g} kg at home"
        )

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON-able data; None for an infinite number."""
        return {
            "robot": self.robot.to_dict(),
            "kind": self.robot.kind,
            "payload": self.payload,
            "home": self.home.to_dict(),
            "workspace": self.workspace,
            "modes": [vars(mode) for mode in self.modes],
            "substeps": self.substeps,
        }


@dataclass(frozen=True, kw_only=True, repr=False)
class MotionCheck(Printed):
    """Result of :func:`check_motion`."""

    trajectory: Trajectory
    """The motion."""
    error_bounds: ErrorBounds
    """Error bounds of the robot."""
    payload: float
    """Payload [kg]."""
    limit: PayloadLimit
    """Payloads with which cables and motors follow the motion exactly."""
    payload_range: tuple[float, float] | None
    """Largest payload over the robot's ranges, see :func:`payload_range` [kg]; None without
    ranges."""
    ceiling: float
    """Payload that no controller can be expected to carry, see
    :func:`~cablebot_gym.physics.statics.payload_ceiling` [kg]."""
    cables: tuple[CableSag, ...]
    """Sag of each cable; empty if the cables have no mass or the motion cannot be held."""
    questions: tuple[str, ...]
    """What may be meant otherwise: see :func:`~cablebot_gym.task.motion_questions`, and pairs of
    cables that come close. Each has a remedy."""

    def __str__(self) -> str:
        low, high = self.limit.least, self.limit.largest
        return f"{self.trajectory.name}: followed exactly with {low:.4g} to {high:.4g} kg"

    @property
    def held(self) -> bool:
        """Whether cables and motors can follow the motion exactly with the payload."""
        return self.limit.least <= self.payload <= self.limit.largest

    @property
    def possible(self) -> bool:
        """Whether a controller may carry the payload, exactly or within the error bounds."""
        return self.limit.least <= self.payload <= max(self.limit.largest, self.ceiling)

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON-able data; None for an infinite number."""
        return {
            "trajectory": self.trajectory.name,
            "payload": self.payload,
            "held": self.held,
            "possible": self.possible,
            "limit": self.limit.to_dict(),
            "payload_range": self.payload_range and list(map(_finite_or_none, self.payload_range)),
            "ceiling": _finite_or_none(self.ceiling),
            "cables": [vars(cable) for cable in self.cables],
            "questions": list(self.questions),
        }


def check_model(robot: Robot, *, payload: float | None = None) -> RobotCheck:
    """Checks a robot without a motion.

    Args:
        robot: the robot.
        payload: payload [kg]; None for the least one of the robot's payload range, else 0.

    Raises:
        ValueError: if the payload is invalid, or the simulation does not know the kind of the
            robot.
    """
    check_simulated(robot)
    payload = _payload_of(robot, payload)
    try:
        substeps = fewest_substeps(robot)
    except ValueError:  # springs that are much too stiff
        substeps = None
    return RobotCheck(
        robot=robot,
        payload=payload,
        home=payload_limit(robot, np.zeros(1), resting(robot.home[None]), payload),
        workspace=float(np.mean(holds(robot, _grid(robot), payload))),
        modes=tuple(modes(robot, payload)),
        substeps=substeps,
    )


def check_motion(
    robot: Robot, *, payload: float | None = None, trajectory: Any = None
) -> MotionCheck:
    """Checks whether a robot can follow a motion.

    Args:
        robot: the robot.
        payload: payload [kg]; None for the least one of the robot's payload range, else 0.
        trajectory: motion, as for
            :func:`~cablebot_gym.motions.names.find_trajectory`; None for the
            robot's default.

    Raises:
        ValueError: if the payload or the motion is invalid, the motion leaves the workspace, or the
            simulation does not know the kind of the robot.
    """
    check_simulated(robot)
    motion = find_trajectory(
        default_trajectory(robot) if trajectory is None else trajectory, robot.kind
    )
    payload = _payload_of(robot, payload)
    bounds = find_error_bounds(None, robot)
    check_workspace(robot, motion, bounds)
    times = np.linspace(0, motion.duration, SAMPLES)
    reference = motion(times)
    return MotionCheck(
        trajectory=motion,
        error_bounds=bounds,
        payload=payload,
        limit=payload_limit(robot, times, reference, payload),
        payload_range=payload_range(robot, reference),
        ceiling=payload_ceiling(robot, motion, bounds),
        cables=_sag(robot, reference, payload),
        questions=(*motion_questions(robot, motion), *_close_cables(robot, times, reference)),
    )


def _payload_of(robot: Robot, payload: float | None) -> float:
    return number("payload", robot.defaults.payload(payload), least=0, unit="kg")


# --- loads and limits ---------------------------------------------------------------------------------------------


_ROUNDING = 1e-6  # least payloads below this fraction of the platform's mass are zero


def payload_limit(robot: Robot, times: Array, reference: Reference, payload: float) -> PayloadLimit:
    """Interval of the payloads with which cables and motors can follow a reference, and what limits
    it.

    Args:
        robot: the robot; joint springs and stretch of the cables are left out.
        times: times (K,) [s].
        reference: the motion at these times.
        payload: payload below which the least payload is what limits [kg].
    """
    payloads = feasible_payloads(robot, reference)
    failed = np.flatnonzero(payloads.status != HELD)
    if len(failed):
        least = math.inf
        largest = -math.inf
        index = int(failed[0])
    else:
        least = float(payloads.least.max())
        largest = float(payloads.largest.min())
        if least < _ROUNDING * robot.mass:
            least = 0.0
        index = int(np.argmax(payloads.least) if payload < least else np.argmin(payloads.largest))
    _, upper = tension_bounds(robot, reference, robot.minimum_tension)
    coefficients = payloads.coefficients[index]
    if payload < least:  # what excludes this payload, not a larger one
        coefficients = status_with_payload(robot, reference, payload).coefficients[index]
    reason = "the cables are singular"
    if payloads.status[index] != SINGULAR:
        reason = limiting_cables(robot, coefficients, upper[index])
    return PayloadLimit(
        least=least,
        largest=largest,
        time=float(times[index]),
        pose=tuple(reference.position[index].tolist()),
        reason=reason,
    )


def payload_range(robot: Robot, reference: Reference) -> tuple[float, float] | None:
    """Least and largest of the payloads with which cables and motors can follow a reference [kg],
    over the robot's ``ranges``; minus infinite if there is none. None for a robot without ranges.

    Each value is taken at the end of its range that lowers (raises) the payload when the others
    are as in the robot, all of them at once. This is exact if the payload rises or falls with a
    value wherever the others are in their ranges.
    """
    if not robot.ranges:
        return None

    def largest(values: dict[str, float]) -> float:
        return payload_interval(with_values(robot, values), reference)[1]

    payloads = [largest({})]
    worst: dict[str, float] = {}
    best: dict[str, float] = {}
    for name, ends in robot.ranges.items():
        at_ends = [largest({name: value}) for value in ends]
        worst[name] = ends[int(np.argmin(at_ends))]
        best[name] = ends[int(np.argmax(at_ends))]
        payloads += at_ends
    payloads += [largest(worst), largest(best)]
    return min(payloads), max(payloads)


def two_digits(*payloads: float) -> str:
    """Payloads of a robot that is not known exactly in words, with two digits [kg]."""
    texts = []
    for payload in payloads:
        text = "none"
        if payload >= 0:
            text = f"{float(f'{payload:.2g}'):g}"
        texts.append(text)
    return " to ".join(dict.fromkeys(texts))


def limiting_cables(robot: Robot, coefficients: Array, upper: Array) -> str:
    """Cables with an active limit as text, from the coefficients of
    :mod:`cablebot_gym.physics.tensions.distribution` and the upper bounds of the tensions, each (m,)."""
    is_upper = coefficients > 1e-6
    at_maximum = upper >= robot.maximum_tension
    parts = []
    for limits, text in (
        (is_upper & ~at_maximum, "at the torque limit"),
        (is_upper & at_maximum, f"at the maximum tension of {robot.maximum_tension:g} N"),
        (coefficients < -1e-6, f"at the minimum tension of {robot.minimum_tension:g} N"),
    ):
        numbers = [str(index + 1) for index in np.flatnonzero(limits)]
        if numbers:
            parts.append(f"cable{'s' if len(numbers) > 1 else ''} {', '.join(numbers)} {text}")
    return " and ".join(parts) or "no limit was reached"


def _grid(robot: Robot) -> Array:
    """Poses at the home orientation in the workspace, (K, n)."""
    d = robot.dimensions
    low, high = robot.pose_bounds
    axes = [np.linspace(low[axis], high[axis], GRID[d]) for axis in range(d)]
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    poses = np.tile(robot.home, (len(positions), 1))
    poses[:, :d] = positions
    return poses


# --- modes --------------------------------------------------------------------------------------------------------


def modes(robot: Robot, payload: float = 0.0) -> list[Mode]:
    """Softest and stiffest mode with locked motors, then with free motors; empty for a rigid robot.

    Free motors keep their torques. The platform can then also move without winding a spring; these
    motions are left out.

    Args:
        robot: the robot.
        payload: payload [kg].
    """
    if not robot.flexible:
        return []
    mass = robot.mass + payload
    tensions = textbook.static_torque(robot, mass, robot.home) / robot.pulley_radius
    softened = _softened(robot, tensions)
    inertia = textbook.linear_model(softened, mass=mass).inertia
    found = []
    for locked, solve in ((True, textbook.locked_modes), (False, textbook.free_modes)):
        frequencies, shapes = solve(softened, mass, robot.home, tensions)
        for index in (0, -1):
            found.append(_mode(robot, inertia, frequencies, shapes, index, locked=locked))
    return found


def _mode(
    robot: Robot, inertia: Array, frequencies: Array, shapes: Array, index: int, *, locked: bool
) -> Mode:
    shape = shapes[:, index]
    moving = len(shape)
    energy = shape * (inertia[:moving, :moving] @ shape)
    n = robot.coordinates
    symbols = [*COORDINATE_NAMES[robot.kind], "motors"]
    direction = symbols[int(np.argmax([*energy[:n], energy[n:].sum()]))]
    return Mode(frequency=float(frequencies[index]), direction=direction, locked=locked)


def _softened(robot: Robot, tensions: Array) -> Robot:
    """The robot with the stiffness that sagging cables have at home with tensions (m,): the part
    between pulley and base anchor does not sag."""
    if not (robot.elastic and np.any(robot.cable_density)):
        return robot
    loose = sag(robot, robot.home, tensions)
    straight = loose.length + robot.extra_length
    factor = np.maximum(loose.stiffness_factor, 1e-9)  # 0 of a slack cable
    softer = straight / (loose.length / factor + robot.extra_length)
    transmission = robot.transmission.replace(axial_stiffness=softer * robot.axial_stiffness)
    return robot.replace(transmission=transmission)


# --- sag ----------------------------------------------------------------------------------------------------------


def _sag(robot: Robot, reference: Reference, payload: float) -> tuple[CableSag, ...]:
    """Sag of each cable; none if the cables have no mass or the motion is not held."""
    if not np.any(robot.cable_density):
        return ()
    lower, upper = tension_bounds(robot, reference, robot.minimum_tension)
    structure = textbook.jacobian(robot, reference.position)
    found = least_norm(structure, required_load(robot, reference, payload), lower, upper)
    if np.any(found.status != HELD):
        return ()
    loose = sag(robot, reference.position, found.tensions)
    cables = []
    for i, k in enumerate(found.tensions.argmin(axis=0)):
        cable = CableSag(
            length=float(loose.length[k, i]),
            tension=float(found.tensions[k, i]),
            sag=float(loose.sag[k, i]),
            extra_length=float(loose.extra_length[k, i]),
            stiffness_factor=float(loose.stiffness_factor[k, i]) if robot.elastic else None,
        )
        cables.append(cable)
    return tuple(cables)


# --- cables that touch ---------------------------------------------------------------------------------------------


def _close_cables(robot: Robot, times: Array, reference: Reference) -> Iterator[str]:
    """Pairs of cables that come close at home or on the motion, other than at a common anchor."""
    poses = np.concatenate([robot.home[None], reference.position])
    ends = attached_points(poses, robot.platform)
    for i, j in combinations(range(robot.cables), 2):
        if np.allclose(robot.base[i], robot.base[j]) or np.allclose(
            robot.platform[i], robot.platform[j]
        ):
            continue
        distance = segment_distance(robot.base[i], ends[:, i], robot.base[j], ends[:, j])
        index = int(np.argmin(distance))
        if distance[index] < CLOSE:
            place = (
                "at home_pose" if index == 0 else f"at t = {times[index - 1]:.2f} s of the motion"
            )
            yield (
                f"cables {i + 1} and {j + 1} come within {1e3 * distance[index]:.0f} mm {place}: do they touch? If so, "
                "move an anchor or change the motion"
            )
