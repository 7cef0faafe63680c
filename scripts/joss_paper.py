"""Writes paper/paper.md: the text of paper/template.md with the numbers of the stored results.

python scripts/joss_paper.py
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

from page_blocks import readme_table

from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import Column, Leaderboard, leaderboards

ROOT = Path(__file__).resolve().parents[1]
PAPER = ROOT / "paper" / "paper.md"


def paper() -> str:
    """The text of paper/paper.md."""
    results = Results.from_json(
        (ROOT / "docs" / "leaderboard" / "results.json").read_text(encoding="utf-8")
    )
    reproduction = json.loads(
        (ROOT / "reproduction" / "docs" / "results.json").read_text(encoding="utf-8")
    )
    template = (ROOT / "paper" / "template.md").read_text(encoding="utf-8")
    return Template(template).substitute(_of_leaderboard(results), **_of_reproduction(reproduction))


def _of_leaderboard(results: Results) -> dict[str, Any]:
    boards = leaderboards(results.records)
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
    """Payload of a policy of the spatial robot on the circle, under conditions of a
    :class:`Column`."""
    for board in boards:
        for (name, column), scores in board.entries.items():
            required = Column(motion="circle-spatial", draws=column.draws, **conditions)
            if (board.env_id, name, column) == ("CableBot-Spatial-v0", policy, required):
                if scores[0].payload is None:
                    return "no payload, not even the platform"
                return f"{scores[0].payload_text} kg"
    raise ValueError(f"no row of {policy!r} on the circle")


def _fraction(board: Leaderboard, policy: str) -> str:
    fraction = board.fraction(policy, board.columns[0])
    assert fraction is not None
    return f"{fraction.mean:.0%}"


def main() -> None:
    """Writes paper/paper.md."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    PAPER.write_text(paper(), encoding="utf-8")


if __name__ == "__main__":
    main()
