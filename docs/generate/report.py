"""The leaderboard as an HTML page with some episodes; ``cablebot report docs/results`` records
all."""

from __future__ import annotations

from pathlib import Path

from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.report.page import html, replay_queries
from cablebot_gym.report.replay import replays
from generate.pages import ranked

RECORDED = ("fl", "composite", "motor-pd")
"""Policies with recorded episodes on the circle, payload known."""


def write(folder: Path) -> None:
    """Writes ``report.html`` into a folder."""
    results = ranked()
    recorded = {}
    for key, row in replay_queries(results.rows).items():
        if row.policy in RECORDED and row.motion.startswith("circle-"):
            usual = Conditions(
                env_id=row.conditions.env_id,
                trajectory=row.conditions.trajectory,
                seed=row.conditions.seed,
            )
            if row.conditions == usual:
                recorded[key] = replays(row)
    folder.mkdir(parents=True, exist_ok=True)
    page = html("cablebot_gym leaderboard", [results], recorded)
    (folder / "report.html").write_text(page, encoding="utf-8")
