"""The leaderboard's page to browse, with some episodes: ``cablebot report docs/leaderboard`` records all of them."""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx

from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.leaderboard import read_results
from cablebot_gym.report.page import Source, html, replayed
from cablebot_gym.report.replay import replays
from generate.results import MAPS, RESULTS

SEEN = ("fl", "curve", "composite", "motor-pd")
"""Policies whose episodes are there: on the paper's circle, told."""


def write(app: Sphinx) -> None:
    """Called by Sphinx before it reads code: autodoc puts its own objects for default values, which Gymnasium sees."""
    if app.builder.format != "html":
        return
    source, maps = (Source(*read_results(path.read_text(encoding="utf-8"))) for path in (RESULTS, MAPS))
    usual = {"information": "told", "uncertainty": None, "criterion": "task"}
    seen = {
        key: replays(cell, payload)
        for key, (cell, payload) in replayed(source.records).items()
        if isinstance(cell, PolicyCell)
        and cell.policy in SEEN
        and str(cell.trajectory["name"]).startswith("paper-")
        and all(getattr(cell, name) == value for name, value in usual.items())
    }
    page = html("cablebot_gym leaderboard", [source, maps], seen)
    Path(app.outdir).mkdir(parents=True, exist_ok=True)
    (Path(app.outdir) / "report.html").write_text(page, encoding="utf-8")
