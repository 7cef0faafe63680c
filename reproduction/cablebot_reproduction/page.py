"""Page of the reproduction in Markdown and HTML, generated from results.json."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from string import Template
from typing import Any

from markdown_it import MarkdownIt

from cablebot_reproduction.findings import RULE
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Run
from cablebot_reproduction.published import load_text
from cablebot_reproduction.summary import HEADINGS, points
from cablebot_reproduction.texts import as_text, option_text

Results = Mapping[str, Any]
"""Contents of results.json."""

Row = Mapping[str, Any]
"""One published number or claim with its finding."""

Entry = Mapping[str, Any]
"""One part of the results: title, text, figure and tables."""


TITLE = "Reproduction of the paper"

SOURCE = (
    "Korayem, Tourajizadeh and Bamdad, *Dynamic Load Carrying Capacity of Flexible Cable Suspended Robot: Robust "
    "Feedback Linearization Control Approach* (2010)"
)

ERRATA = "docs/errata.md"
"""List of misprints in the project. The page links to the path ``errata`` of the results."""

_GROUPS = (
    ("Robots", ("fig1", "fig2", "fig3")),
    ("Tracking", ("fig5", "fig6", "fig7", "fig8", "fig9")),
    ("Payload", ("fig10", "fig11", "fig12", "fig13", "fig14", "fig15")),
    ("Equations and claims", ("eq37", "eq22", "claims")),
    ("Interpretations", ("interpretations",)),
    ("Scan of geometries", ("scan",)),
)
_UNGROUPED = "Beyond the paper"
"""Heading for parts that belong to no group."""

_COLUMNS = (
    "Where",
    "The paper",
    "Published",
    "Ours",
    "Interpretation",
    "Verdict",
    "Evidence",
    "Command",
)

_VERDICTS = {
    "reproduced": "good",
    "used": "good",
    "not reproduced": "bad",
    "contradicted": "bad",
    "used, corrected": "mixed",
    "replaced": "mixed",
    "undecided": "mixed",
    "not run": "mixed",
}
"""CSS class of each verdict."""


def markdown(results: Results) -> str:
    """Page in Markdown. The figures are files in the same folder."""
    return "\n\n".join(_blocks(results)) + "\n"


def html(results: Results) -> str:
    """Page as one HTML file. The figures are files in the same folder."""
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(markdown(results))
    links: list[str] = []
    for token, inline in pairwise(tokens):
        if token.type == "heading_open" and token.tag == "h2":
            anchor = re.sub(r"\W+", "-", inline.content.lower())
            token.attrSet("id", anchor)
            text = reader.renderInline(inline.content)
            links.append(f'<li><a href="#{anchor}">{text}</a></li>')
        elif token.type == "td_open" and inline.content in _VERDICTS:
            token.attrSet("class", f"verdict {_VERDICTS[inline.content]}")
    body = reader.renderer.render(tokens, reader.options, {})
    body = body.replace("<table>", f"{_SCROLLED}<table>")
    body = body.replace("</table>", "</table></div>")
    frame = Template(load_text("page.html"))
    return frame.substitute(title=TITLE, links="\n".join(links), body=body)


_SCROLLED = '<div class="scroll" role="region" tabindex="0" aria-label="table">'
"""Tag around a table, which scrolls on narrow screens."""


def tally(rows: Sequence[Row]) -> str:
    """Number of rows with each verdict, as text."""
    counts = Counter(map(_verdict, rows))
    return "; ".join(f"{counts[verdict]} {verdict}" for verdict in _VERDICTS if counts[verdict])


# --- contents -------------------------------------------------------------------------------------------------------


def _blocks(results: Results) -> Iterator[str]:
    rows = results["rows"]
    yield from _head(results)
    yield from _summary(results)
    for kind in ("result", "claim"):
        yield f"## {kind.capitalize()}s"
        yield _judged(rows, kind)
    for heading, entries in _grouped(results["parts"]):
        yield f"## {heading}"
        for entry in entries:
            yield from _part(entry, results["numbers"])
    yield "## Inputs"
    yield (
        "Values of tables and motions, and counts. Our values are read from the objects of the runs; the evidence "
        "names the object and its attribute."
    )
    yield _judged(rows, "input")
    yield "## Options and versions"
    options = []
    for name, value in results["interpretation"].items():
        options.append((f"`--{name.replace('_', '-')}`", value, option_text(name, value)))
    yield _table(("option", "value", "meaning"), options)
    yield _table(("package", "version"), list(results["versions"].items()))


def _head(results: Results) -> Iterator[str]:
    yield f"# {TITLE}"
    yield (
        f"Reproduction of the tables, figures and claims of {SOURCE}. The page states which of them are reproduced, "
        "which are not, and the reasons. This command generates the page, its figures and `results.json`:"
    )
    yield f"```sh\n{results['command']}\n```"
    changed = Interpretation(**results["interpretation"]).changed()
    choices = "the default choices"
    if changed:
        choices = "the following choices; bold choices differ from the default"
    yield (
        f"The paper leaves some points open. Each choice is an option of this command. This page uses {choices}:"
    )
    lines = []
    for subject, names in _SUBJECTS.items():
        texts = []
        for name in names:
            text = option_text(name, results["interpretation"][name])
            if name in changed:
                text = f"**{text}**"
            texts.append(text)
        lines.append(f"* {subject}: {'; '.join(texts)}.")
    yield "\n".join(lines)
    errata = f"`{ERRATA}` of the project"
    if "errata" in results:
        errata = f"[{ERRATA}]({results['errata']})"
    yield (
        "The defaults are the choices that this project considers correct. They are not fitted to the published "
        f"numbers. The section *Interpretations* shows the results of the other choices. {errata} lists the misprints "
        "of the equations."
    )
    if results["missing"]:
        missing = ", ".join(results["missing"])
        yield f"Not run yet: {missing}. The affected rows name the command that computes them."


_SUBJECTS = {
    "Load": ("payload", "platform_mass"),
    "Torque limits U± of Eq. 37": ("line",),
    "Spatial robot": ("triangles", "sides", "pulleys"),
    "Planar robot": ("planar_apex", "minimum_tension", "alpha"),
    "Joint springs": ("stiffness", "eq24"),
    "Algorithm": ("eq37",),
}
"""Options in the order of the introduction."""


def _summary(results: Results) -> Iterator[str]:
    yield "## Summary"
    lines = []
    for kind in ("result", "claim", "input"):
        rows = [row for row in results["rows"] if row["kind"] == kind]
        lines.append(f"* **{len(rows)} {kind}s**: {tally(rows)}.")
    yield "\n".join(lines)
    run = Run(
        interpretation=Interpretation(**results["interpretation"]), numbers=results["numbers"]
    )
    judged = list(points(run, results["rows"]))
    for verdict, heading in HEADINGS.items():
        lines = [f"* {_escaped(text, bold=True)}" for result, text in judged if result == verdict]
        if lines:
            yield f"### {heading}"
            yield "\n".join(lines)
    yield "### Rules of the verdicts"
    yield RULE
    yield "### Terms"
    yield _TERMS


_TERMS = """\
* **Exact tracking**: the robot is on the reference at each instant. The largest payload then has a closed form.
* **Closed loop**: simulation of a control law at 500 Hz.
* **Open loop**: the torque of exact tracking without feedback.
* **DLCC**: dynamic load carrying capacity, the largest feasible payload.
* **Paper criterion**: the requested torque of every motor is within U± (|a| ≤ 1), the position error is within R, and
  no cable is slack.
