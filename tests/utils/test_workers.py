"""Computations in worker processes: results, errors, lost processes and interrupts."""

import logging
import multiprocessing
import os
import signal
import sys
from functools import partial
from pathlib import Path

import pytest
from clock import wait_until

from cablebot_gym.policies.protocol import BatchItemError
from cablebot_gym.utils import workers
from cablebot_gym.utils.workers import WorkerDied, run


def square(number):
    logging.getLogger("cablebot_gym").warning("compiling %s", "once")
    return number**2


def raises(error):
    raise error


def raises_unpicklable():
    raise BatchItemError(3, "a lost lane")


def exits():
    sys.exit(0)


def dies(marker=None):
    if marker is None or not Path(marker).exists():
        if marker is not None:
            Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def waits_for(marker):
    wait_until(Path(marker).exists)
    return True


def started(tasks, *, workers=2, say=print, **keywords):
    return run(tasks, workers=workers, say=say, **keywords)


one_or_two = pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.landing)])
"""Numbers of processes. A second one starts an interpreter."""


@one_or_two
def test_results_belong_to_their_keys_and_messages_appear_once(workers):
    messages = []
    tasks = {f"{number} squared": partial(square, number) for number in range(7)}
    assert dict(started(tasks, workers=workers, say=messages.append)) == {
        f"{number} squared": number**2 for number in range(7)
    }
    assert messages == (["compiling once"] if workers > 1 else [])
    assert dict(started({}, workers=workers)) == {}


@pytest.mark.landing
@pytest.mark.skipif(sys.platform == "win32", reason="the system does not say the largest memory")
def test_process_with_much_memory_is_replaced_after_its_computation(monkeypatch):
    tasks = {str(number): partial(os.getpid) for number in range(4)}
    monkeypatch.setattr(workers, "LARGEST_MEMORY", 1)
    assert len(set(dict(started(tasks)).values())) == 4


@one_or_two
def test_exceptions_are_raised_or_returned(workers):
    """One that cannot be pickled, too, and ``sys.exit(0)`` of a policy: it ended a benchmark with
    status 0 and no table."""
    tasks = {"bad": partial(raises, EOFError("lost")), "good": partial(square, 2)}
    with pytest.raises(EOFError, match="lost") as caught:
        dict(started(tasks, workers=workers))
    assert workers == 1 or "in raises" in caught.value.__notes__[0]
    tasks |= {"exits": partial(exits), "unpicklable": partial(raises_unpicklable)}
    outcomes = dict(started(tasks, workers=workers, returned=(Exception,)))
    assert isinstance(outcomes["bad"], EOFError)
    assert isinstance(outcomes["exits"], WorkerDied)
    assert str(outcomes["exits"]) == "it raised SystemExit: 0"
    assert "a lost lane" in str(outcomes["unpicklable"])
    assert outcomes["good"] == 4
    interrupted = {"a": partial(raises, KeyboardInterrupt())}
    with pytest.raises(KeyboardInterrupt):
        dict(started(interrupted, workers=1, returned=(Exception,)))


@pytest.mark.landing
def test_computation_of_a_lost_process_is_repeated_once(tmp_path):
    tasks = {str(number): partial(square, number) for number in range(5)}
    tasks |= {"killed": partial(dies, tmp_path / "marker"), "deadly": partial(dies)}
    outcomes = dict(started(tasks, returned=(WorkerDied,)))
    assert "died 2 times" in str(outcomes["deadly"])
    assert "-9" in str(outcomes.pop("deadly"))
    assert outcomes == {"killed": "alive", **{str(number): number**2 for number in range(5)}}


@pytest.mark.landing
def test_interrupt_ends_all_processes(tmp_path):
    results = started({"quick": partial(square, 1), "slow": partial(waits_for, tmp_path / "never")})
    assert next(results) == ("quick", 1)
    assert len(multiprocessing.active_children()) == 2
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt())
    assert multiprocessing.active_children() == []
