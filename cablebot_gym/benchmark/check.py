"""Checks stored results: every expected row of their suite is there, and random rows have the same
payloads when they are computed again."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, DrawnCell, PolicyCell, TimingCell
from cablebot_gym.benchmark.engine import Backend, MessageCallback
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.records import Record, compute, single_records
from cablebot_gym.benchmark.seeds import evaluation_seed
from cablebot_gym.benchmark.suites import find_suite, suite_cells
from cablebot_gym.isolation.installed import public_entry
from cablebot_gym.policies import PolicySpec

BEST_KNOWN_FRACTION = 4
"""One of this many computed rows, at least one, is a best known payload."""

BEST_KNOWN_TOLERANCE = 2e-3
"""Largest relative difference of a best known payload, and of its ratio for a random robot: they are
optimal on a mesh."""


@dataclass(frozen=True, kw_only=True)
class Rows:
    """The rows of stored results beside those that their suite expects."""

    missing: tuple[Cell, ...]
    """Expected rows that the results do not have."""
    unexpected: tuple[Cell, ...]
    """Rows that the suite does not have, such as those of chosen motions."""
    not_installed: tuple[str, ...]
    """Policies whose rows cannot be expected, because they are not installed."""


def compare_rows(results: Results) -> Rows:
    """Compares the rows of results with those of their suite, by their keys: conditions, motions,
    robots and seeds. Best known payloads and random robots, which are the denominators, are rows
    too.

    Expected are all policies of the results in all of their environments.

    Raises:
        ValueError: if the suite is unknown, or if it has hidden motions and the results have no seed
            text.
    """
    suite = find_suite(results.suite)
    stored = {record.cell.key: record.cell for record in results.records}
    env_ids = {cell.env_id for cell in stored.values()}
    names: dict[str, None] = {}
    not_installed: dict[str, None] = {}
    for cell in stored.values():
        if not isinstance(cell, PolicyCell | TimingCell):
            continue
        if _is_installed(cell.policy):
            names[cell.policy] = None
        else:
            not_installed[cell.policy] = None
    policies: dict[str, tuple[str, ...]] = {}
    for env_id in suite.env_ids:
        policies[env_id] = tuple(name for name in names if _supports(name, env_id))
    cells = suite_cells(suite, policies, seed=_seed(results), seed_text=results.seed_text)
    expected = {key: cell for key, cell in cells.items() if cell.env_id in env_ids}
    missing = [cell for key, cell in expected.items() if key not in stored]
    unexpected = []
    for key, cell in stored.items():
        is_gone = isinstance(cell, PolicyCell | TimingCell) and cell.policy in not_installed
        if key not in expected and not is_gone:
            unexpected.append(cell)
    return Rows(
        missing=tuple(missing), unexpected=tuple(unexpected), not_installed=tuple(not_installed)
    )


def _is_installed(policy: str) -> bool:
    return PolicySpec.parse(policy).kind != "unknown"


def _supports(policy: str, env_id: str) -> bool:
    entry = public_entry(policy)
    return entry is None or env_id in entry.env_ids


def _seed(results: Results) -> int:
    """Evaluation seed of results. Without a seed text it is the one that they have."""
    if results.seed_text is None:
        for record in results.records:
            if isinstance(record.cell, PolicyCell):
                return record.cell.seed
    return evaluation_seed(results.seed_text)


@dataclass(frozen=True, kw_only=True)
class Recomputed:
    """A stored row and the same row, computed again."""

    cell: Cell
    """The cell."""
    stored: tuple[float | None, ...]
    """Stored payloads [kg], one for each motion, or the ratio of a random robot; None where there is
    none."""
    computed: tuple[float | None, ...]
    """The same, computed again."""
    is_equal: bool
    """Whether all of them are equal up to the resolution: rounding differs between machines."""

    def __str__(self) -> str:
        outcome = "equal" if self.is_equal else "DIFFERENT"
        return f"{outcome}: {self.cell.stem}: stored {_text(self.stored)}, computed {_text(self.computed)}"


def recompute(
    records: Sequence[Record], count: int, backend: Backend, *, say: MessageCallback
) -> Iterator[Recomputed]:
    """Computes randomly chosen rows again, best known payloads among them.

    Args:
        records: stored records. Computing times and rows of policies that are not installed are left
            out.
        count: number of rows; all if there are fewer.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        say: called with messages of the workers.
    """
    best_known: dict[str, Record] = {}
    others: dict[str, Record] = {}
    for record in records:
        cell = record.cell
        if isinstance(cell, BestKnownCell):
            best_known[cell.key] = record
            continue
        is_installed = isinstance(cell, PolicyCell) and _is_installed(cell.policy)
        if is_installed or isinstance(cell, DrawnCell):
            others[cell.key] = record
    chosen = _sample(best_known, max(1, count // BEST_KNOWN_FRACTION))
    chosen |= _sample(others, count - len(chosen))
    jobs = {key: partial(compute, record.cell) for key, record in chosen.items()}
    for key, computed in backend(jobs, say, ()):
        stored = chosen[key]
        before = single_records([stored])
        after = single_records([computed])
        yield Recomputed(
            cell=stored.cell,
            stored=tuple(_value(record.result) for record in before),
            computed=tuple(_value(record.result) for record in after),
            is_equal=all(map(_are_equal, before, after)),
        )


def _sample(records: Mapping[str, Record], count: int) -> dict[str, Record]:
    keys = random.SystemRandom().sample(sorted(records), min(count, len(records)))
    return {key: records[key] for key in keys}


def _are_equal(stored: Record, computed: Record) -> bool:
    expected = _value(stored.result)
    value = _value(computed.result)
    if expected is None or value is None:
        return expected == value
    tolerance = BEST_KNOWN_TOLERANCE * expected
    if isinstance(stored.cell, PolicyCell):
        tolerance = stored.result["resolution"]
    return abs(value - expected) <= tolerance


def _value(result: Mapping[str, Any]) -> float | None:
    """Ratio of a random robot, or payload [kg]; None without one."""
    value: float | None = result.get("ratio", result.get("payload"))
    return value


def _text(values: Sequence[float | None]) -> str:
    return ", ".join("none" if value is None else f"{value:.3f}" for value in values)
