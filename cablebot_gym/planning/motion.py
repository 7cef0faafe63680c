"""A planned motion and its margins to the constraints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.motions import ORDERS, Pieces, Reference
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

    def scaled(self, factor: float) -> MarginProfile:
        """The profile with each margin times a factor."""
        margins = {name: factor * values for name, values in vars(self).items()}
        return MarginProfile(**margins | {"times": self.times})

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
        return self._alone(times)

    def motor_motion(self, times: ArrayLike, payload: ArrayLike) -> tuple[Array, Array, Array]:
        """As :meth:`PlannedMotions.motor_motion`."""
        return self._alone.motor_motion(times, payload)

    @cached_property
    def _alone(self) -> PlannedMotions:
        return PlannedMotions([self])

    @cached_property
    def pose_pieces(self) -> Pieces:
        """X."""
        return Pieces.of_spline(self.knots, self.poses, self.degree)

    @cached_property
    def motor_pieces(self) -> Pieces:
        """β′ with the heaviest payload and, if planned, with the lightest one, one after the other."""
        inner = self.degree - MOTOR_DEGREE
        points = np.concatenate(self.motors, axis=1)
        return Pieces.of_spline(self.knots[inner:-inner], points, MOTOR_DEGREE)

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


class PlannedMotions:
    """Planned motions of a batch, one for each row, evaluated together.

    Args:
        plans: the motion of each row, or one for all. All are of the same kind of robot.
    """

    def __init__(self, plans: Sequence[PlannedMotion]) -> None:
        distinct = list(dict.fromkeys(plans))
        self._curve: int | NDArray[np.int64] = 0
        if len(distinct) > 1:
            self._curve = np.array([distinct.index(plan) for plan in plans])
        self._poses = Pieces.joined([plan.pose_pieces for plan in distinct])
        self._motors: Pieces | None = None
        if distinct[0].motors:
            self._motors = Pieces.joined([plan.motor_pieces for plan in distinct])
        self._payloads = len(distinct[0].motors)
        self.duration = self._of("duration", distinct)
        """Duration of each motion [s]; one number if there is one for all, as in the next values."""
        self.payload = self._of("payload", distinct)
        """Heaviest payload [kg]."""
        self.lightest = self._of("lightest", distinct)
        """Lightest payload [kg]."""
        self.minimum_tension = self._of("minimum_tension", distinct)
        """Minimum tension of all cables [N]."""

    def _of(self, name: str, distinct: Sequence[PlannedMotion]) -> Array:
        values: Array = np.array([getattr(plan, name) for plan in distinct])[self._curve]
        return values

    def __call__(self, times: ArrayLike) -> Reference:
        """The motions at ``times`` [s]. After its end a robot rests at its last pose."""
        derivatives = self._poses(self._curve, np.asarray(times, float), len(ORDERS))
        return Reference(**dict(zip(ORDERS, derivatives, strict=True)))

    def motor_motion(self, times: ArrayLike, payload: ArrayLike) -> tuple[Array, Array, Array]:
        """Motor angles β′ [rad], speeds β̇′ and accelerations β̈′ of flexible robots, each (..., m).

        With two planned payloads they are affine in the payload, like the balance of forces.

        Args:
            times: times since the start of the motion [s].
            payload: payload [kg].
        """
        assert self._motors is not None
        values = self._motors(self._curve, np.asarray(times, float), 3)
        if self._payloads > 1:
            heaviest, lightest = np.split(values, 2, axis=-1)
            fraction = (payload - self.lightest) / (self.payload - self.lightest)
            values = lightest + fraction[..., None] * (heaviest - lightest)
        angle, speed, acceleration = values
        return angle, speed, acceleration
