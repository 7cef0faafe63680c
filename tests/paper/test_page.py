"""The page against a small set of results."""

from __future__ import annotations

import copy
import re
from dataclasses import asdict
from html.parser import HTMLParser

import pytest

from cablebot_baselines.paper.finding import Run
from cablebot_baselines.paper.findings import FINDING_RULES, RULE, rows
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.page import _GROUPS, _SUBJECTS, _VERDICTS, html, markdown
from cablebot_baselines.paper.published import PUBLISHED
from cablebot_baselines.paper.summary import HEADINGS, POINTS, points

RESULTS = {
    "interpretation": asdict(Interpretation(line="flat")),
    "versions": {"python": "3.12", "numpy": "2.1"},
    "command": "cablebot reproduce --line flat",
    "numbers": {
        "fig10.counted_kg": 2.1,
        "fig10.payload_kg": 2.1,
        "fig10.exact_total_mass_kg": 3.12,
        "fig10.motor": 2,
    },
    "parts": [
        {
            "name": "fig10",
            "title": "Fig. 10: torques [N·m]",
            "text": "What **is** shown: `payload_kg`, `rad_s`.\n",
            "figure": "fig10",
            "tables": [
                {
                    "title": "A table of a|b",
                    "header": ["law", "payload [kg]"],
                    "rows": [["a|b <c> *d* _e_ f_g", 1.23456], ["none", None]],
                }
            ],
        },
        {"name": "interpretations", "title": "Interpretations", "text": "Text.", "figure": None, "tables": []},
        {
            "name": "map-radius",
            "title": "A map",
            "text": "Text.",
            "figure": None,
            "tables": [],
            "impossible": "no positive tensions hold it",
        },
    ],
    "missing": ["fig12", "scan"],
}


RESULTS["rows"] = rows(Interpretation(line="flat"), RESULTS["numbers"])


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
    assert [image["src"] for image in page.images] == ["fig10.svg"]
    assert page.images[0]["alt"] == "Fig. 10: torques [N·m]"


def test_no_link_within_the_page_leads_nowhere(page):
    inner = [link[1:] for link in page.links if link.startswith("#")]
    assert inner
    assert set(inner) <= set(page.ids)
    assert all(link.startswith("#") for link in page.links)
    linked = Page(html(RESULTS | {"errata": "../errata.md"}))
    assert {link for link in linked.links if not link.startswith("#")} == {"../errata.md"}
    assert "`docs/errata.md`" in markdown(RESULTS)
    assert "../errata.md" in Page(html(RESULTS | {"errata": "../errata.md"})).links


def test_nothing_is_loaded_from_elsewhere():
    assert not re.search(r"https?://|<script|<link", html(RESULTS))


def test_every_published_number_has_a_row(page):
    judged = [table for table in page.tables if table[0][0] == "Where"]
    assert sum(len(table) - 1 for table in judged) == len(PUBLISHED)
    assert all(len(row) == 8 for table in judged for row in table)
    results = next(table for table in judged if table[1][0] == "§4.4")
    planar = next(row for row in results if row[1].startswith("load capacity of the planar"))
    assert planar[2:4] == ["about 2.2 kg", "2.10 kg (−5 %)"]
    assert planar[5] == "reproduced"
    assert planar[7] == "cablebot reproduce --only fig10 --line flat"


def test_what_was_not_run_says_how_to(page):
    row = next(row for table in page.tables for row in table if row[1].startswith("load capacity of the spatial"))
    assert row[5] == "not run"
    assert row[7] == "cablebot reproduce --only fig12 --line flat"
    assert "Not run yet: fig12, scan" in markdown(RESULTS)
    assert "Not run yet" not in markdown(RESULTS | {"missing": []})


def test_verdicts_are_marked(page):
    assert {"verdict", "good"} <= page.classes["reproduced"]
    assert {"verdict", "mixed"} <= page.classes["not run"]


