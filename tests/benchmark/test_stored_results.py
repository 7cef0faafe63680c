"""Results in docs: the leaderboard follows from them, the cells are those of the suites, and samples
still hold."""

import re
from pathlib import Path

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, SurveyCell
from cablebot_gym.benchmark.check import compare_rows
from cablebot_gym.benchmark.leaderboard import Results, markdown
from cablebot_gym.benchmark.records import compute
from cablebot_gym.benchmark.scores import RANKED_MOTIONS, leaderboards, payload_maps
from cablebot_gym.benchmark.seeds import evaluation_seed, hidden_seeds
from cablebot_gym.policies import policy_entries
from cablebot_gym.report.page import merge_records

ROOT = Path(__file__).parents[2]
LATER = {"adaptive", "nmpc", "observing", "trajopt"}
"""Policies that were computed after the board, and on its main table only."""


@pytest.fixture(scope="module")
def results():
    def read(name):
        return Results.from_json((ROOT / "docs" / name / "results.json").read_text())

    return {name: read(name) for name in ("leaderboard", "library")}


def test_leaderboard_follows_from_the_results(results):
    stored = results["leaderboard"]
    again = f"run {stored.command}"
    assert (ROOT / "LEADERBOARD.md").read_text() == markdown(stored), again
    assert (ROOT / "docs" / "leaderboard" / "results.json").read_text() == stored.to_json(), again


def test_rows_of_the_leaderboard_are_of_today_or_of_its_board(results):
    """Excludes a row of a policy that has changed since: it would stand beside those of today."""
    origins = {
        "of board 2026-2": set(),
        "computed after board 2026-2, on its first 20 motions": set(),
    }
    for record in records_of(results["leaderboard"], PolicyCell):
        origins[record.versions["rows"]].add(record.cell.policy)
    board, later = origins.values()
    assert later == LATER
    assert board & later == set()
    assert board | later <= policy_entries().keys()


def records_of(results, kind):
    return [record for record in results.records if isinstance(record.cell, kind)]


@pytest.mark.parametrize("name", ["leaderboard", "library"])
def test_results_have_the_cells_of_their_suite(results, name):
    """The only errors are missed deadlines."""
    stored = results[name]
    rows = compare_rows(stored)
    assert [cell.stem for cell in rows.missing if cell.policy not in LATER] == []
    assert rows.unexpected == rows.not_installed == ()
    for record in stored.records:
        assert record.error is None or "did not answer within" in record.error
    for record in records_of(stored, BestKnownCell):
        assert record.result["verified"]


def test_report_has_the_fractions_of_the_leaderboard(results):
    """Robots of a yardstick differ in their seed alone."""
    stored = results["leaderboard"]

    def fractions(records):
        return [
            (board.env_id, policy, board.fraction(policy, column))
            for board in leaderboards(records)
            for policy, column in board.entries
        ]

    assert fractions(merge_records([stored])) == fractions(stored.records)


def test_leaderboards_and_maps_leave_out_real_robots(results):
    """Cells of one environment id and motion once were motions of one robot."""
    records = results["library"].records
    assert leaderboards(records) == []
    assert payload_maps(records) == []


def test_seeds_of_the_leaderboard_follow_from_its_text(results):
    leaderboard = results["leaderboard"]
    assert leaderboard.suite == "ranked"
    seed = evaluation_seed(leaderboard.seed_text)
    assert {record.cell.seed for record in records_of(leaderboard, PolicyCell)} == {seed}
    for record in records_of(leaderboard, SurveyCell):
        motions = record.cell.trajectory["seed"]
        assert len(motions) >= RANKED_MOTIONS
        seeds = hidden_seeds(leaderboard.seed_text, record.cell.env_id, len(motions))
        assert list(motions) == seeds


@pytest.mark.slow
@pytest.mark.parametrize("index", range(10))
def test_cheapest_payloads_of_the_leaderboard_are_reproduced(results, index):
    carried = [
        record
        for record in records_of(results["leaderboard"], PolicyCell)
        if record.result.get("payload") and record.cell.policy in policy_entries()
    ]
    carried.sort(key=lambda record: record.seconds)
    stored = carried[index].result
    result = compute(carried[index].cell).result
    assert result["payload"] == pytest.approx(stored["payload"], abs=stored["resolution"])


@pytest.mark.slow
def test_best_known_payload_is_reproduced(results):
    for record in records_of(results["leaderboard"], BestKnownCell):
        cell = record.cell
        if cell.env_id == "CableBot-Planar-v0" and cell.trajectory["name"] == "circle-planar":
            break
    assert compute(cell).result["payload"] == pytest.approx(record.result["payload"], rel=2e-3)


OTHERS = {
    "attacks.md",
    "changelog.md",
    "motions.md",
    "ranking.md",
}
"""Pages that a script writes, and the history."""

SETTINGS = {
    "README.md": {"6 kg"},  # what the picture shows
    "docs/index.md": {"6 kg"},
    "paper/template.md": {"95%"},
    "docs/dlcc.md": {"0.001 kg", "0.01 kg", "10 %", "99 %"},
    "docs/glossary.md": {"95 %"},
    # A threshold, which test_pages.py compares with the results, and a confidence level.
    "docs/measurement.md": {"90 %", "95 %"},
    "docs/uncertainty.md": {"95 %", "10 %", "13 %", "1 ms", "2 ms"},
}
"""Numbers that are options, definitions or published by others, not measured results."""


def prose(path):
    """Text of a page without code and without tables that scripts write."""
    text = re.sub(r"<!-- [^>]*written by.*?<!-- end", "", path.read_text(), flags=re.DOTALL)
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def test_no_measured_number_is_typed_into_prose():
    pages = [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "paper" / "template.md",
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "docs").glob("*/*.md"),
    ]
    for path in pages:
        name = path.relative_to(ROOT).as_posix()
        if path.name in OTHERS or "/generated/" in name:
            continue
        numbers = re.findall(
            r"\d+(?:\.\d+)? ?(?:kg|%|ms|s|min|minutes?|hours?)(?![\w/·])", prose(path)
        )
        typed = set(numbers) - SETTINGS.get(name, set())
        assert not typed, f"{name} has {typed}: generate these numbers from stored results"
