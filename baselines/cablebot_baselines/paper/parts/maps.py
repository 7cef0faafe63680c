"""Beyond the paper: the payload against stiffness, error bound, duration, and the circle's radius and height."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines.paper.exact import COARSE
from cablebot_baselines.paper.part import Cell, Found, Number, Outcome, Part, Table
from cablebot_baselines.paper.readings import Readings
from cablebot_baselines.paper.runs import largest_payload
from cablebot_gym.bounds import ExactPayload, exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.comparison import COLOURS
from cablebot_gym.plotting.figures import add_legend, entitle, new_figure
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits
from cablebot_gym.trajectories import PaperCircle
from cablebot_gym.utils.palette import GREY, SHADE, SKY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RESOLUTION = 1e-2
"""Of every payload [kg]."""

STIFFNESSES = {
    "composite": (1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 1000.0, 1e4),
    "adaptive-composite": (1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 1000.0),
    "fl4": (1.0, 2.0, 3.0, 10.0, 30.0, 100.0),
    "motor-pd": (1.0, 2.0, 3.0, 10.0, 100.0, 1000.0),
}
"""K [N·m/rad] of each law; stiff springs take long."""

BOUNDS = (1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0)
"""R [mm]."""

DURATIONS = (0.7, 0.8, 0.9, 1.0, 1.5, 2.0, 3.0)
"""Of the circle [s]."""

RADII = (0.05, 0.1, 0.15, 0.2)
"""Of the circle [m]."""

HEIGHTS = (0.08, 0.1, 0.15, 0.25)
"""Of the circle below the base's anchors, z [m]."""

PAPER_CIRCLE = (0.1, 0.1)
"""The radius and height of Table 3 [m]."""

FINE_RADII = tuple(np.linspace(0.02, 0.21, 20).round(4).tolist())
"""Of the circles that are tracked exactly [m]."""

FINE_HEIGHTS = tuple(np.linspace(0.06, 0.33, 28).round(4).tolist())
"""The same, z [m]."""

LIGHT_LOAD, HEAVY_LOAD = 10.0, 30.0
"""Ends of the scans [kg]; the second for circles deep below the anchors. No payload of the paper's robots is cut."""

_LINES = {
    "fl": (COLOURS[0], "rigid: fl, the paper's law"),
    "adaptive": (COLOURS[1], "rigid: adaptive"),
    "composite": (COLOURS[2], "flexible: composite"),
    "adaptive-composite": (COLOURS[3], "flexible: adaptive-composite"),
    "fl4": (COLOURS[4], "flexible: fl4"),
    "motor-pd": (COLOURS[5], "flexible: motor-pd"),
}
"""Colour and words of each law."""

_MARKERS = {"rotation": "o", "position": "s", "slack": "v", "terminated": "X", "scan_end": "^"}
"""Of what gives way."""

_ADAPTIVE, _NOT_ADAPTIVE = ("adaptive", "adaptive-composite"), ("fl", "composite")
_ALL = ("fl", "adaptive", "composite", "adaptive-composite")
_ENDINGS = {"": "-", "_scaled": "--"}
"""Of names of points, with their line: rotation bound 10 mrad, or 1 mrad per mm of R."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """The largest payload of one case, and what ends it."""

    payload: float | None
    """[kg]; None: not even zero is carried."""
    limit: str
    """Kind of the limit that gives way first beyond it."""
    time: float | None
    """When [s]."""
    saturated: bool
    """Whether a motor gave all it can during the motion, at this payload."""

    def words(self) -> str:
        """The limit and its time."""
        return self.limit.replace("_", " ") + ("" if self.time is None else f" {self.time:.2f} s")


def point(*, policy: str, robot: Robot, **keywords: Any) -> Point:
    """The largest payload of a law by its name, payload told, under the task criterion.

    Args:
        policy: name of a law, built from the robot.
        robot: any spatial one.
        keywords: for :func:`~cablebot_gym.evaluation.evaluate_dlcc`.
    """
    result = largest_payload(
        env_id="CableBot-FlexSpatial-v0" if robot.flexible else "CableBot-Spatial-v0",
        law=partial(load_policy, policy),
        robot=robot,
        name=policy,
        **{"payload_max": LIGHT_LOAD, "resolution": RESOLUTION} | keywords,
    )
    demand = float(np.abs(result.history["drive_demand"]).max())
    return Point(payload=result.payload, limit=result.limit.kind, time=result.limit.time, saturated=demand > 1 - 1e-9)


def exact_map(*, robot: Robot, line_speed: Array) -> list[list[ExactPayload]]:
    """Exact tracking on every fine circle, a row for each height.

    Args:
        robot: rigid.
        line_speed: see :func:`~cablebot_gym.evaluation.exact_payload`.
    """
    return [
        [exact_payload(robot, circle(radius, height), line_speed=line_speed, grid=COARSE) for radius in FINE_RADII]
        for height in FINE_HEIGHTS
    ]


def circle(radius: float, height: float) -> PaperCircle:
    """The paper's circle of Table 3 with another radius and height [m]."""
    return PaperCircle(name="circle", radius=radius, center=(0.0, 0.0, height, 0.1, 0.1, 0.1))


