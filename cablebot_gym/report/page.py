"""The report page: the rows of a benchmark and their replays in one self-contained HTML file."""

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
from cablebot_gym.benchmark.ranking import RANKED_MOTIONS
from cablebot_gym.benchmark.rows import Row, canonical
from cablebot_gym.benchmark.store import Results
from cablebot_gym.benchmark.tables import (
    failures,
    heading,
    motion_title,
    task_title,
)
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.judge import LIMIT_NAMES, Violation
from cablebot_gym.rendering.moment import HANG, full_tension
from cablebot_gym.rendering.projection import points_in_space, view_direction
from cablebot_gym.report.replay import LEVELS, RATE, Replay, platform_points

SCRIPTS = ("charts.js", "table.js", "scene.js", "page.js")
"""Scripts of the page in order of their dependencies."""

SHOWN_MOTIONS = 5
"""Number of motions of a family whose episodes the page shows."""

NO_EPISODE = (
    "This page contains no episode of this row. Run cablebot report RESULTS to record all episodes."
)


def merged_rows(sources: Sequence[Results]) -> list[Row]:
    """The rows of all sources; the first one of those that differ in the seed alone."""
    merged: dict[str, Row] = {}
    for source in sources:
        for row in source.rows:
            key = row.key
            if row.measure == "payload":
                key = replace(row, conditions=replace(row.conditions, seed=0)).key
            merged.setdefault(key, row)
    return list(merged.values())


