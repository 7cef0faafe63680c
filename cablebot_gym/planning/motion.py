"""A planned motion and its margins to the constraints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Reference
from cablebot_gym.utils.checks import number

MOTOR_DEGREE = 3
"""Degree of the splines of β′. β̈′ dominates the torque; it is linear between knots and does not
oscillate."""

RIGID_DEGREE, FLEXIBLE_DEGREE = 3, MOTOR_DEGREE + 2
"""Degree of the spline of X. Ẍ is as smooth as the torques of a rigid robot or the motor angles of
a flexible one."""


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Margins of a planned motion to the constraints, which leave room for feedback.

    Raises:
        ValueError: if a margin is negative or not finite.
    """

    position: float = 0.0
    """Margin to the position error bound [m]; ≥ 0."""
    rotation: float = 0.0
    """Margin to the rotation error bound [rad]; ≥ 0."""
    action: float = 0.0
    """Margin of the actions to ± 1; ≥ 0 and < 1."""
    tension: float = 0.0
    """Margin to the minimum and the maximum tension of the robot, for all cables [N]; ≥ 0."""

    def __post_init__(self) -> None:
        for item in fields(self):
            below = 1.0 if item.name == "action" else math.inf
            number(f"margins: {item.name}", getattr(self, item.name), least=0.0, below=below)


@dataclass(frozen=True, kw_only=True, eq=False)
class MarginProfile:
    """Margins over time that a motion keeps in addition to its :class:`Margins`.

    A limit that a replay exceeds for a few milliseconds then costs payload at these instants only.
    """

    times: Array
    """Increasing times since the start of the motion, shape (k,) [s]."""
    position: Array
    """Additional margin to the position error bound, shape (k,) [m]; ≥ 0."""
    rotation: Array
    """Additional margin to the rotation error bound, shape (k,) [rad]; ≥ 0."""
    action: Array
    """Additional margin of the action of each motor to ± 1, shape (k, m); ≥ 0."""
    tension: Array
    """Additional margin to the minimum and the maximum tension of all cables, shape (k,) [N]; ≥ 0."""

    @classmethod
    def zeros(cls, times: Array, cables: int) -> MarginProfile:
        """No additional margins at ``times`` [s] for a number of cables."""
        zero = np.zeros(len(times))
        action = np.zeros((len(times), cables))
        return cls(times=times, position=zero, rotation=zero, action=action, tension=zero)

    def largest(self, name: str, instants: Array, reach: float) -> Array:
        """Largest margin of a limit within ``reach`` [s] of each instant, shape (instants, ...); 0
        where no time is in reach."""
        values = getattr(self, name)
        begins = np.searchsorted(self.times, instants - reach, side="left")
        ends = np.searchsorted(self.times, instants + reach, side="right")
        return np.array(
            [
                values[begin:end].max(axis=0, initial=0.0)
                for begin, end in zip(begins, ends, strict=True)
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion:
    """A planned motion as a spline. It implements
    :class:`~cablebot_gym.motions.base.Trajectory`."""

    name: str
    """Name of the reference motion."""
    knots: Array
    """Knots of the spline, clamped at both ends [s]."""
    poses: Array
    """Control points of the pose, shape (count, n) [m, rad]."""
    motors: tuple[Array, ...]
    """Control points of the motor angles β′ of a flexible robot, each (count, m) [rad]: with the
    heaviest payload and, if planned, with the lightest payload. Empty if rigid."""
    payload: float
    """Heaviest payload of the motion [kg]. All payloads from ``lightest`` to this one are
    feasible."""
    lightest: float
    """Lightest payload of the motion [kg]."""
    minimum_tension: float
    """Minimum tension of all cables [N]."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.knots[-1])

    @property
    def coordinates(self) -> int:
        """Number of coordinates n."""
        return int(self.poses.shape[1])

    @property
    def degree(self) -> int:
        """Degree of the spline of X."""
        return len(self.knots) - len(self.poses) - 1

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s]. After its end the robot rests at the last pose."""
        times = np.asarray(times, float)
        values = [spline(np.clip(times, 0.0, self.duration)) for spline in self._derivatives]
        for value in values[1:]:
            value[times > self.duration] = 0.0
        position, velocity, acceleration, jerk, snap = values
        return Reference(
            position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap
        )

    @cached_property
    def _derivatives(self) -> list[Any]:
        """Splines of the derivatives 0 to 4; those above the degree are zero."""
        spline, zero = (
            BSpline(self.knots, values, self.degree) for values in (self.poses, 0 * self.poses)
        )
        return [spline, *(spline.derivative(d) if d <= self.degree else zero for d in (1, 2, 3, 4))]

    def motor_motion(self, times: ArrayLike, payload: ArrayLike) -> tuple[Array, Array, Array]:
        """Motor angles β′ [rad], speeds β̇′ and accelerations β̈′ of a flexible robot, each (...,
        m).

        With two planned payloads they are affine in the payload, like the balance of forces.

        Args:
            times: times since the start of the motion [s].
            payload: payload [kg].
        """
        values = [spline(np.clip(times, 0.0, self.duration)) for spline in self._motor_derivatives]
        if len(self.motors) == 1:
            angle, speed, acceleration = (value[..., 0, :] for value in values)
        else:
            fraction = (np.asarray(payload, float) - self.lightest) / (self.payload - self.lightest)
            angle, speed, acceleration = (
                value[..., 1, :] + fraction[..., None] * (value[..., 0, :] - value[..., 1, :])
                for value in values
            )
        return angle, speed, acceleration

    @cached_property
    def _motor_derivatives(self) -> list[Any]:
        inner = self.degree - MOTOR_DEGREE
        spline = BSpline(self.knots[inner:-inner], np.stack(self.motors, axis=1), MOTOR_DEGREE)
        return [spline, spline.derivative(1), spline.derivative(2)]

    def to_arrays(self) -> dict[str, Array]:
        """The motion as arrays by name, which :meth:`from_arrays` reads."""
        numbers = np.array([self.payload, self.lightest, self.minimum_tension])
        motors = {f"motors{index}": values for index, values in enumerate(self.motors)}
        return {
            "name": np.array(self.name),
            "knots": self.knots,
            "poses": self.poses,
            "numbers": numbers,
            **motors,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> PlannedMotion:
        """A motion from the arrays of :meth:`to_arrays` or from an ``.npz`` file of them.

        Raises:
            KeyError: if an array is missing.
        """
        payload, lightest, tension = arrays["numbers"].tolist()
        return cls(
            name=str(arrays["name"]),
            knots=arrays["knots"],
            poses=arrays["poses"],
            motors=tuple(arrays[name] for name in ("motors0", "motors1") if name in arrays),
            payload=payload,
            lightest=lightest,
            minimum_tension=tension,
        )
