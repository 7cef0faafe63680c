"""Writes LEADERBOARD.md, paper/paper.md, and the blocks of the hand-written pages that come from the
code or from stored results.

A block stands between two comments, so that the page is plain Markdown, on the site and on a forge:

    <!-- NAME: written by scripts/pages.py -->
    <!-- end of NAME -->

NAME is ``leaderboard`` (the best policy of each kind), ``recommendations`` (the best policies by what
is known of a robot), ``measurement`` (payload lost by sensors and errors), ``real robots`` (payloads of
exact tracking), a table of ``cablebot list``, or a script in ``examples/``, with its output if the name
ends in ``and output``.

python scripts/pages.py
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from string import Template
from typing import Any

import measure_winches
import numpy as np

from cablebot_gym.benchmark.leaderboard import (
    markdown,
)
from cablebot_gym.benchmark.scores import (
    Leaderboard,
    leaderboards,
    optima,
    rows_of,
)
from cablebot_gym.benchmark.store import Results, file_of, read
from cablebot_gym.benchmark.tables import heading, markdown_table, motion_title
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.bounds.robot_check import check_motion, two_digits
from cablebot_gym.cli.listing import tables
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import KIND_TEXTS, find_robot, library

ROOT = Path(__file__).resolve().parents[1]
PAPER = ROOT / "paper" / "paper.md"

PAGES = (
    "README.md",
    "docs/getting-started.md",
    "docs/environments.md",
    "docs/policies.md",
    "docs/measurement.md",
    "docs/robots.md",
)
"""Pages with blocks."""

WITH_OUTPUT = " and output"

_BLOCK = re.compile(
    r"(<!-- (.+?): written by scripts/pages\.py -->\n)(.*?)(<!-- end of \2 -->)", re.DOTALL
)

KINDS = {"classical": "control law", "learned": "learned", "optimal": "trajectory optimisation"}
"""Kinds of policies and their headings."""

START, LATE = 1.0, 0.01
"""Longest start [s] and largest fraction of late actions of a policy that acts in time."""


def readme_table(results: Results) -> str:
    """Sentence and table: the best policy of each kind in each environment, by the first column of
    the leaderboard."""
    boards = leaderboards(results.rows)
    entries = policy_entries()
    rows = [["environment", *KINDS.values()]]
    for board in boards:
        row = [f"`{board.env_id}`"]
        for kind in KINDS:
            of_kind = [name for name in board.ranks if entries[name].kind == kind]
            row.append(_best(board, of_kind, board.columns[0]))
        rows.append(row)
    column = boards[0].columns[0]
    motions = motion_title(column.trajectory["name"], boards[0].motions(column))
    conditions = f"{motions}, {heading(column)}"
    text = "The best policy of each kind: mean fraction of the payload that can be hoped for\n"
    return f"{text}({conditions}).\n\n{markdown_table(rows)}"


def _best(board: Leaderboard, policies: Iterable[str], column: Conditions) -> str:
    """The best of some policies in a column, with its fraction, and with its ties in the first one."""
    fractions = {}
    for policy in policies:
        fraction = board.fraction(policy, column)
        if fraction is not None and fraction.mean > 0:
            fractions[policy] = fraction.mean
    if not fractions:
        return "–"
    best, *others = sorted(fractions, key=lambda policy: -fractions[policy])
    text = f"`{best}` {fractions[best]:.0%}"
    ties = []
    if column == board.columns[0]:
        ties = [f"`{name}`" for name in others if board.ranks[name] == board.ranks[best]]
    if ties:
        text += f" (tied with {', '.join(ties)})"
    return text


def recommendations(results: Results) -> str:
    """The best policies by what is known of a robot."""
    rows = [
        [
            "robot of",
            "exact tracking",
            "exactly known",
            "known within ranges",
            "the same, in time without a plan",
        ]
    ]
    for board in leaderboards(results.rows):
        ranges, exact = board.columns[:2]
        in_time = [name for name in board.ranks if _is_in_time(board.timings.get(name))]
        rows.append(
            [
                f"`{board.env_id}`",
                f"{exact_tracking(results, board):.0%}",
                _best(board, board.policies, exact),
                _best(board, board.ranks, ranges),
                _best(board, in_time, ranges),
            ]
        )
    start = f"a start of at most {START:g} s, and at most {LATE:.0%} late actions"
    return f"\n{markdown_table(rows)}\nIn time: {start}.\n"


def _is_in_time(timing: Mapping[str, Any] | None) -> bool:
    """Whether a policy starts and acts in time, as far as its computing times are stored."""
    return timing is not None and timing["start"] <= START and timing["missed"] <= LATE


def exact_tracking(results: Results, board: Leaderboard) -> float:
    """The payload with which motors of a known robot track the motions of a table exactly, as a mean
    fraction of the optimum."""
    fractions = []
    found = optima(results.rows)
    for key, row in rows_of(results.rows, "optimum").items():
        given = row.conditions
        if given.env_id == board.env_id and row.family and key in found:
            payload = exact_payload(given.nominal_robot, given.motion).payload
            fractions.append(max(payload, 0.0) / found[key])
    return float(np.mean(fractions))


def real_robots() -> str:
    """Table of the real robots: the payload of exact tracking on their own motions."""
    rows = [["robot", "platform", "cables", "exact tracking [kg]", "over its ranges [kg]"]]
    for name in library():
        robot = find_robot(name)
        motion = check_motion(robot)
        ranges = "–"
        if motion.payload_range is not None:
            ranges = two_digits(*motion.payload_range)
        exact = two_digits(motion.limit.largest)
        rows.append([f"`{name}`", KIND_TEXTS[robot.kind], str(robot.cables), exact, ranges])
    return markdown_table(rows)


def stored(suite: str) -> Results:
    """The stored results of a suite."""
    return read(file_of(ROOT / "docs" / "results", suite))


def block(name: str) -> str:
    """The text of a block.

    Raises:
        KeyError: if no block has this name.
    """
    if name == "leaderboard":
        return readme_table(stored("ranked"))
    if name == "real robots":
        return f"\n{real_robots()}\n"
    if name == "recommendations":
        return recommendations(stored("ranked"))
    if name == "measurement":
        rows = read(file_of(measure_winches.FOLDER, measure_winches.SUITE)).rows
        return measure_winches.table(rows)
    if name.startswith("examples/"):
        script = ROOT / name.removesuffix(WITH_OUTPUT)
        text = f"```python\n{script.read_text(encoding='utf-8')}```\n"
        if name.endswith(WITH_OUTPUT):
            text += f"\n```text\n{output(script)}```\n"
        return text
    head, *rows = {key: rows for key, _, rows in tables()}[name]
    lines = [head]
    for key, *cells in rows:
        if key:
            key = f"`{key}`"
        lines.append([key, *cells])
    return f"\n{markdown_table(lines)}\n"


def output(script: Path) -> str:
    """What a script prints."""
    return subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=True
    ).stdout


def blocks(text: str) -> dict[str, str]:
    """The blocks of a page by name, as they stand."""
    return {name: body for _, name, body, _ in _BLOCK.findall(text)}


def paper() -> str:
    """The text of paper/paper.md."""
    results = stored("ranked")
    reproduction = json.loads(
        (ROOT / "reproduction" / "docs" / "results.json").read_text(encoding="utf-8")
    )
    template = (ROOT / "paper" / "template.md").read_text(encoding="utf-8")
    return Template(template).substitute(_of_leaderboard(results), **_of_reproduction(reproduction))


def _of_leaderboard(results: Results) -> dict[str, Any]:
    boards = leaderboards(results.rows)
    spatial = next(board for board in boards if board.env_id == "CableBot-Spatial-v0")
    column = spatial.columns[0]
    best = spatial.policies[0]
    entries = policy_entries()
    learned = next(name for name in spatial.policies if entries[name].kind == "learned")
    fractions = {"best": best, "observing": "observing", "learned": learned}
    texts = {}
    for name, policy in fractions.items():
        fraction = spatial.fraction(policy, column)
        assert fraction is not None
        texts[f"{name}_fraction"] = f"{fraction.mean:.0%}"
    return texts | {
        "policies": len({policy for board in boards for policy in board.policies}),
        "environments": len(boards),
        "motions": spatial.motions(column),
        "table": readme_table(results).partition("\n\n")[2].strip(),
        "robots": column.draws,
        "best": f"`{best}`",
    }


def _of_reproduction(stored: dict[str, Any]) -> dict[str, str]:
    rows = {row["key"]: row for row in stored["rows"]}
    verdicts = defaultdict(Counter)
    for row in rows.values():
        verdicts[row["kind"]][row["verdict"]] += 1
    planar = rows["5.2.1.payload"]
    spatial = rows["5.2.2.payload"]
    return {
        "results": _tally(verdicts["result"]),
        "claims": _tally(verdicts["claim"]),
        "planar_printed": planar["printed"],
        "planar_ours": planar["ours"],
        "spatial_printed": spatial["printed"],
        "spatial_ours": spatial["ours"],
    }


def _tally(counts: Counter[str]) -> str:
    verdicts = ("reproduced", "not reproduced", "undecided")
    return "; ".join(f"{counts[verdict]} {verdict}" for verdict in verdicts if counts[verdict])


def main() -> None:
    """Writes the leaderboard, the paper and the blocks of all pages."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    leaderboard = markdown(stored("ranked"))
    (ROOT / "LEADERBOARD.md").write_text(leaderboard, encoding="utf-8")
    PAPER.write_text(paper(), encoding="utf-8")
    for page in PAGES:
        path = ROOT / page
        text = path.read_text(encoding="utf-8")
        path.write_text(
            _BLOCK.sub(lambda match: match[1] + block(match[2]) + match[4], text), encoding="utf-8"
        )


if __name__ == "__main__":
    main()
