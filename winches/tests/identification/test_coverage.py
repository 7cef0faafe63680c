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


def coverage(motion, case, count, **options):
    """Determined estimates, and those whose interval holds the truth, by the parameter."""
    determined = dict.fromkeys(TRUTH, 0)
    covered = dict.fromkeys(TRUTH, 0)
    for seed in range(count):
        logs = [winch_log(seed, load, MOTIONS[motion], **CASES[case], **options) for load in LOADS]
        for item in identify(ROBOT, logs).estimates:
            determined[item.name] += item.is_determined
            error = abs(item.value - TRUTH[item.name])
            covered[item.name] += item.is_determined and error <= item.half_width
    return determined, covered


@pytest.mark.landing
@pytest.mark.parametrize("case", CASES)
def test_intervals_of_imperfect_logs_cover_the_truth(case):
    """Windows of the filter that hold a reversal, the noise of twice differentiated encoder steps,
    friction that is not smooth, and speeds that come late would bias the estimates by several half
    widths."""
    determined, covered = coverage("fast", case, FEW, duration=20.0)
    assert min(determined.values()) == FEW
    assert min(covered.values()) >= stats.binom.ppf(0.001, FEW, CONFIDENCE), covered


@pytest.mark.evidence
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("case", CASES)
def test_coverage_of_many_imperfect_logs(motion, case):
    determined, covered = coverage(motion, case, MANY)
    rates = {name: covered[name] / max(determined[name], 1) for name in TRUTH}
    shown = "  ".join(f"{name} {rate:.2f}" for name, rate in rates.items())
    print(f"{motion:6} {case:15} {shown}")
    assert min(determined.values()) > MANY / 2
    assert min(rates.values()) >= LEAST
