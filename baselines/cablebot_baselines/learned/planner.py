"""A network that plans the platform's acceleration at every control step, behind the observer of a
robot that is not exactly known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.law import Array
from cablebot_baselines.classical.observer_law import (
    UNCERTAINTY,
    Instant,
    ObserverLaw,
    observed_gains,
)
from cablebot_baselines.estimation.expectation import Expectation
from cablebot_baselines.learned.network import Network
from cablebot_gym.physics.textbook import allocated_minimum
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, Task
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.uncertainty import find_uncertainty
from cablebot_gym.utils.checks import number, numbers

RATE_TIME = 0.05
"""Time that scales errors of the velocity: bound per time [s]."""

MASS_SCALE = 10.0
"""Mass that scales the reciprocal of the mass, an input of the network [kg]."""

PREVIEW_TIMES = np.linspace(0.0, 0.2, 21)
"""Times after the instant at which the action takes effect whose reference the network reads [s]."""

_MEAN_TIMES = PREVIEW_TIMES[1::2]

WALL_GAINS = (3600.0, 120.0)
"""(K_P, K_D) with which the platform comes to the wall of its tube [1/s², 1/s]."""


@dataclass(frozen=True, kw_only=True)
class Planning:
    """Accelerations Ẍ = Ẍ_d + K_P e + K_D ė + ``acceleration`` · network, in place of those of the
    reference, and :func:`confined` to a tube around it.

    Raises:
        ValueError: if a number is out of its range.
    """

    kind: ClassVar[str] = "planning"

    acceleration: float = 5.0
    """Acceleration of an output of 1 [m/s²]; > 0."""
    angular_acceleration: float = 20.0
    """Angular acceleration of an output of 1 [rad/s²]; > 0."""
    gains: tuple[float, float] = (900.0, 60.0)
    """(K_P, K_D) with which a network without output tracks the reference [1/s², 1/s]."""
    tension: float = 5.0
    """Least tension that the law allocates with more cables than coordinates [N]."""
    wall: float = 0.98
    """Radius of the tube, as a fraction of the error bounds; in (0, 1)."""
    payload_prior: float = 1.6
    """Largest payload that is considered possible if it is unknown, as a multiple of that with
    which the motors can track the reference exactly; > 0."""

    def __post_init__(self) -> None:
        for name in ("acceleration", "angular_acceleration", "payload_prior"):
            number(name, getattr(self, name), above=0.0)
        number("tension", self.tension, least=0.0)
        number("wall", self.wall, above=0.0, below=1.0)
        checked = numbers("gains", self.gains, shapes=[(2,)], above=0.0)
        gains = tuple(checked.tolist())
        object.__setattr__(self, "gains", gains)

    def scale(self, robot: Robot) -> Array:
        """Acceleration of an output of 1, (n,) [m/s², rad/s²]."""
        return _by_coordinate(robot, self.acceleration, self.angular_acceleration)


def _by_coordinate(robot: Robot, position: float, rotation: float) -> Array:
    """A value for each coordinate, (n,)."""
    indices = np.arange(robot.coordinates)
    return np.where(indices < robot.dimensions, position, rotation)


def error_scale(robot: Robot, error_bounds: ErrorBounds) -> Array:
    """Error bound of each coordinate, (n,) [m, rad]."""
    return _by_coordinate(robot, error_bounds.position, error_bounds.rotation)


def confined(
    error: Array, rate: Array, acceleration: Array, wall: float, is_position: Array
) -> Array:
    """Accelerations of the error that come closest to given ones and keep the error in a tube.

    On the way to the wall the distance d = ``wall`` − |e| obeys d̈ ≥ −K_D ḋ − K_P d with
    :data:`WALL_GAINS`, whose poles are real, so that d does not change its sign. |e| is the length
    of the position's error and the absolute value of each rotation's.

    Args:
        error: error in units of the error bounds, (..., n).
        rate: its rate [1/s].
        acceleration: its acceleration [1/s²].
        wall: radius of the tube, in units of the error bounds.
        is_position: 1 for coordinates of the position, 0 for those of the rotation, (n,).
    """
    pose_gain, rate_gain = WALL_GAINS
    upper = pose_gain * (wall - error) - rate_gain * rate
    lower = -pose_gain * (wall + error) - rate_gain * rate
    # For a position this bounds the speed across the direction outward.
    confined_by_coordinate = acceleration.clip(lower, upper)
    position = error * is_position
    velocity = rate * is_position
    distance = (_total(position**2) + 1e-12) ** 0.5
    outward = position / distance
    speed = _total(outward * rate)
    # A motion across the direction moves the error outward as well.
    squared_speed_across = _total(velocity**2) - speed**2
    centrifugal = squared_speed_across / (distance + wall / 10)
    limit = pose_gain * (wall - distance) - rate_gain * speed - centrifugal
    excess = _total(outward * confined_by_coordinate) - limit
    excess = excess.clip(0.0, math.inf)
    return confined_by_coordinate - excess * outward


def _total(values: Array) -> Array:
    """Sum over the last axis, (..., 1)."""
    total: Array = values.sum(-1)
    return total[..., None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Preview:
    """The reference at instants and after them; each array has the shape of the instants in
    front."""

    position: Array
    """X_d, (..., n)."""
    velocity: Array
    """Ẋ_d, (..., n)."""
    acceleration: Array
    """Ẍ_d, (..., n)."""
    inputs: Array
    """Inputs of the network: Ẍ_d at :data:`PREVIEW_TIMES`, and mean accelerations until some of
    them, (..., inputs)."""

    @classmethod
    def of(cls, trajectory: Trajectory, instants: Array) -> Preview:
        """The preview of a motion at instants (...) [s]."""
        instants = np.asarray(instants)[..., None]
        reference = trajectory(instants + PREVIEW_TIMES)
        position = reference.position[..., 0, :]
        velocity = reference.velocity[..., 0, :]
        times = _MEAN_TIMES[:, None]
        moved = reference.position[..., 1::2, :] - position[..., None, :]
        coasted = times * velocity[..., None, :]
        means = 2 * (moved - coasted) / times**2
        shape = (*position.shape[:-1], -1)
        inputs = [reference.acceleration.reshape(shape), means.reshape(shape)]
        return cls(
            position=position,
            velocity=velocity,
            acceleration=reference.acceleration[..., 0, :],
            inputs=np.concatenate(inputs, axis=-1),
        )


def network_inputs(
    *, error: Any, rate: Any, preview: Any, pose: Any, velocity: Any, known: Sequence[Any]
) -> list[Any]:
    """The inputs of the network in their order, each (..., size); arrays or tensors.

    Args:
        error: pose minus reference, in units of the error bounds.
        rate: its rate, in bounds per :data:`RATE_TIME`.
        preview: :attr:`Preview.inputs`.
        pose: X.
        velocity: Ẋ.
        known: :func:`robot_inputs`.
    """
    return [error, rate, preview, pose, velocity, *known]


def robot_inputs(mass: Any, strength: Any, disturbance: Any) -> list[Any]:
    """Inputs that describe the robot: mass (..., 1) [kg], its reciprocal, strengths of the motors
    (..., m) and acceleration by the wrench (..., n)."""
    return [mass, MASS_SCALE / mass, strength, disturbance]


def input_count(robot: Robot) -> int:
    """Number of inputs of the network."""
    previewed = len(PREVIEW_TIMES) + len(_MEAN_TIMES)
    # Error, rate, pose, velocity and disturbance; mass and its reciprocal.
    per_coordinate = 5 + previewed
    return per_coordinate * robot.coordinates + 2 + robot.cables


class PlanningPolicy(ObserverLaw):
    """A network plans the platform's acceleration within the error bounds.

    It reads the pose and velocity that the observer expects at the instant at which the action
    takes effect, its estimates of mass, motors and wrench, and the reference of the next 0.2 s. A
    law computes the torques of the acceleration with these estimates.

    Without a call of ``reset`` the motion is unknown, and the policy tracks the reference.

    Args:
        robot: nominal rigid robot.
        network: network from :func:`network_inputs` to accelerations in units of ``planning``.
        planning: meaning of the outputs.

    Raises:
        ValueError: if the robot is flexible, or the network is not for it.
    """

    def __init__(self, robot: Robot, network: Network, planning: Planning) -> None:
        if robot.flexible:
            raise ValueError(f"a planning network needs a rigid robot, not {robot.springs}")
        sizes = (network.inputs, network.outputs)
        expected = (input_count(robot), robot.coordinates)
        if sizes != expected:
            raise ValueError(
                f"the network has inputs and outputs {sizes}, but a planning network of robot "
                f"{robot.name!r} has {expected}"
            )
        uncertainty = find_uncertainty(UNCERTAINTY, robot)
        expectation = Expectation.of(robot, uncertainty)
        law = FeedbackLinearization(
            expectation.robot,
            gains=observed_gains(robot),
            minimum_tension=allocated_minimum(robot, planning.tension),
        )
        super().__init__(law, expectation, payload_prior=planning.payload_prior)
        self.network = network
        self.planning = planning
        self._scale = planning.scale(robot)

    def reference(self, instant: Instant, memory: Any) -> tuple[dict[str, Array], Any]:
        """The expected state and the planned acceleration in place of the reference."""
        if not self._tasks:
            return super().reference(instant, memory)
        estimate, ahead = instant.estimate, instant.ahead
        acceleration = np.empty_like(ahead["pose"])
        for task, rows in self._rows_by_motion(len(acceleration)):
            preview = Preview.of(task.trajectory, instant.time(task, rows))
            robot = robot_inputs(
                mass=estimate.mass[rows, None],
                strength=estimate.strength[rows],
                disturbance=ahead["disturbance"][rows],
            )
            pose = ahead["pose"][rows]
            velocity = ahead["velocity"][rows]
            acceleration[rows] = self._planned(task, pose, velocity, preview, robot)
        planned = {
            "reference_pose": ahead["pose"],
            "reference_velocity": ahead["velocity"],
            "reference_acceleration": acceleration,
        }
        return planned, memory

    def _planned(
        self, task: Task, pose: Array, velocity: Array, preview: Preview, robot: list[Array]
    ) -> Array:
        """Planned accelerations, (N, n)."""
        bounds = error_scale(self.robot, task.error_bounds)
        wall = self.planning.wall
        error = pose - preview.position
        rate = velocity - preview.velocity
        inputs = network_inputs(
            error=error / bounds,
            rate=RATE_TIME * rate / bounds,
            preview=preview.inputs,
            pose=pose,
            velocity=velocity,
            known=robot,
        )
        pose_gain, rate_gain = self.planning.gains
        output = self.network(np.concatenate(inputs, axis=-1))
        acceleration = self._scale * output - pose_gain * error - rate_gain * rate
        is_position = _by_coordinate(self.robot, 1.0, 0.0)
        deviation = confined(
            error / bounds, rate / bounds, acceleration / bounds, wall, is_position
        )
        planned: Array = preview.acceleration + bounds * deviation
        return planned
