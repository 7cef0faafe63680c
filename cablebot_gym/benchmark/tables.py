"""The tables of the benchmark: entries as text."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from statistics import median
from typing import Any

from cablebot_gym.benchmark import scores
from cablebot_gym.benchmark.cells import Cell, PolicyCell, TimingCell, canonical
from cablebot_gym.benchmark.records import Record
from cablebot_gym.benchmark.yardstick import PROBABILITY, yardsticks
from cablebot_gym.bounds.robot_check import check_motion, two_digits
from cablebot_gym.evaluation.constraints import Violation
from cablebot_gym.isolation.installed import public_entry
from cablebot_gym.robots import KIND_TEXTS, Kind, find_robot
from cablebot_gym.task import payload_model_text
from cablebot_gym.trajectories import find_trajectory


def heading(column: scores.Column) -> str:
    """Conditions of a column: payload model, uncertainty, number of draws and, if it is not
    ``task``, the criterion."""
    words = [payload_model_text(column.payload_known, column.model_payload_factor)]
    if column.uncertainty:
        words.append(column.uncertainty)
    if column.draws > 1:
        unit = "robots" if column.is_main else "draws"
        words.append(f"{column.draws} {unit}")
    if column.criterion == "paper":
        words.append("paper criterion")
    text = ", ".join(words)
    has_fraction = column.uncertainty is None or column.is_main
    if column.criterion == "paper" or not has_fraction:
        text += " [kg]"  # there is no fraction of the best known payload
    return text


def motion_title(column: scores.Column, motions: int) -> str:
    """Motion of a column, or its family of motions."""
    if column.motion.startswith("circle-"):
        return "circle"
    if column.motion.startswith("paper-"):
        return "the paper's circle"
    if motions > 1:
        return f"{motions} held-out motions"
    return f"held-out motion of {column.motion}"


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
    if not entry:
        return "–"
    errors = sum(score.error is not None for score in entry)
    if errors == len(entry):
        return "error"
    if not all(score.result.get("applicable", True) for score in entry):
        return "n/a"
    fraction = leaderboard.fraction(policy, column)
    if len(entry) == 1:
        payload = entry[0].payload_text
        return payload if fraction is None else f"{payload}, {fraction.mean:.0%}"
    if fraction is None:
        text = f"{median(score.payload or 0.0 for score in entry):.2f} kg"
    else:
        text = f"{fraction.mean:.1%}"
        if leaderboard.ranks:
            text += f" [{fraction.low:.1%}, {fraction.high:.1%}]"
        text += f", worst {fraction.worst:.0%}"
    if errors:
        text += f"; errors: {errors}"
    return text


def timing_text(timing: Mapping[str, Any] | None) -> str:
    """Computing time: median and 99th percentile of an action [ms], the fraction of late actions,
    and the start [s]."""
    if timing is None:
        return "–"
    text = f"{1e3 * timing['median']:.2g}, {1e3 * timing['p99']:.2g}, "
    text += f"{timing['missed']:.0%}, {timing['start']:.2g}"
    if timing["exchange"]:
        text += ", exchange"
    return text


def policy_text(policy: str) -> str:
    """Name of a policy as code, with its marks. One that is not installed any more has none of its
    own."""
    text = f"`{policy}`"
    entry = public_entry(policy)
    if entry is not None and entry.known_robot:
        text += ", known robot"
    return text


def leaderboard_rows(leaderboard: scores.Leaderboard) -> list[list[str]]:
    """Head and rows of a table: one row per policy, with its rank if there are ranks, and its
    computing time."""
    ranks = leaderboard.ranks
    timings = leaderboard.timings
    head = ["policy", *column_titles(leaderboard)]
    if ranks:
        head.insert(0, "rank")
    if timings:
        head.append("median, p99 [ms], late, start [s]")
    rows = [head]
    for policy in leaderboard.policies:
        row = [policy_text(policy)]
        for column in leaderboard.columns:
            row.append(entry_text(leaderboard, policy, column))
        if ranks:
            row.insert(0, str(ranks.get(policy, "–")))
        if timings:
            row.append(timing_text(timings.get(policy)))
        rows.append(row)
    return rows


def limiting_violation(score: scores.Score) -> dict[str, Any] | None:
    """The violation beyond the payload of a score: fields of
    :class:`~cablebot_gym.evaluation.constraints.Violation`, and the ``fraction`` of the motion with
    its dwells at which the limit broke. None without a violation."""
    violation: dict[str, Any] | None = score.result.get("violation")
    if violation is None:
        return None
    trajectory = canonical(dict(score.cell.trajectory))
    duration = _duration(trajectory, score.cell.robot.kind)
    return violation | {"fraction": violation["time"] / duration}


@cache
def _duration(trajectory: str, kind: Kind) -> float:
    """Duration of a motion with its dwells [s]. All policies have the same motions."""
    return find_trajectory(json.loads(trajectory), kind).duration


def error_title(table: scores.ErrorTable) -> str:
    """Title of an error table."""
    motion = motion_title(scores.Column(motion=json.loads(table.motion)["name"]), 1)
    known = payload_model_text(table.payload_known)
    return f"{table.env_id}, {motion}, {known}: errors of {table.uncertainty} one at a time"


def error_rows(table: scores.ErrorTable) -> list[list[str]]:
    """Head and rows of an error table: payloads [kg], and what is lost against the exactly known
    robot."""
    rows = [["payload [kg] with", *table.policies]]
    for index, error in enumerate(table.errors):
        cells = []
        for entries in table.policies.values():
            score = entries[index]
            exact = entries[0]
            text = "–" if score is None else _payload(score)
            if score is not exact and score and score.payload and exact and exact.payload:
                text += f", {score.payload / exact.payload - 1:+.0%}"
            cells.append(text)
        rows.append([error.replace("_", " "), *cells])
    return rows


def _payload(score: scores.Score) -> str:
    """Payload with more digits than ``payload_text``."""
    if score.error is not None:
        return "error"
    if score.payload is None:
        return score.payload_text
    digits = f"{float(f'{score.payload:.4g}'):g}"  # without an exponent for tonnes
    return f"≥ {digits}" if score.result.get("scan_ended") else digits


def task_title(cell: Cell) -> str:
    """The motion of a cell, after its robot if it has one of its own."""
    motion = str(cell.trajectory["name"])
    if "seed" in cell.trajectory:
        motion += f" {cell.trajectory['seed']}"
    return _title(cell, motion)


def family_title(cell: Cell) -> str:
    """The title of a cell without the seed of its motion."""
    return _title(cell, str(cell.trajectory["name"]))


def _title(cell: Cell, motion: str) -> str:
    if cell.robot_name is None:
        return motion
    return f"{cell.robot_name}, {motion}"


def library_rows(records: Sequence[Record]) -> list[list[list[str]]]:
    """Head and rows of the tables of robots with their own motions: rigid robots, then those with
    elastic cables. Payloads have two digits, because values of the robots are assumed; those of
    policies are fractions of exact tracking."""
    groups: dict[tuple[bool, str], list[scores.Score]] = {}
    for score in scores.scores(records):
        if score.cell.robot_name is not None:
            groups.setdefault((score.cell.robot.flexible, score.cell.robot_name), []).append(score)
    tables: dict[bool, list[list[str]]] = {}
    for (flexible, name), group in groups.items():
        robot = find_robot(name)  # a stored robot has no ranges
        motion = check_motion(robot)
        exact = motion.limit.largest
        head = ["robot", "platform", "cables", "exact tracking [kg]"]
        row = [f"`{name}`", KIND_TEXTS[robot.kind], str(robot.cables), two_digits(exact)]
        if motion.payload_range is not None and not flexible:
            head.append("over its ranges [kg]")
            row.append(two_digits(*motion.payload_range))
        for score in group:
            head.append(score.cell.policy)
            row.append(_share(score, exact))
        head.append("limiting violation of the best")
        best = max(group, key=lambda score: score.payload or 0.0)
        violation = best.result.get("violation")
        row.append("–" if violation is None else str(Violation(**violation)))
        tables.setdefault(flexible, [head]).append(row)
    return [rows for _, rows in sorted(tables.items())]


def _share(score: scores.Score, payload: float) -> str:
    """Payload of a score as a fraction of another one."""
    if score.payload is None:
        return _payload(score)
    return f"{score.payload / payload:.0%}"


def best_known_text(best: scores.BestKnown) -> str:
    """One line about a best known payload."""
    motion = task_title(best.cell)
    if best.payload is None:
        reason = best.result.get("error") or "the replay does not verify the result of the search"
        return f"{best.cell.env_id}, {motion}: none: {reason}"
    return f"{best.cell.env_id}, {motion}: {best.payload:.3f} kg"


def yardstick_rows(records: Sequence[Record]) -> list[list[str]]:
    """Head and rows of the table of the yardsticks under uncertainty."""
    quantile = f"{PROBABILITY:.0%} quantile"
    rows = [["environment", "uncertainty", "robots", quantile, "mean", "not verified"]]
    for (env_id, uncertainty), stick in yardsticks(records).items():
        quantile = f"{stick.quantile:.1%} [{stick.low:.1%}, {stick.high:.1%}]"
        robots = str(stick.draws + stick.unverified)
        mean = f"{stick.mean:.1%}"
        rows.append([env_id, uncertainty, robots, quantile, mean, str(stick.unverified)])
    return rows


def failures(records: Sequence[Record]) -> list[str]:
    """One sentence per distinct error of a policy."""
    sentences = []
    for record in records:
        if record.error is not None and isinstance(record.cell, PolicyCell | TimingCell):
            cell = record.cell
            sentences.append(f"{cell.policy} failed on {cell.env_id}: {record.error}")
    return list(dict.fromkeys(sentences))


def left_out(records: Sequence[Record]) -> list[str]:
    """One sentence per held-out motion that counts for no policy."""
    sentences = []
    for best in scores.best_known_payloads(records).values():
        if best.payload is None and "seed" in best.cell.trajectory:
            sentences.append(
                f"{task_title(best.cell)} counts for no policy on {best.cell.env_id}: "
                "no best known payload was verified"
            )
    return sentences


def fallbacks(records: Sequence[Record]) -> list[str]:
    """One sentence per policy and environment with fallbacks at the DLCC."""
    groups: dict[tuple[str, str], list[float]] = {}
    for score in scores.scores(records):
        number = score.result.get("fallbacks")
        if number is not None:
            groups.setdefault((score.cell.policy, score.cell.env_id), []).append(number)
    sentences = []
    for (policy, env_id), numbers in groups.items():
        if max(numbers) > 0:
            cells = sum(number > 0 for number in numbers)
            sentences.append(
                f"{policy} on {env_id} used its fallback up to {max(numbers):.3g} times per "
                f"episode, in {cells} of {len(numbers)} cells"
            )
    return sentences
