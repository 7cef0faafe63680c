"""Runs jobs, such as the rows of the benchmark, on local processes or on a Ray cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

from cablebot_gym.benchmark.rows import Row, compute, failed, jobs
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils import workers as processes
from cablebot_gym.utils.console import Progress

_FIRST = {"optimum": 1e12, "best-known": 1e11, "drawn": 1e10}
"""Costs in episodes of what no policy changes: drawn robots read the optima from the disk cache, and
policies come last."""

Job = Callable[[], Any]
"""A computation that runs in any process: a ``functools.partial`` of a module-level function, which can
be pickled."""

Backend = Callable[[Mapping[str, Job]], Iterator[tuple[str, Any]]]
"""Executes jobs by key: yields keys and results in order of completion, with a
:class:`~cablebot_gym.utils.workers.WorkerDied` in place of a lost one."""


def local(workers: int) -> Backend:
    """A backend of ``workers`` processes on this machine."""
    return partial(processes.run, workers=workers)


def run_rows(
    rows: Sequence[Row],
    store: Store,
    backend: Backend,
    progress: Progress,
) -> None:
    """Computes the rows that are due, and adds them to the store.

    Jobs with the longest computations start first, to balance the workers. Computing times are
    measured last, one after the other in this process.
    """
    due = [row for row in rows if store.find(row) is None]
    groups = sorted(jobs(due), key=_cost, reverse=True)
    computations: dict[str, Job] = {}
    timings: dict[str, Job] = {}
    for index, group in enumerate(groups):
        kind = timings if group[0].measure == "time" else computations
        kind[str(index)] = partial(compute, group)
    done = len(rows) - len(due)
    progress(done, len(rows))
    # the timings come when no other job runs
    results = chain(backend(computations), local(1)(timings))
    for key, computed in results:
        group = groups[int(key)]
        store.add(_checked(group, computed))
        done += len(group)
        progress(done, len(rows))


def _checked(group: Sequence[Row], computed: Any) -> list[Row]:
    """The rows that a worker computed; failed ones if it died or has different code."""
    if isinstance(computed, processes.WorkerDied):
        return [failed(row, str(computed)) for row in group]
    if computed[0].code != group[0].present_code:
        reason = "a worker computed it with different code; install the same version of the code on every machine"
        return [failed(row, reason) for row in group]
    rows: list[Row] = computed
    return rows


def _cost(group: Sequence[Row]) -> float:
    """Number of episodes at each payload, or the place among :data:`_FIRST`."""
    row = group[0]
    return _FIRST.get(row.measure, len(group) * (row.conditions.draws or 1))
