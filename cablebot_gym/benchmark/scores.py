"""Scores: the DLCC of a policy as a fraction of the best known payload for the same robot, motion and error bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from statistics import median
from typing import Any

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, Record, canonical
from cablebot_gym.benchmark.maps import AXES, Axis, varied_fields
from cablebot_gym.task import payload_model_text


@dataclass(frozen=True, kw_only=True)
class BestKnown:
    """The best known payload for one robot, motion and set of error bounds."""

    cell: BestKnownCell
    """The cell."""
    result: Mapping[str, Any]
    """Result of the search, or an ``error`` message if it failed."""
    payload: float | None
    """Reference of the scores [kg]: the payload found by the search, or the larger payload of a policy. None if the
    search found no payload that its replay verifies."""
    raised_by: str | None
    """Policy and payload model that raised the payload; None if the payload is the search's own."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """The DLCC of a policy under one set of conditions, and its fraction of the best known payload."""

    cell: PolicyCell
    """The cell."""
    result: Mapping[str, Any]
    """Result of the evaluation, or an ``error`` message if the policy failed."""
    best_known: float | None
    """Best known payload [kg]; None if there is none."""
    score: float | None
    """Fraction of the best known payload; 0 if the policy fails unloaded. None for the paper criterion, without a best
    known payload, and if the policy raised an error."""
    raised: bool
    """Whether this payload raised the best known payload."""

    @property
    def error(self) -> str | None:
        """Error message of the evaluation; None if it succeeded."""
        return self.result.get("error")

    @property
    def payload(self) -> float | None:
        """DLCC [kg]; None if the policy fails unloaded, raised an error, or if the criterion is not applicable."""
        return self.result.get("payload")

    @property
    def payload_text(self) -> str:
        """The payload as text. ``≥`` marks a lower bound: the scan ended while the payload was still feasible."""
        if self.payload is None:
            return "fails unloaded"
        at_least = self.result.get("scan_ended")
        return f"{'≥ ' if at_least else ''}{self.payload:.2f}"


def best_known_payloads(records: Sequence[Record]) -> dict[str, BestKnown]:
    """The best known payloads by :func:`motion_key`.

    A policy that carries a payload by the task criterion without uncertainty demonstrates a motion within all limits,
    whatever its payload model. If this payload exceeds the search's, it becomes the best known payload.
    """
    references: dict[str, BestKnown] = {}
    for record in records:
        if isinstance(record.cell, BestKnownCell):
            payload = record.result["payload"] if record.result.get("verified") else None
            reference = BestKnown(cell=record.cell, result=record.result, payload=payload, raised_by=None)
            references[motion_key(record.cell)] = reference
    for record in records:
        cell, payload = record.cell, record.result.get("payload")
        if isinstance(cell, BestKnownCell) or cell.criterion != "task" or cell.uncertainty or payload is None:
            continue
        current = references.get(motion_key(cell))
        if current is not None and current.payload is not None and payload > current.payload:
            references[motion_key(cell)] = replace(current, payload=payload, raised_by=_policy_and_model(cell))
    return references


def scores(records: Sequence[Record]) -> list[Score]:
    """The scores of all policy cells, in the order of the records."""
    references = best_known_payloads(records)
    return [_score(record, record.cell, references) for record in records if isinstance(record.cell, PolicyCell)]


def motion_key(cell: PolicyCell | BestKnownCell) -> str:
    """Key of the best known payload of a cell: environment, motion, error bounds, control frequency and robot."""
    return canonical([cell.env_id, cell.trajectory, cell.error_bounds, cell.control_frequency, cell.robot_changes])


@dataclass(frozen=True, kw_only=True)
class Column:
    """Conditions of one column of a table."""

    payload_known: bool
    """Whether the policies' models include the payload."""
    model_payload_factor: float
    """Ratio of the policies' model payload to the nominal payload."""
    uncertainty: str | None
    """Name of an uncertainty; None for none."""
    criterion: str
    """DLCC criterion: ``task`` or ``paper``."""
    draws: int
    """Number of sampled episodes per payload."""

    @classmethod
    def of(cls, cell: PolicyCell) -> Column:
        """The column of a cell."""
        return cls(**{field.name: getattr(cell, field.name) for field in fields(cls)})


@dataclass(frozen=True, kw_only=True)
class Leaderboard:
    """One table: policies by conditions, for one environment and one motion or family of motions."""

    env_id: str
    """Environment id."""
    motion: str
    """Name of the motion or of the family of motions."""
    columns: tuple[Column, ...]
    """Columns in the order of the suite."""
    policies: tuple[str, ...]
    """Policies by decreasing score in the first column; the median score for a family of motions."""
    entries: Mapping[tuple[str, Column], tuple[Score, ...]]
    """Scores by policy and column, one score per motion."""

    @property
    def motions(self) -> int:
        """Number of motions: 1, or the size of the family."""
        return len({canonical(dict(score.cell.trajectory)) for entry in self.entries.values() for score in entry})

    def fraction(self, policy: str, column: Column) -> Fraction | None:
        """The fraction of a policy in a column; None without a score for every motion."""
        return _fraction(self.entries.get((policy, column), ()))


