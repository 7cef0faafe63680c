"""The page: what a benchmark's records and the replays of their cells say, in one file that needs no network."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from statistics import median
from typing import Any

import numpy as np

from cablebot_gym.benchmark.cells import BestCell, Cell, Record, canonical
from cablebot_gym.benchmark.maps import unusual
from cablebot_gym.benchmark.scores import (
    Best,
    Board,
    Column,
    PayloadMap,
    Standing,
    boards,
    find_bests,
    payload_maps,
    standings,
)
from cablebot_gym.benchmark.tables import best_text, failures, fallbacks, heading, motion_title, task_title
from cablebot_gym.evaluation.constraints import Limit
from cablebot_gym.rendering.moment import HANG, full_tension
from cablebot_gym.report.replay import LEVELS, RATE, Replay, platform_points
from cablebot_gym.trajectories import find_trajectory

SCRIPTS = ("charts.js", "table.js", "scene.js", "page.js")
"""In the order in which they need each other."""

NO_MAPS = (
    "There are none in these results. cablebot benchmark --suite maps --out maps makes them, and "
    "cablebot report RESULTS maps puts them here."
)


BEST_FOUND = "best found"
"""In place of a policy's name."""

NOT_APPLICABLE = "The paper's criterion is about laws that do not clip their commands; this policy does not say so."

NO_EPISODE = "This page has no episode of this cell: cablebot report RESULTS records one of each."


@dataclass(frozen=True)
class Source:
    """Where records come from: a suite's results."""

    suite: str
    """Its name."""
    command: str
    """What makes them."""
    records: Sequence[Record]
    """Of all cells."""


def merged(sources: Sequence[Source]) -> list[Record]:
    """All records; of a cell that is there twice, the first."""
    kept: dict[str, Record] = {}
    for source in sources:
        for record in source.records:
            kept.setdefault(record.cell.key, record)
    return list(kept.values())


