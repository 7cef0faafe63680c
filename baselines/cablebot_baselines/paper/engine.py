"""Runs the parts of the reproduction, and writes what they found: figures, one results.json, one page."""

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
from cablebot_baselines.paper.page import html, markdown
from cablebot_baselines.paper.part import Cell, Found, Number, Part, cell_key
from cablebot_baselines.paper.readings import NoRobot, Readings
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.plotting.figures import DPI, import_matplotlib
from cablebot_gym.utils.files import usable_folder, write_text_whole, write_whole
from cablebot_gym.utils.workers import check_workers, run

RESULTS, MARKDOWN, HTML = "results.json", "reproduction.md", "reproduction.html"
"""Names of the files beside the figures."""

Progress = Callable[[str, int, int], None]
"""Called with what was done last, how many computations are done, and how many there are."""

_ERRATA = "../errata.md"
"""The page of misprints, seen from the project's own folder of results."""

_DIGITS = 10
"""Significant ones in results.json: what is left is rounding, which differs from machine to machine."""


def find_parts(names: Sequence[str]) -> tuple[Part, ...]:
    """The parts of these names in the page's order; all for none.

    Raises:
        ValueError: naming the known ones, if one is not known.
    """
    known = [part.name for part in PARTS]
    for name in names:
        if name not in known:
            raise ValueError(f"there is no part {name!r}; the parts are {', '.join(known)}")
    return tuple(part for part in PARTS if not names or part.name in names)


