"""The judge of the processor time of fast tests."""

from types import SimpleNamespace

import pytest
from processor_time import LIMIT, NAME, TOTAL, Judge, Stopwatch


def session_of(*times, passes=True):
    """A run of tests with these times [s], after its end."""
    judge = Judge()
    for number, seconds in enumerate(times):
        judge.pytest_runtest_logreport(
            SimpleNamespace(
                when="teardown", nodeid=f"test_{number}", user_properties=[(NAME, seconds)]
            )
        )
    session = SimpleNamespace(exitstatus=0 if passes else 2)
    judge.pytest_sessionfinish(session)
    return session.exitstatus, list(judge.verdicts())


def test_run_within_the_limits_passes():
    assert session_of(LIMIT, 0.1) == (0, [])


def test_slow_test_fails_the_run_and_is_named():
    status, verdicts = session_of(0.1, 2 * LIMIT)
    assert status == 1
    assert [text.endswith("test_1") for text in verdicts] == [True]


def test_many_fast_tests_fail_the_run():
    status, verdicts = session_of(*[LIMIT] * (int(TOTAL / LIMIT) + 1))
    assert status == 1
    assert "all together" in verdicts[0]


def test_status_of_a_failed_run_stays():
    assert session_of(2 * LIMIT, passes=False)[0] == 2


def test_nested_parts_done_once_are_counted_once(monkeypatch):
    clock = iter([10.0, 13.0])
    monkeypatch.setattr("processor_time.spent", lambda: next(clock))
    stopwatch = Stopwatch()
    with stopwatch.counted_once(), stopwatch.counted_once():
        pass
    assert stopwatch.once == pytest.approx(3.0)
