"""Runs the parts of the reproduction and writes the figures, results.json and the page."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_baselines.paper.contents import PARTS
from cablebot_baselines.paper.findings import rows
from cablebot_baselines.paper.interpretation import Interpretation, NoEquilibriumError
from cablebot_baselines.paper.page import html, markdown
from cablebot_baselines.paper.part import Jobs, Number, Part, Results
from cablebot_baselines.paper.texts import command
from cablebot_gym.benchmark.engine import local, run_jobs
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.plotting.figures import DPI, import_matplotlib
from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.code_hash import source_hash
from cablebot_gym.utils.files import atomic_write, atomic_write_text, check_writable_dir, read_cached, read_text
from cablebot_gym.utils.workers import check_workers

RESULTS, MARKDOWN, HTML = "results.json", "reproduction.md", "reproduction.html"
"""Names of the output files besides the figures."""

Progress = Callable[[str, int, int], None]
"""Progress callback with the current activity, the number of finished computations and their total number."""

_ERRATA = "../errata.md"
"""Relative path of the list of misprints from docs/reproduction."""

_DIGITS = 10
"""Significant digits in results.json. Further digits are rounding errors that differ between machines."""


def find_parts(names: Sequence[str]) -> tuple[Part, ...]:
    """The named parts in the order of the page; all parts if no name is given.

    Raises:
        ValueError: if a name is unknown; the message lists the valid names.
    """
    for name in names:
        choice("part", name, [part.name for part in PARTS], "; for maps run cablebot benchmark --suite paper-maps")
    return tuple(part for part in PARTS if not names or part.name in names)


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

    Existing parts in the folder are kept until they are recomputed, if the code and the interpretation are the same.
    With ``only``, a folder with results of other code or of another interpretation is rejected. After an interrupt the
    finished parts are written, and a second call with ``only`` can compute the remaining parts.

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
        ValueError: if a part is unknown, if the folder is not writable, if ``only`` is given and the folder contains
            results of another interpretation or of other code, or if ``workers`` is not positive.
        ImportError: if matplotlib is missing; the message names the installation command.
    """
    parts = find_parts(only)
    workers = check_workers(workers)
    import_matplotlib()
    check_writable_dir(out)
    output = _Output(interpretation, out, alone=not only)
    try:
        for part, results in _computed(
            parts, interpretation, workers, progress or (lambda *_: None), say or (lambda _: None)
        ):
            output.add(part, results)
    finally:
        written = output.write()
    return written


def missing(out: Path, names: Sequence[str]) -> list[str]:
    """Parts that the results in a folder do not contain, restricted to ``names`` unless it is empty."""
    held = json.loads(read_text(out / RESULTS))["missing"]
    return [name for name in held if not names or name in names]


