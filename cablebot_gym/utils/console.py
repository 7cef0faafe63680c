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

LINE_GROWTH = 1.3
"""Ratio of the elapsed times of two successive lines of progress, which are at least
:data:`FIRST_LINE` apart."""

LONGEST_SILENCE = 60.0
"""Longest time between two lines of progress [s]."""

LEAST = 0.03
"""Finished fraction from which the time left is estimated."""

LEAST_WORK = 10.0
"""Time of work from which the time left is estimated even if less than :data:`LEAST` is finished
[s]."""

_PULSE = 0.5
"""Time between two looks at the clock while a computation reports nothing [s]."""


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


def print_table(
    title: str,
    rows: Iterable[Sequence[str]],
    *,
    right: bool = True,
    width: int | None = None,
    **options: Any,
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
        justify: JustifyMethod = "right" if right and index else "left"
        # Names are copied, so they stay in one piece; rich would break them first.
        has_names = not right and not any(" " in row[index] for row in body)
        table.add_column(name, justify=justify, overflow="fold", no_wrap=has_names)
    for row in body:
        table.add_row(*row)
    console = results_console()
    console.width = min(console.width, width or console.width)
    console.print(title)
    console.print(table)


class Preparation:
    """Counts the time of preparations, such as compilation, which the estimates of the time left do
    not include."""

    def __init__(self) -> None:
        self._depth = 0
        self._since = 0.0
        self._spent = 0.0

    def start(self) -> None:
        """Starts a preparation, which may be a part of another one."""
        if not self._depth:
            self._since = time.monotonic()
        self._depth += 1

    def end(self) -> None:
        """Ends a preparation."""
        self._depth -= 1
        if not self._depth:
            self._spent += time.monotonic() - self._since

    @property
    def is_active(self) -> bool:
        """Whether a preparation is running."""
        return self._depth > 0

    @property
    def worked(self) -> float:
        """Time without preparations, from an arbitrary zero [s]."""
        end = self._since if self._depth else time.monotonic()
        return end - self._spent


PREPARATION = Preparation()
"""The preparations of this process."""


class _Clock:
    """Times of one computation."""

    def __init__(self) -> None:
        self._start = time.monotonic()
        self._first = -1.0
        self._since = 0.0
        self._last = 0.0
        self._done = self._expected = 0.0

    @property
    def elapsed(self) -> float:
        """Time since the start, with preparations [s]."""
        return time.monotonic() - self._start

    def update(self, done: float, expected: float) -> None:
        """Notes the progress. Work starts at the last report of the first value: results may be
        there already."""
        if self._first in (-1.0, done):
            self._first = done
            self._since = PREPARATION.worked
        self._done = done
        self._expected = expected
        self._last = PREPARATION.worked

    @property
    def left(self) -> str:
        """Text of the time left; empty while it is unknown."""
        finished = self._done - self._first
        remaining = self._expected - self._done
        now = PREPARATION.worked
        if min(remaining, finished) <= 0:
            return ""
        is_early = finished <= LEAST * (finished + remaining)
        if is_early and now - self._since < LEAST_WORK:
            return ""
        # The next unit is expected at the mean pace; if it is late, as if it were finished now.
        in_time = (self._last - self._since) * remaining / finished - (now - self._last)
        late = (now - self._since) * (remaining - 1) / (finished + 1)
        return f"{_duration(max(in_time, late))} left"


def _is_terminal(console: Console) -> bool:
    """Whether bars can be drawn. rich alone would draw them in a log or a notebook that sets
    ``FORCE_COLOR``."""
    return console.is_terminal and sys.stderr.isatty()


@contextmanager
def progress(text: str, unit: str = "%") -> Iterator[Step]:
    """Shows the progress of a computation, and elapsed and remaining time: as a bar on a terminal,
    else as lines.

    The lines come at growing intervals of at most :data:`LONGEST_SILENCE`, also while the
    computation reports nothing.

    Args:
        text: description of the computation.
        unit: unit that is counted, such as ``cells``; ``%`` shows the percentage instead.
    """
    console = notes_console()
    clock = _Clock()
    if not _is_terminal(console):
        with _lines(clock, console.print) as say:
            description = text
            say(text)

            def report(done: float, expected: float, text: str = "") -> None:
                nonlocal description
                description = text or description
                clock.update(done, expected)
                if done < expected:
                    count = f"{done:,.0f} of {expected:,.0f} {unit}"
                    if unit == "%":
                        count = f"{done / expected:.0%}"
                    say(f"{description}: {count}")

            yield report
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    count = f"{{task.completed:,.0f}} of {{task.total:,.0f}} {unit}"
    if unit == "%":
        count = "{task.percentage:3.0f} %"
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn(count),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(text, total=1.0, left="")

        def step(done: float, expected: float, text: str = "") -> None:
            clock.update(done, expected)
            bar.update(
                task, completed=done, total=expected, description=text or None, left=clock.left
            )

        yield step


@contextmanager
def chosen_progress(choice: Any, text: str, unit: str = "%") -> Iterator[Any]:
    """The callback for an argument ``progress``: that of :func:`progress` for True, else the
    argument, or None."""
    if choice is not True:
        yield choice or None
        return
    with progress(text, unit) as step:
        yield step


@contextmanager
def activity() -> Iterator[Callable[[str], None]]:
    """Shows the activity of a computation of unknown length. Yields a function that takes the
    present activity."""
    console = notes_console()
    if not _is_terminal(console):
        with _lines(_Clock(), console.print) as say:
            say("starting")
            yield lambda text: say(text, at_once=True)
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text: bar.update(task, description=text)


class _Say(Protocol):
    """Sets the present activity of a log."""

    def __call__(self, text: str, *, at_once: bool = False) -> None:
        """The next line has this text. It is written when it is due, or ``at_once``."""


@contextmanager
def _lines(clock: _Clock, write: Callable[[str], None]) -> Iterator[_Say]:
    """Writes the present activity with elapsed and remaining time when a line is due, in a thread
    of its own."""
    ended = threading.Event()
    lock = threading.Lock()
    present = ""
    due = FIRST_LINE

    def write_line() -> None:
        nonlocal due
        elapsed = clock.elapsed
        pause = max(FIRST_LINE, (LINE_GROWTH - 1) * elapsed)
        due = elapsed + min(pause, max(FIRST_LINE, LONGEST_SILENCE))
        texts = (present, f"{_duration(elapsed)} elapsed", clock.left)
        write(", ".join(filter(None, texts)))

    def say(text: str, *, at_once: bool = False) -> None:
        nonlocal present
        with lock:
            present = text
            if at_once or clock.elapsed >= due:
                write_line()

    def watch() -> None:
        while not ended.wait(_PULSE):
            with lock:
                if clock.elapsed >= due and not PREPARATION.is_active:  # it has announced itself
                    write_line()

    thread = threading.Thread(target=watch, name="progress", daemon=True)
    thread.start()
    try:
        yield say
    finally:
        ended.set()
        thread.join()


def command_line(command: str, *arguments: object, **options: Any) -> str:
    """A complete command line to paste into a shell.

    Args:
        command: command of ``cablebot``.
        arguments: its positional arguments.
        options: values by the option's name in Python. True is a flag without value, a mapping
            becomes JSON, or the name of the file that it comes from (``source``), and a list repeats
            the option. None, False and empty values are left out.
    """
    words = ["cablebot", command, *map(str, arguments)]
    for name, option in options.items():
        values = option if isinstance(option, list) else [option]
        for value in values:
            if value is None or value is False or value in ("", {}):
                continue
            words.append(f"--{name.replace('_', '-')}")
            if hasattr(value, "source"):  # data of a file
                words.append(value.source)
            elif isinstance(value, Mapping):
                words.append(json.dumps(value, ensure_ascii=False))
            elif value is not True:
                words.append(str(value))
    return shlex.join(words)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{max(1.0, seconds):.0f} s"
    if seconds < 600:
        return f"{seconds / 60:.1f} min"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
