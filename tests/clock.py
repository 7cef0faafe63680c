"""Time in tests: a clock that a test sets, and the only place that waits for another process or
thread.

Waiting ends as soon as its condition holds, so only a test that hangs sees how long the guard is.
"""

from time import monotonic, sleep

HANG = 300.0
"""Time after which a test counts as hanging [s], whatever else the machine does."""


class Clock:
    """Stands for the module ``time`` in a module under test: no time passes but what a test says
    [s]."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now

    perf_counter = monotonic

    def sleep(self, seconds):
        self.now += seconds


def wait_until(condition):
    """Returns when the condition holds; fails after :data:`HANG`."""
    end = monotonic() + HANG
    while not condition():
        assert monotonic() < end, f"the condition did not hold within {HANG:g} s"
        sleep(0.02)
