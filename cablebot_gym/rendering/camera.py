"""Perspective: points of the base frame, whose z points down, on the page."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array

FIELD = math.radians(32)
"""Angle of view across the shorter side of the window it was fitted to."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera that stands upright.

    ``right``, ``down`` and ``forward`` (3,) are its axes in the base frame, ``eye`` (3,) where it is [m], ``centre``
    (2,) where its axis meets the page and ``focal`` its focal length, both in pixels.
    """

    eye: Array
    right: Array
    down: Array
    forward: Array
    centre: Array
    focal: float

    def project(self, points: ArrayLike) -> Array:
        """Points (..., 3) [m] on the page (..., 2) [pixels], x to the right and y downwards."""
        away = np.asarray(points, float) - self.eye
        across = np.stack([away @ self.right, away @ self.down], axis=-1)
        return self.centre + self.focal * across / (away @ self.forward)[..., None]

    def pixels(self, length: float, at: ArrayLike) -> float:
        """How long a length across the line of sight looks, at a point (3,) [m]."""
        return float(self.focal * length / ((np.asarray(at, float) - self.eye) @ self.forward))


def fitted(points: ArrayLike, window: tuple[float, float, float, float], *, azimuth: float, elevation: float) -> Camera:
    """The camera nearest to points (..., 3) [m] that has them all in a window (left, top, width, height) [pixels].

    Args:
        points: what has to be seen.
        window: of the page.
        azimuth: turns the camera about the vertical; at 0, x points to the right [rad].
        elevation: above the horizontal, π/2 is from straight above [rad].
    """
    cloud = np.asarray(points, float).reshape(-1, 3)
    left, top, width, height = window
    right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    level = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    forward = math.cos(elevation) * level + math.sin(elevation) * np.array([0.0, 0.0, 1.0])
    down = np.cross(forward, right)
    focal = 0.5 * min(width, height) / math.tan(FIELD / 2)
    target = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    size = float(np.linalg.norm(np.ptp(cloud, axis=0)))

    def at(distance: float) -> tuple[Camera, bool]:
        def camera(centre: Array) -> Camera:
            return Camera(
                eye=target - distance * forward, right=right, down=down, forward=forward, centre=centre, focal=focal
            )

        page = camera(np.zeros(2)).project(cloud)
        low, high = page.min(axis=0), page.max(axis=0)
        fits = bool(np.all(high - low <= (width, height)))
        return camera(np.array([left + width / 2, top + height / 2]) - (low + high) / 2), fits

    near, far = 0.6 * size, 100.0 * size
    for _ in range(40):
        middle = math.sqrt(near * far)
        if at(middle)[1]:
            far = middle
        else:
            near = middle
    return at(far)[0]
