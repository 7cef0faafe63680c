"""Writes paper/paper.md: the text of paper/template.md with the numbers of the stored results.

python scripts/joss_paper.py
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from page_blocks import readme_table

from cablebot_gym.benchmark.cells import PolicyCell, SurveyCell
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import (
    Column,
    Leaderboard,
    Score,
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
        (ROOT / "reproduction" / "docs" / "results.json").read_text(encoding="utf-8")
    )
    template = (ROOT / "paper" / "template.md").read_text(encoding="utf-8")
    return Template(template).substitute(_of_leaderboard(results), **_of_reproduction(reproduction))


def _of_leaderboard(results: Results) -> dict[str, Any]:
    boards = leaderboards(results.records)
    env_ids = list(dict.fromkeys(board.env_id for board in boards))
    spatial = _circle(boards, "CableBot-Spatial-v0")
    hardware = {}
    entries = []
    for env_id in env_ids:
        hardware[env_id] = _circle(boards, env_id, payload_known=False, uncertainty="hardware")
        entries += hardware[env_id]
    unknown = hardware["CableBot-Spatial-v0"]
    carrying = [score.cell.policy for score in entries if score.payload is not None]
    (draws,) = {score.cell.draws for score in entries}
    cells = [record.cell for record in results.records]
    policies = {cell.policy for cell in cells if isinstance(cell, PolicyCell)}
    motions = max(len(cell.parts) for cell in cells if isinstance(cell, SurveyCell))
    return {
        "policies": len(policies),
        "motions": motions,
        "environments": len(env_ids),
        "table": readme_table(results).partition("\n\n")[2].strip(),
        "fl_known": _payload(spatial, "fl"),
        "fl_unknown": _payload(unknown, "fl"),
        "adaptive_unknown": _payload(unknown, "adaptive"),
        "draws": draws,
        "tried": len(entries),
        "carry": len(carrying),
        "trajopt": carrying.count("trajopt"),
        "hardware": _largest(hardware),
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


def _circle(boards: Sequence[Leaderboard], env_id: str, **conditions: Any) -> list[Score]:
    """Scores of the policies of an environment on the circle, under conditions of a
    :class:`Column`."""
    circle_scores: list[Score] = []
    for board in boards:
        for (_, column), scores in board.entries.items():
            required = Column(motion=column.motion, draws=column.draws, **conditions)
            is_circle = column.motion.startswith("circle-")
            if board.env_id == env_id and column == required and is_circle:
                circle_scores += scores
    return circle_scores


def _payload(scores: Sequence[Score], policy: str) -> str:
    (score,) = (score for score in scores if score.cell.policy == policy)
    if score.payload is None:
        return "no payload, not even the platform"
    return f"{score.payload_text} kg"


def _largest(tables: Mapping[str, Sequence[Score]]) -> str:
    texts = []
    for env_id, scores in tables.items():
        best = max(scores, key=lambda score: score.payload or 0.0)
        texts.append(f"{best.payload_text} kg (`{env_id}`, `{best.cell.policy}`)")
    return ", ".join(texts[:-1]) + f" and {texts[-1]}"


def main() -> None:
    """Writes paper/paper.md."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    PAPER.write_text(paper(), encoding="utf-8")


if __name__ == "__main__":
    main()
