"""The tables of the benchmark: entries as text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from cablebot_gym.benchmark import scores
from cablebot_gym.benchmark.policy_source import shipped_entry
from cablebot_gym.benchmark.rows import Row
from cablebot_gym.benchmark.yardstick import PROBABILITY, yardsticks
from cablebot_gym.evaluation.conditions import Conditions


def heading(column: Conditions) -> str:
    """Conditions of a column: payload model, uncertainty, number of robots and, if it is not
    ``task``, the criterion."""
    words = [column.payload_model]
    if column.uncertainty:
        words += [column.uncertainty, f"{column.draws} robots"]
    if column.criterion == "paper":
        words.append("paper criterion [kg]")  # there is no fraction of the optimum
    return ", ".join(words)


def motion_title(motion: str, motions: int = 1) -> str:
    """A motion, or a number of motions of its family."""
    if motion.startswith("circle-"):
        return "circle"
    if motion.startswith("paper-"):
        return "the paper's circle"
    if motions > 1:
        return f"{motions} held-out motions"
    return f"held-out motion of {motion}"


def column_titles(leaderboard: scores.Leaderboard) -> list[str]:
    """Titles of the columns of a table: motion and conditions."""
    return [
        f"{motion_title(column.trajectory['name'], leaderboard.motions(column))}: {heading(column)}"
        for column in leaderboard.columns
    ]


def entry_text(leaderboard: scores.Leaderboard, policy: str, column: Conditions) -> str:
    """Table entry of a policy in a column: payload [kg] and fraction, or the mean fraction of
    several motions."""
    entry = leaderboard.entries.get((policy, column), ())
    if not entry:
        return "–"
    errors = sum(score.row.error is not None for score in entry)
    if errors == len(entry):
        return "error"
    if not all(score.applicable for score in entry):
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
    """Name of a policy as code, with its marks."""
    text = f"`{policy}`"
    entry = shipped_entry(policy)
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


def task_title(row: Row) -> str:
    """The motion of a row."""
    if row.family:
        return f"{row.motion} {row.conditions.trajectory['seed']}"
    return row.motion


def yardstick_rows(rows: Sequence[Row]) -> list[list[str]]:
    """Head and rows of the table of the yardsticks: that under uncertainty, and the best known payload
    of each motion that has one, as a fraction of its optimum."""
    quantile = f"{PROBABILITY:.0%} quantile"
    lines = [["environment", "robots", quantile, "mean", "without a motion", "best known payloads"]]
    optima = scores.optima(rows)
    verified: dict[str, list[str]] = {}
    for key, row in scores.rows_of(rows, "best-known").items():
        if key in optima and row.result.get("verified"):
            share = f"{row.result['payload'] / optima[key]:.1%}"
            verified.setdefault(row.conditions.env_id, []).append(share)
    for (env_id, _), stick in yardsticks(rows).items():
        quantile = f"{stick.quantile:.1%} [{stick.low:.1%}, {stick.high:.1%}]"
        robots = str(stick.draws + stick.missing)
        shares = ", ".join(verified.get(env_id, ["–"]))
        mean = f"{stick.mean:.1%}"
        lines.append([env_id, robots, quantile, mean, str(stick.missing), shares])
    return lines


def failures(rows: Sequence[Row]) -> list[str]:
    """One sentence per distinct error of a policy, or of a search for what a motion allows."""
    sentences = []
    for row in rows:
        if row.error is not None and row.measure != "drawn":
            name = row.policy or f"the search ({row.measure})"
            sentences.append(f"{name} failed on {row.conditions.env_id}: {row.error}")
    return list(dict.fromkeys(sentences))


def left_out(rows: Sequence[Row]) -> list[str]:
    """One sentence per held-out motion that counts for no policy."""
    sentences = []
    optima = scores.optima(rows)
    for key, row in scores.rows_of(rows, "optimum").items():
        if row.family and key not in optima:
            sentences.append(
                f"{task_title(row)} counts for no policy on {row.conditions.env_id}: it has no optimum"
            )
    return sentences


def due(rows: Sequence[Row]) -> list[str]:
    """One sentence per policy, or per measure without policy, with rows that other code has
    computed."""
    counts: dict[str, list[bool]] = {}
    for row in rows:
        counts.setdefault(row.policy or row.measure, []).append(row.is_due)
    sentences = []
    for name, is_due in counts.items():
        if any(is_due):
            sentences.append(f"{name}: {sum(is_due)} of {len(is_due)} rows are due")
    return sentences


def markdown_table(rows: Iterable[Sequence[str]], *, right: int = 0) -> str:
    """A table in Markdown whose first row is its head.

    Args:
        rows: the rows.
        right: number of right-aligned columns, the last ones.
    """
    head, *body = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    rule = ["---"] * (len(head) - right) + ["---:"] * right
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, rule, *body))
