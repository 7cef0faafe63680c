"""The pages of the winches: a forge shows them as text, tables and links, and their tables and
their figure are those of the present code."""

import re
from pathlib import Path

import pytest
import winches_pages

WINCHES = Path(__file__).parents[1]
PAGES = [WINCHES / "README.md", *sorted((WINCHES / "docs").glob("*.md"))]
AGAIN = "write them anew: PYTHONPATH=scripts python winches/scripts/winches_pages.py"
BLOCKS = [(page, name) for page in winches_pages.PAGES for name in winches_pages.blocks(page)]

_NUMBER = r"\d+\.\d+"


@pytest.mark.parametrize(("page", "name"), BLOCKS)
def test_table_is_that_of_code_and_results(page, name):
    stored = winches_pages.blocks(page)[name]
    anew = winches_pages.block(name)
    assert re.sub(_NUMBER, "", stored) == re.sub(_NUMBER, "", anew), AGAIN
    numbers = [list(map(float, re.findall(_NUMBER, text))) for text in (stored, anew)]
    assert numbers[0] == pytest.approx(numbers[1], abs=0.011), AGAIN  # machines round differently


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_page_is_plain_markdown_whose_links_lead_to_files(page):
    text = page.read_text(encoding="utf-8")
    assert re.findall(r"^(?:```|:::+)\{.*|\{[a-z:-]+\}`", text, re.MULTILINE) == []
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
    assert [link for link in links if not (page.parent / link).exists()] == []


@pytest.mark.nightly
def test_figure_is_that_of_the_present_code(tmp_path):
    from matplotlib.testing.compare import compare_images

    drawn = tmp_path / "identify.png"
    winches_pages.figure().savefig(drawn, dpi=winches_pages.DPI, metadata={"Software": None})
    assert compare_images(str(winches_pages.FIGURE), str(drawn), tol=8) is None, AGAIN
