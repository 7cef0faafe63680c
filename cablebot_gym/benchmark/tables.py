"""The tables of the benchmark: entries as text, console output and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from statistics import median
from typing import Any

from rich.table import Table

from cablebot_gym.benchmark import scores
from cablebot_gym.benchmark.cells import Cell, Record
from cablebot_gym.benchmark.maps import varied_texts
from cablebot_gym.task import payload_model_text
from cablebot_gym.utils.console import results_console

_CSV_FIELDS = (
    *("env_id", "trajectory", "policy", "criterion", "payload_known", "model_payload_factor"),
    *("uncertainty", "draws", "probability", "position_bound", "rotation_bound", "stiffness"),
    *("control_frequency", "seed", "payload", "total_mass", "best_known", "score", "raised"),
    *("violation", "assured_payload", "fallbacks", "error"),
)


def heading(column: scores.Column) -> str:
    """Heading of a column: payload model, uncertainty and, if it is not ``task``, the criterion."""
    words = [
        payload_model_text(column.payload_known, column.model_payload_factor),
        *([column.uncertainty] if column.uncertainty else []),
    ]
    return ", ".join([*words, "paper criterion [kg]"] if column.criterion == "paper" else words)


def motion_title(leaderboard: scores.Leaderboard) -> str:
    """Title of a table: its motion or its family of motions."""
    if leaderboard.motions > 1:
        return f"{leaderboard.motions} held-out motions, {leaderboard.motion}: median and worst fraction"
    if leaderboard.motion.startswith("paper-"):
        return "the paper's circle"
    number = next(iter(leaderboard.entries.values()))[0].cell.trajectory.get("seed")
    return f"held-out motion {leaderboard.motion}" + ("" if number is None else f" {number}")


def entry_text(leaderboard: scores.Leaderboard, policy: str, column: scores.Column) -> str:
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


def leaderboard_rows(leaderboard: scores.Leaderboard) -> list[list[str]]:
    """Head and rows of a table: one row per policy."""
    head = ["policy", *map(heading, leaderboard.columns)]
    return [head] + [
        [policy, *(entry_text(leaderboard, policy, column) for column in leaderboard.columns)]
        for policy in leaderboard.policies
    ]


def map_title(payload_map: scores.PayloadMap) -> str:
    """Title of the table of a map."""
    conditions = ", ".join([payload_map.env_id, "the paper's circle", "payload known", *payload_map.constants])
    return f"{conditions}: payload by {payload_map.axis.label}"


def map_rows(payload_map: scores.PayloadMap) -> list[list[str]]:
    """The table of a map: a row of parameter values, a row of best known payloads, if any, and one row per policy."""
    rows = [["", *(f"{value * payload_map.axis.scale:g}" for value in payload_map.values)]]
    if any(best is not None for best in payload_map.best_known):
        known = ("–" if best is None else f"{best:.2f}" for best in payload_map.best_known)
        rows.append(["best known payload", *known])
    return rows + [[policy, *map(_map_entry, entries)] for policy, entries in payload_map.policies.items()]


def map_note(payload_map: scores.PayloadMap) -> str:
    """One sentence on the cases with saturated motors; empty if the results do not contain them."""
    found = [score for entries in payload_map.policies.values() for score in entries if score is not None]
    saturated = [
        score.result["saturated"] for score in found if score.payload is not None and "saturated" in score.result
    ]
    return f"A motor saturates in {sum(saturated)} of {len(saturated)} feasible cases." if saturated else ""


def _map_entry(score: scores.Score | None) -> str:
    """Payload and fraction; without a best known payload, the payload with more digits and its limiting violation."""
    if score is None or score.error is not None:
        return "–" if score is None else "error"
    if score.score is not None:
        return f"{score.payload_text}, {score.score:.0%}"
    violation = score.result.get("violation") or {}
    limit = [f"{violation['kind']} {violation['time']:.2f} s"] if violation.get("time") is not None else []
    return ", ".join([score.payload_text if score.payload is None else f"{score.payload:.4g}", *limit])


def task_title(cell: Cell) -> str:
    """The motion of a cell and the parameters that are not at their defaults."""
    motion = " ".join(str(cell.trajectory[name]) for name in ("name", "seed") if name in cell.trajectory)
    return ", ".join([motion, *varied_texts(cell)])


def best_known_text(best: scores.BestKnown) -> str:
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
    for score in scores.scores(records):
        if score.error is not None:
            lines[f"{score.cell.policy} failed on {score.cell.env_id}: {score.error}"] = None
    return list(lines)


def fallbacks(records: Sequence[Record]) -> list[str]:
    """One sentence per policy and environment with fallbacks at the DLCC."""
    groups: dict[tuple[str, str], list[float]] = {}
    for score in scores.scores(records):
        if (number := score.result.get("fallbacks")) is not None:
            groups.setdefault((score.cell.policy, score.cell.env_id), []).append(number)
    return [
        f"{policy} on {env_id} used its fallback up to {max(numbers):.3g} times per episode, "
        f"in {sum(number > 0 for number in numbers)} of {len(numbers)} cells"
        for (policy, env_id), numbers in groups.items()
        if max(numbers) > 0
    ]


def print_benchmark(records: Sequence[Record]) -> None:
    """Prints the tables, the best known payloads and the notes."""
    console = results_console()
    boards, maps = scores.leaderboards(records), scores.payload_maps(records)
    tables = [(f"{board.env_id}, {motion_title(board)}", leaderboard_rows(board)) for board in boards]
    for title, (head, *rows) in [*tables, *((map_title(one), map_rows(one)) for one in maps)]:
        console.print(title, highlight=False)
        table = Table()
        for index, name in enumerate(head):
            table.add_column(name, justify="right" if index else "left", overflow="fold")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    console.print(
        "Entries: payload [kg] and its fraction of the best known payload, task criterion. Best known payloads:",
        highlight=False,
    )
    references = list(scores.best_known_payloads(records).values())
    for line in [*map(best_known_text, references), *failures(records), *fallbacks(records)]:
        console.print(f"  {line}", highlight=False, soft_wrap=True)
    if any(best.raised_by for best in references):
        console.print("*: this payload raised the best known payload", highlight=False)


def csv_text(records: Sequence[Record]) -> str:
    """CSV text with one row per policy cell, in SI units."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _CSV_FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(csv_row(score) for score in scores.scores(records))
    return text.getvalue()


def csv_row(score: scores.Score) -> dict[str, Any]:
    """One score as a row of :func:`csv_text`."""
    cell, result, violation = score.cell, score.result, score.result.get("violation") or {}
    values = {name: getattr(source, name) for source in (cell, score) for name in _CSV_FIELDS if hasattr(source, name)}
    return (
        {name: result.get(name) for name in _CSV_FIELDS}
        | values
        | {
            "trajectory": json.dumps(dict(cell.trajectory)),
            "position_bound": cell.error_bounds["position"],
            "rotation_bound": cell.error_bounds["rotation"],
            "stiffness": cell.robot_changes.get("transmission", {}).get("stiffness"),
            "violation": " ".join(
                str(violation[name]) for name in ("kind", "index") if violation.get(name) is not None
            ),
        }
    )
