"""Page of the reproduction in Markdown and HTML, generated from results.json."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token

from cablebot_baselines.paper.finding import Run, as_text, option_text
from cablebot_baselines.paper.findings import RULE
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.summary import HEADINGS, points

Results = Mapping[str, Any]
"""Contents of results.json."""

Row = Mapping[str, Any]
"""One published number or claim with its finding."""

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
    parts = [*_head(results), *_summary(results), *_judged(results["rows"])]
    for heading, members in _grouped(results["parts"]):
        parts.append(f"## {heading}")
        for part in members:
            parts += _part(part, results["numbers"])
    parts += [*_inputs(results["rows"]), *_foot(results)]
    return "\n\n".join(parts) + "\n"


def html(results: Results) -> str:
    """Page as one HTML file. The figures are files in the same folder."""
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens, contents = _decorated(reader.parse(markdown(results)))
    body = reader.renderer.render(tokens, reader.options, {})
    links = "\n".join(f'<li><a href="#{name}">{escape(heading)}</a></li>' for name, heading in contents)
    return _FRAME.format(title=escape(TITLE), style=_STYLE, links=links, body=body)


# --- Markdown -------------------------------------------------------------------------------------------------------


def _head(results: Results) -> Iterator[str]:
    yield f"# {TITLE}"
    yield (
        f"Reproduction of the tables, figures and claims of {SOURCE}. The page states which of them are reproduced, "
        "which are not, and the reasons. This command generates the page, its figures and `results.json`:"
    )
    yield f"```sh\n{results['command']}\n```"
    changed = _changed(results["interpretation"])
    errata = f"[{ERRATA}]({results['errata']})" if "errata" in results else f"`{ERRATA}` of the project"
    yield (
        "The paper leaves some points open. Each choice is an option of this command. This page uses "
        f"{'the following choices; bold choices differ from the default' if changed else 'the default choices'}:"
    )
    yield "\n".join(_chosen(results["interpretation"]))
    yield (
        "The defaults are the choices that this project considers correct. They are not fitted to the published "
        f"numbers. The section *Interpretations* shows the results of the other choices. {errata} lists the misprints "
        "of the equations."
    )
    if results["missing"]:
        names = ", ".join(results["missing"])
        yield f"Not run yet: {names}. The affected rows name the command that computes them."


_SUBJECTS = {
    "Load": ("payload", "platform_mass"),
    "Torque limits U± of Eq. 37": ("line",),
    "Spatial robot": ("triangles", "sides", "pulleys"),
    "Planar robot": ("planar_apex", "minimum_tension", "alpha"),
    "Joint springs": ("stiffness", "eq24"),
    "Algorithm": ("eq37",),
}
"""Options in the order of the introduction."""


def _chosen(interpretation: Mapping[str, Any]) -> Iterator[str]:
    """List of the choices. Choices that differ from the default are bold."""
    changed = _changed(interpretation)
    named = {name for names in _SUBJECTS.values() for name in names}
    rest = {"Other": tuple(name for name in interpretation if name not in named)}
    for subject, names in (_SUBJECTS | rest).items():
        words = {name: option_text(name, interpretation[name]) for name in names if name in interpretation}
        if words:
            each = "; ".join(f"**{text}**" if name in changed else text for name, text in words.items())
            yield f"* {subject}: {each}."


def _changed(interpretation: Mapping[str, Any]) -> set[str]:
    default = Interpretation()
    return {name for name, value in interpretation.items() if value != getattr(default, name, None)}


def tally(rows: Sequence[dict[str, Any]]) -> str:
    """Number of rows with each verdict, as text."""
    counts = Counter(_verdict(row) for row in rows)
    return "; ".join(f"{counts[verdict]} {verdict}" for verdict in _VERDICTS if counts[verdict])


def _summary(results: Results) -> Iterator[str]:
    yield "## Summary"
    rows = results["rows"]
    lines = []
    for kind in ("result", "claim", "input"):
        kind_rows = [row for row in rows if row["kind"] == kind]
        lines.append(f"* **{len(kind_rows)} {kind}s**: {tally(kind_rows)}.")
    yield "\n".join(lines)
    run = Run(interpretation=Interpretation(**results["interpretation"]), numbers=results["numbers"])
    judged = list(points(run, rows))
    for verdict, heading in HEADINGS.items():
        if texts := [text for result, text in judged if result == verdict]:
            yield f"### {heading}"
            yield "\n".join(f"* {_escaped(text, bold=True)}" for text in texts)
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


def _judged(rows: Sequence[Row]) -> Iterator[str]:
    for heading, kind in (("Results", "result"), ("Claims", "claim")):
        yield f"## {heading}"
        yield _table(_COLUMNS, [_cells(row) for row in rows if row["kind"] == kind])


def _inputs(rows: Sequence[Row]) -> Iterator[str]:
    yield "## Inputs"
    yield "Values of tables and motions, and counts. Our values are read from the objects of the runs."
    yield _table(_COLUMNS, [_cells(row) for row in rows if row["kind"] == "input"])


def _cells(row: Row) -> list[Any]:
    values = (
        row["place"],
        row["statement"],
        row["printed"],
        row["ours"],
        row["interpretation"],
        _verdict(row),
        row["evidence"],
    )
    return [*("" if value is None else value for value in values), f"`{row['command']}`"]


def _verdict(row: Row) -> str:
    return "not run" if row["verdict"] is None else str(row["verdict"])


def _grouped(parts: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    named = {name for _, names in _GROUPS for name in names}
    for heading, names in _GROUPS:
        if members := [part for part in parts if part["name"] in names]:
            yield heading, members
    if rest := [part for part in parts if part["name"] not in named]:
        yield _REST, rest


def _part(part: Mapping[str, Any], numbers: Mapping[str, Any]) -> Iterator[str]:
    yield f"### {part['title']}"
    yield part["text"].strip()
    if part.get("impossible"):
        yield f"Not possible under the chosen interpretation: {_escaped(part['impossible'])}"
    if (name := part["figure"]) is not None:
        alt = re.sub(r"([\[\]\\])", r"\\\1", part["title"])
        yield f"![{alt}]({name}.svg)"
    if named := _named(part, numbers):
        yield "**Numbers in the text**"
        yield _table(("number", "value"), named)
    for table in part["tables"]:
        yield f"**{_escaped(table['title'])}**"
        yield _table(table["header"], table["rows"])


def _named(part: Mapping[str, Any], numbers: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Numbers of the part whose names appear in its text, in the order of the text."""
    names = dict.fromkeys(re.findall(r"`(\w+)`", part["text"]))
    return [(f"`{name}`", numbers[key]) for name in names if (key := f"{part['name']}.{name}") in numbers]


