"""Scores: a policy's payload as a share of the best found for the same robot, motion and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from cablebot_gym.benchmark.cells import BestCell, PolicyCell, Record, canonical
from cablebot_gym.benchmark.maps import AXES, Axis, unusual


@dataclass(frozen=True, kw_only=True)
class Best:
    """The best found for one robot, motion and limits."""

    cell: BestCell
    """What was asked."""
    result: Mapping[str, Any]
    """What the search found; ``error`` is a sentence if nothing."""
    payload: float | None
    """What scores refer to [kg]: the search's payload, or a policy's that is larger; None if the search found none that
    passed its replay."""
    raised_by: str | None
    """Policy and information set to which the payload was raised; None if it is the search's own."""


@dataclass(frozen=True, kw_only=True)
class Standing:
    """What a policy carries under one set of conditions, and what share of the best found that is."""

    cell: PolicyCell
    """The conditions."""
    result: Mapping[str, Any]
    """What was found; ``error`` is a sentence if the policy failed."""
    best: float | None
    """Best found [kg]; None if there is none."""
    score: float | None
    """Share of it, 0 if not even zero payload is carried; None by the paper's criterion, without a best found, and
    where the policy failed."""
    raised: bool
    """Whether the best found was raised to this very payload."""

    @property
    def error(self) -> str | None:
        """Why the policy failed; None if it did not."""
        return self.result.get("error")

    @property
    def payload(self) -> float | None:
        """[kg]; None if not even zero is carried, if the policy failed, and where the criterion does not apply."""
        return self.result.get("payload")

    @property
    def weight(self) -> str:
        """The payload in words; one that nothing stopped up to the end of the scan is a lower bound."""
        if self.payload is None:
            return "none"
        at_least = (self.result.get("limit") or {}).get("kind") == "scan_end"
        return f"{'≥ ' if at_least else ''}{self.payload:.2f}"


def find_bests(records: Sequence[Record]) -> dict[str, Best]:
    """The best found by :func:`motion_key`.

    Every payload that is carried by the task criterion without uncertainty was carried by some motion inside the
    limits, whatever the policy was told: none can be better than the best.
    """
    bests: dict[str, Best] = {}
    for record in records:
        if isinstance(record.cell, BestCell):
            payload = record.result["payload"] if record.result.get("verified") else None
            best = Best(cell=record.cell, result=record.result, payload=payload, raised_by=None)
            bests[motion_key(record.cell)] = best
    for record in records:
        cell, payload = record.cell, record.result.get("payload")
        if isinstance(cell, BestCell) or cell.criterion != "task" or cell.uncertainty or payload is None:
            continue
        found = bests.get(motion_key(cell))
        if found is not None and found.payload is not None and payload > found.payload:
            bests[motion_key(cell)] = replace(found, payload=payload, raised_by=_carrier(cell))
    return bests


def standings(records: Sequence[Record]) -> list[Standing]:
    """Every policy's cell with its score."""
    bests = find_bests(records)
    return [_standing(record, record.cell, bests) for record in records if isinstance(record.cell, PolicyCell)]


def motion_key(cell: PolicyCell | BestCell) -> str:
    """Tells apart what has a best found of its own."""
    return canonical([cell.env_id, dict(cell.trajectory), dict(cell.limits), cell.control_frequency, cell.stiffness])


@dataclass(frozen=True, kw_only=True)
class Column:
    """Conditions that all policies of a table meet."""

    information: str
    """See :data:`~cablebot_gym.benchmark.cells.TOLD_SHARE`."""
    uncertainty: str | None
    """What else is not known."""
    criterion: str
    """``task`` or ``paper``."""
    draws: int
    """Episodes at each payload."""

    @classmethod
    def of(cls, cell: PolicyCell) -> Column:
        """The column to which a cell belongs."""
        return cls(
            information=cell.information, uncertainty=cell.uncertainty, criterion=cell.criterion, draws=cell.draws
        )


@dataclass(frozen=True, kw_only=True)
class Board:
    """One environment's table: policies by conditions, for one kind of motion. Each place has one cell per motion."""

    env_id: str
    """Environment."""
    motion: str
    """Name of the motion, or of the family of motions."""
    columns: tuple[Column, ...]
    """In the order of the suite."""
    policies: tuple[str, ...]
    """The best first: by the score of the first column, of a family its median."""
    places: Mapping[tuple[str, Column], tuple[Standing, ...]]
    """Cells of a policy under conditions; several for a family of motions."""

    @property
    def motions(self) -> int:
        """How many there are: one, or a family."""
        return len({canonical(dict(one.cell.trajectory)) for some in self.places.values() for one in some})

    def share(self, policy: str, column: Column) -> Share | None:
        """The score of a policy in a column; None if it has none."""
        return _share(self.places.get((policy, column), ()))


