"""The judge of the processor time of fast tests."""

from types import SimpleNamespace

import pytest
from processor_time import LIMIT, NAME, TOTAL, Judge, Stopwatch


def session_of(*times):
    """A run of tests with these times [s], after its end."""
    judge = Judge()
    for number, seconds in enumerate(times):
        judge.pytest_runtest_logreport(
            SimpleNamespace(
                when="teardown", nodeid=f"test_{number}", user_properties=[(NAME, seconds)]
            )
        )
    session = SimpleNamespace(exitstatus=0)
    judge.pytest_sessionfinish(session)
    return session.exitstatus, list(judge.verdicts())


@pytest.mark.parametrize(
    ("times", "load", "status", "words"),
    [
        ((1.2 * LIMIT, 0.1), 0.0, 0, ["test_0"]),
        ((0.1, 4 * LIMIT), 0.0, 1, ["test_1"]),
        ((0.1, 4 * LIMIT), 1e3, 0, ["test_1"]),
        ((LIMIT,) * int(TOTAL / LIMIT + 1), 0.0, 1, ["all together"]),
    ],
    ids=[
        "above one",
        "one slow test",
        "busy machine",
        "many fast tests",
    ],
)
def test_run_fails_where_a_test_or_all_together_cost_too_much(
    times, load, status, words, monkeypatch
):
    monkeypatch.setattr("os.getloadavg", lambda: (load,) * 3, raising=False)
    ended, verdicts = session_of(*times)
    assert ended == status
    assert len(verdicts) == len(words)
    assert all(word in verdict for word, verdict in zip(words, verdicts, strict=True))


def test_nested_parts_done_once_are_counted_once():
    stopwatch = Stopwatch(clock=iter([10.0, 13.0]).__next__)
    with stopwatch.counted_once(), stopwatch.counted_once():
        pass
    assert stopwatch.once == pytest.approx(3.0)
