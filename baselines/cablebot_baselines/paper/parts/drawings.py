"""Figs. 1 to 3: robots and elastic joint, drawn with the geometry and the parameters of the plants."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Cell, CellResults, Outcome, Part, Table
from cablebot_gym.kinematics import Array, cable_lengths, cable_vectors
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.comparison import COLOURS
from cablebot_gym.plotting.figures import new_figure, set_title
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, SKY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOTORS = COLOURS[:6]
"""Colours of the motors and their cables."""

PLATFORM_CORNERS = ("P1", "P1", "P3", "P3", "P2", "P2")
BASE_CORNERS = ("A1", "A2", "A2", "A3", "A3", "A1")
"""Corners at which cables 1 to 6 end (ring of Fig. 2)."""

_AZIMUTH, _ELEVATION = np.radians((-72.0, 30.0))
"""View direction of the spatial robot with z down: slightly to the right of +y and from above [rad]."""

_COUNT = 201
"""Number of instants of a drawn path."""


def path(robot: Robot) -> tuple[Array, Reference]:
    """Instants of the circle of the paper [s] and the motion at these instants."""
    circle = paper_circle(robot)
    times = np.linspace(0.0, circle.duration, _COUNT)
    return times, circle(times)


def spring_modes(robot: Robot) -> Array:
    """Frequencies of the oscillation of the motors against pulleys and platform at home, ascending [Hz].

    These are the modes of the motion that :func:`~cablebot_gym.physics.textbook.highest_frequency` describes. The twist
    δ = β′ − β of the free robot satisfies δ̈ = −(1/J′ + (S/r) M⁻¹ (S/r)ᵀ) K δ with the mass matrix M of platform and
    pulleys.
    """
    turning = textbook.jacobian(robot, robot.home) / robot.pulley_radius[:, None]
    pulleys = turning.T @ (robot.pulley_inertia[:, None] * turning)
    inertia = textbook.mass_matrix(robot, robot.mass, robot.home) + pulleys
    mobility = np.diag(1 / robot.motor_inertia) + turning @ np.linalg.solve(inertia, turning.T)
    squares = np.linalg.eigvals(mobility * robot.stiffness).real
    return np.sqrt(np.sort(squares)) / (2 * np.pi)


def wind_up(robot: Robot, pose: Array) -> Array:
    """Static twist β′ − β of the joints of a flexible robot, shape (..., m) [rad]."""
    return textbook.static_torque(robot, robot.mass, pose) / robot.stiffness


def _no_cells(interpretation: Interpretation) -> dict[str, Cell]:
    return {}


def _spatial_cells(interpretation: Interpretation) -> dict[str, Cell]:
    """No cells; raises NoEquilibriumError if the interpretation does not allow the robot."""
    interpretation.spatial("control")
    return {}


def _lengths(robot: Robot) -> tuple[Array, Array]:
    times, motion = path(robot)
    return times, cable_lengths(robot.base, robot.platform, motion.position)


def _draw_lengths(axes: Axes, robot: Robot) -> None:
    times, lengths = _lengths(robot)
    for cable in range(robot.cables):
        axes.plot(times, lengths[:, cable], color=MOTORS[cable], linewidth=1.6, label=f"cable {cable + 1}")
    low, high = lengths.min(), lengths.max()
    axes.set(xlim=(times[0], times[-1]), ylim=(low - 0.1 * (high - low), high + 0.1 * (high - low)))
    axes.set(xlabel="time [s]", ylabel="cable length on the path [m]")
    axes.legend(frameon=False, fontsize=9, ncols=robot.cables // 3, loc="upper right")
    axes.set_ylim(top=high + 0.3 * (high - low))


def _interpretation_line(interpretation: Interpretation) -> list[str]:
    """Title line on the interpretation if it differs from the default."""
    return [] if interpretation == Interpretation() else [f"interpretation: {interpretation.text()}"]


def _write(axes: Axes, position: Array, text: str, **style: Any) -> None:
    """Writes text centred at a position."""
    axes.text(float(position[0]), float(position[1]), text, **{"ha": "center", "va": "center", **style})


def _arrow(axes: Axes, start: Array, end: Array, style: str = "-|>", colour: str = "black") -> None:
    properties = {"arrowstyle": style, "color": colour, "linewidth": 1.0}
    axes.annotate("", tuple(end), xytext=tuple(start), arrowprops=properties)


def _box(colour: str = "white") -> dict[str, Any]:
    return {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": colour, "linewidth": 0.8}


# Fig. 1


def _planar_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    robot = interpretation.planar
    sides = np.linalg.norm(robot.base - np.roll(robot.base, 1, axis=0), axis=1)
    lengths = _lengths(robot)[1]
    motion = path(robot)[1]
    return Outcome(
        numbers={
            "side_m": float(sides.mean()),
            "path_radius_m": float(np.linalg.norm(motion.position - robot.base.mean(axis=0), axis=1).max()),
            "shortest_cable_m": float(lengths.min()),
            "longest_cable_m": float(lengths.max()),
        }
    )


def _draw_planar(interpretation: Interpretation, results: CellResults) -> Figure:
    robot = interpretation.planar
    figure = new_figure(4.9)
    plane, lengths = figure.subplots(1, 2, width_ratios=[1.35, 1])
    _draw_plane(plane, robot)
    _draw_lengths(lengths, robot)
    mass = f"point mass m = {robot.mass:g} kg, pulleys r = {1e3 * robot.pulley_radius[0]:g} mm (to scale)"
    set_title(figure, f"Planar robot (Tables 1 and 2): {mass}; dashed: the path", *_interpretation_line(interpretation))
    return figure


def _draw_plane(axes: Axes, robot: Robot) -> None:
    from matplotlib.patches import Arc, Circle, Polygon

    motion = path(robot)[1]
    start, middle = motion.position[0], robot.base.mean(axis=0)
    axes.add_patch(Polygon(robot.base, closed=True, facecolor="none", edgecolor=GREY, linewidth=1.0))
    axes.plot(*motion.position.T, "--", color="black", linewidth=1.0)
    lowest = int(np.argmin(motion.position[:, 1]))
    _arrow(axes, motion.position[lowest - 1], motion.position[lowest + 1])
    for i, anchor in enumerate(robot.base):
        cable = start - anchor
        angle = float(np.degrees(np.arctan2(cable[1], cable[0])))
        outward = (anchor - middle) / np.linalg.norm(anchor - middle)
        axes.add_patch(Circle(anchor, robot.pulley_radius[i], facecolor=SHADE, edgecolor=MOTORS[i], linewidth=1.4))
        axes.plot(*np.stack([anchor, start]).T, color=MOTORS[i], linewidth=1.8)
        aside = (0.0, -0.1) if abs(outward[1]) < 0.1 else (0.0, 0.0)  # keeps the text off the reference line of θ
        _write(axes, anchor + outward * (0.17, 0.13) + aside, f"motor {i + 1}", color=MOTORS[i], weight="bold")
        reach = 0.16
        axes.plot(anchor[0] + np.array([0, reach + 0.05]), [anchor[1]] * 2, ":", color=GREY, linewidth=1.0)
        first, last = sorted((0.0, angle))
        axes.add_patch(Arc(anchor, 2 * reach, 2 * reach, theta1=first, theta2=last, color="black", linewidth=1.0))
        half = np.radians(angle / 2)
        label = anchor + (reach + 0.055) * np.array([np.cos(half), np.sin(half)])
        label[1] += 0.06 if abs(angle) < 10 else 0.0  # keeps the text off the cable
        _write(axes, label, f"$\\theta_{i + 1}$", fontsize=11)
    axes.plot(*start, "o", color="black", markersize=8, zorder=5)
    axes.annotate(
        "platform at\nthe start",
        start,
        xytext=_freest(robot.base, [(0.42, 0.38), (0.42, -0.38), (-0.35, 0.42)]),
        ha="center",
        va="center",
        arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.8, "shrinkB": 6},
    )
    _dimension(axes, robot.base[0], robot.base[1], middle, "side {:g} m")
    cables = start + np.linspace(0, 1, 21)[:, None, None] * (robot.base - start)
    turns = np.radians([120, 180])
    ends = np.linalg.norm(start) * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    toward = np.array(_freest(cables.reshape(-1, 2), [tuple(end) for end in ends]))
    axes.plot([0, toward[0]], [0, toward[1]], color=GREY, linewidth=0.8)
    radius = f"radius {np.linalg.norm(start):g} m"
    _write(axes, 0.55 * toward, radius, fontsize=9, bbox=_box())
    axes.plot(0, 0, "+", color=GREY)
    seen = np.concatenate([robot.base, motion.position])
    low, high = seen.min(axis=0) - 0.33, seen.max(axis=0) + 0.33
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _freest(occupied: Array, candidates: list[tuple[float, float]]) -> tuple[float, float]:
    """Candidate position that is farthest from all occupied points."""
    return max(candidates, key=lambda position: float(np.linalg.norm(occupied - np.array(position), axis=1).min()))


def _dimension(axes: Axes, one: Array, other: Array, middle: Array, text: str) -> None:
    """Draws a dimension line outside the side between two corners."""
    along = other - one
    outward = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    outward *= np.sign(outward @ ((one + other) / 2 - middle))
    ends = np.stack([one, other]) + 0.1 * outward
    _arrow(axes, ends[0], ends[1], "<->", GREY)
    label, turn = text.format(round(float(np.linalg.norm(along)), 6)), np.degrees(np.arctan2(along[1], along[0]))
    turn = (turn + 90) % 180 - 90
    _write(axes, ends.mean(axis=0), label, rotation=turn, fontsize=9, bbox=_box())


# Fig. 2


def _spatial_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    robot = interpretation.spatial("control")
    lengths, start = _lengths(robot)[1], path(robot)[1].position[0]
    depth = path(robot)[1].position[:, 2]
    ends = zip(BASE_CORNERS, PLATFORM_CORNERS, lengths.min(axis=0), lengths.max(axis=0), strict=True)
    rows = tuple((i, base, platform, float(low), float(high)) for i, (base, platform, low, high) in enumerate(ends, 1))
    return Outcome(
        numbers={
            "half_side_base_m": _half_side(robot.base),
            "half_side_platform_m": _half_side(robot.platform),
            "height_m": float(depth.mean()),
            "path_radius_m": float(np.linalg.norm(start[:2])),
            "shortest_cable_m": float(lengths.min()),
            "longest_cable_m": float(lengths.max()),
        },
        tables=(
            Table(
                title="Ends of the cables and their lengths on the path.",
                header=("cable", "base corner", "platform corner", "minimum length [m]", "maximum length [m]"),
                rows=rows,
            ),
        ),
    )


def _half_side(anchors: Array) -> float:
    corners = anchors[np.unique(np.round(anchors, 9), axis=0, return_index=True)[1]]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()) / 2


def oblique(points: Array) -> Array:
    """Parallel projection of points with z down, shape (..., 3) to (..., 2): right and up."""
    upright = np.asarray(points) * (1, -1, -1)  # rotation by 180° about x: z up, still right-handed
    right = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
    across = np.array([np.cos(_AZIMUTH), np.sin(_AZIMUTH), 0.0])
    above = np.cos(_ELEVATION) * np.array([0.0, 0.0, 1.0]) - np.sin(_ELEVATION) * across
    return upright @ np.stack([right, above], axis=-1)


def _flat(points: Array) -> Array:
    return np.asarray(points)[..., :2]


def _draw_spatial(interpretation: Interpretation, results: CellResults) -> Figure:
    robot = interpretation.spatial("control")
    figure = new_figure(7.4)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.05, 1])
    view, below = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0])
    _draw_hanging(view, robot, oblique, names=True)
    _draw_triad(view)
    view.set_axis_off()
    view.set_title(
        "oblique view from above, to scale: base triangle at z = 0, z points down; dotted: depth", fontsize=10
    )
    _draw_hanging(below, robot, _flat, names=False)
    below.set(xlabel="x [m]", ylabel="y [m]")
    below.set_title("view from below: z points towards the reader", fontsize=10)
    _draw_lengths(figure.add_subplot(grid[1, 1]), robot)
    sides = f"half sides {_half_side(robot.base):.3g} m and {_half_side(robot.platform):.3g} m"
    start = path(robot)[1].position[0]
    pose = f"start of the path: z = {start[2]:g} m, ψ = θ = φ = {start[3]:g} rad"
    title = f"Spatial robot (Tables 3 and 4): {sides}, m = {robot.mass:g} kg"
    set_title(
        figure,
        title,
        f"{pose}; dashed: path of the platform's centre, dot: its start",
        *_interpretation_line(interpretation),
    )
    return figure


def _draw_hanging(axes: Axes, robot: Robot, project: Any, *, names: bool) -> None:
    """Draws base, platform at the start of the path, cables and path in a projection."""
    from matplotlib.patches import Polygon

    motion = path(robot)[1]
    vectors = cable_vectors(robot.base, robot.platform, motion.position[0])
    ends = robot.base + vectors
    base, platform = project(robot.base), project(ends)
    axes.add_patch(Polygon(base[::2], closed=True, facecolor="none", edgecolor=GREY, linewidth=1.2))
    axes.add_patch(Polygon(platform[::2], closed=True, facecolor=SKY, edgecolor="black", linewidth=1.2, alpha=0.9))
    if names:
        for corner, foot in zip(platform, project(ends * (1, 1, 0)), strict=True):
            axes.plot(*np.stack([corner, foot]).T, ":", color=GREY, linewidth=1.0)  # depth below the base
    axes.plot(*project(motion.position[:, :3]).T, "--", color="black", linewidth=1.0)
    axes.plot(*project(motion.position[0, :3]), "o", color="black", markersize=5, zorder=6)
    for i in range(robot.cables):
        line = np.stack([base[i], platform[i]])
        axes.plot(*line.T, color=MOTORS[i], linewidth=1.8)
        position = line[0] + 0.42 * (line[1] - line[0])
        _write(axes, position, str(i + 1), color=MOTORS[i], fontsize=9, bbox=_box(MOTORS[i]), zorder=7)
    for corners, points, others in ((BASE_CORNERS, base, 0.1), (PLATFORM_CORNERS, platform, 0.06)):
        centre = points.mean(axis=0)
        for name in sorted(set(corners)):
            cables = [i for i, corner in enumerate(corners) if corner == name]
            point = points[cables[0]]
            outward = (point - centre) / np.linalg.norm(point - centre)
            text = f"{name}: motors {cables[0] + 1}, {cables[1] + 1}" if corners == BASE_CORNERS and names else name
            wide = (1.9, 0.75) if text != name else (0.8, 0.8)
            axes.plot(*point, "o", color="black", markersize=4, zorder=6)
            _write(axes, point + others * outward * wide, text, fontsize=9, zorder=8)
    seen = np.concatenate([base, platform])
    low, high = seen.min(axis=0), seen.max(axis=0)
    pad = np.array([0.42, 0.12]) if names else np.array([0.14, 0.14])
    axes.set(xlim=(low[0] - pad[0], high[0] + pad[0]), ylim=(low[1] - pad[1], high[1] + pad[1]), aspect="equal")


def _draw_triad(axes: Axes) -> None:
    """Draws the coordinate axes in the lower left corner of the oblique view."""
    corner = np.array([axes.get_xlim()[0] + 0.14, axes.get_ylim()[0] + 0.2])
    for name, direction in zip("xyz", np.eye(3), strict=True):
        _arrow(axes, corner, corner + 0.17 * oblique(direction))
        _write(axes, corner + 0.215 * oblique(direction), name, fontsize=11, style="italic")


# Fig. 3


def _joint_outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    robot = interpretation.flexible("control")
    wound, modes = wind_up(robot, path(robot)[1].position), spring_modes(robot)
    return Outcome(
        numbers={
            "stiffness_Nm_per_rad": float(robot.stiffness[0]),
            "wind_up_max_rad": float(wound[0].max()),
            "wind_up_path_max_rad": float(wound.max()),
            "mode_low_Hz": float(modes[0]),
            "mode_high_Hz": float(modes[-1]),
        }
    )


def _draw_joint(interpretation: Interpretation, results: CellResults) -> Figure:
    robot = interpretation.flexible("control")
    figure = new_figure(4.6)
    scheme, curves = figure.subplots(1, 2, width_ratios=[1.35, 1])
    _draw_shaft(scheme, robot)
    motion = path(robot)[1]
    wound = wind_up(robot, motion.position)
    turn = np.degrees(np.unwrap(np.arctan2(motion.position[:, 1], motion.position[:, 0])))
    for i in range(robot.cables):
        curves.plot(turn, wound[:, i], color=MOTORS[i], linewidth=1.6, label=f"motor {i + 1}")
    curves.set(xlim=(0, 360), xticks=range(0, 361, 90), ylim=(0, 1.3 * wound.max()))
    curves.set(xlabel="position on the path, angle from +x [°]", ylabel="static twist β′ − β = r T/K [rad]")
    curves.legend(frameon=False, fontsize=9, ncols=3, loc="upper center")
    set_title(
        figure,
        f"Elastic joint (Table 5), one per cable; platform m = {robot.mass:g} kg",
        *_interpretation_line(interpretation),
    )
    return figure


def _draw_shaft(axes: Axes, robot: Robot) -> None:
    """Draws motor, spring and pulley on one shaft in side view, and the cable."""
    from matplotlib.patches import FancyArrowPatch, Rectangle

    for first, last in ((0.3, 1.1), (3.3, 4.2), (5.2, 5.8)):
        axes.plot([first, last], [0, 0], color="black", linewidth=1.6)  # shaft
    axes.plot([5.8, 5.8], [-0.3, 0.3], color="black", linewidth=2.5)  # bearing
    axes.add_patch(Rectangle((-0.9, -0.75), 1.2, 1.5, facecolor=SHADE, edgecolor="black", linewidth=1.2))
    windings = np.linspace(1.1, 3.3, 221)
    axes.plot(windings, 0.32 * np.sin((windings - 1.1) / 2.2 * 12 * np.pi), color="black", linewidth=1.4)
    axes.add_patch(Rectangle((4.2, -1.2), 1.0, 2.4, facecolor=SKY, edgecolor="black", linewidth=1.2))
    axes.plot([4.7, 4.7], [-1.2, -2.5], color=BLUE, linewidth=2.0)  # cable
    _arrow(axes, np.array([4.7, -2.35]), np.array([4.7, -2.95]), colour=BLUE)
    _arrow(axes, np.array([5.45, 0.0]), np.array([5.45, -1.2]), "<->", GREY)
    for x in (0.66, 3.72):
        turn = FancyArrowPatch(
            (x, -0.42), (x, 0.42), connectionstyle="arc3,rad=-0.7", arrowstyle="-|>", mutation_scale=11, linewidth=1.1
        )
        turn.set_color("black")
        axes.add_patch(turn)
    texts = (
        (-0.3, 0.0, "motor"),
        (4.7, 0.28, "pulley"),
        (0.79, 0.72, "τ, β′"),
        (3.85, 0.72, "β"),
        (-0.3, -1.15, f"J′ = {robot.motor_inertia[0]:.2g} kg·m²"),
        (2.1, -0.75, f"K = {robot.stiffness[0]:g} N·m/rad"),
        (4.7, 1.5, f"J = {robot.pulley_inertia[0]:.2g} kg·m²"),
        (6.45, -0.75, f"r = {1e3 * robot.pulley_radius[0]:g} mm"),
        (1.3, -2.1, "J′ β̈′ + K (β′ − β) = τ\nK (β′ − β) = r T + J β̈"),
    )
    for x, y, text in texts:
        _write(axes, np.array([x, y]), text)
    _write(axes, np.array([4.85, -2.6]), "T, cable tension", ha="left", color=BLUE)
    axes.set(xlim=(-1.5, 7.4), ylim=(-3.1, 2.0), aspect="equal")
    axes.set_axis_off()


PARTS: tuple[Part, ...] = (
    Part(
        name="fig1",
        title="Fig. 1: the planar robot",
        text="Planar robot to scale with the anchors of the plant: an equilateral triangle with the side of Table 2, "
        "motors 1 to 3 at its corners, and the platform at the start of the circle of Table 1. θᵢ is the angle of "
        "cable i in Eq. 2, from +x towards the platform. The paper does not state the orientation of the triangle; the "
        "option `--planar-apex` selects it. Only the caption of the published figure is available, so no comparison is "
        "possible.",
        cells=_no_cells,
        outcome=_planar_outcome,
        draw=_draw_planar,
    ),
    Part(
        name="fig2",
        title="Fig. 2: the spatial robot",
        text="Spatial robot to scale at the start of the path of Table 3; the platform is rotated by the rotation "
        "matrix of the plant. The cables form a ring, A1P1, A2P1, A2P3, A3P3, A3P2, A1P2, and motor i winds cable i. "
        "The values "
        'a and b of Table 4, "half of the triangle", are interpreted as half sides (`--sides`). The platform triangle '
        "points away from the base triangle (`--triangles`); if both point in the same direction, the home pose has no "
        "equilibrium with positive tensions. Only the caption of the published figure is available.",
        cells=_spatial_cells,
        outcome=_spatial_outcome,
        draw=_draw_spatial,
    ),
    Part(
        name="fig3",
        title="Fig. 3: the elastic joint",
        text="Motor, spring and pulley of one joint with the values of Table 5, Eq. 4 with winding counted positive "
        "for both angles, and the static twist of the springs on the path. The springs are soft: the weight alone "
        "twists them by radians. A robot that starts with the motors at the angles of the pulleys would therefore "
        "drop. `wind_up_max_rad` is the largest twist at the start of the path, `wind_up_path_max_rad` the largest "
        "twist on the path. `mode_low_Hz` and `mode_high_Hz` are the lowest and the highest mode of the motors against "
        "pulleys and platform about the home pose with taut cables.",
        cells=_spatial_cells,
        outcome=_joint_outcome,
        draw=_draw_joint,
    ),
)
