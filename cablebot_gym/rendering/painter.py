"""Painter of moments with pygame, on a surface in memory. It needs neither a display nor OpenGL."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.kinematics import Array, turned
from cablebot_gym.rendering.camera import fit_camera
from cablebot_gym.rendering.moment import HANG, Moment, ball_radius, full_tension
from cablebot_gym.task import Task
from cablebot_gym.utils import palette

if TYPE_CHECKING:
    import pygame

SIZE = (640, 480)
"""Default width and height of a picture [pixels]."""

SMALLEST = (320, 240)
"""Smallest width and height [pixels]: text does not fit in smaller pictures."""

LARGEST = (7680, 4320)
"""Largest width and height [pixels], larger than any screen."""

_OVERSAMPLING = 2
"""Factor by which pictures are painted larger and then scaled down, for smooth edges."""

_AZIMUTH, _ELEVATION = math.radians(22), math.radians(30)
"""Direction of view of spatial robots [rad]. Planar robots are viewed from above."""

_SAG_FRACTION = 0.12
"""Depth of a slack cable's arc, as a fraction of its length."""

_BAR_SPACING = 24
"""Distance between the bars of two motors in the motor panel."""

_GAUGE_SCALE = 1.5
"""Full scale of an error gauge, as a multiple of the error bound."""

_TENSION_COLOURS = ("#8FBFE0", "#3F7FB5", "#8E5EA2", "#D55E00", "#8C1C13")
"""Colours of cables, from zero tension to the tension that the motor holds at standstill."""

_INK, _PAPER = "#202020", "#FFFFFF"


