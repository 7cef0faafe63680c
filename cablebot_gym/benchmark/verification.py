"""Confirms uncertain payloads of stored results with fresh draws, and recomputes rows."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil

from cablebot_gym.benchmark.cells import PolicyCell, Record, compute
from cablebot_gym.benchmark.engine import Backend, Job, MessageCallback, run_jobs

KEPT = 0.9
"""Least fraction of the cells whose success rate is at least the promised probability. A 95/95
tolerance bound misses the probability in one cell of 20, and the measured rate scatters about the
true one."""

SLACK = 0.02
"""Largest shortfall of the success rate of any cell."""


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """Success rate of a stored payload in fresh draws."""

    cell: PolicyCell
    """Cell of the payload."""
    payload: float
    """Promised payload [kg]."""
    success_rate: float
    """Fraction of the fresh draws that carry it."""

    @property
    def kept(self) -> bool:
        """Whether the success rate is at least that of the promise."""
        return self.success_rate >= self.cell.probability

    def __str__(self) -> str:
        cell = self.cell
        conditions = ", ".join(
            [
                cell.env_id,
                str(cell.trajectory["name"]),
                cell.policy,
                cell.payload_model,
                str(cell.uncertainty),
            ]
        )
        promise = f"{self.payload:.3f} kg in at least {cell.probability:.0%} of all draws"
        return f"{conditions}: promised {promise}, carried in {self.success_rate:.1%}"


def confirm(
    records: Sequence[Record],
    backend: Backend,
    *,
    cells: int,
    draws: int,
    seed: int,
    say: MessageCallback,
) -> Iterator[Confirmation]:
    """Tries payloads of randomly chosen uncertain cells in fresh draws, which the cells share.

    Args:
        records: stored records.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        cells: number of cells; all cells if there are fewer.
        draws: number of fresh draws.
        seed: seed of the choice and of the draws.
        say: called with messages of the workers.

    Raises:
        ValueError: if there is no cell with an uncertain payload.
    """
    promises: dict[str, tuple[PolicyCell, float]] = {}
    for record in records:
        payload = record.result.get("payload")
        if isinstance(record.cell, PolicyCell) and record.result.get("assured") and payload:
            promises[record.cell.key] = (record.cell, float(payload))
    if not promises:
        raise ValueError(
            "the results have no payload under uncertainty; choose a suite with uncertain columns"
        )
    sample = random.Random(seed).sample(sorted(promises), min(cells, len(promises)))
    jobs = []
    for key in sample:
        cell, payload = promises[key]
        compute = partial(cell.success_rate, payload, draws, seed)
        jobs.append(Job(key=key, compute=compute, kind=(PolicyCell, cell.env_id)))
    for key, rate in run_jobs(jobs, backend, say=say):
        cell, payload = promises[key]
        yield Confirmation(cell=cell, payload=payload, success_rate=rate)


def broken(confirmations: Sequence[Confirmation]) -> str:
    """One sentence if the promises are broken; empty if they hold."""
    required = ceil(KEPT * len(confirmations))
    count = sum(confirmation.kept for confirmation in confirmations)
    if count < required:
        return (
            f"only {count} of {len(confirmations)} payloads keep their promise; "
            f"at least {required} have to"
        )
    for confirmation in confirmations:
        if confirmation.success_rate < confirmation.cell.probability - SLACK:
            return f"a success rate is more than {SLACK:.0%} below the promise: {confirmation}"
    return ""


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """A stored payload and the payload of the same cell that was computed again."""

    cell: PolicyCell
    """The cell."""
    stored: float | None
    """Stored payload [kg]; None if the policy fails unloaded or raised an error."""
    computed: float | None
    """Payload that was computed again [kg]."""
    resolution: float
    """Resolution of the search [kg]."""

    @property
    def equal(self) -> bool:
        """Whether both payloads are equal up to the resolution: rounding differs between
        machines."""
        if self.stored is None or self.computed is None:
            return self.stored == self.computed
        return abs(self.stored - self.computed) <= self.resolution

    def __str__(self) -> str:
        payloads = []
        for payload in (self.stored, self.computed):
            payloads.append("none" if payload is None else f"{payload:.3f} kg")
        return f"{self.cell.stem}: stored {payloads[0]}, computed {payloads[1]}"


def reproduce(
    records: Sequence[Record],
    policies: Sequence[str],
    env_ids: Sequence[str],
    backend: Backend,
    *,
    say: MessageCallback,
) -> Iterator[Reproduction]:
    """Computes the cells of rows of the tables again, with their stored seeds.

    Args:
        records: stored records.
        policies: policies of the rows.
        env_ids: environments of the rows; all of them if empty.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        say: called with messages of the workers.

    Raises:
        ValueError: if there are no such cells.
    """
    rows: dict[str, Record] = {}
    jobs = []
    for record in records:
        cell = record.cell
        if not isinstance(cell, PolicyCell) or cell.policy not in policies:
            continue
        if not env_ids or cell.env_id in env_ids:
            rows[cell.key] = record
            job = Job(key=cell.key, compute=partial(compute, cell), kind=(PolicyCell, cell.env_id))
            jobs.append(job)
    if not jobs:
        raise ValueError(
            f"the results have no cells of {', '.join(policies)}: choose policies and ids of its "
            "tables"
        )
    for key, record in run_jobs(jobs, backend, say=say):
        cell = rows[key].cell
        assert isinstance(cell, PolicyCell)
        yield Reproduction(
            cell=cell,
            stored=rows[key].result.get("payload"),
            computed=record.result.get("payload"),
            resolution=rows[key].result.get("resolution") or 0.0,
        )
