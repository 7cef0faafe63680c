"""The results of the benchmark as JSON, and the leaderboard page in Markdown, which is rendered from them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from cablebot_gym.benchmark import tables
from cablebot_gym.benchmark.cells import Record, cell_from_dict
from cablebot_gym.benchmark.maps import varied_fields
from cablebot_gym.benchmark.scores import BestKnown, best_known_payloads, leaderboards, payload_maps, scores
from cablebot_gym.benchmark.suites import find_suite


def results_json(suite: str, command: str, records: Sequence[Record]) -> str:
    """The results of a suite and its command as JSON, one cell per line. Equal results give identical bytes."""
    scored, versions = iter(scores(records)), _versions(records)
    lines = []
    for record in records:
        entry: dict[str, Any] = {
            "cell": record.cell.to_dict(),
            "source": record.source,
            "versions": versions.index(record.versions),
            "result": record.result,
        }
        if entry["cell"]["kind"] == "policy":
            score = next(scored)
            entry |= {"best_known": score.best_known, "score": score.score, "raised": score.raised}
        lines.append(json.dumps(entry, ensure_ascii=False, allow_nan=False))
    head = {"suite": suite, "command": command, "versions": versions}
    fields = [f" {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in head.items()]
    fields.append(' "cells": [\n  ' + ",\n  ".join(lines) + "\n ]")
    return "{\n" + ",\n".join(fields) + "\n}\n"


def read_results(text: str) -> tuple[str, str, list[Record]]:
    """Suite, command and records from the output of :func:`results_json`."""
    data = json.loads(text)
    records = [
        Record(
            cell=cell_from_dict(entry["cell"]),
            source=entry["source"],
            versions=data["versions"][entry["versions"]],
            result=entry["result"],
            seconds=0.0,
        )
        for entry in data["cells"]
    ]
    return data["suite"], data["command"], records


def markdown(suite: str, command: str, records: Sequence[Record]) -> str:
    """The leaderboard page: tables by environment, payload maps, best known payloads and notes.

    Args:
        suite: name of the suite.
        command: command that computes the results.
        records: records of the suite's cells.
    """
    cells = [score.cell for score in scores(records)]
    default = next((cell for cell in cells if not varied_fields(cell)), cells[0])
    drawn = [cell for cell in cells if cell.draws > 1]
    text = (
        (files("cablebot_gym.benchmark") / "leaderboard_head.md")
        .read_text(encoding="utf-8")
        .format(
            position=1e3 * default.error_bounds["position"],
            rotation=1e3 * default.error_bounds["rotation"],
            probability=drawn[0].probability if drawn else 0.95,
            draws=drawn[0].draws if drawn else "the",
        )
    )
    boards = leaderboards(records)
    for env_id in dict.fromkeys(leaderboard.env_id for leaderboard in boards):
        text += f"\n## {env_id}\n"
        for leaderboard in boards:
            if leaderboard.env_id == env_id:
                title, (head, *rows) = tables.motion_title(leaderboard), tables.leaderboard_rows(leaderboard)
                rows = [[f"`{policy}`", *entries] for policy, *entries in rows]
                text += f"\n{title[0].upper()}{title[1:]}:\n\n{_table([head, *rows])}"
    for payload_map in payload_maps(records):
        note = tables.map_note(payload_map)
        text += f"\n## {tables.map_title(payload_map)}\n\n{_table(tables.map_rows(payload_map))}" + (
            f"\n{note}\n" if note else ""
        )
    if references := list(best_known_payloads(records).values()):
        text += f"\n## Best known payloads\n\n{_best_known_table(references)}"
    notes = [*tables.failures(records), *tables.fallbacks(records)]
    if notes:
        text += "\n## Notes\n\n" + "".join(f"* {note}\n" for note in notes)
    used = "; ".join(
        ", ".join(f"{name} {value}" for name, value in versions.items()) for versions in _versions(records)
    )
    return f"{text}\nSuite `{suite}` ({find_suite(suite).summary}), computed by `{command}` with {used}.\n"


def _versions(records: Sequence[Record]) -> list[Mapping[str, str]]:
    """The distinct sets of package versions."""
    distinct: list[Mapping[str, str]] = []
    for record in records:
        if record.versions not in distinct:
            distinct.append(record.versions)
    return distinct


def _best_known_table(references: Sequence[BestKnown]) -> str:
    rows = [["environment", "motion", "payload [kg]", "total mass [kg]", "upper bound [kg]", "note"]]
    for best in references:
        payloads = (best.result.get("payload"), best.result.get("total_mass"))
        upper = (best.result.get("upper") or {}).get("payload")
        note = best.result.get("error") or ("" if best.payload is not None else "not verified by the replay")
        if best.raised_by:
            note = f"raised to {best.payload:.3f} kg, the DLCC of {best.raised_by}*"
        numbers = ["–" if value is None else f"{value:.3f}" for value in (*payloads, upper)]
        rows.append([best.cell.env_id, tables.task_title(best.cell), *numbers, note])
    return _table(rows)


def _table(rows: Sequence[Sequence[str]]) -> str:
    cells = [[cell.replace("|", "\\|").replace("*", "\\*") for cell in row] for row in rows]
    cells.insert(1, ["---", *["---:"] * (len(rows[0]) - 1)])
    return "".join(f"| {' | '.join(row)} |\n" for row in cells)