def _robots(readings: Readings) -> dict[str, Robot]:
    """The robot that each law moves."""
    rigid, flexible = (readings.motors(robot) for robot in (readings.spatial("payload"), readings.flexible("payload")))
    return {law: rigid if law in ("fl", "adaptive") else flexible for law in _LINES}


def _stiff(robot: Robot, stiffness: float) -> Robot:
    return robot.replace(transmission=robot.transmission.replace(stiffness=stiffness))


def _rigid_limit(robot: Robot) -> Robot:
    """What a flexible robot is with K → ∞: rotor and pulley turn as one."""
    old = robot.transmission
    joined = old.replace(
        pulley_inertia=tuple(robot.pulley_inertia + robot.motor_inertia),
        damping=tuple(robot.damping + robot.motor_damping),
        stiffness=None,
        motor_inertia=None,
        motor_damping=0.0,
    )
    return robot.replace(transmission=joined)


def _stiffness_cells(readings: Readings) -> dict[str, Cell]:
    if not readings.springs_play:
        return {}
    robots = _robots(readings)
    cells: dict[str, Cell] = {}
    for law, stiffnesses in STIFFNESSES.items():
        for stiffness in stiffnesses:
            cells[f"{law}_K{stiffness:g}"] = partial(point, policy=law, robot=_stiff(robots[law], stiffness))
    for law in ("fl", "adaptive"):
        cells[f"{law}_rigid"] = partial(point, policy=law, robot=robots[law])
        cells[f"{law}_limit"] = partial(point, policy=law, robot=_rigid_limit(robots["composite"]))
    return cells


def _bound_cells(readings: Readings) -> dict[str, Cell]:
    if not readings.springs_play:
        return {}
    cells: dict[str, Cell] = {}
    for law, robot in _robots(readings).items():
        for ending in _ENDINGS if law in _NOT_ADAPTIVE else ("",) if law in _ALL else ():
            for bound in BOUNDS:
                limits = Limits(position=1e-3 * bound, **({"rotation": 1e-3 * bound} if ending else {}))
                changed = {} if limits == Limits() else {"limits": limits}
                cells[f"{law}_R{bound:g}mm{ending}"] = partial(point, policy=law, robot=robot, **changed)
    return cells


def _duration_cells(readings: Readings) -> dict[str, Cell]:
    if not readings.springs_play:
        return {}
    cells: dict[str, Cell] = {}
    for law, robot in _robots(readings).items():
        for duration in DURATIONS if law in _ALL else ():
            changed = {} if duration == 1.0 else {"trajectory": {"name": "paper-spatial", "duration": duration}}
            cells[f"{law}_{duration:g}s"] = partial(point, policy=law, robot=robot, **changed)
    return cells


def _circle_cells(readings: Readings) -> dict[str, Cell]:
    robot = readings.spatial("payload")
    cells: dict[str, Cell] = {"exact": partial(exact_map, robot=robot, line_speed=readings.line_speed(robot))}
    if not readings.springs_play:
        return cells
    robots = _robots(readings)
    for law in _ADAPTIVE:
        for height in HEIGHTS:
            for radius in RADII:
                papers = (radius, height) == PAPER_CIRCLE
                changed = {} if papers else {"trajectory": circle(radius, height), "payload_max": HEAVY_LOAD}
                cells[_circle_name(law, radius, height)] = partial(point, policy=law, robot=robots[law], **changed)
    return cells


def _circle_name(law: str, radius: float, height: float) -> str:
    return f"{law}_r{radius:g}_z{height:g}"


def _payloads(found: Found) -> dict[str, Number]:
    """Every payload by its name."""
    return {f"{name}_kg": one.payload for name, one in found.items() if isinstance(one, Point)}


