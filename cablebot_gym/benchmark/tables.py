"""The benchmark's tables: what stands in each place, in the terminal and as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from statistics import median
from typing import Any

from rich.table import Table

from cablebot_gym.benchmark.cells import Cell, Record
from cablebot_gym.benchmark.maps import AXES, unusual
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
from cablebot_gym.utils.console import results_console

_INFORMATION = {"told": "told", "untold": "not told", "told-0.9": "told 0.9 ×", "told-1.1": "told 1.1 ×"}

_CSV_FIELDS = (
    *("env_id", "trajectory", "policy", "criterion", "information", "uncertainty", "draws", "probability"),
    *("position_bound", "rotation_bound", "stiffness", "control_frequency", "seed"),
    *("payload", "total_mass", "best_found", "score", "raised", "limit", "assured_payload", "fallbacks", "error"),
)


def heading(column: Column) -> str:
    """Name of a column."""
    words = [_INFORMATION[column.information], *([column.uncertainty] if column.uncertainty else [])]
    return ", ".join([*words, "paper criterion [kg]"] if column.criterion == "paper" else words)


def motion_title(board: Board) -> str:
    """What a table's motions are."""
    if board.motions > 1:
        return f"{board.motions} held-out motions, {board.motion}: median and worst share"
    if board.motion.startswith("paper-"):
        return "the paper's circle"
    number = next(iter(board.places.values()))[0].cell.trajectory.get("seed")
    return f"held-out motion {board.motion}" + ("" if number is None else f" {number}")


def place(board: Board, policy: str, column: Column) -> str:
    """What a table says of a policy under some conditions."""
    some = board.places.get((policy, column), ())
    if not some:
        return "–"
    if any(one.error is not None for one in some):
        return "failed"
    if not all(one.result.get("applicable", True) for one in some):
        return "n/a"
    share = board.share(policy, column)
    if board.motions > 1:
        payloads = [one.payload or 0.0 for one in some]
        kilograms = f"{median(payloads):.2f} kg, {min(payloads):.2f} kg"
        mark = "*" if any(one.raised for one in some) else ""
        return kilograms if share is None else f"{share.median:.0%}, {share.worst:.0%}{mark}"
    weight = some[0].weight + ("*" if some[0].raised else "")
    return weight if share is None else f"{weight}, {share.median:.0%}"


def map_title(found: PayloadMap) -> str:
    """What the table of the map ``found`` is."""
    return f"{found.env_id}, the paper's circle, told: payload by {found.axis.label}"


def map_rows(found: PayloadMap) -> list[list[str]]:
    """The table of the map ``found``: values of the axis above, then the best found, then a row for each policy."""
    rows = [["", *(f"{value * found.axis.scale:g}" for value in found.values)]]
    rows.append(["best found", *("–" if best is None else f"{best:.2f}" for best in found.bests)])
    return rows + [[policy, *map(_on_map, some)] for policy, some in found.policies.items()]


def _on_map(one: Standing | None) -> str:
    if one is None or one.error is not None:
        return "–" if one is None else "failed"
    return one.weight if one.score is None else f"{one.weight}, {one.score:.0%}"


def task_title(cell: Cell) -> str:
    """Motion, and what of the task is not as usual."""
    fields = dict(cell.trajectory)
    words = [str(fields.pop("name")), *(str(value) for name, value in fields.items() if name != "duration")]
    words += [f"{AXES[name].label} {AXES[name].of(cell) * AXES[name].scale:g}" for name in unusual(cell)]
    return ", ".join([" ".join(words[:2]), *words[2:]]) if "seed" in fields else ", ".join(words)


def best_text(best: Best) -> str:
    """One line about a best found."""
    motion = task_title(best.cell)
    if best.payload is None:
        why = best.result.get("error") or "what was found does not pass its replay"
        return f"{best.cell.env_id}, {motion}: none: {why}"
    raised = f"; raised to {best.payload:.3f} kg, which {best.raised_by} carries" if best.raised_by else ""
    return f"{best.cell.env_id}, {motion}: {best.result['payload']:.3f} kg{raised}"


def failures(records: Sequence[Record]) -> list[str]:
    """A sentence for each policy's failure, each once."""
    said: dict[str, None] = {}
    for one in standings(records):
        if one.error is not None:
            said[f"{one.cell.policy} failed on {one.cell.env_id}: {one.error}"] = None
    return list(said)


def fallbacks(records: Sequence[Record]) -> list[str]:
    """A sentence for each policy that fell back on something safer at a payload that counts."""
    counted: dict[tuple[str, str], list[float]] = {}
    for one in standings(records):
        if (number := one.result.get("fallbacks")) is not None:
            counted.setdefault((one.cell.policy, one.cell.env_id), []).append(number)
    return [
        f"{policy} on {env_id} fell back {max(numbers):.3g} times an episode at most, in {_cells(numbers)} cells"
        for (policy, env_id), numbers in counted.items()
        if max(numbers) > 0
    ]


def print_benchmark(records: Sequence[Record]) -> None:
    """The tables in the terminal, and what has to be said of them."""
    console = results_console()
    for board in boards(records):
        console.print(f"{board.env_id}, {motion_title(board)}", highlight=False)
        table = Table()
        table.add_column("policy", overflow="fold")
        for column in board.columns:
            table.add_column(heading(column), justify="right")
        for policy in board.policies:
            table.add_row(policy, *(place(board, policy, column) for column in board.columns))
        console.print(table)
    for found in payload_maps(records):
        console.print(map_title(found), highlight=False)
        first, *rows = map_rows(found)
        table = Table()
        for place_, title in enumerate(first):
            table.add_column(title, justify="right" if place_ else "left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    console.print("payload [kg] and its share of the best found, task criterion; best found:", highlight=False)
    bests = list(find_bests(records).values())
    for line in [*map(best_text, bests), *failures(records), *fallbacks(records)]:
        console.print(f"  {line}", highlight=False, soft_wrap=True)
    if any(best.raised_by for best in bests):
        console.print("*: a payload is the best found itself, which is raised to it", highlight=False)


def csv_text(records: Sequence[Record]) -> str:
    """One row for each policy's cell; units are SI."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _CSV_FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat(one) for one in standings(records))
    return text.getvalue()


def flat(one: Standing) -> dict[str, Any]:
    """One standing as a row of :func:`csv_text`."""
    cell, result, limit = one.cell, one.result, one.result.get("limit") or {}
    conditions = ("criterion", "information", "uncertainty", "draws", "probability", "stiffness", "control_frequency")
    return {
        **{name: getattr(cell, name) for name in ("env_id", "policy", *conditions, "seed")},
        "trajectory": json.dumps(dict(cell.trajectory)),
        "position_bound": cell.limits["position"],
        "rotation_bound": cell.limits["rotation"],
        "best_found": one.best,
        "score": one.score,
        "raised": one.raised,
        "limit": " ".join(str(limit[name]) for name in ("kind", "index") if limit.get(name) is not None),
        **{name: result.get(name) for name in ("payload", "total_mass", "assured_payload", "fallbacks", "error")},
    }


def _cells(numbers: Sequence[float]) -> str:
    return f"{sum(number > 0 for number in numbers)} of {len(numbers)}"
