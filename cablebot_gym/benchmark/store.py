"""A folder of results, one file for each finished cell: nothing that is done gets lost, nothing broken gets used."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import Cell, Record, canonical, cell_from
from cablebot_gym.utils.files import write_text_whole

FOLDER = "cells"
"""Name of the folder beside the tables."""


class Store:
    """Records in a folder.

    The name of a file holds what was asked (a readable stem, and a hash of all of it) and which code answered: results
    of other code stay beside each other.

    Args:
        out: folder of the benchmark's results; the files are in its folder ``cells``.
        say: gets a sentence for each file that cannot be used.
        any_source: take results of other code where there is none of this one.
    """

    def __init__(self, out: Path, *, say: Callable[[str], None], any_source: bool = False) -> None:
        self._folder, self._say, self._any_source = out / FOLDER, say, any_source
        self.foreign = 0
        """How many of the cells that were looked for are there by other code alone."""

    def find(self, cell: Cell) -> Record | None:
        """The finished cell, or None: it is not there, broken, or of other code."""
        own = self._path(cell, cell.source)
        if own.exists() and (record := self._read(own, cell)) is not None and record.source == cell.source:
            return record
        others = [path for path in self._folder.glob(f"{cell.stem}-{_short(cell.key)}-*.json") if path != own]
        if not others:
            return None
        self.foreign += 1
        if not self._any_source:
            return None
        newest = sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)
        return next((record for path in newest if (record := self._read(path, cell)) is not None), None)

    def add(self, record: Record) -> None:
        """Keeps a record that is final."""
        if not record.final:
            return
        data: dict[str, Any] = {
            "cell": record.cell.to_dict(),
            "source": record.source,
            "versions": dict(record.versions),
            "result": dict(record.result),
            "seconds": round(record.seconds, 3),
        }
        text = json.dumps(data | {"checksum": _checksum(data)}, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        path = self._path(record.cell, record.source)
        write_text_whole(path, text)

    def _path(self, cell: Cell, source: str) -> Path:
        return self._folder / f"{cell.stem}-{_short(cell.key)}-{source}.json"

    def _read(self, path: Path, cell: Cell) -> Record | None:
        """The record in a file if it is whole and the cell's, else None, and says why."""
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            checksum = data.pop("checksum")
            record = Record(**(data | {"cell": cell_from(data["cell"])}))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            self._say(f"{path} is broken ({type(error).__name__}): its cell is computed anew")
            return None
        if checksum != _checksum(data):
            self._say(f"{path} was changed after it was written: its cell is computed anew")
            return None
        if record.cell.key != cell.key:
            self._say(f"{path} holds another cell than its name says: its cell is computed anew")
            return None
        return record


def _checksum(data: dict[str, Any]) -> str:
    return hashlib.sha256(canonical(data).encode()).hexdigest()


def _short(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()[:12]
