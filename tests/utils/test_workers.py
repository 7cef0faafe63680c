"""Computations in worker processes: results, errors, lost processes and interrupts."""

import multiprocessing
import os
import signal
import sys
from functools import partial
from pathlib import Path

import pytest
from clock import wait_until

from cablebot_gym.utils.workers import WorkerDied, run


def square(number):
    return number**2


def raises(error):
    raise error


class UnpicklableError(Exception):
    def __init__(self, index, message):
        super().__init__(message)


def raises_unpicklable():
    raise UnpicklableError(3, "a lost lane")


def exits():
    sys.exit(0)


def dies():
    os.kill(os.getpid(), signal.SIGKILL)


def waits_for(marker):
    wait_until(Path(marker).exists)
    return True


def started(tasks, *, workers=2):
    return run(tasks, workers=workers)


one_or_two = pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.landing)])
"""Numbers of processes. A second one starts an interpreter."""


@one_or_two
def test_results_belong_to_their_keys(workers):
    tasks = {f"{number} squared": partial(square, number) for number in range(7)}
    assert dict(started(tasks, workers=workers)) == {
        f"{number} squared": number**2 for number in range(7)
    }
    assert dict(started({}, workers=workers)) == {}


@one_or_two
def test_exceptions_are_raised_and_ended_processes_are_results(workers):
    """One that cannot be pickled, too, and ``sys.exit(0)`` of a policy: it ended a benchmark with
    status 0 and no table."""
    tasks = {"bad": partial(raises, EOFError("lost")), "good": partial(square, 2)}
    with pytest.raises(EOFError, match="lost") as caught:
        dict(started(tasks, workers=workers))
    assert workers == 1 or "in raises" in caught.value.__notes__[0]
    unpicklable = {"a": partial(raises_unpicklable), "good": tasks["good"]}
    with pytest.raises(UnpicklableError if workers == 1 else RuntimeError, match="a lost lane"):
        dict(started(unpicklable, workers=workers))
    outcomes = dict(started({"exits": partial(exits), "good": tasks["good"]}, workers=workers))
    assert isinstance(outcomes["exits"], WorkerDied)
    assert str(outcomes["exits"]) == "it raised SystemExit: 0"
    assert outcomes["good"] == 4
    interrupted = {"a": partial(raises, KeyboardInterrupt())}
    with pytest.raises(KeyboardInterrupt):
        dict(started(interrupted, workers=1))


@pytest.mark.landing
def test_computations_beside_a_lost_process_go_on():
    tasks = {str(number): partial(square, number) for number in range(5)}
    outcomes = dict(started({"deadly": partial(dies), **tasks}))
    assert "its process died, with exit status -9" in str(outcomes.pop("deadly"))
    assert outcomes == {str(number): number**2 for number in range(5)}


@pytest.mark.landing
def test_interrupt_ends_all_processes(tmp_path):
    results = started({"quick": partial(square, 1), "slow": partial(waits_for, tmp_path / "never")})
    assert next(results) == ("quick", 1)
    assert len(multiprocessing.active_children()) == 2
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt())
    assert multiprocessing.active_children() == []


@pytest.mark.landing
def test_full_process_is_replaced():
    """Compiled code stays in a process; one of 3 GB once took the memory of the others."""
    tasks = {str(number): partial(os.getpid) for number in range(4)}
    assert len(set(dict(run(tasks, workers=2, memory=0.0)).values())) == 4
    assert len(set(dict(run(tasks, workers=2)).values())) <= 2
