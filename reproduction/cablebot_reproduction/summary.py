"""Summary of the reproduction: which findings of the paper are reproduced, which are not, and the
reasons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cablebot_reproduction.judgement import Run
from cablebot_reproduction.parts.interpretations import closest_payload
from cablebot_reproduction.published import load_table

HEADINGS = {
    "reproduced": "Reproduced",
    "partly reproduced": "Partly reproduced",
    "not reproduced": "Not reproduced",
    "undecided": "Undecided",
}
"""Headings of the lists of points by verdict."""

POINTS: list[dict[str, Any]] = load_table("summary.toml")["point"]
"""``keys`` of published items, their common ``title``, and format strings of their sentences,
``text``."""


def points(run: Run, rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yields the verdict on each point and the point in Markdown. Points that were not run are
    omitted."""
    rows_by_key = {row["key"]: row for row in rows}
    texts = _texts(run)
    for point in POINTS:
        judged = [rows_by_key[key] for key in point["keys"] if key in rows_by_key]
        verdicts = {row["verdict"] for row in judged}
        if len(judged) < len(point["keys"]) or None in verdicts:
            continue
        verdict = "partly reproduced"
        if len(verdicts) == 1:
            verdict = verdicts.pop()
        places = ", ".join(dict.fromkeys([row["place"] for row in judged]))
        sentences = run.sentences(point["text"], **texts)
        yield verdict, f"**{point['title']}** ({places}). {sentences}".rstrip()


def _texts(run: Run) -> dict[str, str]:
    """Texts in the sentences besides the numbers of the run."""
    texts = {
        "closest_spatial": closest_payload(run, "spatial"),
        "closest_flexible": closest_payload(run, "flexible"),
        "fl4_drop": run.sentence_if("fig15.simulated", "{fig15.drop_fraction:%}"),
    }
    return {name: text for name, text in texts.items() if text}