class _Output:
    """Finished parts and their output files."""

    def __init__(self, interpretation: Interpretation, out: Path, *, alone: bool) -> None:
        self._interpretation, self._out = interpretation, out
        files = sorted(path for path in Path(__file__).parent.iterdir() if path.suffix in (".md", ".toml"))
        self._head = {
            "interpretation": asdict(interpretation),
            "versions": versions(),
            "source": source_hash("cablebot_baselines.paper.engine", data=tuple(files)),
        }
        self._numbers: dict[str, Number] = {}
        self._parts: dict[str, dict[str, Any]] = {}
        self._keep(alone)

    def _keep(self, alone: bool) -> None:
        """Loads the results of an earlier run with the same code and interpretation."""
        results = read_cached(self._out / RESULTS, self._decoded)
        if results is None:
            return
        is_same, numbers, parts = results
        if is_same:
            self._numbers, self._parts = numbers, parts
        elif not alone:
            raise ValueError(
                f"{str(self._out)!r} contains results of another interpretation or of other code; choose another "
                "--out, or run all parts without --only"
            )

    def _decoded(self, content: bytes) -> tuple[bool, dict[str, Number], dict[str, dict[str, Any]]]:
        """Whether stored results are of the same code and interpretation; their numbers, and their parts by name."""
        data = json.loads(content)
        is_same = all(data[name] == value for name, value in self._head.items())
        return is_same, dict(data["numbers"]), {part["name"]: part for part in data["parts"]}

    def add(self, part: Part, results: Results | str) -> None:
        """Adds the outcome and the figure of a part, or the reason why the interpretation does not allow it."""
        self._numbers = {key: value for key, value in self._numbers.items() if not key.startswith(f"{part.name}.")}
        entry: dict[str, Any] = {
            "name": part.name,
            "title": part.title,
            "text": part.text,
            "figure": None,
            "tables": [],
        }
        if isinstance(results, str):
            entry["impossible"] = results
        else:
            outcome = part.outcome(self._interpretation, results)
            self._numbers |= {f"{part.name}.{key}": json_number(value) for key, value in outcome.numbers.items()}
            for table in outcome.tables:
                cells = [[json_number(value) for value in row] for row in table.rows]
                entry["tables"].append({"title": table.title, "header": list(table.header), "rows": cells})
            if part.draw is not None:
                entry["figure"] = part.name
                save_figure(part.draw(self._interpretation, results), self._out / part.name)
        self._parts[part.name] = entry

    def write(self) -> dict[str, Any]:
        """Writes results.json and the page of all finished parts."""
        order = [part.name for part in PARTS]
        finished = [name for name in order if name in self._parts]
        results: dict[str, Any] = self._head | {
            "command": command(self._interpretation, *(finished if len(finished) < len(order) else ())),
            "numbers": {
                key: self._numbers[key] for name in order for key in self._numbers if key.startswith(f"{name}.")
            },
            "parts": [self._parts[name] for name in finished],
            "missing": [name for name in order if name not in self._parts],
        }
        if (self._out / _ERRATA).is_file():
            results["errata"] = _ERRATA
        impossible = {name: part["impossible"] for name, part in self._parts.items() if "impossible" in part}
        results["rows"] = rows(self._interpretation, results["numbers"], impossible)
        text = json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        for name, content in ((RESULTS, text), (MARKDOWN, markdown(results)), (HTML, html(results))):
            atomic_write_text(self._out / name, content)
        return results


def save_figure(figure: Any, stem: Path) -> None:
    """Writes a figure as ``.png`` and ``.svg`` with reproducible bytes."""
    from matplotlib import rc_context

    for suffix, keywords in ((".png", {"dpi": DPI}), (".svg", {"metadata": {"Date": None}})):
        with rc_context({"svg.hashsalt": stem.name}):
            atomic_write(stem.with_suffix(suffix), partial(figure.savefig, format=suffix[1:], **keywords))


def json_number(value: Any) -> Number:
    """JSON value: a Python type, None for infinity and NaN, rounded to the digits on which machines agree."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    raise TypeError(f"a result must be a number, a text, a truth value or None, not {value!r}")


def _computed(
    parts: Sequence[Part],
    interpretation: Interpretation,
    workers: int,
    progress: Progress,
    say: Callable[[str], None],
) -> Iterator[tuple[Part, Results | str]]:
    """Yields each part with its results, or with the reason why the interpretation does not allow it."""
    waiting: dict[str, tuple[Part, Jobs]] = {}
    for part in parts:
        try:
            waiting[part.name] = part, part.jobs(interpretation)
        except NoEquilibriumError as error:
            yield part, str(error)
    jobs = {job.key: job for _, own in waiting.values() for job in own.values()}
    done: dict[str, Any] = {}

    def complete() -> Iterator[tuple[Part, Results | str]]:
        for name, (part, own) in list(waiting.items()):
            if all(job.key in done for job in own.values()):
                progress(f"drawing {name}", len(done), len(jobs))
                results = {name: done[job.key] for name, job in own.items()}
                failed = [result for result in results.values() if isinstance(result, NoEquilibriumError)]
                del waiting[name]
                yield part, str(failed[0]) if failed else results

    yield from complete()  # parts without computations
    for key, result in run_jobs(jobs.values(), local(workers), say=say, returned=(NoEquilibriumError,)):
        done[key] = result
        progress("computing", len(done), len(jobs))
        yield from complete()
