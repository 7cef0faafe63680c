"""Results in docs: the rows are those of the suites, and samples still hold."""

from pathlib import Path

import pytest

from cablebot_gym.benchmark.check import compare_rows
from cablebot_gym.benchmark.rows import compute
from cablebot_gym.benchmark.scores import leaderboards
from cablebot_gym.benchmark.store import read
from cablebot_gym.policies import policy_entries
from cablebot_gym.report.page import merged_rows

RESULTS = Path(__file__).parents[2] / "docs" / "results"
MAIN_ONLY = {"adaptive", "nmpc", "observing", "trajopt"}
"""Policies that have changed since the board, and are on its main table only."""

COMPUTED_AGAIN = {"composite", "fl", "motor-pd", "robust"}
"""Other policies with rows that were computed after the board."""


@pytest.fixture(scope="module")
def results():
    return {name: read(RESULTS / f"{name}.jsonl") for name in ("ranked", "library")}


def rows_of(results, measure):
    return [row for row in results.rows if row.measure == measure]


def test_rows_of_the_leaderboard_are_of_today_or_of_its_board(results):
    """Excludes a row of a policy that has changed since: it would stand beside those of today."""
    origins = {"of board 2026-2": set(), "after board 2026-2, on its first 20 motions": set()}
    for row in rows_of(results["ranked"], "payload"):
        origins[row.versions["rows"]].add(row.policy)
    board, later = origins.values()
    assert later == MAIN_ONLY | COMPUTED_AGAIN
    assert board & MAIN_ONLY == set()
    assert board | later <= policy_entries().keys()


@pytest.mark.landing
@pytest.mark.parametrize("name", ["ranked", "library"])
def test_results_have_the_rows_of_their_suite(results, name):
    """Motions and seeds follow from the seed text. The only errors are missed deadlines."""
    stored = results[name]
    difference = compare_rows(stored)
    assert [row for row in difference.missing if row.policy not in MAIN_ONLY] == []
    assert difference.unexpected == difference.not_installed == ()
    for row in stored.rows:
        assert row.error is None or "did not answer within" in row.error
    for row in rows_of(stored, "best-known"):
        assert row.result["verified"]


def test_report_has_the_fractions_of_the_leaderboard(results):
    """Robots of a yardstick differ in their seed alone."""
    stored = results["ranked"]

    def fractions(rows):
        return [
            (board.env_id, policy, board.fraction(policy, column))
            for board in leaderboards(rows)
            for policy, column in board.entries
        ]

    assert fractions(merged_rows([stored])) == fractions(stored.rows)


def test_leaderboards_leave_out_real_robots(results):
    """Rows of one environment id and motion once were motions of one robot."""
    assert leaderboards(results["library"].rows) == []


@pytest.mark.evidence
@pytest.mark.parametrize("index", range(10))
def test_cheapest_payloads_of_the_leaderboard_are_reproduced(results, index):
    carried = [row for row in rows_of(results["ranked"], "payload") if row.result.get("payload")]
    carried.sort(key=lambda row: row.seconds)
    stored = carried[index]
    (computed,) = compute([stored])
    tolerance = stored.result["resolution"]
    assert computed.result["payload"] == pytest.approx(stored.result["payload"], abs=tolerance)


@pytest.mark.evidence
def test_best_known_payload_is_reproduced(results):
    for row in rows_of(results["ranked"], "best-known"):
        if row.motion == "circle-planar" and row.conditions.env_id == "CableBot-Planar-v0":
            break
    (computed,) = compute([row])
    assert computed.result["payload"] == pytest.approx(row.result["payload"], rel=2e-3)
