"""Runs the parts of the reproduction and writes the figures, results.json and the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cablebot_gym.evaluation.batch import versions
from cablebot_gym.plotting.figures import import_matplotlib
from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.files import atomic_write, atomic_write_text, check_writable_dir
from cablebot_reproduction.findings import rows
from cablebot_reproduction.outcome import Number, Outcome
from cablebot_reproduction.page import markdown
from cablebot_reproduction.parts.claims import claims
from cablebot_reproduction.parts.equations import eq22, eq37
from cablebot_reproduction.parts.interpretations import interpretations
from cablebot_reproduction.parts.robust import fig8, fig9
from cablebot_reproduction.parts.saturation import fig10, fig11, fig12, fig13, fig14, fig15
from cablebot_reproduction.parts.scan import scan
from cablebot_reproduction.parts.sizes import sizes
from cablebot_reproduction.parts.tracking import fig5, fig6, fig7

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULTS = "results.json"
PAGE = "reproduction.md"
"""Names of the output files besides the figures."""

_FUNCTIONS = (
    *(sizes, fig5, fig6, fig7, fig8, fig9, fig10, fig11, fig12, fig13, fig14, fig15),
    *(eq37, eq22, claims, interpretations, scan),
)
PARTS: dict[str, Callable[[], Outcome]] = {part.__name__: part for part in _FUNCTIONS}
"""All parts of the page in their order."""

_DIGITS = 10
"""Significant digits in results.json. Further digits are rounding errors that differ between
machines."""


def run(
    out: str | Path,
    only: Sequence[str] = (),
    *,
    progress: Callable[[int, int, str], None] | None = None,
) -> dict[str, Any]:
    """Runs parts and writes their figures, ``results.json`` and the page to a folder.

    After each part the files contain all parts so far, so an interrupt keeps them.

    Args:
        out: output folder; it is created if it does not exist.
        only: names of parts; all parts if empty.
        progress: called before every part with the number of finished parts, their total number and
            a text.

    Returns:
        Contents of results.json.

    Raises:
        ValueError: if a part is unknown or the folder is not writable.
        ImportError: if matplotlib is missing; the message names the installation command.
    """
    for name in only:
        choice("part", name, PARTS)
    import_matplotlib()
    out = Path(out)
    check_writable_dir(out)
    names = [name for name in PARTS if not only or name in only]
    results: dict[str, Any] = {"versions": versions(), "numbers": {}, "parts": {}}
    for index, name in enumerate(names):
        if progress is not None:
            progress(index, len(names), name)
        outcome = PARTS[name]()
        for key, value in outcome.numbers.items():
            results["numbers"][f"{name}.{key}"] = json_number(value)
        tables = []
        for table in outcome.tables:
            cells = [list(map(json_number, row)) for row in table.rows]
            tables.append(asdict(table) | {"rows": cells})
        results["parts"][name] = {"figure": outcome.figure is not None, "tables": tables}
        if outcome.figure is not None:
            save_figure(outcome.figure, out / f"{name}.svg")
        results["rows"] = list(rows(results["numbers"]))
        text = json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False)
        atomic_write_text(out / RESULTS, f"{text}\n")
        page = markdown(results, has_errata=(out / "errata.md").exists())
        atomic_write_text(out / PAGE, page)
    return results


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure with reproducible bytes."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": Path(path).stem}):
        write = partial(figure.savefig, format="svg", metadata={"Date": None})
        atomic_write(path, write)


def json_number(value: Any) -> Number:
    """A value of Python's types, rounded to the digits on which machines agree."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        value = float(f"{value:.{_DIGITS}g}")
    number: Number = value
    return number
