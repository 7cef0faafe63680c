"""The leaderboard page of the results of a suite."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files

from cablebot_gym.benchmark import tables
from cablebot_gym.benchmark.ranking import CONFIDENCE, RANKED_MOTIONS
from cablebot_gym.benchmark.rows import Row, canonical
from cablebot_gym.benchmark.scores import (
    Leaderboard,
    is_main,
    leaderboards,
)
from cablebot_gym.benchmark.store import Results
from cablebot_gym.benchmark.suites import find_suite
from cablebot_gym.benchmark.yardstick import PROBABILITY

_INTRODUCTION = """# Leaderboard

Payload that a policy carries (DLCC) as a fraction of the [optimum](#definitions) of the motion: the mean over motions,
its interval, and the worst motion. Single motions have the payload [kg], too.
"""


def markdown(results: Results) -> str:
    """The leaderboard page: a table for each environment, and notes."""
    rows = results.rows
    boards = leaderboards(rows)
    text = _INTRODUCTION + _main_text(boards)
    for board in boards:
        text += f"\n## {board.env_id}\n\n{_table(tables.leaderboard_rows(board))}"
    yardsticks = tables.yardstick_rows(rows)
    if len(yardsticks) > 1:
        text += f"\n## Yardsticks, as fractions of the optimum\n\n{_table(yardsticks)}"
    text += _notes_text(rows)
    # suite, command and versions that all results have
    common = _common(_versions(rows))
    versions = ", ".join(f"{name} {version}" for name, version in common.items())
    summary = find_suite(results.suite).summary
    origin = (
        f"Suite `{results.suite}` ({summary}), computed by `{results.command}` with {versions}."
    )
    return f"{text}\n{_definitions(results, boards)}\n{origin}\n"


def _main_text(boards: Sequence[Leaderboard]) -> str:
    """What the main column is; empty without one."""
    if not boards or not is_main(boards[0].columns[0]):
        return ""
    column = boards[0].columns[0]
    robots = column.draws or 1
    probability = robots / (robots + 1)
    return f"""
The first column ranks policies on robots that are not exactly known. On each motion, the payload is the largest one
that {robots} random robots carry (`{column.uncertainty}`). A further one carries it with a probability of
{probability:.0%}. A fraction is that of what a planner can hope for that knows each robot: the yardstick.
"""


def _common(sets: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """The versions that several sets agree on."""
    first, *others = sets
    common = {}
    for name, version in first.items():
        if all(versions.get(name) == version for versions in others):
            common[name] = version
    return common


def _notes_text(rows: Sequence[Row]) -> str:
    notes = [*map(_escaped, tables.failures(rows)), *map(_escaped, tables.left_out(rows))]
    if not notes:
        return ""
    return "\n## Notes\n\n" + "".join(f"* {note}\n" for note in notes)


def _definitions(results: Results, boards: Sequence[Leaderboard]) -> str:
    """Definitions, with what the results have: error bounds, seeds and processors."""
    payloads = [row for row in results.rows if row.measure == "payload"]
    path = files("cablebot_gym.benchmark") / "leaderboard_definitions.md"
    return path.read_text(encoding="utf-8").format(
        bounds=_bounds_text(payloads),
        seeds=_seeds_text(results.seed_text),
        processors=_processors_text(boards),
        confidence=CONFIDENCE,
        ranked=RANKED_MOTIONS,
        quantile=PROBABILITY,
    )


def _bounds_text(rows: Sequence[Row]) -> str:
    """The error bounds of the environments; that of the rotation only where there is one."""
    environments: dict[str, dict[str, None]] = {}
    for row in rows:
        bounds = row.conditions.bounds
        text = f"{1e3 * bounds.position:g} mm"
        if row.conditions.nominal_robot.kind not in ("planar", "point"):
            text += f" and {1e3 * bounds.rotation:g} mrad"
        environments.setdefault(text, {})[f"`{row.conditions.env_id}`"] = None
    if len(environments) == 1:
        return next(iter(environments))
    return "; ".join(f"{text} ({', '.join(env_ids)})" for text, env_ids in environments.items())


def _seeds_text(seed_text: str | None) -> str:
    if seed_text is None:
        return ""
    return f""" Their seeds and the evaluation seed follow by SHA-256 from the text
  `{json.dumps(seed_text, ensure_ascii=False)}`.
  It is new at every release: policies may have been tuned on the motions of earlier ones, and those that
  changed after it was fixed on these."""


def _processors_text(boards: Sequence[Leaderboard]) -> str:
    timings = [timing for board in boards for timing in board.timings.values()]
    processors = sorted({str(timing["processor"]) for timing in timings})
    return f" Measured on: {', '.join(processors)}." if processors else ""


def _versions(rows: Sequence[Row]) -> list[Mapping[str, str]]:
    """The distinct sets of package versions."""
    distinct = {canonical(dict(row.versions)): row.versions for row in rows}
    return list(distinct.values())


def _escaped(text: str) -> str:
    """A text, such as the error of a policy, without any meaning as Markdown or HTML."""
    return re.sub(r"([\\`*_~#&<>|\[\]])", r"\\\1", text)


def _table(rows: Sequence[Sequence[str]]) -> str:
    escaped = [[cell.replace("*", "\\*") for cell in row] for row in rows]
    return tables.markdown_table(escaped, right=len(rows[0]) - 1)
