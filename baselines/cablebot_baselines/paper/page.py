"""The page of the reproduction, from what results.json holds: Markdown, and the same as HTML."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token

from cablebot_baselines.paper.finding import Run, as_text, reading_words
from cablebot_baselines.paper.findings import RULE
from cablebot_baselines.paper.readings import Readings
from cablebot_baselines.paper.summary import HEADINGS, points

Results = Mapping[str, Any]
"""What results.json holds."""

Row = Mapping[str, Any]
"""One published number or claim beside its finding."""

TITLE = "The paper, reproduced"

SOURCE = (
    "Korayem, Tourajizadeh and Bamdad, *Dynamic Load Carrying Capacity of Flexible Cable Suspended Robot: Robust "
    "Feedback Linearization Control Approach* (2010)"
)

ERRATA = "docs/errata.md"
"""Where misprints stand in the project; the page links to what results have as ``errata``."""

_GROUPS = (
    ("Robots", ("fig1", "fig2", "fig3")),
    ("Tracking", ("fig5", "fig6", "fig7", "fig8", "fig9")),
    ("Payload", ("fig10", "fig11", "fig12", "fig13", "fig14", "fig15")),
    ("Equations and claims", ("eq37", "eq22", "claims")),
    ("Readings", ("readings",)),
    ("Scan of geometries", ("scan",)),
)
_REST = "Beyond the paper"
"""What no group names."""

_COLUMNS = ("Where", "The paper", "Published", "Ours", "Reading", "Verdict", "Evidence", "Command")

_VERDICTS = {
    "reproduces": "good",
    "taken": "good",
    "does not": "bad",
    "contradicted": "bad",
    "taken, corrected": "mixed",
    "not taken": "mixed",
    "cannot be decided": "mixed",
    "not run": "mixed",
}
"""How the page marks each."""

_PLURAL = {"reproduces": "reproduce", "does not": "do not"}


def markdown(results: Results) -> str:
    """The page in Markdown; figures and the other form of the page stand beside it."""
    parts = [*_head(results), *_summary(results), *_judged(results["rows"])]
    for heading, members in _grouped(results["parts"]):
        parts.append(f"## {heading}")
        for part in members:
            parts += _part(part, results["numbers"])
    parts += [*_inputs(results["rows"]), *_foot(results)]
    return "\n\n".join(parts) + "\n"


def html(results: Results) -> str:
    """The page as one HTML file; figures stand beside it."""
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens, contents = _dressed(reader.parse(markdown(results)))
    body = reader.renderer.render(tokens, reader.options, {})
    links = "\n".join(f'<li><a href="#{name}">{escape(heading)}</a></li>' for name, heading in contents)
    return _FRAME.format(title=escape(TITLE), style=_STYLE, links=links, body=body)


# --- Markdown -------------------------------------------------------------------------------------------------------


def _head(results: Results) -> Iterator[str]:
    yield f"# {TITLE}"
    yield (
        f"{SOURCE}: its tables, figures and claims made again, with what agrees, what does not, and why. One command "
        "made this page, its figures and `results.json`:"
    )
    yield f"```sh\n{results['command']}\n```"
    changed = _changed(results["readings"])
    errata = f"[{ERRATA}]({results['errata']})" if "errata" in results else f"`{ERRATA}` of the project"
    yield (
        "The paper can be read in more than one way, and each way is an option of that command. What follows holds for "
        f"{'these readings, in bold where they are not the default' if changed else 'the default readings'}:"
    )
    yield "\n".join(_chosen(results["readings"]))
    yield (
        "The defaults are what this project holds for right, not what comes closest to a published number; *Readings* "
        f"shows what the others give. Misprints of the equations are in {errata}."
    )
    if results["missing"]:
        names = ", ".join(results["missing"])
        yield f"Not run yet: {names}. The rows that need them name the command that makes them."


_SUBJECTS = {
    "Load": ("payload", "platform_mass"),
    "Torque limits U± of Eq. 37": ("line",),
    "Spatial robot": ("triangles", "sides", "pulleys"),
    "Planar robot": ("planar_apex", "minimum_tension", "alpha"),
    "Joint springs": ("stiffness", "eq24"),
    "Algorithm": ("eq37",),
}
"""The readings in the order of the introduction."""


def _chosen(readings: Mapping[str, Any]) -> Iterator[str]:
    """A list of the readings, those that are not the default in bold."""
    changed = _changed(readings)
    named = {name for names in _SUBJECTS.values() for name in names}
    rest = {"Other": tuple(name for name in readings if name not in named)}
    for subject, names in (_SUBJECTS | rest).items():
        words = {name: reading_words(name, readings[name]) for name in names if name in readings}
        if words:
            each = "; ".join(f"**{said}**" if name in changed else said for name, said in words.items())
            yield f"* {subject}: {each}."


def _changed(readings: Mapping[str, Any]) -> set[str]:
    default = Readings()
    return {name for name, value in readings.items() if value != getattr(default, name, None)}


def tally(rows: Sequence[dict[str, Any]]) -> str:
    """How many rows have each verdict, in words."""
    counts = Counter(_verdict(row) for row in rows)
    return "; ".join(
        f"{counts[verdict]} {verdict if counts[verdict] == 1 else _PLURAL.get(verdict, verdict)}"
        for verdict in _VERDICTS
        if counts[verdict]
    )


def _summary(results: Results) -> Iterator[str]:
    yield "## Summary"
    rows = results["rows"]
    lines = []
    for kind in ("result", "claim", "input"):
        mine = [row for row in rows if row["kind"] == kind]
        lines.append(f"* **{len(mine)} {kind}s**: {tally(mine)}.")
    yield "\n".join(lines)
    run = Run(readings=Readings(**results["readings"]), numbers=results["numbers"])
    said = list(points(run, rows))
    for verdict, heading in HEADINGS.items():
        if mine := [words for found, words in said if found == verdict]:
            yield f"### {heading}"
            yield "\n".join(f"* {_escaped(words, bold=True)}" for words in mine)
    yield "### How verdicts are reached"
    yield RULE
    yield "### Words"
    yield _WORDS


_WORDS = """\
* **Exact tracking**: the robot is on the reference at each instant; the largest payload then has a closed form.
  **Closed loop**: a law is simulated with 500 commands a second.
