"""Scores: the DLCC of a policy as a fraction of the best known payload for the same robot, motion
and error bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cablebot_gym.benchmark.ranking import RANKED_MOTIONS, Fraction, fraction, ranks
from cablebot_gym.benchmark.rows import Row, canonical
from cablebot_gym.benchmark.yardstick import Yardstick, yardsticks
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.kinematics import Array
from cablebot_gym.uncertainty import split_error


@dataclass(frozen=True, kw_only=True)
class Score:
    """The DLCC of a policy under one set of conditions, and its fraction of the best known
    payload."""

    row: Row
    """The row of the payload."""
    best_known: float | None
    """Best known payload [kg]; None if there is none."""
    score: float | None
    """Fraction of the best known payload, in the main table times the yardstick under uncertainty; 0
    if the policy fails unloaded or raised an error. None for the paper criterion, under an
    uncertainty except in the main table, without these references, and if the computation can be
    repeated."""

    @property
    def conditions(self) -> Conditions:
        """Conditions of the payload."""
        return self.row.conditions

    @property
    def result(self) -> Mapping[str, Any]:
        """Result of the evaluation, or an ``error`` message if the policy failed."""
        return self.row.result

    @property
    def payload(self) -> float | None:
        """DLCC [kg], a 95/95 lower tolerance bound under an uncertainty; None if the policy fails
        unloaded, raised an error, or if the criterion is not applicable."""
        return self.result.get("payload")

    @property
    def applicable(self) -> bool:
        """Whether the criterion applies to the policy."""
        return bool(self.result.get("applicable", True))

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
        if self.result.get("stochastic") and not self.conditions.draws:
            text += f", stochastic ({self.result['draws']} draws)"
        return text


def best_known_rows(rows: Sequence[Row]) -> dict[str, Row]:
    """The rows of best known payloads by :attr:`~cablebot_gym.benchmark.rows.Row.motion_key`."""
    return {row.motion_key: row for row in rows if row.measure == "best-known"}


def verified_payload(row: Row | None) -> float | None:
    """Best known payload of a row [kg]; None if the search found no payload that its replay
    verifies."""
    if row is not None and row.result.get("verified"):
        payload: float = row.result["payload"]
        return payload
    return None


def scores(rows: Sequence[Row]) -> list[Score]:
    """The scores of all payloads of policies in the order of the rows."""
    references = best_known_rows(rows)
    sticks = yardsticks(rows)
    policy_scores = []
    for row in rows:
        if row.measure != "payload":
            continue
        best_known = verified_payload(references.get(row.motion_key))
        reference = None
        if best_known and row.conditions.criterion == "task":
            reference = best_known * _attainable(row, sticks)
        score = None
        if reference and (row.error is None or row.final):
            score = (row.result.get("payload") or 0.0) / reference
        policy_scores.append(Score(row=row, best_known=best_known, score=score))
    return policy_scores


def column_of(row: Row) -> Conditions:
    """The column of a row: its conditions without what differs from motion to motion. The seed of a
    family of motions is 0."""
    trajectory: dict[str, Any] = {"name": row.motion}
    if row.family:
        trajectory["seed"] = 0
    return replace(row.conditions, trajectory=trajectory, error_bounds=None, seed=0)


def is_main(column: Conditions) -> bool:
    """Whether a column belongs to the main table: random motions, on robots that are not exactly
    known."""
    return "seed" in column.trajectory and column.uncertainty is not None


@dataclass(frozen=True, kw_only=True)
class Leaderboard:
    """A table of one environment: policies by conditions."""

    env_id: str
    """Environment id."""
    columns: tuple[Conditions, ...]
    """Columns; nominal ones and those with the most motions come first, otherwise in the order of the
    suite."""
    policies: tuple[str, ...]
    """Policies by decreasing mean fraction in the first column."""
    ranks: Mapping[str, int]
    """Ranks by policy in the first column, from 1; empty if it has less than
    :data:`~cablebot_gym.benchmark.ranking.RANKED_MOTIONS` motions, including those
    that do not count. See :func:`~cablebot_gym.benchmark.ranking.ranks`."""
    entries: Mapping[tuple[str, Conditions], tuple[Score, ...]]
    """Scores by policy and column, one score per motion. Motions without best known payload are
    left out."""
    timings: Mapping[str, Mapping[str, Any]]
    """Results of the rows of computing times by policy."""

    @property
    def is_main(self) -> bool:
        """Whether it is the main table of the environment. All other conditions are in a second
        one."""
        return is_main(self.columns[0])

    def motions(self, column: Conditions) -> int:
        """Number of motions of a column that count."""
        return max(
            len(entry) for (_, of_column), entry in self.entries.items() if of_column == column
        )

    def fraction(self, policy: str, column: Conditions) -> Fraction | None:
        """The fraction of a policy in a column; None without a score for every motion."""
        values = _values(self.entries.get((policy, column), ()))
        if values is None:
            return None
        return fraction(values)


def leaderboards(rows: Sequence[Row]) -> list[Leaderboard]:
    """The tables in the order of the rows, first the main table of an environment. Rows with one
    error alone, and those of other robots than those of the environments are omitted.
    """
    groups: dict[str, dict[bool, list[Score]]] = {}
    for score in scores(rows):
        given = score.conditions
        if given.robot is None and not _single_error(given):
            tables = groups.setdefault(given.env_id, {True: [], False: []})
            tables[is_main(column_of(score.row))].append(score)
    timings: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        if row.measure == "time" and row.error is None:
            timings.setdefault(row.conditions.env_id, {})[row.policy] = row.result
    boards = []
    for env_id, tables in groups.items():
        for group in tables.values():
            if group:  # the first table of an environment has the computing times
                times = timings.pop(env_id, {})
                boards.append(_leaderboard(env_id, group, times))
    return boards


def _single_error(conditions: Conditions) -> str:
    """The error of an uncertainty that is alone; empty without one."""
    _, error = split_error(conditions.uncertainty or "")
    return error


@dataclass(frozen=True, kw_only=True)
class ErrorTable:
    """DLCC of policies on one motion of one environment, with each error of an uncertainty alone."""

    conditions: Conditions
    """Conditions of all errors together."""
    errors: tuple[str, ...]
    """Errors: :data:`NO_ERROR`, the errors alone, :data:`ALL_ERRORS`."""
    policies: Mapping[str, tuple[Score | None, ...]]
    """Scores by policy, one for each error; None where the policy was not evaluated."""


NO_ERROR = "no error"
"""Label of the exactly known robot in an error table."""

ALL_ERRORS = "all errors together"
"""Label of the whole uncertainty in an error table."""


def error_tables(rows: Sequence[Row]) -> list[ErrorTable]:
    """The error tables of the rows: one for the conditions of each uncertainty of which there is an
    error alone."""
    by_conditions: dict[Conditions, dict[str, Score]] = {}
    singles: dict[Conditions, list[str]] = {}
    for score in scores(rows):
        given = score.conditions
        if given.robot is None and given.criterion == "task":
            by_conditions.setdefault(replace(given, draws=None), {})[score.row.policy] = score
            name, error = split_error(given.uncertainty or "")
            if error:
                everything = replace(given, draws=None, uncertainty=name)
                singles.setdefault(everything, []).append(given.uncertainty)
    tables = []
    for everything, names in singles.items():
        names = list(dict.fromkeys(names))
        columns = {NO_ERROR: by_conditions.get(replace(everything, uncertainty=None), {})}
        for name in names:
            columns[split_error(name)[1]] = by_conditions[replace(everything, uncertainty=name)]
        columns[ALL_ERRORS] = by_conditions.get(everything, {})
        policies = {}
        for policy in dict.fromkeys(name for column in columns.values() for name in column):
            policies[policy] = tuple(column.get(policy) for column in columns.values())
        tables.append(ErrorTable(conditions=everything, errors=tuple(columns), policies=policies))
    return tables


def _leaderboard(
    env_id: str,
    group: Sequence[Score],
    timings: Mapping[str, Mapping[str, Any]],
) -> Leaderboard:
    scores_of: dict[tuple[str, Conditions], list[Score]] = {}
    for score in group:
        scores_of.setdefault((score.row.policy, column_of(score.row)), []).append(score)
    # motions are compared in pairs, and therefore in the same order
    entries = {key: tuple(sorted(entry, key=_motion)) for key, entry in scores_of.items()}
    motions: dict[Conditions, int] = {}
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
    return canonical(score.conditions.trajectory)


def _values(entry: Sequence[Score]) -> Array | None:
    """Fractions of the motions; None unless every motion has one."""
    values = [score.score for score in entry if score.score is not None]
    if not values or len(values) < len(entry):
        return None
    return np.array(values)


def _attainable(row: Row, sticks: Mapping[tuple[str, str], Yardstick]) -> float:
    """Fraction of the best known payload that anybody can hope for; 0 if it is unknown, as for
    single motions under an uncertainty."""
    uncertainty = row.conditions.uncertainty
    if uncertainty is None:
        return 1.0
    stick = sticks.get((row.conditions.env_id, uncertainty))
    if stick is None or not row.family:
        return 0.0
    return stick.quantile
