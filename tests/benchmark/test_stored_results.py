"""Results in docs: the pages follow from the stored results, the cells are those of the suites, and
samples still hold.

The last line of each page is the command that computes it.
"""

import re
from pathlib import Path

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell
from cablebot_gym.benchmark.engine import local
from cablebot_gym.benchmark.leaderboard import Results, markdown
from cablebot_gym.benchmark.records import compute
from cablebot_gym.benchmark.scores import leaderboards, payload_maps
from cablebot_gym.benchmark.suites import find_policies, find_suite, suite_cells
from cablebot_gym.benchmark.verification import broken, confirm
from cablebot_gym.policies import policy_entries
from cablebot_gym.report.page import merge_records

ROOT = Path(__file__).parents[2]
PAGES = {
    "leaderboard": ROOT / "LEADERBOARD.md",
    "maps": ROOT / "docs" / "maps" / "leaderboard.md",
    "paper-maps": ROOT / "docs" / "paper-maps" / "leaderboard.md",
}


@pytest.fixture(scope="module")
def results():
    def read(name):
        return Results.from_json((ROOT / "docs" / name / "results.json").read_text())

    return {name: read(name) for name in (*PAGES, "library")}


@pytest.mark.parametrize("name", PAGES)
def test_page_follows_from_the_results(results, name):
    folder = ROOT / "docs" / name
    again = f"run {results[name].command}"
    assert PAGES[name].read_text() == markdown(results[name]), again
    assert (folder / "results.json").read_text() == results[name].to_json(), again


def records_of(results, kind):
    return [record for record in results.records if isinstance(record.cell, kind)]


@pytest.mark.parametrize("name", [*PAGES, "library"])
def test_results_have_the_cells_of_their_suite(results, name):
    """The only errors are missed deadlines. Policies that are not installed any more, or not for an
    environment any more, are left out where the suite does not name their environments."""
    stored = results[name]
    suite = find_suite(stored.suite)
    policy_records = records_of(stored, PolicyCell)
    (seed,) = {record.cell.seed for record in policy_records}
    policies = sorted({record.cell.policy for record in policy_records} & policy_entries().keys())
    supported = {policy: policy_entries()[policy].env_ids for policy in policies}
    env_ids = [env_id for env_id in suite.env_ids if env_id not in stored.due]
    policies = [policy for policy in policies if set(supported[policy]) & set(env_ids)]
    cells = suite_cells(suite, find_policies(policies, env_ids), seed=seed, board=stored.board)
    kept = []
    for record in stored.records:
        policy = getattr(record.cell, "policy", None)
        env_id = record.cell.env_id
        is_named = any(env_id in block.env_ids for block in suite.blocks)
        if policy is None or is_named or env_id in supported.get(policy, ()):
            kept.append(record.cell.key)
    assert sorted(kept) == sorted(cells)
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


def test_leaderboard_follows_from_its_commitment(results):
    leaderboard = results["leaderboard"]
    assert leaderboard.suite == "ranked"
    assert leaderboard.board.motions >= 20
    leaderboard.check_board()


@pytest.mark.slow
def test_uncertain_payloads_are_carried_in_fresh_draws(results):
    confirmations = list(
        confirm(results["leaderboard"].records, local(2), cells=2, draws=256, seed=23, say=print)
    )
    surveyed = [confirmation for confirmation in confirmations if confirmation.is_surveyed]
    assert broken(surveyed) == ""
    assert [
        str(confirmation)
        for confirmation in confirmations
        if confirmation not in surveyed and confirmation.success_rate < 0.93
    ] == []


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
    "learned.md",
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
        if path.name in OTHERS or path in PAGES.values() or "/generated/" in name:
            continue
        numbers = re.findall(
            r"\d+(?:\.\d+)? ?(?:kg|%|ms|s|min|minutes?|hours?)(?![\w/·])", prose(path)
        )
        typed = set(numbers) - SETTINGS.get(name, set())
        assert not typed, f"{name} has {typed}: generate these numbers from stored results"
