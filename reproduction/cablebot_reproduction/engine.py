"""Runs the parts of the reproduction and writes the figures, results.json and the page."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_gym.benchmark.engine import Job, local, run_jobs
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.plotting.figures import DPI, import_matplotlib
from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.code_hash import source_hash
from cablebot_gym.utils.files import (
    atomic_write,
    atomic_write_text,
    check_writable_dir,
    read_cached,
    read_text,
)
from cablebot_gym.utils.workers import check_workers
from cablebot_reproduction.contents import PARTS
from cablebot_reproduction.findings import rows
from cablebot_reproduction.interpretation import Interpretation, NoEquilibriumError
from cablebot_reproduction.page import html, markdown
from cablebot_reproduction.part import Jobs, Number, Part, Results
from cablebot_reproduction.texts import command

RESULTS = "results.json"
MARKDOWN = "reproduction.md"
HTML = "reproduction.html"
"""Names of the output files besides the figures."""

Progress = Callable[[int, int, str], None]
"""Progress callback with the number of finished computations, their total number and the current
activity."""

_ERRATA = "errata.md"
"""Relative path of the list of misprints from the stored page."""

_DIGITS = 10
"""Significant digits in results.json. Further digits are rounding errors that differ between
machines."""


def find_parts(names: Sequence[str]) -> tuple[Part, ...]:
    """The named parts in the order of the page; all parts if no name is given.

    Raises:
        ValueError: if a name is unknown; the message lists the valid names.
    """
    valid = [page_part.name for page_part in PARTS]
    for name in names:
        choice("part", name, valid, "; for maps run cablebot benchmark --suite paper-maps")
    if not names:
        return PARTS
    return tuple(page_part for page_part in PARTS if page_part.name in names)


def reproduce(
    interpretation: Interpretation,
    out: Path,
    *,
    only: Sequence[str] = (),
    workers: int | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Runs parts and writes their figures, ``results.json`` and the page to a folder.

    Existing parts in the folder are kept until they are recomputed, if the code and the
    interpretation are the same. With ``only``, a folder with results of other code or of another
    interpretation is rejected. After an interrupt the finished parts are written, and a second call
    with ``only`` can compute the remaining parts.

    Args:
        interpretation: interpretation of the paper.
        out: output folder; it is created if it does not exist.
        only: names of parts; all parts if empty.
        workers: number of processes; None for one per core.
        progress: called after every computation.
        say: receives messages for the user, such as a notice of the first compilation.

    Returns:
        Contents of results.json.

    Raises:
        ValueError: if a part is unknown, if the folder is not writable, if ``only`` is given and
            the folder contains results of another interpretation or of other code, or if
            ``workers`` is not positive.
        ImportError: if matplotlib is missing; the message names the installation command.
    """
    page_parts = find_parts(only)
    workers = check_workers(workers)
    import_matplotlib()
    check_writable_dir(out)
    output = _Output(interpretation, out, alone=not only)
    computed = _computed(page_parts, interpretation, workers, progress or _ignore, say or _ignore)
    try:
        for page_part, results in computed:
            output.add(page_part, results)
    finally:
        written = output.write()
    return written


def _ignore(*_: Any) -> None:
    """A callback without effect."""


def missing(out: Path, names: Sequence[str]) -> list[str]:
    """Parts that the results in a folder do not contain, restricted to ``names`` unless it is
    empty."""
    missing: list[str] = json.loads(read_text(out / RESULTS))["missing"]
    if not names:
        return missing
    return [name for name in missing if name in names]


