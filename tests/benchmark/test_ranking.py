"""Intervals and ranks against simulated boards with known truth, and cases worked out by hand."""

import numpy as np
import pytest
import simulated_boards

from cablebot_gym.benchmark.ranking import better_policies, ranks
from cablebot_gym.evaluation.statistics import mid_p_interval


@pytest.mark.parametrize("draw", simulated_boards.FAMILIES.values(), ids=simulated_boards.FAMILIES)
def test_interval_covers_the_mean_as_often_as_stated(draw):
    """A percentile bootstrap covered 76 % where a policy fails on a rare motion."""
    covered, below, above = simulated_boards.coverage(draw, motions=100, boards=600)
    assert covered > 0.925
    assert below < 0.045
    assert above < 0.055


@pytest.mark.parametrize(("rate", "fewer"), [(0.0, False), (0.05, False), (0.002, True)])
def test_equal_policies_are_seldom_ordered(rate, fewer):
    """Pairwise intervals ordered equal policies on 59 to 82 % of the boards."""
    false = simulated_boards.false_boards(12, motions=100, rate=rate, boards=600, fewer=fewer)
    assert false <= 0.05


def test_mid_p_interval_of_all_and_of_half_of_the_draws():
    low, high = mid_p_interval(100, 100, 0.95)
    assert low == pytest.approx(0.05 ** (1 / 100))
    assert high == 1.0
    low, high = mid_p_interval(50, 100, 0.95)
    assert low == pytest.approx(1 - high)
    assert low == pytest.approx(0.5 - 1.96 * 0.05, abs=0.005)


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
