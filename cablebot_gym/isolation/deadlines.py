"""Time that an isolated policy may take: processor time, which does not depend on what else the
machine does."""

from __future__ import annotations

import math
from typing import NamedTuple

from cablebot_gym.utils.checks import number

DEADLINE = 60.0
"""Default deadline of a call of a policy [s of processor time]."""

START_UP = 10
"""Deadline of loading, reset and first call together, in deadlines of a call: plans and compiled
code are made then."""

TOTAL = 60
"""Budget of all calls of an evaluation together, so of a cell of the benchmark, in deadlines of a
call."""

WAITING = 10
"""Largest elapsed time of a call or of the start, in units of the same limit of processor time. It
ends policies that sleep, and is long enough for a busy machine."""

WAITING_FOR_ALL = 2
"""The same of all calls together."""


class Limits(NamedTuple):
    """How long the next answer may take."""

    processor: float
    """Processor time [s]."""
    elapsed: float
    """Elapsed time [s]."""
    processor_words: str
    """The limit of processor time in words."""
    elapsed_words: str
    """The limit of elapsed time in words."""


class _Time:
    """Time of one kind for which a policy has been waited for.

    Args:
        deadline: largest processor time of a call [s].
        call: factor of the limits of a call and of the start.
        everything: factor of the limit of all calls together.
    """

    def __init__(self, deadline: float, *, call: int = 1, everything: int = 1) -> None:
        self._deadline = deadline
        self._call = call
        self._all = everything
        self._total = self._process = 0.0

    def start_process(self) -> None:
        """A fresh process has been started."""
        self._process = 0.0

    def wait(self, seconds: float) -> None:
        """The policy has taken a time [s]."""
        self._total += seconds
        self._process += seconds

    def remaining(self, *, started_up: bool) -> tuple[float, float, str]:
        """Time that the next answer may take [s], its limit [s], and the deadline in words."""
        total = self._all * TOTAL * self._deadline
        limits = [(total - self._total, total, _words(self._all, "all calls together"))]
        if started_up:
            longest = self._call * self._deadline
            limits.append((longest, longest, _words(self._call, "a call")))
        else:
            longest = self._call * START_UP * self._deadline
            calls = _words(self._call, "loading, reset() and the first call")
            limits.append((longest - self._process, longest, calls))
        seconds, limit, words = min(limits)
        return max(seconds, 0.0), limit, words


def _words(factor: int, calls: str) -> str:
    if factor == 1:
        return f"the deadline of {calls}"
    return f"{factor} times the deadline of {calls}"


class Deadlines:
    """Time that a policy has taken, and its limits.

    Args:
        deadline: largest processor time of a call [s]; > 0.

    Raises:
        ValueError: if the deadline is invalid.
    """

    def __init__(self, deadline: float) -> None:
        deadline = number("deadline", deadline, above=0, unit="s")
        self._processor = _Time(deadline)
        self._elapsed = _Time(deadline, call=WAITING, everything=WAITING_FOR_ALL)
        self._started_up = False

    def start_process(self) -> None:
        """A fresh process has been started."""
        self._started_up = False
        for time in (self._processor, self._elapsed):
            time.start_process()

    def finish_start_up(self) -> None:
        """The process has returned actions."""
        self._started_up = True

    def wait(self, elapsed: float, processor: float) -> None:
        """The policy has been waited for [s], and has taken processor time [s]."""
        self._elapsed.wait(elapsed)
        self._processor.wait(processor)

    def remaining(self) -> Limits:
        """Time that the next answer may take."""
        processor, allowed, calls = self._processor.remaining(started_up=self._started_up)
        elapsed, longest, waiting = self._elapsed.remaining(started_up=self._started_up)
        return Limits(
            processor=processor,
            elapsed=elapsed,
            processor_words=f"{allowed:g} s of processor time, {calls}",
            elapsed_words=f"{longest:g} s, {waiting}",
        )


class ProcessorTime:
    """Processor time of a process and of all that it has started, sampled now and then.

    A sample costs milliseconds, because it reads all processes of the machine; calls of a policy
    can be shorter.
    """

    def __init__(self) -> None:
        self._last_sample = -math.inf
        self._used = self._reported = 0.0

    def is_due(self, now: float, period: float) -> bool:
        """Whether the last sample is older than a period [s]."""
        return now - self._last_sample >= period

    def sample(self, now: float, used: float) -> None:
        """A sample at a time [s]: all processes have used a processor time [s].

        It can fall when a process ends for which no other one waits; what it used stays counted.
        """
        self._last_sample = now
        self._used = max(self._used, used)

    @property
    def unreported(self) -> float:
        """Processor time since the last :meth:`report` [s]."""
        return self._used - self._reported

    def report(self) -> float:
        """Processor time since the last report [s]."""
        seconds = self.unreported
        self._reported = self._used
        return seconds
