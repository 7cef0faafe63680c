"""The report page: the records of a benchmark and the replays of their cells in one self-contained HTML file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from statistics import median
from typing import Any

import numpy as np

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, Record, canonical
from cablebot_gym.benchmark.maps import varied_axes
from cablebot_gym.benchmark.scores import (
    BestKnown,
    Column,
    Leaderboard,
    PayloadMap,
    Score,
    best_known_payloads,
    leaderboards,
    payload_maps,
    scores,
)
from cablebot_gym.benchmark.tables import best_known_text, failures, fallbacks, heading, motion_title, task_title
from cablebot_gym.evaluation.constraints import Violation
from cablebot_gym.rendering.moment import HANG, full_tension
from cablebot_gym.report.replay import LEVELS, RATE, Replay, platform_points
from cablebot_gym.trajectories import find_trajectory

SCRIPTS = ("charts.js", "table.js", "scene.js", "page.js")
"""Scripts of the page in order of their dependencies."""

NO_MAPS = (
    "These results contain no payload maps. To add them, run cablebot benchmark --suite maps --out maps, then "
    "cablebot report RESULTS maps."
)

BEST_KNOWN = "best known payload"
"""Label of a best known payload in the policy column."""

NOT_APPLICABLE = "The paper criterion applies only to policies that declare unsaturated_actions; this policy does not."

NO_EPISODE = "This page contains no episode of this cell. Run cablebot report RESULTS to record all episodes."


@dataclass(frozen=True)
class Source:
    """The results of one suite."""

    suite: str
    """Name of the suite."""
    command: str
    """Command that computes the results."""
    records: Sequence[Record]
    """Records of all cells."""


def merge_records(sources: Sequence[Source]) -> list[Record]:
    """The records of all sources; the first one of each cell."""
    merged: dict[str, Record] = {}
    for source in sources:
        for record in source.records:
            merged.setdefault(record.cell.key, record)
    return list(merged.values())


def html(title: str, sources: Sequence[Source], replays: Mapping[str, Sequence[Replay] | str]) -> str:
    """The report page as HTML text.

    Args:
        title: heading of the page.
        sources: results of one or more suites.
        replays: episodes, or an error message, by key of the cell.
    """
    assets = files("cablebot_gym.report") / "assets"

    def read(name: str) -> str:
        return (assets / name).read_text(encoding="utf-8")

    data = json.dumps(page_data(sources, replays), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    values = {
        "title": title.replace("&", "&amp;").replace("<", "&lt;"),
        "style": read("style.css"),
        "script": "\n".join(map(read, SCRIPTS)),
        "data": data.replace("<", "\\u003c"),  # excludes an end tag
    }
    before, *rest = read("page.html").split("{{")
    pieces = [before]
    for piece in rest:  # in one pass, because inserted text may contain braces
        name, _, after = piece.partition("}}")
        pieces += [values[name], after]
    return "".join(pieces)


def page_data(sources: Sequence[Source], replays: Mapping[str, Sequence[Replay] | str]) -> dict[str, Any]:
    """JSON-able data for the scripts of the page. For the arguments see :func:`html`."""
    records = merge_records(sources)
    all_scores = scores(records)
    references = [best for best in best_known_payloads(records).values() if not varied_axes(best.cell)]
    by_key = {record.cell.key: record for record in records}
    robots, motions = _Unique(), _Unique()
    cells = [_cell(score, by_key[score.cell.key], replays, robots, motions) for score in all_scores]
    indices = {score.cell.key: index for index, score in enumerate(all_scores)}
    rows = []
    for leaderboard in leaderboards(records):
        rows += [_row(leaderboard, policy, column, indices) for policy, column in leaderboard.entries]
        group = [best for best in references if _belongs(best.cell, leaderboard)]
        if group:
            rows.append(_best_row(leaderboard, group, range(len(cells), len(cells) + len(group))))
            cells += [_best_cell(best, by_key[best.cell.key], replays, robots, motions) for best in group]
    return {
        "rows": rows,
        "cells": cells,
        "robots": robots.values,
        "motions": motions.values,
        "maps": [_map(payload_map) for payload_map in payload_maps(records)],
        "notes": _notes(sources, records),
        "no_maps": NO_MAPS,
        "rate": RATE,
        "levels": LEVELS,
    }


class _Unique:
    """A list of distinct JSON-able values."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self._indices: dict[str, int] = {}

    def add(self, value: Any) -> int:
        """The index of a value, which is appended if it is new."""
        key = canonical(value)
        if key not in self._indices:
            self._indices[key] = len(self.values)
            self.values.append(value)
        return self._indices[key]


