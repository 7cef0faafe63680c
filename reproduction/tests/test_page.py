"""The page for a small set of results; test_golden has the whole page in Markdown."""

import re
from dataclasses import asdict

import pytest

from cablebot_reproduction.contents import PARTS, VERDICTS
from cablebot_reproduction.findings import rows
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Run
from cablebot_reproduction.page import _GROUPS, _SUBJECTS, html, markdown
from cablebot_reproduction.published import PUBLISHED
from cablebot_reproduction.summary import points

FLAT = Interpretation(line="flat")
NUMBERS = {
    "fig10.counted_kg": 2.1,
    "fig10.payload_kg": 2.1,
    "fig10.exact_total_mass_kg": 3.12,
    "fig10.motor": 2,
}
CELLS = [["a|b <c> *d* _e_ f_g", 1.23456], ["none", None]]
TABLE = {"title": "a|b", "header": ["law", "payload [kg]"], "rows": CELLS}
PART = {
    "name": "fig10",
    "title": "Torques [N·m]",
    "text": "`payload_kg`",
    "figure": "fig10",
    "tables": [TABLE],
}
MAP = {
    "name": "map",
    "title": "A map",
    "text": "Text.",
    "figure": None,
    "tables": [],
    "impossible": "no tension",
}
RESULTS = {
    "interpretation": asdict(FLAT),
    "versions": {"python": "3.12", "numpy": "2.1"},
    "command": "cablebot reproduce --line flat",
    "numbers": NUMBERS,
    "parts": [PART, MAP],
    "missing": ["fig12", "scan"],
    "rows": rows(FLAT, NUMBERS),
}


def test_html_needs_figures_only_and_links_its_sections():
    text = html(RESULTS | {"errata": "../errata.md"})
    assert not re.search(r"https?://|<script|<link", text)
    assert re.findall(' src="(.*?)"', text) == ["fig10.svg"]
    sections = [f"#{name}" for name in re.findall('<h2 id="(.*?)"', text)]
    assert "#results" in sections
    assert re.findall(' href="(.*?)"', text) == [*sections, "../errata.md"]
    assert '<td class="verdict good">reproduced</td>' in text


def test_cells_are_escaped():
    assert "a|b &lt;c&gt; *d* _e_ f_g" in html(RESULTS)
    lines = markdown(RESULTS).replace("\\|", "").splitlines()
    assert {line.count("|") for line in lines if line.startswith("|")} == {3, 4, 9}


def test_every_published_item_has_a_row_with_its_verdict():
    text = markdown(RESULTS)
    for item in PUBLISHED.values():
        assert f"| {item.place} | {item.statement} |" in text.replace("\\_", "_"), item.key
    planar = next(line for line in text.splitlines() if "| load capacity of the planar" in line)
    assert "| 2.10 kg (−5 %) |" in planar
    assert "| reproduced |" in planar
    spatial = next(line for line in text.splitlines() if "| load capacity of the spatial" in line)
    assert "| not run |" in spatial
    assert "--only fig12 --line flat" in spatial
    assert "Not run yet: fig12, scan" in text
    assert "Not possible under the chosen interpretation: no tension" in text


def test_groups_and_subjects_are_complete():
    grouped = [name for _, names in _GROUPS for name in names]
    options = [name for names in _SUBJECTS.values() for name in names]
    assert {part.name for part in PARTS} - {"map-circle"} == set(grouped)
    assert {part for verdict in VERDICTS.values() for part in verdict.part_names} <= set(grouped)
    assert set(options) == set(asdict(Interpretation()))


@pytest.mark.parametrize(
    ("verdict", "expected"), [("reproduced", "partly reproduced"), (None, None)]
)
def test_point_with_different_verdicts_is_partly_reproduced(verdict, expected):
    verdicts = {"4.4.sum": verdict}
    judged = [
        row | {"verdict": verdicts.get(row["key"], "not reproduced")} for row in RESULTS["rows"]
    ]
    run = Run(interpretation=Interpretation(), numbers={})
    by_title = {text.split("**")[1]: verdict for verdict, text in points(run, judged)}
    assert by_title.get("Error reduction of more than 60 % by the robust term") == expected
