"""The tables of the benchmark: entries as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from cablebot_gym.benchmark import scores
from cablebot_gym.benchmark.cells import Cell, Record
from cablebot_gym.benchmark.maps import varied_texts
from cablebot_gym.bounds.robot_check import check_motion
from cablebot_gym.evaluation.constraints import Violation
from cablebot_gym.robots import KIND_TEXTS
from cablebot_gym.task import payload_model_text


def heading(column: scores.Column) -> str:
    """Conditions of a column: payload model, uncertainty, number of draws and, if it is not
    ``task``, the criterion."""
    words = [payload_model_text(column.payload_known, column.model_payload_factor)]
    if column.uncertainty:
        words.append(column.uncertainty)
    if column.real_time:
        words.append("real time")
    if column.draws > 1:
        words.append(f"{column.draws} draws")
    if column.criterion == "paper":
        words.append("paper criterion")
    return ", ".join(words) + (" [kg]" if column.uncertainty or column.criterion == "paper" else "")


def motion_title(column: scores.Column, motions: int) -> str:
    """Motion of a column, or its family of motions."""
    if column.motion.startswith(("circle-", "paper-")):
        return "circle" if column.motion.startswith("circle-") else "the paper's circle"
    return f"{motions} held-out motions" if motions > 1 else f"held-out motion of {column.motion}"


def column_titles(leaderboard: scores.Leaderboard) -> list[str]:
    """Titles of the columns of a table: motion and conditions."""
    return [
        f"{motion_title(column, leaderboard.motions(column))}: {heading(column)}"
        for column in leaderboard.columns
    ]


def entry_text(leaderboard: scores.Leaderboard, policy: str, column: scores.Column) -> str:
    """Table entry of a policy in a column: payload [kg] and fraction, or the mean fraction of
    several motions."""
    entry = leaderboard.entries.get((policy, column), ())
    errors = sum(score.error is not None for score in entry)
    if not entry or errors == len(entry):
        return "error" if entry else "–"
    if not all(score.result.get("applicable", True) for score in entry):
        return "n/a"
    fraction = leaderboard.fraction(policy, column)
    if len(entry) == 1:
        text = entry[0].payload_text
        return text if fraction is None else f"{text}, {fraction.mean:.0%}"
    counted = f"; errors: {errors}" if errors else ""
    if fraction is None:
        return f"{median(score.payload or 0.0 for score in entry):.2f} kg{counted}"
    interval = f" [{fraction.low:.1%}, {fraction.high:.1%}]" if leaderboard.ranks else ""
    return f"{fraction.mean:.1%}{interval}, worst {fraction.worst:.0%}{counted}"


def timing_text(timing: Mapping[str, Any] | None) -> str:
    """Computing time: median and 99th percentile of an action [ms], the fraction of late actions,
    and the start [s]."""
    if timing is None:
        return "–"
    times = f"{1e3 * timing['median']:.2g}, {1e3 * timing['p99']:.2g}, {timing['missed']:.0%}, {timing['start']:.2g}"
    return f"{times}, exchange" if timing["exchange"] else times


def leaderboard_rows(leaderboard: scores.Leaderboard) -> list[list[str]]:
    """Head and rows of a table: one row per policy, with its rank if there are ranks, and its
    computing time."""
    ranks, timings = leaderboard.ranks, leaderboard.timings
    head = [*(["rank"] if ranks else []), "policy", *column_titles(leaderboard)]
    rows = [[*head, *(["median, p99 [ms], late, start [s]"] if timings else [])]]
    for policy in leaderboard.policies:
        row = [policy, *(entry_text(leaderboard, policy, column) for column in leaderboard.columns)]
        row = [*([str(ranks.get(policy, "–"))] if ranks else []), *row]
        rows.append([*row, *([timing_text(timings.get(policy))] if timings else [])])
    return rows


def overall_rows(boards: Sequence[scores.Leaderboard]) -> list[list[str]]:
    """Head and rows of the table of the policies that several ranked environments have; no rows
    without any."""
    found = scores.overall(boards).items()
    rows = [
        [policy, str(len(env_ids)), f"{one.mean:.1%} [{one.low:.1%}, {one.high:.1%}]"]
        for policy, (env_ids, one) in sorted(found, key=lambda item: -item[1][1].mean)
    ]
    return [["policy", "environments", "mean fraction"], *rows] if rows else []


def map_title(payload_map: scores.PayloadMap) -> str:
    """Title of the table of a map."""
    motion = motion_title(scores.Column(motion=payload_map.motion), 1)
    conditions = ", ".join([payload_map.env_id, motion, "payload known", *payload_map.constants])
    return f"{conditions}: payload by {payload_map.axis.label}"


def map_rows(payload_map: scores.PayloadMap) -> list[list[str]]:
    """The table of a map: a row of parameter values, a row of best known payloads, if any, and one
    row per policy."""
    rows = [["", *(f"{value * payload_map.axis.scale:g}" for value in payload_map.values)]]
    if any(best is not None for best in payload_map.best_known):
        known = ("–" if best is None else f"{best:.2f}" for best in payload_map.best_known)
        rows.append(["best known payload", *known])
    return rows + [
        [policy, *map(_map_entry, entries)] for policy, entries in payload_map.policies.items()
    ]


def map_note(payload_map: scores.PayloadMap) -> str:
    """One sentence on the cases with saturated motors; empty if the results do not contain them."""
    found = [
        score for entries in payload_map.policies.values() for score in entries if score is not None
    ]
    saturated = [
        score.result["saturated"]
        for score in found
        if score.payload is not None and "saturated" in score.result
    ]
    return (
        f"A motor saturates in {sum(saturated)} of {len(saturated)} feasible cases."
        if saturated
        else ""
    )


def _map_entry(score: scores.Score | None) -> str:
    """Payload and fraction; without a best known payload, the payload with more digits and its
    limiting violation."""
    if score is None:
        return "–"
    if score.error is None and score.score is not None:
        return f"{score.payload_text}, {score.score:.0%}"
    violation = score.result.get("violation") or {}
    limit = (
        [f"{violation['kind']} {violation['time']:.2f} s"]
        if violation.get("time") is not None
        else []
    )
    return ", ".join([_payload(score), *limit])


def _payload(score: scores.Score) -> str:
    """Payload with more digits than ``payload_text``."""
    if score.error is not None or score.payload is None:
        return score.payload_text if score.error is None else "error"
    return ("≥ " if score.result.get("scan_ended") else "") + _digits(score.payload)


def _digits(payload: float) -> str:
    """Four digits, without an exponent for tonnes."""
    return f"{float(f'{payload:.4g}'):g}"


def task_title(cell: Cell) -> str:
    """The motion of a cell and the parameters that are not at their defaults."""
    motion = " ".join(
        str(cell.trajectory[name]) for name in ("name", "seed") if name in cell.trajectory
    )
    return ", ".join([*filter(None, [cell.robot_name]), motion, *varied_texts(cell)])


def library_rows(records: Sequence[Record]) -> list[list[list[str]]]:
    """Head and rows of the tables of robots with their own motions: rigid robots, then those with
    elastic cables."""
    groups: dict[tuple[bool, str], list[scores.Score]] = {}
    for score in scores.scores(records):
        if score.cell.robot_name is not None:
            groups.setdefault((score.cell.robot.flexible, score.cell.robot_name), []).append(score)
    tables: dict[bool, list[list[str]]] = {}
    for (flexible, name), group in groups.items():
        robot = group[0].cell.robot
        best = max(group, key=lambda score: score.payload or 0.0)
        exact = [] if flexible else [_digits(check_motion(robot).limit.largest)]
        head = ["robot", "platform", "cables", *([] if flexible else ["exact tracking [kg]"])]
        head += [
            *(f"{score.cell.policy} [kg]" for score in group),
            "limiting violation of the best",
        ]
        violation = best.result.get("violation")
        limit = "–" if violation is None else str(Violation(**violation))
        row = [
            f"`{name}`",
            KIND_TEXTS[robot.kind],
            str(robot.cables),
            *exact,
            *map(_payload, group),
            limit,
        ]
        tables.setdefault(flexible, [head]).append(row)
    return [rows for _, rows in sorted(tables.items())]


def best_known_text(best: scores.BestKnown) -> str:
    """One line about a best known payload."""
    motion = task_title(best.cell)
    if best.payload is None:
        reason = best.result.get("error") or "the replay does not verify the result of the search"
        return f"{best.cell.env_id}, {motion}: none: {reason}"
    return f"{best.cell.env_id}, {motion}: {best.payload:.3f} kg"


def failures(records: Sequence[Record]) -> list[str]:
    """One sentence per distinct error of a policy."""
    failed = [(one.cell, one.error) for one in records if one.error is not None]
    lines = [
        f"{cell.policy} failed on {cell.env_id}: {error}"
        for cell, error in failed
        if hasattr(cell, "policy")
    ]
    return list(dict.fromkeys(lines))


def left_out(records: Sequence[Record]) -> list[str]:
    """One sentence per held-out motion that counts for no policy."""
    return [
        f"{task_title(best.cell)} counts for no policy on {best.cell.env_id}: no best known payload was verified"
        for best in scores.best_known_payloads(records).values()
        if best.payload is None and "seed" in best.cell.trajectory
    ]


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
