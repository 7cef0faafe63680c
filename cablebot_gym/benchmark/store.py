"""A folder of results with one file per finished cell."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import Cell, canonical
from cablebot_gym.benchmark.records import Record, record_from_dict
from cablebot_gym.utils.files import atomic_write_text, read_text
from cablebot_gym.utils.foreign import foreign_json, foreign_object

FOLDER = "cells"
"""Name of the folder of the records, next to the tables."""


class Store:
    """Records in a folder.

    A file name consists of a readable stem, a hash of the cell and the hash of the code that
    computed it. Results of different code versions therefore coexist.

    Args:
        out: folder of the benchmark's results. The files are in its subfolder ``cells``.
        say: called with one sentence for each unusable file.
    """

    def __init__(self, out: Path, *, say: Callable[[str], None]) -> None:
        self._folder = out / FOLDER
        self._say = say

    def find(self, cell: Cell) -> Record | None:
        """The record of a cell; None if it is missing, broken or computed by different code."""
        current = self._path(cell, cell.source)
        if not current.exists():
            return None
        record = self._read(current, cell)
        if record is None or record.source != cell.source:
            return None
        return record

    def add(self, record: Record) -> None:
        """Writes a record if it is final."""
        if not record.final:
            return
        data: dict[str, Any] = {
            "cell": record.cell.to_dict(),
            "source": record.source,
            "versions": dict(record.versions),
            "result": dict(record.result),
            "seconds": round(record.seconds, 3),
        }
        text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        atomic_write_text(self._path(record.cell, record.source), text)

    def _path(self, cell: Cell, source: str) -> Path:
        digest = hashlib.sha256(canonical(cell.to_dict()).encode()).hexdigest()
        return self._folder / f"{cell.stem}-{digest[:12]}-{source}.json"

    def _read(self, path: Path, cell: Cell) -> Record | None:
        """The record in a file; None, with a message, if the file is not as it was written for the
        cell."""
        try:
            data = foreign_object("a record", foreign_json(read_text(path)))
            record = record_from_dict(data)
            if record.cell.key == cell.key:
                return record
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            pass
        self._say(f"{path} is damaged; its cell is computed again")
        return None
