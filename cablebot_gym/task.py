"""The public task, which a policy may read before an episode starts, and the bounds of the tracking
error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import POSE, Measurement
from cablebot_gym.motions import BetweenDwells, Reference, Trajectory, Waypoints
from cablebot_gym.robots import COORDINATE_NAMES, Cable, Robot
from cablebot_gym.robots.record import vertical_remedy
from cablebot_gym.utils.checks import mapping, number, record
from cablebot_gym.utils.results import Printed


@dataclass(frozen=True, kw_only=True)
class ErrorBounds:
    """Bounds of the tracking error. The torque limits are part of the robot.

    Raises:
        ValueError: if a bound is not a positive number.
    """

    position: float = 0.01
    """R, the bound of the distance to the reference at the same instant [m] (Tables 7–9); > 0."""
    rotation: float = 0.01
    """Bound of the error of each of ψ, θ and φ [rad]; > 0. Not in the paper. Has no effect on a
    point mass."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = number(f"error_bounds.{field.name}", getattr(self, field.name), above=0)
            object.__setattr__(self, field.name, value)

    def of_coordinates(self, robot: Robot) -> Array:
        """Bound of each coordinate, (n,) [m, rad]."""
        is_angle = np.arange(robot.coordinates) >= robot.dimensions
        return np.where(is_angle, self.rotation, self.position)

    @property
    def termination_radius(self) -> float:
        """Position error beyond which the environment terminates an episode [m]; at least twice the
        bound."""
        return max(0.1, 2 * self.position)

    @property
    def start_offset(self) -> float:
        """Distance of the start pose under gravity from a motion that starts at rest [m], see
        :func:`start_pose`."""
        return min(self.position / 2, LARGEST_START_OFFSET)


def find_error_bounds(
    error_bounds: ErrorBounds | Mapping[str, float] | None, robot: Robot
) -> ErrorBounds:
    """Error bounds from an :class:`ErrorBounds` or from ``{"position": …, "rotation": …}``.

    Args:
        error_bounds: the bounds; None and omitted keys stand for the defaults.
        robot: robot to which they apply, whose data come first. Without data, its position bound is
            10 mm, at most 1 % and at least 0.1 % of the width of its base.

    Raises:
        ValueError: if a key is unknown, a bound is not positive, or the position bound exceeds the
            diagonal of the robot's workspace.
    """
    if not isinstance(error_bounds, ErrorBounds):
        own = _usual_error_bounds(robot)
        given = mapping("error_bounds", error_bounds or {}, vars(own))
        error_bounds = record("error_bounds", ErrorBounds, vars(own) | given)
    largest = float(np.linalg.norm(np.diff(robot.pose_bounds[:, : robot.dimensions], axis=0)))
    if error_bounds.position > largest:
        raise ValueError(
            f"error_bounds.position must be at most {largest:.3g} m, the diagonal of the workspace of robot "
            f"{robot.name!r}, not {error_bounds.position:g} m: a bound of 10 mm is 0.01"
        )
    return error_bounds