def _carried(found: Found) -> dict[str, Number]:
    """How many cases carry something, and in how many of them a motor is at its limit."""
    carried = [one for one in found.values() if isinstance(one, Point) and one.payload is not None]
    return {
        "cases_carried": len(carried),
        "cases_with_a_motor_at_its_limit": sum(one.saturated for one in carried),
    }


def _line_table(found: Found, title: str, first: str, rows: Mapping[Number, Mapping[str, str]]) -> Table:
    """A row for each abscissa, with payload and limit of each column that ``rows`` names a point for."""
    columns = list(dict.fromkeys(column for names in rows.values() for column in names))
    header = [first]
    for column in columns:
        header += [f"{column} [kg]", "then"]
    lines: list[tuple[Number, ...]] = []
    for abscissa, names in rows.items():
        line: list[Number] = [abscissa]
        for column in columns:
            one = found.get(names.get(column, ""))
            line += [None, None] if one is None else [one.payload, one.words()]
        lines.append(tuple(line))
    return Table(title=title, header=tuple(header), rows=tuple(lines))


def _exact_arrays(found: Found) -> tuple[Array, Array]:
    """Payload of exact tracking, nan where not even zero is carried, and where it is the motors that are too weak."""
    exact: list[list[ExactPayload]] = found["exact"]
    payload = [[one.payload if one.lowest <= 0 <= one.payload else np.nan for one in row] for row in exact]
    weak = [[one.lowest <= 0 and -np.inf < one.payload < 0 for one in row] for row in exact]
    return np.array(payload), np.array(weak)


def _stiffness_outcome(readings: Readings, found: Found) -> Outcome:
    if not found:
        return Outcome()
    every = sorted(set().union(*STIFFNESSES.values()))
    rows: dict[Number, dict[str, str]] = {
        stiffness: {law: f"{law}_K{stiffness:g}" for law in STIFFNESSES} for stiffness in every
    }
    rigid: tuple[tuple[Number, ...], ...] = tuple(
        (law, robot, found[f"{law}_{case}"].payload, found[f"{law}_{case}"].words())
        for law in ("fl", "adaptive")
        for case, robot in (("limit", "flexible with K → ∞, no friction"), ("rigid", "rigid, its friction"))
    )
    table = "Payload [kg] against K, and what gives way beyond it. A dash: not even zero is carried; two: not tried."
    return Outcome(
        numbers=_payloads(found) | _carried(found),
        tables=(
            _line_table(found, table, "K [N·m/rad]", rows),
            Table(
                title="Rigid robots to compare with.",
                header=("law", "robot", "payload [kg]", "then"),
                rows=rigid,
            ),
        ),
    )


def _bound_outcome(readings: Readings, found: Found) -> Outcome:
    if not found:
        return Outcome()
    tables = []
    for ending, title in zip(_ENDINGS, ("10 mrad", "1 mrad per mm of R"), strict=True):
        rows: dict[Number, dict[str, str]] = {
            bound: {law: name for law in _ALL if (name := f"{law}_R{bound:g}mm{ending}") in found} for bound in BOUNDS
        }
        title = f"Payload [kg] against R, and what gives way beyond it; bound of the rotation {title}."
        tables.append(_line_table(found, title, "R [mm]", rows))
    return Outcome(numbers=_payloads(found) | _carried(found), tables=tuple(tables))


def _duration_outcome(readings: Readings, found: Found) -> Outcome:
    if not found:
        return Outcome()
    rows: dict[Number, dict[str, str]] = {
        duration: {law: f"{law}_{duration:g}s" for law in _ALL} for duration in DURATIONS
    }
    title = "Payload [kg] against the duration of the circle, and what gives way beyond it."
    return Outcome(
        numbers=_payloads(found) | _carried(found), tables=(_line_table(found, title, "duration [s]", rows),)
    )


def _circle_outcome(readings: Readings, found: Found) -> Outcome:
    numbers = _payloads(found) | _carried(found)
    payload, _ = _exact_arrays(found)
    if np.isfinite(payload).any():
        row, column = np.unravel_index(np.nanargmax(payload), payload.shape)
        numbers |= {
            "exact_largest_kg": float(payload[row, column]),
            "exact_largest_at_r_m": FINE_RADII[column],
            "exact_largest_at_z_m": FINE_HEIGHTS[row],
            "exact_widest_r_m": FINE_RADII[np.flatnonzero(np.isfinite(payload).any(axis=0))[-1]],
        }
    tables = []
    for law in _ADAPTIVE if readings.springs_play else ():
        rows: dict[Number, dict[str, str]] = {
            height: {f"r = {radius:g} m": _circle_name(law, radius, height) for radius in RADII} for height in HEIGHTS
        }
        title = f"{law}: payload [kg] against the circle's height z and radius r, and what gives way beyond it."
        tables.append(_line_table(found, title, "z [m]", rows))
    return Outcome(numbers=numbers, tables=tuple(tables))


