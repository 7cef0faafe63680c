"""Scores: the DLCC of a policy as a fraction of the best known payload for the same robot, motion
and error bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, TimingCell, canonical
from cablebot_gym.benchmark.ranking import Fraction, fraction, ranks
from cablebot_gym.benchmark.records import Record, single_records
from cablebot_gym.benchmark.yardstick import Yardstick, yardsticks
from cablebot_gym.kinematics import Array
from cablebot_gym.uncertainty import ERROR_SEPARATOR

RANKED_MOTIONS = 20
"""Least number of motions for ranks. Fewer do not tell policies apart."""


@dataclass(frozen=True, kw_only=True)
class BestKnown:
    """The best known payload for one robot, motion and set of error bounds."""

    cell: BestKnownCell
    """The cell."""
    result: Mapping[str, Any]
    """Result of the search, or an ``error`` message if it failed."""

    @property
    def payload(self) -> float | None:
        """Reference of the scores [kg]; None if the search found no payload that its replay
        verifies."""
        if self.result.get("verified"):
            return self.result["payload"]
        return None


@dataclass(frozen=True, kw_only=True)
class Score:
    """The DLCC of a policy under one set of conditions, and its fraction of the best known
    payload."""

    cell: PolicyCell
    """The cell."""
    result: Mapping[str, Any]
    """Result of the evaluation, or an ``error`` message if the policy failed."""
    best_known: float | None
    """Best known payload [kg]; None if there is none."""
    score: float | None
    """Fraction of the best known payload, in the main table times the yardstick under uncertainty; 0
    if the policy fails unloaded or raised an error. None for the paper criterion, under an
    uncertainty except in the main table, without these references, and if the computation can be
    repeated."""

    @property
    def error(self) -> str | None:
        """Error message of the evaluation; None if it succeeded."""
        return self.result.get("error")

    @property
    def payload(self) -> float | None:
        """DLCC [kg], a 95/95 lower tolerance bound under an uncertainty; None if the policy fails
        unloaded, raised an error, or if the criterion is not applicable."""
        return self.result.get("payload")

    @property
    def payload_text(self) -> str:
        """The payload as text. ``≥`` marks a lower bound: the scan ended while the payload was
        still feasible."""
        if self.payload is None:
            return "fails unloaded"
        text = f"{self.payload:.2f}"
        if self.result.get("scan_ended"):
            text = f"≥ {text}"
        if self.result.get("declared"):
            text += ", declared"
        if self.result.get("stochastic") and self.cell.draws == 1:
            text += f", stochastic ({self.result['draws']} draws)"
        return text


def best_known_payloads(records: Sequence[Record]) -> dict[str, BestKnown]:
    """The best known payloads by :attr:`~cablebot_gym.benchmark.cells.Setting.motion_key`."""
    payloads = {}
    for record in records:
        cell = record.cell
        if isinstance(cell, BestKnownCell):
            payloads[cell.motion_key] = BestKnown(cell=cell, result=record.result)
    return payloads


def scores(records: Sequence[Record]) -> list[Score]:
    """The scores of all policy cells in the order of the records, one for each motion of a
    survey."""
    references = best_known_payloads(records)
    sticks = yardsticks(records)
    policy_scores = []
    for record in single_records(records):
        cell = record.cell
        if not isinstance(cell, PolicyCell):
            continue
        best_known = None
        if cell.motion_key in references:
            best_known = references[cell.motion_key].payload
        reference = None
        if best_known and cell.criterion == "task":
            reference = best_known * _attainable(cell, sticks)
        score = None
        if reference and (record.error is None or record.final):
            score = (record.result.get("payload") or 0.0) / reference
        policy_scores.append(
            Score(cell=cell, result=record.result, best_known=best_known, score=score)
        )
    return policy_scores


@dataclass(frozen=True, kw_only=True)
class Column:
    """Conditions of one column of a table."""

    motion: str
    """Name of the motion or of the family of motions."""
    payload_known: bool = True
    """Whether the policies' models include the payload."""
    model_payload_factor: float = 1.0
    """Ratio of the policies' model payload to the nominal payload."""
    uncertainty: str | None = None
    """Name of an uncertainty; None for none."""
    criterion: str = "task"
    """DLCC criterion: ``task`` or ``paper``."""
    draws: int = 1
    """Number of draws that confirm the payload."""
    is_family: bool = False
    """Whether the motions are random ones of a family."""

    @property
    def is_main(self) -> bool:
        """Whether it belongs to the main table: random motions, on robots that are not exactly
        known."""
        return self.is_family and self.uncertainty is not None

    @classmethod
    def of(cls, cell: PolicyCell) -> Column:
        """The column of a cell."""
        return cls(
            motion=str(cell.trajectory["name"]),
            payload_known=cell.payload_known,
            model_payload_factor=cell.model_payload_factor,
            uncertainty=cell.uncertainty,
            criterion=cell.criterion,
            draws=cell.draws,
            is_family="seed" in cell.trajectory,
        )


