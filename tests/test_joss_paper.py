"""The paper has the stored results, its references exist, and it is short."""

import re

from joss_paper import PAPER, paper

TEXT = PAPER.read_text(encoding="utf-8")
BODY = TEXT.split("---\n", 2)[2]


def test_paper_has_the_stored_results():
    assert paper() == TEXT, "make it anew: python scripts/joss_paper.py"


def test_paper_cites_all_references_and_no_others():
    entries = re.findall(r"@\w+\{(\w+),", (PAPER.parent / "paper.bib").read_text(encoding="utf-8"))
    assert set(re.findall(r"@(\w+)", BODY)) == set(entries)
