"""From a robot to a picture: points in space, views, perspective projection and outlines.

Coordinates in space are those of the base frame, whose z axis points down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from cablebot_gym.kinematics import Array, turned
from cablebot_gym.rendering.moment import HANG
from cablebot_gym.robots import Robot

FIELD_OF_VIEW = math.radians(32)
"""Angle of view across the shorter side of the fitted window [rad]."""

_SPATIAL_VIEW = (math.radians(22), math.radians(30))
_PLANAR_VIEW = (0.0, math.pi / 2)
"""Azimuth and elevation of the view of spatial and planar robots [rad]."""


def attached_points(poses: Array, points: Array) -> Array:
    """Points of the platform in the base frame, (..., k, d) [m].

    Args:
        poses: poses X of the platform, (..., n) [m, rad].
        points: the points in the platform frame, (k, d) [m].
    """
    dimensions = points.shape[-1]
    return poses[..., None, :dimensions] + turned(poses, points)


def points_in_space(robot: Robot, positions: Array) -> Array:
    """Points in space (..., 3) [m] of poses, anchors or other positions (..., ≥ d).

    Planar robots lie in z = 0. In their pictures, y points upwards, or downwards if the plane is
    vertical.
    """
    if not robot.planar:
        return positions[..., :3]
    points = np.zeros((*positions.shape[:-1], 3))
    points[..., :2] = positions[..., :2]
    if not points_downwards(robot, 1):
        points[..., 1] *= -1
    return points


def points_downwards(robot: Robot, axis: int) -> bool:
    """Whether axis 0, 1 or 2 of the base frame points downwards in pictures and drawings: z, and y
    of a vertical plane."""
    if robot.planar:
        return axis == 1 and robot.plane == "vertical"
    return axis == 2


def drawing_views(robot: Robot) -> list[list[int]]:
    """Horizontal and vertical axis of each view of a drawing: the plane of a planar robot, or plan
    and elevations."""
    if robot.planar:
        return [[0, 1]]
    return [[0, 1], [0, 2], [1, 2]]


def view_direction(robot: Robot) -> tuple[float, float]:
    """Azimuth and elevation of the view of a robot [rad], see :func:`fit_camera`. Planar robots are
    viewed from above."""
    if robot.planar:
        return _PLANAR_VIEW
    return _SPATIAL_VIEW


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera without roll."""

    eye: Array
    """Position of the camera in the base frame [m], (3,)."""
    right: Array
    """Axis to the right in the base frame, (3,)."""
    down: Array
    """Axis downwards in the base frame, (3,)."""
    forward: Array
    """Optical axis in the base frame, (3,)."""
    centre: Array
    """Point of the picture on the optical axis [pixels], (2,)."""
    focal: float
    """Focal length [pixels]."""

    def project(self, points: ArrayLike) -> Array:
        """Projection of points (..., 3) [m] onto the picture, (..., 2) [pixels], x to the right and
        y downwards."""
        relative = np.asarray(points, float) - self.eye
        lateral = np.stack([relative @ self.right, relative @ self.down], axis=-1)
        return self.centre + self.focal * lateral / (relative @ self.forward)[..., None]

    def pixels(self, length: float, at: ArrayLike) -> float:
        """Length in pixels of a length [m] perpendicular to the line of sight at a point ``at``
        (3,) [m]."""
        return float(self.focal * length / ((np.asarray(at, float) - self.eye) @ self.forward))


def fit_camera(
    points: ArrayLike,
    window: tuple[float, float, float, float],
    *,
    azimuth: float,
    elevation: float,
) -> Camera:
    """The camera closest to some points that shows all of them in a window of the picture.

    Args:
        points: points that must be visible, (..., 3) [m].
        window: (left, top, width, height) [pixels].
        azimuth: rotation about the vertical axis [rad]; at 0, x points to the right.
        elevation: angle of view above the horizontal [rad]; π/2 is a view from above.
    """
    cloud = np.asarray(points, float).reshape(-1, 3)
    left_edge, top, width, height = window
    right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    horizontal = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    forward = math.cos(elevation) * horizontal + math.sin(elevation) * np.array([0.0, 0.0, 1.0])
    down = np.cross(forward, right)
    focal = 0.5 * min(width, height) / math.tan(FIELD_OF_VIEW / 2)
    target = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    size = float(np.linalg.norm(np.ptp(cloud, axis=0)))

    def camera_at(distance: float) -> tuple[Camera, bool]:
        camera = Camera(
            eye=target - distance * forward,
            right=right,
            down=down,
            forward=forward,
            centre=np.zeros(2),
            focal=focal,
        )
        page = camera.project(cloud)
        low = page.min(axis=0)
        high = page.max(axis=0)
        fits = bool(np.all(high - low <= (width, height)))
        centre = np.array([left_edge + width / 2, top + height / 2]) - (low + high) / 2
        return replace(camera, centre=centre), fits

    near = 0.6 * size
    far = 100.0 * size
    for _ in range(40):
        middle = math.sqrt(near * far)
        if camera_at(middle)[1]:
            far = middle
        else:
            near = middle
    return camera_at(far)[0]


def fit_robot_camera(
    robot: Robot, path: Array, window: tuple[float, float, float, float]
) -> Camera:
    """The camera that shows the base of a robot, and its platform and payload along a path.

    Args:
        robot: the robot.
        path: positions along the path, as :func:`points_in_space` returns them, (k, 3) [m].
        window: (left, top, width, height) [pixels].
    """
    reach = np.abs(robot.platform).max()
    visible = [points_in_space(robot, robot.base), path]
    if robot.planar:
        margin = max(reach, 0.06)
        visible += [path + margin, path - margin]
    else:
        for x, y in product((reach, -reach), repeat=2):
            visible.append(path[::20] + np.array([x, y, 0]))
        visible.append(path + np.array([0, 0, HANG + 0.07]))
    azimuth, elevation = view_direction(robot)
    return fit_camera(np.concatenate(visible), window, azimuth=azimuth, elevation=elevation)


def outline(points: Array) -> Array:
    """Corners of the convex hull of points (m, 2), by direction from the centre of the points.

    Fewer than three distinct points have no hull: all points are returned.
    """
    distinct = points[[group[0] for group in coinciding(points)]]
    if len(distinct) < 3:
        return points
    hull = ConvexHull(distinct, qhull_options="QJ")  # joggled, for points on a line
    corners = distinct[hull.vertices]
    x, y = (corners - points.mean(axis=0)).T
    return corners[np.argsort(np.arctan2(y, x))]


def coinciding(points: Array) -> list[list[int]]:
    """Indices of points (m, …), grouped by position, in the order of the first index of each
    group."""
    groups: list[list[int]] = []
    for index, point in enumerate(points):
        for group in groups:
            if np.allclose(point, points[group[0]]):
                group.append(index)
                break
        else:
            groups.append([index])
    return groups
