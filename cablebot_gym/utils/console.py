"""What the commands' output in a terminal has in common."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

_PLAIN_WIDTH = 170
"""Columns where the output is no terminal."""


def results_console() -> Console:
    """For results: as wide as the terminal or ``COLUMNS``; no markup, no emoji: names hold brackets and colons."""
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else _PLAIN_WIDTH
    return Console(width=width, markup=False, emoji=False)


def notes_console() -> Console:
    """For everything that is no result: standard error, words as they are."""
    return Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


@contextmanager
def working(console: Console) -> Iterator[Callable[[str], None]]:
    """A line that says what is being done and for how long, for work whose end is not known; in a terminal alone."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text: bar.update(task, description=text)


def counting(console: Console, things: str) -> Progress:
    """A bar that counts things, such as ``computations``; shown in a terminal alone."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn(f"{{task.completed:.0f}} of {{task.total:.0f}} {things}"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
