"""Map beyond the paper: payload of exact tracking versus radius and depth of the circle, in closed
form.

Maps of closed loops are a suite of the benchmark, ``paper-maps``.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.bounds import ExactPayload, exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import PaperCircle
from cablebot_gym.utils.palette import SHADE, SKY
from cablebot_reproduction.exact import COARSE
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.part import Jobs, Outcome, Results, job
from cablebot_reproduction.parts.plotting import add_title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RADII = tuple(np.linspace(0.02, 0.21, 20).round(4).tolist())
"""Radii of the circles [m]."""

HEIGHTS = tuple(np.linspace(0.06, 0.33, 28).round(4).tolist())
"""Depths z of the circles below the base anchors [m]."""

PAPER_CIRCLE = (0.1, 0.1)
"""Radius and depth of the circle of Table 3 [m]."""

_CONTOURS = (2, 5, 10, 15, 20)
"""Payloads of the contour lines [kg]."""


def exact_map(*, robot: Robot, line_speed: Array) -> list[list[ExactPayload]]:
    """Exact tracking on all circles, one row for each depth.

    Args:
        robot: rigid robot.
        line_speed: see :func:`~cablebot_gym.bounds.closed_form.exact_payload`.
    """
    rows = []
    for height in HEIGHTS:
        row = []
        center = (0.0, 0.0, height, 0.1, 0.1, 0.1)
        for radius in RADII:
            circle = PaperCircle(name="circle", radius=radius, center=center)
            exact = exact_payload(robot, circle, line_speed=line_speed, grid=COARSE)
            row.append(exact)
        rows.append(row)
    return rows


def jobs(interpretation: Interpretation) -> Jobs:
    """Computation of the map."""
    robot = interpretation.spatial("payload")
    line_speed = interpretation.line_speed(robot)
    return {"exact": job(exact_map, robot=robot, line_speed=line_speed)}


def payloads(results: Results) -> tuple[Array, Array]:
    """Payloads (NaN if the robot fails unloaded), and a mask of the circles for which the motors
    are too weak."""
    exact: list[list[ExactPayload]] = results["exact"]
    payload, lowest = np.zeros((2, len(exact), len(exact[0])))
    for index, circle in np.ndenumerate(np.array(exact, object)):
        payload[index] = circle.payload
        lowest[index] = circle.lowest
    needs_no_ballast = lowest <= 0
    is_feasible = needs_no_ballast & (payload >= 0)
    is_weak = needs_no_ballast & (payload > -np.inf) & (payload < 0)
    return np.where(is_feasible, payload, np.nan), is_weak


def outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Largest payload of the map and the widest feasible circle."""
    payload, _ = payloads(results)
    is_feasible = np.isfinite(payload)
    if not is_feasible.any():
        return Outcome()
    row, column = np.unravel_index(np.nanargmax(payload), payload.shape)
    feasible_columns = np.flatnonzero(is_feasible.any(axis=0))
    return Outcome(
        numbers={
            "exact_largest_kg": float(payload[row, column]),
            "exact_largest_at_r_m": RADII[column],
            "exact_largest_at_z_m": HEIGHTS[row],
            "exact_widest_r_m": RADII[feasible_columns[-1]],
        }
    )


def draw(interpretation: Interpretation, results: Results) -> Figure:
    """Map with contour lines."""
    from matplotlib.colors import ListedColormap

    payload, weak = payloads(results)
    figure = new_figure(4.6)
    axes = figure.subplots()
    grid = (RADII, HEIGHTS)
    fill = partial(axes.pcolormesh, *grid, shading="nearest", rasterized=True)
    fill(weak, cmap=ListedColormap([SHADE, SKY]))
    if np.isfinite(payload).any():
        image = fill(payload, vmin=0.0, cmap="viridis")
        figure.colorbar(image, ax=axes, label="payload [kg]")
        lowest = np.nanmin(payload)
        highest = np.nanmax(payload)
        levels = [level for level in _CONTOURS if lowest < level < highest]
        if levels:
            lines = axes.contour(*grid, payload, levels=levels, colors="white", linewidths=1.0)
            axes.clabel(lines, fmt="%g", fontsize=8.5)
    axes.plot(*PAPER_CIRCLE, "*", color="white", markeredgecolor="black", markersize=11)
    axes.set(xlabel="radius [m]", ylabel="depth z below the anchors [m]")
    axes.invert_yaxis()
    add_title(
        figure,
        interpretation,
        "Rigid robot, exact tracking: payload versus radius and depth of the circle; star: circle of the paper",
        "grey: no payload keeps all cables taut; pale blue: motors too weak for the platform alone",
    )
    return figure
