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
from cablebot_gym.benchmark.cells import BestKnownCell, Cell, PolicyCell, canonical
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.records import Record, single_records
from cablebot_gym.benchmark.tables import (
    best_known_text,
    error_title,
    failures,
    fallbacks,
    heading,
    limiting_violation,
    motion_title,
    task_title,
)
from cablebot_gym.evaluation.constraints import LIMIT_NAMES, Violation
from cablebot_gym.rendering.moment import HANG, full_tension
from cablebot_gym.rendering.projection import points_in_space, view_direction
from cablebot_gym.report.replay import LEVELS, RATE, Replay, platform_points
from cablebot_gym.report.violations import violation_strips
from cablebot_gym.trajectories import find_trajectory

SCRIPTS = ("charts.js", "limits.js", "table.js", "scene.js", "page.js")
"""Scripts of the page in order of their dependencies."""

BEST_KNOWN = "best known payload"
"""Label of a best known payload in the policy column."""

NOT_APPLICABLE = "The paper criterion applies only to policies that declare unsaturated_actions; this policy does not."

SHOWN_MOTIONS = 5
"""Number of motions of a family whose episodes the page shows."""

NO_EPISODE = "This page contains no episode of this cell. Run cablebot report RESULTS to record all episodes."


def merge_records(sources: Sequence[Results]) -> list[Record]:
    """The records of all sources, those of surveys for each motion; the first one of each cell.
    Cells of a policy that differ in the evaluation seed alone count as one."""
    merged: dict[str, Record] = {}
    for source in sources:
        for record in single_records(source.records):
            cell = record.cell
            if isinstance(cell, PolicyCell):
                cell = replace(cell, seed=0)
            merged.setdefault(cell.key, record)
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
    cells = _Cells(records, replays)
    indices = {}
    for score in shown_scores(records):
        indices[score.cell.key] = cells.add_score(score)
    references = list(scores.best_known_payloads(records).values())
    boards = scores.leaderboards(records)
    rows = []
    last_boards = {board.env_id: board for board in boards}
    for board in boards:
        for policy, column in board.entries:
            rows.append(_row(board, policy, column, indices))
        if board is last_boards[board.env_id]:
            rows += _best_known_rows(board, references, cells)
    return {
        "rows": rows,
        "start": _start(rows, cells.cells),
        "cells": cells.cells,
        "robots": list(cells.robots.values()),
        "motions": list(cells.motions.values()),
        "limits": _limits(boards),
        "errors": _errors(records),
        "notes": _notes(sources, records),
        "rate": RATE,
        "levels": LEVELS,
    }


class _Cells:
    """Data of the cells of a page, and the distinct robots and motions of their episodes."""

    def __init__(
        self, records: Sequence[Record], replays: Mapping[str, Sequence[Replay] | str]
    ) -> None:
        self.cells: list[dict[str, Any]] = []
        self.robots: dict[str, dict[str, Any]] = {}
        self.motions: dict[str, dict[str, Any]] = {}
        self._replays = replays
        self._records = {record.cell.key: record for record in records}

    def add_score(self, score: scores.Score) -> int:
        """Adds the cell of a score and returns its index."""
        label = "DLCC"
        if score.payload is None:
            label = "unloaded"
        reason = NO_EPISODE
        if not _applicable(score):
            reason = NOT_APPLICABLE
        return self.add(score.cell, label, _facts(score), reason)

    def add(
        self,
        cell: PolicyCell | BestKnownCell,
        label: str,
        facts: list[list[str]],
        reason: str = NO_EPISODE,
    ) -> int:
        """Adds a cell and returns its index.

        Args:
            cell: the cell.
            label: label of its payload.
            facts: names and texts of its properties.
            reason: reason for the missing episodes, if neither episodes nor an error message are
                given.
        """
        record = self._records[cell.key]
        versions = ", ".join(f"{name} {version}" for name, version in record.versions.items())
        data: dict[str, Any] = {
            "title": task_title(cell),
            "payload_label": label,
            "code": _code(cell),
            "facts": [*facts, ["Provenance", f"code {record.source}, with {versions}"]],
        }
        replays = self._replays.get(cell.key, "")
        if isinstance(replays, str):
            data |= {"replays": None, "reason": replays or reason}
        else:
            data["replays"] = [replay.to_dict() for replay in replays]
            data["robot"] = _index(self.robots, _robot(cell))
            data["motion"] = _index(self.motions, _motion(cell))
        self.cells.append(data)
        return len(self.cells) - 1


def _index(values: dict[str, dict[str, Any]], value: dict[str, Any]) -> int:
    """Index of a JSON-able value among distinct ones, to which it is added if it is new."""
    key = canonical(value)
    values.setdefault(key, value)
    return list(values).index(key)


