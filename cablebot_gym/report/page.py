"""The report page: the records of a benchmark and the replays of their cells in one self-contained
HTML file."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from statistics import median
from typing import Any

import numpy as np

from cablebot_gym.benchmark import scores
from cablebot_gym.benchmark.cells import (
    BestKnownCell,
    Cell,
    PolicyCell,
    Record,
    TimingCell,
    canonical,
)
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.maps import varied_fields
from cablebot_gym.benchmark.tables import (
    best_known_text,
    failures,
    fallbacks,
    heading,
    motion_title,
    task_title,
)
from cablebot_gym.evaluation.constraints import Violation
from cablebot_gym.rendering.moment import HANG, full_tension
from cablebot_gym.report.replay import LEVELS, RATE, Replay, platform_points
from cablebot_gym.trajectories import find_trajectory

SCRIPTS = ("charts.js", "table.js", "scene.js", "page.js")
"""Scripts of the page in order of their dependencies."""

BEST_KNOWN = "best known payload"
"""Label of a best known payload in the policy column."""

NOT_APPLICABLE = "The paper criterion applies only to policies that declare unsaturated_actions; this policy does not."

NO_EPISODE = "This page contains no episode of this cell. Run cablebot report RESULTS to record all episodes."


def merge_records(sources: Sequence[Results]) -> list[Record]:
    """The records of all sources; the first one of each cell."""
    merged: dict[str, Record] = {}
    for source in sources:
        for record in source.records:
            merged.setdefault(record.cell.key, record)
    return list(merged.values())


def html(
    title: str, sources: Sequence[Results], replays: Mapping[str, Sequence[Replay] | str]
) -> str:
    """The report page as HTML text.

    Args:
        title: heading of the page.
        sources: results of one or more suites.
        replays: episodes, or an error message, by key of the cell.
    """
    assets = files("cablebot_gym.report") / "assets"
    data = json.dumps(
        page_data(sources, replays), ensure_ascii=False, allow_nan=False, separators=(",", ":")
    )
    values = {
        "title": title.replace("&", "&amp;").replace("<", "&lt;"),
        "style": (assets / "style.css").read_text(encoding="utf-8"),
        "script": "\n".join((assets / name).read_text(encoding="utf-8") for name in SCRIPTS),
        "data": data.replace("<", "\\u003c"),  # excludes an end tag
    }
    page = (assets / "page.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda match: values[match[1]], page)


def page_data(
    sources: Sequence[Results], replays: Mapping[str, Sequence[Replay] | str]
) -> dict[str, Any]:
    """JSON-able data for the scripts of the page. For the arguments see :func:`html`."""
    records = merge_records(sources)
    all_scores = scores.scores(records)
    references = [
        best
        for best in scores.best_known_payloads(records).values()
        if not varied_fields(best.cell)
    ]
    by_key = {record.cell.key: record for record in records}
    robots, motions = _Unique(), _Unique()

    def entry(
        cell: Cell, label: str, facts: list[list[str]], reason: str = NO_EPISODE
    ) -> dict[str, Any]:
        facts = [*facts, _made_by(by_key[cell.key])]
        data = {
            "title": task_title(cell),
            "payload_label": label,
            "code": _code(cell),
            "facts": facts,
        }
        recorded = replays.get(cell.key, "")
        if isinstance(recorded, str):
            return data | {"replays": None, "reason": recorded or reason}
        shown = [replay.to_dict() for replay in recorded]
        return data | {
            "replays": shown,
            "robot": robots.add(_robot(cell)),
            "motion": motions.add(_motion(cell)),
        }

    cells = []
    for score in all_scores:
        reason = NO_EPISODE if score.result.get("applicable", True) else NOT_APPLICABLE
        cells.append(
            entry(
                score.cell, "unloaded" if score.payload is None else "DLCC", _facts(score), reason
            )
        )
    indices = {score.cell.key: index for index, score in enumerate(all_scores)}
    boards, rows = scores.leaderboards(records), []
    for leaderboard in boards:
        rows += [
            _row(leaderboard, policy, column, indices) for policy, column in leaderboard.entries
        ]
        for name in dict.fromkeys(column.motion for column in leaderboard.columns):
            motion = leaderboard.env_id, name
            group = [
                best
                for best in references
                if (best.cell.env_id, best.cell.trajectory["name"]) == motion
            ]
            if not group:
                continue
            rows.append(
                _best_row(leaderboard, name, group, range(len(cells), len(cells) + len(group)))
            )
            cells += [
                entry(best.cell, BEST_KNOWN, [["Best known payload", best_known_text(best)]])
                for best in group
            ]
    return {
        "rows": rows,
        "start": _start(rows, cells, boards),
        "cells": cells,
        "robots": robots.values,
        "motions": motions.values,
        "maps": [_map(payload_map) for payload_map in scores.payload_maps(records)],
        "notes": _notes(sources, records),
        "rate": RATE,
        "levels": LEVELS,
    }


def _start(
    rows: Sequence[Mapping[str, Any]],
    cells: Sequence[Mapping[str, Any]],
    boards: Sequence[scores.Leaderboard],
) -> int:
    """Index of the row that the page opens: the largest payload on the circle of the first
    leaderboard.

    A row without an episode is opened only if none of these rows has one.
    """
    if not boards:
        return 0
    board = boards[0]
    column = next(
        (column for column in board.columns if column.motion.startswith("circle-")),
        board.columns[0],
    )
    keys = {_row_key(board, policy, column) for policy in board.policies}

    def rank(index: int) -> tuple[bool, float]:
        row = rows[index]
        return cells[row["cells"][0]]["replays"] is not None, -1.0 if row[
            "payload"
        ] is None else row["payload"]

    return max((index for index, row in enumerate(rows) if row["key"] in keys), key=rank)


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


def _row(
    leaderboard: scores.Leaderboard, policy: str, column: scores.Column, indices: Mapping[str, int]
) -> dict[str, Any]:
    entry = leaderboard.entries[policy, column]
    fraction = leaderboard.fraction(policy, column)
    applicable = all(score.result.get("applicable", True) for score in entry)
    payloads = [score.payload or 0.0 for score in entry]
    failed = any(score.error is not None for score in entry)
    value = entry[0].payload_text if len(entry) == 1 else f"{median(payloads):.2f}"
    return _conditions(leaderboard, policy, column) | {
        "payload_text": "error" if failed else value if applicable else "n/a",
        "payload": None if failed or not applicable else median(payloads),
        "fraction": None if fraction is None else fraction.mean,
        "interval": [fraction.low, fraction.high]
        if fraction and len(entry) >= scores.RANKED_MOTIONS
        else None,
        "note": _note(entry, applicable, failed),
        "violation": _violation_text(entry),
        "cells": [indices[score.cell.key] for score in entry],
    }


def _best_row(
    leaderboard: scores.Leaderboard,
    motion: str,
    group: Sequence[scores.BestKnown],
    indices: Sequence[int],
) -> dict[str, Any]:
    payloads = [best.payload for best in group if best.payload is not None]
    payload = median(payloads) if len(payloads) == len(group) else None
    column = next(column for column in leaderboard.columns if column.motion == motion)
    return _conditions(leaderboard, BEST_KNOWN, column) | {
        "payload_text": "none" if payload is None else f"{payload:.2f}",
        "payload": payload,
        "fraction": None if payload is None else 1.0,
        "cells": [*indices],
    }


def _conditions(
    leaderboard: scores.Leaderboard, policy: str, column: scores.Column
) -> dict[str, Any]:
    return {
        "key": _row_key(leaderboard, policy, column),
        "id": leaderboard.env_id,
        "policy": policy,
        "motion": motion_title(column, leaderboard.motions(column)),
        "condition": heading(column).removesuffix(" [kg]"),
        "violation": "",
    }


def _row_key(leaderboard: scores.Leaderboard, policy: str, column: scores.Column) -> str:
    return canonical([leaderboard.env_id, column.motion, policy, heading(column)])


def _note(entry: Sequence[scores.Score], applicable: bool, failed: bool) -> str:
    """Reason for a missing fraction; empty if there is a fraction or if another column states the
    reason."""
    if not applicable:
        return "does not declare unsaturated_actions"
    cell = entry[0].cell
    searched = (
        all(score.best_known is not None for score in entry)
        or cell.criterion != "task"
        or cell.uncertainty
    )
    return "" if failed or searched else "no best known payload"


def _violation_text(entry: Sequence[scores.Score]) -> str:
    """Limiting violation for one motion; the kinds of violation and their counts for several
    motions."""
    violations = [
        violation for score in entry if (violation := limiting_violation(score)) is not None
    ]
    if len(entry) == 1:
        return str(violations[0]) if violations else (entry[0].error or "")
    counts = Counter(violation.kind for violation in violations)
    return ", ".join(f"{kind} {count} ×" for kind, count in counts.items())


def _code(cell: Cell) -> str:
    """Python code that computes a cell."""
    if isinstance(cell, BestKnownCell):
        module = "cablebot_gym.bounds.best_known"
        name = "find_best_known"
        lines = [repr(cell.env_id)]
    else:
        module = "cablebot_gym.evaluation"
        name = "evaluate_dlcc"
        lines = [repr(cell.policy), repr(cell.env_id)]
    options = cell.options() if isinstance(cell, PolicyCell) else cell.env_options()
    lines += [f"{option}={value!r}" for option, value in options.items() if value is not None]
    inner = "".join(f"    {line},\n" for line in lines)
    return f"import cablebot_gym\nfrom {module} import {name}\n\nprint({name}(\n{inner}))"


def _facts(score: scores.Score) -> list[list[str]]:
    result, cell = score.result, score.cell
    if score.error is not None:
        return [["Error", score.error]]
    if not result.get("applicable", True):
        return [["Not applicable", NOT_APPLICABLE]]
    intervals = [f"{low:.3f} to {high:.3f} kg" for low, high in result.get("feasible", [])]
    facts = [["Feasible payloads", ", ".join(intervals) or "none; the policy fails unloaded"]]
    if (violation := limiting_violation(score)) is not None:
        facts.append(["Limiting violation", str(violation)])
    if cell.draws > 1:
        bound = "is" if result.get("assured") else "is not assured to be"
        facts.append(
            [
                "Draws",
                f"{cell.draws}; the payload {bound} the 95/{100 * cell.probability:g} lower tolerance bound",
            ]
        )
    if result.get("failures"):
        counts = ", ".join(f"{kind}: {count}" for kind, count in result["failures"].items())
        facts.append(["Violations of the draws at a larger payload", counts])
    if score.best_known is not None:
        facts.append(["Best known payload", f"{score.best_known:.3f} kg"])
    if cell.model_payload_factor != 1.0:
        facts.append(["Payload model", f"{cell.model_payload_factor:g} times the nominal payload"])
    return facts


def limiting_violation(score: scores.Score) -> Violation | None:
    """Limiting violation of a score with the bound of its cell; None without a violation."""
    data = score.result.get("violation")
    if not data:
        return None
    violation = Violation(**data)
    return replace(violation, bound=score.cell.error_bounds.get(violation.kind))


def _made_by(record: Record) -> list[str]:
    return [
        "Provenance",
        f"code {record.source}, with " + ", ".join(f"{k} {v}" for k, v in record.versions.items()),
    ]


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
    trajectory = find_trajectory(dict(cell.trajectory), robot.kind)
    times = np.arange(np.ceil(trajectory.duration * RATE - 1e-9) + 1) / RATE
    path = trajectory(np.minimum(times, trajectory.duration)).position[:, : robot.base.shape[1]]
    return {
        "path": np.round(path, 6).tolist(),
        "bound": cell.error_bounds["position"],
        "rotation": cell.error_bounds["rotation"],
    }


def _map(payload_map: scores.PayloadMap) -> dict[str, Any]:
    def payload(score: scores.Score | None) -> float | None:
        return None if score is None or score.error is not None else score.payload or 0.0

    return {
        "id": payload_map.env_id,
        "label": ", ".join([*payload_map.constants, payload_map.axis.label]),
        "x": [round(value * payload_map.axis.scale, 9) for value in payload_map.values],
        "best_known": list(payload_map.best_known),
        "policies": [
            {"name": policy, "values": [payload(score) for score in entry]}
            for policy, entry in payload_map.policies.items()
        ],
    }


def _notes(sources: Sequence[Results], records: Sequence[Record]) -> list[dict[str, Any]]:
    references = [best_known_text(best) for best in scores.best_known_payloads(records).values()]
    sections = {
        "Commands": [f"suite {source.suite}: {source.command}" for source in sources],
        "Best known payloads": references or ["none in these results"],
        "Notes": [*failures(records), *fallbacks(records)],
    }
    return [{"title": title, "lines": lines} for title, lines in sections.items() if lines]


def replay_queries(records: Sequence[Record]) -> dict[str, tuple[Cell, float | None]]:
    """The cells whose episodes the page shows, with their DLCC [kg], by key.

    The best known payload of a map has no row and therefore no episode.
    """
    return {
        record.cell.key: (record.cell, record.result.get("payload"))
        for record in records
        if record.error is None
        and not isinstance(record.cell, TimingCell)
        and record.result.get("applicable", True)
        and not (isinstance(record.cell, BestKnownCell) and varied_fields(record.cell))
    }
