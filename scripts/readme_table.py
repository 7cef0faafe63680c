"""Writes the README's leaderboard: the best policy of each kind, from the stored results.

python scripts/readme_table.py
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import Column, Leaderboard, best_known_payloads, leaderboards
from cablebot_gym.benchmark.tables import motion_title
from cablebot_gym.policies import policy_entries

ROOT = Path(__file__).resolve().parents[1]

MARKS = "<!-- leaderboard: written by scripts/readme_table.py -->\n", "<!-- end of leaderboard -->"

KINDS = {"classical": "control law", "learned": "learned", "optimal": "trajectory optimisation"}
"""Kinds of policies and their headings."""


def readme_table(results: Results) -> str:
    """Sentence and table: the best policy of each kind in each environment, by the first column of the leaderboard."""
    boards = leaderboards(results.records)
    motion = motion_title(boards[0].columns[0], boards[0].motions(boards[0].columns[0]))
    rows = [["environment", *KINDS.values(), "best known on the circle"], ["---"] * (2 + len(KINDS))]
    for board in boards:
        known = [
            f"{one.payload:.2f} kg"
            for one in best_known_payloads(results.records).values()
            if (one.cell.env_id, str(one.cell.trajectory["name"])[:7]) == (board.env_id, "circle-") and one.payload
        ]
        rows.append([f"`{board.env_id}`", *(_best(board, kind) for kind in KINDS), *(known or ["–"])])
    text = "The best policy of each kind: mean fraction of the best known payload (payload known, task criterion;\n"
    text += f"{motion}), and its payload on the circle.\n\n"
    return text + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _best(board: Leaderboard, kind: str) -> str:
    entries = policy_entries()
    own = [policy for policy in board.policies if entries[policy].kind == kind]  # by decreasing fraction
    for policy in own[:1]:
        fraction = board.fraction(policy, board.columns[0])
        if fraction is not None and fraction.mean > 0:
            circle = [entry[0] for (name, column), entry in board.entries.items() if name == policy and _circle(column)]
            ties = [
                f"`{one}`" for one in own[1:] if policy in board.ranks and board.ranks.get(one) == board.ranks[policy]
            ]
            unit = " kg" if circle and circle[0].payload is not None else ""
            text = f"`{policy}` {fraction.mean:.0%}" + (f", {circle[0].payload_text}{unit}" if circle else "")
            return text + (f" (tied with {', '.join(ties)})" if ties else "")
    return "–"


def _circle(column: Column) -> bool:
    return column == Column(motion=column.motion) and column.motion.startswith("circle-")


def with_table(readme: str, table: str) -> str:
    """The README's text with the table between its marks."""
    start, end = (re.escape(mark) for mark in MARKS)
    return re.sub(f"(?<={start}).*?(?={end})", table, readme, flags=re.DOTALL)


def main() -> None:
    """Writes README.md."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    results = Results.from_json((ROOT / "docs" / "leaderboard" / "results.json").read_text(encoding="utf-8"))
    path = ROOT / "README.md"
    path.write_text(with_table(path.read_text(encoding="utf-8"), readme_table(results)), encoding="utf-8")


if __name__ == "__main__":
    main()