def _row(leaderboard: Leaderboard, policy: str, column: Column, indices: Mapping[str, int]) -> dict[str, Any]:
    entry = leaderboard.entries[policy, column]
    fraction = leaderboard.fraction(policy, column)
    applicable = all(score.result.get("applicable", True) for score in entry)
    payloads = [score.payload or 0.0 for score in entry]
    failed = any(score.error is not None for score in entry)
    value = entry[0].payload_text if len(entry) == 1 else f"{median(payloads):.2f}"
    payload_text = "error" if failed else value if applicable else "n/a"
    return {
        "key": canonical([leaderboard.env_id, leaderboard.motion, policy, heading(column)]),
        "id": leaderboard.env_id,
        "policy": policy,
        "motion": motion_title(leaderboard).removesuffix(": median and worst fraction"),
        "condition": heading(column).removesuffix(" [kg]"),
        "payload_text": payload_text,
        "payload": None if failed or not applicable else median(payloads),
        "fraction": None if fraction is None else fraction.median,
        "interval": _interval(entry),
        "raised": any(score.raised for score in entry),
        "note": _note(entry, applicable, failed),
        "violation": _violation_text(entry),
        "cells": [indices[score.cell.key] for score in entry],
    }


def _belongs(cell: BestKnownCell, leaderboard: Leaderboard) -> bool:
    return (cell.env_id, str(cell.trajectory["name"])) == (leaderboard.env_id, leaderboard.motion)


def _best_row(leaderboard: Leaderboard, group: Sequence[BestKnown], indices: Sequence[int]) -> dict[str, Any]:
    payloads = [best.result["payload"] for best in group if best.result.get("verified")]
    payload = median(payloads) if len(payloads) == len(group) else None
    return {
        "key": canonical([leaderboard.env_id, leaderboard.motion, BEST_KNOWN]),
        "id": leaderboard.env_id,
        "policy": BEST_KNOWN,
        "motion": motion_title(leaderboard).removesuffix(": median and worst fraction"),
        "condition": heading(leaderboard.columns[0]).removesuffix(" [kg]"),
        "payload_text": "none" if payload is None else f"{payload:.2f}",
        "payload": payload,
        "fraction": None
        if payload is None
        else median(best.result["payload"] / (best.payload or 1.0) for best in group),
        "interval": None,
        "raised": False,
        "note": "",
        "violation": "",
        "cells": [*indices],
    }


def _note(entry: Sequence[Score], applicable: bool, failed: bool) -> str:
    """Reason for a missing fraction; empty if there is a fraction or if another column states the reason."""
    if not applicable:
        return "does not declare unsaturated_actions"
    searched = all(score.best_known is not None for score in entry) or entry[0].cell.criterion != "task"
    return "" if failed or searched else "no best known payload"


def _interval(entry: Sequence[Score]) -> list[float] | None:
    """Fractions of the worst and best motion; with draws, those of the assured payload and the DLCC.

    The assured payload is a 95/95 lower tolerance bound.
    """
    if len(entry) > 1:
        values = [score.score for score in entry if score.score is not None]
        return [min(values), max(values)] if len(values) == len(entry) else None
    score = entry[0]
    if score.cell.draws == 1 or score.score is None or not score.best_known:
        return None
    return [(score.result.get("assured_payload") or 0.0) / score.best_known, score.score]


def _violation_text(entry: Sequence[Score]) -> str:
    """Limiting violation for one motion; the kinds of violation and their counts for several motions."""
    violations = [Violation(**score.result["violation"]) for score in entry if score.result.get("violation")]
    if len(entry) == 1:
        return str(violations[0]) if violations else (entry[0].error or "")
    kinds = [violation.kind for violation in violations]
    return ", ".join(f"{kind} {kinds.count(kind)} ×" for kind in dict.fromkeys(kinds))


def _cell(
    score: Score,
    record: Record,
    replays: Mapping[str, Sequence[Replay] | str],
    robots: _Unique,
    motions: _Unique,
) -> dict[str, Any]:
    cell = score.cell
    reason = NO_EPISODE if score.result.get("applicable", True) else NOT_APPLICABLE
    return _episodes(cell, replays.get(cell.key, ""), robots, motions, reason) | {
        "title": task_title(cell),
        "payload_label": "unloaded" if score.payload is None else "DLCC",
        "code": _code("cablebot_gym.evaluation", "evaluate_dlcc", [cell.policy, cell.env_id], cell.options()),
        "facts": _facts(score, record),
    }


def _best_cell(
    best: BestKnown,
    record: Record,
    replays: Mapping[str, Sequence[Replay] | str],
    robots: _Unique,
    motions: _Unique,
) -> dict[str, Any]:
    return _episodes(best.cell, replays.get(best.cell.key, ""), robots, motions) | {
        "title": task_title(best.cell),
        "payload_label": BEST_KNOWN,
        "code": _code("cablebot_gym.bounds.best_known", "find_best_known", [best.cell.env_id], best.cell.options()),
        "facts": [["Best known payload", best_known_text(best)], _made_by(record)],
    }