def _draw_line(axes: Axes, points: Mapping[float, Point], law: str, *, below: float, style: str = "-") -> None:
    """Payloads of a law with a marker for what gives way; cases that carry nothing stand below zero."""
    colour, _ = _LINES[law]
    payload = [np.nan if one.payload is None else one.payload for one in points.values()]
    axes.plot(list(points), payload, style, color=colour, linewidth=1.6, zorder=2)
    for x, one in points.items():
        height, face = (below, "white") if one.payload is None else (one.payload, colour)
        axes.plot(x, height, _MARKERS[one.limit], color=face, markeredgecolor=colour, markersize=6, zorder=3)


def _rows(axes: Axes, found: Found, count: int) -> list[float]:
    """Heights of ``count`` rows of markers below zero [kg]; sets the axis."""
    top = 1.06 * _top(found)
    step = 0.05 * top
    low = -step * (count + 0.5)
    axes.axhspan(low, 0.0, color=SHADE, linewidth=0, zorder=0)
    axes.set(ylim=(low, top))
    axes.set_yticks(np.arange(0, top, 1.0))
    axes.annotate(
        "not even zero payload",
        (0.99, low / 2),
        xycoords=("axes fraction", "data"),
        horizontalalignment="right",
        verticalalignment="center",
        fontsize=9,
        color=GREY,
    )
    axes.grid(axis="y", color=SHADE, linewidth=0.7, zorder=0)
    return [-step * (row + 0.75) for row in range(count)]


def _mark(axes: Axes, where: Sequence[float], words: str) -> None:
    """Vertical lines at what the paper has."""
    for x in where:
        axes.axvline(x, color=GREY, linewidth=0.7, zorder=0)
    axes.annotate(words, (where[-1], 0.1), xytext=(4, 3), textcoords="offset points", fontsize=9, color=GREY)


def _legend(figure: Figure, axes: Axes, laws: Sequence[str], shown: Sequence[Point], lines: Mapping[str, str]) -> None:
    """Names of laws, line styles and markers."""
    for law in laws:
        axes.plot([], [], color=_LINES[law][0], linewidth=1.6, label=_LINES[law][1])
    for words, style in lines.items():
        axes.plot([], [], style, color="black", linewidth=1.2, label=words)
    for kind, marker in _MARKERS.items():
        if any(one.limit == kind for one in shown):
            words = {"scan_end": "or more", "terminated": "far off"}.get(kind, f"{kind} gives way")
            axes.plot([], [], marker, color="white", markeredgecolor=GREY, markeredgewidth=1.2, label=words)
    add_legend(figure, axes)


def _unplayable(readings: Readings, what: str) -> Figure:
    """In place of a map of closed loops, where no motor has the reading's torque-speed line."""
    figure = new_figure(1.6)
    entitle(figure, f"Payload against {what}", f"no closed loop has the torque-speed line {readings.line!r}")
    return figure


def _top(found: Found) -> float:
    return max([one.payload or 0.0 for one in found.values() if isinstance(one, Point)] + [1.0])


def _draw_stiffness(readings: Readings, found: Found) -> Figure:
    if not found:
        return _unplayable(readings, "stiffness")
    figure = new_figure(5.6)
    axes = figure.subplots()
    for (law, stiffnesses), below in zip(STIFFNESSES.items(), _rows(axes, found, len(STIFFNESSES)), strict=True):
        _draw_line(axes, {x: found[f"{law}_K{x:g}"] for x in stiffnesses}, law, below=below)
    for law in ("fl", "adaptive"):
        for case, style in (("limit", "--"), ("rigid", ":")):
            if (payload := found[f"{law}_{case}"].payload) is not None:
                axes.axhline(payload, color=_LINES[law][0], linestyle=style, linewidth=1.3, zorder=1)
    axes.set(xscale="log", xlim=(0.85, 1.2e4), xlabel="stiffness K [N·m/rad]", ylabel="payload [kg]")
    axes.xaxis.set_major_formatter("{x:g}")
    _mark(axes, (2.0, 3.0), "the paper's K")
    _legend(
        figure,
        axes,
        (*STIFFNESSES, "fl", "adaptive"),
        list(found.values()),
        {"flexible robot with K → ∞": "--", "rigid robot, its c of Table 4": ":"},
    )
    entitle(figure, "Payload against the stiffness of the joints", _SETTING)
    return figure


