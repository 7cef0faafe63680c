"""Parts of the reproduction page. A part has computations, numbers, tables and a figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from cablebot_gym.benchmark.engine import Job
from cablebot_reproduction.interpretation import Interpretation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Number = float | int | str | bool | None
"""Value of a number in results.json."""

Jobs = dict[str, Job]
"""Computations of a part by name. A computation that several parts share has one key and runs
once."""

Results = Mapping[str, Any]
"""Results of the computations of a part by name."""


def job(function: Callable[..., Any], **keywords: Any) -> Job:
    """The call of a module-level function. Its keyword arguments can be pickled, and their ``repr``
    identifies them."""
    arguments = ", ".join(f"{name}={keywords[name]!r}" for name in sorted(keywords))
    return Job(
        key=f"{function.__module__}.{function.__qualname__}({arguments})",
        compute=partial(function, **keywords),
        kind=(function, keywords.get("env_id")),
    )


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
    """Numbers by name. A name ends with the unit, if any: ``payload_kg``, ``motor``,
    ``peak_error_mm``."""
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
    """Description of the contents and the method in Markdown."""
    jobs: Callable[[Interpretation], Jobs]
    """Function that returns the required computations of an interpretation."""
    outcome: Callable[[Interpretation, Results], Outcome]
    """Function that returns the numbers and tables."""
    draw: Callable[[Interpretation, Results], Figure] | None = None
    """Function that draws the figure; None if the part has no figure."""
