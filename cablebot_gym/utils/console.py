"""Terminal output shared by all commands."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

_PLAIN_WIDTH = 170
"""Number of columns if the output is not a terminal."""


def results_console() -> Console:
    """Console for results, as wide as the terminal or ``COLUMNS``.

    Markup and emoji are disabled because names contain brackets and colons.
    """
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else _PLAIN_WIDTH
    return Console(width=width, markup=False, emoji=False)


def notes_console() -> Console:
    """Console for progress and messages on standard error, without markup, emoji and wrapping."""
    return Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


@contextmanager
def working(console: Console) -> Iterator[Callable[[str], None]]:
    """Shows the current activity and the elapsed time of work of unknown length; in a terminal only."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text: bar.update(task, description=text)


def counting(console: Console, unit: str) -> Progress:
    """A progress bar that counts in a unit, such as ``computations``; shown in a terminal only."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn(f"{{task.completed:.0f}} of {{task.total:.0f}} {unit}"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
