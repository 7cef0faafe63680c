"""Many computations in processes of their own: each runs once, what they log is said once, and none is left behind."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar, cast

Task = TypeVar("Task", bound=Callable[[], Any])
"""A computation. For workers, a function of a module, or a :func:`functools.partial` of one, that can be pickled."""

ATTEMPTS = 2
"""How often a computation may take its worker with it before it counts as failed."""


class WorkerDied(RuntimeError):
    """The process of a computation ended without a result, as when it crashes or the memory is not enough."""


def cores() -> int:
    """How many of this machine's cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_workers(workers: int | None) -> int:
    """``workers``, a number of processes that was asked for; None stands for one per core.

    Raises:
        ValueError: if it is not positive.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers}")
    return workers or cores()


def run(
    tasks: Mapping[str, Task],
    *,
    workers: int,
    kind: Callable[[Task], Hashable],
    say: Callable[[str], None],
    returned: tuple[type[Exception], ...] = (),
) -> Iterator[tuple[str, Any]]:
    """Results by key, as they come. Closing the iterator, or an interrupt, ends the processes.

    A computation whose process dies is tried again in a fresh one, :data:`ATTEMPTS` times in all.

    Args:
        tasks: by key; one after the other in this process if ``workers`` is 1.
        workers: processes at the same time.
        kind: computations of one kind need the same compiled code, see :func:`leaders_first`.
        say: gets what workers log to ``cablebot_gym``, each message once.
        returned: exceptions that come in place of a result, :class:`WorkerDied` perhaps; others end the whole.
    """
    if workers == 1 or not tasks:
        for key, task in tasks.items():
            try:
                result = task()
            except returned as error:
                result = error
            yield key, result
        return
    for key, failure, result in _Crew(min(workers, len(tasks)), say).results(tasks, leaders_first(tasks, kind)):
        if failure is not None and not isinstance(failure, returned):
            raise failure
        yield key, result if failure is None else failure


def leaders_first(tasks: Mapping[str, Task], kind: Callable[[Task], Hashable]) -> list[str]:
    """The keys, one computation of each kind first.

    A kernel is compiled once per machine; two workers that need the same one at the same time would both compile it.
    """
    leaders: dict[Hashable, str] = {}
    for key, task in tasks.items():
        leaders.setdefault(kind(task), key)
    return list(dict.fromkeys([*leaders.values(), *tasks]))


class _Worker:
    """A process and what it is at."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")  # threads of BLAS do not survive a fork
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()  # so that the end of the process is the end of the pipe
        self.key: str | None = None

    def give(self, key: str, task: Callable[[], Any]) -> None:
        self.key = key
        with suppress(OSError):  # it is dead, which receiving will show
            self.pipe.send(task)

    def end(self) -> None:
        self.process.terminate()
        self.process.join()
        self.pipe.close()


class _Crew:
    def __init__(self, size: int, say: Callable[[str], None]) -> None:
        self._size, self._say = size, say
        self._said: set[str] = set()
        self._workers: list[_Worker] = []

    def results(self, tasks: Mapping[str, Task], order: list[str]) -> Iterator[tuple[str, Exception | None, Any]]:
        """Key, error and result of each as they come."""
        queue, deaths = deque(order), Counter[str]()

        def occupy(worker: _Worker) -> None:
            worker.key = None
            if queue:
                key = queue.popleft()
                worker.give(key, tasks[key])

        try:
            for _ in range(self._size):
                with _interrupts_held():
                    self._workers.append(_Worker())
                occupy(self._workers[-1])
            while busy := {worker.pipe: worker for worker in self._workers if worker.key is not None}:
                for worker in [busy[pipe] for pipe in cast(list[Connection], wait(list(busy)))]:
                    key, ended = worker.key or "", self._heard(worker)
                    if isinstance(ended, WorkerDied):
                        deaths[key] += 1
                        worker = self._replaced(worker)
                        if deaths[key] < ATTEMPTS:
                            worker.give(key, tasks[key])
                            continue
                        ended = (ended, None)
                    if ended is not None:
                        occupy(worker)  # first: whoever takes the result may take their time
                        yield key, *ended
        finally:
            for worker in self._workers:
                worker.end()

    def _heard(self, worker: _Worker) -> tuple[Exception | None, Any] | WorkerDied | None:
        """Error and result, the death of the process, or None if it only had something to say."""
        try:
            what, content = worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join(1.0)  # the pipe ends a moment before the process does
            worker.end()
            return WorkerDied(f"its process died {ATTEMPTS} times, with exit status {worker.process.exitcode}")
        if what == "say":
            if content not in self._said:
                self._said.add(content)
                self._say(content)
            return None
        return (content, None) if what == "error" else (None, content)

    def _replaced(self, dead: _Worker) -> _Worker:
        with _interrupts_held():
            fresh = self._workers[self._workers.index(dead)] = _Worker()
        return fresh


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Interrupts wait until the end, whichever thread they reach; a process started meanwhile never gets any."""
    came: list[int] = []
    handler = signal.getsignal(signal.SIGINT) if threading.current_thread() is threading.main_thread() else None
    if handler is not None:  # it runs in this thread, even for what the mask let through to another
        signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    masks = hasattr(signal, "pthread_sigmask")  # which processes inherit
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
        if came:
            signal.raise_signal(signal.SIGINT)


def _serve(pipe: Connection) -> None:
    """What a worker does: one computation after the other, until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logger = logging.getLogger("cablebot_gym")
    logger.addHandler(_PipeHandler(pipe))
    logger.propagate = False
    with suppress(BrokenPipeError):  # nobody is there to listen any more
        while True:
            try:
                data = pipe.recv_bytes()
            except EOFError:
                return
            try:
                reply = pickle.dumps(("result", pickle.loads(data)()))
            except Exception as error:
                reply = pickle.dumps(("error", _portable(error)))
            pipe.send_bytes(reply)


def _portable(error: Exception) -> Exception:
    """The error, or its words if it cannot be sent; with the traceback, which cannot, as a note."""
    try:
        sent = pickle.loads(pickle.dumps(error))
    except Exception:
        sent = None
    portable = error if type(sent) is type(error) else RuntimeError(f"{type(error).__name__}: {error}")
    portable.add_note("".join(traceback.format_exception(error)))
    return portable


class _PipeHandler(logging.Handler):
    """Passes on what a worker logs, from the thread that computes."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__()
        self._pipe = pipe

    def emit(self, record: logging.LogRecord) -> None:
        self._pipe.send(("say", record.getMessage()))