* **Task criterion**: the motors saturate at U±, the position error is within 10 mm, the rotation error is within
  10 mrad, and no cable is slack.
* **Limiting violation**: the first violated condition at a payload just above the largest feasible one.
* **Laws for rigid robots**: `fl` is the feedback linearization of the paper (Eqs. 10–19), `robust` adds Δv of Eq. 34,
  and `adaptive` estimates the payload.
* **Laws for joint springs**: `composite`, `robust-composite` and `adaptive-composite` add damping of the springs to
  these laws, `fl4` linearises up to the fourth derivative, `motor-pd` controls the motor angles, and `flex-eq22` is the
  law of the paper.
* **ε**: boundary layer within which the robust term Δv is continuous."""


def _judged(rows: Sequence[Row], kind: str) -> str:
    """Table of the findings of one kind."""
    cells = []
    for row in rows:
        if row["kind"] == kind:
            ours = row["ours"] or ""
            paper = (row["place"], row["statement"], row["printed"])
            verdict = (row["interpretation"], _verdict(row), row["evidence"], f"`{row['command']}`")
            cells.append((*paper, ours, *verdict))
    return _table(_COLUMNS, cells)


def _verdict(row: Row) -> str:
    return row["verdict"] or "not run"


def _grouped(entries: Sequence[Entry]) -> Iterator[tuple[str, list[Entry]]]:
    ungrouped = list(entries)
    for heading, names in _GROUPS:
        members = [entry for entry in entries if entry["name"] in names]
        if members:
            yield heading, members
        for entry in members:
            ungrouped.remove(entry)
    if ungrouped:
        yield _UNGROUPED, ungrouped


def _part(entry: Entry, numbers: Mapping[str, Any]) -> Iterator[str]:
    yield f"### {entry['title']}"
    yield entry["text"].strip()
    if entry.get("impossible"):
        yield f"Not possible under the chosen interpretation: {_escaped(entry['impossible'])}"
    if entry["figure"] is not None:
        alt = re.sub(r"([\[\]\\])", r"\\\1", entry["title"])
        yield f"![{alt}]({entry['figure']}.svg)"
    rows = []
    for name in dict.fromkeys(re.findall(r"`(\w+)`", entry["text"])):  # in the order of the text
        key = f"{entry['name']}.{name}"
        if key in numbers:
            rows.append((f"`{name}`", numbers[key]))
    if rows:
        yield "**Numbers in the text**"
        yield _table(("number", "value"), rows)
    for table in entry["tables"]:
        yield f"**{_escaped(table['title'])}**"
        yield _table(table["header"], table["rows"])


# --- formats --------------------------------------------------------------------------------------------------------


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table in Markdown. Columns that contain only numbers are right-aligned."""
    rules = ["---"] * len(header)
    for index, column in enumerate(zip(*rows, strict=True)):
        if all(map(_is_number, column)):
            rules[index] = "---:"
    lines: list[Iterable[str]] = [map(_escaped, header), rules]
    for row in rows:
        lines.append(map(_escaped, map(as_text, row)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _escaped(text: str, *, bold: bool = False) -> str:
    """Escapes text for a table or a sentence. Text between backticks remains code.

    With ``bold``, text between double asterisks remains bold.
    """
    pieces = " ".join(str(text).split()).split("`")
    if len(pieces) % 2 == 0:  # unpaired backtick
        pieces = ["\\`".join(pieces)]
    outside = [re.sub(r"([\\*<\[\]]|(?<!\w)_|_(?!\w))", r"\\\1", piece) for piece in pieces[::2]]
    pieces[::2] = [piece.replace("\\\\`", "\\`") for piece in outside]
    escaped = "`".join(pieces).replace("|", "\\|")
    if bold:
        return escaped.replace("\\*\\*", "**")
    return escaped
