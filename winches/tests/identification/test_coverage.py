"""Coverage of the intervals of an identification with the imperfections of real logs."""

import pytest
from identification.winch_model import CASES, MOTIONS, ROBOT, TRUTH, winch_log
from scipy import stats

from cablebot_winches.identification import identify
from cablebot_winches.identification.regression import CONFIDENCE

LOADS = (2.0, 6.0)
FEW, MANY = 15, 100
LEAST = 0.90
"""Least coverage over many logs."""


def coverage(motion, case, count):
    """Estimates that rest on no given value, and those whose interval holds the truth, by the
    parameter."""
    determined = dict.fromkeys(TRUTH, 0)
    covered = dict.fromkeys(TRUTH, 0)
    for seed in range(count):
        logs = [winch_log(seed, load, MOTIONS[motion], **CASES[case]) for load in LOADS]
        for item in identify(ROBOT, logs).estimates:
            if item.is_determined and not item.given:
                determined[item.name] += 1
                covered[item.name] += abs(item.value - TRUTH[item.name]) <= item.half_width
    return determined, covered


@pytest.mark.landing
@pytest.mark.parametrize(
    ("case", "motion"),
    [
        ("reversals", "quick"),
        ("encoder", "alike"),
        ("dry friction", "alike"),
        ("filtered speed", "fast"),
    ],
)
def test_intervals_of_imperfect_logs_cover_the_truth(case, motion):
    """Windows of the filter that hold a reversal, the noise of twice differentiated encoder steps,
    friction that is not smooth, and speeds that come late would bias the estimates by several half
    widths."""
    determined, covered = coverage(motion, case, FEW)
    assert min(determined.values()) == FEW
    assert min(covered.values()) >= stats.binom.ppf(0.001, FEW, CONFIDENCE), covered


@pytest.mark.evidence
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("case", CASES)
def test_coverage_of_many_imperfect_logs(motion, case):
    determined, covered = coverage(motion, case, MANY)
    texts = [f"{name} {covered[name]} of {determined[name]}" for name in TRUTH]
    print(f"{case:15} {motion:6} {', '.join(texts)}")
    for name, count in determined.items():
        # The window of the filter of angles is longer than a swing of the quick motion.
        if (case, motion) != ("encoder", "quick"):
            assert count > 0.9 * MANY, name
        assert covered[name] >= LEAST * count, name
