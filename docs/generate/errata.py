"""Where an equation stands on the page of errata."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

PAGE = Path(__file__).parents[1] / "errata.md"

_NUMBERS = re.compile(r"(\d+)(?:\s*[–-]\s*(\d+))?")
_MENTION = re.compile(r"\bEqs?\.\s*(\d+(?:\s*(?:[–-]|,|and)\s*\d+)*)")


@cache
def anchors() -> dict[int, tuple[str, str]]:
    """Heading and anchor by the number of the equation."""
    found: dict[int, tuple[str, str]] = {}
    for heading in re.findall(r"^## (Eqs?\..*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE):
        anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        found |= dict.fromkeys(_expanded(heading), (heading, anchor))
    return found


def mentioned(text: str) -> str:
    """Links to the errata of the equations that a text names, one after the other; empty if it names none."""
    wanted = sorted({one for numbers in _MENTION.findall(text) for one in _expanded(numbers)})
    links = dict.fromkeys(anchors()[one] for one in wanted)
    return ", ".join(f"[{heading}](/errata.md#{anchor})" for heading, anchor in links)


def _expanded(text: str) -> list[int]:
    """Numbers in words such as ``8 and 10–12``."""
    ranges = [(int(first), int(last or first)) for first, last in _NUMBERS.findall(text)]
    return [one for first, last in ranges for one in range(first, last + 1)]