def _episodes(
    cell: Cell, replays: Sequence[Replay] | str, robots: _Unique, motions: _Unique, reason: str = NO_EPISODE
) -> dict[str, Any]:
    if isinstance(replays, str):
        return {"replays": None, "reason": replays or reason}
    return {
        "replays": [replay.to_dict() for replay in replays],
        "robot": robots.add(_robot(cell)),
        "motion": motions.add(_motion(cell)),
    }


def _code(module: str, function: str, arguments: Sequence[str], options: Mapping[str, Any]) -> str:
    """Python code that computes a cell."""
    lines = [repr(value) for value in arguments]
    lines += [f"{name}={value!r}" for name, value in options.items() if value is not None]
    inner = "".join(f"    {line},\n" for line in lines)
    return f"import cablebot_gym\nfrom {module} import {function}\n\nprint({function}(\n{inner}))"


def _facts(score: Score, record: Record) -> list[list[str]]:
    result, cell = score.result, score.cell
    facts = [_made_by(record)]
    if score.error is not None:
        return [["Error", score.error], *facts]
    if not result.get("applicable", True):
        return [["Not applicable", NOT_APPLICABLE], *facts]
    if cell.model_payload_factor != 1.0:
        text = f"{cell.model_payload_factor:g} times the nominal payload"
        facts.insert(0, ["Payload model", text])
    if score.best_known is not None:
        facts.insert(0, ["Best known payload", f"{score.best_known:.3f} kg"])
    if result.get("failures"):
        facts.insert(
            0,
            [
                "Violations of the draws at a larger payload",
                ", ".join(f"{k}: {n}" for k, n in result["failures"].items()),
            ],
        )
    if cell.draws > 1:
        assured = result.get("assured_payload")
        text = "none" if assured is None else f"{assured:.3f} kg"
        facts.insert(
            0,
            ["Draws", f"{cell.draws}; success rate {cell.probability:.0%}; 95/95 lower tolerance bound: {text}"],
        )
    if result.get("violation"):
        facts.insert(0, ["Limiting violation", str(Violation(**result["violation"]))])
    intervals = [f"{low:.3f} to {high:.3f} kg" for low, high in result.get("feasible", [])]
    facts.insert(0, ["Feasible payloads", ", ".join(intervals) or "none; the policy fails unloaded"])
    return facts


def _made_by(record: Record) -> list[str]:
    return ["Provenance", f"code {record.source}, with " + ", ".join(f"{k} {v}" for k, v in record.versions.items())]


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
        "bound": cell.error_bounds["position"],
        "rotation": cell.error_bounds["rotation"],
    }


def _map(payload_map: PayloadMap) -> dict[str, Any]:
    def payload(score: Score | None) -> float | None:
        return None if score is None or score.error is not None else score.payload or 0.0

    return {
        "id": payload_map.env_id,
        "label": payload_map.axis.label,
        "x": [round(value * payload_map.axis.scale, 9) for value in payload_map.values],
        "best_known": list(payload_map.best_known),
        "policies": [
            {"name": policy, "values": [payload(score) for score in entry]}
            for policy, entry in payload_map.policies.items()
        ],
    }


def _notes(sources: Sequence[Source], records: Sequence[Record]) -> list[dict[str, Any]]:
    references = [best_known_text(best) for best in best_known_payloads(records).values()]
    sections = [
        {
            "title": "Definitions",
            "lines": [
                "The dynamic load carrying capacity (DLCC) is the upper end of the interval of feasible payloads that "
                "starts at zero. A scan finds the interval, and a bisection refines its end.",
                "The task criterion requires, at every physics step, a position error within R, a rotation error "
                "within its bound and no slack cable. Motor torques are clipped.",
                "Fractions refer to the best known payload for the same robot, motion and error bounds. It is "
                "verified by replay.",
                "The page shows the episode at the DLCC, or the unloaded episode if the policy fails unloaded, and an "
                "episode at a slightly larger payload. For cells with draws, they are those of the first draw. For a "
                "best known payload, the page shows the open-loop replay of its actions.",
                "The code under 'How this number is computed' reproduces the number of each row.",
            ],
        },
        {"title": "Commands", "lines": [f"suite {source.suite}: {source.command}" for source in sources]},
        {"title": "Best known payloads", "lines": references or ["none in these results"]},
    ]
    notes = [*failures(records), *fallbacks(records)]
    return sections + ([{"title": "Notes", "lines": notes}] if notes else [])


def replay_queries(records: Sequence[Record]) -> dict[str, tuple[Cell, float | None]]:
    """The cells whose episodes the page shows, with their DLCC [kg], by key."""
    return {
        record.cell.key: (record.cell, record.result.get("payload"))
        for record in records
        if record.error is None and record.result.get("applicable", True) and not _only_in_map(record.cell)
    }


def _only_in_map(cell: Cell) -> bool:
    """Whether a cell is the best known payload of a map, which has no row and therefore no episode."""
    return isinstance(cell, BestKnownCell) and bool(varied_axes(cell))
