"""Processor time of the fast tests: one costs at most LIMIT seconds, all together at most TOTAL.

Time that is spent once for several tests is no test's: imports, compilation, Python in place of
compiled code, shared fixtures and the collection of garbage. Processes that a test starts and waits for are part of it.
"""

import builtins
import gc
import os
import threading
import time
from contextlib import contextmanager
from functools import wraps

import pytest
from numba.core.dispatcher import Dispatcher

from cablebot_gym.physics.compiling.python_first import EntryPoint

LIMIT = 0.45
TOTAL = 300.0
MARGIN = 3.0
"""Multiple of the limit from which on a test fails the run. It is named from the limit on: the time
of a test that starts processes doubles where other work shares caches with it."""

PROBE = 0.004
"""Processor time of :func:`probe` on the machine of these limits [s]. Another machine may be
slower, and so is this one while its cores have other work."""

NAME = "processor time"


def spent():
    """Processor time of this process and of the ended processes that it started [s]."""
    children = os.times()
    return time.process_time() + children.children_user + children.children_system


def probe():
    """Processor time of a computation that is always the same [s]."""
    start = time.process_time()
    total = 0
    for number in range(200_000):
        total += number
    return time.process_time() - start


def is_busy():
    """Whether the cores had more work in the last minute than two processes of tests: caches and
    cores that they share make a test slower than the probe says."""
    return hasattr(os, "getloadavg") and os.getloadavg()[0] > max(2, os.cpu_count()) + 1


class Stopwatch:
    """Processor time of the tests of one process, without what is done once for several tests."""

    def __init__(self):
        self.once = 0.0
        self._depth = 0
        self._since = 0.0
        self._start = 0.0

    def measure_shared_work(self):
        """Measures it from now on. Compiled code may also be read from a file. Python computes only
        until compilation pays. A collection of garbage comes at any time, for all tests before."""
        builtins.__import__ = self._counted(builtins.__import__)
        Dispatcher.compile = self._counted(Dispatcher.compile)
        EntryPoint.in_python = self._counted(EntryPoint.in_python)
        gc.callbacks.append(self._on_collection)

    def _counted(self, function):
        @wraps(function)
        def counted(*arguments, **keywords):
            with self.counted_once():
                return function(*arguments, **keywords)

        return counted

    def _on_collection(self, phase, _):
        if phase == "start":
            self._begin()
        else:
            self._end()

    @contextmanager
    def counted_once(self):
        """The block is done once for several tests."""
        self._begin()
        try:
            yield
        finally:
            self._end()

    def _begin(self):
        if threading.current_thread() is threading.main_thread():
            if self._depth == 0:
                self._since = spent()
            self._depth += 1

    def _end(self):
        if threading.current_thread() is threading.main_thread():
            self._depth -= 1
            if self._depth == 0:
                self.once += spent() - self._since

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef):
        """A shared fixture is no single test's."""
        if fixturedef.scope == "function":
            return (yield)
        with self.counted_once():
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        """A test begins."""
        self._start = spent() - self.once
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        """The last report of a test has its time, as on the machine of the limits."""
        if call.when == "teardown":
            seconds = spent() - self.once - self._start
            if seconds > LIMIT:
                seconds /= max(1.0, probe() / PROBE)
            item.user_properties.append((NAME, seconds))
        return (yield)


class Judge:
    """Fails a run of fast tests that costs too much."""

    def __init__(self):
        self.times = {}

    def pytest_runtest_logreport(self, report):
        """Notes the time of a test, also of one in another process."""
        if report.when == "teardown":
            self.times[report.nodeid] = dict(report.user_properties)[NAME]

    def verdicts(self):
        """What costs too much, in words."""
        for name, seconds in sorted(self.times.items(), key=lambda item: -item[1]):
            if seconds > LIMIT:
                yield f"{seconds:.2f} s of processor time, at most {LIMIT} s: {name}"
        total = sum(self.times.values())
        if total > TOTAL:
            yield f"{total:.0f} s of processor time all together, at most {TOTAL:.0f} s"

    def pytest_sessionfinish(self, session):
        """The run fails, unless other work makes all of it slower."""
        slow = [name for name, seconds in self.times.items() if seconds > MARGIN * LIMIT]
        is_slow = bool(slow) or sum(self.times.values()) > TOTAL
        if session.exitstatus == 0 and is_slow and not is_busy():
            session.exitstatus = 1

    def pytest_terminal_summary(self, terminalreporter):
        """Says what costs too much, and what all together cost."""
        for verdict in self.verdicts():
            terminalreporter.write_line(verdict, red=True)
        if self.times:
            total = sum(self.times.values())
            terminalreporter.write_line(f"{len(self.times)} tests, {total:.0f} s of processor time")


def install(config):
    """Measures the tests of this process, and judges the run where it is the one of the fast
    tests."""
    stopwatch = Stopwatch()
    stopwatch.measure_shared_work()
    config.pluginmanager.register(stopwatch)
    if "not landing" in config.option.markexpr and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Judge())
