"""Painter of moments with pygame, on a surface in memory. It needs neither a display nor OpenGL."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.rendering.moment import HANG, Moment, ball_radius, full_tension
from cablebot_gym.rendering.projection import (
    attached_points,
    coinciding,
    fit_robot_camera,
    outline,
    points_in_space,
)
from cablebot_gym.task import Task
from cablebot_gym.utils import palette

if TYPE_CHECKING:
    import pygame

SIZE = (640, 480)
"""Default width and height of a picture [pixels]."""

SMALLEST = (320, 240)
"""Smallest width and height [pixels]: text does not fit in smaller pictures."""

_OVERSAMPLING = 2
"""Factor by which pictures are painted larger and then scaled down, for smooth edges."""

_BAR_SPACING = 24
"""Distance between the bars of two motors in the motor panel."""

_GAUGE_SCALE = 1.5
"""Full scale of an error gauge, as a multiple of the error bound."""

_TENSION_COLOURS = np.array(
    [[143, 191, 224], [63, 127, 181], [142, 94, 162], [213, 94, 0], [140, 28, 19]]
)
"""Red, green and blue of cables, from zero tension to the tension that the motor holds at
standstill."""

_INK = "#202020"
_STEEL = "#4A4E55"
_PAPER = "#FFFFFF"


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
        ValueError: if it is below :data:`SMALLEST`.
    """
    if size[0] < SMALLEST[0] or size[1] < SMALLEST[1]:
        least = f"{SMALLEST[0]} × {SMALLEST[1]}"
        raise ValueError(f"a picture must have at least {least} pixels, not {size[0]} × {size[1]}")
    return size


