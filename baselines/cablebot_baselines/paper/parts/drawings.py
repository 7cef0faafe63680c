"""Figs. 1 to 3: robots and elastic joint, drawn with the geometry and the parameters of the
plants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.judgement import Judgement, Run, verdict
from cablebot_baselines.paper.part import Jobs, Outcome, Results, Table
from cablebot_baselines.paper.parts.plotting import LEGEND, MOTORS, add_headroom, add_title, curves
from cablebot_gym.kinematics import Array, cable_lengths, cable_vectors
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, SKY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLATFORM_CORNERS = ("P1", "P1", "P3", "P3", "P2", "P2")
BASE_CORNERS = ("A1", "A2", "A2", "A3", "A3", "A1")
"""Corners at which cables 1 to 6 end (ring of Fig. 2)."""

_AZIMUTH, _ELEVATION = np.radians((-72.0, 30.0))
"""View direction of the spatial robot with z down: slightly to the right of +y and from above
[rad]."""

_COUNT = 201
"""Number of instants of a drawn path."""


def path(robot: Robot) -> tuple[Array, Reference]:
    """Instants of the circle of the paper [s] and the motion at these instants."""
    circle = paper_circle(robot)
    times = np.linspace(0.0, circle.duration, _COUNT)
    return times, circle(times)


def spring_modes(robot: Robot) -> Array:
    """Frequencies of the oscillation of the motors against pulleys and platform at home, ascending
    [Hz].

    These are the modes of the motion that :func:`~cablebot_gym.physics.textbook.drives.highest_frequency`
    describes. The twist δ = β′ − β of the free robot satisfies δ̈ = −(1/J′ + (S/r) M⁻¹ (S/r)ᵀ) K δ
    with the mass matrix M of platform and pulleys.
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


def no_jobs(interpretation: Interpretation) -> Jobs:
    """No computations."""
    return {}


def spatial_jobs(interpretation: Interpretation) -> Jobs:
    """No computations; raises NoEquilibriumError if the interpretation does not allow the robot."""
    interpretation.spatial("control")
    return {}


def _lengths(robot: Robot) -> Array:
    _, motion = path(robot)
    return cable_lengths(robot.base, robot.platform, motion.position)


def _length_numbers(robot: Robot) -> dict[str, float]:
    lengths = _lengths(robot)
    return {"shortest_cable_m": float(lengths.min()), "longest_cable_m": float(lengths.max())}


