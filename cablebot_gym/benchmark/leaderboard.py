"""The results of the benchmark as JSON, and the leaderboard page in Markdown, which is rendered from them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from cablebot_gym.benchmark.cells import Record, cell_from_dict
from cablebot_gym.benchmark.maps import varied_axes
from cablebot_gym.benchmark.scores import (
    BestKnown,
    Leaderboard,
    best_known_payloads,
    leaderboards,
    payload_maps,
    scores,
)
from cablebot_gym.benchmark.suites import find_suite
from cablebot_gym.benchmark.tables import (
    entry_text,
    failures,
    fallbacks,
    heading,
    map_rows,
    map_title,
    motion_title,
    task_title,
)

_HEAD = """# Leaderboard

An entry is the dynamic load carrying capacity (DLCC) of a policy [kg] and its fraction of the best known payload.

* **DLCC:** the largest payload that the policy carries over the whole motion, by the task criterion:
  position error ≤ {position:g} mm, rotation error ≤ {rotation:g} mrad and no slack cable at any physics step. Motor
  torques are clipped.
* **Best known payload:** the largest payload for which a motion within the same limits is known. It is verified by
  replay, and it is a lower bound of the true optimum.
* **Payload known, payload unknown:** whether the policy's model includes the payload.
  **Payload model × 0.9:** the model payload is 0.9 times the nominal payload.
* **`table6`, `sensors`:** uncertainty of the robot or of the measurements. A payload counts as carried if at least
  {probability:.0%} of {draws} sampled episodes succeed. All policies see the same samples. The fraction refers to the
  best known payload without uncertainty.
* **Paper criterion:** |a| ≤ 1 at every control instant and no bound on the rotation. This column is not ranked.
* **Held-out motions** are drawn from a seeded family of motions. No policy was tuned on them.

| entry | meaning |
| --- | --- |
| fails unloaded | The policy fails without payload. Its score is zero. |
| ≥ | A lower bound: the largest payload of the scan is still feasible. |
| \\* | This payload raised the best known payload. |
| n/a | The paper criterion is not applicable: the policy does not declare `unsaturated_actions`. |
| error | The policy raised an exception or returned an invalid action, see the notes. |
| – | Not evaluated. |

Rows are sorted by the first column.
"""


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
    default = next((cell for cell in cells if not varied_axes(cell)), cells[0])
    drawn = [cell for cell in cells if cell.draws > 1]
    text = _HEAD.format(
        position=1e3 * default.error_bounds["position"],
        rotation=1e3 * default.error_bounds["rotation"],
        probability=drawn[0].probability if drawn else 0.95,
        draws=drawn[0].draws if drawn else "the",
    )
    boards = leaderboards(records)
    for env_id in dict.fromkeys(leaderboard.env_id for leaderboard in boards):
        text += f"\n## {env_id}\n"
        for leaderboard in boards:
            if leaderboard.env_id == env_id:
                text += f"\n{_sentence(motion_title(leaderboard))}:\n\n{_leaderboard(leaderboard)}"
    for payload_map in payload_maps(records):
        text += f"\n## {map_title(payload_map)}\n\n{_table(map_rows(payload_map))}"
    text += f"\n## Best known payloads\n\n{_best_known_table(list(best_known_payloads(records).values()))}"
    notes = [*failures(records), *fallbacks(records)]
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


def _leaderboard(leaderboard: Leaderboard) -> str:
    rows = [["policy", *map(heading, leaderboard.columns)]]
    rows += [
        [f"`{policy}`", *(entry_text(leaderboard, policy, column) for column in leaderboard.columns)]
        for policy in leaderboard.policies
    ]
    return _table(rows)


def _best_known_table(references: Sequence[BestKnown]) -> str:
    rows = [["environment", "motion", "payload [kg]", "total mass [kg]", "upper bound [kg]", "note"]]
    for best in references:
        upper = best.result.get("upper") or {}
        payload, total = best.result.get("payload"), best.result.get("total_mass")
        note = best.result.get("error") or ("" if best.payload is not None else "not verified by the replay")
        if best.raised_by:
            note = f"raised to {best.payload:.3f} kg, the DLCC of {best.raised_by}*"
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
