"""The page of the reproduction in Markdown, generated from the contents of results.json."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cablebot_reproduction.findings import FILES
from cablebot_reproduction.texts import as_text, fill

Results = Mapping[str, Any]
"""Contents of results.json."""

_GROUPS = {
    "Robots": ("sizes",),
    "Tracking": ("fig5", "fig6", "fig7", "fig8", "fig9"),
    "Payload": ("fig10", "fig11", "fig12", "fig13", "fig14", "fig15"),
    "Equations and claims": ("eq37", "eq22", "claims"),
    "Interpretations": ("interpretations", "scan"),
}

_COLUMNS = ("Where", "The paper", "Published", "Ours", "Conditions", "Verdict", "Evidence")


_REFERENCE = re.compile(r"\s*The section \*(\w+)\*.*?\.(?=\s+\D|\s*$)", re.DOTALL)
"""A sentence that points to a section."""


def markdown(results: Results, *, has_errata: bool = True) -> str:
    """The page. The figures are files in the same folder, and the errata if they are there.

    Sentences that point to sections without their parts are left out.
    """
    blocks = _blocks(results)
    if not has_errata:
        blocks = (block for block in blocks if not block.startswith("[Errata]"))
    text = "\n\n".join(blocks) + "\n"

    def kept(sentence: re.Match[str]) -> str:
        has_section = f"\n## {sentence[1]}\n" in text
        return sentence[0] if has_section else ""

    return _REFERENCE.sub(kept, text)


def read(name: str) -> str:
    """Text of a data file of this package."""
    return FILES.joinpath(name).read_text(encoding="utf-8").strip()


def tally(rows: Sequence[Mapping[str, str]]) -> str:
    """Number of rows with each verdict, as text."""
    counts = Counter(row["verdict"] for row in rows)
    return "; ".join(f"{count} {verdict}" for verdict, count in counts.most_common())


def _blocks(results: Results) -> Iterator[str]:
    for paragraph in read("head.md").split("\n\n"):
        try:
            yield fill(paragraph, results["numbers"])
        except KeyError:  # its parts were not run
            continue
    for kind in ("result", "claim"):
        rows = [row for row in results["rows"] if row["kind"] == kind]
        if not rows:
            continue
        yield f"## {kind.capitalize()}s"
        plural = "s" if len(rows) > 1 else ""
        yield f"{len(rows)} {kind}{plural}: {tally(rows)}."
        cells = []
        for row in rows:
            paper = (row["place"], row["statement"], row["printed"])
            cells.append((*paper, row["ours"], row["conditions"], row["verdict"], row["evidence"]))
        yield _table(_COLUMNS, cells)
    yield read("tail.md")
    texts = dict(section.split("\n", 1) for section in read("parts.md").split("\n## ")[1:])
    sections = {heading.partition(": ")[0]: (heading, text) for heading, text in texts.items()}
    for group, names in _GROUPS.items():
        run = [name for name in names if name in results["parts"]]
        if run:
            yield f"## {group}"
        for name in run:
            yield from _part(name, *sections[name], results)


def _part(name: str, heading: str, text: str, results: Results) -> Iterator[str]:
    title = heading.partition(": ")[2]
    part = results["parts"][name]
    yield f"### {title}"
    yield text.strip()
    if part["figure"]:
        yield f"![{title}]({name}.svg)"
    rows = []
    for number in dict.fromkeys(re.findall(r"`(\w+)`", text)):  # in the order of the text
        if f"{name}.{number}" in results["numbers"]:
            rows.append((f"`{number}`", results["numbers"][f"{name}.{number}"]))
    if rows:
        yield _table(("number", "value"), rows)
    for table in part["tables"]:
        yield f"**{_escaped(table['title'])}**"
        yield _table(table["header"], table["rows"])


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table in Markdown."""
    lines = [list(map(_escaped, header)), ["---"] * len(header)]
    lines += [[_escaped(as_text(value)) for value in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escaped(text: str) -> str:
    """Escapes text for a table. Text between backticks remains code."""
    pieces = text.split("`")
    pieces[::2] = [
        re.sub(r"([\\*<\[\]]|(?<!\w)_|_(?!\w))", r"\\\1", piece) for piece in pieces[::2]
    ]
    return "`".join(pieces).replace("|", "\\|")
