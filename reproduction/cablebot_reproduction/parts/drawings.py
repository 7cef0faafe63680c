"""Figs. 1 to 3: robots and elastic joint, drawn with the geometry and the parameters of the
plants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_gym.kinematics import Array, cable_lengths, cable_vectors
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, SKY
from cablebot_reproduction.exact import paper_circle
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.part import Jobs, Outcome, Results, Table
from cablebot_reproduction.parts.plotting import LEGEND, MOTORS, add_headroom, add_title, curves

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


def _poses(robot: Robot) -> Array:
    """Poses at the instants of :func:`path`, (K, n)."""
    _, motion = path(robot)
    return motion.position


def spring_modes(robot: Robot) -> Array:
    """Frequencies of the oscillation of the motors against pulleys and platform at home, ascending
    [Hz].

    These are the modes of the motion that :func:`~cablebot_gym.physics.textbook.drives.highest_frequency`
    describes. The twist δ = β′ − β of the free robot satisfies δ̈ = −(1/J′ + (S/r) M⁻¹ (S/r)ᵀ) K δ
    with the mass matrix M of platform and pulleys.
    """
    structure = textbook.jacobian(robot, robot.home)
    turning = structure / robot.pulley_radius[:, None]
    pulley_momentum = robot.pulley_inertia[:, None] * turning
    pulley_inertia = turning.T @ pulley_momentum
    platform_inertia = textbook.mass_matrix(robot, robot.mass, robot.home)
    inertia = platform_inertia + pulley_inertia
    platform_response = np.linalg.solve(inertia, turning.T)
    motor_mobility = np.diag(1 / robot.motor_inertia)
    mobility = motor_mobility + turning @ platform_response
    eigenvalues = np.linalg.eigvals(mobility * robot.stiffness)
    squares = np.sort(eigenvalues.real)
    return np.sqrt(squares) / (2 * np.pi)


def wind_up(robot: Robot, pose: Array) -> Array:
    """Static twist β′ − β of the joints of a flexible robot, shape (..., m) [rad]."""
    torque = textbook.static_torque(robot, robot.mass, pose)
    return torque / robot.stiffness


def no_jobs(interpretation: Interpretation) -> Jobs:
    """No computations."""
    return {}


def spatial_jobs(interpretation: Interpretation) -> Jobs:
    """No computations; raises NoEquilibriumError if the interpretation does not allow the robot."""
    interpretation.spatial("control")
    return {}


def _lengths(robot: Robot) -> Array:
    return cable_lengths(robot.base, robot.platform, _poses(robot))


def _length_numbers(robot: Robot) -> dict[str, float]:
    lengths = _lengths(robot)
    return {
        "shortest_cable_m": float(lengths.min()),
        "longest_cable_m": float(lengths.max()),
    }


def _draw_lengths(axes: Axes, robot: Robot) -> None:
    times, _ = path(robot)
    labels = [f"cable {cable + 1}" for cable in range(robot.cables)]
    curves(axes, times, _lengths(robot), labels)
    axes.set_xlim(times[0], times[-1])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("cable length on the path [m]")
    add_headroom(axes, above=0.25)
    columns = robot.cables // 3
    axes.legend(**LEGEND, ncols=columns, loc="upper right")


def _write(axes: Axes, position: Array, text: str, **style: Any) -> None:
    """Writes text centred at a position."""
    x, y = position
    style.setdefault("fontsize", 9)
    axes.text(float(x), float(y), text, ha="center", va="center", **style)


def _draw_cable(axes: Axes, start: Array, end: Array, colour: str) -> None:
    points = np.stack([start, end])
    axes.plot(*points.T, color=colour, linewidth=1.8)


def _draw_path(axes: Axes, points: Array) -> None:
    axes.plot(*points.T, "--", color="black", linewidth=1.0)


def _draw_dot(axes: Axes, position: Array, size: float, zorder: int) -> None:
    axes.plot(*position, "o", color="black", markersize=size, zorder=zorder)


def _draw_polygon(axes: Axes, corners: Array, **style: Any) -> None:
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(corners, closed=True, **style))


def _arrow(axes: Axes, start: Array, end: Array, style: str = "-|>", colour: str = "black") -> None:
    arrow = {"arrowstyle": style, "color": colour}
    axes.annotate("", tuple(end), xytext=tuple(start), arrowprops=arrow)


_BOX = {
    "boxstyle": "round,pad=0.15",
    "facecolor": "white",
    "linewidth": 0.8,
}
"""Style of the box of a number."""


# Fig. 1


def planar_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Side of the triangle, radius of the path and cable lengths."""
    robot = interpretation.planar
    centre = robot.base.mean(axis=0)
    offsets = _poses(robot) - centre
    distances = np.linalg.norm(offsets, axis=1)
    sides = _sides(robot.base)
    sizes = {
        "side_m": float(sides.mean()),
        "path_radius_m": float(distances.max()),
    }
    return Outcome(numbers=sizes | _length_numbers(robot))


