"""Output on the terminal: consoles for results and for messages, tables, and the progress of long
computations."""

from __future__ import annotations

import json
import os
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol

Progress = Callable[[int, int], None]
"""Called with the number of finished steps and the expected number of steps. Functions that take one
accept True for a bar, or lines in a log, on standard error."""

Say = Callable[[str], None]
"""Called with a sentence for the user."""

if TYPE_CHECKING:  # rich is imported on first use, because start-up time counts
    from rich.console import Console, JustifyMethod

_PLAIN_WIDTH = 170
"""Number of columns if the output is not a terminal."""

FIRST_LINE = 2.0
"""Elapsed time before the first line of progress off a terminal [s]."""

LINE_GROWTH = 0.3
"""Time between two lines of progress, as a fraction of the elapsed time; at least
:data:`FIRST_LINE`."""

LONGEST_SILENCE = 60.0
"""Longest time between two lines of progress [s]."""


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

    return Console(
        stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True, force_jupyter=False
    )


def say(text: str, style: str | None = None) -> None:
    """Prints a message on standard error."""
    notes_console().print(text, style=style)


def print_table(title: str, rows: Iterable[Sequence[str]], *, right: bool = True) -> None:
    """Prints a title and a table on standard output.

    Args:
        title: line above the table.
        rows: the header, then the rows.
        right: whether all columns after the first are aligned to the right.
    """
    from rich.table import Table

    head, *body = rows
    table = Table()
    for index, name in enumerate(head):
        justify: JustifyMethod = "right" if right and index else "left"
        # Names are copied, so they stay in one piece; rich would break them first.
        has_names = not right and not any(" " in row[index] for row in body)
        table.add_column(name, justify=justify, overflow="fold", no_wrap=has_names)
    for row in body:
        table.add_row(*row)
    console = results_console()
    console.print(title)
    console.print(table)


def _is_terminal(console: Console) -> bool:
    """Whether bars can be drawn. rich alone would draw them in a log or a notebook that sets
    ``FORCE_COLOR``."""
    return console.is_terminal and sys.stderr.isatty()


@contextmanager
def progress(text: str, unit: str = "%") -> Iterator[Step]:
    """Shows the progress of a computation with the time left: as a bar on a terminal, else as lines
    at growing intervals of at most :data:`LONGEST_SILENCE`, also while nothing is reported.

    Args:
        text: description of the computation.
        unit: unit that is counted, such as ``cells``; ``%`` shows the percentage instead.
    """
    console = notes_console()
    if not _is_terminal(console):
        with _lines(console, text, unit) as report:
            yield report
        return
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    count = f"{{task.completed:,.0f}} of {{task.total:,.0f}} {unit}"
    if unit == "%":
        count = "{task.percentage:3.0f} %"
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn(count),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(text, total=1.0)

        def step(done: float, expected: float, text: str = "") -> None:
            bar.update(task, completed=done, total=expected, description=text or None)

        yield step


@contextmanager
def _lines(console: Console, text: str, unit: str) -> Iterator[Step]:
    """Prints the progress when a line is due, in a thread of its own."""
    start = time.monotonic()
    latest = 0.0, 1.0, text
    first = 0.0, start, ""  # of a continued computation, something is done at its first report
    ended = threading.Event()

    def step(done: float, expected: float, text: str = "") -> None:
        nonlocal latest, first
        latest = done, expected, text or latest[2]
        if latest[2] != first[2]:
            first = done, time.monotonic(), latest[2]

    def write() -> None:
        elapsed = 0.0
        while not ended.wait(min(max(FIRST_LINE, LINE_GROWTH * elapsed), LONGEST_SILENCE)):
            now = time.monotonic()
            elapsed = now - start
            before, began, _ = first
            pace = (latest[0] - before) / max(now - began, 1e-9)
            console.print(progress_line(*latest, unit=unit, elapsed=elapsed, pace=pace))

    thread = threading.Thread(target=write, name="progress", daemon=True)
    thread.start()
    try:
        yield step
    finally:
        ended.set()
        thread.join()


def progress_line(
    done: float, expected: float, text: str, *, unit: str, elapsed: float, pace: float
) -> str:
    """A line of a log: progress, elapsed time [s] and time left at a pace in units per second."""
    count = f"{done:,.0f} of {expected:,.0f} {unit}"
    if unit == "%":
        count = f"{done / expected:.0%}"
    line = f"{text}: {count}, {timedelta(seconds=round(elapsed))} elapsed"
    if pace > 0:
        line += f", {timedelta(seconds=round((expected - done) / pace))} left"
    return line


@contextmanager
def chosen_progress(choice: Any, text: str, unit: str = "%") -> Iterator[Any]:
    """The callback for an argument ``progress``: that of :func:`progress` for True, else the
    argument, or None."""
    if choice is not True:
        yield choice or None
        return
    with progress(text, unit) as step:
        yield step


def command_line(command: str, *arguments: object, **options: Any) -> str:
    """A complete command line to paste into a shell.

    Args:
        command: command of ``cablebot``.
        arguments: its positional arguments.
        options: values by the option's name in Python. True is a flag without value, a mapping
            becomes JSON, and a list repeats the option. None, False and empty values are left out.
    """
    words = ["cablebot", command, *map(str, arguments)]
    for name, option in options.items():
        values = option if isinstance(option, list) else [option]
        for value in values:
            if value is None or value is False or value in ("", {}):
                continue
            words.append(f"--{name.replace('_', '-')}")
            if isinstance(value, Mapping):
                words.append(json.dumps(value, ensure_ascii=False))
            elif value is not True:
                words.append(str(value))
    return shlex.join(words)