@dataclass(frozen=True, kw_only=True)
class Share:
    """A score over one motion or several."""

    median: float
    """Of the motions."""
    worst: float
    """Of the motions."""


def boards(records: Sequence[Record]) -> list[Board]:
    """The tables, in the order of the records; what only maps have is not in them."""
    grouped: dict[tuple[str, str], list[Standing]] = {}
    for standing in standings(records):
        if unusual(standing.cell):
            continue
        grouped.setdefault((standing.cell.env_id, str(standing.cell.trajectory["name"])), []).append(standing)
    return [_board(env_id, motion, some) for (env_id, motion), some in grouped.items()]


@dataclass(frozen=True, kw_only=True)
class PayloadMap:
    """What policies carry on one environment's circle, told the payload, while one number of the task varies."""

    env_id: str
    """Environment."""
    axis: Axis
    """What varies."""
    values: tuple[float, ...]
    """Of the axis, SI, rising."""
    bests: tuple[float | None, ...]
    """Best found at each value [kg]; None where there is none."""
    policies: Mapping[str, tuple[Standing | None, ...]]
    """Standings of each at each value; None where it was not asked."""


def payload_maps(records: Sequence[Record]) -> list[PayloadMap]:
    """The maps that the records have: two values of an axis make one."""
    asked = [
        one
        for one in standings(records)
        if (one.cell.information, one.cell.uncertainty, one.cell.criterion) == ("told", None, "task")
    ]
    bests = find_bests(records)
    found = []
    for env_id in dict.fromkeys(one.cell.env_id for one in asked):
        for axis in AXES.values():
            off = [one for one in asked if one.cell.env_id == env_id and unusual(one.cell) == (axis.name,)]
            motions = {one.cell.trajectory["name"] for one in off}
            usual = [
                one
                for one in asked
                if one.cell.env_id == env_id and not unusual(one.cell) and one.cell.trajectory["name"] in motions
            ]
            if off:
                found.append(_map(env_id, axis, [*usual, *off], bests))
    return found


def _map(env_id: str, axis: Axis, some: Sequence[Standing], bests: Mapping[str, Best]) -> PayloadMap:
    values = tuple(sorted({axis.of(one.cell) for one in some}))
    carried = {(one.cell.policy, axis.of(one.cell)): one for one in some}
    known = {axis.of(one.cell): bests.get(motion_key(one.cell)) for one in some}
    varied = {one.cell.policy for one in some if unusual(one.cell)}
    return PayloadMap(
        env_id=env_id,
        axis=axis,
        values=values,
        bests=tuple(None if (best := known[value]) is None else best.payload for value in values),
        policies={
            policy: tuple(carried.get((policy, value)) for value in values)
            for policy in dict.fromkeys(one.cell.policy for one in some)
            if policy in varied
        },
    )


def _board(env_id: str, motion: str, some: Sequence[Standing]) -> Board:
    places: dict[tuple[str, Column], tuple[Standing, ...]] = {}
    for one in some:
        place = (one.cell.policy, Column.of(one.cell))
        places[place] = (*places.get(place, ()), one)
    columns = tuple(dict.fromkeys(column for _, column in places))

    def rank(policy: str) -> tuple[float, str]:
        share = _share(places.get((policy, columns[0]), ()))
        return (1.0 if share is None else -share.median), policy

    policies = sorted({policy for policy, _ in places}, key=rank)
    return Board(env_id=env_id, motion=motion, columns=columns, policies=tuple(policies), places=places)


def _share(some: Sequence[Standing]) -> Share | None:
    scores = [one.score for one in some if one.score is not None]
    return Share(median=median(scores), worst=min(scores)) if scores and len(scores) == len(some) else None


def _standing(record: Record, cell: PolicyCell, bests: Mapping[str, Best]) -> Standing:
    best = bests.get(motion_key(cell))
    reference = None if best is None else best.payload
    payload = record.result.get("payload")
    ranked = cell.criterion == "task" and record.error is None and reference is not None and reference > 0
    return Standing(
        cell=cell,
        result=record.result,
        best=reference,
        score=(payload or 0.0) / reference if ranked and reference else None,
        raised=ranked and cell.uncertainty is None and best is not None and best.raised_by == _carrier(cell),
    )


def _carrier(cell: PolicyCell) -> str:
    return f"{cell.policy}, {cell.information}"
