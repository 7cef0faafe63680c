"""The yardstick under uncertainty: its interval and its records."""

from dataclasses import replace

import numpy as np
import pytest
import simulated_boards
from benchmark.made_rows import PLANAR, asked

from cablebot_gym.benchmark.yardstick import FEWEST, drawn_rows, yardstick, yardsticks

CIRCLE = asked("best-known")
LOOP = asked("best-known", motion={"name": "loop-planar", "seed": 7})


@pytest.mark.landing
@pytest.mark.parametrize("family", simulated_boards.RATIOS)
def test_interval_covers_the_quantile_of_any_distribution(family):
    """Quantiles of a normal distribution covered 49 % of skewed ratios."""
    covered, below, above, width = simulated_boards.yardstick_coverage(family, 100, boards=400)
    assert covered > 0.94
    assert max(below, above) < 0.045
    assert width < 0.03


def test_ends_are_order_statistics_and_unverified_draws_count_as_zero_at_the_low_end():
    ratios = np.linspace(0.8, 1.0, 200).tolist()
    complete = yardstick(ratios)
    assert complete.low < complete.quantile < complete.high
    assert complete.low == ratios[3]  # 4 is the 2.5 % quantile of the binomial distribution
    assert complete.high == ratios[16]
    assert complete.quantile == pytest.approx(0.81, abs=1e-3)
    holes = yardstick([None, None, *ratios])
    assert (holes.draws, holes.unverified) == (200, 2)
    assert holes.low == ratios[2]  # rank 5 of 202
    assert (holes.quantile, holes.high) == (complete.quantile, complete.high)
    assert yardstick([0.9] * (FEWEST - 1)).low == 0.0  # too few draws for a lower end
    assert yardstick([0.9] * FEWEST).low == 0.9
    with pytest.raises(ValueError, match="at least one draw"):
        yardstick([None])


def test_rows_are_grouped_by_environment():
    """A motion without a verified nominal payload counts for no policy, and not for the yardstick."""
    rows = drawn_rows([CIRCLE], "hardware", seed=0)[:3]
    spatial = replace(rows[0].conditions, env_id="CableBot-Spatial-v0")
    rows.append(replace(rows[0], conditions=spatial))
    rows += drawn_rows([LOOP], "hardware", seed=0)[:1]
    rows += [CIRCLE, LOOP]
    results = [{"ratio": 0.9}, {"ratio": 0.8}, {"error": "no motion"}, {"ratio": None}]
    results += [{"ratio": 0.1}, {"verified": True}, {"verified": False}]
    answered = [replace(row, result=result) for row, result in zip(rows, results, strict=True)]
    by_environment = yardsticks(answered)
    assert list(by_environment) == [(PLANAR, "hardware")]
    assert by_environment[PLANAR, "hardware"].mean == pytest.approx(0.85)
    assert by_environment[PLANAR, "hardware"].unverified == 1
