"""Sag of a suspended robot on four cables, Innopolis, under three loads at the same commanded
positions.

The stiffness of the cables is not published. So there is no value of the model: that the sag is
linear in the load, and its map over the workspace, are the checks.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.utils.palette import BLUE, VERMILLION
from cablebot_winches.reality.comparison import LogComparison, Validation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOADS = (5.0, 17.0, 33.0)
"""Loads [kg]."""

GOAL = 0.1
"""Largest RMS deviation of the heights from a line, over the sag between least and largest load."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Heights:
    """Measured heights at the P commanded positions that all loads have."""

    commanded: Array
    """Commanded positions, (P, 3) [m]."""
    measured: Array
    """Measured positions by load, (3, P, 3) [m]."""

    @property
    def repeated(self) -> Array:
        """Whether the row of the least load is that of the largest one to the last digit, (P,):
        then one is a copy of the other."""
        return np.all(self.measured[0] == self.measured[-1], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Straight lines through the heights over the load."""

    sag: Array
    """Sag per load at each point, (P,) [m/kg]."""
    nonlinearity: float
    """RMS deviation from the lines, over the mean sag between least and largest load."""


def validate(logs: Mapping[str, bytes]) -> Validation:
    """Measures sag and linearity of the robot."""
    heights = read_heights([logs[f"datasets/final/real_{load:g}kg.csv"] for load in LOADS])
    z = heights.measured[..., 2]
    repeated = heights.repeated
    line = fit_line(z[:, ~repeated])
    stiff = (z[1] - z[2]) / (LOADS[2] - LOADS[1])
    low, high = np.quantile(stiff, [0.05, 0.95])
    with_copies = fit_line(z)
    values = (
        ("sag per load, mean", "m/kg", line.sag.mean()),
        ("sag per load from 5 to 17 kg, mean", "m/kg", _mean_slope(z[:2, ~repeated], LOADS[:2])),
        ("sag per load from 17 to 33 kg, mean", "m/kg", stiff.mean()),
        ("sag per load from 17 to 33 kg, 5 % of the points below", "m/kg", low),
        ("sag per load from 17 to 33 kg, 5 % of the points above", "m/kg", high),
        ("sag per load with the repeated rows, mean", "m/kg", with_copies.sag.mean()),
    )
    comparisons = [
        LogComparison(
            quantity="deviation from a line, RMS over the largest sag",
            unit="1",
            robot=line.nonlinearity,
            goal=GOAL,
        )
    ]
    for quantity, unit, value in values:
        comparisons.append(LogComparison(quantity=quantity, unit=unit, robot=float(value)))
    rise = 1e3 * float(np.mean(z[1, repeated] - z[0, repeated]))
    sag = 1e3 * float(np.mean(z[0, ~repeated] - z[1, ~repeated]))
    return Validation(
        comparisons=tuple(comparisons),
        notes=(
            f"{np.count_nonzero(repeated)} of the {len(repeated):,} points have the same row in "
            "the files of 5 and 33 kg, to the last digit: every second point in x and y. There the "
            f"platform would rise by {rise:.0f} mm from 5 to 17 kg; elsewhere it sags by {sag:.0f} "
            "mm. The lines leave these points out.",
            "The stiffness of the cables is not published: linearity and the map are the only "
            "checks.",
        ),
        draw=partial(draw, heights, line, stiff),
    )


def read_heights(files: list[bytes]) -> Heights:
    """Positions from CSV files of measured x, y, z and commanded x, y, z [mm], one for each load.
    The first row of a repeated position counts."""
    tables = []
    for content in files:
        positions: dict[tuple[float, ...], Array] = {}
        for row in np.loadtxt(io.BytesIO(content), delimiter=","):
            positions.setdefault(tuple(row[3:]), row[:3])
        tables.append(positions)
    common = [point for point in tables[0] if all(point in positions for positions in tables)]
    measured = [[positions[point] for point in common] for positions in tables]
    return Heights(commanded=1e-3 * np.array(common), measured=1e-3 * np.array(measured))


def fit_line(heights: Array) -> Line:
    """Lines through heights (3, P) over the load by least squares."""
    slope, height = np.polyfit(LOADS, heights, 1)
    deviation = heights - (np.outer(LOADS, slope) + height)
    largest = abs(float(slope.mean())) * (LOADS[-1] - LOADS[0])
    nonlinearity = float(np.sqrt(np.mean(deviation**2))) / largest
    return Line(sag=-slope, nonlinearity=nonlinearity)


def _mean_slope(heights: Array, loads: tuple[float, ...]) -> float:
    return float(np.mean(heights[0] - heights[1])) / (loads[1] - loads[0])


def draw(heights: Heights, line: Line, stiff: Array) -> Figure:
    """Draws the mean height over the load, and the map of the sag."""
    from cablebot_gym.plotting.figures import new_figure

    figure = new_figure(4.0)
    over_load, over_space = figure.subplots(1, 2, width_ratios=[1, 1.5])
    means = 1e3 * heights.measured[:, ~heights.repeated, 2].mean(axis=1)
    over_load.plot(LOADS, means, "o", color=VERMILLION, label="robot")
    loads = np.array([0.0, 35.0])
    at_middle = means.mean() - 1e3 * line.sag.mean() * (loads - np.mean(LOADS))
    over_load.plot(loads, at_middle, color=BLUE, label="line")
    over_load.set(xlabel="load [kg]", ylabel="mean height [mm]")
    over_load.legend(frameon=False)
    x, column = np.unique(heights.commanded[:, 0], return_inverse=True)
    y, row = np.unique(heights.commanded[:, 1], return_inverse=True)
    total, count = np.zeros((2, len(y), len(x)))
    np.add.at(total, (row, column), 1e3 * stiff)
    np.add.at(count, (row, column), 1.0)
    shown = over_space.pcolormesh(x, y, total / count, cmap="viridis", shading="nearest")
    figure.colorbar(shown, ax=over_space, label="sag [mm/kg], mean over z")
    over_space.set(xlabel="commanded x [m]", ylabel="commanded y [m]", aspect="equal")
    return figure