class Painter:
    """Paints the moments of one episode, in a unit of length that is one pixel of a picture of the
    default size.

    Args:
        task: task of the episode, whose robot, motion and error bounds are drawn.
        title: text above the pictures.
        size: width and height [pixels].

    Raises:
        ImportError: if pygame is missing.
        ValueError: if the size is too small.
    """

    def __init__(self, task: Task, title: str = "", size: tuple[int, int] = SIZE) -> None:
        check_size(size)
        self._pygame = import_pygame()
        self._pygame.font.init()
        self._draw = self._pygame.draw
        self.task = task
        self.title = title
        self.size = (int(size[0]), int(size[1]))
        self._unit = _OVERSAMPLING * min(size[0] / SIZE[0], size[1] / SIZE[1])
        self._fonts: dict[float, pygame.font.Font] = {}
        canvas_size = (_OVERSAMPLING * self.size[0], _OVERSAMPLING * self.size[1])
        self._canvas = self._pygame.Surface(canvas_size)
        self._glass = self._pygame.Surface(canvas_size, self._pygame.SRCALPHA)
        canvas_width, canvas_height = canvas_size
        self._width = canvas_width / self._unit
        self._height = canvas_height / self._unit
        robot = task.robot
        # Width of the motor panel at the right.
        self._panel = max(40 + _BAR_SPACING * robot.cables, 150)
        times = np.linspace(0, task.trajectory.duration, 241)
        path = np.array([task.trajectory(time).position for time in times])
        self._path = points_in_space(robot, path)
        self._base = points_in_space(robot, robot.base)
        left_edge = 0.04 * self._width
        width = self._width - self._panel - 2 * left_edge
        window = (left_edge, 58, width, self._height - 152)
        self._camera = fit_robot_camera(robot, self._path, window)
        self._paint_background()
        self._static_layer = self._canvas.copy()

    def paint(
        self,
        moment: Moment,
        trail: Sequence[Array] | Array = (),
        note: str = "",
        *,
        good: bool = False,
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
            points = self._camera.project(points_in_space(self.task.robot, past))
            width = round(1.6 * self._unit)
            self._draw.lines(self._canvas, palette.BLUE, False, self._unit * points, width)
        if np.all(np.isfinite(moment.pose)):
            self._paint_robot(moment)
        self._paint_motors(moment)
        self._paint_tension_scale()
        self._paint_gauges(moment)
        title = f"{moment.payload:.2f} kg"
        if self.title:
            title = f"{self.title}   {title}"
        note_colour = palette.VERMILLION
        if good:
            note_colour = palette.GREEN
        self._write(title, (14, 8), 17)
        self._write(note, (14, 28), 13, note_colour)
        return self._pygame.transform.smoothscale(self._canvas, self.size)

    def array(
        self,
        moment: Moment,
        trail: Sequence[Array] | Array = (),
        note: str = "",
    ) -> NDArray[np.uint8]:
        """The picture as an array (height, width, 3); arguments as for :meth:`paint`."""
        return as_array(self.paint(moment, trail, note))

    def _paint_background(self) -> None:
        """Paints what does not move: base, tube around the path, and reference path."""
        self._canvas.fill(_PAPER)
        base = self._camera.project(self._base)
        corners = self._unit * outline(base)
        self._draw.polygon(self._canvas, "#F4F5F7", corners)
        self._draw.polygon(self._canvas, "#B8BCC4", corners, round(1.5 * self._unit))
        path = self._camera.project(self._path)
        diameter = 2 * self.task.error_bounds.position
        tube = self._camera.pixels(diameter, self._path.mean(axis=0))
        for point in path:
            self._circle(palette.SKY, point, max(tube / 2, 1))
        self._draw.lines(self._canvas, palette.GREY, False, self._unit * path, round(self._unit))
        centre = base.mean(axis=0)
        for cables in coinciding(self._base):
            anchor = base[cables[0]]
            outward = anchor - centre
            outward /= max(float(np.linalg.norm(outward)), 1.0)
            numbers = ",".join(str(cable + 1) for cable in cables)
            self._circle(_INK, anchor, 4.5)
            self._write(numbers, anchor + 13 * outward, 11, palette.GREY, across=0.5, along=0.5)

    def _paint_robot(self, moment: Moment) -> None:
        """Paints the payload, the platform, the cables and the reference position."""
        robot = self.task.robot
        centre = points_in_space(robot, moment.pose)
        ends = points_in_space(robot, attached_points(moment.pose, robot.platform))
        if moment.payload > 0:
            self._paint_payload(moment.payload, centre)
        if robot.point_mass:
            middle = self._camera.project(centre)
            self._circle(palette.YELLOW, middle, 5)
            self._circle(_INK, middle, 5, 1.4)
        else:
            corners = outline(self._camera.project(ends))
            self._glass.fill((0, 0, 0, 0))
            # Transparent, so that the path is visible.
            self._draw.polygon(self._glass, (240, 228, 66, 150), self._unit * corners)
            self._canvas.blit(self._glass, (0, 0))
            for start, stop in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                self._line(start, stop, _INK, 1.6)
        for base, end, tension, is_slack in zip(
            self._base, ends, moment.tensions, moment.slack, strict=True
        ):
            start, stop = self._camera.project([base, end])
            if is_slack:
                self._line(start, stop, palette.GREY, 0.8)
            else:
                fraction = float(tension) / full_tension(robot)
                width = 1.6 + 2.4 * min(max(fraction, 0.0), 1.0)
                self._line(start, stop, tension_colour(fraction), width)
        reference = self.task.trajectory(moment.time).position
        target = self._camera.project(points_in_space(robot, reference))
        self._circle(palette.VERMILLION, target, 3.2, 1.3)

    def _paint_payload(self, payload: float, centre: Array) -> None:
        """Paints the payload as a ball at the centre of a planar platform, or on a hook below a
        spatial one."""
        camera = self._camera
        radius = ball_radius(payload)
        ball = centre
        if not self.task.robot.planar:
            ball = centre + np.array([0, 0, HANG + radius])
            self._line(camera.project(centre), camera.project(ball), _INK, 1.5)
        self._circle(_STEEL, camera.project(ball), max(camera.pixels(radius, ball), 2))

    def _paint_motors(self, moment: Moment) -> None:
        """Paints a bar of the applied torque for each motor. The scale beyond its present U± is
        shaded."""
        robot = self.task.robot
        left_edge = self._width - self._panel + 26
        top = 44
        bottom = self._height - 118
        zero = (top + bottom) / 2
        bar_width = 16
        largest = float(np.max(robot.stall_torque))
        # A motor that rotates against its torque can exceed its stall torque.
        scale = (bottom - top) / (2.3 * largest)

        def row(torque: float) -> float:
            return min(max(zero - scale * torque, top), bottom)

        self._write("motor torques [N·m]", (self._width - 12, 10), 12, across=1.0)
        lower_limits, upper_limits = moment.torque_limits
        for motor in range(robot.cables):
            x = left_edge + _BAR_SPACING * motor
            low = row(float(lower_limits[motor]))
            high = row(float(upper_limits[motor]))
            self._rect(palette.SHADE, x, top, bar_width, bottom - top)
            self._rect(_PAPER, x, high, bar_width, low - high)
            torque = row(float(moment.torques[motor]))
            length = max(abs(torque - zero), 1)
            is_saturated = abs(float(moment.commanded_action[motor])) >= 1
            colour = palette.BLUE
            if is_saturated:
                colour = palette.VERMILLION
            self._rect(colour, x + 3, min(torque, zero), bar_width - 6, length)
            right_edge = x + bar_width
            self._line((x, low), (right_edge, low), _INK, 1.6)
            self._line((x, high), (right_edge, high), _INK, 1.6)
            self._write(str(motor + 1), (x + bar_width / 2, bottom + 4), 12, across=0.5)
        start = left_edge - 4
        stop = start + _BAR_SPACING * robot.cables
        self._line((start, zero), (stop, zero), palette.GREY, 1)
        for torque in (-largest, 0.0, largest):
            at = (left_edge - 7, row(torque))
            self._write(f"{torque:.3g}", at, 11, palette.GREY, across=1.0, along=0.5)

    def _paint_tension_scale(self) -> None:
        """Paints the colour scale of the cable tensions, below the motors."""
        left_edge = self._width - self._panel + 26
        top = self._height - 84
        length = self._panel - 40
        for x in np.arange(0, length, 0.5):
            self._rect(tension_colour(x / length), left_edge + x, top, 1, 7.5)
        middle = left_edge + length / 2
        right_edge = left_edge + length
        below = top + 8
        highest = f"{full_tension(self.task.robot):.3g}"
        self._write("cable tension [N]", (middle, top - 15), 11, palette.GREY, across=0.5)
        self._write("0", (left_edge, below), 11, palette.GREY)
        self._write(highest, (right_edge, below), 11, palette.GREY, across=1.0)

    def _paint_gauges(self, moment: Moment) -> None:
        """Paints the errors relative to their bounds, and the time."""
        bounds = self.task.error_bounds
        bottom = self._height
        self._paint_error("position", bottom - 60, moment.position_error, bounds.position, "mm")
        if not self.task.robot.point_mass:
            error = moment.rotation_error
            self._paint_error("rotation", bottom - 40, error, bounds.rotation, "mrad")
        duration = self.task.trajectory.duration
        text = f"{moment.time:.3f} of {duration:.3g} s"
        fraction = min(moment.time / duration, 1.0)
        self._paint_gauge("time", bottom - 18, 4, fraction, palette.GREY, text, _INK)

    def _paint_error(
        self, name: str, y: float, error: float, bound: float, bound_unit: str
    ) -> None:
        """Paints the gauge of an error and a mark at its bound."""
        colour = palette.BLUE
        text_colour = _INK
        if error > bound:
            colour = palette.VERMILLION
            text_colour = palette.VERMILLION
        text = f"{1e3 * error:.1f} of {1e3 * bound:g} {bound_unit}"
        fraction = min(error / bound, _GAUGE_SCALE) / _GAUGE_SCALE
        left_edge, length = self._paint_gauge(name, y, 10, fraction, colour, text, text_colour)
        mark = left_edge + length / _GAUGE_SCALE
        self._line((mark, y - 8), (mark, y + 8), _INK, 2)

    def _paint_gauge(
        self,
        name: str,
        y: float,
        height: float,
        fraction: float,
        colour: str,
        text: str,
        text_colour: str,
    ) -> tuple[float, float]:
        """Paints a horizontal bar that is filled by a fraction, and returns its left edge and
        length."""
        left_edge = 76
        length = self._width - self._panel - 190
        top = y - height / 2
        self._write(name, (14, y), 12, along=0.5)
        self._rect(palette.SHADE, left_edge, top, length, height)
        self._rect(colour, left_edge, top, fraction * length, height)
        self._write(text, (left_edge + length + 8, y), 12, text_colour, along=0.5)
        return left_edge, length

    def _rect(self, colour: Any, left_edge: float, top: float, width: float, height: float) -> None:
        pixels = self._unit * np.array([left_edge, top, width, height])
        self._draw.rect(self._canvas, colour, pixels)

    def _circle(self, colour: str, centre: Array, radius: float, width: float = 0) -> None:
        """Draws a disc, or a ring of some width."""
        unit = self._unit
        self._draw.circle(self._canvas, colour, unit * centre, unit * radius, round(unit * width))

    def _line(self, start: ArrayLike, stop: ArrayLike, colour: Any, width: float) -> None:
        """Draws a line whose width does not depend on its direction, unlike the lines of pygame."""
        start = np.asarray(start, float)
        stop = np.asarray(stop, float)
        along = stop - start
        length = float(np.linalg.norm(along))
        if not length > 0:  # NaN too
            return
        aside = 0.5 * width * np.array([-along[1], along[0]]) / length
        corners = np.array([start + aside, stop + aside, stop - aside, start - aside])
        self._draw.polygon(self._canvas, colour, self._unit * corners)

    def _write(
        self,
        text: str,
        at: Sequence[float] | Array,
        size: float,
        colour: str = _INK,
        *,
        across: float = 0.0,
        along: float = 0.0,
    ) -> None:
        """Writes text at a point; ``across`` and ``along`` are the fractions of it left of the
        point and above it."""
        if size not in self._fonts:
            font_height = max(8, round(1.28 * size * self._unit))
            self._fonts[size] = self._pygame.font.Font(None, font_height)
        image = self._fonts[size].render(text, True, colour)
        left_edge = self._unit * at[0] - across * image.get_width()
        top = self._unit * at[1] - along * image.get_height()
        self._canvas.blit(image, (left_edge, top))


def as_array(surface: pygame.Surface) -> NDArray[np.uint8]:
    """Pixels of a surface as an array (height, width, 3)."""
    pixels = import_pygame().surfarray.array3d(surface)
    return np.ascontiguousarray(pixels.swapaxes(0, 1))


def tension_colour(fraction: float) -> tuple[int, ...]:
    """Colour of a cable whose tension is this fraction of the tension that its motor holds at
    standstill."""
    fractions = np.linspace(0.0, 1.0, len(_TENSION_COLOURS))
    return tuple(round(np.interp(fraction, fractions, channel)) for channel in _TENSION_COLOURS.T)
