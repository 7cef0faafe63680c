"""The hand-written pages: their generated blocks are up to date, and a forge shows them as text,
tables and links."""

import json
import re
from pathlib import Path

import page_blocks
import pytest

ROOT = Path(__file__).parents[1]
AGAIN = "write them anew: python scripts/page_blocks.py"

MET_FIRST = (
    *("README.md", "LEADERBOARD.md", "CHANGELOG.md", "CONTRIBUTING.md"),
    *(
        f"docs/{name}.md"
        for name in (
            "index",
            "getting-started",
            "environments",
            "policies",
            "dlcc",
            "leaderboard",
            "faq",
        )
    ),
)
"""The README, and the pages that it and the home page lead to first."""


BLOCKS = [
    pytest.param(
        page,
        name,
        id=f"{page}: {name}",
        marks=pytest.mark.slow if "output" in name or name == "library" else [],
    )
    for page in page_blocks.PAGES
    for name in page_blocks.blocks((ROOT / page).read_text(encoding="utf-8"))
]

_NUMBER = r"\d+\.\d+"


def read(page):
    return (ROOT / page).read_text(encoding="utf-8")


@pytest.mark.parametrize(("page", "name"), BLOCKS)
def test_block_is_that_of_code_and_results(page, name):
    stored = page_blocks.blocks(read(page))[name]
    anew = page_blocks.block(name)
    assert re.sub(_NUMBER, "", stored) == re.sub(_NUMBER, "", anew), AGAIN
    numbers = [list(map(float, re.findall(_NUMBER, text))) for text in (stored, anew)]
    assert numbers[0] == pytest.approx(numbers[1], abs=0.011), AGAIN  # machines round differently


def test_laws_behind_the_homed_filter_keep_their_payload():
    """As the page says."""
    least = float(
        re.search(
            r"every law keeps at least (\d+) %", " ".join(read("docs/measurement.md").split())
        )[1]
    )
    cases = json.loads(
        (page_blocks.measure_winches.FOLDER / "results.json").read_text(encoding="utf-8")
    )["cases"]
    exact = {}
    homed = {}
    for case in cases:
        key = case["env_id"], case["disturbance"]
        if case["sensors"] == "pose" and case["payload"] is not None:
            exact[key] = case["payload"]
        if (case["estimator"], case["errors"]) == ("ekf-homed", "load-cells"):
            homed[key] = case["payload"]
    del exact["CableBot-Spatial-v0", "hardware"]  # the exception of the page
    assert {env_id for env_id, _ in exact} == set(page_blocks.measure_winches.LAWS)
    for key, payload in exact.items():
        assert homed[key] >= least / 100 * payload


def test_code_of_the_home_page_is_that_of_the_example():
    for name, text in page_blocks.blocks(read("docs/index.md")).items():
        if name.endswith(page_blocks.WITH_OUTPUT):
            assert text.startswith(page_blocks.block(name.removesuffix(page_blocks.WITH_OUTPUT))), (
                AGAIN
            )


@pytest.mark.parametrize("page", MET_FIRST)
def test_page_is_plain_markdown(page):
    """A forge shows directives and roles as code."""
    assert re.findall(r"^(?:```|:::+)\{.*|\{[a-z:-]+\}`", read(page), re.MULTILINE) == []


@pytest.mark.parametrize("page", MET_FIRST)
def test_every_link_leads_to_a_file_of_the_repository(page):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", read(page))
    assert [link for link in links if not (ROOT / page).parent.joinpath(link).exists()] == []
    assert [link for link in links if "generated/" in link] == []  # git ignores that folder


def test_links_to_headings_stay_within_the_site():
    """The site knows no headings of such files, and its build fails after an hour of tests."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        for link in re.findall(r"\]\(([^)#:]+)#[^)]*\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).resolve().is_relative_to(ROOT / "docs"), f"{page}: {link}"


@pytest.mark.slow
def test_figures_are_those_of_the_present_code(tmp_path):
    pytest.importorskip("matplotlib")
    import page_figures
    from matplotlib.testing.compare import compare_images

    for drawn in page_figures.write(tmp_path):
        stored = page_figures.FOLDER / drawn.name
        different = compare_images(str(stored), str(drawn), tol=8)
        assert different is None, f"draw them anew: python scripts/page_figures.py\n{different}"
