"""Records the episodes of many cells and stores each as soon as it is finished."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, PolicyCell, canonical
from cablebot_gym.report.replay import Replay, batch_key, best_replays, replays
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
    groups: dict[str, list[str]] = {}
    for key, (cell, payload) in queries.items():
        stored = _read(_path(folder, cell, payload))
        if stored is not None:
            yield key, stored
        else:
            group = batch_key(cell) if isinstance(cell, PolicyCell) else key
            groups.setdefault(group, []).append(key)
    jobs = {
        group: partial(record_batch, [queries[key] for key in keys])
        for group, keys in groups.items()
    }
    returned = (processes.WorkerDied,)
    for group, results in processes.run(
        jobs, workers=workers, kind=_kind, say=say, returned=returned
    ):
        for index, key in enumerate(groups[group]):
            if isinstance(results, processes.WorkerDied):
                yield key, str(results)
                continue
            if not isinstance(results[index], str):
                _write(_path(folder, *queries[key]), results[index])
            yield key, results[index]


def record_batch(queries: Sequence[ReplayQuery]) -> list[ReplayResult]:
    """The episodes of cells that share a batch. An exception becomes an error message; it does not
    stop the report."""
    try:
        first = queries[0][0]
        if isinstance(first, BestKnownCell):
            return [best_replays(first)]
        return list(
            replays([(cell, payload) for cell, payload in queries if isinstance(cell, PolicyCell)])
        )
    except Exception as error:
        if len(queries) > 1:  # an error in one cell must not hide the others
            return [result for query in queries for result in record_batch([query])]
        return [f"No episode: {' '.join(str(error).split())}"]


def _kind(job: partial[list[ReplayResult]]) -> str:
    """Jobs of one kind need the same compiled code."""
    cell: Cell = job.args[0][0][0]
    return cell.env_id


def _path(folder: Path, cell: Cell, payload: float | None) -> Path:
    digest = hashlib.sha256(canonical([cell.to_dict(), payload, cell.source]).encode()).hexdigest()[
        :16
    ]
    return folder / f"{cell.stem}-{digest}.json"


def _read(path: Path) -> list[Replay] | None:
    return read_cached(path, lambda content: [Replay(**data) for data in json.loads(content)])


def _write(path: Path, episodes: list[Replay]) -> None:
    text = json.dumps([replay.to_dict() for replay in episodes], allow_nan=False)
    atomic_write_text(path, text)