def html(title: str, sources: Sequence[Source], replays: Mapping[str, Sequence[Replay] | str]) -> str:
    """The page.

    Args:
        title: heading.
        sources: results of one suite or several.
        replays: by the key of a cell: its episodes, or why there are none.
    """
    assets = files("cablebot_gym.report") / "assets"

    def read(name: str) -> str:
        return (assets / name).read_text(encoding="utf-8")

    data = json.dumps(page_data(sources, replays), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    parts = {
        "title": title.replace("&", "&amp;").replace("<", "&lt;"),
        "style": read("style.css"),
        "script": "\n".join(map(read, SCRIPTS)),
        "data": data.replace("<", "\\u003c"),  # no end tag can stand in it
    }
    before, *rest = read("page.html").split("{{")
    pieces = [before]
    for piece in rest:  # one pass: what is filled in may hold braces itself
        name, _, after = piece.partition("}}")
        pieces += [parts[name], after]
    return "".join(pieces)


def page_data(sources: Sequence[Source], replays: Mapping[str, Sequence[Replay] | str]) -> dict[str, Any]:
    """Everything that the page's scripts draw, JSON-able. Arguments as of :func:`html`."""
    records = merged(sources)
    some = standings(records)
    bests = [best for best in find_bests(records).values() if not unusual(best.cell)]
    by_key = {record.cell.key: record for record in records}
    robots, motions = _Numbered(), _Numbered()
    cells = [_cell(one, by_key[one.cell.key], replays, robots, motions) for one in some]
    places = {one.cell.key: place for place, one in enumerate(some)}
    rows = []
    for board in boards(records):
        rows += [_row(board, policy, column, places) for policy, column in board.places]
        some_bests = [best for best in bests if _belongs(best.cell, board)]
        if some_bests:
            rows.append(_best_row(board, some_bests, range(len(cells), len(cells) + len(some_bests))))
            cells += [_best_cell(best, by_key[best.cell.key], replays, robots, motions) for best in some_bests]
    return {
        "rows": rows,
        "cells": cells,
        "robots": robots.values,
        "motions": motions.values,
        "maps": [_map(found) for found in payload_maps(records)],
        "made": _made(sources, records),
        "words": {"no_maps": NO_MAPS},
        "rate": RATE,
        "levels": LEVELS,
    }


class _Numbered:
    """Different things, each once, by number."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self._places: dict[str, int] = {}

    def add(self, value: Any) -> int:
        key = canonical(value)
        if key not in self._places:
            self._places[key] = len(self.values)
            self.values.append(value)
        return self._places[key]


def _row(board: Board, policy: str, column: Column, places: Mapping[str, int]) -> dict[str, Any]:
    some = board.places[policy, column]
    share = board.share(policy, column)
    applicable = all(one.result.get("applicable", True) for one in some)
    payloads = [one.payload or 0.0 for one in some]
    failed = any(one.error is not None for one in some)
    alone = some[0].weight if len(some) == 1 else f"{median(payloads):.2f}"
    weight = "failed" if failed else alone if applicable else "n/a"
    return {
        "key": canonical([board.env_id, board.motion, policy, heading(column)]),
        "id": board.env_id,
        "policy": policy,
        "motion": motion_title(board).removesuffix(": median and worst share"),
        "condition": heading(column).removesuffix(" [kg]"),
        "weight": weight,
        "payload": None if failed or not applicable else median(payloads),
        "share": None if share is None else share.median,
        "interval": _interval(some),
        "raised": any(one.raised for one in some),
        "note": _note(some, applicable, failed),
        "limit": _gives_way(some),
        "cells": [places[one.cell.key] for one in some],
    }


def _belongs(cell: BestCell, board: Board) -> bool:
    return (cell.env_id, str(cell.trajectory["name"])) == (board.env_id, board.motion)


def _best_row(board: Board, some: Sequence[Best], places: Sequence[int]) -> dict[str, Any]:
    payloads = [best.result["payload"] for best in some if best.result.get("verified")]
    payload = median(payloads) if len(payloads) == len(some) else None
    return {
        "key": canonical([board.env_id, board.motion, BEST_FOUND]),
        "id": board.env_id,
        "policy": BEST_FOUND,
        "motion": motion_title(board).removesuffix(": median and worst share"),
        "condition": heading(board.columns[0]).removesuffix(" [kg]"),
        "weight": "none" if payload is None else f"{payload:.2f}",
        "payload": payload,
        "share": None if payload is None else median(best.result["payload"] / (best.payload or 1.0) for best in some),
        "interval": None,
        "raised": False,
        "note": "",
        "limit": "",
        "cells": [*places],
    }


def _note(some: Sequence[Standing], applicable: bool, failed: bool) -> str:
    """Why there is no share; nothing where there is one, or another column says so."""
    if not applicable:
        return "does not declare unclipped"
    searched = all(one.best is not None for one in some) or some[0].cell.criterion != "task"
    return "" if failed or searched else "no best found"


def _interval(some: Sequence[Standing]) -> list[float] | None:
    """Shares from the worst to the best motion, or from the assured payload to the payload."""
    if len(some) > 1:
        scores = [one.score for one in some if one.score is not None]
        return [min(scores), max(scores)] if len(scores) == len(some) else None
    one = some[0]
    if one.cell.draws == 1 or one.score is None or not one.best:
        return None
    return [(one.result.get("assured_payload") or 0.0) / one.best, one.score]


def _gives_way(some: Sequence[Standing]) -> str:
    """What is first beyond the payload, of one motion; the kinds of several."""
    limits = [Limit(**one.result["limit"]) for one in some if one.result.get("limit")]
    if len(some) == 1:
        return str(limits[0]) if limits else (some[0].error or "")
    kinds = [limit.kind for limit in limits]
    return ", ".join(f"{kind} {kinds.count(kind)} ×" for kind in dict.fromkeys(kinds))


def _cell(
    one: Standing,
    record: Record,
    replays: Mapping[str, Sequence[Replay] | str],
    robots: _Numbered,
    motions: _Numbered,
) -> dict[str, Any]:
    cell = one.cell
    none = NO_EPISODE if one.result.get("applicable", True) else NOT_APPLICABLE
    return _episodes(cell, replays.get(cell.key, ""), robots, motions, none) | {
        "title": task_title(cell),
        "carries": "not carried" if one.payload is None else "what it carries",
        "code": _code("cablebot_gym.evaluation", "evaluate_dlcc", [cell.policy, cell.env_id], cell.question()),
        "facts": _facts(one, record),
    }


def _best_cell(
    best: Best,
    record: Record,
    replays: Mapping[str, Sequence[Replay] | str],
    robots: _Numbered,
    motions: _Numbered,
) -> dict[str, Any]:
    return _episodes(best.cell, replays.get(best.cell.key, ""), robots, motions) | {
        "title": task_title(best.cell),
        "carries": "the best found",
        "code": _code("cablebot_gym.bounds.best_known", "best_found", [best.cell.env_id], best.cell.question()),
        "facts": [["Best found", best_text(best)], _made_by(record)],
    }


def _episodes(
    cell: Cell, seen: Sequence[Replay] | str, robots: _Numbered, motions: _Numbered, none: str = NO_EPISODE
) -> dict[str, Any]:
    if isinstance(seen, str):
        return {"replays": None, "why": seen or none}
    return {
        "replays": [replay.to_dict() for replay in seen],
        "robot": robots.add(_robot(cell)),
        "motion": motions.add(_motion(cell)),
    }


def _code(module: str, function: str, asked: Sequence[str], question: Mapping[str, Any]) -> str:
    """What computes a cell."""
    lines = [repr(value) for value in asked]
    lines += [f"{name}={value!r}" for name, value in question.items() if value is not None]
    inner = "".join(f"    {line},\n" for line in lines)
    return f"import cablebot_gym\nfrom {module} import {function}\n\nprint({function}(\n{inner}))"


def _facts(one: Standing, record: Record) -> list[list[str]]:
    result, cell = one.result, one.cell
    facts = [_made_by(record)]
    if one.error is not None:
        return [["Failed", one.error], *facts]
    if not result.get("applicable", True):
        return [["Not applicable", NOT_APPLICABLE], *facts]
    if cell.told_share != 1.0:
        text = f"{cell.told_share:g} times the true payload; payloads here are the true ones"
        facts.insert(0, ["What is told", text])
    if one.best is not None:
        facts.insert(0, ["Best found", f"{one.best:.3f} kg"])
    if result.get("failures"):
        facts.insert(0, ["Draws that fail beyond", ", ".join(f"{k}: {n}" for k, n in result["failures"].items())])
    if cell.draws > 1:
        assured = result.get("assured_payload")
        text = "none" if assured is None else f"{assured:.3f} kg"
        facts.insert(0, ["Draws", f"{cell.draws}, {cell.probability:.0%} have to carry it; assured: {text}"])
    if result.get("limit"):
        facts.insert(0, ["First beyond it", str(Limit(**result["limit"]))])
    intervals = [f"{low:.3f} to {high:.3f} kg" for low, high in result.get("feasible", [])]
    facts.insert(0, ["Carried", ", ".join(intervals) or "no payload that was tried, not even zero"])
    return facts


def _made_by(record: Record) -> list[str]:
    return ["Source", f"code {record.source}, with " + ", ".join(f"{k} {v}" for k, v in record.versions.items())]


def _robot(cell: Cell) -> dict[str, Any]:
    robot = cell.robot
    points, cables = platform_points(robot)
    base = robot.base
    low, high = base.min(axis=0), base.max(axis=0)
    reach = np.array(robot.home_pose[: base.shape[1]], float)
    low, high = np.minimum(low, reach), np.maximum(high, reach)
    return {
        "name": robot.name,
        "base": base.tolist(),
        "points": len(points),
        "cables": cables,
        "middle": [*((low + high) / 2).tolist(), *[0.0] * (3 - base.shape[1])],
        "size": float(np.linalg.norm(high - low)),
        "planar": robot.planar,
        "hang": 0.0 if robot.planar else HANG,
        "fullTension": full_tension(robot),
    }


def _motion(cell: Cell) -> dict[str, Any]:
    robot = cell.robot
    trajectory = find_trajectory(dict(cell.trajectory), robot.coordinates)
    times = np.arange(np.ceil(trajectory.duration * RATE - 1e-9) + 1) / RATE
    path = trajectory(np.minimum(times, trajectory.duration)).position[:, : robot.base.shape[1]]
    return {
        "path": np.round(path, 6).tolist(),
        "bound": cell.limits["position"],
        "rotation": cell.limits["rotation"],
    }


def _map(found: PayloadMap) -> dict[str, Any]:
    def payload(one: Standing | None) -> float | None:
        return None if one is None or one.error is not None else one.payload or 0.0

    return {
        "id": found.env_id,
        "label": found.axis.label,
        "x": [round(value * found.axis.scale, 9) for value in found.values],
        "bests": list(found.bests),
        "policies": [
            {"name": policy, "values": [payload(one) for one in some]} for policy, some in found.policies.items()
        ],
    }


def _made(sources: Sequence[Source], records: Sequence[Record]) -> list[dict[str, Any]]:
    bests = [best_text(best) for best in find_bests(records).values()]
    parts = [
        {
            "title": "A payload",
            "lines": [
                "is the upper end of the payloads that are carried, from zero on: scanned, then refined.",
                "Carried, by the task criterion: motors clip; the position error within R, the rotation error within "
                "its bound and no slack cable at every physics step.",
                "Shares are of the best found for the same robot, motion and limits; it is verified by replay.",
                "Episodes are those at the payload, or at zero if none is carried, and at a little more; of cells "
                "with draws, the first draw; of the best found, its own inputs without feedback.",
                "Each row's number is computed by the lines under 'How this number was made'.",
            ],
        },
        {"title": "These results", "lines": [f"suite {one.suite}: {one.command}" for one in sources]},
        {"title": "Best found", "lines": bests or ["none in these results"]},
    ]
    notes = [*failures(records), *fallbacks(records)]
    return parts + ([{"title": "Notes", "lines": notes}] if notes else [])


def replayed(records: Sequence[Record]) -> dict[str, tuple[Cell, float | None]]:
    """By key, the cells that have an episode, and the true payload that each carries [kg]."""
    return {
        record.cell.key: (record.cell, record.result.get("payload"))
        for record in records
        if record.error is None and record.result.get("applicable", True) and not _only_of_maps(record.cell)
    }


def _only_of_maps(cell: Cell) -> bool:
    """A best found of a map has no row, and so no place for an episode."""
    return isinstance(cell, BestCell) and bool(unusual(cell))