@dataclass(frozen=True, kw_only=True)
class Leaderboard:
    """A table of one environment: policies by conditions."""

    env_id: str
    """Environment id."""
    columns: tuple[Column, ...]
    """Columns; nominal ones and those with the most motions come first, otherwise in the order of the
    suite."""
    policies: tuple[str, ...]
    """Policies by decreasing mean fraction in the first column."""
    ranks: Mapping[str, int]
    """Ranks by policy in the first column, from 1; empty if it has less than :data:`RANKED_MOTIONS`
    motions, including those that do not count. See :func:`~cablebot_gym.benchmark.ranking.ranks`."""
    entries: Mapping[tuple[str, Column], tuple[Score, ...]]
    """Scores by policy and column, one score per motion. Motions without best known payload are
    left out."""
    timings: Mapping[str, Mapping[str, Any]]
    """Results of :class:`~cablebot_gym.benchmark.cells.TimingCell` by policy."""

    @property
    def is_main(self) -> bool:
        """Whether it is the main table of the environment. All other conditions are in a second
        one."""
        return self.columns[0].is_main

    def motions(self, column: Column) -> int:
        """Number of motions of a column that count."""
        return max(
            len(entry) for (_, of_column), entry in self.entries.items() if of_column == column
        )

    def fraction(self, policy: str, column: Column) -> Fraction | None:
        """The fraction of a policy in a column; None without a score for every motion."""
        values = _values(self.entries.get((policy, column), ()))
        if values is None:
            return None
        return fraction(values)


def leaderboards(records: Sequence[Record]) -> list[Leaderboard]:
    """The tables in the order of the records, first the main table of an environment. Cells with
    one error alone, and cells of other robots than those of the environments are omitted.
    """
    groups: dict[str, dict[bool, list[Score]]] = {}
    for score in scores(records):
        cell = score.cell
        is_one_error = ERROR_SEPARATOR in (cell.uncertainty or "")
        if cell.robot_name is None and not is_one_error:
            tables = groups.setdefault(cell.env_id, {True: [], False: []})
            tables[Column.of(cell).is_main].append(score)
    timings: dict[str, dict[str, Mapping[str, Any]]] = {}
    for record in records:
        if isinstance(record.cell, TimingCell) and record.error is None:
            times = timings.setdefault(record.cell.env_id, {})
            times[record.cell.policy] = record.result
    boards = []
    for env_id, tables in groups.items():
        for group in tables.values():
            if group:  # the first table of an environment has the computing times
                times = timings.pop(env_id, {})
                boards.append(_leaderboard(env_id, group, times))
    return boards


@dataclass(frozen=True, kw_only=True)
class ErrorTable:
    """DLCC of policies on one motion of one environment, with each error of an uncertainty alone."""

    env_id: str
    """Environment id."""
    motion: str
    """Name of the motion."""
    payload_known: bool
    """Whether the policies' models include the payload."""
    uncertainty: str
    """Name of the uncertainty."""
    errors: tuple[str, ...]
    """Errors: :data:`NO_ERROR`, the errors alone, :data:`ALL_ERRORS`."""
    policies: Mapping[str, tuple[Score | None, ...]]
    """Scores by policy, one for each error; None where the policy was not evaluated."""


NO_ERROR = "no error"
"""Label of the exactly known robot in an error table."""

ALL_ERRORS = "all errors together"
"""Label of the whole uncertainty in an error table."""


