"""Writes paper/paper.md: the text of paper/template.md with the numbers of the stored results.

python scripts/joss_paper.py
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from string import Template
from typing import Any

from page_blocks import readme_table

from cablebot_baselines.paper.page import tally
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import (
    Column,
    Leaderboard,
    Score,
    best_known_payloads,
    leaderboards,
)

ROOT = Path(__file__).resolve().parents[1]
PAPER = ROOT / "paper" / "paper.md"


def paper() -> str:
    """The text of paper/paper.md."""
    results = Results.from_json(
        (ROOT / "docs" / "leaderboard" / "results.json").read_text(encoding="utf-8")
    )
    reproduction = json.loads(
        (ROOT / "docs" / "reproduction" / "results.json").read_text(encoding="utf-8")
    )
    template = (ROOT / "paper" / "template.md").read_text(encoding="utf-8")
    return Template(template).substitute(_of_leaderboard(results), **_of_reproduction(reproduction))


def _of_leaderboard(results: Results) -> dict[str, Any]:
    if results.board is None:
        raise ValueError("docs/leaderboard has no board: run the suite ranked")
    boards = leaderboards(results.records)
    spatial = next(board for board in boards if board.env_id == "CableBot-Spatial-v0")
    hardware = [
        (board, _circle(board, payload_known=False, uncertainty="hardware")) for board in boards
    ]
    bounds = [
        known.payload / known.result["upper"]["payload"]
        for known in best_known_payloads(results.records).values()
        if known.payload is not None and known.result.get("upper")
    ]
    entries = [score for _, scores in hardware for score in scores]
    (draws,) = {score.cell.draws for score in entries}
    return {
        "version": results.board.version,
        "policies": len(results.board.policies),
        "motions": results.board.motions,
        "environments": len(boards),
        "table": readme_table(results).partition("\n\n")[2].strip(),
        "bounded": len(bounds),
        "ratio": f"{median(bounds):.1%}",
        "smallest_ratio": f"{min(bounds):.1%}",
        "fl_known": _payload(_circle(spatial), "fl"),
        "fl_unknown": _payload(_circle(spatial, payload_known=False, uncertainty="sensors"), "fl"),
        "adaptive_unknown": _payload(
            _circle(spatial, payload_known=False, uncertainty="sensors"), "adaptive"
        ),
        "draws": draws,
        "tried": len(entries),
        "carry": sum(score.payload is not None for score in entries),
        "trajopt": sum(
            score.payload is not None for score in entries if score.cell.policy == "trajopt"
        ),
        "hardware": _largest(hardware),
    }


def _of_reproduction(stored: dict[str, Any]) -> dict[str, str]:
    rows = {row["key"]: row for row in stored["rows"]}
    planar = rows["5.2.1.payload"]
    spatial = rows["5.2.2.payload"]
    return {
        **{
            f"{kind}s": tally([row for row in rows.values() if row["kind"] == kind])
            for kind in ("result", "claim")
        },
        **{"planar_printed": planar["printed"], "planar_ours": planar["ours"]},
        **{"spatial_printed": spatial["printed"], "spatial_ours": spatial["ours"]},
    }


def _circle(board: Leaderboard, **conditions: Any) -> list[Score]:
    """Scores of a table's policies on the circle, under conditions of a :class:`Column`."""
    found = []
    for (_, column), scores in board.entries.items():
        wanted = Column(motion=column.motion, draws=column.draws, **conditions)
        if column == wanted and column.motion.startswith("circle-"):
            found.extend(scores)
    return found


def _payload(scores: Sequence[Score], policy: str) -> str:
    (text,) = (score.payload_text for score in scores if score.cell.policy == policy)
    return f"{text} kg"


def _largest(tables: Sequence[tuple[Leaderboard, Sequence[Score]]]) -> str:
    texts = []
    for board, scores in tables:
        best = max(scores, key=lambda score: score.payload or 0.0)
        texts.append(f"{best.payload_text} kg (`{board.env_id}`, `{best.cell.policy}`)")
    return ", ".join(texts[:-1]) + f" and {texts[-1]}"


def main() -> None:
    """Writes paper/paper.md."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    PAPER.write_text(paper(), encoding="utf-8")


if __name__ == "__main__":
    main()
