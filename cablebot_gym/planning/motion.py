"""A planned motion, and what a plan leaves unused of the limits."""

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
from cablebot_gym.trajectories import Reference

MOTOR_DEGREE = 3
"""Of the splines of β′: β̈′, which asks most of the torque, is linear between knots and does not swing."""

RIGID_DEGREE, FLEXIBLE_DEGREE = 3, MOTOR_DEGREE + 2
"""Of the spline of X: Ẍ as smooth as the torques of a rigid robot, or as the motor angles of a flexible one."""


@dataclass(frozen=True, kw_only=True)
class Margins:
    """What a planned motion leaves unused of each limit, for feedback to correct errors with.

    Raises:
        ValueError: if a margin is negative or not finite.
    """

    position: float = 0.0
    """Of the bound of the position error [m]."""
    rotation: float = 0.0
    """Of the bound of the rotation error [rad]."""
    demand: float = 0.0
    """Of the drive commands' ±1; below 1."""
    tension: float = 0.0
    """Least tension [N]."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            most = 1.0 if item.name == "demand" else math.inf
            if not 0 <= value < most:
                raise ValueError(f"margins: {item.name} must be at least 0 and below {most:g}, not {value!r}")

    def scaled(self, factor: float) -> Margins:
        """Every margin times a factor."""
        return Margins(**{item.name: factor * getattr(self, item.name) for item in fields(self)})


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion:
    """A motion as a spline, which is a :class:`~cablebot_gym.trajectories.Trajectory` and may be followed like one."""

    name: str
    """Of the motion whose tube it keeps."""
    knots: Array
    """Of the spline, clamped at both ends [s]."""
    poses: Array
    """Control points, (count, n)."""
    motors: tuple[Array, ...]
    """Control points of the motor angles β′ of a flexible robot with the heaviest and the lightest payload, each
    (count, m) [rad]; empty: rigid."""
    payload: float
    """Heaviest payload that the motion is for [kg]; every lighter one down to ``lightest`` is possible as well."""
    lightest: float
    """Lightest payload that the motion is for [kg]."""
    minimum_tension: float
    """What every cable keeps [N]."""

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.knots[-1])

    @property
    def coordinates(self) -> int:
        """n."""
        return int(self.poses.shape[1])

    @property
    def degree(self) -> int:
        """Of the spline of X."""
        return len(self.knots) - len(self.poses) - 1

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times``; after its end it rests at its last pose."""
        times = np.asarray(times, float)
        values = [spline(np.clip(times, 0.0, self.duration)) for spline in self._derivatives]
        for value in values[1:]:
            value[times > self.duration] = 0.0
        position, velocity, acceleration, jerk, snap = values
        return Reference(position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap)

    @cached_property
    def _derivatives(self) -> list[Any]:
        """Orders 0 to 4; beyond the degree they are zero wherever they exist."""
        spline, nothing = (BSpline(self.knots, values, self.degree) for values in (self.poses, 0 * self.poses))
        return [spline, *(spline.derivative(d) if d <= self.degree else nothing for d in (1, 2, 3, 4))]

    def motor_motion(self, times: ArrayLike, payload: ArrayLike) -> tuple[Array, Array, Array]:
        """β′ [rad], β̇′ and β̈′ of a flexible robot with a payload [kg] at times [s], each (..., m).

        Between two payloads they are affine in the payload, as the balance of forces is.
        """
        values = [spline(np.clip(times, 0.0, self.duration)) for spline in self._motor_derivatives]
        if len(self.motors) == 1:
            angle, speed, acceleration = (value[..., 0, :] for value in values)
        else:
            share = (np.asarray(payload, float) - self.lightest) / (self.payload - self.lightest)
            angle, speed, acceleration = (
                value[..., 1, :] + share[..., None] * (value[..., 0, :] - value[..., 1, :]) for value in values
            )
        return angle, speed, acceleration

    @cached_property
    def _motor_derivatives(self) -> list[Any]:
        inner = self.degree - MOTOR_DEGREE
        spline = BSpline(self.knots[inner:-inner], np.stack(self.motors, axis=1), MOTOR_DEGREE)
        return [spline, spline.derivative(1), spline.derivative(2)]

    def to_arrays(self) -> dict[str, Array]:
        """Everything as arrays by name; :meth:`from_arrays` reads them."""
        numbers = np.array([self.payload, self.lightest, self.minimum_tension])
        motors = {f"motors{place}": values for place, values in enumerate(self.motors)}
        return {"name": np.array(self.name), "knots": self.knots, "poses": self.poses, "numbers": numbers, **motors}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> PlannedMotion:
        """A motion from :meth:`to_arrays`, or from a file of them.

        Raises:
            KeyError: if one is missing.
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
