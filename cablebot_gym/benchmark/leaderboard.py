"""Results of a suite: the JSON file, and the leaderboard page, which is rendered from it."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from rich.markdown import Markdown

from cablebot_gym.benchmark import tables
from cablebot_gym.benchmark.cells import PolicyCell, canonical
from cablebot_gym.benchmark.ranking import CONFIDENCE
from cablebot_gym.benchmark.records import Record, record_from_dict
from cablebot_gym.benchmark.scores import (
    RANKED_MOTIONS,
    BestKnown,
    Leaderboard,
    best_known_payloads,
    error_tables,
    leaderboards,
    scores,
)
from cablebot_gym.benchmark.suites import find_suite
from cablebot_gym.benchmark.yardstick import PROBABILITY
from cablebot_gym.utils.checks import whole
from cablebot_gym.utils.console import results_console
from cablebot_gym.utils.foreign import foreign_json, foreign_list, foreign_object

LINE = 118
"""Largest length of a line of the page, except for tables."""

_INTRODUCTION = """# Leaderboard

Payload [kg] that a policy carries (DLCC), and its fraction of the best known payload: [definitions](#definitions).
"""


@dataclass(frozen=True, kw_only=True)
class Results:
    """The results of one suite."""

    suite: str
    """Name of the suite."""
    command: str
    """Command that computes the results."""
    records: Sequence[Record]
    """Records of all cells."""
    seed_text: str | None = None
    """Public text from which the hidden motions and the evaluation seed follow; None for a suite
    without hidden motions."""

    def to_json(self) -> str:
        """The results as JSON, one cell per line. Equal results give identical bytes."""
        scored = {score.cell.key: score for score in scores(self.records)}
        versions = _versions(self.records)
        lines = []
        for record in self.records:
            entry: dict[str, Any] = {
                "cell": record.cell.to_dict(),
                "source": record.source,
                "versions": versions.index(record.versions),
                "result": record.result,
                "seconds": round(record.seconds, 3),
                "final": record.final,
            }
            if entry["cell"]["kind"] == "policy":
                score = scored[record.cell.key]
                entry |= {"best_known": score.best_known, "score": score.score}
            lines.append(json.dumps(entry, ensure_ascii=False, allow_nan=False))
        head: dict[str, Any] = {
            "suite": self.suite,
            "command": self.command,
            "seed_text": self.seed_text,
            "versions": versions,
        }
        fields = [
            f" {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}"
            for name, value in head.items()
        ]
        fields.append(' "cells": [\n  ' + ",\n  ".join(lines) + "\n ]")
        return "{\n" + ",\n".join(fields) + "\n}\n"

    @classmethod
    def from_json(cls, text: str) -> Results:
        """The results whose :meth:`to_json` returned ``text``.

        Raises:
            ValueError: if the text is something else.
        """
        data = foreign_object("the results", foreign_json(text))
        try:
            versions = foreign_list("versions", data["versions"])
            cells = foreign_list("cells", data["cells"])
            records = []
            for cell in cells:
                fields = foreign_object("a cell", cell)
                index = whole("versions", fields["versions"], most=len(versions) - 1)
                records.append(record_from_dict(fields | {"versions": versions[index]}))
            seed_text = data["seed_text"]
            return cls(
                suite=str(data["suite"]),
                command=str(data["command"]),
                records=records,
                seed_text=None if seed_text is None else str(seed_text),
            )
        except KeyError as error:
            raise ValueError(f"the key {error} is missing") from error
        except (TypeError, AttributeError) as error:  # fields that a record does not have
            raise ValueError(f"a record has other fields: {error}") from error


def markdown(results: Results) -> str:
    """The leaderboard page: a table for each environment, best known payloads and notes."""
    records = results.records
    boards = leaderboards(records)
    main = [board for board in boards if board.is_main]
    second = [board for board in boards if not board.is_main]
    text = _INTRODUCTION
    if main:
        text += (
            f"\n## Robots that are not exactly known\n\n{_main_text(main)}{origins_text(records)}"
        )
    text += _boards_text(main, has_main=True)
    if main and second:
        text += "\n## Robots that are exactly known, and single motions\n"
        text += _absent_text(main, second)
    text += _boards_text(second, has_main=bool(main))
    library = library_tables(records)
    if library:
        text += "\n## Real robots\n\n"
        text += f"Each robot has its own motion, error bounds and payload range.\n\n{library}"
    text += errors_text(records, "##")
    if not main:
        references = best_known_payloads(records).values()
        text += _section("Best known payloads", _best_known_rows(references))
    text += _section(
        "What can be hoped for, as a fraction of the best known payload",
        tables.yardstick_rows(records),
    )
    text += _notes_text(records, boards)
    if results.seed_text is not None:
        text += _hidden_text(results.seed_text)
    # suite, command and versions that all results have
    common = _common(_versions(records))
    versions = ", ".join(f"{name} {version}" for name, version in common.items())
    summary = find_suite(results.suite).summary
    origin = (
        f"Suite `{results.suite}` ({summary}), computed by `{results.command}` with {versions}."
    )
    return f"{text}\n{_definitions(records)}\n{origin}\n"


def _section(title: str, rows: Sequence[Sequence[str]]) -> str:
    """A table under a heading; empty if it has a head only."""
    if len(rows) < 2:
        return ""
    return f"\n## {title}\n\n{_table(rows)}"


def _main_text(boards: Sequence[Leaderboard]) -> str:
    """What the number of the main table is."""
    column = boards[0].columns[0]
    robots = column.draws
    probability = robots / (robots + 1)
    drawn = f"{robots} random robots carry (`{column.uncertainty}`)"
    return f"""On each motion, the payload is the largest one that {drawn}. A further one carries it
with a probability of {probability:.0%}. An entry is the mean of this payload over the motions, as a fraction of what a
planner can hope for that knows each robot, see the [yardsticks](#yardsticks).
"""


def origins_text(records: Sequence[Record]) -> str:
    """Which policies have rows of which :func:`_versions`; empty if there is only one set."""
    sets = _versions(records)
    if len(sets) == 1:
        return ""
    common = _common(sets)
    sentences = []
    for versions in sets:
        policies = set()
        for record in records:
            if isinstance(record.cell, PolicyCell) and record.versions == versions:
                policies.add(record.cell.policy)
        words = [f"{name} {version}" for name, version in versions.items() if name not in common]
        text = ", ".join(words)
        sentences.append(f"{text[:1].upper()}{text[1:]}: {_codes(sorted(policies))}.")
    return f"\n{textwrap.fill(' '.join(sentences), LINE, break_on_hyphens=False)}\n"


def _common(sets: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """The versions that several sets agree on."""
    first, *others = sets
    common = {}
    for name, version in first.items():
        if all(versions.get(name) == version for versions in others):
            common[name] = version
    return common


def _boards_text(boards: Sequence[Leaderboard], *, has_main: bool) -> str:
    """The tables under headings; with main tables, those have a common heading each."""
    text = ""
    for board in boards:
        rows = tables.leaderboard_rows(board)
        level = "###" if has_main else "##"
        title = board.env_id
        if has_main and not board.is_main:
            title += ", exactly known"
        text += f"\n{level} {title}\n\n{_table(rows)}"
    return text


def _absent_text(main: Sequence[Leaderboard], second: Sequence[Leaderboard]) -> str:
    """Which policies have rows in the main tables only; empty if there are none."""
    names = {policy for board in main for policy in board.policies}
    names -= {policy for board in second for policy in board.policies}
    if not names:
        return ""
    return f"\nNot evaluated here: {_codes(sorted(names))}.\n"


def errors_text(records: Sequence[Record], heading: str) -> str:
    """The error tables under headings of a level, such as ``##``."""
    text = ""
    for table in error_tables(records):
        text += f"\n{heading} {tables.error_title(table)}\n\n{_table(tables.error_rows(table))}"
    return text


def _notes_text(records: Sequence[Record], boards: Sequence[Leaderboard]) -> str:
    notes = list(map(_escaped, tables.failures(records)))
    notes += map(_escaped, tables.left_out(records))
    notes += tables.fallbacks(records)
    processors = set()
    for board in boards:
        processors |= {str(timing["processor"]) for timing in board.timings.values()}
    if processors:
        notes.append(f"computing times were measured on: {', '.join(sorted(processors))}")
    if not notes:
        return ""
    return "\n## Notes\n\n" + "".join(f"* {note}\n" for note in notes)


def _definitions(records: Sequence[Record]) -> str:
    """Definitions with the error bounds and the probability of the records."""
    cells = [score.cell for score in scores(records)]
    standard = [cell for cell in cells if cell.robot_name is None]
    cells = standard or cells[:1]
    path = files("cablebot_gym.benchmark") / "leaderboard_definitions.md"
    return path.read_text(encoding="utf-8").format(
        bounds=_bounds_text(cells),
        probability=cells[0].probability,
        confidence=CONFIDENCE,
        ranked=RANKED_MOTIONS,
        quantile=PROBABILITY,
    )


def _bounds_text(cells: Sequence[PolicyCell]) -> str:
    """The error bounds of the environments; that of the rotation only where there is one."""
    environments: dict[str, list[str]] = {}
    for cell in cells:
        text = f"{1e3 * cell.error_bounds['position']:g} mm"
        if cell.robot.kind not in ("planar", "point"):
            text += f" and {1e3 * cell.error_bounds['rotation']:g} mrad"
        env_ids = environments.setdefault(text, [])
        if f"`{cell.env_id}`" not in env_ids:
            env_ids.append(f"`{cell.env_id}`")
    if len(environments) == 1:
        return next(iter(environments))
    return "; ".join(f"{text} ({', '.join(env_ids)})" for text, env_ids in environments.items())


def library_tables(records: Sequence[Record]) -> str:
    """Markdown tables of the robots with their own motions; empty if the records have none."""
    return "\n".join(map(_table, tables.library_rows(records)))


def _hidden_text(seed_text: str) -> str:
    return f"""
## Hidden motions

The hidden motions of each environment and the evaluation seed follow by SHA-256 from the text
`{json.dumps(seed_text, ensure_ascii=False)}`.
If it was fixed after the policies, none of them was made for these motions. That no other text was tried, and
that the payloads were computed, it does not show: `cablebot benchmark --check N` computes random rows again.
"""


def _versions(records: Sequence[Record]) -> list[Mapping[str, str]]:
    """The distinct sets of package versions."""
    distinct = {canonical(dict(record.versions)): record.versions for record in records}
    return list(distinct.values())


def _best_known_rows(references: Iterable[BestKnown]) -> list[list[str]]:
    """A row for each motion, and one for all random motions of an environment."""
    rows = [["environment", "motion", "payload [kg]", "total mass [kg]", "note"]]
    groups: dict[tuple[str, str], list[BestKnown]] = {}
    for best in references:
        groups.setdefault((best.cell.env_id, tables.family_title(best.cell)), []).append(best)
    for (env_id, title), group in groups.items():
        if len(group) == 1:
            title = tables.task_title(group[0].cell)
        medians = []
        for name in ("payload", "total_mass"):
            values = [best.result[name] for best in group if best.result.get(name) is not None]
            medians.append(f"{np.median(values):.3f}" if values else "–")
        rows.append([env_id, title, *medians, _best_known_note(group)])
    return rows


def _best_known_note(group: Sequence[BestKnown]) -> str:
    """The range of several payloads; of a single one, why it does not count."""
    if len(group) == 1:
        (best,) = group
        note = str(best.result.get("error") or "")
        if not note and best.payload is None:
            note = "not verified by the replay"
        return note
    payloads = [best.payload for best in group if best.payload is not None]
    note = f"medians of {len(group)} motions"
    if payloads:
        note += f"; payloads from {min(payloads):.3f} to {max(payloads):.3f}"
    if len(payloads) < len(group):
        note += f"; {len(group) - len(payloads)} without a verified payload"
    return note


def print_page(page: str) -> None:
    """Prints the leaderboard page without its explanations."""
    tables_and_notes, _, definitions = page.partition("\n## Definitions\n")
    command = definitions.rpartition("\n\n")[2]
    text = tables_and_notes[page.index("\n## ") :] + "\n" + command
    results_console().print(Markdown(text))


def _codes(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _escaped(text: str) -> str:
    """A text, such as the error of a policy, without any meaning as Markdown or HTML."""
    return re.sub(r"([\\`*_~#&<>|\[\]])", r"\\\1", text)


def _table(rows: Sequence[Sequence[str]]) -> str:
    cells = [[cell.replace("|", "\\|").replace("*", "\\*") for cell in row] for row in rows]
    cells.insert(1, ["---", *["---:"] * (len(rows[0]) - 1)])
    return "".join(f"| {' | '.join(row)} |\n" for row in cells)
