"""Output on the terminal: consoles for results and for messages, tables, and the progress of long computations."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:  # rich is imported on first use, because start-up time counts
    from rich.console import Console

_PLAIN_WIDTH = 170
"""Number of columns if the output is not a terminal."""

FIRST_LINE = 2.0
"""Elapsed time before the first line of progress off a terminal [s]."""

LINE_GROWTH = 1.3
"""Ratio of the elapsed times of two successive lines of progress, which are at least :data:`FIRST_LINE` apart."""


LEAST = 0.03
"""Finished fraction from which the time left is estimated."""


class Step(Protocol):
    """Reports the progress of a computation."""

    def __call__(self, done: float, expected: float, text: str = "") -> None:
        """``done`` of ``expected`` units are finished. ``text`` replaces the description."""


def results_console() -> Console:
    """Console for results, as wide as the terminal or ``COLUMNS``.

    Markup and emoji are disabled because names contain brackets and colons.
    """
    from rich.console import Console

    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else _PLAIN_WIDTH
    return Console(width=width, markup=False, emoji=False, highlight=False)


@cache
def notes_console() -> Console:
    """Console for progress and messages on standard error, without markup, emoji and wrapping."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


def print_table(
    title: str, rows: Iterable[Sequence[str]], *, right: bool = True, width: int | None = None, **options: Any
) -> None:
    """Prints a title and a table on standard output.

    Args:
        title: line above the table.
        rows: the header, then the rows.
        right: whether all columns after the first are aligned to the right.
        width: largest width [columns]; None for the width of the terminal.
        options: options of ``rich.table.Table``.
    """
    from rich.table import Table

    head, *body = rows
    table = Table(**options)
    for index, name in enumerate(head):
        table.add_column(name, justify="right" if right and index else "left", overflow="fold")
    for row in body:
        table.add_row(*row)
    console = results_console()
    console.width = min(console.width, width or console.width)
    console.print(title)
    console.print(table)


@contextmanager
def progress(text: str, unit: str = "%") -> Iterator[Step]:
    """Shows the progress of a computation and the time left: as a bar on a terminal, else as a line now and then.

    Args:
        text: description of the computation.
        unit: unit that is counted, such as ``cells``; ``%`` shows the percentage instead.
    """
    console = notes_console()
    if not console.is_terminal:
        yield _line_printer(text, unit, console.print)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    count = "{task.percentage:3.0f} %" if unit == "%" else f"{{task.completed:.0f}} of {{task.total:.0f}} {unit}"
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn(count))
    left = (TimeElapsedColumn(), TimeRemainingColumn(), TextColumn("left"))
    with Progress(*columns, *left, console=console, transient=True) as bar:
        task = bar.add_task(text, total=1.0)

        def step(done: float, expected: float, text: str = "") -> None:
            bar.update(task, completed=done, total=expected, description=text or None)

        yield step


@contextmanager
def activity() -> Iterator[Callable[[str], None]]:
    """Shows the activity of a computation of unknown length. Yields a function that takes the present activity."""
    console, start = notes_console(), time.monotonic()
    if not console.is_terminal:
        yield lambda text: console.print(f"{time.monotonic() - start:.0f} s: {text}")
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text: bar.update(task, description=text)


def _line_printer(text: str, unit: str, say: Callable[[str], None]) -> Step:
    """Progress as lines of a log. Results that are done at the first step do not affect the time left."""
    start, description = time.monotonic(), text
    due, first = start + FIRST_LINE, -1.0

    def step(done: float, expected: float, text: str = "") -> None:
        nonlocal due, first, description
        description = text or description
        first = done if first < 0 else first
        now = time.monotonic()
        if now < due or not first + LEAST * (expected - first) < done < expected:
            return
        due = max(now + FIRST_LINE, start + LINE_GROWTH * (now - start))
        count = f"{done / expected:.0%}" if unit == "%" else f"{done:.0f} of {expected:.0f} {unit}"
        say(f"{description}: {count}, {_duration((now - start) * (expected - done) / (done - first))} left")

    return step


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{max(1.0, seconds):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
