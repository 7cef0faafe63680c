"""Records the episodes of many rows and stores each as soon as it is finished."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

from cablebot_gym.benchmark.rows import Row, canonical
from cablebot_gym.report.replay import Replay, best_replays, replays
from cablebot_gym.utils import workers as processes
from cablebot_gym.utils.files import atomic_write_text, read_cached

FOLDER = "episodes"
"""Name of the folder of the episodes, next to the results."""

ReplayResult = list[Replay] | str
"""The episodes of a row, or an error message."""


def record_all(
    queries: Mapping[str, Row], folder: Path, *, workers: int, say: Callable[[str], None]
) -> Iterator[tuple[str, ReplayResult]]:
    """Yields each key with its episodes: stored ones first, then the others as they are recorded.

    Args:
        queries: rows by their keys.
        folder: folder of the stored episodes, one file per row. Broken files and files of
            different code are replaced.
        workers: number of parallel processes.
        say: called with one-sentence messages for the user.
    """
    jobs = {}
    for key, row in queries.items():
        stored = _read(_path(folder, row))
        if stored is None:
            jobs[key] = partial(record, row)
        else:
            yield key, stored
    for key, result in processes.run(
        jobs, workers=workers, say=say, returned=(processes.WorkerDied,)
    ):
        if isinstance(result, processes.WorkerDied):
            result = str(result)
        if not isinstance(result, str):
            _write(_path(folder, queries[key]), result)
        yield key, result


def record(row: Row) -> ReplayResult:
    """The episodes of a row. An exception becomes an error message; it does not stop the report."""
    try:
        if row.measure == "best-known":
            return best_replays(row)
        return replays(row)
    except Exception as error:
        return f"No episode: {' '.join(str(error).split())}"


def _path(folder: Path, row: Row) -> Path:
    content = canonical([row.key, row.result.get("payload"), row.present_code])
    digest = hashlib.sha256(content.encode()).hexdigest()
    stem = re.sub(r"[^A-Za-z0-9.]+", "-", str(row)).strip("-.").lower()[:100]
    return folder / f"{stem}-{digest[:16]}.json"


def _read(path: Path) -> list[Replay] | None:
    return read_cached(path, lambda content: [Replay(**data) for data in json.loads(content)])


def _write(path: Path, episodes: list[Replay]) -> None:
    text = json.dumps([replay.to_dict() for replay in episodes], allow_nan=False)
    atomic_write_text(path, text)