def _draw_lengths(axes: Axes, robot: Robot) -> None:
    times, _ = path(robot)
    labels = [f"cable {cable + 1}" for cable in range(robot.cables)]
    curves(axes, times, _lengths(robot), labels)
    axes.set(xlim=(times[0], times[-1]), xlabel="time [s]", ylabel="cable length on the path [m]")
    add_headroom(axes, above=0.25)
    axes.legend(**LEGEND, ncols=robot.cables // 3, loc="upper right")


def _write(axes: Axes, position: Array, text: str, **style: Any) -> None:
    """Writes text centred at a position."""
    x, y = position
    style.setdefault("fontsize", 9)
    axes.text(float(x), float(y), text, ha="center", va="center", **style)


def _arrow(axes: Axes, start: Array, end: Array, style: str = "-|>", colour: str = "black") -> None:
    arrow = {"arrowstyle": style, "color": colour}
    axes.annotate("", tuple(end), xytext=tuple(start), arrowprops=arrow)


_BOX = {"boxstyle": "round,pad=0.15", "facecolor": "white", "linewidth": 0.8}
"""Style of the box of a number."""


# Fig. 1


def planar_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Side of the triangle, radius of the path and cable lengths."""
    robot = interpretation.planar
    _, motion = path(robot)
    sides = np.linalg.norm(robot.base - np.roll(robot.base, 1, axis=0), axis=1)
    radius = np.linalg.norm(motion.position - robot.base.mean(axis=0), axis=1).max()
    sizes = {"side_m": float(sides.mean()), "path_radius_m": float(radius)}
    return Outcome(numbers=sizes | _length_numbers(robot))


def draw_planar(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 1."""
    robot = interpretation.planar
    figure = new_figure(4.9)
    plane, lengths = figure.subplots(1, 2, width_ratios=[1.35, 1])
    _draw_plane(plane, robot)
    _draw_lengths(lengths, robot)
    side = np.linalg.norm(robot.base[1] - robot.base[0])
    sizes = f"sides {side:g} m, pulleys r = {1e3 * robot.pulley_radius[0]:g} mm (to scale)"
    mass = f"point mass m = {robot.mass:g} kg at the start of the path (dashed)"
    add_title(figure, interpretation, f"Planar robot (Tables 1 and 2): {sizes}, {mass}")
    return figure


def _draw_plane(axes: Axes, robot: Robot) -> None:
    from matplotlib.patches import Polygon

    _, motion = path(robot)
    start = motion.position[0]
    axes.add_patch(
        Polygon(robot.base, closed=True, facecolor="none", edgecolor=GREY, linewidth=1.0)
    )
    axes.plot(*motion.position.T, "--", color="black", linewidth=1.0)
    lowest = int(np.argmin(motion.position[:, 1]))
    _arrow(axes, motion.position[lowest - 1], motion.position[lowest + 1])
    for motor in range(robot.cables):
        _draw_motor(axes, robot, motor, start)
    axes.plot(*start, "o", color="black", markersize=8, zorder=5)
    _set_limits(axes, np.concatenate([robot.base, motion.position]), (0.33, 0.33))
    axes.set(xlabel="x [m]", ylabel="y [m]")


def _draw_motor(axes: Axes, robot: Robot, motor: int, start: Array) -> None:
    """Draws a motor of the planar robot, its cable and the angle θ."""
    from matplotlib.patches import Arc, Circle

    anchor, colour = robot.base[motor], MOTORS[motor]
    outward = anchor - robot.base.mean(axis=0)
    outward = outward / np.linalg.norm(outward)
    pulley = {"facecolor": SHADE, "edgecolor": colour, "linewidth": 1.4}
    axes.add_patch(Circle(anchor, robot.pulley_radius[motor], **pulley))
    axes.plot(*np.stack([anchor, start]).T, color=colour, linewidth=1.8)
    label = anchor + outward * (0.17, 0.13)
    if abs(outward[1]) < 0.1:
        label[1] -= 0.1  # keeps the text off the reference line of θ
    _write(axes, label, f"motor {motor + 1}", color=colour, weight="bold")
    x, y = anchor
    axes.plot(x + np.array([0, 0.21]), [y, y], ":", color=GREY, linewidth=1.0)
    across, along = start - anchor
    angle = float(np.degrees(np.arctan2(along, across)))
    low, high = sorted((0.0, angle))
    arc = Arc(anchor, 0.32, 0.32, theta1=low, theta2=high, color="black", linewidth=1.0)
    axes.add_patch(arc)
    half = np.radians(angle / 2)
    label = anchor + 0.215 * np.array([np.cos(half), np.sin(half)])
    if abs(angle) < 10:
        label[1] += 0.06  # keeps the text off the cable
    _write(axes, label, f"$\\theta_{motor + 1}$", fontsize=11)


def _set_limits(axes: Axes, points: Array, margin: tuple[float, float]) -> None:
    """Sets equal axes that contain all points with a margin."""
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


# Fig. 2


def spatial_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Sizes of the triangles, depth and radius of the path, and cable lengths."""
    robot = interpretation.spatial("control")
    _, motion = path(robot)
    pose, lengths = motion.position, _lengths(robot)
    rows = []
    for cable, (base, platform) in enumerate(zip(BASE_CORNERS, PLATFORM_CORNERS, strict=True)):
        length = lengths[:, cable]
        rows.append((cable + 1, base, platform, float(length.min()), float(length.max())))
    table = Table(
        title="Ends of the cables and their lengths on the path.",
        header=(
            "cable",
            "base corner",
            "platform corner",
            "minimum length [m]",
            "maximum length [m]",
        ),
        rows=tuple(rows),
    )
    return Outcome(
        numbers={
            "half_side_base_m": _half_side(robot.base),
            "half_side_platform_m": _half_side(robot.platform),
            "height_m": float(pose[:, 2].mean()),
            "path_radius_m": float(np.linalg.norm(pose[0, :2])),
            **_length_numbers(robot),
        },
        tables=(table,),
    )


def _half_side(anchors: Array) -> float:
    _, first_indices = np.unique(np.round(anchors, 9), axis=0, return_index=True)
    corners = anchors[first_indices]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    return float(sides.mean()) / 2


def oblique(points: Array) -> Array:
    """Parallel projection of points with z down, shape (..., 3) to (..., 2): right and up."""
    upright = np.asarray(points) * (1, -1, -1)  # rotation by 180° about x: z up, still right-handed
    right = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
    across = np.array([np.cos(_AZIMUTH), np.sin(_AZIMUTH), 0.0])
    vertical = np.array([0.0, 0.0, 1.0])
    above = np.cos(_ELEVATION) * vertical - np.sin(_ELEVATION) * across
    return upright @ np.stack([right, above], axis=-1)


def _from_below(points: Array) -> Array:
    return np.asarray(points)[..., :2]


def draw_spatial(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 2."""
    robot = interpretation.spatial("control")
    figure = new_figure(7.4)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.05, 1])
    view = figure.add_subplot(grid[0, :])
    below = figure.add_subplot(grid[1, 0])
    _draw_hanging(view, robot, oblique, pad=(0.42, 0.12))
    corner = np.array([view.get_xlim()[0] + 0.14, view.get_ylim()[0] + 0.2])
    for name, axis in zip("xyz", np.eye(3), strict=True):
        direction = oblique(axis)
        _arrow(view, corner, corner + 0.17 * direction)
        _write(view, corner + 0.215 * direction, name, fontsize=11, style="italic")
    view.set_axis_off()
    view.set_title(
        "oblique view from above, to scale: base triangle at z = 0, z points down", fontsize=10
    )
    _draw_hanging(below, robot, _from_below, pad=(0.14, 0.14))
    below.set(xlabel="x [m]", ylabel="y [m]")
    below.set_title("view from below: z points towards the reader", fontsize=10)
    _draw_lengths(figure.add_subplot(grid[1, 1]), robot)
    sides = f"half sides {_half_side(robot.base):.3g} m and {_half_side(robot.platform):.3g} m"
    _, motion = path(robot)
    _, _, z, angle, *_ = motion.position[0]
    pose = f"start of the path: z = {z:g} m, ψ = θ = φ = {angle:g} rad"
    title = f"Spatial robot (Tables 3 and 4): {sides}, m = {robot.mass:g} kg; motor i winds cable i"
    add_title(
        figure,
        interpretation,
        title,
        f"{pose}; dashed: path of the platform's centre, dot: its start",
    )
    return figure


