"""The store of a suite's results: one file, a row on each line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.rows import Row, row_from_dict
from cablebot_gym.utils.files import atomic_write_text, read_text
from cablebot_gym.utils.foreign import foreign_json, foreign_object

SUFFIX = ".jsonl"
"""Suffix of the file of a suite."""

_ADVICE = "give a folder that `cablebot benchmark --out FOLDER` wrote"


def file_of(folder: str | Path, suite: str) -> Path:
    """The file of a suite in a folder of results."""
    return Path(folder) / f"{suite}{SUFFIX}"


@dataclass(frozen=True, kw_only=True)
class Results:
    """The results of one suite."""

    suite: str
    """Name of the suite."""
    command: str
    """Commands that compute the results, separated by semicolons."""
    rows: Sequence[Row]
    """All rows."""
    seed_text: str | None = None
    """Public text from which the hidden motions and the evaluation seed follow; None for a suite
    without hidden motions."""

    def to_text(self) -> str:
        """The file: a head, then a row on each line. Equal results give identical bytes."""
        head = {"suite": self.suite, "command": self.command, "seed_text": self.seed_text}
        return _line(head) + "".join(_line(row.to_dict()) for row in self.rows)

    @classmethod
    def from_text(cls, text: str, *, say: Callable[[str], None] | None = None) -> Results:
        """The results whose :meth:`to_text` returned ``text``. Of two rows with the same conditions,
        the last one counts.

        Args:
            text: content of a file.
            say: called with one sentence for each invalid row; None to raise an error.

        Raises:
            ValueError: if the head or a line is damaged.
        """
        first, *lines = text.removesuffix("\n").split("\n")
        head = foreign_object("the head", foreign_json(first))
        if "suite" not in head:
            raise ValueError("the first line is not the head of a suite")
        rows: dict[str, Row] = {}
        for number, line in enumerate(lines, 2):
            try:
                row = row_from_dict(foreign_json(line))
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                problem = f"line {number} is no row"
                if say is None:
                    raise ValueError(problem) from error
                say(problem)
                continue
            rows[row.key] = row
        seed_text = head.get("seed_text")
        if seed_text is not None:
            seed_text = str(seed_text)
        return cls(
            suite=str(head["suite"]),
            command=str(head.get("command", "")),
            rows=list(rows.values()),
            seed_text=seed_text,
        )


class Store:
    """The file of a suite in a folder, to which finished rows are added.

    Args:
        folder: folder of the results.
        suite: name of the suite.
        command: command that computes the results.
        seed_text: public text of the hidden motions.
        say: called with one sentence for each invalid row.

    Raises:
        ValueError: if the file has an invalid head or another seed text.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        suite: str,
        command: str,
        seed_text: str | None,
        say: Callable[[str], None],
    ) -> None:
        self.path = file_of(folder, suite)
        """The file."""
        rows: Sequence[Row] = ()
        if self.path.exists():
            before = read(
                self.path,
                say=lambda problem: say(
                    f"{self.path} is damaged: {problem}; the row is computed again"
                ),
            )
            rows = before.rows
            commands = [*before.command.split("; "), *command.split("; ")]
            command = "; ".join(dict.fromkeys(commands))
            if before.seed_text != seed_text:
                raise ValueError(
                    f"{str(self.path)!r} has rows of another --seed-text: repeat that text, or choose another --out"
                )
        self._results = Results(suite=suite, command=command, rows=rows, seed_text=seed_text)
        self._rows = {row.key: row for row in rows}

    def find(self, row: Row) -> Row | None:
        """The stored row with the conditions of ``row``; None if it is missing or due."""
        stored = self._rows.get(row.key)
        if stored is None or stored.is_due:
            return None
        return stored

    def add(self, rows: Iterable[Row]) -> None:
        """Appends the final rows to the file."""
        final = [row for row in rows if row.final]
        if not self.path.exists():
            atomic_write_text(self.path, self._results.to_text())
        with self.path.open("a", encoding="utf-8") as file:
            file.writelines(_line(row.to_dict()) for row in final)
        for row in final:
            self._rows[row.key] = row

    def close(self, order: Sequence[str]) -> Results:
        """Rewrites the file, with the rows of the keys ``order`` first, and returns its
        results."""
        first = [self._rows[key] for key in order if key in self._rows]
        listed = set(order)
        others = [row for key, row in self._rows.items() if key not in listed]
        results = replace(self._results, rows=first + others)
        atomic_write_text(self.path, results.to_text())
        return results


def _line(data: Any) -> str:
    return json.dumps(data, ensure_ascii=False, allow_nan=False) + "\n"


def read(path: str | Path, *, say: Callable[[str], None] | None = None) -> Results:
    """The results in the file of a suite. For ``say`` see :meth:`Results.from_text`.

    Raises:
        ValueError: if the file cannot be read. The message says how to create results.
    """
    try:
        results = Results.from_text(read_text(path), say=say)
    except OSError as error:
        raise ValueError(
            f"cannot read {str(path)!r} ({error.strerror or error}): {_ADVICE}"
        ) from error
    except ValueError as error:
        raise ValueError(f"{str(path)!r} holds no results ({error}): {_ADVICE}") from error
    return results


def read_all(path: str | Path) -> list[Results]:
    """The results of all suites in a folder, or those of one file.

    Raises:
        ValueError: if there are no rows, or a file cannot be read.
    """
    source = Path(path)
    files = [source]
    if source.is_dir():
        files = sorted(source.glob(f"*{SUFFIX}"))
    suites = [read(file) for file in files]
    if not any(suite.rows for suite in suites):
        raise ValueError(f"{str(path)!r} holds no rows: {_ADVICE}")
    return suites
