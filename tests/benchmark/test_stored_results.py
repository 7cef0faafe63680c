"""Results in docs: the cells are those of the suites, and samples still hold."""

from pathlib import Path

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, SurveyCell
from cablebot_gym.benchmark.check import compare_rows
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.records import compute
from cablebot_gym.benchmark.scores import RANKED_MOTIONS, leaderboards
from cablebot_gym.benchmark.seeds import evaluation_seed, hidden_seeds
from cablebot_gym.policies import policy_entries
from cablebot_gym.report.page import merge_records

ROOT = Path(__file__).parents[2]
MAIN_ONLY = {"adaptive", "nmpc", "observing", "trajopt"}
"""Policies that have changed since the board, and are on its main table only."""

COMPUTED_AGAIN = {"composite", "fl", "motor-pd", "ppo-circle", "robust"}
"""Other policies with rows that were computed after the board."""


@pytest.fixture(scope="module")
def results():
    def read(name):
        return Results.from_json((ROOT / "docs" / name / "results.json").read_text())

    return {name: read(name) for name in ("leaderboard", "library")}


def test_rows_of_the_leaderboard_are_of_today_or_of_its_board(results):
    """Excludes a row of a policy that has changed since: it would stand beside those of today."""
    origins = {"of board 2026-2": set(), "after board 2026-2, on its first 20 motions": set()}
    for record in records_of(results["leaderboard"], PolicyCell):
        origins[record.versions["rows"]].add(record.cell.policy)
    board, later = origins.values()
    assert later == MAIN_ONLY | COMPUTED_AGAIN
    assert board & MAIN_ONLY == set()
    assert board | later <= policy_entries().keys()


def records_of(results, kind):
    return [record for record in results.records if isinstance(record.cell, kind)]


@pytest.mark.landing
@pytest.mark.parametrize("name", ["leaderboard", "library"])
def test_results_have_the_cells_of_their_suite(results, name):
    """The only errors are missed deadlines."""
    stored = results[name]
    rows = compare_rows(stored)
    assert [cell.stem for cell in rows.missing if cell.policy not in MAIN_ONLY] == []
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


def test_leaderboards_leave_out_real_robots(results):
    """Cells of one environment id and motion once were motions of one robot."""
    records = results["library"].records
    assert leaderboards(records) == []


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


@pytest.mark.evidence
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


@pytest.mark.evidence
def test_best_known_payload_is_reproduced(results):
    for record in records_of(results["leaderboard"], BestKnownCell):
        cell = record.cell
        if cell.env_id == "CableBot-Planar-v0" and cell.trajectory["name"] == "circle-planar":
            break
    assert compute(cell).result["payload"] == pytest.approx(record.result["payload"], rel=2e-3)
