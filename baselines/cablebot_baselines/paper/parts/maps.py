"""Maps beyond the paper: payload versus stiffness, error bound, duration, and radius and height of the circle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines.paper.exact import COARSE
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Cell, CellResults, Number, Outcome, Part, Table
from cablebot_baselines.paper.runs import largest_payload
from cablebot_gym.bounds import ExactPayload, exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.comparison import COLOURS
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import PaperCircle
from cablebot_gym.utils.palette import GREY, SHADE, SKY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RESOLUTION = 1e-2
"""Resolution of the payloads [kg]."""

STIFFNESSES = {
    "composite": (1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 1000.0, 1e4),
    "adaptive-composite": (1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 1000.0),
    "fl4": (1.0, 2.0, 3.0, 10.0, 30.0, 100.0),
    "motor-pd": (1.0, 2.0, 3.0, 10.0, 100.0, 1000.0),
}
"""Stiffnesses K of each law [N·m/rad]; stiff springs require long computations."""

BOUNDS = (1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0)
"""Position error bounds R [mm]."""

DURATIONS = (0.7, 0.8, 0.9, 1.0, 1.5, 2.0, 3.0)
"""Durations of the circle [s]."""

RADII = (0.05, 0.1, 0.15, 0.2)
"""Radii of the circle [m]."""

HEIGHTS = (0.08, 0.1, 0.15, 0.25)
"""Depths z of the circle below the base anchors [m]."""

PAPER_CIRCLE = (0.1, 0.1)
"""Radius and depth of the circle of Table 3 [m]."""

FINE_RADII = tuple(np.linspace(0.02, 0.21, 20).round(4).tolist())
"""Radii of the circles for exact tracking [m]."""

FINE_HEIGHTS = tuple(np.linspace(0.06, 0.33, 28).round(4).tolist())
"""Depths z of the circles for exact tracking [m]."""

LIGHT_LOAD, HEAVY_LOAD = 10.0, 30.0
"""Upper ends of the payload scans [kg]; the second one is for deep circles. No payload of the paper robots is cut."""

_LINES = {
    "fl": (COLOURS[0], "rigid: fl, the paper's law"),
    "adaptive": (COLOURS[1], "rigid: adaptive"),
    "composite": (COLOURS[2], "flexible: composite"),
    "adaptive-composite": (COLOURS[3], "flexible: adaptive-composite"),
    "fl4": (COLOURS[4], "flexible: fl4"),
    "motor-pd": (COLOURS[5], "flexible: motor-pd"),
}
"""Colour and legend text of each law."""

_MARKERS = {"rotation": "o", "position": "s", "slack": "v", "terminated": "X", "scan_end": "^"}
"""Marker of each limiting violation."""

_ADAPTIVE, _NOT_ADAPTIVE = ("adaptive", "adaptive-composite"), ("fl", "composite")
_ALL = ("fl", "adaptive", "composite", "adaptive-composite")
_ENDINGS = {"": "-", "_scaled": "--"}
"""Suffixes of the point names with their line styles: rotation bound 10 mrad, or 1 mrad per mm of R."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """Largest payload and limiting violation of one case."""

    payload: float | None
    """Largest payload [kg]; None if the robot fails unloaded."""
    violation: str
    """Kind of the limiting violation, or ``scan_end``."""
    time: float | None
    """Time of the limiting violation [s]; None at the end of the scan."""
    saturated: bool
    """Whether a motor saturates during the motion at this payload."""

    def text(self) -> str:
        """Limiting violation and its time as text."""
        return self.violation.replace("_", " ") + ("" if self.time is None else f" {self.time:.2f} s")


def point(*, policy: str, robot: Robot, **keywords: Any) -> Point:
    """Largest payload of a named law with known payload under the task criterion.

    Args:
        policy: name of a law, which is built for the robot.
        robot: spatial robot.
        keywords: arguments of :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc`.
    """
    result = largest_payload(
        env_id="CableBot-FlexSpatial-v0" if robot.flexible else "CableBot-Spatial-v0",
        law=partial(load_policy, policy),
        robot=robot,
        name=policy,
        **{"payload_max": LIGHT_LOAD, "resolution": RESOLUTION} | keywords,
    )
    action = float(np.abs(result.history["commanded_action"]).max())
    violation, time = ("scan_end", None) if result.violation is None else (result.violation.kind, result.violation.time)
    return Point(payload=result.payload, violation=violation, time=time, saturated=action > 1 - 1e-9)


def exact_map(*, robot: Robot, line_speed: Array) -> list[list[ExactPayload]]:
    """Exact tracking on all fine circles, one row for each depth.

    Args:
        robot: rigid robot.
        line_speed: see :func:`~cablebot_gym.evaluation.exact_payload`.
    """
    return [
        [exact_payload(robot, circle(radius, height), line_speed=line_speed, grid=COARSE) for radius in FINE_RADII]
        for height in FINE_HEIGHTS
    ]


def circle(radius: float, height: float) -> PaperCircle:
    """Circle of Table 3 with another radius and depth [m]."""
    return PaperCircle(name="circle", radius=radius, center=(0.0, 0.0, height, 0.1, 0.1, 0.1))


def _robots(interpretation: Interpretation) -> dict[str, Robot]:
    """Robot of each law."""
    rigid, flexible = (
        interpretation.motors(robot)
        for robot in (interpretation.spatial("payload"), interpretation.flexible("payload"))
    )
    return {law: rigid if law in ("fl", "adaptive") else flexible for law in _LINES}


def _stiff(robot: Robot, stiffness: float) -> Robot:
    return robot.replace(transmission=robot.transmission.replace(stiffness=stiffness))


def _rigid_limit(robot: Robot) -> Robot:
    """Rigid limit K → ∞ of a flexible robot, in which rotor and pulley turn together."""
    old = robot.transmission
    joined = old.replace(
        pulley_inertia=tuple(robot.pulley_inertia + robot.motor_inertia),
        damping=tuple(robot.damping + robot.motor_damping),
        stiffness=None,
        motor_inertia=None,
        motor_damping=0.0,
    )
    return robot.replace(transmission=joined)


def _stiffness_cells(interpretation: Interpretation) -> dict[str, Cell]:
    if not interpretation.flexible_loop_possible:
        return {}
    robots = _robots(interpretation)
    cells: dict[str, Cell] = {}
    for law, stiffnesses in STIFFNESSES.items():
        for stiffness in stiffnesses:
            cells[f"{law}_K{stiffness:g}"] = partial(point, policy=law, robot=_stiff(robots[law], stiffness))
    for law in ("fl", "adaptive"):
        cells[f"{law}_rigid"] = partial(point, policy=law, robot=robots[law])
        cells[f"{law}_limit"] = partial(point, policy=law, robot=_rigid_limit(robots["composite"]))
    return cells


def _bound_cells(interpretation: Interpretation) -> dict[str, Cell]:
    if not interpretation.flexible_loop_possible:
        return {}
    cells: dict[str, Cell] = {}
    for law, robot in _robots(interpretation).items():
        for ending in _ENDINGS if law in _NOT_ADAPTIVE else ("",) if law in _ALL else ():
            for bound in BOUNDS:
                error_bounds = ErrorBounds(position=1e-3 * bound, **({"rotation": 1e-3 * bound} if ending else {}))
                changed = {} if error_bounds == ErrorBounds() else {"error_bounds": error_bounds}
                cells[f"{law}_R{bound:g}mm{ending}"] = partial(point, policy=law, robot=robot, **changed)
    return cells


def _duration_cells(interpretation: Interpretation) -> dict[str, Cell]:
    if not interpretation.flexible_loop_possible:
        return {}
    cells: dict[str, Cell] = {}
    for law, robot in _robots(interpretation).items():
        for duration in DURATIONS if law in _ALL else ():
            changed = {} if duration == 1.0 else {"trajectory": {"name": "paper-spatial", "duration": duration}}
            cells[f"{law}_{duration:g}s"] = partial(point, policy=law, robot=robot, **changed)
    return cells


def _circle_cells(interpretation: Interpretation) -> dict[str, Cell]:
    robot = interpretation.spatial("payload")
    cells: dict[str, Cell] = {"exact": partial(exact_map, robot=robot, line_speed=interpretation.line_speed(robot))}
    if not interpretation.flexible_loop_possible:
        return cells
    robots = _robots(interpretation)
    for law in _ADAPTIVE:
        for height in HEIGHTS:
            for radius in RADII:
                papers = (radius, height) == PAPER_CIRCLE
                changed = {} if papers else {"trajectory": circle(radius, height), "payload_max": HEAVY_LOAD}
                cells[_circle_name(law, radius, height)] = partial(point, policy=law, robot=robots[law], **changed)
    return cells


def _circle_name(law: str, radius: float, height: float) -> str:
    return f"{law}_r{radius:g}_z{height:g}"


def _payloads(results: CellResults) -> dict[str, Number]:
    """All payloads by name."""
    return {f"{name}_kg": one.payload for name, one in results.items() if isinstance(one, Point)}


def _case_counts(results: CellResults) -> dict[str, Number]:
    """Number of cases with a feasible payload, and number of these cases in which a motor saturates."""
    feasible = [one for one in results.values() if isinstance(one, Point) and one.payload is not None]
    return {
        "feasible_cases": len(feasible),
        "feasible_cases_with_saturation": sum(one.saturated for one in feasible),
    }


def _line_table(results: CellResults, title: str, first: str, rows: Mapping[Number, Mapping[str, str]]) -> Table:
    """Table with one row for each abscissa and the payload and limiting violation of each named point."""
    columns = list(dict.fromkeys(column for names in rows.values() for column in names))
    header = [first]
    for column in columns:
        header += [f"{column} [kg]", "limiting violation"]
    lines: list[tuple[Number, ...]] = []
    for abscissa, names in rows.items():
        line: list[Number] = [abscissa]
        for column in columns:
            one = results.get(names.get(column, ""))
            line += [None, None] if one is None else [one.payload, one.text()]
        lines.append(tuple(line))
    return Table(title=title, header=tuple(header), rows=tuple(lines))


def _exact_arrays(results: CellResults) -> tuple[Array, Array]:
    """Payloads of exact tracking (NaN if the robot fails unloaded), and a mask of the cases with too weak motors."""
    exact: list[list[ExactPayload]] = results["exact"]
    payload = [[one.payload if one.lowest <= 0 <= one.payload else np.nan for one in row] for row in exact]
    weak = [[one.lowest <= 0 and -np.inf < one.payload < 0 for one in row] for row in exact]
    return np.array(payload), np.array(weak)


def _stiffness_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    if not results:
        return Outcome()
    every = sorted(set().union(*STIFFNESSES.values()))
    rows: dict[Number, dict[str, str]] = {
        stiffness: {law: f"{law}_K{stiffness:g}" for law in STIFFNESSES} for stiffness in every
    }
    rigid: tuple[tuple[Number, ...], ...] = tuple(
        (law, robot, results[f"{law}_{case}"].payload, results[f"{law}_{case}"].text())
        for law in ("fl", "adaptive")
        for case, robot in (("limit", "flexible, K → ∞, no friction"), ("rigid", "rigid, with friction"))
    )
    table = "Payload [kg] versus K with limiting violation. One dash: fails unloaded. Two dashes: not evaluated."
    return Outcome(
        numbers=_payloads(results) | _case_counts(results),
        tables=(
            _line_table(results, table, "K [N·m/rad]", rows),
            Table(
                title="Rigid robots for comparison.",
                header=("law", "robot", "payload [kg]", "limiting violation"),
                rows=rigid,
            ),
        ),
    )


def _bound_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    if not results:
        return Outcome()
    tables = []
    for ending, title in zip(_ENDINGS, ("10 mrad", "1 mrad per mm of R"), strict=True):
        rows: dict[Number, dict[str, str]] = {
            bound: {law: name for law in _ALL if (name := f"{law}_R{bound:g}mm{ending}") in results} for bound in BOUNDS
        }
        title = f"Payload [kg] versus R with limiting violation; rotation bound {title}."
        tables.append(_line_table(results, title, "R [mm]", rows))
    return Outcome(numbers=_payloads(results) | _case_counts(results), tables=tuple(tables))


def _duration_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    if not results:
        return Outcome()
    rows: dict[Number, dict[str, str]] = {
        duration: {law: f"{law}_{duration:g}s" for law in _ALL} for duration in DURATIONS
    }
    title = "Payload [kg] versus duration of the circle with limiting violation."
    return Outcome(
        numbers=_payloads(results) | _case_counts(results), tables=(_line_table(results, title, "duration [s]", rows),)
    )


def _circle_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    numbers = _payloads(results) | _case_counts(results)
    payload, _ = _exact_arrays(results)
    if np.isfinite(payload).any():
        row, column = np.unravel_index(np.nanargmax(payload), payload.shape)
        numbers |= {
            "exact_largest_kg": float(payload[row, column]),
            "exact_largest_at_r_m": FINE_RADII[column],
            "exact_largest_at_z_m": FINE_HEIGHTS[row],
            "exact_widest_r_m": FINE_RADII[np.flatnonzero(np.isfinite(payload).any(axis=0))[-1]],
        }
    tables = []
    for law in _ADAPTIVE if interpretation.flexible_loop_possible else ():
        rows: dict[Number, dict[str, str]] = {
            height: {f"r = {radius:g} m": _circle_name(law, radius, height) for radius in RADII} for height in HEIGHTS
        }
        title = f"{law}: payload [kg] versus depth z and radius r of the circle with limiting violation."
        tables.append(_line_table(results, title, "z [m]", rows))
    return Outcome(numbers=numbers, tables=tuple(tables))


def _draw_line(axes: Axes, points: Mapping[float, Point], law: str, *, below: float, style: str = "-") -> None:
    """Draws the payloads of a law with markers for the limiting violation; cases that fail unloaded are below zero."""
    colour, _ = _LINES[law]
    payload = [np.nan if one.payload is None else one.payload for one in points.values()]
    axes.plot(list(points), payload, style, color=colour, linewidth=1.6, zorder=2)
    for x, one in points.items():
        height, face = (below, "white") if one.payload is None else (one.payload, colour)
        axes.plot(x, height, _MARKERS[one.violation], color=face, markeredgecolor=colour, markersize=6, zorder=3)


def _rows(axes: Axes, results: CellResults, count: int) -> list[float]:
    """Sets the axis and returns the heights of ``count`` rows of markers below zero [kg]."""
    top = 1.06 * _top(results)
    step = 0.05 * top
    low = -step * (count + 0.5)
    axes.axhspan(low, 0.0, color=SHADE, linewidth=0, zorder=0)
    axes.set(ylim=(low, top))
    axes.set_yticks(np.arange(0, top, 1.0))
    axes.annotate(
        "fails unloaded",
        (0.99, low / 2),
        xycoords=("axes fraction", "data"),
        horizontalalignment="right",
        verticalalignment="center",
        fontsize=9,
        color=GREY,
    )
    axes.grid(axis="y", color=SHADE, linewidth=0.7, zorder=0)
    return [-step * (row + 0.75) for row in range(count)]


def _mark(axes: Axes, positions: Sequence[float], text: str) -> None:
    """Draws vertical lines at the values of the paper."""
    for x in positions:
        axes.axvline(x, color=GREY, linewidth=0.7, zorder=0)
    axes.annotate(text, (positions[-1], 0.1), xytext=(4, 3), textcoords="offset points", fontsize=9, color=GREY)


def _legend(figure: Figure, axes: Axes, laws: Sequence[str], shown: Sequence[Point], lines: Mapping[str, str]) -> None:
    """Adds a legend with laws, line styles and markers."""
    for law in laws:
        axes.plot([], [], color=_LINES[law][0], linewidth=1.6, label=_LINES[law][1])
    for words, style in lines.items():
        axes.plot([], [], style, color="black", linewidth=1.2, label=words)
    for kind, marker in _MARKERS.items():
        if any(one.violation == kind for one in shown):
            words = {"scan_end": "end of scan", "terminated": "terminated"}.get(kind, f"{kind} violation")
            axes.plot([], [], marker, color="white", markeredgecolor=GREY, markeredgewidth=1.2, label=words)
    add_legend(figure, axes)


def _draw_no_closed_loop(interpretation: Interpretation, name: str) -> Figure:
    """Figure in place of a map if no motor can have the torque-speed line in closed loop."""
    figure = new_figure(1.6)
    set_title(
        figure,
        f"Payload versus {name}",
        f"no closed loop with the line {interpretation.line!r}",
    )
    return figure


def _top(results: CellResults) -> float:
    return max([one.payload or 0.0 for one in results.values() if isinstance(one, Point)] + [1.0])


def _draw_stiffness(interpretation: Interpretation, results: CellResults) -> Figure:
    if not results:
        return _draw_no_closed_loop(interpretation, "stiffness")
    figure = new_figure(5.6)
    axes = figure.subplots()
    for (law, stiffnesses), below in zip(STIFFNESSES.items(), _rows(axes, results, len(STIFFNESSES)), strict=True):
        _draw_line(axes, {x: results[f"{law}_K{x:g}"] for x in stiffnesses}, law, below=below)
    for law in ("fl", "adaptive"):
        for case, style in (("limit", "--"), ("rigid", ":")):
            if (payload := results[f"{law}_{case}"].payload) is not None:
                axes.axhline(payload, color=_LINES[law][0], linestyle=style, linewidth=1.3, zorder=1)
    axes.set(xscale="log", xlim=(0.85, 1.2e4), xlabel="stiffness K [N·m/rad]", ylabel="payload [kg]")
    axes.xaxis.set_major_formatter("{x:g}")
    _mark(axes, (2.0, 3.0), "K of the paper")
    _legend(
        figure,
        axes,
        (*STIFFNESSES, "fl", "adaptive"),
        list(results.values()),
        {"flexible robot with K → ∞": "--", "rigid robot, c of Table 4": ":"},
    )
    set_title(figure, "Payload versus joint stiffness", _SETTING)
    return figure


_SETTING = "circle of the paper, 500 Hz, payload known, task criterion, 10 mm and 10 mrad"


def _draw_bound(interpretation: Interpretation, results: CellResults) -> Figure:
    if not results:
        return _draw_no_closed_loop(interpretation, "the error bound")
    figure = new_figure(5.4)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, laws, title in zip(panels, (_ALL[:2], _ALL[2:]), ("rigid", "flexible"), strict=True):
        below = iter(_rows(axes, results, 3))
        for law in laws:
            for ending, style in _ENDINGS.items():
                names = {bound: f"{law}_R{bound:g}mm{ending}" for bound in BOUNDS}
                if points := {x: results[name] for x, name in names.items() if name in results}:
                    _draw_line(axes, points, law, below=next(below), style=style)
        axes.set(xlabel="position bound R [mm]", title=title, xlim=(0, 1.05 * max(BOUNDS)))
        axes.set_xticks(np.arange(0, max(BOUNDS) + 1, 5))
        _mark(axes, (10.0,), "R of the paper")
    panels[0].set_ylabel("payload [kg]")
    _legend(
        figure,
        panels[0],
        _ALL,
        list(results.values()),
        {"rotation bound 10 mrad": "-", "rotation bound 1 mrad per mm": "--"},
    )
    set_title(figure, "Payload versus error bound", _SETTING.removesuffix(", 10 mm and 10 mrad"))
    return figure


def _draw_duration(interpretation: Interpretation, results: CellResults) -> Figure:
    if not results:
        return _draw_no_closed_loop(interpretation, "the duration")
    figure = new_figure(5.2)
    axes = figure.subplots()
    for law, below in zip(_ALL, _rows(axes, results, len(_ALL)), strict=True):
        points = {duration: results[f"{law}_{duration:g}s"] for duration in DURATIONS}
        _draw_line(axes, points, law, below=below)
    axes.set(xlabel="duration of the circle [s]", ylabel="payload [kg]", xlim=(0.6, 1.02 * max(DURATIONS)))
    axes.set_xticks(DURATIONS, [f"{duration:g}" for duration in DURATIONS])
    _mark(axes, (1.0,), "duration of the paper")
    _legend(figure, axes, _ALL, list(results.values()), {})
    set_title(figure, "Payload versus duration of the circle", _SETTING)
    return figure


_CONTOURS = (2, 5, 10, 15, 20)
"""Payloads of the contour lines [kg]."""


def _draw_circle(interpretation: Interpretation, results: CellResults) -> Figure:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, Normalize

    payload, weak = _exact_arrays(results)
    most = float(np.nanmax([_top(results), *payload.ravel()]))
    scale, colours = Normalize(0.0, most), colormaps["viridis"]
    laws = _ADAPTIVE if interpretation.flexible_loop_possible else ()
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
        _draw_cells(axes, results, law, scale, colours)
        axes.set(title=_LINES[law][1], xlabel="radius [m]", ylabel="z [m]")
    figure.colorbar(image, ax=panels, label="payload [kg]")
    set_title(
        figure,
        "Payload versus radius and depth of the circle (1 s, tilted by 0.1 rad); star or frame: circle of the paper",
        "exact tracking; grey: no payload keeps all cables taut; pale blue: motors too weak for the platform alone",
        "closed loop: payload [kg] and limiting violation, 10 mm and 10 mrad; grey: fails unloaded",
    )
    return figure


def _draw_cells(axes: Axes, results: CellResults, law: str, scale: Any, colours: Any) -> None:
    """Draws the payload and the limiting violation of each circle."""
    for row, height in enumerate(HEIGHTS):
        for column, radius in enumerate(RADII):
            one = results[_circle_name(law, radius, height)]
            face = SHADE if one.payload is None else colours(scale(one.payload))
            bright = one.payload is None or scale(one.payload) > 0.6
            axes.fill_between([column, column + 1], row, row + 1, color=face, linewidth=0)
            axes.annotate(
                f"{'–' if one.payload is None else f'{one.payload:.1f}'}\n{one.violation}",
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


_NOTES = (
    "Task criterion, 500 Hz, payload known. Markers show the limiting violation. Motors saturate at much smaller "
    "payloads (`feasible_cases_with_saturation` of `feasible_cases`)."
)

PARTS: tuple[Part, ...] = (
    Part(
        name="map-stiffness",
        title="Payload versus stiffness",
        text=(
            "Circle of the paper with springs from 1 to 10 000 N·m/rad. For large K, `composite` becomes the rigid "
            "law. Its payload approaches that of a rigid robot in which rotor and pulley turn together, without the "
            "friction c of Table 4, which the flexible robot of the paper does not have. Softer springs give a "
            "slightly larger payload, because they smooth the jump of the acceleration. Very soft springs respond too "
            "late. `adaptive-composite` damps its springs by 0.4 √(K J′). For K < 2 this is less than the excitation "
            "by its outer loop. `fl4` and `motor-pd` fail with stiff springs, because 500 Hz is too slow for them. "
            + _NOTES
        ),
        cells=_stiffness_cells,
        outcome=_stiffness_outcome,
        draw=_draw_stiffness,
    ),
    Part(
        name="map-bound",
        title="Payload versus error bound",
        text=(
            "Circle of the paper with other bounds R of the position error. The bound of the rotation error is 10 "
            "mrad. For the two laws that it limits, the map also shows a bound of 1 mrad per mm of R. " + _NOTES
        ),
        cells=_bound_cells,
        outcome=_bound_outcome,
        draw=_draw_bound,
    ),
    Part(
        name="map-duration",
        title="Payload versus duration",
        text="Circle of the paper with other durations. The acceleration is proportional to the inverse square of the "
        "duration. " + _NOTES,
        cells=_duration_cells,
        outcome=_duration_outcome,
        draw=_draw_duration,
    ),
    Part(
        name="map-circle",
        title="Payload versus radius and depth of the circle",
        text=(
            "Circle of the paper with other radii and depths z, angles of 0.1 rad as in Table 3, duration 1 s. Left: "
            "payload of exact tracking in closed form, without feedback and error bounds. Right: closed loops of the "
            "two laws with the largest payloads, within 10 mm and 10 mrad. Near the plane of the anchors the cables "
            "are flat and the motors too weak. Deep below this plane the payloads are larger, but a cable becomes "
            "slack on wide circles. The payload is the upper end of the feasible interval that contains zero. Some "
            "circles with a slack cable at zero payload are feasible at larger payloads."
        ),
        cells=_circle_cells,
        outcome=_circle_outcome,
        draw=_draw_circle,
    ),
)
"""Maps in the order of the page."""
