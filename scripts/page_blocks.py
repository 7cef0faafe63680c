"""Writes the blocks of the hand-written pages that come from the code or from stored results.

A block stands between two comments, so that the page is plain Markdown, on the site and on a forge:

    <!-- NAME: written by scripts/page_blocks.py -->
    <!-- end of NAME -->

NAME is ``leaderboard`` (the best policy of each kind), ``main table`` (of the present policies),
``measurement`` (payload lost by sensors and errors), ``errors`` (payload with each error alone),
``library`` (the real robots), ``library payloads`` (payloads of laws on them), a table of
``cablebot list``, or a script in ``examples/``, with its output if the name ends in ``and output``.

python scripts/page_blocks.py
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

import main_table
import measure_winches
from markdown_table import markdown_table

from cablebot_gym.benchmark.leaderboard import Results, errors_text, library_tables
from cablebot_gym.benchmark.scores import Column, Leaderboard, best_known_payloads, leaderboards
from cablebot_gym.benchmark.tables import heading, motion_title
from cablebot_gym.bounds.robot_check import MotionCheck, RobotCheck, check_model, check_motion
from cablebot_gym.cli.listing import tables
from cablebot_gym.cli.robot import motion_report, report
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import ELASTIC, find_robot, library

ROOT = Path(__file__).resolve().parents[1]

PAGES = (
    "README.md",
    "docs/index.md",
    "docs/getting-started.md",
    "docs/environments.md",
    "docs/policies.md",
    "docs/which-controller.md",
    "docs/measurement.md",
    "docs/robots.md",
    "docs/uncertainty.md",
)
"""Pages with blocks."""

WITH_OUTPUT = " and output"

_BLOCK = re.compile(
    r"(<!-- (.+?): written by scripts/page_blocks\.py -->\n)(.*?)(<!-- end of \2 -->)", re.DOTALL
)

KINDS = {"classical": "control law", "learned": "learned", "optimal": "trajectory optimisation"}
"""Kinds of policies and their headings."""


def readme_table(results: Results) -> str:
    """Sentence and table: the best policy of each kind in each environment, by the first column of
    the leaderboard."""
    boards = leaderboards(results.records)
    first = boards[0].columns[0]
    motion = motion_title(first, boards[0].motions(first))
    boards_of: dict[str, list[Leaderboard]] = {}
    for board in boards:
        boards_of.setdefault(board.env_id, []).append(board)
    rows = [["environment", *KINDS.values(), "best known on the circle"]]
    for env_id, boards_of_env in boards_of.items():
        row = [f"`{env_id}`", *(_best(boards_of_env, kind) for kind in KINDS)]
        columns = len(row)
        for known in best_known_payloads(results.records).values():
            on_circle = str(known.cell.trajectory["name"]).startswith("circle-")
            if known.cell.env_id == env_id and on_circle and known.payload:
                row.append(f"{known.payload:.2f} kg")
        if len(row) == columns:
            row.append("–")
        rows.append(row)
    reference = "best known payload"
    if boards[0].is_main:
        reference = "payload that can be hoped for"
    text = f"The best policy of each kind: mean fraction of the {reference}\n({motion}, {heading(first)}),\n"
    text += "and its payload on the circle with an exactly known robot.\n\n"
    return text + markdown_table(rows)


def _best(boards: list[Leaderboard], kind: str) -> str:
    """The best policy of a kind in the first of the tables of an environment, with its fraction, its
    payload on the circle, and its ties."""
    board = boards[0]
    entries = policy_entries()
    # By decreasing fraction. A board may have policies that are not installed any more.
    installed = [policy for policy in board.policies if policy in entries]
    policies = [policy for policy in installed if entries[policy].kind == kind]
    if not policies:
        return "–"
    policy = policies[0]
    fraction = board.fraction(policy, board.columns[0])
    if fraction is None or fraction.mean <= 0:
        return "–"
    text = f"`{policy}` {fraction.mean:.0%}"
    for table in boards:
        for (name, column), entry in table.entries.items():
            if name == policy and _circle(column):
                text += f", {entry[0].payload_text}"
                if entry[0].payload is not None:
                    text += " kg"
    ties = []
    for follower in policies[1:]:
        if policy in board.ranks and board.ranks.get(follower) == board.ranks[policy]:
            ties.append(f"`{follower}`")
    if ties:
        text += f" (tied with {', '.join(ties)})"
    return text


def _circle(column: Column) -> bool:
    return column == Column(motion=column.motion) and column.motion.startswith("circle-")


def library_pages() -> str:
    """Drawing, check and sources of each robot of the library, with about half of the payload that
    it carries."""
    text = ""
    for name, path in library().items():
        check, motion = shown_checks(name)
        about = re.findall(r"^# (.*)", path.read_text(encoding="utf-8"), re.MULTILINE)
        text += f"## {name}\n\n" + "\n".join(about) + "\n\n"
        text += f"![{name}: plan, elevations and workspace](figures/robot-{name}.png)\n\n"
        command = f"cablebot robot check {check.robot.name} --payload {check.payload:g}"
        lines = [f"$ {command}", *report(check), *motion_report(check, motion, "")]
        text += "```text\n" + "\n".join(lines) + "\n```\n\n"
        text += "| value | range | source |\n| --- | --- | --- |\n"
        for field, source in check.robot.sources.items():
            ends = " to ".join(f"{value:g}" for value in check.robot.ranges.get(field, ()))
            text += f"| `{field}` | {ends} | {re.sub('^assumed', '**assumed**', source)} |\n"
        text += "\n"
    return "\n" + text


def shown_checks(name: str) -> tuple[RobotCheck, MotionCheck]:
    """Checks of a robot of the library with elastic cables and half of its payload, rounded to two
    digits."""
    robot = find_robot(ELASTIC + name)
    payload = float(f"{check_motion(robot).limit.largest / 2:.2g}")
    return check_model(robot, payload=payload), check_motion(robot, payload=payload)


def block(name: str) -> str:
    """The text of a block.

    Raises:
        KeyError: if no block has this name.
    """
    if name == "leaderboard":
        return readme_table(
            Results.from_json((ROOT / "docs/leaderboard/results.json").read_text(encoding="utf-8"))
        )
    if name == "library":
        return library_pages()
    if name == "library payloads":
        stored = (ROOT / "docs/library/results.json").read_text(encoding="utf-8")
        return f"\n{library_tables(Results.from_json(stored).records)}\n"
    if name == "errors":
        stored = (ROOT / "docs/errors/results.json").read_text(encoding="utf-8")
        return errors_text(Results.from_json(stored).records, "###") + "\n"
    if name == "main table":
        return main_table.table(
            main_table.read(main_table.BOARD), main_table.read(main_table.RESULTS)
        )
    if name == "measurement":
        return measure_winches.table(
            json.loads((measure_winches.FOLDER / "results.json").read_text(encoding="utf-8"))
        )
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


def main() -> None:
    """Writes the blocks of all pages."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    for page in PAGES:
        path = ROOT / page
        text = path.read_text(encoding="utf-8")
        path.write_text(
            _BLOCK.sub(lambda match: match[1] + block(match[2]) + match[4], text), encoding="utf-8"
        )


if __name__ == "__main__":
    main()
