"""Links to the sections of ``docs/errata.md``."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

PAGE = Path(__file__).parents[1] / "errata.md"

_NUMBERS = re.compile(r"(\d+)(?:\s*[–-]\s*(\d+))?")
_MENTION = re.compile(r"\bEqs?\.\s*(\d+(?:\s*(?:[–-]|,|and)\s*\d+)*)")


@cache
def anchors() -> dict[int, tuple[str, str]]:
    """Heading and anchor of the section of each equation, by equation number."""
    sections: dict[int, tuple[str, str]] = {}
    for heading in re.findall(r"^## (Eqs?\..*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE):
        anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        sections |= dict.fromkeys(_equation_numbers(heading), (heading, anchor))
    return sections


def mentioned(text: str) -> str:
    """Comma-separated links to the errata of the equations that a text names; empty if it names
    none."""
    equations: set[int] = set()
    for mention in _MENTION.findall(text):
        equations.update(_equation_numbers(mention))
    links: dict[str, None] = {}  # several equations may share a section
    for number in sorted(equations):
        heading, anchor = anchors()[number]
        links[f"[{heading}](/errata.md#{anchor})"] = None
    return ", ".join(links)


def _equation_numbers(text: str) -> list[int]:
    """All equation numbers in a text such as ``8 and 10–12``."""
    numbers: list[int] = []
    for start, end in _NUMBERS.findall(text):
        numbers += range(int(start), int(end or start) + 1)
    return numbers
