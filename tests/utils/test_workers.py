"""Computations in processes: what comes back, what is tried again, and what is left behind."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from cablebot_gym.policies.protocol import BatchItemError
from cablebot_gym.utils.workers import WorkerDied, check_workers, cores, run


def square(number, env_id=None):
    return number**2


def says(number):
    logging.getLogger("cablebot_gym").warning("compiling %s", "once")
    return number


def raises(error):
    raise error


def raises_what_cannot_be_unpickled():
    raise BatchItemError(3, "a lost lane")


def returns_a_lambda():
    return lambda: None


def dies(marker=None):
    if marker is None or not Path(marker).exists():
        if marker is not None:
            Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def touches(marker):
    Path(marker).touch()


def waits_for(marker):
    deadline = time.monotonic() + 30
    while not Path(marker).exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    return Path(marker).exists()


def done(tasks, *, workers=2, say=print, **keywords):
    return dict(run(tasks, workers=workers, kind=lambda task: task.func, say=say, **keywords))


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_no_computation_is_left_out_or_mistaken_for_another(workers):
    tasks = {f"{number} squared": partial(square, number) for number in range(7)}
    assert done(tasks, workers=workers) == {f"{number} squared": number**2 for number in range(7)}
    assert done({}, workers=workers) == {}


def test_message_of_two_workers_is_not_said_twice():
    said = []
    done({str(number): partial(says, number) for number in range(4)}, say=said.append)
    assert said == ["compiling once"]


@pytest.mark.parametrize("workers", [1, 2])
def test_error_is_not_taken_for_a_result_unless_it_is_asked_for(workers):
    tasks = {"bad": partial(raises, KeyError("lost")), "good": partial(square, 2)}
    with pytest.raises(KeyError, match="lost"):
        done(tasks, workers=workers)
    found = done(tasks, workers=workers, returned=(KeyError,))
    assert isinstance(found["bad"], KeyError)
    assert found["good"] == 4


def test_error_of_a_worker_does_not_lack_its_traceback():
    with pytest.raises(KeyError) as caught:
        done({"bad": partial(raises, KeyError("lost"))})
    assert "in raises" in caught.value.__notes__[0]


@pytest.mark.parametrize("function", [raises_what_cannot_be_unpickled, returns_a_lambda])
def test_what_cannot_be_sent_does_not_hang(function):
    with pytest.raises(Exception, match=r"a lost lane|lambda"):
        list(run({"a": partial(function), "b": partial(function)}, workers=2, kind=id, say=print))


def test_end_of_a_file_in_a_computation_is_not_taken_for_the_end_of_the_worker():
    found = done({"bad": partial(raises, EOFError("short")), "good": partial(square, 3)}, returned=(EOFError,))
    assert str(found["bad"]) == "short"
    assert found["good"] == 9


def test_computation_is_not_lost_with_its_process(tmp_path):
    tasks = {str(number): partial(square, number) for number in range(5)}
    found = done({"killed": partial(dies, tmp_path / "marker"), **tasks})
    assert found == {"killed": "alive", **{str(number): number**2 for number in range(5)}}


def test_computation_that_kills_every_process_is_not_tried_for_ever_and_does_not_stop_the_others():
    tasks = {str(number): partial(square, number) for number in range(5)}
    found = done({"deadly": partial(dies), **tasks}, returned=(WorkerDied,))
    assert "died 2 times" in str(found.pop("deadly"))
    assert "-9" in str(done({"deadly": partial(dies)}, returned=(WorkerDied,))["deadly"])
    assert found == {str(number): number**2 for number in range(5)}
    with pytest.raises(WorkerDied):
        done({"deadly": partial(dies), **tasks})


def test_no_worker_is_idle_while_a_result_is_looked_at(tmp_path):
    tasks = {"first": partial(square, 1), "second": partial(waits_for, tmp_path / "go")}
    tasks["third"] = partial(touches, tmp_path / "third")
    results = run(tasks, workers=2, kind=lambda task: task, say=print)
    assert next(results)[0] == "first"
    assert waits_for(tmp_path / "third")
    (tmp_path / "go").touch()
    assert dict(results)["second"]


def test_no_process_is_left_behind_by_an_interrupt(tmp_path):
    results = run(
        {"quick": partial(square, 1), "slow": partial(waits_for, tmp_path / "never")},
        workers=2,
        kind=lambda task: task.func,
        say=print,
    )
    assert next(results) == ("quick", 1)
    assert len(multiprocessing.active_children()) == 2
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt())
    assert multiprocessing.active_children() == []


def test_interrupt_does_not_cut_the_start_of_a_process_off_when_another_thread_gets_it(monkeypatch):
    """Whatever thread gets it, Python raises it in the main one: between a process and what it is told to do."""
    go, gone, started = threading.Event(), threading.Event(), []

    def interrupt():
        go.wait()
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        gone.set()

    thread = threading.Thread(target=interrupt)  # begun before any interrupt is held: threads inherit what is blocked
    thread.start()
    start = multiprocessing.context.SpawnProcess.start

    def slow_start(process):
        go.set()
        gone.wait()
        start(process)
        started.append(process)

    monkeypatch.setattr(multiprocessing.context.SpawnProcess, "start", slow_start)
    with pytest.raises(KeyboardInterrupt):
        done({"a": partial(square, 1), "b": partial(square, 2)})
    thread.join()
    assert len(started) == 1
    assert multiprocessing.active_children() == []


def test_number_of_workers_that_is_none_is_refused():
    assert check_workers(None) == cores() >= 1
    assert check_workers(3) == 3
    with pytest.raises(ValueError, match="workers must be at least 1, not 0"):
        check_workers(0)
