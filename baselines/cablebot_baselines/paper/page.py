"""Page of the reproduction in Markdown and HTML, generated from results.json."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any, NamedTuple

from markdown_it import MarkdownIt

from cablebot_baselines.paper.findings import RULE
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.judgement import Run
from cablebot_baselines.paper.summary import HEADINGS, points
from cablebot_baselines.paper.texts import as_text, option_text

Results = Mapping[str, Any]
"""Contents of results.json."""

Row = Mapping[str, Any]
"""One published number or claim with its finding."""


class Heading(NamedTuple):
    """A heading of the page."""

    level: int
    """1 for the title."""
    text: str
    """Text in Markdown."""


class Table(NamedTuple):
    """A table of the page."""

    header: Sequence[str]
    """Names of the columns."""
    rows: Sequence[Sequence[Any]]
    """Values of the cells."""

    def numeric(self) -> list[bool]:
        """Whether each column contains only numbers. Such columns are right-aligned."""
        columns = list(zip(*self.rows, strict=True)) if self.rows else [()] * len(self.header)
        return [bool(column) and all(map(_is_number, column)) for column in columns]


Block = Heading | Table | str
"""A heading, a table, or Markdown."""

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
_REST = "Beyond the paper"
"""Heading for parts that belong to no group."""

_COLUMNS = ("Where", "The paper", "Published", "Ours", "Interpretation", "Verdict", "Evidence", "Command")

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
    return "\n\n".join(_as_markdown(block) for block in _blocks(results)) + "\n"


def html(results: Results) -> str:
    """Page as one HTML file. The figures are files in the same folder."""
    reader = MarkdownIt("commonmark", {"html": False})
    body: list[str] = []
    links: list[str] = []
    names: list[str] = []
    for block in _blocks(results):
        if isinstance(block, Heading):
            name = re.sub(r"\W+", "-", block.text.lower()).strip("-")
            names.append(name)
            anchor = name if names.count(name) == 1 else f"{name}-{names.count(name)}"
            text = reader.renderInline(block.text)
            body.append(f'<h{block.level} id="{anchor}">{text}</h{block.level}>\n')
            if block.level == 2:
                links.append(f'<li><a href="#{anchor}">{text}</a></li>')
        else:
            body.append(reader.render(block) if isinstance(block, str) else _as_html(block, reader))
    frame = Template(files("cablebot_baselines.paper").joinpath("page.html").read_text(encoding="utf-8"))
    return frame.substitute(title=escape(TITLE), links="\n".join(links), body="".join(body))


def tally(rows: Sequence[Row]) -> str:
    """Number of rows with each verdict, as text."""
    counts = Counter(_verdict(row) for row in rows)
    return "; ".join(f"{counts[verdict]} {verdict}" for verdict in _VERDICTS if counts[verdict])


# --- contents -------------------------------------------------------------------------------------------------------


def _blocks(results: Results) -> Iterator[Block]:
    rows = results["rows"]
    yield from _head(results)
    yield from _summary(results)
    for kind in ("result", "claim"):
        yield Heading(2, f"{kind.capitalize()}s")
        yield _judged(rows, kind)
    for heading, members in _grouped(results["parts"]):
        yield Heading(2, heading)
        for part in members:
            yield from _part(part, results["numbers"])
    yield Heading(2, "Inputs")
    yield (
        "Values of tables and motions, and counts. Our values are read from the objects of the runs; the evidence "
        "names the object and its attribute."
    )
    yield _judged(rows, "input")
    yield Heading(2, "Options and versions")
    options = results["interpretation"].items()
    yield Table(
        ("option", "value", "meaning"),
        [(f"`--{name.replace('_', '-')}`", value, option_text(name, value)) for name, value in options],
    )
    yield Table(("package", "version"), list(results["versions"].items()))


def _head(results: Results) -> Iterator[Block]:
    yield Heading(1, TITLE)
    yield (
        f"Reproduction of the tables, figures and claims of {SOURCE}. The page states which of them are reproduced, "
        "which are not, and the reasons. This command generates the page, its figures and `results.json`:"
    )
    yield f"```sh\n{results['command']}\n```"
    changed = Interpretation(**results["interpretation"]).changed()
    yield (
        "The paper leaves some points open. Each choice is an option of this command. This page uses "
        f"{'the following choices; bold choices differ from the default' if changed else 'the default choices'}:"
    )
    lines = []
    for subject, names in _SUBJECTS.items():
        texts = {name: option_text(name, results["interpretation"][name]) for name in names}
        words = "; ".join(f"**{text}**" if name in changed else text for name, text in texts.items())
        lines.append(f"* {subject}: {words}.")
    yield "\n".join(lines)
    errata = f"[{ERRATA}]({results['errata']})" if "errata" in results else f"`{ERRATA}` of the project"
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


def _summary(results: Results) -> Iterator[Block]:
    yield Heading(2, "Summary")
    rows = results["rows"]
    each = {kind: [row for row in rows if row["kind"] == kind] for kind in ("result", "claim", "input")}
    yield "\n".join(f"* **{len(some)} {kind}s**: {tally(some)}." for kind, some in each.items())
    run = Run(interpretation=Interpretation(**results["interpretation"]), numbers=results["numbers"])
    judged = list(points(run, rows))
    for verdict, heading in HEADINGS.items():
        if texts := [text for result, text in judged if result == verdict]:
            yield Heading(3, heading)
            yield "\n".join(f"* {_escaped(text, bold=True)}" for text in texts)
    yield Heading(3, "Rules of the verdicts")
    yield RULE
    yield Heading(3, "Terms")
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


def _judged(rows: Sequence[Row], kind: str) -> Table:
    """Table of the findings of one kind."""
    cells = [
        (
            row["place"],
            row["statement"],
            row["printed"],
            row["ours"] or "",
            row["interpretation"],
            _verdict(row),
            row["evidence"],
            f"`{row['command']}`",
        )
        for row in rows
        if row["kind"] == kind
    ]
    return Table(_COLUMNS, cells)


def _verdict(row: Row) -> str:
    return row["verdict"] or "not run"


def _grouped(parts: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    named = {name for _, names in _GROUPS for name in names}
    for heading, names in _GROUPS:
        if members := [part for part in parts if part["name"] in names]:
            yield heading, members
    if rest := [part for part in parts if part["name"] not in named]:
        yield _REST, rest


def _part(part: Mapping[str, Any], numbers: Mapping[str, Any]) -> Iterator[Block]:
    yield Heading(3, part["title"])
    yield part["text"].strip()
    if part.get("impossible"):
        yield f"Not possible under the chosen interpretation: {_escaped(part['impossible'])}"
    if (name := part["figure"]) is not None:
        alt = re.sub(r"([\[\]\\])", r"\\\1", part["title"])
        yield f"![{alt}]({name}.svg)"
    names = dict.fromkeys(re.findall(r"`(\w+)`", part["text"]))  # in the order of the text
    if named := [(f"`{name}`", numbers[key]) for name in names if (key := f"{part['name']}.{name}") in numbers]:
        yield "**Numbers in the text**"
        yield Table(("number", "value"), named)
    for table in part["tables"]:
        yield f"**{_escaped(table['title'])}**"
        yield Table(table["header"], table["rows"])


# --- formats --------------------------------------------------------------------------------------------------------


def _as_markdown(block: Block) -> str:
    if isinstance(block, str):
        return block
    if isinstance(block, Heading):
        return f"{'#' * block.level} {block.text}"
    rules = ["---:" if numeric else "---" for numeric in block.numeric()]
    cells = ([_escaped(as_text(value)) for value in row] for row in block.rows)
    lines = [[_escaped(name) for name in block.header], rules, *cells]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _as_html(table: Table, reader: MarkdownIt) -> str:
    """HTML table that scrolls. The columns of findings and the verdicts have classes."""

    def cell(tag: str, attributes: str, text: str) -> str:
        plain = _escaped(text).replace("\\|", "|")  # a bar separates cells only in Markdown
        return f"<{tag}{attributes}>{reader.renderInline(plain)}</{tag}>"

    align = [' style="text-align:right"' if numeric else "" for numeric in table.numeric()]
    head = "".join(cell("th", f' scope="col"{style}', name) for name, style in zip(table.header, align, strict=True))
    lines = []
    for row in table.rows:
        cells = []
        for name, style, text in zip(table.header, align, map(as_text, row), strict=True):
            classes = [name.lower().replace(" ", "-")] if name in _COLUMNS else []
            classes += [_VERDICTS[text]] if name == "Verdict" and text in _VERDICTS else []
            cells.append(cell("td", style + (f' class="{" ".join(classes)}"' if classes else ""), text))
        lines.append(f"<tr>{''.join(cells)}</tr>\n")
    return (
        '<div class="scroll" role="region" tabindex="0" aria-label="table">\n'
        f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(lines)}</tbody>\n</table>\n</div>\n"
    )


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
    whole = "`".join(pieces).replace("|", "\\|")
    return whole.replace("\\*\\*", "**") if bold else whole
