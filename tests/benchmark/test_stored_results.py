"""Results in docs: the rows are those of the suite, and samples still hold."""

import random
from pathlib import Path

import pytest

from cablebot_gym.benchmark.check import compare_rows, recompute
from cablebot_gym.benchmark.engine import local
from cablebot_gym.benchmark.scores import leaderboards
from cablebot_gym.benchmark.store import read
from cablebot_gym.report.page import merged_rows

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def results():
    return read(ROOT / "docs" / "results" / "ranked.jsonl")


@pytest.mark.landing
def test_results_have_the_rows_of_their_suite(results):
    """Motions and seeds follow from the seed text, which was fixed before."""
    text = (ROOT / "docs" / "results" / "seed.txt").read_text(encoding="utf-8")
    assert results.seed_text == text.strip()
    difference = compare_rows(results)
    assert difference.missing == difference.unexpected == difference.not_installed == ()
    assert [row.error for row in results.rows if row.error is not None] == []


def test_report_has_the_fractions_of_the_leaderboard(results):
    """Robots of a yardstick differ in their seed alone."""

    def fractions(rows):
        return [
            (board.env_id, policy, board.fraction(policy, column))
            for board in leaderboards(rows)
            for policy, column in board.entries
        ]

    assert fractions(merged_rows([results])) == fractions(results.rows)


@pytest.mark.landing
def test_two_rows_are_reproduced(results):
    """Other ones after each change of the results; rows that are due have another code."""
    chooser = random.Random(results.to_text())
    present = [row for row in results.rows if not row.is_due]
    for again in recompute(present, 2, local(1), chooser):
        assert again.is_equal, str(again)