@dataclass(frozen=True, kw_only=True)
class Fraction:
    """Fractions of the best known payload over one motion or several."""

    median: float
    """Median over the motions."""
    worst: float
    """Minimum over the motions."""


def leaderboards(records: Sequence[Record]) -> list[Leaderboard]:
    """The tables in the order of the records. Cells with varied parameters, which belong to maps, are omitted."""
    groups: dict[tuple[str, str], list[Score]] = {}
    for score in scores(records):
        if not varied_fields(score.cell):
            groups.setdefault((score.cell.env_id, str(score.cell.trajectory["name"])), []).append(score)
    return [_leaderboard(env_id, motion, group) for (env_id, motion), group in groups.items()]


@dataclass(frozen=True, kw_only=True)
class PayloadMap:
    """DLCC of policies on the circle of one environment with known payload, as a function of one task parameter."""

    env_id: str
    """Environment id."""
    axis: Axis
    """Varied parameter."""
    constants: tuple[str, ...]
    """Labels and values of other varied parameters, which are constant in the map."""
    values: tuple[float, ...]
    """Values of the parameter, SI, ascending."""
    best_known: tuple[float | None, ...]
    """Best known payload at each value [kg]; None where there is none."""
    policies: Mapping[str, tuple[Score | None, ...]]
    """Scores by policy, one for each value; None where the policy was not evaluated."""


def payload_maps(records: Sequence[Record]) -> list[PayloadMap]:
    """The maps of the records: one for each environment, axis and set of constants with at least one varied cell."""
    conditions = (payload_model_text(True), None, "task")
    groups: dict[str, dict[tuple[Axis, str, tuple[str, ...]], list[Score]]] = {}
    for score in scores(records):
        cell = score.cell
        if (cell.payload_model, cell.uncertainty, cell.criterion) == conditions:
            maps = groups.setdefault(cell.env_id, {})
            for axis in AXES.values():
                if (constants := axis.constants(cell)) is not None:
                    maps.setdefault((axis, cell.trajectory["name"], constants), []).append(score)
    references = best_known_payloads(records)
    order = list(AXES.values())
    return [
        _map(env_id, axis, constants, group, references)
        for env_id, maps in groups.items()
        for (axis, _, constants), group in sorted(maps.items(), key=lambda item: order.index(item[0][0]))
        if any(axis.varies(score.cell) for score in group)
    ]


def _map(
    env_id: str, axis: Axis, constants: tuple[str, ...], group: Sequence[Score], references: Mapping[str, BestKnown]
) -> PayloadMap:
    group = sorted(group, key=lambda score: axis.varies(score.cell))
    by_value: dict[float, dict[str, Score]] = {axis.value(score.cell): {} for score in group}
    for score in group:
        by_value[axis.value(score.cell)][score.cell.policy] = score
    values = tuple(sorted(by_value))
    best = [references.get(motion_key(next(iter(by_value[value].values())).cell)) for value in values]
    varied = {score.cell.policy for score in group if axis.varies(score.cell)}
    names = [name for name in dict.fromkeys(score.cell.policy for score in group) if name in varied]
    return PayloadMap(
        env_id=env_id,
        axis=axis,
        constants=constants,
        values=values,
        best_known=tuple(None if one is None else one.payload for one in best),
        policies={name: tuple(by_value[value].get(name) for value in values) for name in names},
    )


def _leaderboard(env_id: str, motion: str, group: Sequence[Score]) -> Leaderboard:
    entries: dict[tuple[str, Column], tuple[Score, ...]] = {}
    for score in group:
        key = (score.cell.policy, Column.of(score.cell))
        entries[key] = (*entries.get(key, ()), score)
    columns = tuple(dict.fromkeys(column for _, column in entries))

    def rank(policy: str) -> tuple[float, str]:
        fraction = _fraction(entries.get((policy, columns[0]), ()))
        return (1.0 if fraction is None else -fraction.median), policy

    policies = sorted({policy for policy, _ in entries}, key=rank)
    return Leaderboard(env_id=env_id, motion=motion, columns=columns, policies=tuple(policies), entries=entries)


def _fraction(entry: Sequence[Score]) -> Fraction | None:
    values = [score.score for score in entry if score.score is not None]
    return Fraction(median=median(values), worst=min(values)) if values and len(values) == len(entry) else None


def _score(record: Record, cell: PolicyCell, references: Mapping[str, BestKnown]) -> Score:
    best = references.get(motion_key(cell))
    reference = None if best is None else best.payload
    payload = record.result.get("payload")
    ranked = cell.criterion == "task" and record.error is None and reference is not None and reference > 0
    return Score(
        cell=cell,
        result=record.result,
        best_known=reference,
        score=(payload or 0.0) / reference if ranked and reference else None,
        raised=ranked and cell.uncertainty is None and best is not None and best.raised_by == _policy_and_model(cell),
    )


def _policy_and_model(cell: PolicyCell) -> str:
    return f"{cell.policy}, {cell.payload_model}"