def _usual_error_bounds(robot: Robot) -> ErrorBounds:
    """Error bounds of a robot's data.

    The usual position bound is the paper's 10 mm, but at most 1 % and at least 0.1 % of the width
    of the base, rounded to 1, 2 or 5 times a power of ten. Real robots keep about this
    (``docs/robots.md``).
    """
    width = float(np.max(np.ptp(robot.base, axis=0)))
    bound = min(max(ErrorBounds().position, 0.001 * width), 0.01 * width)
    power = 10.0 ** math.floor(math.log10(bound))
    position = min(
        (step * power for step in (1, 2, 5, 10)), key=lambda rounded: abs(math.log(rounded / bound))
    )
    usual = {"position": float(f"{position:.1g}")}
    return record("error_bounds", ErrorBounds, usual | dict(robot.defaults.error_bounds or {}))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Task(Printed):
    """One episode as the controller knows it. It never contains the true payload, the true
    parameters or a seed."""

    robot: Robot
    """Nominal robot without payload."""
    trajectory: Trajectory
    """Reference motion."""
    error_bounds: ErrorBounds
    """Bounds of the tracking error."""
    control_frequency: float
    """Actions per second [Hz]."""
    cable: Cable
    """``unilateral`` cables can only pull, ``bilateral`` cables can push too."""
    model_payload: float
    """Payload of the controller's model [kg]; 0 if the payload is unknown."""
    payload_known: bool
    """Whether the controller's model includes a payload."""
    measurement: Measurement = POSE
    """Sensors of the observation, and the nominal resolution of the encoders; never the errors of
    the sensors."""

    def __str__(self) -> str:
        model = payload_model_text(self.payload_known)
        return (
            f"{self.robot.name}, {self.trajectory.name} of {self.trajectory.duration:g} s "
            f"at {self.control_frequency:g} Hz, {model}"
        )

    @property
    def steps(self) -> int:
        """Number of control steps of the whole motion."""
        return round(self.trajectory.duration * self.control_frequency)

    @property
    def start_pose(self) -> Array:
        """Start pose of an episode without start error, see :func:`start_pose`, shape (n,)."""
        return start_pose(self.robot, self.trajectory, self.error_bounds)

    @property
    def starts_at_rest(self) -> bool:
        """Whether the velocity and the acceleration of the motion are zero at time 0."""
        return at_rest(self.trajectory(0.0))

    def check_motion(self) -> None:
        """Checks that the motion can be followed.

        Raises:
            ValueError: if the motion is shorter than half a control period, or leaves the robot's
                workspace by more than the error bounds.
        """
        if self.steps < 1:
            raise ValueError(
                f"trajectory {self.trajectory.name!r} is shorter than a control period; make it longer"
            )
        check_workspace(self.robot, self.trajectory, self.error_bounds)


LONGEST_MOTION = 1000.0
"""Longest duration of a motion [s]; also the upper bound of ``time_to_go`` in the observation."""

REST_TOLERANCE = 1e-9
"""Largest velocity [m/s, rad/s] and acceleration [m/s², rad/s²] of a motion at rest."""


LARGEST_START_OFFSET = 0.05
"""Largest distance of the start pose from the reference [m]: half the environments' default
termination radius."""


def at_rest(reference: Reference) -> bool:
    """Whether the velocity and the acceleration of a motion are zero at an instant."""
    return all(
        np.max(np.abs(rate)) <= REST_TOLERANCE
        for rate in (reference.velocity, reference.acceleration)
    )


def start_pose(robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds) -> Array:
    """Start pose of the episodes of a motion, for every payload, shape (n,).

    It is the first pose of the motion. Under gravity, and for a motion that starts at rest, it is
    lower by half the position bound, at most by :data:`LARGEST_START_OFFSET`: the cables of the
    lower platform are steeper, so its motors hold more payload at rest. The paper's circle as
    printed accelerates from time 0 and is started on the reference.
    """
    start = trajectory(0.0)
    pose = np.array(start.position, float)
    if not robot.weightless and at_rest(start):
        pose[robot.dimensions - 1] += error_bounds.start_offset
    return pose


def check_workspace(
    robot: Robot, trajectory: Trajectory, tolerance: ErrorBounds | None = None
) -> None:
    """Checks the duration of a motion, and that it stays within the workspace of a robot.

    Args:
        robot: nominal robot.
        trajectory: the motion.
        tolerance: distance by which the motion may leave the workspace; None for zero.

    Raises:
        ValueError: if the motion is longer than :data:`LONGEST_MOTION` or leaves the workspace. The
            message gives the time, the coordinate and remedies.
    """
    if not 0 < trajectory.duration <= LONGEST_MOTION:
        raise ValueError(
            f"trajectory {trajectory.name!r} lasts {trajectory.duration:g} s: its duration must be > 0 and at most "
            f"{LONGEST_MOTION:g} s. Is it in ms? Then divide its times by 1000"
        )
    times = np.linspace(0.0, trajectory.duration, 1 + math.ceil(200 * trajectory.duration))
    poses = trajectory(times).position
    (low, high) = robot.pose_bounds
    slack = np.zeros(robot.coordinates)
    if tolerance is not None:
        slack[: robot.dimensions], slack[robot.dimensions :] = (
            tolerance.position,
            tolerance.rotation,
        )
    outside = (poses < low - slack) | (poses > high + slack)
    if np.any(outside):
        sample, channel = (int(index) for index in np.argwhere(outside)[0])
        symbol = COORDINATE_NAMES[robot.kind][channel]
        raise ValueError(
            f"trajectory {trajectory.name!r} leaves the workspace of {robot.name!r} at t = {times[sample]:.3f} s: "
            f"{symbol} = {poses[sample][channel]:.3g} is not within {low[channel]:.3g} to {high[channel]:.3g}; "
            f"{_remedy(robot, channel, poses[:, channel])}"
        )


