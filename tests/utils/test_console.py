"""Progress in a log."""

import pytest

from cablebot_gym.utils.console import progress_line


@pytest.mark.parametrize(
    ("done", "expected", "unit", "pace", "line"),
    [
        (0, 4, "rows", 0.0, "computing: 0 of 4 rows, 0:01:30 elapsed"),
        (1, 4, "rows", 0.1, "computing: 1 of 4 rows, 0:01:30 elapsed, 0:00:30 left"),
        (
            4500,
            6000,
            "steps",
            50.0,
            "computing: 4,500 of 6,000 steps, 0:01:30 elapsed, 0:00:30 left",
        ),
        (0.9, 1.0, "%", 0.01, "computing: 90%, 0:01:30 elapsed, 0:00:10 left"),
    ],
)
def test_line_of_a_log_has_the_time_left_at_the_present_pace(done, expected, unit, pace, line):
    given = {"unit": unit, "elapsed": 90.0, "pace": pace}
    assert progress_line(done, expected, "computing", **given) == line
