"""Drawing functions that several parts share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.comparison import COLOURS
from cablebot_gym.plotting.figures import set_title
from cablebot_reproduction.interpretation import Interpretation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase

MOTORS = COLOURS[:6]
"""Colours of the motors and their cables."""

COORDINATES = ("x", "y", "z", "ψ", "θ", "φ")

STYLES = ("-", "--", "-.")
"""Line styles of the coordinates of a position or a rotation."""

LEGEND: dict[str, Any] = {
    "frameon": False,
    "fontsize": 9,
    "handlelength": 1.6,
    "columnspacing": 1.0,
}
"""Style of a legend inside a panel."""


def add_title(figure: FigureBase, interpretation: Interpretation, *lines: str) -> None:
    """Adds a title, with the interpretation if it differs from the default."""
    texts = list(lines)
    if interpretation.changed():
        texts.append(f"interpretation: {interpretation.text()}")
    set_title(figure, *texts)


def add_loop_title(figure: FigureBase, interpretation: Interpretation, *lines: str) -> None:
    """Adds a title of a closed loop, with the options that it cannot use."""
    texts = list(lines)
    if not interpretation.closed_loop_possible:
        line = f"no motor can have the line {interpretation.line!r}"
        texts.append(f"{line}: the limits show this line, the loop uses the physical line")
    if interpretation.alpha == "constant":
        texts.append(
            "a planar loop uses the smallest α at each instant; a constant α applies to exact tracking only"
        )
    add_title(figure, interpretation, *texts)


def curves(axes: Axes, x: Array, columns: Array, labels: Sequence[str]) -> None:
    """Draws the columns of an array in the colours of the motors."""
    for column, label, colour in zip(columns.T, labels, MOTORS, strict=False):
        axes.plot(x, column, color=colour, linewidth=1.6, label=label)


def coordinate_curves(axes: Axes, x: Array, columns: Array, offset: int) -> None:
    """Draws three or fewer coordinates with a line at zero; ``offset`` is the index of the first
    coordinate."""
    for index, column in enumerate(columns.T):
        name = COORDINATES[offset + index]
        axes.plot(x, column, STYLES[index], color=MOTORS[index], linewidth=1.4, label=name)
    axes.axhline(0, color="grey", linewidth=0.6)


def add_headroom(axes: Axes, *, above: float = 0.0, below: float = 0.0) -> None:
    """Widens the y axis by fractions of its length, for a legend."""
    low, high = axes.get_ylim()
    height = high - low
    axes.set_ylim(low - below * height, high + above * height)
