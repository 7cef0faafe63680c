"""Records the episodes of many cells and stores each as soon as it is finished."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, canonical
from cablebot_gym.report.replay import Replay, best_replays, replays
from cablebot_gym.utils import workers as processes
from cablebot_gym.utils.files import atomic_write_text

FOLDER = "episodes"
"""Name of the folder of the episodes, next to the results."""

ReplayQuery = tuple[Cell, float | None]
"""A cell and its DLCC [kg]; None if the policy fails unloaded."""

ReplayResult = list[Replay] | str
"""The episodes of a cell, or an error message."""


def record_all(
    queries: Mapping[str, ReplayQuery], folder: Path, *, workers: int, say: Callable[[str], None]
) -> Iterator[tuple[str, ReplayResult]]:
    """Yields each key with its episodes: stored ones first, then the others as they are recorded.

    Args:
        queries: cells and payloads by key of the cell.
        folder: folder of the stored episodes, one file per cell. Broken files and files of different code are replaced.
        workers: number of parallel processes.
        say: called with one-sentence messages for the user.
    """
    pending: dict[str, partial[ReplayResult]] = {}
    for key, (cell, payload) in queries.items():
        stored = _read(_path(folder, cell, payload))
        if stored is None:
            pending[key] = partial(_record, cell, payload)
        else:
            yield key, stored
    returned = (processes.WorkerDied,)
    for key, result in processes.run(pending, workers=workers, kind=_kind, say=say, returned=returned):
        if isinstance(result, processes.WorkerDied):
            yield key, str(result)
            continue
        if not isinstance(result, str):
            cell, payload = queries[key]
            _write(_path(folder, cell, payload), result)
        yield key, result


def _record(cell: Cell, payload: float | None) -> ReplayResult:
    """The episodes of a cell. An exception becomes an error message; it does not stop the report."""
    try:
        return best_replays(cell) if isinstance(cell, BestKnownCell) else replays(cell, payload)
    except Exception as error:
        return f"No episode: {' '.join(str(error).split())}"


def _kind(task: partial[ReplayResult]) -> str:
    cell: Cell = task.args[0]
    return cell.env_id


def _path(folder: Path, cell: Cell, payload: float | None) -> Path:
    digest = hashlib.sha256(canonical([cell.to_dict(), payload, cell.source]).encode()).hexdigest()[:16]
    return folder / f"{cell.stem}-{digest}.json"


def _read(path: Path) -> list[Replay] | None:
    try:
        return [_replay(data) for data in json.loads(path.read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _replay(data: Mapping[str, Any]) -> Replay:
    return Replay(**{**data, "low": tuple(data["low"]), "high": tuple(data["high"])})


def _write(path: Path, episodes: list[Replay]) -> None:
    text = json.dumps([replay.to_dict() for replay in episodes], allow_nan=False)
    atomic_write_text(path, text)
