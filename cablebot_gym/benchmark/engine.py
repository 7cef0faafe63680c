"""Runs jobs, such as the cells of the benchmark, on local processes or on a Ray cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from cablebot_gym.benchmark.cells import Cell, DrawnCell, PolicyCell, SurveyCell, TimingCell
from cablebot_gym.benchmark.records import Record, compute, failed_record
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils import workers as processes

_AFTER_BEST_KNOWN = 1e9
"""Cost of a drawn robot in episodes: it starts after the nominal ones, whose results it reads from the
disk cache, and before all policies."""

MessageCallback = Callable[[str], None]
"""Called with one-sentence messages for the user."""

Progress = Callable[[int, int], None]
"""Called with the number of finished jobs and the total number of jobs."""


Job = Callable[[], Any]
"""A computation that runs in any process: a ``functools.partial`` of a module-level function, which can
be pickled."""

Backend = Callable[
    [Mapping[str, Job], MessageCallback, tuple[type[Exception], ...]], Iterator[tuple[str, Any]]
]
"""Executes jobs: yields keys and results in order of completion. Called with the jobs by key, a
function for messages, and the types of exceptions that are results; others are raised."""


def local(workers: int) -> Backend:
    """A backend of ``workers`` processes on this machine."""

    def run(
        jobs: Mapping[str, Job], say: MessageCallback, returned: tuple[type[Exception], ...]
    ) -> Iterator[Any]:
        return processes.run(jobs, workers=workers, say=say, returned=returned)

    return run


def run_cells(
    cells: Mapping[str, Cell],
    store: Store,
    backend: Backend,
    progress: Progress,
    say: MessageCallback,
) -> list[Record]:
    """The records of all cells, in the order of ``cells``. Cells found in the store are not
    computed again.

    Cells with the longest computations start first, to balance the workers. Computing times are
    measured last, one after the other in this process.
    """
    done = {}
    pending = []
    for key, cell in cells.items():
        record = store.find(cell)
        if record is None:
            pending.append(cell)
        else:
            done[key] = record
    jobs: dict[str, Job] = {}
    timings: dict[str, Job] = {}
    for cell in sorted(pending, key=_cost, reverse=True):
        group = timings if isinstance(cell, TimingCell) else jobs
        group[cell.key] = partial(compute, cell)
    progress(len(done), len(cells))
    for key, record in _computed(jobs, timings, backend, say):
        if isinstance(record, processes.WorkerDied):
            record = failed_record(cells[key], str(record))
        elif record.source != cells[key].source:
            reason = "a worker computed it with different code; install the same version of the code on every machine"
            record = failed_record(cells[key], reason)
        store.add(record)
        done[key] = record
        progress(len(done), len(cells))
    return [done[key] for key in cells]


def _computed(
    jobs: Mapping[str, Job], timings: Mapping[str, Job], backend: Backend, say: MessageCallback
) -> Iterator[tuple[str, Any]]:
    """Key and record of each job, or why its process died; the timings come when no other job
    runs."""
    died = (processes.WorkerDied,)
    yield from backend(jobs, say, died)
    yield from local(1)(timings, say, died)


def _cost(cell: Cell) -> float:
    """Number of episodes at each payload; best known payloads take longest."""
    if isinstance(cell, SurveyCell):
        return cell.draws * len(cell.parts)
    if isinstance(cell, DrawnCell):
        return _AFTER_BEST_KNOWN
    return cell.draws if isinstance(cell, PolicyCell) else float("inf")