def test_text_in_tables_is_not_markup(page):
    cells = [cell for table in page.tables for row in table for cell in row]
    assert "a|b <c> *d* _e_ f_g" in cells
    assert "1.235" in cells
    assert "–" in cells
    lines = [line for line in markdown(RESULTS).splitlines() if line.startswith("|")]
    tables = "\n".join(lines).replace("\\|", "")
    assert {line.count("|") for line in tables.splitlines()} == {3, 4, 9}


def test_code_in_evidence_stays_code():
    assert "<code>Robot.cables</code>" in html(RESULTS)
    assert "`Robot.cables`" in markdown(RESULTS)


def test_a_part_that_is_impossible_says_why():
    assert "no positive tensions hold it" in html(RESULTS)


def test_parts_stand_under_their_headings():
    text = markdown(RESULTS)
    headings = [line for line in text.splitlines() if line.startswith("#")]
    places = [headings.index(line) for line in ("## Payload", "### Fig. 10: torques [N·m]", "## Interpretations")]
    assert places == sorted(places)
    assert headings[headings.index("### A map") - 1] == "## Beyond the paper"
    assert headings[-2:] == ["## Inputs", "## Options and versions"]
    assert "## Robots" not in headings


def test_groups_hold_what_findings_need():
    grouped = [name for _, names in _GROUPS for name in names]
    assert len(grouped) == len(set(grouped))
    assert {part for finder in FINDING_RULES.values() for part in finder.parts} <= set(grouped)


def test_the_summary_counts_and_says_what_reproduces():
    text = markdown(RESULTS)
    assert "**11 results**: 2 reproduced; 9 not run" in text
    summary = text[text.index("## Summary") : text.index("## Results")]
    point = "* **Load capacity of the planar robot** (§5.2.1). Published: about 2.2 kg. Ours: 2.10 kg (−5 %). "
    assert point in summary[summary.index("### Reproduced") :]
    assert "Total mass of platform and load by exact tracking: 3.12 kg (+42 %)." in summary
    assert "### Not reproduced" not in summary
    assert "Load capacity of the spatial robot" not in summary
    assert RULE in summary


def test_points_of_the_summary_are_findings():
    keys = [key for keys, _, _ in POINTS for key in keys]
    assert len(keys) == len(set(keys))
    assert set(keys) <= set(PUBLISHED)


def test_a_point_whose_findings_differ_reproduces_in_part():
    def said(**verdicts):
        judged = [
            row | {"verdict": verdicts.get(row["key"].replace(".", "_"), "not reproduced")} for row in RESULTS["rows"]
        ]
        return {title.split("**")[1]: verdict for verdict, title in points(run, judged)}

    run = Run(interpretation=Interpretation(), numbers={})
    found = said()
    assert set(found) == {title for _, title, _ in POINTS}
    assert set(found.values()) == {"not reproduced"}
    assert found | {"Error reduction of more than 60 % by the robust term": "partly reproduced"} == said(
        **{"4_4_sum": "reproduced"}
    )
    assert set(said(**{"4_4_sum": None})) == set(found) - {"Error reduction of more than 60 % by the robust term"}
    assert {*found.values(), "partly reproduced"} <= set(HEADINGS)


def test_readings_that_are_not_the_default_stand_out():
    text = markdown(RESULTS)
    assert "* Torque limits U± of Eq. 37: **torque limits independent of speed**." in text
    assert "bold choices differ from the default" in text
    assert "cablebot reproduce --line flat" in text
    default = markdown(RESULTS | {"interpretation": asdict(Interpretation())})
    assert "This page uses the default choices:" in default
    assert "* Torque limits U± of Eq. 37: torque limits from the motor speed in rad/s." in default
    assert {name for names in _SUBJECTS.values() for name in names} == set(asdict(Interpretation()))


def test_numbers_that_a_text_names_stand_below_it(page):
    assert [["number", "value"], ["payload_kg", "2.1"]] in page.tables


def test_no_verdict_is_without_mark():
    from typing import get_args

    from cablebot_baselines.paper.finding import Verdict

    assert set(_VERDICTS) == {*get_args(Verdict), "not run"}


def test_results_are_not_changed():
    before = copy.deepcopy(RESULTS)
    assert html(RESULTS) == html(RESULTS)
    assert before == RESULTS
