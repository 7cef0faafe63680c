"""Runs the parts of the reproduction and writes the figures, results.json and the page."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import cablebot_baselines
import cablebot_gym
from cablebot_baselines.paper.contents import PARTS
from cablebot_baselines.paper.finding import command
from cablebot_baselines.paper.findings import rows
from cablebot_baselines.paper.interpretation import Interpretation, NoEquilibriumError
from cablebot_baselines.paper.page import html, markdown
from cablebot_baselines.paper.part import Cell, CellResults, Number, Part, cell_key
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.plotting.figures import DPI, import_matplotlib
from cablebot_gym.utils.files import atomic_write, atomic_write_text, check_writable_dir
from cablebot_gym.utils.workers import check_workers, run

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
    known = [part.name for part in PARTS]
    for name in names:
        if name not in known:
            raise ValueError(f"unknown part {name!r}; valid parts are {', '.join(known)}")
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
    results = _Results(interpretation, out, alone=not only)
    try:
        for part, cell_results in _computed(parts, interpretation, workers, progress, say or (lambda _: None)):
            results.add(part, cell_results)
    finally:
        written = results.write()
    return written


def missing(out: Path, names: Sequence[str]) -> list[str]:
    """Parts that the results in a folder do not contain, restricted to ``names`` unless it is empty."""
    held = json.loads((out / RESULTS).read_text(encoding="utf-8"))["missing"]
    return [name for name in held if not names or name in names]


class _Results:
    """Finished parts and their output files."""

    def __init__(self, interpretation: Interpretation, out: Path, *, alone: bool) -> None:
        self._interpretation, self._out = interpretation, out
        self._head = {"interpretation": asdict(interpretation), "versions": versions(), "source": source_hash()}
        self._numbers: dict[str, Number] = {}
        self._parts: dict[str, dict[str, Any]] = {}
        self._keep(alone)

    def _keep(self, alone: bool) -> None:
        """Loads the results of an earlier run with the same code and interpretation."""
        try:
            before = json.loads((self._out / RESULTS).read_text(encoding="utf-8"))
            same = all(before[name] == value for name, value in self._head.items())
            numbers, parts = dict(before["numbers"]), {part["name"]: part for part in before["parts"]}
        except (OSError, ValueError, KeyError, TypeError):
            return  # no results, or not written by this command
        if same:
            self._numbers, self._parts = numbers, parts
        elif not alone:
            raise ValueError(
                f"{str(self._out)!r} contains results of another interpretation or of other code; choose another "
                "--out, or run all parts without --only"
            )

    def add(self, part: Part, cell_results: CellResults | str) -> None:
        """Adds the outcome and the figure of a part, or the reason why the interpretation does not allow it."""
        entry: dict[str, Any] = {"name": part.name, "title": part.title, "text": part.text}
        self._numbers = {key: value for key, value in self._numbers.items() if not key.startswith(f"{part.name}.")}
        if isinstance(cell_results, str):
            entry |= {"figure": None, "tables": [], "impossible": cell_results}
        else:
            outcome = part.outcome(self._interpretation, cell_results)
            self._numbers |= {f"{part.name}.{key}": json_number(value) for key, value in outcome.numbers.items()}
            entry |= {
                "figure": None if part.draw is None else part.name,
                "tables": [
                    {
                        "title": table.title,
                        "header": list(table.header),
                        "rows": [[json_number(value) for value in row] for row in table.rows],
                    }
                    for table in outcome.tables
                ],
            }
            if part.draw is not None:
                save_figure(part.draw(self._interpretation, cell_results), self._out / part.name)
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
        atomic_write_text(
            self._out / RESULTS, json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        )
        atomic_write_text(self._out / MARKDOWN, markdown(results))
        atomic_write_text(self._out / HTML, html(results))
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


def source_hash() -> str:
    """Hash of the source code that computes the numbers."""
    digest = hashlib.sha256()
    for package in (cablebot_gym, cablebot_baselines):
        root = Path(package.__path__[0])
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _computed(
    parts: Sequence[Part],
    interpretation: Interpretation,
    workers: int,
    progress: Progress | None,
    say: Callable[[str], None],
) -> Iterator[tuple[Part, CellResults | str]]:
    """Yields each part with the results of its cells, or with the reason why the interpretation does not allow it."""
    waiting: dict[str, dict[str, str]] = {}
    cells: dict[str, Cell] = {}
    for part in parts:
        try:
            part_cells = part.cells(interpretation)
        except NoEquilibriumError as error:
            yield part, str(error)
            continue
        keys = {name: cell_key(cell) for name, cell in part_cells.items()}
        waiting[part.name] = keys
        cells |= {keys[name]: cell for name, cell in part_cells.items()}
    by_name = {part.name: part for part in parts}
    done: dict[str, Any] = {}

    def complete() -> Iterator[tuple[Part, CellResults | str]]:
        for name in [name for name, keys in waiting.items() if all(key in done for key in keys.values())]:
            if progress is not None:
                progress(f"drawing {name}", len(done), len(cells))
            yield by_name[name], _gathered(waiting.pop(name), done)

    yield from complete()  # parts without computations
    for key, value in run(cells, workers=workers, kind=_kind, say=say, returned=(NoEquilibriumError,)):
        done[key] = value
        if progress is not None:
            progress("computing", len(done), len(cells))
        yield from complete()


def _gathered(keys: Mapping[str, str], done: Mapping[str, Any]) -> CellResults | str:
    failed = [done[key] for key in keys.values() if isinstance(done[key], NoEquilibriumError)]
    return str(failed[0]) if failed else {name: done[key] for name, key in keys.items()}


def _kind(cell: Cell) -> tuple[Any, Any]:
    """Key of the compiled code that a cell requires: its function and its environment."""
    return cell.func, cell.keywords.get("env_id")
