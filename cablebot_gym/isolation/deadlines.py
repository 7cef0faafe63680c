"""Time that an isolated policy may take."""

from __future__ import annotations

from cablebot_gym.utils.checks import number

DEADLINE = 60.0
"""Default deadline of a call of a policy [s]."""

START_UP = 10
"""Deadline of loading, reset and first call together, in deadlines of a call: plans and compiled
code are made then."""

TOTAL = 240
"""Deadline of all calls together, in deadlines of a call."""


class Deadlines:
    """Wall-clock time for which a policy has been waited for, and its limits.

    Args:
        deadline: largest time of a call [s]; > 0.

    Raises:
        ValueError: if the deadline is invalid.
    """

    def __init__(self, deadline: float) -> None:
        self._deadline = number("deadline", deadline, above=0, unit="s")
        self._total = self._process = 0.0
        self._started_up = False

    def start_process(self) -> None:
        """A fresh process has been started."""
        self._process, self._started_up = 0.0, False

    def finish_start_up(self) -> None:
        """The process has returned actions."""
        self._started_up = True

    def wait(self, seconds: float) -> None:
        """The policy has been waited for [s]."""
        self._total += seconds
        self._process += seconds

    def remaining(self) -> tuple[float, str]:
        """Time that the next answer may take [s], and the limit behind it in words."""
        total = TOTAL * self._deadline
        start_up = START_UP * self._deadline
        limits = [(total - self._total, total, "all calls together")]
        if self._started_up:
            limits.append((self._deadline, self._deadline, "a call"))
        else:
            limits.append(
                (start_up - self._process, start_up, "loading, reset() and the first call")
            )
        seconds, limit, calls = min(limits)
        return max(seconds, 0.0), f"{limit:g} s, the deadline of {calls}"