def _draw_hanging(
    axes: Axes, robot: Robot, project: Callable[[Array], Array], *, pad: tuple[float, float]
) -> None:
    """Draws base, platform at the start of the path, cables and path in a projection."""
    from matplotlib.patches import Polygon

    _, motion = path(robot)
    ends = robot.base + cable_vectors(robot.base, robot.platform, motion.position[0])
    base, platform = project(robot.base), project(ends)
    axes.add_patch(Polygon(base[::2], closed=True, facecolor="none", edgecolor=GREY, linewidth=1.2))
    axes.add_patch(
        Polygon(
            platform[::2], closed=True, facecolor=SKY, edgecolor="black", linewidth=1.2, alpha=0.9
        )
    )
    centre = project(motion.position[:, :3])
    axes.plot(*centre.T, "--", color="black", linewidth=1.0)
    axes.plot(*centre[0], "o", color="black", markersize=5, zorder=6)
    for cable, colour in enumerate(MOTORS):
        start, end = base[cable], platform[cable]
        axes.plot(*np.stack([start, end]).T, color=colour, linewidth=1.8)
        label = start + 0.42 * (end - start)
        box = _BOX | {"edgecolor": colour}
        _write(axes, label, str(cable + 1), color=colour, bbox=box, zorder=7)
    _name_corners(axes, BASE_CORNERS, base, 0.08)
    _name_corners(axes, PLATFORM_CORNERS, platform, 0.05)
    _set_limits(axes, np.concatenate([base, platform]), pad)


def _name_corners(axes: Axes, names: Sequence[str], points: Array, distance: float) -> None:
    """Writes the names of the corners outside of a triangle."""
    centre = points.mean(axis=0)
    for name, point in dict(zip(names, points, strict=True)).items():
        outward = (point - centre) / np.linalg.norm(point - centre)
        axes.plot(*point, "o", color="black", markersize=4, zorder=6)
        _write(axes, point + distance * outward, name, zorder=8)


# Fig. 3


