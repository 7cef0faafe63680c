"""Motions in closed form: circles, dwells, lines and lemniscates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.motions.base import Motion
from cablebot_gym.motions.derivatives import (
    circle,
    in_plane,
    scaled,
    sine_derivatives,
    turn_from_rest,
)
from cablebot_gym.utils.checks import number


@dataclass(frozen=True, kw_only=True)
class Circle(Motion):
    """A turn on a circle about a pose, with the fields that both kinds of it share."""

    radius: float
    """Radius of the circle [m]; > 0. Table 1: 0.2165, Table 3: 0.1."""
    center: tuple[float, ...]
    """Center pose, shape (n,); all coordinates except x and y stay constant. Table 3: (0, 0, 0.1,
    0.1, 0.1, 0.1)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        number("radius", self.radius, above=0, unit="m")


@dataclass(frozen=True, kw_only=True)
class PaperCircle(Circle):
    """The paper's circle (Tables 1 and 3). The motion accelerates over one half turn and
    decelerates over the other.

    With u = t / duration: ``(x, y) = radius (cos 4πu², sin 4πu²)`` for u ≤ 0.5, then ``radius (cos
    4π(1−u)², −sin 4π(1−u)²)``, about ``center``. The angular acceleration jumps from +8π to −8π rad
    per duration² right after u = 0.5, where the first branch is still valid. It is not zero at
    either end. Only position and velocity are continuous, so no robot with flexible joints can
    follow the circle exactly.

    Raises:
        ValueError: if a length, time or pose is invalid.
    """

    duration: float = 1.0
    """Duration of the turn [s]; > 0. Tables 1 and 3: 1 s."""
    name: str = "paper-circle"
    """Name shown in tables and error messages."""

    def _derivatives(self, time: Array) -> Array:
        angle = turn_from_rest(time / self.duration)
        return circle(self.center, self.radius, scaled(angle, 1 / self.duration))


@dataclass(frozen=True, kw_only=True)
class SmoothCircle(Circle):
    """One C⁴ turn on the paper's circle from the same start. The angle goes from 0 to 2π along
    :data:`~cablebot_gym.motions.base.BLEND`.

    Raises:
        ValueError: if a length, time or pose is invalid.
    """

    duration: float = 2.0
    """Duration of the turn [s]; > 0."""
    name: str = "smooth-circle"
    """Name shown in tables and error messages."""

    def _derivatives(self, time: Array) -> Array:
        return circle(self.center, self.radius, 2 * np.pi * self._blend(time))


@dataclass(frozen=True, kw_only=True)
class Dwell(Motion):
    """A dwell: the robot rests at one pose.

    Raises:
        ValueError: if the duration or the pose is invalid.
    """

    pose: tuple[float, ...]
    """The pose, shape (n,)."""
    duration: float = 1.0
    """Duration of the dwell [s]; > 0."""
    name: str = "dwell"
    """Name shown in tables and error messages."""
    _POSES = ("pose",)

    def _derivatives(self, time: Array) -> Array:
        derivatives = np.zeros((5, *time.shape, self.coordinates))
        derivatives[0] = self.pose
        return derivatives


@dataclass(frozen=True, kw_only=True)
class PointToPoint(Motion):
    """A C⁴ motion from rest at one pose to rest at another; all coordinates follow
    :data:`~cablebot_gym.motions.base.BLEND`.

    Raises:
        ValueError: if the duration or a pose is invalid, or the poses differ in their number of
            coordinates.
    """

    start: tuple[float, ...]
    """First pose, shape (n,)."""
    end: tuple[float, ...]
    """Last pose, shape (n,)."""
    duration: float = 2.0
    """Duration of the motion [s]; > 0."""
    name: str = "line"
    """Name shown in tables and error messages."""
    _POSES = ("start", "end")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.start) != len(self.end):
            raise ValueError(f"start has {len(self.start)} coordinates and end has {len(self.end)}")

    def _derivatives(self, time: Array) -> Array:
        derivatives = self._blend(time)[..., None] * np.subtract(self.end, self.start)
        derivatives[0] += self.start
        return derivatives


@dataclass(frozen=True, kw_only=True)
class Lemniscate(Motion):
    """Gerono's lemniscate, traversed once from its crossing point; the motion is C⁴.

    ``(x, y) = (a_x sin α, a_y sin 2α)`` about ``center``. The angle α goes from 0 to 2π along
    :data:`~cablebot_gym.motions.base.BLEND`.

    Raises:
        ValueError: if a length, time or pose is invalid.
    """

    amplitude: tuple[float, float]
    """(a_x, a_y), half width and half height of the lemniscate [m]; > 0."""
    center: tuple[float, ...]
    """Pose of the crossing point, shape (n,); all coordinates except x and y stay constant."""
    duration: float = 3.0
    """Duration of the motion [s]; > 0."""
    name: str = "lemniscate"
    """Name shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set_numbers(
            "amplitude", shapes=[(2,)], form="two lengths (a_x, a_y)", above=0, unit="m"
        )

    def _derivatives(self, time: Array) -> Array:
        alpha = 2 * np.pi * self._blend(time)
        width, height = self.amplitude
        x = width * sine_derivatives(alpha[0])[:5]
        y = height * scaled(sine_derivatives(2 * alpha[0])[:5], 2.0)
        return in_plane(self.center, x, y, alpha)
