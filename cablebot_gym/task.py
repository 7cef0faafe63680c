"""What a policy may know before an episode starts: the public task, and the limits that its motion has to keep."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any

import numpy as np

from cablebot_gym.robots import Cable, Robot
from cablebot_gym.trajectories import Trajectory


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Bounds of the tracking error. The motors' limits belong to the robot.

    Raises:
        ValueError: if a bound is not a positive number.
    """

    position: float = 0.01
    """R, largest distance from the reference at the same instant [m] (Tables 7–9); > 0."""
    rotation: float = 0.01
    """Largest difference of ψ, θ or φ from the reference [rad] (ours); > 0. A planar robot has no rotation."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, Real) or isinstance(value, bool) or not math.isfinite(value) or value <= 0:
                raise ValueError(f"limits: {field.name} must be a number greater than 0, not {value!r}")
            object.__setattr__(self, field.name, float(value))

    @property
    def termination_radius(self) -> float:
        """Position error beyond which an episode that is judged by these limits may end [m]: well out of the tube."""
        return max(0.1, 2 * self.position)

    def replace(self, **changes: float) -> Limits:
        """A copy with some bounds changed, as ``changes`` say."""
        return replace(self, **changes)


def find_limits(limits: Limits | dict[str, float] | None) -> Limits:
    """Limits from themselves, from ``{"position": …, "rotation": …}``, or the default for None.

    Raises:
        ValueError: if a key is unknown or a bound is not positive.
    """
    if limits is None:
        return Limits()
    if isinstance(limits, Limits):
        return limits
    known = [field.name for field in fields(Limits)]
    if not isinstance(limits, dict) or set(limits) - set(known):
        raise ValueError(f"limits must be a Limits or a dict with keys out of {', '.join(known)}, not {limits!r}")
    return Limits(**limits)


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """One episode as the controller is told it. Never holds the true payload, true parameters or a seed."""

    robot: Robot
    """Nominal robot, without payload."""
    trajectory: Trajectory
    """Reference motion."""
    limits: Limits
    """Bounds of the tracking error."""
    control_frequency: float
    """Drive commands per second [Hz]."""
    cable: Cable
    """Whether cables can push."""
    told_payload: float
    """Payload that the controller is told [kg]; 0 if it is not known."""
    payload_known: bool
    """Whether the payload is told."""

    @property
    def steps(self) -> int:
        """Control steps of the whole motion."""
        return round(self.trajectory.duration * self.control_frequency)

    def check_motion(self) -> None:
        """Refuses a motion that nobody can follow.

        Raises:
            ValueError: if the motion is shorter than half a control period, or leaves the robot's workspace farther
                than the limits let the robot stay behind.
        """
        if self.steps < 1:
            motion = f"trajectory {self.trajectory.name!r} of {self.trajectory.duration:g} s"
            raise ValueError(f"{motion} is shorter than a control period: give it a longer duration")
        check_workspace(self.robot, self.trajectory, self.limits)


def check_workspace(robot: Robot, trajectory: Trajectory, behind: Limits | None = None) -> None:
    """Refuses a motion that leaves the workspace of a robot.

    Args:
        robot: nominal.
        trajectory: the motion.
        behind: how far it may leave it; None for not at all.

    Raises:
        ValueError: saying where, and what to do.
    """
    times = np.linspace(0.0, trajectory.duration, 1 + math.ceil(200 * trajectory.duration))
    poses, (low, high) = trajectory(times).position, robot.pose_bounds
    slack = np.zeros(robot.coordinates)
    if behind is not None:
        slack[:3], slack[3:] = behind.position, behind.rotation
    outside = (poses < low - slack) | (poses > high + slack)
    if np.any(outside):
        place, channel = (int(index) for index in np.argwhere(outside)[0])
        raise ValueError(
            f"trajectory {trajectory.name!r} leaves the workspace of {robot.name!r} at t = {times[place]:.3f} s: "
            f"{'xyzψθφ'[channel]} = {poses[place][channel]:.3g} is not within {low[channel]:.3g} to "
            f"{high[channel]:.3g}; make it smaller, move it, or give the robot a wider workspace"
        )


def as_plain(value: Any) -> Any:
    """A value, such as a trajectory, as JSON-able data; of one that is no dataclass, what the protocol promises."""
    if isinstance(value, Trajectory) and not hasattr(value, "__dataclass_fields__"):
        return {"name": value.name, "duration": float(value.duration), "coordinates": int(value.coordinates)}
    if hasattr(value, "__dataclass_fields__"):
        return {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: as_plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
