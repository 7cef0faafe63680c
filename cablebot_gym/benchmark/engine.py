"""Runs the cells that are not done yet, on this machine's cores or on a Ray cluster, and keeps each as it comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Protocol

from cablebot_gym.benchmark.cells import BestCell, Cell, Record, compute, failed
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils import workers as processes

Say = Callable[[str], None]
"""Gets what a user should know meanwhile, one sentence."""

Progress = Callable[[int, int], None]
"""Called with the cells done and the cells there are."""

Task = partial[Record]
"""A cell to be computed."""


class Backend(Protocol):
    """Where the cells are computed."""

    def __call__(self, tasks: Mapping[str, Task], say: Say) -> Iterator[tuple[str, Record | processes.WorkerDied]]:
        """Records by key as they come, or how their process died."""


def local(workers: int) -> Backend:
    """Processes of this machine, as many as ``workers``."""

    def run(tasks: Mapping[str, Task], say: Say) -> Iterator[tuple[str, Any]]:
        return processes.run(tasks, workers=workers, kind=_kind, say=say, returned=(processes.WorkerDied,))

    return run


def run_cells(cells: Mapping[str, Cell], store: Store, backend: Backend, progress: Progress, say: Say) -> list[Record]:
    """A record of each cell, in their order; what the store has is not computed again."""
    done = {key: record for key, cell in cells.items() if (record := store.find(cell)) is not None}
    open_ = {key: partial(compute, cell) for key, cell in _longest_first(cells) if key not in done}
    progress(len(done), len(cells))
    for key, outcome in backend(open_, say):
        record = failed(cells[key], str(outcome)) if isinstance(outcome, processes.WorkerDied) else outcome
        if record.source != cells[key].source:
            why = "it was computed by other code than this process has: install the same code on every machine"
            record = failed(cells[key], why)
        store.add(record)
        done[key] = record
        progress(len(done), len(cells))
    return [done[key] for key in cells]


def _longest_first(cells: Mapping[str, Cell]) -> list[tuple[str, Cell]]:
    """So that no core waits for another at the end: searches for the best, then many draws, then few."""

    def cost(item: tuple[str, Cell]) -> float:
        return float("inf") if isinstance(item[1], BestCell) else item[1].draws

    return sorted(cells.items(), key=cost, reverse=True)


def _kind(task: Task) -> tuple[type[Cell], str]:
    """Cells of one kind need the same compiled code."""
    cell: Cell = task.args[0]
    return type(cell), cell.env_id