def reproduce(
    readings: Readings,
    out: Path,
    *,
    only: Sequence[str] = (),
    workers: int | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Runs parts and writes their figures, ``results.json`` and the page into a folder.

    Parts that the folder holds from before are kept until they are made anew, if they were made by the same code and
    under the same readings; ``only`` some parts are not put beside others. After an interrupt what is done is written,
    and ``only`` the rest can follow.

    Args:
        readings: how to read the paper.
        out: where to; made if it does not exist.
        only: names of parts; all for none.
        workers: processes; None for one per core.
        progress: called after every computation.
        say: gets what a user should know meanwhile, such as that a first compilation takes its time.

    Returns:
        What results.json holds.

    Raises:
        ValueError: if a part is not known, the folder cannot be written to or holds results of other readings or code
            beside which ``only`` some parts would stand, or ``workers`` is not positive.
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    parts = find_parts(only)
    workers = check_workers(workers)
    import_matplotlib()
    usable_folder(out)
    results = _Results(readings, out, alone=not only)
    try:
        for part, found in _computed(parts, readings, workers, progress, say or (lambda _: None)):
            results.add(part, found)
    finally:
        written = results.write()
    return written


def missing(out: Path, names: Sequence[str]) -> list[str]:
    """Which of these parts, or of all for none, the results in a folder lack."""
    held = json.loads((out / RESULTS).read_text(encoding="utf-8"))["missing"]
    return [name for name in held if not names or name in names]


class _Results:
    """What is known so far, and its files."""

    def __init__(self, readings: Readings, out: Path, *, alone: bool) -> None:
        self._readings, self._out = readings, out
        self._head = {"readings": asdict(readings), "versions": versions(), "source": source_hash()}
        self._numbers: dict[str, Number] = {}
        self._parts: dict[str, dict[str, Any]] = {}
        self._keep(alone)

    def _keep(self, alone: bool) -> None:
        """Takes over what an earlier run of the same code and readings left in the folder."""
        try:
            before = json.loads((self._out / RESULTS).read_text(encoding="utf-8"))
            same = all(before[name] == value for name, value in self._head.items())
            numbers, parts = dict(before["numbers"]), {part["name"]: part for part in before["parts"]}
        except (OSError, ValueError, KeyError, TypeError):
            return  # nothing there, or nothing that this command wrote
        if same:
            self._numbers, self._parts = numbers, parts
        elif not alone:
            raise ValueError(
                f"{str(self._out)!r} holds results of other readings or code, which these parts do not go with: choose "
                "another --out, or make all parts"
            )

    def add(self, part: Part, found: Found | str) -> None:
        """A part's outcome and figure; a string says why the readings do not allow it."""
        entry: dict[str, Any] = {"name": part.name, "title": part.title, "text": part.text}
        self._numbers = {key: value for key, value in self._numbers.items() if not key.startswith(f"{part.name}.")}
        if isinstance(found, str):
            entry |= {"figure": None, "tables": [], "impossible": found}
        else:
            outcome = part.outcome(self._readings, found)
            self._numbers |= {f"{part.name}.{key}": plain(value) for key, value in outcome.numbers.items()}
            entry |= {
                "figure": None if part.draw is None else part.name,
                "tables": [
                    {
                        "title": table.title,
                        "header": list(table.header),
                        "rows": [[plain(value) for value in row] for row in table.rows],
                    }
                    for table in outcome.tables
                ],
            }
            if part.draw is not None:
                save_figure(part.draw(self._readings, found), self._out / part.name)
        self._parts[part.name] = entry

    def write(self) -> dict[str, Any]:
        """results.json and the page, of the parts there are."""
        order = [part.name for part in PARTS]
        made = [name for name in order if name in self._parts]
        results: dict[str, Any] = self._head | {
            "command": command(self._readings, *(made if len(made) < len(order) else ())),
            "numbers": {
                key: self._numbers[key] for name in order for key in self._numbers if key.startswith(f"{name}.")
            },
            "parts": [self._parts[name] for name in made],
            "missing": [name for name in order if name not in self._parts],
        }
        if (self._out / _ERRATA).is_file():
            results["errata"] = _ERRATA
        impossible = {name: part["impossible"] for name, part in self._parts.items() if "impossible" in part}
        results["rows"] = rows(self._readings, results["numbers"], impossible)
        write_text_whole(self._out / RESULTS, json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
        write_text_whole(self._out / MARKDOWN, markdown(results))
        write_text_whole(self._out / HTML, html(results))
        return results


def save_figure(figure: Any, stem: Path) -> None:
    """Writes a figure as ``.png`` and ``.svg``, the same bytes each time."""
    from matplotlib import rc_context

    for suffix, keywords in ((".png", {"dpi": DPI}), (".svg", {"metadata": {"Date": None}})):
        with rc_context({"svg.hashsalt": stem.name}):
            write_whole(stem.with_suffix(suffix), partial(figure.savefig, format=suffix[1:], **keywords))


def plain(value: Any) -> Number:
    """A number as JSON has it: Python's own, infinities and NaN as None, rounded to what machines agree on."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    raise TypeError(f"results hold numbers, words and yes or no, not {value!r}")


def source_hash() -> str:
    """Of the code that makes the numbers."""
    digest = hashlib.sha256()
    for package in (cablebot_gym, cablebot_baselines):
        root = Path(package.__path__[0])
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _computed(
    parts: Sequence[Part],
    readings: Readings,
    workers: int,
    progress: Progress | None,
    say: Callable[[str], None],
) -> Iterator[tuple[Part, Found | str]]:
    """Each part as soon as its cells are done; a string in their place says why the readings do not allow it."""
    waiting: dict[str, dict[str, str]] = {}
    cells: dict[str, Cell] = {}
    for part in parts:
        try:
            mine = part.cells(readings)
        except NoRobot as error:
            yield part, str(error)
            continue
        keys = {name: cell_key(cell) for name, cell in mine.items()}
        waiting[part.name] = keys
        cells |= {keys[name]: cell for name, cell in mine.items()}
    by_name = {part.name: part for part in parts}
    done: dict[str, Any] = {}

    def complete() -> Iterator[tuple[Part, Found | str]]:
        for name in [name for name, keys in waiting.items() if all(key in done for key in keys.values())]:
            if progress is not None:
                progress(f"drawing {name}", len(done), len(cells))
            yield by_name[name], _gathered(waiting.pop(name), done)

    yield from complete()  # those that need no computation
    for key, value in run(cells, workers=workers, kind=_kind, say=say, returned=(NoRobot,)):
        done[key] = value
        if progress is not None:
            progress("computing", len(done), len(cells))
        yield from complete()


def _gathered(keys: Mapping[str, str], done: Mapping[str, Any]) -> Found | str:
    failed = [done[key] for key in keys.values() if isinstance(done[key], NoRobot)]
    return str(failed[0]) if failed else {name: done[key] for name, key in keys.items()}


def _kind(cell: Cell) -> tuple[Any, Any]:
    """What tells the compiled code that a cell needs: its function and its environment."""
    return cell.func, cell.keywords.get("env_id")
