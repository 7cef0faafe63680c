"""The benchmark's page in Markdown and its results as JSON, from which the page can be made again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from cablebot_gym.benchmark.cells import Record, cell_from
from cablebot_gym.benchmark.maps import unusual
from cablebot_gym.benchmark.scores import Best, Board, boards, find_bests, payload_maps, standings
from cablebot_gym.benchmark.suites import find_suite
from cablebot_gym.benchmark.tables import (
    failures,
    fallbacks,
    heading,
    map_rows,
    map_title,
    motion_title,
    place,
    task_title,
)

_HEAD = """# Leaderboard

Each policy's payload [kg] and its share of the best found: the largest payload for which some motion inside the same
limits is known. The best found is verified by replay, and a lower bound of what is possible. All by the task criterion:
motors clip; position error ≤ {position:g} mm, rotation error ≤ {rotation:g} mrad, no slack cable at any physics step.

* told, not told: whether the policy knows the payload; told 0.9 ×: it is told that share of the true one.
* `table6`, `sensors`: what else it does not know; a payload counts as carried if it is in at least {probability:.0%} of
  {draws} draws, the same ones for everybody. The share refers to the best found without uncertainty.
* none: not even zero payload is carried, score 0. n/a: the policy does not declare `unclipped`. –: not asked.
  failed: it raised, or returned no drive command, see the notes.
* The paper's criterion (|a| ≤ 1 at every control instant, no bound of rotation) is a column and no rank.
* Held-out motions are drawn from a seeded family, on which nothing was tuned.

Rows are in the order of the first column.
"""


def results_json(suite: str, command: str, records: Sequence[Record]) -> str:
    """All results of a suite and the command that made them, one cell a line; the same bytes for the same results."""
    scored, versions = iter(standings(records)), _versions(records)
    lines = []
    for record in records:
        entry: dict[str, Any] = {
            "cell": record.cell.to_dict(),
            "source": record.source,
            "versions": versions.index(record.versions),
            "result": record.result,
        }
        if entry["cell"]["kind"] == "policy":
            one = next(scored)
            entry |= {"best_found": one.best, "score": one.score, "raised": one.raised}
        lines.append(json.dumps(entry, ensure_ascii=False, allow_nan=False))
    head = {"suite": suite, "command": command, "versions": versions}
    parts = [f" {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in head.items()]
    parts.append(' "cells": [\n  ' + ",\n  ".join(lines) + "\n ]")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def read_results(text: str) -> tuple[str, str, list[Record]]:
    """Suite, command and records of the text that :func:`results_json` wrote."""
    data = json.loads(text)
    records = [
        Record(
            cell=cell_from(entry["cell"]),
            source=entry["source"],
            versions=data["versions"][entry["versions"]],
            result=entry["result"],
            seconds=0.0,
        )
        for entry in data["cells"]
    ]
    return data["suite"], data["command"], records


def markdown(suite: str, command: str, records: Sequence[Record]) -> str:
    """The page: tables by environment, the best found, and what has to be said of them.

    Args:
        suite: name of the suite.
        command: what makes these results.
        records: of the suite's cells.
    """
    some = standings(records)
    usual = next((one.cell for one in some if not unusual(one.cell)), some[0].cell)
    drawn = [one.cell for one in some if one.cell.draws > 1]
    text = _HEAD.format(
        position=1e3 * usual.limits["position"],
        rotation=1e3 * usual.limits["rotation"],
        probability=drawn[0].probability if drawn else 0.95,
        draws=drawn[0].draws if drawn else "the",
    )
    every = boards(records)
    for env_id in dict.fromkeys(board.env_id for board in every):
        text += f"\n## {env_id}\n"
        for board in every:
            if board.env_id == env_id:
                text += f"\n{_sentence(motion_title(board))}:\n\n{_board(board)}"
    for found in payload_maps(records):
        text += f"\n## {map_title(found)}\n\n{_table(map_rows(found))}"
    text += f"\n## Best found\n\n{_bests(list(find_bests(records).values()))}"
    notes = [*failures(records), *fallbacks(records)]
    if notes:
        text += "\n## Notes\n\n" + "".join(f"* {note}\n" for note in notes)
    made_with = "; ".join(", ".join(f"{name} {value}" for name, value in one.items()) for one in _versions(records))
    return f"{text}\nSuite `{suite}` ({find_suite(suite).summary}), made by `{command}` with {made_with}.\n"


def _versions(records: Sequence[Record]) -> list[Mapping[str, str]]:
    """The different ones."""
    different: list[Mapping[str, str]] = []
    for record in records:
        if record.versions not in different:
            different.append(record.versions)
    return different


def _board(board: Board) -> str:
    rows = [["policy", *map(heading, board.columns)]]
    rows += [[f"`{policy}`", *(place(board, policy, column) for column in board.columns)] for policy in board.policies]
    return _table(rows)


def _bests(bests: Sequence[Best]) -> str:
    rows = [["id", "motion", "payload [kg]", "with platform [kg]", "no more than [kg]", ""]]
    for best in bests:
        upper = best.result.get("upper") or {}
        payload, total = best.result.get("payload"), best.result.get("total_mass")
        note = best.result.get("error") or ("" if best.payload is not None else "does not pass its replay")
        if best.raised_by:
            note = f"raised to {best.payload:.3f} kg, which {best.raised_by} carries*"
        numbers = [_number(value) for value in (payload, total, upper.get("payload"))]
        rows.append([best.cell.env_id, task_title(best.cell), *numbers, note])
    return _table(rows)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _table(rows: Sequence[Sequence[str]]) -> str:
    cells = [[cell.replace("|", "\\|").replace("*", "\\*") for cell in row] for row in rows]
    cells.insert(1, ["---", *["---:"] * (len(rows[0]) - 1)])
    return "".join(f"| {' | '.join(row)} |\n" for row in cells)


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]
