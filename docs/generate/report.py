"""The leaderboard as an HTML page with some episodes; ``cablebot report docs/leaderboard`` records
all."""

from __future__ import annotations

from pathlib import Path

from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.report.page import html, replay_queries
from cablebot_gym.report.replay import replays
from generate.pages import RESULTS

RECORDED = ("fl", "ppo-circle", "composite", "motor-pd")
"""Policies with recorded episodes on the circle, payload known."""


def write(folder: Path) -> None:
    """Writes ``report.html`` into a folder."""
    results = Results.from_json(RESULTS.read_text(encoding="utf-8"))
    recorded = {}
    for key, (cell, payload) in replay_queries(results.records).items():
        if not isinstance(cell, PolicyCell) or cell.policy not in RECORDED:
            continue
        on_circle = str(cell.trajectory["name"]).startswith("circle-")
        model = (cell.payload_known, cell.model_payload_factor)
        if (
            on_circle
            and model == (True, 1.0)
            and (cell.uncertainty, cell.criterion) == (None, "task")
        ):
            recorded[key] = replays(cell, payload)
    folder.mkdir(parents=True, exist_ok=True)
    page = html("cablebot_gym leaderboard", [results], recorded)
    (folder / "report.html").write_text(page, encoding="utf-8")
