"""The leaderboard as an HTML page with some episodes; ``cablebot report docs/leaderboard`` records all."""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx

from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.leaderboard import read_results
from cablebot_gym.report.page import Source, html, replay_queries
from cablebot_gym.report.replay import replays
from generate.results import MAPS, RESULTS

RECORDED = ("fl", "apg-circle", "composite", "motor-pd")
"""Policies with recorded episodes on the paper's circle, payload known."""


def write(app: Sphinx) -> None:
    """Called by Sphinx before it reads code: autodoc puts its own objects for default values, which Gymnasium sees."""
    if app.builder.format != "html":
        return
    source, maps = (Source(*read_results(path.read_text(encoding="utf-8"))) for path in (RESULTS, MAPS))
    usual = {"payload_known": True, "model_payload_factor": 1.0, "uncertainty": None, "criterion": "task"}
    recorded = {
        key: replays(cell, payload)
        for key, (cell, payload) in replay_queries(source.records).items()
        if isinstance(cell, PolicyCell)
        and cell.policy in RECORDED
        and str(cell.trajectory["name"]).startswith("paper-")
        and all(getattr(cell, name) == value for name, value in usual.items())
    }
    page = html("cablebot_gym leaderboard", [source, maps], recorded)
    Path(app.outdir).mkdir(parents=True, exist_ok=True)
    (Path(app.outdir) / "report.html").write_text(page, encoding="utf-8")