def import_pygame() -> Any:
    """Imports pygame without its welcome message.

    Raises:
        ImportError: if pygame is missing; the message gives the extra to install.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise ImportError("pictures require pygame: pip install 'cablebot-gym[render]'") from error
    return pygame


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """The size of a picture [pixels], checked.

    Raises:
        ValueError: if it is below :data:`SMALLEST` or above ``LARGEST``.
    """
    if np.any(np.less(size, SMALLEST)) or np.any(np.greater(size, LARGEST)):
        least, most, given = (f"{width} × {height}" for width, height in (SMALLEST, LARGEST, size))
        raise ValueError(f"a picture must have between {least} and {most} pixels, not {given}")
    return size


class Painter:
    """Paints the moments of one episode.

    Args:
        task: task of the episode, whose robot, motion and error bounds are drawn.
        title: text above the pictures.
        size: width and height [pixels].

    Raises:
        ImportError: if pygame is missing.
        ValueError: if the size is too small or too large.
    """

    def __init__(self, task: Task, title: str = "", size: tuple[int, int] = SIZE) -> None:
        check_size(size)
        self._pygame = import_pygame()
        self._pygame.font.init()
        self.task, self.title, self.size = task, title, (int(size[0]), int(size[1]))
        self._unit = _OVERSAMPLING * min(size[0] / SIZE[0], size[1] / SIZE[1])
        self._fonts: dict[float, pygame.font.Font] = {}
        self._canvas = self._pygame.Surface((_OVERSAMPLING * self.size[0], _OVERSAMPLING * self.size[1]))
        self._glass = self._pygame.Surface(self._canvas.get_size(), self._pygame.SRCALPHA)
        robot, trajectory = task.robot, task.trajectory
        path = np.array([trajectory(time).position for time in np.linspace(0, trajectory.duration, 241)])
        self._path, self._base = self._points(path), self._points(robot.base)
        visible = [self._base.reshape(-1, 3), self._path]
        reach = np.abs(robot.platform).max() * np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
        if robot.planar:
            reach = np.abs(reach).max(initial=0.06)
            visible += [self._path + reach, self._path - reach]
        else:
            visible += [(self._path[::20, None] + reach).reshape(-1, 3), self._path + np.array([0, 0, HANG + 0.07])]
        width, height = self._canvas.get_size()
        self._panel = max(40 + _BAR_SPACING * robot.cables, 150) * self._unit  # width of the motor panel at the right
        window = (
            int(0.04 * width),
            int(58 * self._unit),
            int(width - self._panel - 0.08 * width),
            int(height - 152 * self._unit),
        )
        angles = (0.0, math.pi / 2) if robot.planar else (_AZIMUTH, _ELEVATION)
        self._camera = fit_camera(np.concatenate(visible), window, azimuth=angles[0], elevation=angles[1])
        self._static_layer = self._background()

    def paint(
        self, moment: Moment, trail: Sequence[Array] | Array = (), note: str = "", *, good: bool = False
    ) -> pygame.Surface:
        """Paints a moment.

        Args:
            moment: the moment to paint.
            trail: past poses of the platform, (k, n).
            note: text below the title.
            good: whether the note is green, for success, or red.
        """
        self._canvas.blit(self._static_layer, (0, 0))
        past = np.array(trail, float).reshape(-1, self.task.robot.coordinates)
        past = past[np.isfinite(past).all(axis=1)]
        if len(past) > 1:
            points = self._camera.project(self._points(past))
            self._pygame.draw.lines(self._canvas, palette.BLUE, False, points, round(1.6 * self._unit))
        if np.all(np.isfinite(moment.pose)):
            self._robot(moment)
        self._motors(moment)
        self._gauges(moment)
        unit, payload = self._unit, f"{moment.payload:.2f} kg"
        title = f"{self.title}   {payload}" if self.title else payload
        self._write(title, (14 * unit, 8 * unit), 17)
        self._write(note, (14 * unit, 28 * unit), 13, palette.GREEN if good else palette.VERMILLION)
        return self._pygame.transform.smoothscale(self._canvas, self.size)

    def array(
        self, moment: Moment, trail: Sequence[Array] | Array = (), note: str = "", *, good: bool = False
    ) -> NDArray[np.uint8]:
        """The picture as an array (height, width, 3); arguments as for :meth:`paint`."""
        return as_array(self.paint(moment, trail, note, good=good))

    def _points(self, positions: Array) -> Array:
        """Points in space (..., 3) of poses or anchors. Planar robots lie in z = 0.

        In the picture y points upwards, or downwards if the plane is vertical.
        """
        robot = self.task.robot
        if not robot.planar:
            return positions[..., :3]
        upwards = -1.0 if robot.plane == "horizontal" else 1.0
        return np.stack([positions[..., 0], upwards * positions[..., 1], np.zeros(positions.shape[:-1])], axis=-1)

    def _background(self) -> pygame.Surface:
        """Static layer: base, tube around the path, and reference path."""
        pygame, surface, unit = self._pygame, self._canvas.copy(), self._unit
        surface.fill(_PAPER)
        base = self._camera.project(self._base)
        corners = base[_polygon_order(base)]
        pygame.draw.polygon(surface, "#F4F5F7", corners)
        pygame.draw.polygon(surface, "#B8BCC4", corners, max(1, round(1.5 * unit)))
        tube = self._camera.pixels(2 * self.task.error_bounds.position, self._path.mean(axis=0))
        path = self._camera.project(self._path)
        for point in _resample(path, max(1.0, tube / 8)):
            pygame.draw.circle(surface, palette.SKY, point, max(tube / 2, unit))
        self._dashed(surface, path, palette.GREY, 1.0 * unit, 4 * unit)
        for index, anchor in enumerate(base):
            pygame.draw.circle(surface, _INK, anchor, 4.5 * unit)
            if index in _first_indices(self._base):
                outward = (anchor - base.mean(axis=0)) / max(float(np.linalg.norm(anchor - base.mean(axis=0))), 1.0)
                names = ",".join(str(i + 1) for i in range(len(base)) if np.allclose(self._base[i], self._base[index]))
                self._write(names, anchor + 13 * unit * outward, 11, palette.GREY, across=0.5, along=0.5, on=surface)
        return surface

    def _robot(self, moment: Moment) -> None:
        pygame, canvas, unit, camera = self._pygame, self._canvas, self._unit, self._camera
        robot = self.task.robot
        centre = self._points(moment.pose)
        ends = self._points(moment.pose[: robot.dimensions] + turned(moment.pose, robot.platform))
        radius = ball_radius(moment.payload)
        ball = centre + (np.zeros(3) if robot.planar else np.array([0, 0, HANG + radius]))
        if not robot.planar and moment.payload > 0:
            hook = camera.project(np.array([centre, ball]))
            pygame.draw.line(canvas, _INK, hook[0], hook[1], round(1.5 * unit))
        if moment.payload > 0:
            middle, size = camera.project(ball), max(camera.pixels(radius, ball), 2 * unit)
            for fraction, colour in ((1.0, "#3A3D42"), (0.82, "#4A4E55"), (0.55, "#5F646C"), (0.25, "#858B94")):
                pygame.draw.circle(canvas, colour, middle - 0.3 * (1 - fraction) * size, max(fraction * size, 1))
        if robot.point_mass:
            pygame.draw.circle(canvas, palette.YELLOW, camera.project(centre), 5 * unit)
            pygame.draw.circle(canvas, _INK, camera.project(centre), 5 * unit, round(1.4 * unit))
        else:
            corners = camera.project(ends)
            corners = corners[_polygon_order(corners)]
            self._glass.fill((0, 0, 0, 0))
            pygame.draw.polygon(self._glass, (240, 228, 66, 150), corners)  # transparent, so that the path is visible
            canvas.blit(self._glass, (0, 0))
            for first, last in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                self._line(first, last, _INK, 1.6 * unit)
        for cable in range(robot.cables):
            self._cable(self._base[cable], ends[cable], moment, cable)
        reference = self._points(np.asarray(self.task.trajectory(moment.time).position))
        pygame.draw.circle(canvas, palette.VERMILLION, camera.project(reference), 3.2 * unit, round(1.3 * unit))

    def _cable(self, base: Array, end: Array, moment: Moment, cable: int) -> None:
        if moment.slack[cable]:
            along = np.linspace(0, 1, 25)[:, None]
            sag = 4 * _SAG_FRACTION * float(np.linalg.norm(end - base)) * along * (1 - along)
            # Planar robots are viewed along the sag direction: draw the arc sideways.
            sag_direction = np.array([0, 0, 1.0])
            if self.task.robot.planar:
                sag_direction = np.cross(sag_direction, end - base) / max(float(np.linalg.norm(end - base)), 1e-9)
            points = self._camera.project(base + along * (end - base) + sag * sag_direction)
            self._dashed(self._canvas, points, palette.GREY, 1.6 * self._unit, 6 * self._unit)
            return
        fraction = float(moment.tensions[cable]) / full_tension(self.task.robot)
        start, stop = self._camera.project(np.array([base, end]))
        self._line(start, stop, tension_colour(fraction), (1.6 + 2.4 * min(max(fraction, 0.0), 1.0)) * self._unit)

    def _motors(self, moment: Moment) -> None:
        """Paints a bar of the applied torque for each motor. The scale beyond its present U± is shaded."""
        pygame, canvas, unit = self._pygame, self._canvas, self._unit
        robot, (width, height) = self.task.robot, canvas.get_size()
        left, top, bottom = width - self._panel + 26 * unit, 44 * unit, height - 118 * unit
        largest = float(np.max(robot.stall_torque))
        # A motor that rotates against its torque can exceed its stall torque.
        scale = (bottom - top) / (2.3 * largest)
        zero = (top + bottom) / 2

        def row(torque: float) -> float:
            return float(min(max(zero - scale * torque, top), bottom))

        self._write("motor torques [N·m]", (width - 12 * unit, 10 * unit), 12, across=1.0)
        for motor in range(robot.cables):
            x, bar_width = left + _BAR_SPACING * unit * motor, 16 * unit
            low, high = (row(float(limit)) for limit in moment.torque_limits[:, motor])
            self._rect(palette.SHADE, x, top, bar_width, bottom - top)
            self._rect(_PAPER, x, high, bar_width, low - high)
            torque, saturated = row(float(moment.torques[motor])), abs(float(moment.commanded_action[motor])) >= 1
            colour, length = palette.VERMILLION if saturated else palette.BLUE, max(abs(torque - zero), unit)
            self._rect(colour, x + 3 * unit, min(torque, zero), bar_width - 6 * unit, length)
            for edge in (low, high):
                self._line((x, edge), (x + bar_width, edge), _INK, 1.6 * unit)
            self._write(str(motor + 1), (x + bar_width / 2, bottom + 4 * unit), 12, across=0.5)
        start = left - 4 * unit
        self._line((start, zero), (start + _BAR_SPACING * unit * robot.cables, zero), palette.GREY, unit)
        for torque in (-largest, 0.0, largest):
            self._write(f"{torque:.3g}", (left - 7 * unit, row(torque)), 11, palette.GREY, across=1.0, along=0.5)

        # Colour scale of the cable tensions.
        y, across = bottom + 34 * unit, self._panel - 40 * unit
        for x in range(round(across)):
            pygame.draw.line(canvas, tension_colour(x / across), (left + x, y), (left + x, y + 7 * unit))
        self._write("cable tension [N]", (left + across / 2, y - 15 * unit), 11, palette.GREY, across=0.5)
        self._write("0", (left, y + 8 * unit), 11, palette.GREY)
        self._write(f"{full_tension(self.task.robot):.3g}", (left + across, y + 8 * unit), 11, palette.GREY, across=1.0)

    def _gauges(self, moment: Moment) -> None:
        """Paints the errors relative to their bounds, and the time."""
        unit, (width, height), error_bounds = self._unit, self._canvas.get_size(), self.task.error_bounds
        gauges = [("position", moment.position_error, error_bounds.position, "mm")]
        if not self.task.robot.point_mass:
            gauges.append(("rotation", moment.rotation_error, error_bounds.rotation, "mrad"))
        left, scale = 76 * unit, width - self._panel - 190 * unit
        for index, (name, error, bound, bound_unit) in enumerate(gauges):
            y = height - (60 - 20 * index) * unit
            beyond = error > bound
            colour = palette.VERMILLION if beyond else palette.BLUE
            fraction = min(error / bound, _GAUGE_SCALE) / _GAUGE_SCALE
            self._write(name, (14 * unit, y), 12, along=0.5)
            self._rect(palette.SHADE, left, y - 5 * unit, scale, 10 * unit)
            self._rect(colour, left, y - 5 * unit, fraction * scale, 10 * unit)
            mark = left + scale / _GAUGE_SCALE
            self._line((mark, y - 8 * unit), (mark, y + 8 * unit), _INK, 2 * unit)
            text = f"{1e3 * error:.1f}" if error < 1 else "> 1000"
            text = f"{text} of {1e3 * bound:g} {bound_unit}"
            self._write(text, (left + scale + 8 * unit, y), 12, colour if beyond else _INK, along=0.5)
        duration, y = self.task.trajectory.duration, height - 18 * unit
        self._write("time", (14 * unit, y), 12, along=0.5)
        self._rect(palette.SHADE, left, y - 2 * unit, scale, 4 * unit)
        self._rect(palette.GREY, left, y - 2 * unit, scale * min(moment.time / duration, 1.0), 4 * unit)
        text = f"{moment.time:.3f} of {duration:.3g} s"
        self._write(text, (left + scale + 8 * unit, y), 12, along=0.5)

    def _rect(self, colour: str, left: float, top: float, width: float, height: float) -> None:
        self._pygame.draw.rect(self._canvas, colour, (left, top, width, height))

    def _line(self, start: ArrayLike, stop: ArrayLike, colour: Any, width: float) -> None:
        """Draws a line whose width does not depend on its direction, unlike the lines of pygame."""
        first, last = np.asarray(start, float), np.asarray(stop, float)
        along = last - first
        length = float(np.linalg.norm(along))
        if length > 0:
            aside = 0.5 * width * np.array([-along[1], along[0]]) / length
            self._pygame.draw.polygon(self._canvas, colour, [first + aside, last + aside, last - aside, first - aside])

    def _dashed(self, surface: pygame.Surface, points: Array, colour: str, width: float, dash: float) -> None:
        for start, stop in list(pairwise(_resample(points, dash)))[::2]:
            self._pygame.draw.line(surface, colour, start, stop, max(1, round(width)))

    def _write(
        self,
        text: str,
        at: Sequence[float] | Array,
        size: float,
        colour: str = _INK,
        *,
        across: float = 0.0,
        along: float = 0.0,
        on: pygame.Surface | None = None,
    ) -> None:
        """Writes text at a point; ``across`` and ``along`` are the fractions of it left of the point and above it."""
        if size not in self._fonts:
            self._fonts[size] = self._pygame.font.Font(None, max(8, round(1.28 * size * self._unit)))
        image = self._fonts[size].render(text, True, colour)
        corner = (at[0] - across * image.get_width(), at[1] - along * image.get_height())
        (self._canvas if on is None else on).blit(image, corner)


def as_array(surface: pygame.Surface) -> NDArray[np.uint8]:
    """Pixels of a surface as an array (height, width, 3)."""
    pixels = import_pygame().surfarray.array3d(surface)
    return np.ascontiguousarray(pixels.swapaxes(0, 1))


def tension_colour(fraction: float) -> tuple[int, int, int]:
    """Colour of a cable whose tension is this fraction of the tension that its motor holds at standstill."""
    position = min(max(fraction, 0.0), 1.0) * (len(_TENSION_COLOURS) - 1)
    first = min(int(position), len(_TENSION_COLOURS) - 2)
    low, high = (np.array([int(_TENSION_COLOURS[i][j : j + 2], 16) for j in (1, 3, 5)]) for i in (first, first + 1))
    red, green, blue = (low + (position - first) * (high - low)).round().astype(int).tolist()
    return red, green, blue


def _first_indices(points: Array) -> list[int]:
    """Index of the first occurrence of each point among points (m, …) that may coincide."""
    return [
        index for index in range(len(points)) if not any(np.allclose(points[index], points[i]) for i in range(index))
    ]


def _polygon_order(points: Array) -> list[int]:
    """Indices of points (m, 2), sorted by direction from the centre and without duplicates: corners of a polygon."""
    relative = points - points.mean(axis=0)
    angles = np.arctan2(relative[:, 1], relative[:, 0])
    return sorted(_first_indices(points), key=lambda index: float(angles[index]))


def _resample(points: Array, step: float) -> Array:
    """Points on the polyline through points (k, 2), at a distance of about ``step``."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], max(2, math.ceil(lengths[-1] / step)))
    return np.stack([np.interp(at, lengths, points[:, 0]), np.interp(at, lengths, points[:, 1])], axis=-1)
