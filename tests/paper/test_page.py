"""The page for a small set of results."""

from __future__ import annotations

import re
from dataclasses import asdict
from html.parser import HTMLParser

import pytest

from cablebot_baselines.paper.findings import RULE, rows
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.page import _GROUPS, _SUBJECTS, html, markdown
from cablebot_baselines.paper.published import PUBLISHED
from cablebot_baselines.paper.summary import POINTS, points
from cablebot_baselines.paper.verdicts import Run

NUMBERS = {"fig10.counted_kg": 2.1, "fig10.payload_kg": 2.1, "fig10.exact_total_mass_kg": 3.12, "fig10.motor": 2}
CELLS = ["a|b <c> *d* _e_ f_g `h|i`", 1.23456]
RESULTS = {
    "interpretation": asdict(Interpretation(line="flat")),
    "versions": {"python": "3.12", "numpy": "2.1"},
    "command": "cablebot reproduce --line flat",
    "numbers": NUMBERS,
    "parts": [
        {
            "name": "fig10",
            "title": "Fig. 10: torques [N·m]",
            "text": "Text with **bold**: `payload_kg`, `rad_s`.\n",
            "figure": "fig10",
            "tables": [{"title": "a|b", "header": ["law", "payload [kg]"], "rows": [CELLS, ["none", None]]}],
        },
        {"name": "interpretations", "title": "Interpretations", "text": "Text.", "figure": None, "tables": []},
        {"name": "map", "title": "A map", "text": "Text.", "figure": None, "tables": [], "impossible": "no tension"},
    ],
    "missing": ["fig12", "scan"],
    "rows": rows(Interpretation(line="flat"), NUMBERS),
}


class Page(HTMLParser):
    """Images, links, ids, tables and classes of cells of an HTML page with balanced tags."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.classes: dict[str, set[str]] = {}
        self.cell: set[str] | None = None
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        self.ids += [known["id"]] if "id" in known else []
        if tag in ("img", "meta"):
            self.images += [known] if tag == "img" else []
            return
        self.open.append(tag)
        if tag == "a":
            self.links.append(known["href"])
        elif tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self.cell = set((known.get("class") or "").split())

    handle_startendtag = handle_starttag

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag in ("td", "th"):
            self.classes.setdefault(self.tables[-1][-1][-1], set()).update(self.cell)
            self.cell = None

    def handle_data(self, data):
        if self.cell is not None:
            self.tables[-1][-1][-1] += data


@pytest.fixture(scope="module")
def page():
    return Page(html(RESULTS))


def test_html_needs_no_other_file_but_the_figures(page):
    assert [(image["src"], image["alt"]) for image in page.images] == [("fig10.svg", "Fig. 10: torques [N·m]")]
    assert not re.search(r"https?://|<script|<link", html(RESULTS))


def test_links_lead_to_unique_anchors(page):
    assert len(page.ids) == len(set(page.ids))
    assert page.links
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)
    assert "../errata.md" in Page(html(RESULTS | {"errata": "../errata.md"})).links
    assert "`docs/errata.md` of the project" in markdown(RESULTS)


def test_every_published_item_has_a_row(page):
    judged = [table for table in page.tables if table[0][0] == "Where"]
    assert sum(len(table) - 1 for table in judged) == len(PUBLISHED)
    planar = next(row for row in judged[0] if row[1].startswith("load capacity of the planar"))
    assert planar[2:4] == ["about 2.2 kg", "2.10 kg (−5 %)"]
    assert (planar[5], planar[7]) == ("reproduced", "cablebot reproduce --only fig10 --line flat")
    spatial = next(row for row in judged[0] if row[1].startswith("load capacity of the spatial"))
    assert (spatial[3], spatial[5], spatial[7]) == ("", "not run", "cablebot reproduce --only fig12 --line flat")
    assert {"verdict", "good"} <= page.classes["reproduced"]
    assert {"verdict", "mixed"} <= page.classes["not run"]


def test_cells_are_text_and_not_markup(page):
    table = next(table for table in page.tables if table[0] == ["law", "payload [kg]"])
    assert table[1:] == [["a|b <c> *d* _e_ f_g h|i", "1.235"], ["none", "–"]]
    assert "<code>planar.cables</code>" in html(RESULTS)
    lines = [line.replace("\\|", "") for line in markdown(RESULTS).splitlines() if line.startswith("|")]
    assert {line.count("|") for line in lines} == {3, 4, 9}


def test_parts_are_grouped_under_headings(page):
    headings = [line for line in markdown(RESULTS).splitlines() if line.startswith("#")]
    places = [headings.index(line) for line in ("## Payload", "### Fig. 10: torques [N·m]", "## Interpretations")]
    assert places == sorted(places)
    assert headings[-4:] == ["## Beyond the paper", "### A map", "## Inputs", "## Options and versions"]
    assert "## Robots" not in headings
    assert [["number", "value"], ["payload_kg", "2.1"]] in page.tables  # named in the text
    assert "Not possible under the chosen interpretation: no tension" in markdown(RESULTS)
    grouped = [name for _, names in _GROUPS for name in names]
    assert {part for item in PUBLISHED.values() for part in item.parts} <= set(grouped)


def test_summary_counts_the_verdicts_and_states_the_points():
    text = markdown(RESULTS)
    summary = text[text.index("## Summary") : text.index("## Results")]
    assert "**11 results**: 2 reproduced; 9 not run" in summary
    point = "* **Load capacity of the planar robot** (§5.2.1). Published: about 2.2 kg. Ours: 2.10 kg (−5 %). "
    total = "Total mass of platform and load by exact tracking: 3.12 kg (+42 %)."
    assert point + total in summary[summary.index("### Reproduced") :]
    assert "Load capacity of the spatial robot" not in summary
    assert RULE in summary
    assert "Not run yet: fig12, scan" in text


def test_point_with_different_verdicts_is_partly_reproduced():
    def verdicts(**changed):
        judged = [
            row | {"verdict": changed.get(row["key"].replace(".", "_"), "not reproduced")} for row in RESULTS["rows"]
        ]
        run = Run(interpretation=Interpretation(), numbers={})
        return {text.split("**")[1]: verdict for verdict, text in points(run, judged)}

    robust = "Error reduction of more than 60 % by the robust term"
    assert verdicts() == {point["title"]: "not reproduced" for point in POINTS}
    assert verdicts(**{"4_4_sum": "reproduced"})[robust] == "partly reproduced"
    assert robust not in verdicts(**{"4_4_sum": None})


def test_changed_options_are_bold():
    text = markdown(RESULTS)
    assert "* Torque limits U± of Eq. 37: **torque limits independent of speed**." in text
    assert "bold choices differ from the default" in text
    assert "default choices:" in markdown(RESULTS | {"interpretation": asdict(Interpretation())})
    assert {name for names in _SUBJECTS.values() for name in names} == set(asdict(Interpretation()))
