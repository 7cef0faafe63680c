"""What a part of the page computes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Number = float | int | str | bool | None
"""A value in results.json."""

Numbers = dict[str, Any]
"""Values of the type :data:`Number` by name. A name ends with the unit, if any, such as
``payload_kg``."""


@dataclass(frozen=True, kw_only=True)
class PaperTable:
    """A table of the page."""

    title: str
    """One sentence on the contents."""
    header: Sequence[str]
    """Names of the columns with units in brackets."""
    rows: Sequence[Sequence[Number]]
    """Values. The page prints numbers with four significant digits and None as a dash."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Numbers, tables and figure of a part."""

    numbers: Numbers
    """Numbers of the part."""
    tables: Sequence[PaperTable] = ()
    """Tables below the figure."""
    figure: Figure | None = None
    """Figure of the part."""