def html(
    title: str, sources: Sequence[Results], replays: Mapping[str, Sequence[Replay] | str]
) -> str:
    """The report page as HTML text.

    Args:
        title: heading of the page.
        sources: results of one or more suites.
        replays: episodes, or an error message, by key of the row.
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
    merged = merged_rows(sources)
    cells = _Cells(replays)
    indices = {}
    for score in shown_scores(merged):
        indices[score.row.key] = cells.add(score)
    boards = scores.leaderboards(merged)
    rows = []
    for board in boards:
        for policy, column in board.entries:
            rows.append(_row(board, policy, column, indices))
    return {
        "rows": rows,
        "cells": cells.cells,
        "robots": list(cells.robots.values()),
        "motions": list(cells.motions.values()),
        "notes": _notes(sources, merged),
        "rate": RATE,
        "levels": LEVELS,
    }


class _Cells:
    """What the page shows of its rows, and the distinct robots and motions of their episodes."""

    def __init__(self, replays: Mapping[str, Sequence[Replay] | str]) -> None:
        self.cells: list[dict[str, Any]] = []
        self.robots: dict[str, dict[str, Any]] = {}
        self.motions: dict[str, dict[str, Any]] = {}
        self._replays = replays

    def add(self, score: scores.Score) -> int:
        """Adds the row of a score and returns its index."""
        row = score.row
        label = "DLCC"
        if score.payload is None:
            label = "unloaded"
        versions = ", ".join(f"{name} {version}" for name, version in row.versions.items())
        data: dict[str, Any] = {
            "title": task_title(row),
            "payload_label": label,
            "code": _code(row),
            "facts": [*_facts(score), ["Provenance", f"code {row.code}, with {versions}"]],
        }
        replays = self._replays.get(row.key, "")
        if isinstance(replays, str):
            data |= {"replays": None, "reason": replays or NO_EPISODE}
        else:
            data["replays"] = [vars(replay) for replay in replays]
            data["robot"] = _index(self.robots, _robot(row.conditions))
            data["motion"] = _index(self.motions, _motion(row.conditions))
        self.cells.append(data)
        return len(self.cells) - 1


def _index(values: dict[str, dict[str, Any]], value: dict[str, Any]) -> int:
    """Index of a JSON-able value among distinct ones, to which it is added if it is new."""
    key = canonical(value)
    values.setdefault(key, value)
    return list(values).index(key)


def _row(
    board: scores.Leaderboard, policy: str, column: Conditions, indices: Mapping[str, int]
) -> dict[str, Any]:
    """The row of a policy under the conditions of a column; ``indices`` of cells by their keys."""
    entry = board.entries[policy, column]
    payload = None
    if any(score.row.error is not None for score in entry):
        payload_text = "error"
    elif not all(score.applicable for score in entry):
        payload_text = "n/a"
    else:
        payload = median(score.payload or 0.0 for score in entry)
        payload_text = f"{payload:.2f}"
        if len(entry) == 1:
            payload_text = entry[0].payload_text
    fraction = board.fraction(policy, column)
    mean = None
    interval = None
    if fraction is not None:
        mean = fraction.mean
        if len(entry) >= RANKED_MOTIONS:
            interval = [fraction.low, fraction.high]
    return _conditions(board, policy, column) | {
        "payload_text": payload_text,
        "payload": payload,
        "fraction": mean,
        "interval": interval,
        "violation": _violation_text(entry),
        "cells": [indices[score.row.key] for score in entry if score.row.key in indices],
    }


def _conditions(board: scores.Leaderboard, policy: str, column: Conditions) -> dict[str, Any]:
    motion = column.trajectory["name"]
    return {
        "key": canonical([board.env_id, motion, policy, heading(column)]),
        "id": board.env_id,
        "policy": policy,
        "motion": motion_title(motion, board.motions(column)),
        "condition": heading(column).removesuffix(" [kg]"),
        "violation": "",
    }


def _violation_text(entry: Sequence[scores.Score]) -> str:
    """Limiting violation for one motion; the violated limits and their counts for several
    motions."""
    violations = [
        Violation.from_dict(score.result["violation"])
        for score in entry
        if score.result.get("violation")
    ]
    if len(entry) > 1:
        counts = Counter(LIMIT_NAMES[violation.kind] for violation in violations)
        return ", ".join(f"{limit} {count} ×" for limit, count in counts.items())
    if violations:
        return str(violations[0])
    return entry[0].row.error or ""


def _code(row: Row) -> str:
    """Python code that computes a row."""
    lines = [repr(row.policy), repr(row.conditions.env_id)]
    for option, value in {**row.conditions.keywords(), **row.search}.items():
        lines.append(f"{option}={value!r}")
    inner = "".join(f"    {line},\n" for line in lines)
    imports = "import cablebot_gym\nfrom cablebot_gym.evaluation import evaluate_dlcc"
    return f"{imports}\n\nprint(evaluate_dlcc(\n{inner}))"


def _facts(score: scores.Score) -> list[list[str]]:
    """Names and texts of the properties of a score."""
    result = score.result
    if score.row.error is not None:
        return [["Error", score.row.error]]
    if not score.applicable:
        return []
    intervals = [f"{low:.3f} to {high:.3f} kg" for low, high in result.get("feasible", [])]
    facts = [["Feasible payloads", ", ".join(intervals) or "none; the policy fails unloaded"]]
    if score.optimum is not None:
        facts.append(["Optimum of the motion", f"{score.optimum:.3f} kg"])
    return facts


def _robot(conditions: Conditions) -> dict[str, Any]:
    """Constants of the picture of a robot. ``axes`` are those of its base frame in the picture's
    space."""
    robot = conditions.nominal_robot
    points, cables = platform_points(robot)
    visible = points_in_space(robot, np.vstack([robot.base, robot.home[: robot.dimensions]]))
    low = visible.min(axis=0)
    high = visible.max(axis=0)
    azimuth, elevation = view_direction(robot)
    hang = HANG
    if robot.planar:
        hang = 0.0
    return {
        "name": robot.name,
        "base": robot.base.tolist(),
        "points": len(points),
        "cables": cables,
        "axes": points_in_space(robot, np.eye(robot.dimensions)).tolist(),
        "middle": ((low + high) / 2).tolist(),
        "azimuth": azimuth,
        "elevation": elevation,
        "size": float(np.linalg.norm(high - low)),
        "hang": hang,
        "leastTension": robot.minimum_tension,
        "fullTension": full_tension(robot),
    }


def _motion(conditions: Conditions) -> dict[str, Any]:
    """Reference path at the frames of a replay, and the error bounds."""
    robot = conditions.nominal_robot
    trajectory = conditions.motion
    times = np.arange(np.ceil(trajectory.duration * RATE - 1e-9) + 1) / RATE
    path = trajectory(np.minimum(times, trajectory.duration)).position[:, : robot.dimensions]
    return {
        "path": np.round(path, 6).tolist(),
        "bound": conditions.bounds.position,
        "rotation": conditions.bounds.rotation,
    }


def _notes(sources: Sequence[Results], rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Titles and lines of the notes below the tables."""
    commands = [f"suite {source.suite}: {source.command}" for source in sources]
    notes = [
        {"title": "Commands", "lines": commands},
        {"title": "Notes", "lines": failures(rows)},
    ]
    return [note for note in notes if note["lines"]]


def shown_scores(rows: Sequence[Row]) -> list[scores.Score]:
    """The scores that the page shows: all but those of most motions of a family."""
    shown = []
    counts: dict[tuple[str, Conditions], int] = {}
    for score in scores.scores(rows):
        group = (score.row.policy, scores.column_of(score.row))
        counts[group] = counts.get(group, 0) + 1
        if not score.row.family or counts[group] <= SHOWN_MOTIONS:
            shown.append(score)
    return shown


def replay_queries(rows: Sequence[Row]) -> dict[str, Row]:
    """The rows whose episodes the page shows, by key."""
    queries: dict[str, Row] = {}
    for score in shown_scores(rows):
        if score.row.error is None and score.applicable:
            queries[score.row.key] = score.row
    return queries