def _sides(corners: Array) -> Array:
    """Lengths of the sides of a polygon."""
    previous_corners = np.roll(corners, 1, axis=0)
    return np.linalg.norm(corners - previous_corners, axis=1)


def draw_planar(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 1."""
    robot = interpretation.planar
    figure = new_figure(4.9)
    plane, lengths = figure.subplots(1, 2, width_ratios=[1.35, 1])
    _draw_plane(plane, robot)
    _draw_lengths(lengths, robot)
    corner, next_corner, _ = robot.base
    side = np.linalg.norm(next_corner - corner)
    radius = 1e3 * robot.pulley_radius[0]
    sizes = f"sides {side:g} m, pulleys r = {radius:g} mm (to scale)"
    mass = f"point mass m = {robot.mass:g} kg at the start of the path (dashed)"
    add_title(figure, interpretation, f"Planar robot (Tables 1 and 2): {sizes}, {mass}")
    return figure


def _draw_plane(axes: Axes, robot: Robot) -> None:
    points = _poses(robot)
    start = points[0]
    _draw_polygon(axes, robot.base, facecolor="none", edgecolor=GREY, linewidth=1.0)
    _draw_path(axes, points)
    heights = points[:, 1]
    lowest = int(np.argmin(heights))
    before = points[lowest - 1]
    after = points[lowest + 1]
    _arrow(axes, before, after)
    for motor in range(robot.cables):
        _draw_motor(axes, robot, motor, start)
    _draw_dot(axes, start, size=8, zorder=5)
    shown_points = np.concatenate([robot.base, points])
    _set_limits(axes, shown_points, (0.33, 0.33))
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _draw_motor(axes: Axes, robot: Robot, motor: int, start: Array) -> None:
    """Draws a motor of the planar robot, its cable and the angle θ."""
    from matplotlib.patches import Circle

    anchor = robot.base[motor]
    colour = MOTORS[motor]
    centre = robot.base.mean(axis=0)
    outward = _direction(centre, anchor)
    radius = robot.pulley_radius[motor]
    pulley = Circle(anchor, radius, facecolor=SHADE, edgecolor=colour, linewidth=1.4)
    axes.add_patch(pulley)
    _draw_cable(axes, anchor, start, colour)
    label = anchor + outward * (0.17, 0.13)
    if abs(outward[1]) < 0.1:
        label[1] -= 0.1  # keeps the text off the reference line of θ
    number = motor + 1
    _write(axes, label, f"motor {number}", color=colour, weight="bold")
    _draw_cable_angle(axes, anchor, start, f"$\\theta_{number}$")


def _draw_cable_angle(axes: Axes, anchor: Array, start: Array, symbol: str) -> None:
    from matplotlib.patches import Arc

    x, y = anchor
    axes.plot([x, x + 0.21], [y, y], ":", color=GREY, linewidth=1.0)
    across, along = start - anchor
    radians = np.arctan2(along, across)
    angle = float(np.degrees(radians))
    low, high = sorted((0.0, angle))
    arc = Arc(
        (x, y),
        width=0.32,
        height=0.32,
        theta1=low,
        theta2=high,
        color="black",
        linewidth=1.0,
    )
    axes.add_patch(arc)
    half = np.radians(angle / 2)
    bisector = np.array([np.cos(half), np.sin(half)])
    label = anchor + 0.215 * bisector
    if abs(angle) < 10:
        label[1] += 0.06  # keeps the text off the cable
    _write(axes, label, symbol, fontsize=11)


def _direction(start: Array, end: Array) -> Array:
    """Unit vector from one point to another."""
    difference = end - start
    return difference / np.linalg.norm(difference)


def _set_limits(axes: Axes, points: Array, margin: tuple[float, float]) -> None:
    """Sets equal axes that contain all points with a margin."""
    low = points.min(axis=0) - margin
    high = points.max(axis=0) + margin
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")


# Fig. 2


def spatial_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Sizes of the triangles, depth and radius of the path, and cable lengths."""
    robot = interpretation.spatial("control")
    poses = _poses(robot)
    heights = poses[:, 2]
    start = poses[0, :2]
    sizes = {
        "half_side_base_m": _half_side(robot.base),
        "half_side_platform_m": _half_side(robot.platform),
        "height_m": float(heights.mean()),
        "path_radius_m": float(np.linalg.norm(start)),
    }
    return Outcome(
        numbers=sizes | _length_numbers(robot),
        tables=(_cable_table(robot),),
    )


def _cable_table(robot: Robot) -> Table:
    lengths = _lengths(robot)
    shortest = lengths.min(axis=0).tolist()
    longest = lengths.max(axis=0).tolist()
    numbers = range(1, robot.cables + 1)
    rows = zip(numbers, BASE_CORNERS, PLATFORM_CORNERS, shortest, longest, strict=True)
    return Table(
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


def _half_side(anchors: Array) -> float:
    rounded = np.round(anchors, 9)
    _, first_indices = np.unique(rounded, axis=0, return_index=True)
    sides = _sides(anchors[first_indices])
    return float(sides.mean()) / 2


def oblique(points: Array) -> Array:
    """Parallel projection of points with z down, shape (..., 3) to (..., 2): right and up."""
    upright = np.asarray(points) * (1, -1, -1)  # rotation by 180° about x: z up, still right-handed
    cosine = np.cos(_AZIMUTH)
    sine = np.sin(_AZIMUTH)
    right = np.array([-sine, cosine, 0.0])
    across = np.array([cosine, sine, 0.0])
    vertical = np.array([0.0, 0.0, 1.0])
    rise = np.cos(_ELEVATION) * vertical
    tilt = np.sin(_ELEVATION) * across
    above = rise - tilt
    projection = np.stack([right, above], axis=-1)
    return upright @ projection


def _from_below(points: Array) -> Array:
    return np.asarray(points)[..., :2]


def draw_spatial(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 2."""
    robot = interpretation.spatial("control")
    figure = new_figure(7.4)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.05, 1])
    view = figure.add_subplot(grid[0, :])
    below = figure.add_subplot(grid[1, 0])
    lengths = figure.add_subplot(grid[1, 1])
    _draw_hanging(view, robot, oblique, pad=(0.42, 0.12))
    _draw_frame(view)
    view.set_axis_off()
    view.set_title(
        "oblique view from above, to scale: base triangle at z = 0, z points down", fontsize=10
    )
    _draw_hanging(below, robot, _from_below, pad=(0.14, 0.14))
    below.set_xlabel("x [m]")
    below.set_ylabel("y [m]")
    below.set_title("view from below: z points towards the reader", fontsize=10)
    _draw_lengths(lengths, robot)
    base = _half_side(robot.base)
    platform = _half_side(robot.platform)
    sides = f"half sides {base:.3g} m and {platform:.3g} m"
    title = f"Spatial robot (Tables 3 and 4): {sides}, m = {robot.mass:g} kg; motor i winds cable i"
    _, _, z, angle, *_ = _poses(robot)[0]
    pose = f"start of the path: z = {z:g} m, ψ = θ = φ = {angle:g} rad"
    legend = f"{pose}; dashed: path of the platform's centre, dot: its start"
    add_title(figure, interpretation, title, legend)
    return figure


def _draw_frame(axes: Axes) -> None:
    """Draws the axes of the frame in the lower left corner of the oblique view."""
    x_low, _ = axes.get_xlim()
    y_low, _ = axes.get_ylim()
    corner = np.array([x_low + 0.14, y_low + 0.2])
    for name, axis in zip("xyz", np.eye(3), strict=True):
        direction = oblique(axis)
        _arrow(axes, corner, corner + 0.17 * direction)
        label = corner + 0.215 * direction
        _write(axes, label, name, fontsize=11, style="italic")


def _draw_hanging(
    axes: Axes, robot: Robot, project: Callable[[Array], Array], *, pad: tuple[float, float]
) -> None:
    """Draws base, platform at the start of the path, cables and path in a projection."""
    poses = _poses(robot)
    start_pose = poses[0]
    vectors = cable_vectors(robot.base, robot.platform, start_pose)
    base = project(robot.base)
    platform = project(robot.base + vectors)
    _draw_polygon(axes, base[::2], facecolor="none", edgecolor=GREY, linewidth=1.2)
    _draw_polygon(axes, platform[::2], facecolor=SKY, edgecolor="black", linewidth=1.2, alpha=0.9)
    centre = project(poses[:, :3])
    _draw_path(axes, centre)
    _draw_dot(axes, centre[0], size=5, zorder=6)
    for cable, colour in enumerate(MOTORS):
        start = base[cable]
        end = platform[cable]
        _draw_cable(axes, start, end, colour)
        label = start + 0.42 * (end - start)
        number = str(cable + 1)
        box = _BOX | {"edgecolor": colour}
        _write(axes, label, number, color=colour, bbox=box, zorder=7)
    _name_corners(axes, BASE_CORNERS, base, 0.08)
    _name_corners(axes, PLATFORM_CORNERS, platform, 0.05)
    shown_points = np.concatenate([base, platform])
    _set_limits(axes, shown_points, pad)


def _name_corners(axes: Axes, names: Sequence[str], points: Array, distance: float) -> None:
    """Writes the names of the corners outside of a triangle."""
    centre = points.mean(axis=0)
    corners = dict(zip(names, points, strict=True))
    for name, point in corners.items():
        outward = _direction(centre, point)
        _draw_dot(axes, point, size=4, zorder=6)
        label = point + distance * outward
        _write(axes, label, name, zorder=8)


# Fig. 3


def joint_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Stiffness, static twist and modes of the springs."""
    robot = interpretation.flexible("control")
    twists = wind_up(robot, _poses(robot))
    modes = spring_modes(robot)
    numbers = {
        "stiffness_Nm_per_rad": float(robot.stiffness[0]),
        "wind_up_max_rad": float(twists[0].max()),
        "wind_up_path_max_rad": float(twists.max()),
        "mode_low_Hz": float(modes[0]),
        "mode_high_Hz": float(modes[-1]),
    }
    return Outcome(numbers=numbers)


def draw_joint(interpretation: Interpretation, results: Results) -> Figure:
    """Fig. 3."""
    robot = interpretation.flexible("control")
    figure = new_figure(4.6)
    scheme, curve_axes = figure.subplots(1, 2, width_ratios=[1.35, 1])
    _draw_shaft(scheme, robot)
    _draw_twists(curve_axes, robot)
    title = f"Elastic joint (Table 5), one per cable; platform m = {robot.mass:g} kg"
    add_title(figure, interpretation, title)
    return figure


def _draw_twists(axes: Axes, robot: Robot) -> None:
    poses = _poses(robot)
    twists = wind_up(robot, poses)
    x, y = poses[:, :2].T
    radians = np.unwrap(np.arctan2(y, x))
    angles = np.degrees(radians)
    labels = [f"motor {motor + 1}" for motor in range(robot.cables)]
    curves(axes, angles, twists, labels)
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 90))
    axes.set_ylim(0, 1.3 * twists.max())
    axes.set_xlabel("position on the path, angle from +x [°]")
    axes.set_ylabel("static twist β′ − β = r T/K [rad]")
    axes.legend(**LEGEND, ncols=3, loc="upper center")


def _draw_shaft(axes: Axes, robot: Robot) -> None:
    """Draws motor, spring and pulley on one shaft in side view, and the cable."""
    _draw_axle(axes, 0.3, 1.1)
    _draw_axle(axes, 3.3, 4.2)
    _draw_axle(axes, 5.2, 5.8)
    axes.plot([5.8, 5.8], [-0.3, 0.3], color="black", linewidth=2.5)  # bearing
    _draw_box(axes, (-0.9, -0.75), 1.2, 1.5, SHADE)  # motor
    _draw_box(axes, (4.2, -1.2), 1.0, 2.4, SKY)  # pulley
    along = np.linspace(1.1, 3.3, 221)
    turns = (along - 1.1) / 2.2
    windings = 0.32 * np.sin(turns * 12 * np.pi)
    axes.plot(along, windings, color="black", linewidth=1.4)
    pulley_bottom = np.array([4.7, -1.2])
    cable_end = np.array([4.7, -2.95])
    _arrow(axes, pulley_bottom, cable_end, colour=BLUE)
    axle = np.array([5.45, 0.0])
    rim = np.array([5.45, -1.2])
    _arrow(axes, axle, rim, "<->", GREY)
    _label_shaft(axes, robot)
    axes.set_xlim(-1.5, 7.4)
    axes.set_ylim(-3.1, 2.0)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_axle(axes: Axes, start: float, end: float) -> None:
    axes.plot([start, end], [0, 0], color="black", linewidth=1.6)


def _draw_box(
    axes: Axes, corner: tuple[float, float], width: float, height: float, colour: str
) -> None:
    from matplotlib.patches import Rectangle

    box = Rectangle(corner, width, height, facecolor=colour, edgecolor="black", linewidth=1.2)
    axes.add_patch(box)


def _label_shaft(axes: Axes, robot: Robot) -> None:
    motor_inertia = robot.motor_inertia[0]
    pulley_inertia = robot.pulley_inertia[0]
    stiffness = robot.stiffness[0]
    radius = 1e3 * robot.pulley_radius[0]
    texts = {
        (-0.3, 0.0): "motor",
        (4.7, 0.28): "pulley",
        (0.79, 0.5): "τ, β′",
        (3.85, 0.5): "β",
        (-0.3, -1.15): f"J′ = {motor_inertia:.2g} kg·m²",
        (2.1, -0.75): f"K = {stiffness:g} N·m/rad",
        (4.7, 1.5): f"J = {pulley_inertia:.2g} kg·m²",
        (6.45, -0.75): f"r = {radius:g} mm",
        (1.3, -2.1): "J′ β̈′ + K (β′ − β) = τ\nK (β′ − β) = r T + J β̈",
        (5.7, -2.6): "T, cable tension",
    }
    for coordinates, text in texts.items():
        position = np.array(coordinates)
        _write(axes, position, text, fontsize=10)


# --- verdict ----------------------------------------------------------------------------------------------------------


@verdict("2.3.constraint", "fig3")
def spring_constrains_the_motion(run: Run) -> Judgement:
    """The springs leave fewer free coordinates than platform and motors have."""
    robot = run.interpretation.flexible("control")
    free = robot.coordinates + robot.cables
    evidence = (
        "A spring exerts a torque and does not constrain the motion. "
        "All coordinates of Eq. 8 remain free."
    )
    holds = free < 12
    return Judgement(free, holds, (evidence,), "{ours} free coordinates")