def joint_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Stiffness, static twist and modes of the springs."""
    robot = interpretation.flexible("control")
    _, motion = path(robot)
    wound = wind_up(robot, motion.position)
    modes = spring_modes(robot)
    return Outcome(
        numbers={
            "stiffness_Nm_per_rad": float(robot.stiffness[0]),
            "wind_up_max_rad": float(wound[0].max()),
            "wind_up_path_max_rad": float(wound.max()),
            "mode_low_Hz": float(modes[0]),
            "mode_high_Hz": float(modes[-1]),
        }
    )


def draw_joint(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 3."""
    robot = interpretation.flexible("control")
    figure = new_figure(4.6)
    scheme, twists = figure.subplots(1, 2, width_ratios=[1.35, 1])
    _draw_shaft(scheme, robot)
    _, motion = path(robot)
    wound = wind_up(robot, motion.position)
    x, y = motion.position[:, :2].T
    turn = np.degrees(np.unwrap(np.arctan2(y, x)))
    curves(twists, turn, wound, [f"motor {motor + 1}" for motor in range(robot.cables)])
    twists.set(xlim=(0, 360), xticks=range(0, 361, 90), ylim=(0, 1.3 * wound.max()))
    twists.set(
        xlabel="position on the path, angle from +x [°]", ylabel="static twist β′ − β = r T/K [rad]"
    )
    twists.legend(**LEGEND, ncols=3, loc="upper center")
    add_title(
        figure,
        interpretation,
        f"Elastic joint (Table 5), one per cable; platform m = {robot.mass:g} kg",
    )
    return figure


def _draw_shaft(axes: Axes, robot: Robot) -> None:
    """Draws motor, spring and pulley on one shaft in side view, and the cable."""
    from matplotlib.patches import Rectangle

    for shaft in ((0.3, 1.1), (3.3, 4.2), (5.2, 5.8)):
        axes.plot(shaft, [0, 0], color="black", linewidth=1.6)
    axes.plot([5.8, 5.8], [-0.3, 0.3], color="black", linewidth=2.5)  # bearing
    for x, y, width, height, colour in ((-0.9, -0.75, 1.2, 1.5, SHADE), (4.2, -1.2, 1.0, 2.4, SKY)):
        axes.add_patch(
            Rectangle((x, y), width, height, facecolor=colour, edgecolor="black", linewidth=1.2)
        )
    windings = np.linspace(1.1, 3.3, 221)
    axes.plot(
        windings, 0.32 * np.sin((windings - 1.1) / 2.2 * 12 * np.pi), color="black", linewidth=1.4
    )
    _arrow(axes, np.array([4.7, -1.2]), np.array([4.7, -2.95]), colour=BLUE)  # cable
    _arrow(axes, np.array([5.45, 0.0]), np.array([5.45, -1.2]), "<->", GREY)
    texts = (
        (-0.3, 0.0, "motor"),
        (4.7, 0.28, "pulley"),
        (0.79, 0.5, "τ, β′"),
        (3.85, 0.5, "β"),
        (-0.3, -1.15, f"J′ = {robot.motor_inertia[0]:.2g} kg·m²"),
        (2.1, -0.75, f"K = {robot.stiffness[0]:g} N·m/rad"),
        (4.7, 1.5, f"J = {robot.pulley_inertia[0]:.2g} kg·m²"),
        (6.45, -0.75, f"r = {1e3 * robot.pulley_radius[0]:g} mm"),
        (1.3, -2.1, "J′ β̈′ + K (β′ − β) = τ\nK (β′ − β) = r T + J β̈"),
        (5.7, -2.6, "T, cable tension"),
    )
    for x, y, text in texts:
        _write(axes, np.array([x, y]), text, fontsize=10)
    axes.set(xlim=(-1.5, 7.4), ylim=(-3.1, 2.0), aspect="equal")
    axes.set_axis_off()


# --- verdict ----------------------------------------------------------------------------------------------------------


@verdict("2.3.constraint", "fig3")
def spring_constrains_the_motion(run: Run) -> Judgement:
    """The springs leave fewer free coordinates than platform and motors have."""
    robot = run.interpretation.flexible("control")
    free = robot.coordinates + robot.cables
    evidence = (
        "A spring exerts a torque and does not constrain the motion. All coordinates of Eq. 8 remain free.",
    )
    return Judgement(free, free < 12, evidence, "{ours} free coordinates")