_SETTING = "the paper's circle at 500 Hz, payload told, task criterion, 10 mm and 10 mrad"


def _draw_bound(readings: Readings, found: Found) -> Figure:
    if not found:
        return _unplayable(readings, "the error bound")
    figure = new_figure(5.4)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, laws, title in zip(panels, (_ALL[:2], _ALL[2:]), ("rigid", "flexible"), strict=True):
        below = iter(_rows(axes, found, 3))
        for law in laws:
            for ending, style in _ENDINGS.items():
                names = {bound: f"{law}_R{bound:g}mm{ending}" for bound in BOUNDS}
                if points := {x: found[name] for x, name in names.items() if name in found}:
                    _draw_line(axes, points, law, below=next(below), style=style)
        axes.set(xlabel="position bound R [mm]", title=title, xlim=(0, 1.05 * max(BOUNDS)))
        axes.set_xticks(np.arange(0, max(BOUNDS) + 1, 5))
        _mark(axes, (10.0,), "the paper's R")
    panels[0].set_ylabel("payload [kg]")
    _legend(
        figure,
        panels[0],
        _ALL,
        list(found.values()),
        {"rotation bound 10 mrad": "-", "rotation bound 1 mrad per mm": "--"},
    )
    entitle(figure, "Payload against the bound of the error", _SETTING.removesuffix(", 10 mm and 10 mrad"))
    return figure


def _draw_duration(readings: Readings, found: Found) -> Figure:
    if not found:
        return _unplayable(readings, "the duration")
    figure = new_figure(5.2)
    axes = figure.subplots()
    for law, below in zip(_ALL, _rows(axes, found, len(_ALL)), strict=True):
        points = {duration: found[f"{law}_{duration:g}s"] for duration in DURATIONS}
        _draw_line(axes, points, law, below=below)
    axes.set(xlabel="duration of the circle [s]", ylabel="payload [kg]", xlim=(0.6, 1.02 * max(DURATIONS)))
    axes.set_xticks(DURATIONS, [f"{duration:g}" for duration in DURATIONS])
    _mark(axes, (1.0,), "the paper's duration")
    _legend(figure, axes, _ALL, list(found.values()), {})
    entitle(figure, "Payload against the duration of the circle", _SETTING)
    return figure


_CONTOURS = (2, 5, 10, 15, 20)
"""[kg]"""


def _draw_circle(readings: Readings, found: Found) -> Figure:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, Normalize

    payload, weak = _exact_arrays(found)
    most = float(np.nanmax([_top(found), *payload.ravel()]))
    scale, colours = Normalize(0.0, most), colormaps["viridis"]
    laws = _ADAPTIVE if readings.springs_play else ()
    figure = new_figure(5.0)
    panels = figure.subplots(1, 1 + len(laws), squeeze=False)[0]
    first, grid = panels[0], (FINE_RADII, FINE_HEIGHTS)
    first.pcolormesh(*grid, weak, cmap=ListedColormap([SHADE, SKY]), shading="nearest", rasterized=True)
    image = first.pcolormesh(*grid, payload, norm=scale, cmap=colours, shading="nearest", rasterized=True)
    if levels := [level for level in _CONTOURS if np.nanmin(payload, initial=np.inf) < level < np.nanmax(payload)]:
        lines = first.contour(*grid, payload, levels=levels, colors="white", linewidths=1.0)
        first.clabel(lines, fmt="%g", fontsize=8.5)
    first.plot(*PAPER_CIRCLE, "*", color="white", markeredgecolor="black", markersize=11)
    first.set(title="rigid: exact tracking", xlabel="radius [m]", ylabel="depth z below the anchors [m]")
    first.set_yticks(np.arange(0.1, 0.31, 0.05))
    first.invert_yaxis()
    for axes, law in zip(panels[1:], laws, strict=True):
        _draw_cells(axes, found, law, scale, colours)
        axes.set(title=_LINES[law][1], xlabel="radius [m]", ylabel="z [m]")
    figure.colorbar(image, ax=panels, label="payload [kg]")
    entitle(
        figure,
        "Payload against radius and depth of the circle, 1 s long, tilted by 0.1 rad; star or frame: the paper's",
        "exact tracking: grey, no payload keeps all cables taut; pale blue, motors too weak for the platform alone",
        "closed loop: payload [kg] and what gives way beyond it, 10 mm and 10 mrad; grey, not even zero payload",
    )
    return figure


