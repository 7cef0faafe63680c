"""Scores: the DLCC of a policy as a fraction of the optimum for the same robot, motion and error
bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cablebot_gym.benchmark.ranking import RANKED_MOTIONS, Fraction, fraction, ranks
from cablebot_gym.benchmark.rows import Measure, Row, canonical
from cablebot_gym.benchmark.yardstick import Yardstick, yardsticks
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.kinematics import Array


@dataclass(frozen=True, kw_only=True)
class Score:
    """The DLCC of a policy under one set of conditions, and its fraction of the optimum."""

    row: Row
    """The row of the payload."""
    optimum: float | None
    """Optimum of the motion [kg]; None if there is none."""
    score: float | None
    """Fraction of the optimum, on robots that are not exactly known times the yardstick; 0 if the policy
    fails unloaded or raised an error. None for the paper criterion, without these references, and if the
    computation can be repeated."""

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


def rows_of(rows: Sequence[Row], measure: Measure) -> dict[str, Row]:
    """The rows of a measure that no policy changes, by
    :attr:`~cablebot_gym.benchmark.rows.Row.motion_key`."""
    return {row.motion_key: row for row in rows if row.measure == measure}


def optima(rows: Sequence[Row]) -> dict[str, float]:
    """The optima [kg] by :attr:`~cablebot_gym.benchmark.rows.Row.motion_key`, of the motions that have
    one."""
    found = {}
    for key, row in rows_of(rows, "optimum").items():
        if row.result.get("payload"):
            found[key] = row.result["payload"]
    return found


def scores(rows: Sequence[Row]) -> list[Score]:
    """The scores of all payloads of policies in the order of the rows."""
    references = optima(rows)
    sticks = yardsticks(rows)
    policy_scores = []
    for row in rows:
        if row.measure != "payload":
            continue
        optimum = references.get(row.motion_key)
        reference = None
        if optimum and row.conditions.criterion == "task":
            reference = optimum * _attainable(row, sticks)
        score = None
        if reference and (row.error is None or row.final):
            score = (row.result.get("payload") or 0.0) / reference
        policy_scores.append(Score(row=row, optimum=optimum, score=score))
    return policy_scores


def column_of(row: Row) -> Conditions:
    """The column of a row: its conditions without what differs from motion to motion. The seed of a
    family of motions is 0."""
    trajectory: dict[str, Any] = {"name": row.motion}
    if row.family:
        trajectory["seed"] = 0
    return replace(row.conditions, trajectory=trajectory, error_bounds=None, seed=0)


def is_main(column: Conditions) -> bool:
    """Whether a column is the main one: random motions, on robots that are not exactly known."""
    return "seed" in column.trajectory and column.uncertainty is not None


@dataclass(frozen=True, kw_only=True)
class Leaderboard:
    """A table of one environment: policies by conditions."""

    env_id: str
    """Environment id."""
    columns: tuple[Conditions, ...]
    """Columns; the main one and those with the most motions come first, otherwise in the order of the
    suite."""
    policies: tuple[str, ...]
    """Policies by decreasing mean fraction in the first column, then in the next ones."""
    ranks: Mapping[str, int]
    """Ranks by policy in the first column, from 1; empty if it has less than
    :data:`~cablebot_gym.benchmark.ranking.RANKED_MOTIONS` motions, including those
    that do not count. See :func:`~cablebot_gym.benchmark.ranking.ranks`."""
    entries: Mapping[tuple[str, Conditions], tuple[Score, ...]]
    """Scores by policy and column, one score per motion. Motions without optimum are left out."""
    timings: Mapping[str, Mapping[str, Any]]
    """Results of the rows of computing times by policy."""

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
    """The tables in the order of the rows, one of each environment."""
    groups: dict[str, list[Score]] = {}
    for score in scores(rows):
        groups.setdefault(score.conditions.env_id, []).append(score)
    timings: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        if row.measure == "time" and row.error is None:
            timings.setdefault(row.conditions.env_id, {})[row.policy] = row.result
    return [
        _leaderboard(env_id, group, timings.get(env_id, {})) for env_id, group in groups.items()
    ]


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
    columns = sorted(motions, key=lambda column: (not is_main(column), -motions[column]))
    # A motion without optimum counts for no policy, unless no motion of the column has one.
    for key, entry in entries.items():
        with_reference = tuple(score for score in entry if score.optimum is not None)
        entries[key] = with_reference or entry
    fractions = _aligned(entries, columns[0])
    means: dict[str, list[float]] = {policy: [] for policy, _ in entries}
    for column in columns:
        of_column = _aligned(entries, column)
        for policy, of_policy in means.items():
            mean = -1.0
            if policy in of_column:
                mean = float(np.nanmean(of_column[policy]))
            of_policy.append(-mean)
    policy_ranks: dict[str, int] = {}
    if motions[columns[0]] >= RANKED_MOTIONS:
        policy_ranks = ranks(fractions)
    return Leaderboard(
        env_id=env_id,
        columns=tuple(columns),
        policies=tuple(sorted(means, key=lambda policy: (means[policy], policy))),
        ranks=policy_ranks,
        entries=entries,
        timings=timings,
    )


def _aligned(
    entries: Mapping[tuple[str, Conditions], tuple[Score, ...]], column: Conditions
) -> dict[str, Array]:
    """Fractions of the policies that have one for each of their motions of a column, on all its motions;
    NaN for motions that a policy has not run."""
    of_policies = {policy: entry for (policy, key), entry in entries.items() if key == column}
    index_of_motion: dict[str, int] = {}
    for entry in of_policies.values():
        for score in entry:
            index_of_motion.setdefault(_motion(score), len(index_of_motion))
    fractions = {}
    for policy, entry in of_policies.items():
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
    """Fraction of the optimum that anybody can hope for; 0 if it is unknown."""
    uncertainty = row.conditions.uncertainty
    if uncertainty is None:
        return 1.0
    stick = sticks.get((row.conditions.env_id, uncertainty))
    return stick.quantile if stick else 0.0
