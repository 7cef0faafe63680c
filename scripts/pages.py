"""Writes LEADERBOARD.md, paper/paper.md, and the blocks of the hand-written pages that come from the
code or from stored results.

A block stands between two comments, so that the page is plain Markdown, on the site and on a forge:

    <!-- NAME: written by scripts/pages.py -->
    <!-- end of NAME -->

NAME is ``leaderboard`` (the best policy of each kind), ``recommendations`` (the best policies by what
is known of a robot), ``measurement`` (payload lost by sensors and errors), ``errors`` (payload with
each error alone), ``library payloads`` (payloads of laws on the real robots), a table of ``cablebot
list``, or a script in ``examples/``, with its output if the name ends in ``and output``.

python scripts/pages.py
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import measure_winches
import numpy as np

from cablebot_gym.benchmark.leaderboard import (
    errors_text,
    library_tables,
    markdown,
    origins_text,
)
from cablebot_gym.benchmark.scores import (
    Leaderboard,
    best_known_rows,
    leaderboards,
    scores,
    verified_payload,
)
from cablebot_gym.benchmark.store import Results, file_of, read
from cablebot_gym.benchmark.tables import heading, markdown_table, motion_title
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.bounds.robot_check import check_motion
from cablebot_gym.cli.listing import tables
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import KIND_TEXTS

ROOT = Path(__file__).resolve().parents[1]
PAPER = ROOT / "paper" / "paper.md"

PAGES = (
    "README.md",
    "docs/getting-started.md",
    "docs/environments.md",
    "docs/policies.md",
    "docs/measurement.md",
    "docs/robots.md",
    "docs/uncertainty.md",
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
    """Sentence and table: the best policy of each kind in each environment, by the main tables of
    the leaderboard."""
    boards = [board for board in leaderboards(results.rows) if board.is_main]
    entries = policy_entries()
    rows = [["environment", *KINDS.values()]]
    for board in boards:
        row = [f"`{board.env_id}`"]
        for kind in KINDS:
            row.append(
                _best(board, [name for name in board.policies if entries[name].kind == kind])
            )
        rows.append(row)
    column = boards[0].columns[0]
    motions = motion_title(column.trajectory["name"], boards[0].motions(column))
    conditions = f"{motions}, {heading(column)}"
    text = "The best policy of each kind: mean fraction of the payload that can be hoped for\n"
    text += f"({conditions}).\n{origins_text(results.rows).lstrip()}\n"
    return text + markdown_table(rows)


def _best(board: Leaderboard, policies: Sequence[str]) -> str:
    """The best of some policies of a table, in its order, with its fraction and its ties."""
    if not policies:
        return "–"
    policy = policies[0]
    fraction = board.fraction(policy, board.columns[0])
    if fraction is None or fraction.mean <= 0:
        return "–"
    ties = []
    for follower in policies[1:]:
        if board.ranks[follower] == board.ranks[policy]:
            ties.append(f"`{follower}`")
    text = f"`{policy}` {fraction.mean:.0%}"
    if ties:
        text += f" (tied with {', '.join(ties)})"
    return text


def recommendations(results: Results, of_library: Results) -> str:
    """The best policies by what is known of a robot: those of the leaderboard, and the laws on the
    real robots."""
    boards = leaderboards(results.rows)
    main = {board.env_id: board for board in boards if board.is_main}
    rows = [
        [
            "robot of",
            "exact tracking",
            "exactly known",
            "known within ranges",
            "the same, in time without a plan",
        ]
    ]
    for board in boards:
        if not board.is_main:
            ranges = main[board.env_id]
            in_time = [name for name in ranges.policies if _is_in_time(ranges.timings.get(name))]
            rows.append(
                [
                    f"`{board.env_id}`",
                    f"{exact_tracking(results, board):.0%}",
                    _best(board, board.policies),
                    _best(ranges, ranges.policies),
                    _best(ranges, in_time),
                ]
            )
    evaluated = {policy for board in main.values() for policy in board.policies}
    for board in boards:
        if not board.is_main:
            evaluated -= set(board.policies)
    text = f"\n{markdown_table(rows)}\nIn time: a start of at most {START:g} s, and at most {LATE:.0%} late actions."
    if evaluated:
        names = ", ".join(f"`{name}`" for name in sorted(evaluated))
        text += f"\nNot evaluated on exactly known robots: {names}."
    return f"{text}\n\n{markdown_table(_library_rows(of_library))}\n"


def _is_in_time(timing: Mapping[str, Any] | None) -> bool:
    """Whether a policy starts and acts in time, as far as its computing times are stored."""
    return timing is not None and timing["start"] <= START and timing["missed"] <= LATE


def _library_rows(results: Results) -> list[list[str]]:
    """Head, and a row for each kind of real robots: their number, and the laws by their mean fraction
    of exact tracking."""
    fractions: dict[tuple[str, str], dict[str, list[float]]] = {}
    for score in scores(results.rows):
        robot = score.conditions.nominal_robot
        laws = fractions.setdefault((KIND_TEXTS[robot.kind], robot.springs), {})
        exact = check_motion(robot).limit.largest
        laws.setdefault(score.row.policy, []).append((score.payload or 0.0) / exact)
    rows = [["real robots", "number", "laws by their fraction of exact tracking"]]
    for (kind, springs), laws in fractions.items():
        means = sorted(
            ((float(np.mean(values)), law) for law, values in laws.items()), reverse=True
        )
        texts = [f"`{law}` {mean:.0%}" for mean, law in means]
        number = len(next(iter(laws.values())))
        rows.append([f"{kind}, {springs}", str(number), ", ".join(texts)])
    return rows


def exact_tracking(results: Results, board: Leaderboard) -> float:
    """The payload with which motors of a known robot track the motions of a table exactly, as a mean
    fraction of the best known payload."""
    entry = max((board.entries[name, board.columns[0]] for name in board.policies), key=len)
    best_known = best_known_rows(results.rows)
    fractions = []
    for score in entry:
        hoped = verified_payload(best_known[score.row.motion_key])
        if hoped:
            given = score.conditions
            fractions.append(exact_payload(given.nominal_robot, given.motion).payload / hoped)
    return float(np.mean(fractions))


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
    if name == "library payloads":
        return f"\n{library_tables(stored('library').rows)}\n"
    if name == "errors":
        return errors_text(stored("errors").rows, "###") + "\n"
    if name == "recommendations":
        return recommendations(stored("ranked"), stored("library"))
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
    main = [board for board in boards if board.is_main]
    spatial = main[0]
    policies = {policy for board in main for policy in board.policies}
    return {
        "policies": len(policies),
        "motions": spatial.motions(spatial.columns[0]),
        "table": readme_table(results).partition("\n\n")[2].strip(),
        "fl_known": _circle(boards, "fl"),
        "fl_unknown": _circle(boards, "fl", payload_known=False, uncertainty="hardware"),
        "robots": spatial.columns[0].draws,
        "best": f"`{spatial.policies[0]}`",
        "best_fraction": _fraction(spatial, spatial.policies[0]),
        "adaptive_fraction": _fraction(spatial, "adaptive"),
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


def _circle(boards: Sequence[Leaderboard], policy: str, **conditions: Any) -> str:
    """Payload of a policy of the spatial robot on the circle, under some conditions."""
    env_id = "CableBot-Spatial-v0"
    trajectory = {"name": "circle-spatial"}
    for board in boards:
        for (name, column), entry in board.entries.items():
            required = Conditions(
                env_id=env_id, trajectory=trajectory, draws=column.draws, **conditions
            )
            if (name, column) == (policy, required):
                if entry[0].payload is None:
                    return "no payload, not even the platform"
                return f"{entry[0].payload_text} kg"
    raise ValueError(f"no row of {policy!r} on the circle")


def _fraction(board: Leaderboard, policy: str) -> str:
    fraction = board.fraction(policy, board.columns[0])
    assert fraction is not None
    return f"{fraction.mean:.0%}"


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