class _Output:
    """Finished parts and their output files."""

    def __init__(self, interpretation: Interpretation, out: Path, *, alone: bool) -> None:
        self._interpretation = interpretation
        self._out = out
        folder = Path(__file__).parent
        data = (*sorted(folder.glob("*.md")), *sorted(folder.glob("*.toml")))
        self._head = {
            "interpretation": asdict(interpretation),
            "versions": versions(),
            "source": source_hash("cablebot_reproduction.engine", data=data),
        }
        self._numbers: dict[str, Number] = {}
        self._entries: dict[str, dict[str, Any]] = {}
        self._keep(alone)

    def _keep(self, alone: bool) -> None:
        """Loads the results of an earlier run with the same code and interpretation."""
        results = read_cached(self._out / RESULTS, self._decoded)
        if results is None:
            return
        is_same, numbers, entries = results
        if is_same:
            self._numbers = numbers
            self._entries = entries
        elif not alone:
            raise ValueError(
                f"{str(self._out)!r} contains results of another interpretation or of other code; choose another "
                "--out, or run all parts without --only"
            )

    def _decoded(self, content: bytes) -> tuple[bool, dict[str, Number], dict[str, dict[str, Any]]]:
        """Whether stored results are of the same code and interpretation; their numbers, and their
        parts by name."""
        data = json.loads(content)
        is_same = all(data[name] == value for name, value in self._head.items())
        return is_same, dict(data["numbers"]), {entry["name"]: entry for entry in data["parts"]}

    def add(self, page_part: Part, results: Results | str) -> None:
        """Adds the outcome and the figure of a part, or the reason why the interpretation does not
        allow it."""
        name = page_part.name
        for key in self._numbers_of(name):
            del self._numbers[key]
        entry: dict[str, Any] = {
            "name": name,
            "title": page_part.title,
            "text": page_part.text,
            "figure": None,
            "tables": [],
        }
        self._entries[name] = entry
        if isinstance(results, str):
            entry["impossible"] = results
            return
        outcome = page_part.outcome(self._interpretation, results)
        for key, value in outcome.numbers.items():
            self._numbers[f"{name}.{key}"] = json_number(value)
        for table in outcome.tables:
            cells = [list(map(json_number, row)) for row in table.rows]
            entry["tables"].append(
                {"title": table.title, "header": list(table.header), "rows": cells}
            )
        if page_part.draw is not None:
            entry["figure"] = name
            save_figure(page_part.draw(self._interpretation, results), self._out / name)

    def _numbers_of(self, name: str) -> list[str]:
        """Keys of the numbers of a part."""
        return [key for key in self._numbers if key.startswith(f"{name}.")]

    def write(self) -> dict[str, Any]:
        """Writes results.json and the page of all finished parts."""
        entries: dict[str, Any] = {}
        missing: list[str] = []
        numbers: dict[str, Number] = {}
        impossible: dict[str, str] = {}
        for page_part in PARTS:
            name = page_part.name
            if name not in self._entries:
                missing.append(name)
                continue
            entries[name] = self._entries[name]
            if "impossible" in entries[name]:
                impossible[name] = entries[name]["impossible"]
            for key in self._numbers_of(name):
                numbers[key] = self._numbers[key]
        only: Iterable[str] = ()
        if missing:
            only = entries
        results: dict[str, Any] = self._head | {
            "command": command(self._interpretation, *only),
            "numbers": numbers,
            "parts": list(entries.values()),
            "missing": missing,
        }
        if (self._out / _ERRATA).is_file():
            results["errata"] = _ERRATA
        results["rows"] = rows(self._interpretation, numbers, impossible)
        text = json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        atomic_write_text(self._out / RESULTS, text)
        atomic_write_text(self._out / MARKDOWN, markdown(results))
        atomic_write_text(self._out / HTML, html(results))
        return results


def save_figure(figure: Any, stem: Path) -> None:
    """Writes a figure as ``.png`` and ``.svg`` with reproducible bytes."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": stem.name}):
        atomic_write(stem.with_suffix(".png"), partial(figure.savefig, format="png", dpi=DPI))
        atomic_write(
            stem.with_suffix(".svg"), partial(figure.savefig, format="svg", metadata={"Date": None})
        )


def json_number(value: Any) -> Number:
    """JSON value: a Python type, None for infinity and NaN, rounded to the digits on which machines
    agree."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return float(f"{value:.{_DIGITS}g}")
    if value is None or isinstance(value, (bool, int, str)):
        return value
    raise TypeError(f"a result must be a number, a text, a truth value or None, not {value!r}")


def _computed(
    page_parts: Sequence[Part],
    interpretation: Interpretation,
    workers: int,
    progress: Progress,
    say: Callable[[str], None],
) -> Iterator[tuple[Part, Results | str]]:
    """Yields each part with its results, or with the reason why the interpretation does not allow
    it."""
    waiting: list[tuple[Part, Jobs]] = []
    all_jobs: dict[str, Job] = {}
    for page_part in page_parts:
        try:
            jobs = page_part.jobs(interpretation)
        except NoEquilibriumError as error:
            yield page_part, str(error)
            continue
        waiting.append((page_part, jobs))
        for job in jobs.values():
            all_jobs[job.key] = job
    results_by_key: dict[str, Any] = {}

    def finished() -> Iterator[tuple[Part, Results | str]]:
        for page_part, jobs in list(waiting):
            results = {}
            for name, job in jobs.items():
                if job.key in results_by_key:
                    results[name] = results_by_key[job.key]
            if len(results) < len(jobs):
                continue
            progress(len(results_by_key), len(all_jobs), f"drawing {page_part.name}")
            waiting.remove((page_part, jobs))
            for result in results.values():
                if isinstance(result, NoEquilibriumError):
                    yield page_part, str(result)
                    break
            else:
                yield page_part, results

    yield from finished()  # parts without computations
    computed = run_jobs(all_jobs.values(), local(workers), say=say, returned=(NoEquilibriumError,))
    for key, result in computed:
        results_by_key[key] = result
        progress(len(results_by_key), len(all_jobs), "computing")
        yield from finished()
