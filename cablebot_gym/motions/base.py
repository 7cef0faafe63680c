"""Motions as functions of time: the protocol, the values of a motion, and a base class."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeGuard, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.motions.derivatives import scaled
from cablebot_gym.robots import COORDINATE_NAMES, Kind
from cablebot_gym.utils.checks import number, numbers

COORDINATES: dict[Kind, int] = {kind: len(names) for kind, names in COORDINATE_NAMES.items()}
"""Number of coordinates by kind of robot: ``(x, y)``, ``(x, y, φ)``, ``(x, y, z)`` or ``(x, y, z,
ψ, θ, φ)``."""


POSE_SHAPES = ((2,), (3,), (6,))
"""Shapes of poses."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """The reference motion at given times. Each array has the shape of the times plus a last axis
    of n coordinates."""

    position: Array
    """Reference pose X_d, shape (..., n) [m, rad]."""
    velocity: Array
    """First time derivative, shape (..., n) [m/s, rad/s]."""
    acceleration: Array
    """Second time derivative, shape (..., n) [m/s², rad/s²]."""
    jerk: Array
    """Third time derivative, shape (..., n) [m/s³, rad/s³]."""
    snap: Array
    """Fourth time derivative, shape (..., n) [m/s⁴, rad/s⁴]."""


RATES = ("velocity", "acceleration", "jerk", "snap")
"""Time derivatives of the position, by order."""

ORDERS = ("position", *RATES)
"""Orders of a motion: position and its time derivatives."""


@runtime_checkable
class Trajectory(Protocol):
    """A reference motion from time 0 to ``duration``."""

    @property
    def name(self) -> str:
        """Name shown in tables and error messages."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]; > 0 and finite."""

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose, see :data:`COORDINATES`."""

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], a number or an array of any shape.

        A time before 0 is treated as 0. A time after ``duration`` gives the last pose at rest.
        ``duration`` itself still belongs to the motion.
        """


def is_trajectory(value: object) -> TypeGuard[Trajectory]:
    """Whether a value is a trajectory. A class has the attributes of its objects, but is none."""
    return isinstance(value, Trajectory) and not isinstance(value, type)


def checked_times(times: ArrayLike) -> Array:
    """Times as an array; infinite ones are before or after the motion.

    Raises:
        ValueError: if a time is NaN.
    """
    checked = np.asarray(times, float)
    if np.isnan(checked).any():
        raise ValueError("times must be numbers, without NaN")
    return checked


BLEND = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
"""Blend polynomial s(u) of C⁴ motions: the polynomial of lowest degree with s(0) = 0 and s(1) = 1
whose first four derivatives are zero at both ends."""


# Coefficients are padded with zeros, so that one call evaluates all orders.
_BLEND_DERIVATIVES = np.zeros((10, 5))
for _order in range(5):
    _coefficients = BLEND.deriv(_order).coef
    _BLEND_DERIVATIVES[: len(_coefficients), _order] = _coefficients
"""Coefficients of s and of its derivatives 1 to 4, one column each, shape (10, 5)."""


def unit_blend(fraction: Array) -> Array:
    """s and its derivatives 1 to 4 at fractions of the duration, shape (5, ...)."""
    return np.asarray(np.polynomial.polynomial.polyval(fraction, _BLEND_DERIVATIVES), float)


class Motion:
    """Base of the motions of this package: clamps the time and checks the duration and the poses."""

    name: str
    duration: float
    _POSES: ClassVar[tuple[str, ...]] = ("center",)
    """Names of the fields that are poses."""

    def __post_init__(self) -> None:
        number("duration", self.duration, above=0, unit="s")
        form = "(x, y), (x, y, φ), (x, y, z) or (x, y, z, ψ, θ, φ), by the kind of robot"
        for field in self._POSES:
            self._set_numbers(field, shapes=POSE_SHAPES, form=form)

    def _set_numbers(self, field: str, **form: Any) -> None:
        """Checks the numbers of a field and converts them to a tuple."""
        values = numbers(field, getattr(self, field), **form)
        object.__setattr__(self, field, tuple(values.tolist()))

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(getattr(self, self._POSES[0]))

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], see :class:`Trajectory`."""
        times = checked_times(times)
        derivatives = self._derivatives(np.clip(times, 0.0, self.duration))
        # A motion may end with a velocity; the protocol wants rest after the end, not at it.
        derivatives[1:, times > self.duration] = 0.0
        return Reference(**dict(zip(ORDERS, derivatives, strict=True)))

    def _derivatives(self, time: Array) -> Array:
        """Position to snap for times in [0, duration], shape (5, ..., n), in a new array."""
        raise NotImplementedError

    def _blend(self, time: Array) -> Array:
        """Time derivatives 0 to 4 of :data:`BLEND`, scaled to the duration, shape (5, ...)."""
        return scaled(unit_blend(time / self.duration), 1 / self.duration)


def sampled(trajectory: Trajectory, times: Array, orders: tuple[str, ...] = ORDERS) -> list[Array]:
    """The ``orders`` of a motion at times (k,) [s], each (k, n). A custom motion may return
    anything: it is checked.

    Raises:
        ValueError: if the motion does not return a :class:`Reference`, or a shape is wrong, or a
            number is not finite.
    """
    label = f"trajectory {trajectory.name!r}"
    shape = (len(times), trajectory.coordinates)
    motion = trajectory(times)
    if not isinstance(motion, Reference):
        raise ValueError(f"{label} must return a Reference, not {type(motion).__name__}")
    samples = [np.asarray(getattr(motion, name)) for name in orders]
    for name, values in zip(orders, samples, strict=True):
        if values.shape != shape:
            raise ValueError(
                f"{label} must return a {name} of shape {shape} for {shape[0]} times, not {values.shape}"
            )
        if values.dtype.kind not in "iuf":
            raise ValueError(f"{label} must return a {name} of numbers, not of {values.dtype}")
        if not np.all(np.isfinite(values)):
            time = times[np.flatnonzero(~np.all(np.isfinite(values), axis=1))[0]]
            raise ValueError(
                f"{label} must return finite numbers: its {name} at {time:g} s is not finite"
            )
    return samples
