"""Intervals and ranks against simulated boards with known truth, and cases worked out by hand."""

import numpy as np
import pytest
import simulated_boards

from cablebot_gym.benchmark.ranking import better_policies, fraction, ranks
from cablebot_gym.evaluation.statistics import mid_p_interval


@pytest.mark.parametrize("draw", simulated_boards.FAMILIES.values(), ids=simulated_boards.FAMILIES)
def test_interval_covers_the_mean_as_often_as_stated(draw):
    """A percentile bootstrap covered 76 % where a policy fails on a rare motion."""
    covered, below, above = simulated_boards.coverage(draw, motions=100, boards=600)
    assert covered > 0.925
    assert below < 0.045
    assert above < 0.055


@pytest.mark.parametrize("rate", [0.0, 0.05])
def test_equal_policies_are_seldom_ordered(rate):
    """Pairwise intervals ordered equal policies on 59 to 82 % of the boards."""
    false = simulated_boards.false_boards(policies=12, motions=100, rate=rate, boards=300)
    assert false <= 0.05


@pytest.mark.parametrize("family", simulated_boards.CAPACITIES)
def test_further_robot_carries_a_surveyed_payload_as_often_as_promised(family):
    """Three standard errors allow for the number of simulated motions."""
    motions = 40_000
    carried, _, _ = simulated_boards.promise(family, motions)
    assert carried > 0.95 - 3 * np.sqrt(0.95 * 0.05 / motions)


def test_equal_surveys_are_seldom_ordered_where_half_has_fewer_motions():
    assert simulated_boards.false_surveys(failing=0.002, noise=0.05, boards=200) <= 0.06


@pytest.mark.evidence
def test_page_has_the_simulated_tables():
    assert simulated_boards.DOCUMENT.read_text(encoding="utf-8") == simulated_boards.page()


def test_mid_p_interval_of_all_and_of_half_of_the_draws():
    low, high = mid_p_interval(100, 100, 0.95)
    assert low == pytest.approx(0.05 ** (1 / 100))
    assert high == 1.0
    low, high = mid_p_interval(50, 100, 0.95)
    assert low == pytest.approx(1 - high)
    assert low == pytest.approx(0.5 - 1.96 * 0.05, abs=0.005)


def test_motions_that_nobody_carries_leave_a_bounded_interval():
    interval = fraction(np.zeros(100))
    assert interval.low == interval.mean == 0.0
    assert interval.high == pytest.approx(1 - 0.05 ** (1 / 100))


HARD = np.random.default_rng(0).uniform(-0.2, 0.2, 100)
NOISE = np.random.default_rng(1).normal(0, 0.01, (12, 100))


def shifted(level, row):
    return level + HARD + NOISE[row]


CLONES = {f"clone {number}": shifted(0.6, 1) for number in range(5)}


def test_copies_of_a_policy_move_another_by_one_rank():
    """Five clones once moved a policy from rank 5 to rank 10."""
    policies = {"best": shifted(0.7, 0), **CLONES, "last": shifted(0.4, 11)}
    policy_ranks = ranks(policies)
    assert policy_ranks["best"] == 1
    assert {policy_ranks[name] for name in CLONES} == {2}
    assert policy_ranks["last"] == 3


def test_ranks_follow_the_rows():
    """A steady policy can be better than one with a larger, noisier mean is shown to be: the ranks
    were 1, 2, 3, 2."""
    noise = np.random.default_rng(3).uniform(-0.45, 0.45, 100)
    policies = {
        "a little better": np.full(100, 0.601),
        "steady": np.full(100, 0.6),
        "noisy": 0.599 + noise - noise.mean(),
    }
    assert ranks(policies) == {"a little better": 1, "noisy": 1, "steady": 1}
    without_noisy = [policies["a little better"], policies["steady"]]
    assert better_policies(np.stack(without_noisy))[0, 1]


def test_policies_with_a_constant_difference_are_ordered_and_equal_ones_tie():
    levels = [0.5, 0.5, 0.4]
    better = better_policies(np.stack([np.full(20, level) for level in levels]))
    # only the first two are better than the last one
    assert np.argwhere(better).tolist() == [[0, 2], [1, 2]]
