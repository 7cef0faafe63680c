"""The page for a small set of results; test_golden has the whole page in Markdown."""

from __future__ import annotations

import re
from dataclasses import asdict
from html.parser import HTMLParser

import pytest

from cablebot_baselines.paper.findings import rows
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.page import _GROUPS, _SUBJECTS, html, markdown
from cablebot_baselines.paper.published import PUBLISHED
from cablebot_baselines.paper.summary import points
from cablebot_baselines.paper.verdicts import Run

NUMBERS = {"fig10.counted_kg": 2.1, "fig10.payload_kg": 2.1, "fig10.exact_total_mass_kg": 3.12, "fig10.motor": 2}
CELLS = ["a|b <c> *d* _e_ f_g", 1.23456]
TABLE = {"title": "a|b", "header": ["law", "payload [kg]"], "rows": [CELLS, ["none", None]]}
RESULTS = {
    "interpretation": asdict(Interpretation(line="flat")),
    "versions": {"python": "3.12", "numpy": "2.1"},
    "command": "cablebot reproduce --line flat",
    "numbers": NUMBERS,
    "parts": [
        {
            "name": "fig10",
            "title": "Fig. 10: torques [N·m]",
            "text": "`payload_kg`",
            "figure": "fig10",
            "tables": [TABLE],
        },
        {"name": "map", "title": "A map", "text": "Text.", "figure": None, "tables": [], "impossible": "no tension"},
    ],
    "missing": ["fig12", "scan"],
    "rows": rows(Interpretation(line="flat"), NUMBERS),
}


class Page(HTMLParser):
    """Images, links and ids of an HTML page with balanced tags."""

    def __init__(self, text):
        super().__init__()
        self.open, self.images, self.links, self.ids = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        self.ids += [known["id"]] if "id" in known else []
        self.links += [known["href"]] if tag == "a" else []
        self.images += [known["src"]] if tag == "img" else []
        self.open += [tag] if tag not in ("img", "meta") else []

    handle_startendtag = handle_starttag

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_html_is_balanced_and_needs_no_other_file_but_the_figures():
    text = html(RESULTS)
    page = Page(text)
    assert page.images == ["fig10.svg"]
    assert not re.search(r"https?://|<script|<link", text)
    assert len(page.ids) == len(set(page.ids))
    assert page.links
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)
    assert "../errata.md" in Page(html(RESULTS | {"errata": "../errata.md"})).links


def test_cells_are_escaped():
    assert "a|b &lt;c&gt; *d* _e_ f_g" in html(RESULTS)
    lines = [line.replace("\\|", "") for line in markdown(RESULTS).splitlines() if line.startswith("|")]
    assert {line.count("|") for line in lines} == {3, 4, 9}


def test_every_published_item_has_a_row_with_its_verdict():
    text = markdown(RESULTS)
    judged = [line for line in text.splitlines() if line.startswith("|") and line.count("|") - line.count("\\|") == 9]
    assert len([line for line in judged if not line.startswith(("| Where", "| :", "| -", "|-", "|:"))]) == len(
        PUBLISHED
    )
    planar = next(line for line in judged if "load capacity of the planar" in line)
    assert all(part in planar for part in ("| 2.10 kg (−5 %) |", "| reproduced |", "--only fig10 --line flat"))
    spatial = next(line for line in judged if "load capacity of the spatial" in line)
    assert all(part in spatial for part in ("| not run |", "--only fig12 --line flat"))
    assert "Not run yet: fig12, scan" in text
    assert "Not possible under the chosen interpretation: no tension" in text


def test_groups_and_subjects_are_complete():
    grouped = [name for _, names in _GROUPS for name in names]
    assert {part for item in PUBLISHED.values() for part in item.parts} <= set(grouped)
    assert {name for names in _SUBJECTS.values() for name in names} == set(asdict(Interpretation()))


@pytest.mark.parametrize(("verdict", "expected"), [("reproduced", "partly reproduced"), (None, None)])
def test_point_with_different_verdicts_is_partly_reproduced(verdict, expected):
    judged = [row | {"verdict": "not reproduced" if row["key"] != "4.4.sum" else verdict} for row in RESULTS["rows"]]
    found = points(Run(interpretation=Interpretation(), numbers={}), judged)
    title = "Error reduction of more than 60 % by the robust term"
    assert {text.split("**")[1]: verdict for verdict, text in found}.get(title) == expected
