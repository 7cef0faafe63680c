"""Summary of the reproduction: which findings of the paper are reproduced, which are not, and the reasons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cablebot_baselines.paper.published import load_table
from cablebot_baselines.paper.verdicts import Run

HEADINGS = {
    "reproduced": "Reproduced",
    "partly reproduced": "Partly reproduced",
    "not reproduced": "Not reproduced",
    "undecided": "Undecided",
}
"""Headings of the lists of points by verdict."""

POINTS: list[dict[str, Any]] = load_table("summary.toml")["point"]
"""``keys`` of published items, their common ``title``, and templates of their ``text``."""


def points(run: Run, rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yields the verdict on each point and the point in Markdown. Points that were not run are omitted."""
    by_key = {row["key"]: row for row in rows}
    for point in POINTS:
        judged = [by_key[key] for key in point["keys"] if key in by_key]
        verdicts = {row["verdict"] for row in judged}
        if len(judged) < len(point["keys"]) or None in verdicts:
            continue
        verdict = verdicts.pop() if len(verdicts) == 1 else "partly reproduced"
        places = ", ".join(dict.fromkeys(row["place"] for row in judged))
        text = run.all_filled((point["text"],) if isinstance(point["text"], str) else point["text"])
        yield verdict, f"**{point['title']}** ({places}). {text}".rstrip()
