"""The yardstick under uncertainty: its interval and its records."""

from dataclasses import replace

import numpy as np
import pytest
from benchmark.made_rows import CIRCLE, PLANAR, drawn, optimum

from cablebot_gym.benchmark.yardstick import FEWEST, drawn_rows, yardstick, yardsticks
from cablebot_gym.evaluation.batch import draw_seeds
from cablebot_gym.evaluation.survey import motion_seeds

LOOP = {"name": "loop-planar", "seed": 7}


def test_ends_are_order_statistics_and_missing_draws_count_as_zero_at_the_low_end():
    ratios = np.linspace(0.8, 1.0, 200).tolist()
    complete = yardstick(ratios)
    assert complete.low < complete.quantile < complete.high
    assert complete.low == ratios[3]  # 4 is the 2.5 % quantile of the binomial distribution
    assert complete.high == ratios[16]
    assert complete.quantile == pytest.approx(0.81, abs=1e-3)
    holes = yardstick([None, None, *ratios])
    assert (holes.draws, holes.missing) == (200, 2)
    assert holes.low == ratios[2]  # rank 5 of 202
    assert (holes.quantile, holes.high) == (complete.quantile, complete.high)
    assert yardstick([0.9] * (FEWEST - 1)).low == 0.0  # too few draws for a lower end
    assert yardstick([0.9] * FEWEST).low == 0.9
    with pytest.raises(ValueError, match="at least one draw"):
        yardstick([None])


def test_robots_are_the_first_that_policies_meet():
    rows = drawn_rows([optimum(2.0)], "hardware", seed=5)
    (motion_seed,) = motion_seeds(5, 1)
    assert [row.conditions.seed for row in rows] == draw_seeds(motion_seed, FEWEST)


def test_rows_are_grouped_by_environment():
    """A motion without an optimum counts for no policy, and not for the yardstick."""
    rows = [
        drawn(CIRCLE, 0.9),
        drawn(CIRCLE, 0.8),
        replace(drawn(CIRCLE, 0.0), result={"error": "no motion"}),
        drawn(CIRCLE, None, env_id="CableBot-Spatial-v0"),
        drawn(LOOP, 0.1),
        optimum(2.0),
        optimum(None, LOOP),
    ]
    by_environment = yardsticks(rows)
    assert list(by_environment) == [(PLANAR, "hardware")]
    assert by_environment[PLANAR, "hardware"].mean == pytest.approx(0.85)
    assert by_environment[PLANAR, "hardware"].missing == 1
