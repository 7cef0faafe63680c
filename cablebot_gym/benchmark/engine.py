"""Computes the unfinished cells on local processes or on a Ray cluster and stores each result as it arrives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Protocol

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, Record, compute, failed_record
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils import workers as processes

MessageCallback = Callable[[str], None]
"""Called with one-sentence messages for the user."""

Progress = Callable[[int, int], None]
"""Called with the number of finished cells and the total number of cells."""

CellTask = partial[Record]
"""The pending computation of a cell."""


class Backend(Protocol):
    """Executes cell tasks."""

    def __call__(
        self, tasks: Mapping[str, CellTask], say: MessageCallback
    ) -> Iterator[tuple[str, Record | processes.WorkerDied]]:
        """Yields each key with its record, or with the reason why its process died, in order of completion."""


def local(workers: int) -> Backend:
    """A backend of ``workers`` processes on this machine."""

    def run(tasks: Mapping[str, CellTask], say: MessageCallback) -> Iterator[tuple[str, Any]]:
        return processes.run(tasks, workers=workers, kind=_kind, say=say, returned=(processes.WorkerDied,))

    return run


def run_cells(
    cells: Mapping[str, Cell], store: Store, backend: Backend, progress: Progress, say: MessageCallback
) -> list[Record]:
    """The records of all cells, in the order of ``cells``. Cells found in the store are not computed again."""
    done = {key: record for key, cell in cells.items() if (record := store.find(cell)) is not None}
    pending = {key: partial(compute, cell) for key, cell in _longest_first(cells) if key not in done}
    progress(len(done), len(cells))
    for key, outcome in backend(pending, say):
        record = failed_record(cells[key], str(outcome)) if isinstance(outcome, processes.WorkerDied) else outcome
        if record.source != cells[key].source:
            reason = "a worker computed it with different code; install the same version of the code on every machine"
            record = failed_record(cells[key], reason)
        store.add(record)
        done[key] = record
        progress(len(done), len(cells))
    return [done[key] for key in cells]


def _longest_first(cells: Mapping[str, Cell]) -> list[tuple[str, Cell]]:
    """Cells by decreasing cost, to balance the workers: best known payloads first, then policies by number of draws."""

    def cost(item: tuple[str, Cell]) -> float:
        return float("inf") if isinstance(item[1], BestKnownCell) else item[1].draws

    return sorted(cells.items(), key=cost, reverse=True)


def _kind(task: CellTask) -> tuple[type[Cell], str]:
    """Group of tasks that need the same compiled code."""
    cell: Cell = task.args[0]
    return type(cell), cell.env_id
