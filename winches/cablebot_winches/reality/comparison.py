"""Results of a study: quantities of the model beside those of the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from cablebot_winches.reality.sources import Source

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_UNITS = {"1": ("%", 100.0), "m": ("mm", 1e3), "m/kg": ("mm/kg", 1e3)}
"""Unit and factor of printed values by SI unit, where they differ."""


@dataclass(frozen=True, kw_only=True)
class LogComparison:
    """A quantity of the model beside that of the robot, in SI units."""

    quantity: str
    """The quantity in words."""
    unit: str
    """SI unit; ``1`` for a ratio."""
    model: float | None = None
    """Value of the model; None if the robot's value is itself a deviation, or if the model has
    none."""
    robot: float
    """Value from the logs of the robot."""
    goal: float | None = None
    """Largest deviation from the robot's value, as a fraction of it; without a value of the model
    the largest value of the robot. None if the quantity is shown for information."""

    @property
    def deviation(self) -> float | None:
        """Relative deviation of the model from the robot; None without a value of the model."""
        if self.model is None:
            return None
        return self.model / self.robot - 1

    @property
    def held(self) -> bool | None:
        """Whether the goal is met; None without a goal."""
        if self.goal is None:
            return None
        deviation = self.deviation
        if deviation is None:
            deviation = self.robot
        return abs(deviation) <= self.goal


@dataclass(frozen=True, kw_only=True, eq=False)
class Validation:
    """Result of a study."""

    comparisons: tuple[LogComparison, ...]
    """All quantities."""
    notes: tuple[str, ...]
    """Facts about the logs, as sentences."""
    draw: Callable[[], Figure]
    """Draws the figure of the study. Needs the extra ``plot``."""

    def to_dict(self, name: str, source: Source) -> dict[str, Any]:
        """JSON-able data of a study with the source of its files."""
        comparisons = []
        for item in self.comparisons:
            comparisons.append(asdict(item) | {"deviation": item.deviation, "held": item.held})
        return {
            "study": name,
            "command": f"cablebot validate {name}",
            **asdict(source),
            "comparisons": comparisons,
            "notes": list(self.notes),
        }


def table(comparisons: Iterable[LogComparison]) -> list[list[str]]:
    """Header and rows of the comparisons as text."""
    rows = [["quantity", "model", "robot", "deviation", "goal", "held"]]
    for item in comparisons:
        unit, factor = SHOWN_UNITS.get(item.unit, (item.unit, 1.0))
        row = [item.quantity, "–", f"{factor * item.robot:.4g} {unit}", "–", "–", "–"]
        if item.model is not None and item.deviation is not None:
            row[1] = f"{factor * item.model:.4g} {unit}"
            row[3] = f"{100 * item.deviation:+.1f} %"
        if item.goal is not None:
            row[4] = f"{factor * item.goal:g} {unit}"
            if item.model is not None:
                row[4] = f"{100 * item.goal:g} %"
            row[5] = "yes" if item.held else "no"
        rows.append(row)
    return rows