def _start(rows: Sequence[Mapping[str, Any]], cells: Sequence[Mapping[str, Any]]) -> int:
    """Index of the row that the page opens: the largest payload of a policy on the circle of the
    first table that has it.

    A row without an episode is opened only if none of these rows has one.
    """

    def rank(index: int) -> tuple[bool, float]:
        row = rows[index]
        payload = row["payload"]
        if payload is None:
            payload = -1.0
        return cells[row["cells"][0]]["replays"] is not None, payload

    if not rows:
        return 0
    circles = [row for row in rows if row["motion"] == "circle"]
    first = [*circles, rows[0]][0]
    same = ("id", "motion", "condition")
    shown = []
    for index, row in enumerate(rows):
        if row["policy"] != BEST_KNOWN and all(row[name] == first[name] for name in same):
            shown.append(index)
    return max(shown, key=rank)


def _row(
    board: scores.Leaderboard, policy: str, column: scores.Column, indices: Mapping[str, int]
) -> dict[str, Any]:
    """The row of a policy under the conditions of a column; ``indices`` of cells by their keys."""
    entry = board.entries[policy, column]
    payload = None
    if any(score.error is not None for score in entry):
        payload_text = "error"
    elif not all(map(_applicable, entry)):
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
        if len(entry) >= scores.RANKED_MOTIONS:
            interval = [fraction.low, fraction.high]
    return _conditions(board, policy, column) | {
        "payload_text": payload_text,
        "payload": payload,
        "fraction": mean,
        "interval": interval,
        "note": _note(entry),
        "violation": _violation_text(entry),
        "cells": [indices[score.cell.key] for score in entry if score.cell.key in indices],
    }


def _best_known_rows(
    board: scores.Leaderboard, references: Sequence[scores.BestKnown], cells: _Cells
) -> list[dict[str, Any]]:
    """The rows of the best known payloads of a leaderboard, one for each motion; their cells are
    added to ``cells``."""
    groups: dict[str, list[scores.BestKnown]] = {}
    for reference in references:
        if reference.cell.env_id == board.env_id:
            groups.setdefault(str(reference.cell.trajectory["name"]), []).append(reference)
    columns: dict[str, scores.Column] = {}
    for column in board.columns:
        columns.setdefault(column.motion, column)
    rows = []
    for motion, column in columns.items():
        if motion not in groups:
            continue
        indices: list[int] = []
        payloads = []
        for reference in groups[motion]:
            facts = [["Best known payload", best_known_text(reference)]]
            if len(indices) < SHOWN_MOTIONS:
                indices.append(cells.add(reference.cell, BEST_KNOWN, facts))
            if reference.payload is not None:
                payloads.append(reference.payload)
        row = _conditions(board, BEST_KNOWN, column)
        row |= {"payload_text": "none", "payload": None, "fraction": None, "cells": indices}
        if len(payloads) == len(groups[motion]):
            payload = median(payloads)
            row |= {"payload_text": f"{payload:.2f}", "payload": payload, "fraction": 1.0}
        rows.append(row)
    return rows


def _conditions(board: scores.Leaderboard, policy: str, column: scores.Column) -> dict[str, Any]:
    return {
        "key": _row_key(board, policy, column),
        "id": board.env_id,
        "policy": policy,
        "motion": motion_title(column, board.motions(column)),
        "condition": heading(column).removesuffix(" [kg]"),
        "violation": "",
    }


def _row_key(board: scores.Leaderboard, policy: str, column: scores.Column) -> str:
    return canonical([board.env_id, column.motion, policy, heading(column)])


def _applicable(score: scores.Score) -> bool:
    """Whether the criterion applies to the policy."""
    return bool(score.result.get("applicable", True))


def _note(entry: Sequence[scores.Score]) -> str:
    """Reason for a missing fraction; empty if there is a fraction or if another column states the
    reason."""
    if not all(map(_applicable, entry)):
        return "does not declare unsaturated_actions"
    if entry[0].cell.criterion != "task" or entry[0].cell.uncertainty:
        return ""
    for score in entry:
        if score.error is not None:
            return ""
    if all(score.best_known is not None for score in entry):
        return ""
    return "no best known payload"


def _violation_text(entry: Sequence[scores.Score]) -> str:
    """Limiting violation for one motion; the violated limits and their counts for several
    motions."""
    violations = [
        Violation(**score.result["violation"]) for score in entry if score.result.get("violation")
    ]
    if len(entry) > 1:
        counts = Counter(LIMIT_NAMES[violation.kind] for violation in violations)
        return ", ".join(f"{limit} {count} ×" for limit, count in counts.items())
    if violations:
        return str(violations[0])
    return entry[0].error or ""


def _code(cell: PolicyCell | BestKnownCell) -> str:
    """Python code that computes a cell."""
    if isinstance(cell, BestKnownCell):
        module = "cablebot_gym.bounds.best_known"
        name = "find_best_known"
        lines = [repr(cell.env_id)]
    else:
        module = "cablebot_gym.evaluation"
        name = "evaluate_dlcc"
        lines = [repr(cell.policy), repr(cell.env_id)]
    options = cell.env_options()
    if isinstance(cell, PolicyCell):
        options = cell.options()
    for option, value in options.items():
        if value is not None:
            lines.append(f"{option}={value!r}")
    inner = "".join(f"    {line},\n" for line in lines)
    return f"import cablebot_gym\nfrom {module} import {name}\n\nprint({name}(\n{inner}))"