def _foot(results: Results) -> Iterator[str]:
    yield "## Options and versions"
    options = [(_option(name), value, option_text(name, value)) for name, value in results["interpretation"].items()]
    yield _table(("option", "value", "meaning"), options)
    yield _table(("package", "version"), list(results["versions"].items()))


def _option(name: str) -> str:
    return f"`--{name.replace('_', '-')}`"


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Markdown table. Columns that contain only numbers are right-aligned."""
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    rules = ["---:" if column and all(_is_number(value) for value in column) else "---" for column in columns]
    lines = [[_escaped(name) for name in header], rules, *([_escaped(as_text(value)) for value in row] for row in rows)]
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
    whole = "`".join(pieces).replace("|", "\\|")
    return whole.replace("\\*\\*", "**") if bold else whole


# --- HTML -----------------------------------------------------------------------------------------------------------


def _decorated(tokens: list[Token]) -> tuple[list[Token], list[tuple[str, str]]]:
    """Adds anchors to headings, scrolling to tables, and classes to verdicts and columns; also returns the contents."""
    decorated: list[Token] = []
    contents: list[tuple[str, str]] = []
    columns: list[str] = []
    names: list[str] = []
    column = 0
    for token, following in zip(tokens, [*tokens[1:], None], strict=True):
        text = following.content if following is not None and following.type == "inline" else ""
        if token.type == "heading_open" and token.tag in ("h2", "h3"):
            name = re.sub(r"\W+", "-", text.lower()).strip("-")
            names.append(name)
            token.attrSet("id", name if names.count(name) == 1 else f"{name}-{names.count(name)}")
            if token.tag == "h2":
                contents.append((str(token.attrGet("id")), text))
        elif token.type == "table_open":
            decorated.append(_raw('<div class="scroll" role="region" tabindex="0" aria-label="table">\n'))
            columns = []
        elif token.type == "tr_open":
            column = 0
        elif token.type == "th_open":
            columns.append(text)
            token.attrSet("scope", "col")
        elif token.type == "td_open":
            classes = [columns[column].lower().replace(" ", "-")] if columns[column] in _COLUMNS else []
            classes += [_VERDICTS[text]] if columns[column] == "Verdict" and text in _VERDICTS else []
            if classes:
                token.attrSet("class", " ".join(classes))
            column += 1
        decorated.append(token)
        if token.type == "table_close":
            decorated.append(_raw("</div>\n"))
    return decorated, contents


def _raw(content: str) -> Token:
    return Token("html_block", "", 0, content=content)


_STYLE = """
:root { color-scheme: light dark; --text: #1b1b1b; --back: #ffffff; --line: #d0d0d0; --soft: #f3f4f6;
  --good: #00693e; --bad: #a8330a; --mixed: #5c5c5c; --link: #005a9c; }
@media (prefers-color-scheme: dark) { :root { --text: #e6e6e6; --back: #16181b; --line: #3c4045; --soft: #22262b;
  --good: #5fc99a; --bad: #f0906a; --mixed: #b0b0b0; --link: #7cb8ee; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 1rem; color: var(--text); background: var(--back);
  font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
a { color: var(--link); }
main > p, main > ul { max-width: 50rem; }
nav ul { display: flex; flex-wrap: wrap; gap: 0.25rem 1rem; padding: 0; list-style: none; }
img { display: block; max-width: 100%; height: auto; background: #ffffff; border: 1px solid var(--line); }
pre { overflow-x: auto; padding: 0.75rem; background: var(--soft); }
code { font-size: 0.9em; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: 0.875rem; line-height: 1.35; }
th, td { padding: 0.3rem 0.6rem; border: 1px solid var(--line); text-align: left; vertical-align: top; }
th { background: var(--soft); }
td.the-paper { min-width: 14rem; } td.evidence { min-width: 24rem; } td.ours, td.interpretation { min-width: 9rem; }
td.command { min-width: 12rem; } td.where, td.published { white-space: nowrap; }
td.verdict { white-space: nowrap; font-weight: 600; }
@media (max-width: 40rem) { td.the-paper { min-width: 10rem; } td.evidence { min-width: 16rem; } }
td.good { color: var(--good); } td.bad { color: var(--bad); } td.mixed { color: var(--mixed); }
"""

_FRAME = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<nav aria-label="Contents">
<ul>
{links}
</ul>
</nav>
<main>
{body}</main>
</body>
</html>
"""