def _remedy(robot: Robot, channel: int, values: Array) -> str:
    """What to do about a coordinate outside of the workspace, whose unit or sign may be another."""
    (low, high) = robot.pose_bounds[:, channel]
    largest = np.max(np.abs(values))
    if channel >= robot.dimensions:
        if largest > math.pi / 2:
            return "angles are in radians: multiply degrees by π/180"
    elif largest > 20 * max(abs(low), abs(high)):
        return "lengths are in metres: divide millimetres by 1000"
    is_vertical = channel == robot.dimensions - 1 and not robot.weightless
    if is_vertical and low <= -values.max() and -values.min() <= high:
        return vertical_remedy(robot)
    return "change the motion or the workspace"


def motion_questions(robot: Robot, trajectory: Trajectory) -> list[str]:
    """Questions about a motion that can be followed, but may not be the one that was meant: it
    starts far from the home pose, with the opposite sign of the vertical coordinate, or leaves the
    straight lines between its waypoints.

    Args:
        robot: nominal robot.
        trajectory: the motion.
    """
    d = robot.dimensions
    label = f"trajectory {trajectory.name!r}"
    questions = []
    home = robot.home[:d]
    start = trajectory(0.0).position[:d]
    distance = np.linalg.norm(start - home)
    size = np.linalg.norm(np.ptp(robot.pose_bounds[:, :d], axis=0))
    is_mirrored = 2 * abs(start[-1] + home[-1]) < abs(start[-1] - home[-1]) > size / 10
    doubt = ""
    if is_mirrored and not robot.weightless:
        doubt = f"is it mirrored? {vertical_remedy(robot)}"
    elif distance > size / 2:
        doubt = f"is it in the base frame of {robot.name!r}?"
    if doubt:
        questions.append(f"{label} starts {distance:.3g} m from home_pose: {doubt}")
    motion = getattr(trajectory, "motion", trajectory)
    if isinstance(motion, Waypoints):
        farthest, time, length = motion.deviation(d)
        if farthest > length / 10:
            remedy = "shorten the blends"
            if not motion.blend:
                blend = f"{np.diff(motion.times).min() / 2:.2g}"
                remedy = f'for straight lines, give it "blend": {blend}, a duration in s'
            questions.append(
                f"{label} leaves the lines between its waypoints by {1e3 * farthest:.4g} mm, {time:.2f} s after its "
                f"start, where they are {1e3 * length:.4g} mm long: is this meant? If not, {remedy}"
            )
    return questions


def payload_model_text(payload_known: bool, factor: float = 1.0) -> str:
    """The controller's payload model as text: ``payload known``, ``payload unknown``, ``payload
    model × 0.9``.

    Args:
        payload_known: whether the model includes a payload.
        factor: ratio of the model's payload to the nominal payload.
    """
    if not payload_known:
        return "payload unknown"
    return "payload known" if factor == 1.0 else f"payload model × {factor:g}"


def to_jsonable(value: Any) -> Any:
    """A value, such as a trajectory, as JSON-able data.

    A dataclass becomes a dict of its fields. A motion between dwells becomes that of the motion
    with the key ``dwell``, so that
    :func:`~cablebot_gym.motions.names.find_trajectory` accepts a
    named motion's data. Any other trajectory becomes a dict of its name, duration and coordinates.
    """
    if isinstance(value, BetweenDwells):
        return to_jsonable(value.motion) | {"dwell": value.dwell}
    if is_dataclass(value):
        return {field.name: to_jsonable(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Trajectory):
        return {
            "name": value.name,
            "duration": float(value.duration),
            "coordinates": int(value.coordinates),
        }
    if isinstance(value, Mapping):
        return {name: to_jsonable(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_jsonable(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
