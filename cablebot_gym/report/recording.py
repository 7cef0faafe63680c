"""Records the episodes of many cells and stores each as soon as it is finished."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import cast

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, PolicyCell, canonical
from cablebot_gym.report.replay import Replay, best_replays, replays
from cablebot_gym.utils import workers as processes
from cablebot_gym.utils.files import atomic_write_text, read_cached

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
        folder: folder of the stored episodes, one file per cell. Broken files and files of
            different code are replaced.
        workers: number of parallel processes.
        say: called with one-sentence messages for the user.
    """
    jobs = {}
    for key, (cell, payload) in queries.items():
        stored = _read(_path(folder, cell, payload))
        if stored is None:
            jobs[key] = partial(record, cell, payload)
        else:
            yield key, stored
    for key, result in processes.run(
        jobs,
        workers=workers,
        say=say,
        returned=(processes.WorkerDied,),
    ):
        if isinstance(result, processes.WorkerDied):
            result = str(result)
        if not isinstance(result, str):
            _write(_path(folder, *queries[key]), result)
        yield key, result


def record(cell: Cell, payload: float | None) -> ReplayResult:
    """The episodes of a cell. An exception becomes an error message; it does not stop the
    report."""
    try:
        if isinstance(cell, BestKnownCell):
            return best_replays(cell)
        return replays(cast(PolicyCell, cell), payload)
    except Exception as error:
        return f"No episode: {' '.join(str(error).split())}"


def _path(folder: Path, cell: Cell, payload: float | None) -> Path:
    content = canonical([cell.to_dict(), payload, cell.source])
    digest = hashlib.sha256(content.encode()).hexdigest()
    return folder / f"{cell.stem}-{digest[:16]}.json"


def _read(path: Path) -> list[Replay] | None:
    return read_cached(path, lambda content: [Replay(**data) for data in json.loads(content)])


def _write(path: Path, episodes: list[Replay]) -> None:
    text = json.dumps([replay.to_dict() for replay in episodes], allow_nan=False)
    atomic_write_text(path, text)
