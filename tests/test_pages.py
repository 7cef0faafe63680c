"""Hand-written and generated pages: their blocks and files follow from code and stored results, a forge
shows them, and their links and code work."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pages
import pytest

from cablebot_gym.benchmark.store import read as load_rows
from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.robots import COORDINATE_NAMES, find_robot

ROOT = Path(__file__).parents[1]
AGAIN = "write them anew: python scripts/pages.py"

FRONT = ("README.md", "LEADERBOARD.md", "CHANGELOG.md", "CONTRIBUTING.md")

DOCS = tuple(
    path.relative_to(ROOT).as_posix()
    for path in sorted((ROOT / "docs").rglob("*.md"))
    if "generated" not in path.parts
)

MET_FIRST = (
    *FRONT,
    *(
        f"docs/{name}.md"
        for name in ("index", "getting-started", "environments", "policies", "dlcc", "leaderboard")
    ),
)
"""The README, which is the home page, and the pages that it leads to first."""

TIERS = {
    "library payloads": pytest.mark.landing,
    "recommendations": pytest.mark.landing,
}


def tier(block):
    """The mark of a block that is not written anew in a moment."""
    return pytest.mark.evidence if "output" in block else TIERS.get(block, ())


BLOCKS = [
    pytest.param(page, name, id=f"{page}: {name}", marks=tier(name))
    for page in pages.PAGES
    for name in pages.blocks((ROOT / page).read_text(encoding="utf-8"))
]

_NUMBER = r"\d+\.\d+"


def read(page):
    return (ROOT / page).read_text(encoding="utf-8")


# --- pages that scripts write -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("page", "name"), BLOCKS)
def test_block_is_that_of_code_and_results(page, name):
    stored = pages.blocks(read(page))[name]
    anew = pages.block(name)
    assert re.sub(_NUMBER, "", stored) == re.sub(_NUMBER, "", anew), AGAIN
    numbers = [list(map(float, re.findall(_NUMBER, text))) for text in (stored, anew)]
    assert numbers[0] == pytest.approx(numbers[1], abs=0.011), AGAIN  # machines round differently


def test_code_of_the_home_page_is_that_of_the_example():
    for name, text in pages.blocks(read("README.md")).items():
        if name.endswith(pages.WITH_OUTPUT):
            assert text.startswith(pages.block(name.removesuffix(pages.WITH_OUTPUT))), AGAIN


@pytest.mark.landing
def test_leaderboard_and_paper_follow_from_the_results():
    results = pages.stored("ranked")
    assert read("docs/results/ranked.jsonl") == results.to_text()
    assert read("LEADERBOARD.md") == pages.markdown(results), AGAIN
    assert pages.PAPER.read_text(encoding="utf-8") == pages.paper(), AGAIN


def test_paper_cites_all_references_and_no_others():
    entries = re.findall(r"@\w+\{(\w+),", read("paper/paper.bib"))
    body = read("paper/paper.md").split("---\n", 2)[2]
    assert set(re.findall(r"@(\w+)", body)) == set(entries)


@pytest.mark.evidence
def test_figures_are_those_of_the_present_code(tmp_path):
    pytest.importorskip("matplotlib")
    import page_figures
    from matplotlib.testing.compare import compare_images

    for drawn in page_figures.write(tmp_path):
        stored = page_figures.FOLDER / drawn.name
        different = compare_images(str(stored), str(drawn), tol=8)
        assert different is None, f"draw them anew: python scripts/page_figures.py\n{different}"


# --- links and Markdown -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", MET_FIRST)
def test_page_is_plain_markdown(page):
    """A forge shows directives and roles as code."""
    assert re.findall(r"^(?:```|:::+)\{.*|\{[a-z:-]+\}`", read(page), re.MULTILINE) == []


@pytest.mark.parametrize("page", [*FRONT, *DOCS])
def test_every_link_leads_to_a_file_of_the_repository(page):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", read(page))
    links = [link for link in links if not link.startswith("/")]  # a page of the site
    assert [link for link in links if not (ROOT / page).parent.joinpath(link).exists()] == []
    assert [link for link in links if "generated/" in link] == []  # git ignores that folder


# --- statements -------------------------------------------------------------------------------------------------------


def test_manual_names_the_coordinates_of_every_id():
    for robot in map(find_robot, ENV_ROBOTS.values()):
        assert f"({', '.join(COORDINATE_NAMES[robot.kind])})" in CableBotEnv.__doc__


def test_laws_behind_the_homed_filter_keep_their_payload():
    """As the page says."""
    page = " ".join(read("docs/measurement.md").split())
    least = float(re.search(r"every law keeps at least (\d+) %", page)[1])
    sensors = pages.measure_winches
    stored = {row.key: row.result for row in load_rows(sensors.FOLDER / "sensors.jsonl").rows}
    exact = {}
    homed = {}
    for env_id in sensors.LAWS:
        for case in sensors.cases(env_id):
            payload = stored[sensors.question(env_id, case).key]["payload"]
            key = env_id, case["disturbance"]
            if case["sensors"] == "pose" and payload is not None:
                exact[key] = payload
            if (case["estimator"], case["errors"]) == ("ekf-homed", "load-cells"):
                homed[key] = payload
    assert {env_id for env_id, _ in exact} == set(sensors.LAWS)
    for key, payload in exact.items():
        assert homed[key] >= least / 100 * payload


SETTINGS = {
    "README.md": {"6 kg"},  # what the picture shows
    "paper/template.md": {"95%"},
    "docs/dlcc.md": {"99 %"},
    "docs/leaderboard.md": {"2 %", "2 s"},  # noise and deadline of an attack
    # A threshold, which a test compares with the results, and a confidence level.
    "docs/measurement.md": {"90 %", "95 %"},
    "docs/uncertainty.md": {"95 %", "10 %", "13 %", "1 ms", "2 ms"},
}
"""Numbers that are options, definitions or published by others, not measured results."""


def test_no_measured_number_is_typed_into_prose():
    for page in ["README.md", "CONTRIBUTING.md", "paper/template.md", *DOCS]:
        # without code and without tables that scripts write
        text = re.sub(r"<!-- [^>]*written by.*?<!-- end", "", read(page), flags=re.DOTALL)
        text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
        numbers = re.findall(r"\d+(?:\.\d+)? ?(?:kg|%|ms|s|min|minutes?|hours?)(?![\w/·])", text)
        typed = set(numbers) - SETTINGS.get(page, set())
        assert not typed, f"{page} has {typed}: generate these numbers from stored results"


# --- scripts ----------------------------------------------------------------------------------------------------------


@pytest.mark.landing
def test_policy_of_the_readme_runs(tmp_path):
    _, code = re.findall(r"```python\n(.*?)```", read("README.md"), re.DOTALL)
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0
    assert all(line.startswith("compiling for") for line in ran.stderr.splitlines())
    assert re.search(r"payload known(, not isolated)?: \d\.\d+ kg", ran.stdout)


def test_every_client_has_a_result():
    """The table on training lists scripts by their results; one without result has not run."""
    scripts = {path.name for path in (ROOT / "examples/clients").glob("*.py")}
    results = json.loads(read("docs/clients.json"))
    assert {f"use_{name}.py" for name in results} == scripts
    for ran in results.values():
        assert (ran["error"] is None) == (ran["figure"] is not None)