def _facts(score: scores.Score) -> list[list[str]]:
    """Names and texts of the properties of a score."""
    result = score.result
    cell = score.cell
    if score.error is not None:
        return [["Error", score.error]]
    if not _applicable(score):
        return [["Not applicable", NOT_APPLICABLE]]
    intervals = [f"{low:.3f} to {high:.3f} kg" for low, high in result.get("feasible", [])]
    facts = [["Feasible payloads", ", ".join(intervals) or "none; the policy fails unloaded"]]
    violation = _violation_text([score])
    if violation:
        facts.append(["Limiting violation", violation])
    if cell.draws > 1:
        verb = "is not assured to be"
        if result.get("assured"):
            verb = "is"
        bound = f"the 95/{100 * cell.probability:g} lower tolerance bound"
        facts.append(["Draws", f"{cell.draws}; the payload {verb} {bound}"])
    if result.get("failures"):
        failures = result["failures"].items()
        counts = ", ".join(f"{LIMIT_NAMES[kind]}: {count}" for kind, count in failures)
        facts.append(["Violations of the draws at a larger payload", counts])
    if score.best_known is not None:
        facts.append(["Best known payload", f"{score.best_known:.3f} kg"])
    if cell.model_payload_factor != 1.0:
        facts.append(["Payload model", f"{cell.model_payload_factor:g} times the nominal payload"])
    return facts


def _robot(cell: Cell) -> dict[str, Any]:
    """Constants of the picture of a robot. ``axes`` are those of its base frame in the picture's
    space."""
    robot = cell.robot
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


def _motion(cell: Cell) -> dict[str, Any]:
    """Reference path of a cell at the frames of a replay, and its error bounds."""
    robot = cell.robot
    trajectory = find_trajectory(dict(cell.trajectory), robot.kind)
    times = np.arange(np.ceil(trajectory.duration * RATE - 1e-9) + 1) / RATE
    path = trajectory(np.minimum(times, trajectory.duration)).position[:, : robot.dimensions]
    return {
        "path": np.round(path, 6).tolist(),
        "bound": cell.error_bounds["position"],
        "rotation": cell.error_bounds["rotation"],
    }


def _limits(boards: Sequence[scores.Leaderboard]) -> list[dict[str, Any]]:
    """The violations of each policy over all robots and motions under the task criterion."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for board in boards:
        for (policy, column), entry in board.entries.items():
            violations = filter(None, map(limiting_violation, entry))
            if column.criterion == "task":
                groups.setdefault(policy, []).extend(violations)
    limits = []
    for policy, group in groups.items():
        if group:
            limits.append({"policy": policy, "strips": violation_strips(group)})
    return limits


def _errors(records: Sequence[Record]) -> list[dict[str, Any]]:
    """For each error table and policy: payloads with each error alone, 0 if it fails unloaded."""
    figures = []
    for table in scores.error_tables(records):
        for policy, entries in table.policies.items():
            bars = []
            for error, score in zip(table.errors, entries, strict=True):
                if score is not None and score.error is None:
                    name = error.replace("_", " ")
                    bars.append(
                        {
                            "error": name,
                            "payload": score.payload or 0.0,
                            "text": score.payload_text,
                        }
                    )
            figures.append({"title": f"{policy}, {error_title(table)}", "bars": bars})
    return figures


def _notes(sources: Sequence[Results], records: Sequence[Record]) -> list[dict[str, Any]]:
    """Titles and lines of the notes below the tables."""
    commands = [f"suite {source.suite}: {source.command}" for source in sources]
    references = list(map(best_known_text, scores.best_known_payloads(records).values()))
    notes = [
        {"title": "Commands", "lines": commands},
        {"title": "Best known payloads", "lines": references or ["none in these results"]},
        {"title": "Notes", "lines": [*failures(records), *fallbacks(records)]},
    ]
    return [note for note in notes if note["lines"]]


def shown_scores(records: Sequence[Record]) -> list[scores.Score]:
    """The scores whose cells the page shows: all but those of most motions of a survey."""
    shown = []
    counts: dict[tuple[str, str, scores.Column], int] = {}
    for score in scores.scores(records):
        group = (score.cell.env_id, score.cell.policy, scores.Column.of(score.cell))
        counts[group] = counts.get(group, 0) + 1
        if not group[-1].is_family or counts[group] <= SHOWN_MOTIONS:
            shown.append(score)
    return shown


def replay_queries(records: Sequence[Record]) -> dict[str, tuple[Cell, float | None]]:
    """The cells whose episodes the page shows, with their DLCC [kg], by key."""
    queries: dict[str, tuple[Cell, float | None]] = {}
    for score in shown_scores(records):
        if score.error is None and _applicable(score):
            queries[score.cell.key] = (score.cell, score.payload)
    motions: dict[tuple[str, str], int] = {}
    for reference in scores.best_known_payloads(records).values():
        family = (reference.cell.env_id, str(reference.cell.trajectory["name"]))
        motions[family] = motions.get(family, 0) + 1
        if motions[family] <= SHOWN_MOTIONS and "error" not in reference.result:
            queries[reference.cell.key] = (reference.cell, reference.result.get("payload"))
    return queries
