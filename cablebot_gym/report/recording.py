"""Records the episodes of many cells, and keeps each as it comes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import BestCell, Cell, canonical
from cablebot_gym.report.replay import Replay, best_replays, replays
from cablebot_gym.utils import workers as processes
from cablebot_gym.utils.files import write_text_whole

FOLDER = "episodes"
"""Name of the folder beside the results."""

Asked = tuple[Cell, float | None]
"""A cell, and the true payload that it carries [kg]."""

Seen = list[Replay] | str
"""The episodes of a cell, or a sentence that says why there are none."""


def record_all(
    asked: Mapping[str, Asked], folder: Path, *, workers: int, say: Callable[[str], None]
) -> Iterator[tuple[str, Seen]]:
    """Episodes by key as they come, those first that the folder has.

    Args:
        asked: cells and payloads by the cell's key.
        folder: keeps what is recorded, one file each; a broken file, or one of other code, is recorded anew.
        workers: processes at the same time.
        say: gets what a user should know meanwhile, one sentence.
    """
    open_: dict[str, partial[Seen]] = {}
    for key, (cell, payload) in asked.items():
        found = _read(_path(folder, cell, payload))
        if found is None:
            open_[key] = partial(_record, cell, payload)
        else:
            yield key, found
    returned = (processes.WorkerDied,)
    for key, seen in processes.run(open_, workers=workers, kind=_kind, say=say, returned=returned):
        if isinstance(seen, processes.WorkerDied):
            yield key, str(seen)
            continue
        if not isinstance(seen, str):
            cell, payload = asked[key]
            _write(_path(folder, cell, payload), seen)
        yield key, seen


def _record(cell: Cell, payload: float | None) -> Seen:
    """Whatever goes wrong is the cell's: it does not end the report."""
    try:
        return best_replays(cell) if isinstance(cell, BestCell) else replays(cell, payload)
    except Exception as error:
        return f"No episode: {' '.join(str(error).split())}"


def _kind(task: partial[Seen]) -> str:
    cell: Cell = task.args[0]
    return cell.env_id


def _path(folder: Path, cell: Cell, payload: float | None) -> Path:
    asked = hashlib.sha256(canonical([cell.to_dict(), payload, cell.source]).encode()).hexdigest()[:16]
    return folder / f"{cell.stem}-{asked}.json"


def _read(path: Path) -> list[Replay] | None:
    try:
        return [_replay(data) for data in json.loads(path.read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _replay(data: Mapping[str, Any]) -> Replay:
    return Replay(**{**data, "low": tuple(data["low"]), "high": tuple(data["high"])})


def _write(path: Path, seen: list[Replay]) -> None:
    text = json.dumps([replay.to_dict() for replay in seen], allow_nan=False)
    write_text_whole(path, text)
