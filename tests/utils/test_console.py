"""Progress in a log."""

import pytest

from cablebot_gym.utils.console import progress_line


@pytest.mark.parametrize(
    ("before", "done", "expected", "unit", "line"),
    [
        (0, 0, 4, "rows", "computing: 0 of 4 rows, 0:01:40 elapsed"),
        (0, 1, 4, "rows", "computing: 1 of 4 rows, 0:01:40 elapsed, 0:04:30 left"),
        (0, 0.9, 1.0, "%", "computing: 90%, 0:01:40 elapsed, 0:00:10 left"),
        (
            4500,
            5000,
            6000,
            "steps",
            "computing: 5,000 of 6,000 steps, 0:01:40 elapsed, 0:03:00 left",
        ),
    ],
)
def test_line_of_a_log_has_the_time_left_at_the_pace_of_what_was_done_since_the_first_report(
    before, done, expected, unit, line
):
    pace = {"before": before, "working": 90.0}
    assert progress_line(done, expected, "computing", unit=unit, elapsed=100.0, **pace) == line
