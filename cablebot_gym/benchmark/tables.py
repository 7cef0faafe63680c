"""The tables of the benchmark: entries as text, console output and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from statistics import median
from typing import Any

from rich.table import Table

from cablebot_gym.benchmark.cells import Cell, Record
from cablebot_gym.benchmark.maps import AXES, varied_axes
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
from cablebot_gym.task import payload_model_text
from cablebot_gym.utils.console import results_console

_CSV_FIELDS = (
    *(
        "env_id",
        "trajectory",
        "policy",
        "criterion",
        "payload_known",
        "model_payload_factor",
        "uncertainty",
        "draws",
        "probability",
    ),
    *("position_bound", "rotation_bound", "stiffness", "control_frequency", "seed"),
    *("payload", "total_mass", "best_known", "score", "raised", "violation", "assured_payload", "fallbacks", "error"),
)


def heading(column: Column) -> str:
    """Heading of a column: payload model, uncertainty and, if it is not ``task``, the criterion."""
    words = [
        payload_model_text(column.payload_known, column.model_payload_factor),
        *([column.uncertainty] if column.uncertainty else []),
    ]
    return ", ".join([*words, "paper criterion [kg]"] if column.criterion == "paper" else words)


def motion_title(leaderboard: Leaderboard) -> str:
    """Title of a table: its motion or its family of motions."""
    if leaderboard.motions > 1:
        return f"{leaderboard.motions} held-out motions, {leaderboard.motion}: median and worst fraction"
    if leaderboard.motion.startswith("paper-"):
        return "the paper's circle"
    number = next(iter(leaderboard.entries.values()))[0].cell.trajectory.get("seed")
    return f"held-out motion {leaderboard.motion}" + ("" if number is None else f" {number}")


def entry_text(leaderboard: Leaderboard, policy: str, column: Column) -> str:
    """Table entry of a policy in a column: payload [kg] and fraction, or the fractions of several motions."""
    entry = leaderboard.entries.get((policy, column), ())
    if not entry:
        return "–"
    if any(score.error is not None for score in entry):
        return "error"
    if not all(score.result.get("applicable", True) for score in entry):
        return "n/a"
    fraction = leaderboard.fraction(policy, column)
    if leaderboard.motions > 1:
        payloads = [score.payload or 0.0 for score in entry]
        kilograms = f"{median(payloads):.2f} kg, {min(payloads):.2f} kg"
        mark = "*" if any(score.raised for score in entry) else ""
        return kilograms if fraction is None else f"{fraction.median:.0%}, {fraction.worst:.0%}{mark}"
    text = entry[0].payload_text + ("*" if entry[0].raised else "")
    return text if fraction is None else f"{text}, {fraction.median:.0%}"


def map_title(payload_map: PayloadMap) -> str:
    """Title of the table of a map."""
    return f"{payload_map.env_id}, the paper's circle, payload known: payload by {payload_map.axis.label}"


def map_rows(payload_map: PayloadMap) -> list[list[str]]:
    """The table of a map: a row of parameter values, a row of best known payloads, and one row per policy."""
    rows = [["", *(f"{value * payload_map.axis.scale:g}" for value in payload_map.values)]]
    rows.append(["best known payload", *("–" if best is None else f"{best:.2f}" for best in payload_map.best_known)])
    return rows + [[policy, *map(_map_entry, entries)] for policy, entries in payload_map.policies.items()]


def _map_entry(score: Score | None) -> str:
    if score is None or score.error is not None:
        return "–" if score is None else "error"
    return score.payload_text if score.score is None else f"{score.payload_text}, {score.score:.0%}"


def task_title(cell: Cell) -> str:
    """The motion of a cell and the parameters that are not at their defaults."""
    fields = dict(cell.trajectory)
    words = [str(fields.pop("name")), *(str(value) for name, value in fields.items() if name != "duration")]
    words += [f"{AXES[name].label} {AXES[name].value(cell) * AXES[name].scale:g}" for name in varied_axes(cell)]
    return ", ".join([" ".join(words[:2]), *words[2:]]) if "seed" in fields else ", ".join(words)


def best_known_text(best: BestKnown) -> str:
    """One line about a best known payload."""
    motion = task_title(best.cell)
    if best.payload is None:
        reason = best.result.get("error") or "the replay does not verify the result of the search"
        return f"{best.cell.env_id}, {motion}: none: {reason}"
    raised = f"; raised to {best.payload:.3f} kg, the DLCC of {best.raised_by}" if best.raised_by else ""
    return f"{best.cell.env_id}, {motion}: {best.result['payload']:.3f} kg{raised}"


def failures(records: Sequence[Record]) -> list[str]:
    """One sentence per distinct error of a policy."""
    lines: dict[str, None] = {}
    for score in scores(records):
        if score.error is not None:
            lines[f"{score.cell.policy} failed on {score.cell.env_id}: {score.error}"] = None
    return list(lines)


def fallbacks(records: Sequence[Record]) -> list[str]:
    """One sentence per policy and environment with fallbacks at the DLCC."""
    groups: dict[tuple[str, str], list[float]] = {}
    for score in scores(records):
        if (number := score.result.get("fallbacks")) is not None:
            groups.setdefault((score.cell.policy, score.cell.env_id), []).append(number)
    return [
        f"{policy} on {env_id} used its fallback up to {max(numbers):.3g} times per episode, in {_cells(numbers)} cells"
        for (policy, env_id), numbers in groups.items()
        if max(numbers) > 0
    ]


def print_benchmark(records: Sequence[Record]) -> None:
    """Prints the tables, the best known payloads and the notes."""
    console = results_console()
    for leaderboard in leaderboards(records):
        console.print(f"{leaderboard.env_id}, {motion_title(leaderboard)}", highlight=False)
        table = Table()
        table.add_column("policy", overflow="fold")
        for column in leaderboard.columns:
            table.add_column(heading(column), justify="right")
        for policy in leaderboard.policies:
            table.add_row(policy, *(entry_text(leaderboard, policy, column) for column in leaderboard.columns))
        console.print(table)
    for payload_map in payload_maps(records):
        console.print(map_title(payload_map), highlight=False)
        head, *rows = map_rows(payload_map)
        table = Table()
        for index, title in enumerate(head):
            table.add_column(title, justify="right" if index else "left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    console.print(
        "Entries: payload [kg] and its fraction of the best known payload, task criterion. Best known payloads:",
        highlight=False,
    )
    references = list(best_known_payloads(records).values())
    for line in [*map(best_known_text, references), *failures(records), *fallbacks(records)]:
        console.print(f"  {line}", highlight=False, soft_wrap=True)
    if any(best.raised_by for best in references):
        console.print("*: this payload raised the best known payload", highlight=False)


def csv_text(records: Sequence[Record]) -> str:
    """CSV text with one row per policy cell, in SI units."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _CSV_FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(csv_row(score) for score in scores(records))
    return text.getvalue()


def csv_row(score: Score) -> dict[str, Any]:
    """One score as a row of :func:`csv_text`."""
    cell, result, violation = score.cell, score.result, score.result.get("violation") or {}
    conditions = (
        "criterion",
        "payload_known",
        "model_payload_factor",
        "uncertainty",
        "draws",
        "probability",
        "stiffness",
        "control_frequency",
    )
    return {
        **{name: getattr(cell, name) for name in ("env_id", "policy", *conditions, "seed")},
        "trajectory": json.dumps(dict(cell.trajectory)),
        "position_bound": cell.error_bounds["position"],
        "rotation_bound": cell.error_bounds["rotation"],
        "best_known": score.best_known,
        "score": score.score,
        "raised": score.raised,
        "violation": " ".join(str(violation[name]) for name in ("kind", "index") if violation.get(name) is not None),
        **{name: result.get(name) for name in ("payload", "total_mass", "assured_payload", "fallbacks", "error")},
    }


def _cells(numbers: Sequence[float]) -> str:
    return f"{sum(number > 0 for number in numbers)} of {len(numbers)}"
