"""Confirms uncertain payloads of stored results with fresh draws, and recomputes rows."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil, log
from statistics import mean

from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.engine import Backend, Job, MessageCallback, run_jobs
from cablebot_gym.benchmark.records import Record, compute, single_records
from cablebot_gym.policies.spec import PolicySpec

KEPT = 0.9
"""Least fraction of the cells whose success rate is at least the promised probability. A 95/95
tolerance bound misses the probability in one cell of 20, and the measured rate scatters about the
true one."""

SLACK = 0.02
"""Largest shortfall of the success rate of any cell."""

FALSE_ALARM = 1e-3
"""Fraction of honest boards whose surveyed payloads are called broken."""


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """Success rate of a stored payload in fresh draws."""

    cell: PolicyCell
    """Cell of the payload."""
    payload: float
    """Promised payload [kg]."""
    success_rate: float
    """Fraction of the fresh draws that carry it."""
    draws: int
    """Number of fresh draws."""
    is_surveyed: bool
    """Whether all robots of a survey have carried it. Its success probability then is at least the
    promised one on the mean over motions; otherwise it is a tolerance bound."""

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
        if self.is_surveyed:
            promise += ", on the mean over motions"
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
    """Tries payloads of randomly chosen uncertain cells, and of as many motions of surveys, in fresh
    draws, which the cells share. Policies that are not installed any more are named and left out.

    Args:
        records: stored records.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        cells: number of cells, and of motions of surveys; all if there are fewer.
        draws: number of fresh draws.
        seed: seed of the choice and of the draws.
        say: called with messages for the user.

    Raises:
        ValueError: if there is no cell with an uncertain payload.
    """
    promises: dict[bool, dict[str, tuple[PolicyCell, float]]] = {False: {}, True: {}}
    gone: set[str] = set()
    for record in single_records(records):
        cell = record.cell
        payload = record.result.get("payload")
        if not isinstance(cell, PolicyCell) or cell.uncertainty is None or not payload:
            continue
        if PolicySpec.parse(cell.policy).kind == "unknown":
            gone.add(cell.policy)
            continue
        is_surveyed = "assured" not in record.result
        if is_surveyed or record.result["assured"]:
            promises[is_surveyed][cell.key] = (cell, float(payload))
    if gone:
        say(f"not tried, because they are not installed: {', '.join(sorted(gone))}")
    if not any(promises.values()):
        raise ValueError(
            "the results have no payload under uncertainty; choose a suite with uncertain columns"
        )
    generator = random.Random(seed)
    jobs = []
    chosen: dict[str, tuple[PolicyCell, float, bool]] = {}
    for is_surveyed, group in promises.items():
        for key in generator.sample(sorted(group), min(cells, len(group))):
            cell, payload = group[key]
            chosen[key] = (cell, payload, is_surveyed)
            compute = partial(cell.success_rate, payload, draws, seed)
            jobs.append(Job(key=key, compute=compute, kind=(PolicyCell, cell.env_id)))
    for key, rate in run_jobs(jobs, backend, say=say):
        cell, payload, is_surveyed = chosen[key]
        yield Confirmation(
            cell=cell,
            payload=payload,
            success_rate=rate,
            draws=draws,
            is_surveyed=is_surveyed,
        )


def outcome(confirmations: Sequence[Confirmation]) -> str:
    """How many tolerance bounds keep their promise, and how often surveyed payloads are carried."""
    surveyed = [confirmation for confirmation in confirmations if confirmation.is_surveyed]
    bounds = [confirmation for confirmation in confirmations if not confirmation.is_surveyed]
    parts = []
    if bounds:
        kept = sum(confirmation.kept for confirmation in bounds)
        parts.append(f"{kept} of {len(bounds)} payloads keep their promise")
    if surveyed:
        rate = mean(confirmation.success_rate for confirmation in surveyed)
        parts.append(
            f"the payloads of {len(surveyed)} surveyed motions are carried in {rate:.1%} on the mean"
        )
    return " and ".join(parts)


def broken(confirmations: Sequence[Confirmation]) -> str:
    """One sentence if the promises are broken; empty if they hold."""
    surveyed = [confirmation for confirmation in confirmations if confirmation.is_surveyed]
    bounds = [confirmation for confirmation in confirmations if not confirmation.is_surveyed]
    required = ceil(KEPT * len(bounds))
    count = sum(confirmation.kept for confirmation in bounds)
    if count < required:
        return (
            f"only {count} of {len(bounds)} payloads keep their promise; "
            f"at least {required} have to"
        )
    if surveyed:
        rarity = _rarity(surveyed)
        if rarity < FALSE_ALARM:
            rate = mean(confirmation.success_rate for confirmation in surveyed)
            return (
                f"the surveyed payloads are carried in {rate:.1%} on the mean; "
                f"honest ones are so rarely in {rarity:.1g} of all checks"
            )
    for confirmation in bounds:
        if confirmation.success_rate < confirmation.cell.probability - SLACK:
            return f"a success rate is more than {SLACK:.0%} below the promise: {confirmation}"
    return ""


def _rarity(surveyed: Sequence[Confirmation]) -> float:
    """Probability that honest surveys of as many motions are carried as rarely.

    The success probability p of a payload that the weakest of r robots has just carried has the
    distribution Beta(r, 1), so −r ln p is exponential, and the sum over motions has a gamma
    distribution.
    """
    from scipy.special import gammaincc  # slow to import

    total = 0.0
    for confirmation in surveyed:
        rate = max(confirmation.success_rate, 0.5 / confirmation.draws)
        total -= confirmation.cell.draws * log(rate)
    return float(gammaincc(len(surveyed), total))


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
    """Computes the cells of rows of the tables again, with their stored seeds; a survey gives a
    result for each motion.

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
        stored = single_records([rows[key]])
        for before, after in zip(stored, single_records([record]), strict=True):
            assert isinstance(before.cell, PolicyCell)
            yield Reproduction(
                cell=before.cell,
                stored=before.result.get("payload"),
                computed=after.result.get("payload"),
                resolution=before.result.get("resolution") or 0.0,
            )
