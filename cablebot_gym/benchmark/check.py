"""Checks stored results: every expected row of their suite is there, and random rows have the same
payloads when they are computed again."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from cablebot_gym.benchmark.engine import Backend
from cablebot_gym.benchmark.policy_source import shipped_entry
from cablebot_gym.benchmark.rows import Row, compute
from cablebot_gym.benchmark.seeds import evaluation_seed
from cablebot_gym.benchmark.store import Results
from cablebot_gym.benchmark.suites import find_suite, suite_rows
from cablebot_gym.policies import PolicySpec
from cablebot_gym.utils.workers import WorkerDied

OPTIMUM_FRACTION = 4
"""One of this many computed rows, at least one, is an optimum."""

OPTIMUM_TOLERANCE = 2e-3
"""Largest relative difference of what a motion allows: a solver computes it."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """The rows of stored results beside those that their suite expects."""

    missing: tuple[Row, ...]
    """Expected rows that the results do not have."""
    unexpected: tuple[Row, ...]
    """Rows that the suite does not have, such as those of chosen motions."""
    not_installed: tuple[str, ...]
    """Policies whose rows cannot be expected, because they are not installed."""


def compare_rows(results: Results) -> Difference:
    """Compares the rows of results with those of their suite, by their keys: conditions, motions,
    robots and seeds. Optima and random robots, which are the denominators, are rows too.

    Expected are all policies of the results in all of their environments, and those of other
    packages where they have a row.

    Raises:
        ValueError: if the suite is unknown, or if it has hidden motions and the results have no seed
            text.
    """
    suite = find_suite(results.suite)
    stored = {row.key: row for row in results.rows}
    env_ids = {row.conditions.env_id for row in results.rows}
    pairs = {(row.policy, row.conditions.env_id) for row in results.rows}
    names = list(dict.fromkeys(row.policy for row in results.rows if row.policy))
    not_installed = [name for name in names if not _is_installed(name)]
    policies: dict[str, tuple[str, ...]] = {}
    for env_id in suite.env_ids:
        supporting = []
        for name in names:
            entry = shipped_entry(name)
            is_supported = (name, env_id) in pairs if entry is None else env_id in entry.env_ids
            if is_supported and name not in not_installed:
                supporting.append(name)
        policies[env_id] = tuple(supporting)
    seed = evaluation_seed(results.seed_text)
    rows = suite_rows(suite, policies, seed=seed, seed_text=results.seed_text)
    expected = {row.key: row for row in rows if row.conditions.env_id in env_ids}
    unexpected = []
    for key, row in stored.items():
        if key not in expected and row.policy not in not_installed:
            unexpected.append(row)
    return Difference(
        missing=tuple(row for key, row in expected.items() if key not in stored),
        unexpected=tuple(unexpected),
        not_installed=tuple(not_installed),
    )


def _is_installed(policy: str) -> bool:
    return PolicySpec.parse(policy).kind != "unknown"


@dataclass(frozen=True, kw_only=True)
class Recomputed:
    """A stored row and the same row, computed again."""

    stored: Row
    """The stored row."""
    computed: Row
    """The row, computed again."""

    @property
    def is_equal(self) -> bool:
        """Whether both have the same number up to the resolution: rounding differs between
        machines."""
        expected = _value(self.stored)
        value = _value(self.computed)
        if expected is None or value is None:
            return expected == value
        tolerance = OPTIMUM_TOLERANCE * expected
        if self.stored.policy:
            tolerance = self.stored.result["resolution"]
        return abs(value - expected) <= tolerance

    def __str__(self) -> str:
        outcome = "equal" if self.is_equal else "DIFFERENT"
        values = f"stored {_text(self.stored)}, computed {_text(self.computed)}"
        return f"{outcome}: {self.stored}: {values}"


def recompute(
    rows: Sequence[Row], count: int, backend: Backend, chooser: random.Random | None = None
) -> Iterator[Recomputed]:
    """Computes randomly chosen rows again, optima among them.

    Args:
        rows: stored rows. Computing times and rows of policies that are not installed are left out.
        count: number of rows; all if there are fewer.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        chooser: chooses the rows; None for another choice each time.

    Raises:
        WorkerDied: if a computation ends its process.
    """
    optima = {row.key: row for row in rows if row.measure == "optimum"}
    others = {}
    for row in rows:
        is_installed = not row.policy or _is_installed(row.policy)
        if is_installed and row.measure not in ("optimum", "time"):
            others[row.key] = row
    chooser = chooser or random.SystemRandom()
    chosen = _sample(chooser, optima, max(1, count // OPTIMUM_FRACTION))
    chosen |= _sample(chooser, others, count - len(chosen))
    jobs = {key: partial(compute, (row,)) for key, row in chosen.items()}
    for key, computed in backend(jobs):
        if isinstance(computed, WorkerDied):
            raise computed
        yield Recomputed(stored=chosen[key], computed=computed[0])


def _sample(chooser: random.Random, rows: Mapping[str, Row], count: int) -> dict[str, Row]:
    keys = chooser.sample(sorted(rows), min(count, len(rows)))
    return {key: rows[key] for key in keys}


def _value(row: Row) -> float | None:
    """Ratio of a random robot, or payload [kg]; None without one."""
    value: float | None = row.result.get("ratio", row.result.get("payload"))
    return value


def _text(row: Row) -> str:
    value = _value(row)
    return "none" if value is None else f"{value:.3f}"