* **Paper criterion**: no motor is asked for more than U±, |a| ≤ 1, and the error stays within R. **Task criterion**:
  motors clip at U±; the errors of position and rotation stay within 10 mm and 10 mrad. Under both no cable goes slack.
* **Laws**: `fl` is the paper's feedback linearization of the rigid robots (Eqs. 10–19), `robust` the same with Δv of
  Eq. 34, `adaptive` one that estimates the load. With joint springs, `composite`, `robust-composite` and
  `adaptive-composite` are these with damping of the springs, `fl4` linearises up to the fourth derivative and
  `motor-pd` controls the motors' angles; `flex-eq22` is the paper's own law. **Open loop** is exact tracking's torque
  without feedback.
* **ε** is the boundary layer within which the robust term Δv is continuous."""


def _judged(rows: Sequence[Row]) -> Iterator[str]:
    for heading, kind in (("Results", "result"), ("Claims", "claim")):
        yield f"## {heading}"
        yield _table(_COLUMNS, [_cells(row) for row in rows if row["kind"] == kind])


def _inputs(rows: Sequence[Row]) -> Iterator[str]:
    yield "## Inputs"
    yield "Values of tables and motions, and counts. Ours are read from the objects that the runs used."
    yield _table(_COLUMNS, [_cells(row) for row in rows if row["kind"] == "input"])


def _cells(row: Row) -> list[Any]:
    values = (row["place"], row["says"], row["printed"], row["ours"], row["reading"], _verdict(row), row["evidence"])
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
        yield f"Not possible under the readings chosen: {_escaped(part['impossible'])}"
    if (name := part["figure"]) is not None:
        alt = re.sub(r"([\[\]\\])", r"\\\1", part["title"])
        yield f"![{alt}]({name}.svg)"
    if named := _named(part, numbers):
        yield "**Numbers that the text names.**"
        yield _table(("number", "value"), named)
    for table in part["tables"]:
        yield f"**{_escaped(table['title'])}**"
        yield _table(table["header"], table["rows"])


def _named(part: Mapping[str, Any], numbers: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """The part's numbers whose names stand in its text, in that order."""
    names = dict.fromkeys(re.findall(r"`(\w+)`", part["text"]))
    return [(f"`{name}`", numbers[key]) for name in names if (key := f"{part['name']}.{name}") in numbers]


