"""What the page of the reproduction is made of: parts, each with its computations, its numbers and its figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from cablebot_baselines.paper.readings import Readings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Number = float | int | str | bool | None
"""What results.json holds under a name."""

Cell = partial[Any]
"""One computation: a function of a module with keywords that can be pickled and whose ``repr`` tells them apart. Equal
cells of several parts run once, each in a process of its own choosing."""

Found = Mapping[str, Any]
"""What a part's cells returned, by their names in the part."""


def cell_key(cell: Cell) -> str:
    """Tells cells apart: the function and its keywords."""
    keywords = ", ".join(f"{name}={value!r}" for name, value in sorted(cell.keywords.items()))
    return f"{cell.func.__module__}.{cell.func.__qualname__}({keywords})"


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the page, as it is printed."""

    title: str
    """What it shows, one sentence."""
    header: tuple[str, ...]
    """Names of the columns, units in brackets."""
    rows: tuple[tuple[Number, ...], ...]
    """Cells; numbers are printed with four significant digits, None as a dash."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a part says in numbers."""

    numbers: Mapping[str, Number] = field(default_factory=dict)
    """By name, units at the end of the name where it has one: ``payload_kg``, ``motor``, ``peak_error_mm``."""
    tables: tuple[Table, ...] = ()
    """Tables below the figure."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """A figure, a table of readings or a map."""

    name: str
    """What ``--only`` takes, and the stem of its files: ``fig10``."""
    title: str
    """Heading on the page."""
    text: str
    """What is shown and how it was made, one paragraph of Markdown."""
    cells: Callable[[Readings], dict[str, Cell]]
    """The computations that it needs under these readings."""
    outcome: Callable[[Readings, Found], Outcome]
    """The numbers and tables."""
    draw: Callable[[Readings, Found], Figure] | None = None
    """The figure."""
