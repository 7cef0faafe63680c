"""Records of the benchmark: a cell and its result."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cablebot_gym.benchmark.cells import Cell, SurveyCell, canonical, cell_from_dict
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.foreign import foreign_object


@dataclass(frozen=True, kw_only=True)
class Record:
    """A cell and its result."""

    cell: Cell
    """The cell."""
    source: str
    """Hash of the code that computed the result."""
    versions: Mapping[str, str]
    """Versions of Python and of the packages used."""
    result: Mapping[str, Any]
    """JSON-able result, or an ``error`` message if the computation failed. It is reproducible."""
    seconds: float
    """Wall time of the computation [s]."""
    final: bool = True
    """Whether a retry gives the same result. False if a package, a file or memory was missing or a
    process died."""

    @property
    def error(self) -> str | None:
        """Error message of a failed computation; None if it succeeded."""
        return self.result.get("error")


def compute(cell: Cell) -> Record:
    """Computes a cell. An exception becomes the error of the record; it does not stop the
    benchmark."""
    start = time.perf_counter()
    final = True
    try:
        result = json.loads(canonical(cell.compute()))
    except Exception as error:
        result = {"error": _one_line(error)}
        final = not isinstance(error, (ImportError, OSError, MemoryError))
    return Record(
        cell=cell,
        source=cell.source,
        versions=versions(),
        result=result,
        seconds=time.perf_counter() - start,
        final=final,
    )


def single_records(records: Sequence[Record]) -> list[Record]:
    """The records with a record for each motion in place of that of a survey."""
    singles = []
    for record in records:
        if not isinstance(record.cell, SurveyCell):
            singles.append(record)
            continue
        parts = record.cell.parts
        results = record.cell.part_results(record.result)
        for part, result in zip(parts, results, strict=True):
            singles.append(replace(record, cell=part, result=result))
    return singles


def failed_record(cell: Cell, reason: str) -> Record:
    """A record that is not final, with ``reason`` as its error: the next run computes the cell
    again."""
    return Record(
        cell=cell,
        source=cell.source,
        versions=versions(),
        result={"error": reason},
        seconds=0.0,
        final=False,
    )


def record_from_dict(data: Any) -> Record:
    """A stored record.

    Raises:
        KeyError, TypeError, ValueError: if ``data`` are something else.
    """
    fields = foreign_object("a record", data)
    record = Record(
        cell=cell_from_dict(foreign_object("the conditions of a cell", fields["cell"])),
        source=str(fields["source"]),
        versions=foreign_object("versions", fields["versions"]),
        result=foreign_object("a result", fields["result"]),
        seconds=number("seconds", fields["seconds"], least=0, unit="s"),
        final=fields.get("final", True) is True,
    )
    single_records([record])  # raises if the result of a survey is not that of its motions
    return record


def _one_line(error: Exception) -> str:
    """The message of an exception in one line, with the type where the message alone is unclear."""
    text = " ".join(str(error).split())
    if isinstance(error, (ValueError, ImportError, RuntimeError)):
        return text
    return f"{type(error).__name__}: {text}"
