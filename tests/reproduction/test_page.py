"""The page against a small set of results."""

from __future__ import annotations

import copy
import re
from dataclasses import asdict
from html.parser import HTMLParser

import pytest

from baselines.reproduction.findings import FINDERS, RULE, rows
from baselines.reproduction.page import _GROUPS, _VERDICTS, MAIN, html, markdown
from baselines.reproduction.published import PUBLISHED
from baselines.reproduction.readings import Readings

RESULTS = {
    "readings": asdict(Readings(line="flat")),
    "versions": {"python": "3.12", "numpy": "2.1"},
    "command": "cablebot reproduce --line flat",
    "numbers": {},
    "parts": [
        {
            "name": "fig10",
            "title": "Fig. 10: torques [N·m]",
            "text": "What **is** shown.",
            "figure": "fig10",
            "tables": [
                {
                    "title": "A table of a|b",
                    "header": ["law", "payload [kg]"],
                    "rows": [["a|b <c> *d* _e_ f_g", 1.23456], ["none", None]],
                }
            ],
        },
        {"name": "readings", "title": "Readings", "text": "Text.", "figure": None, "tables": []},
        {
            "name": "map-radius",
            "title": "A map",
            "text": "Text.",
            "figure": None,
            "tables": [],
            "impossible": "no positive tensions hold it",
        },
    ],
    "rows": rows(Readings(line="flat"), {"fig10.counted_kg": 2.1, "fig10.payload_kg": 2.1, "fig10.motor": 2}),
    "missing": ["fig12", "scan"],
}


class Page(HTMLParser):
    """Tags, checked for balance; images, links, ids and the cells of tables."""

    VOID = ("meta", "img", "br", "hr", "link")

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.classes: dict[str, set[str]] = {}
        self.cell = None
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        if known.get("id"):
            self.ids.append(known["id"])
        if tag == "img":
            self.images.append(known)
        if tag == "a":
            self.links.append(known["href"])
        if tag == "table":
            assert self.open[-1] == "div"
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self.cell = known.get("class") or ""
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag in ("td", "th"):
            self.classes.setdefault(self.tables[-1][-1][-1], set()).update((self.cell or "").split())
            self.cell = None

    def handle_data(self, data):
        if self.cell is not None:
            self.tables[-1][-1][-1] += data


@pytest.fixture(scope="module")
def page():
    return Page(html(RESULTS))


def test_html_is_not_unbalanced(page):
    assert html(RESULTS).startswith("<!DOCTYPE html>")
    assert len(page.ids) == len(set(page.ids))


def test_every_figure_has_its_picture_and_words(page):
    assert [image["src"] for image in page.images] == ["fig10.png"]
    assert page.images[0]["alt"] == "Fig. 10: torques [N·m]"
    assert "fig10.svg" in page.links


def test_no_link_within_the_page_leads_nowhere(page):
    inner = [link[1:] for link in page.links if link.startswith("#")]
    assert inner
    assert set(inner) <= set(page.ids)
    assert {link for link in page.links if not link.startswith("#")} == {"fig10.svg", "docs/errata.md"}
    assert "../errata.md" in Page(html(RESULTS | {"errata": "../errata.md"})).links


def test_nothing_is_loaded_from_elsewhere():
    assert not re.search(r"https?://|<script|<link", html(RESULTS))


def test_every_published_number_has_a_row(page):
    judged = [table for table in page.tables if table[0][0] == "Where"]
    assert sum(len(table) - 1 for table in judged) == len(PUBLISHED)
    assert all(len(row) == 8 for table in judged for row in table)
    results = next(table for table in judged if table[1][0] == "§4.4")
    planar = next(row for row in results if row[1].startswith("load capacity of the planar"))
    assert planar[2:4] == ["about 2.2 kg", "2.1 kg (−5 %)"]
    assert planar[5] == "reproduces"
    assert planar[7] == "cablebot reproduce --only fig10 --line flat"


def test_what_was_not_run_says_how_to(page):
    row = next(row for table in page.tables for row in table if row[1].startswith("load capacity of the spatial"))
    assert row[5] == "not run"
    assert row[7] == "cablebot reproduce --only fig12 --line flat"
    assert "Not run yet: fig12, scan" in markdown(RESULTS)
    assert "Not run yet" not in markdown(RESULTS | {"missing": []})


def test_verdicts_are_marked(page):
    assert {"verdict", "good"} <= page.classes["reproduces"]
    assert {"verdict", "mixed"} <= page.classes["not run"]


def test_text_in_tables_is_not_markup(page):
    cells = [cell for table in page.tables for row in table for cell in row]
    assert "a|b <c> *d* _e_ f_g" in cells
    assert "1.235" in cells
    assert "–" in cells
    lines = [line for line in markdown(RESULTS).splitlines() if line.startswith("|")]
    tables = "\n".join(lines).replace("\\|", "")
    assert {line.count("|") for line in tables.splitlines()} == {3, 9}


def test_code_in_evidence_stays_code():
    assert "<code>Robot.cables</code>" in html(RESULTS)
    assert "`Robot.cables`" in markdown(RESULTS)


def test_a_part_that_is_impossible_says_why():
    assert "no positive tensions hold it" in html(RESULTS)


def test_parts_stand_under_their_headings():
    text = markdown(RESULTS)
    headings = [line for line in text.splitlines() if line.startswith("#")]
    places = [headings.index(line) for line in ("## Payload", "### Fig. 10: torques [N·m]", "## Readings")]
    assert places == sorted(places)
    assert headings[headings.index("### A map") - 1] == "## Beyond the paper"
    assert headings[-2:] == ["## Inputs", "## Readings and versions"]
    assert "## Robots" not in headings


def test_groups_hold_what_findings_need():
    grouped = [name for _, names in _GROUPS for name in names]
    assert len(grouped) == len(set(grouped))
    assert {part for finder in FINDERS.values() for part in finder.parts} <= set(grouped)


def test_the_summary_counts_and_names_the_main_findings():
    text = markdown(RESULTS)
    assert set(MAIN) <= set(PUBLISHED)
    assert "**11 results**: 2 reproduce; 9 not run" in text
    assert "* **§5.2.1, load capacity of the planar robot** (about 2.2 kg): 2.1 kg (−5 %), *reproduces*." in text
    assert "load capacity of the spatial robot** (" not in text
    assert RULE in text
    assert "cablebot reproduce --line flat" in text
    assert "Readings chosen: line flat." in text


def test_no_verdict_is_without_mark():
    from typing import get_args

    from baselines.reproduction.finding import Verdict

    assert set(_VERDICTS) == {*get_args(Verdict), "not run"}


def test_results_are_not_changed():
    before = copy.deepcopy(RESULTS)
    assert html(RESULTS) == html(RESULTS)
    assert before == RESULTS