def error_tables(records: Sequence[Record]) -> list[ErrorTable]:
    """The error tables of the records, for each environment, motion, payload model and uncertainty
    of which there is an error alone."""
    singles = []
    for score in scores(records):
        if score.cell.robot_name is None and score.cell.criterion == "task":
            singles.append(score)
    groups: dict[tuple[str, str, bool, str], dict[str, dict[str, Score]]] = {}
    for score in singles:
        name, _, error = (score.cell.uncertainty or "").partition(ERROR_SEPARATOR)
        if error:
            by_error = groups.setdefault((*_place(score.cell), name), {NO_ERROR: {}})
            by_error.setdefault(error, {})[score.cell.policy] = score
    tables = []
    for (env_id, motion, payload_known, uncertainty), by_error in groups.items():
        by_error[ALL_ERRORS] = {}
        for score in singles:
            cell = score.cell
            if _place(cell) != (env_id, motion, payload_known):
                continue
            if cell.uncertainty is None:
                by_error[NO_ERROR][cell.policy] = score
            elif cell.uncertainty == uncertainty:
                by_error[ALL_ERRORS][cell.policy] = score
        names = dict.fromkeys(name for by_policy in by_error.values() for name in by_policy)
        policies = {}
        for name in names:
            policies[name] = tuple(by_policy.get(name) for by_policy in by_error.values())
        tables.append(
            ErrorTable(
                env_id=env_id,
                motion=motion,
                payload_known=payload_known,
                uncertainty=uncertainty,
                errors=tuple(by_error),
                policies=policies,
            )
        )
    return tables


def _place(cell: PolicyCell) -> tuple[str, str, bool]:
    """Environment, motion and whether the payload is known."""
    return cell.env_id, canonical(dict(cell.trajectory)), cell.payload_known


def _leaderboard(
    env_id: str,
    group: Sequence[Score],
    timings: Mapping[str, Mapping[str, Any]],
) -> Leaderboard:
    scores_of: dict[tuple[str, Column], list[Score]] = {}
    for score in group:
        scores_of.setdefault((score.cell.policy, Column.of(score.cell)), []).append(score)
    # motions are compared in pairs, and therefore in the same order
    entries = {key: tuple(sorted(entry, key=_motion)) for key, entry in scores_of.items()}
    motions: dict[Column, int] = {}
    for (_, column), entry in entries.items():
        motions[column] = max(motions.get(column, 0), len(entry))
    columns = sorted(motions, key=lambda column: (column.uncertainty is not None, -motions[column]))
    first_column = columns[0]
    # A motion without best known payload counts for no policy, unless no motion of the column has
    # one.
    for key, entry in entries.items():
        with_reference = tuple(score for score in entry if score.best_known is not None)
        entries[key] = with_reference or entry
    ranked = {}
    for (policy, column), entry in entries.items():
        if column == first_column:
            ranked[policy] = entry
    fractions = _aligned(ranked)
    means = {policy: -1.0 for policy, _ in entries}
    for policy, values in fractions.items():
        means[policy] = float(np.nanmean(values))
    policy_ranks: dict[str, int] = {}
    if motions[first_column] >= RANKED_MOTIONS:
        policy_ranks = ranks(fractions)
    return Leaderboard(
        env_id=env_id,
        columns=tuple(columns),
        policies=tuple(sorted(means, key=lambda policy: (-means[policy], policy))),
        ranks=policy_ranks,
        entries=entries,
        timings=timings,
    )


def _aligned(entries: Mapping[str, tuple[Score, ...]]) -> dict[str, Array]:
    """Fractions of the policies that have one for each of their motions, on all motions of a column;
    NaN for motions that a policy has not run."""
    index_of_motion: dict[str, int] = {}
    for entry in entries.values():
        for score in entry:
            index_of_motion.setdefault(_motion(score), len(index_of_motion))
    fractions = {}
    for policy, entry in entries.items():
        values = _values(entry)
        if values is not None:
            indices = [index_of_motion[_motion(score)] for score in entry]
            fractions[policy] = np.full(len(index_of_motion), np.nan)
            fractions[policy][indices] = values
    return fractions


def _motion(score: Score) -> str:
    """The motion as text, the same for equal motions."""
    return canonical(dict(score.cell.trajectory))


def _values(entry: Sequence[Score]) -> Array | None:
    """Fractions of the motions; None unless every motion has one."""
    values = [score.score for score in entry if score.score is not None]
    if not values or len(values) < len(entry):
        return None
    return np.array(values)


def _attainable(cell: PolicyCell, sticks: Mapping[tuple[str, str], Yardstick]) -> float:
    """Fraction of the best known payload that anybody can hope for; 0 if it is unknown, as for
    single motions under an uncertainty."""
    if cell.uncertainty is None:
        return 1.0
    stick = sticks.get((cell.env_id, cell.uncertainty))
    if stick is None or not Column.of(cell).is_main:
        return 0.0
    return stick.quantile