def _draw_cells(axes: Axes, found: Found, law: str, scale: Any, colours: Any) -> None:
    """A value for each circle, and what gives way beyond it."""
    for row, height in enumerate(HEIGHTS):
        for column, radius in enumerate(RADII):
            one = found[_circle_name(law, radius, height)]
            face = SHADE if one.payload is None else colours(scale(one.payload))
            bright = one.payload is None or scale(one.payload) > 0.6
            axes.fill_between([column, column + 1], row, row + 1, color=face, linewidth=0)
            axes.annotate(
                f"{'–' if one.payload is None else f'{one.payload:.1f}'}\n{one.limit}",
                (column + 0.5, row + 0.5),
                horizontalalignment="center",
                verticalalignment="center",
                fontsize=8.5,
                color="black" if bright else "white",
            )
    if PAPER_CIRCLE[0] in RADII and PAPER_CIRCLE[1] in HEIGHTS:
        x, y = RADII.index(PAPER_CIRCLE[0]), HEIGHTS.index(PAPER_CIRCLE[1])
        axes.plot([x, x + 1, x + 1, x, x], [y, y, y + 1, y + 1, y], color="black", linewidth=1.6, zorder=4)
    axes.set(xlim=(0, len(RADII)), ylim=(len(HEIGHTS), 0))
    axes.set_xticks(np.arange(len(RADII)) + 0.5, [f"{radius:g}" for radius in RADII])
    axes.set_yticks(np.arange(len(HEIGHTS)) + 0.5, [f"{height:g}" for height in HEIGHTS])


_READ = (
    "Task criterion, 500 Hz, payload told. Markers tell what gives way beyond the payload; motors clip long before it "
    "(`cases_with_a_motor_at_its_limit` of `cases_carried`)."
)

PARTS: tuple[Part, ...] = (
    Part(
        name="map-stiffness",
        title="Payload against stiffness",
        text=(
            "The paper's circle with springs from 1 to 10 000 N·m/rad. As K grows, `composite` becomes the rigid law, "
            "and its payload that of a rigid robot with rotor and pulley as one: without the friction c of Table 4, "
            "which the paper's flexible robot does not have. Softer springs carry a little more, for they smooth the "
            "jump of the acceleration; still softer ones follow too late. `adaptive-composite` damps its springs by "
            "0.4 √(K J′), which below K = 2 is less than its outer loop feeds them. Stiff springs end `fl4` and "
            "`motor-pd`, for which 500 commands a second are then too few. " + _READ
        ),
        cells=_stiffness_cells,
        outcome=_stiffness_outcome,
        draw=_draw_stiffness,
    ),
    Part(
        name="map-bound",
        title="Payload against the bound of the error",
        text=(
            "The same circle with other bounds R of the position error. The bound of the rotation error stays at "
            "10 mrad; for the two laws that it limits, it also follows R at 1 mrad per mm. " + _READ
        ),
        cells=_bound_cells,
        outcome=_bound_outcome,
        draw=_draw_bound,
    ),
    Part(
        name="map-duration",
        title="Payload against duration",
        text="The same circle, faster and slower; its acceleration goes with the inverse square of the time. " + _READ,
        cells=_duration_cells,
        outcome=_duration_outcome,
        draw=_draw_duration,
    ),
    Part(
        name="map-circle",
        title="Payload against radius and depth of the circle",
        text=(
            "The paper's circle with other radii and depths z of its plane, angles 0.1 rad as in Table 3, in 1 s. On "
            "the left the payload of exact tracking in closed form, without feedback or bounds; then the two laws that "
            "carry most in closed loop, within 10 mm and 10 mrad. Near the anchors' plane cables are flat and motors "
            "too weak; deep below it they carry more, but wide circles slacken a cable. A payload is the upper end of "
            "the feasible interval that contains zero: some circles that slacken a cable at zero would carry more."
        ),
        cells=_circle_cells,
        outcome=_circle_outcome,
        draw=_draw_circle,
    ),
)
"""In the order of the page."""
