"""Writes the README's leaderboard: the best policy of each kind on the paper's circle, from the stored results.

python scripts/readme_table.py
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

from cablebot_gym.benchmark.cells import Record
from cablebot_gym.benchmark.leaderboard import read_results
from cablebot_gym.benchmark.scores import Column, Score, best_known_payloads, leaderboards
from cablebot_gym.policies import policy_entries

ROOT = Path(__file__).resolve().parents[1]

MARKS = "<!-- leaderboard: written by scripts/readme_table.py -->\n", "<!-- end of leaderboard -->"

KINDS = {"classical": "control law", "learned": "learned", "optimal": "trajectory optimisation"}
"""Kinds of policies and their headings."""


def readme_table(records: Sequence[Record]) -> str:
    """The table: the best policy of each kind in each environment, payload known, and the best known payload."""
    column = Column(payload_known=True, model_payload_factor=1.0, uncertainty=None, criterion="task", draws=1)
    best_known = {one.cell.env_id: one.payload for one in best_known_payloads(records).values() if _on_circle(one.cell)}
    rows = [["environment", *KINDS.values(), "best known"], ["---"] * (2 + len(KINDS))]
    for board in leaderboards(records):
        if board.motions > 1 or not board.motion.startswith("paper-"):
            continue
        scores = [board.entries[policy, column][0] for policy in board.policies]
        rows.append([f"`{board.env_id}`", *(_best(scores, kind) for kind in KINDS), f"{best_known[board.env_id]:.2f}"])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _on_circle(cell: object) -> bool:
    return str(cell.trajectory["name"]).startswith("paper-")  # type: ignore[attr-defined]


def _best(scores: Sequence[Score], kind: str) -> str:
    entries = policy_entries()
    best = max((one for one in scores if entries[one.cell.policy].kind == kind), key=lambda one: one.score or 0.0)
    return f"`{best.cell.policy}` {best.payload_text} ({best.score:.0%})" if best.score else "–"


def with_table(readme: str, table: str) -> str:
    """The README's text with the table between its marks."""
    start, end = (re.escape(mark) for mark in MARKS)
    return re.sub(f"(?<={start}).*?(?={end})", table, readme, flags=re.DOTALL)


def main() -> None:
    """Writes README.md."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    records = read_results((ROOT / "docs" / "leaderboard" / "results.json").read_text(encoding="utf-8"))[2]
    path = ROOT / "README.md"
    path.write_text(with_table(path.read_text(encoding="utf-8"), readme_table(records)), encoding="utf-8")


if __name__ == "__main__":
    main()
