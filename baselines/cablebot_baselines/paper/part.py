"""Parts of the reproduction page. A part has computations, numbers, tables and a figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from cablebot_baselines.paper.interpretation import Interpretation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Number = float | int | str | bool | None
"""Value of a number in results.json."""

Cell = partial[Any]
"""One computation: a module-level function with keyword arguments. The arguments can be pickled, and their ``repr``
identifies them. A cell that several parts share runs once, in any worker process."""

CellResults = Mapping[str, Any]
"""Return values of the cells of a part, by cell name."""


def cell_key(cell: Cell) -> str:
    """Key that identifies a cell: its function and its keyword arguments."""
    keywords = ", ".join(f"{name}={value!r}" for name, value in sorted(cell.keywords.items()))
    return f"{cell.func.__module__}.{cell.func.__qualname__}({keywords})"


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the page."""

    title: str
    """Title: one sentence on the contents."""
    header: tuple[str, ...]
    """Column names with units in brackets."""
    rows: tuple[tuple[Number, ...], ...]
    """Values. The page prints numbers with four significant digits and None as a dash."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Numbers and tables of a part."""

    numbers: Mapping[str, Number] = field(default_factory=dict)
    """Numbers by name. A name ends with the unit, if any: ``payload_kg``, ``motor``, ``peak_error_mm``."""
    tables: tuple[Table, ...] = ()
    """Tables below the figure."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """One part of the page: a figure, a table of interpretations or a map."""

    name: str
    """Name for ``--only`` and stem of the figure files, for example ``fig10``."""
    title: str
    """Heading on the page."""
    text: str
    """Description of the contents and the method: one Markdown paragraph."""
    cells: Callable[[Interpretation], dict[str, Cell]]
    """Function that returns the required cells of an interpretation."""
    outcome: Callable[[Interpretation, CellResults], Outcome]
    """Function that returns the numbers and tables."""
    draw: Callable[[Interpretation, CellResults], Figure] | None = None
    """Function that draws the figure; None if the part has no figure."""