def _foot(results: Results) -> Iterator[str]:
    yield "## Readings and versions"
    options = [(_option(name), value, reading_words(name, value)) for name, value in results["readings"].items()]
    yield _table(("option", "value", "meaning"), options)
    yield _table(("version of", "is"), list(results["versions"].items()))


def _option(name: str) -> str:
    return f"`--{name.replace('_', '-')}`"


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Columns of numbers alone are aligned to the right."""
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    rules = ["---:" if column and all(_is_number(value) for value in column) else "---" for column in columns]
    lines = [[_escaped(name) for name in header], rules, *([_escaped(as_text(value)) for value in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _escaped(text: str, *, bold: bool = False) -> str:
    """Text for a table or a sentence: what is between backticks stays code, and nothing else is markup.

    ``bold``: nor is what stands between two asterisks each.
    """
    pieces = " ".join(str(text).split()).split("`")
    if len(pieces) % 2 == 0:  # a backtick on its own
        pieces = ["\\`".join(pieces)]
    outside = [re.sub(r"([\\*<\[\]]|(?<!\w)_|_(?!\w))", r"\\\1", piece) for piece in pieces[::2]]
    pieces[::2] = [piece.replace("\\\\`", "\\`") for piece in outside]
    whole = "`".join(pieces).replace("|", "\\|")
    return whole.replace("\\*\\*", "**") if bold else whole


# --- HTML -----------------------------------------------------------------------------------------------------------


def _dressed(tokens: list[Token]) -> tuple[list[Token], list[tuple[str, str]]]:
    """Tokens with anchors at headings, tables that scroll, and classes for verdicts and columns; and the contents."""
    dressed: list[Token] = []
    contents: list[tuple[str, str]] = []
    columns: list[str] = []
    names: list[str] = []
    place = 0
    for token, following in zip(tokens, [*tokens[1:], None], strict=True):
        text = following.content if following is not None and following.type == "inline" else ""
        if token.type == "heading_open" and token.tag in ("h2", "h3"):
            name = re.sub(r"\W+", "-", text.lower()).strip("-")
            names.append(name)
            token.attrSet("id", name if names.count(name) == 1 else f"{name}-{names.count(name)}")
            if token.tag == "h2":
                contents.append((str(token.attrGet("id")), text))
        elif token.type == "table_open":
            dressed.append(_raw('<div class="scroll" role="region" tabindex="0" aria-label="table">\n'))
            columns = []
        elif token.type == "tr_open":
            place = 0
        elif token.type == "th_open":
            columns.append(text)
            token.attrSet("scope", "col")
        elif token.type == "td_open":
            classes = [columns[place].lower().replace(" ", "-")] if columns[place] in _COLUMNS else []
            classes += [_VERDICTS[text]] if columns[place] == "Verdict" and text in _VERDICTS else []
            if classes:
                token.attrSet("class", " ".join(classes))
            place += 1
        dressed.append(token)
        if token.type == "table_close":
            dressed.append(_raw("</div>\n"))
    return dressed, contents


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
td.the-paper { min-width: 14rem; } td.evidence { min-width: 24rem; } td.ours, td.reading { min-width: 9rem; }
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
