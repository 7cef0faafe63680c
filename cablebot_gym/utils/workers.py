"""Computations in worker processes.

Each computation runs once, repeated log messages appear once, and no process outlives its iterator.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar, cast

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

from cablebot_gym.utils.user_code import keep_sentence, sentence_of_user_code

Task = TypeVar("Task", bound=Callable[[], Any])
"""A computation. For workers it must be picklable: a module-level function or a
``functools.partial`` of one."""

ATTEMPTS = 2
"""Number of times that a computation is started if its process dies."""


LARGEST_MEMORY = 3e9
"""Memory [bytes] above which a process is replaced after its computation. Compiled code and solvers
stay in a process, and so does the memory of the largest computation."""

GRACE = 5.0
"""Longest time from the end of a process's pipe to its own end, on a busy machine too [s]."""


class WorkerDied(RuntimeError):
    """A computation ended its process or tried to, for example by ``sys.exit``, a crash or for lack
    of memory."""


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_workers(workers: int | None) -> int:
    """The number of worker processes; one per core for None.

    Raises:
        ValueError: if ``workers`` is less than 1.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers}")
    return workers or cores()


def run(
    tasks: Mapping[str, Task],
    *,
    workers: int,
    say: Callable[[str], None],
    returned: tuple[type[Exception], ...] = (),
) -> Iterator[tuple[str, Any]]:
    """Yields keys and results in the order of completion. Closing the iterator or an interrupt ends
    the processes.

    A computation whose process dies is repeated in a new process, at most :data:`ATTEMPTS` times in
    total.

    Args:
        tasks: computations by key. With ``workers`` = 1 they run one after the other in this
            process.
        workers: number of processes.
        say: called with each message that workers log to ``cablebot_gym``; repeated messages are
            dropped.
        returned: exception types that are yielded in place of a result, such as
            :class:`WorkerDied`. Other exceptions are raised.
    """
    results = _sequential
    if workers > 1 and tasks:
        results = _Pool(min(workers, len(tasks)), say).results
    # The loop alone refers to the iterator, which therefore ends the processes at any error.
    for key, failure, result in results(tasks):
        if failure is None:
            yield key, result
        elif isinstance(failure, returned):
            yield key, failure
        else:
            raise failure


def _outcome(task: Callable[[], Any]) -> tuple[Exception | None, Any]:
    """Error and result of a computation. An attempt to end the process, such as ``sys.exit``, is a
    WorkerDied."""
    try:
        return None, task()
    except KeyboardInterrupt:
        raise
    except Exception as error:
        return error, None
    except BaseException as error:
        return WorkerDied(f"it raised {type(error).__name__}: {error}"), None


def _sequential(tasks: Mapping[str, Task]) -> Iterator[tuple[str, Exception | None, Any]]:
    """Key, error and result of each computation in this process."""
    for key, task in tasks.items():
        yield key, *_outcome(task)


class _Worker:
    """A process and its current computation."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")  # BLAS threads do not survive a fork
        self.pipe, remote = context.Pipe()
        self.process = context.Process(target=_serve, args=(remote,), daemon=True)
        self.process.start()
        remote.close()  # the pipe then closes when the process ends
        self.key: str | None = None
        self.memory = 0
        """Largest memory of the process until its last result [bytes]."""

    def submit(self, key: str, task: Callable[[], Any]) -> None:
        self.key = key
        with suppress(OSError):  # the process is dead; receiving reports it
            self.pipe.send(task)

    def end(self) -> None:
        self.process.terminate()
        self.process.join()
        self.pipe.close()


class _Pool:
    """Processes that share computations, in their order."""

    def __init__(self, size: int, say: Callable[[str], None]) -> None:
        self._size = size
        self._say = say
        self._reported: set[str] = set()
        self._workers: list[_Worker] = []

    def results(self, tasks: Mapping[str, Task]) -> Iterator[tuple[str, Exception | None, Any]]:
        """Key, error and result of each computation in the order of completion."""
        queue = deque(tasks)
        deaths = Counter[str]()

        def submit_next(worker: _Worker) -> None:
            worker.key = None
            if queue:
                key = queue.popleft()
                worker.submit(key, tasks[key])

        try:
            for _ in range(self._size):
                with _interrupts_deferred():
                    self._workers.append(_Worker())
                submit_next(self._workers[-1])
            while True:
                busy = {worker.pipe: worker for worker in self._workers if worker.key is not None}
                if not busy:
                    return
                for worker in [busy[pipe] for pipe in cast(list[Connection], wait(list(busy)))]:
                    key = worker.key or ""
                    outcome = self._receive(worker)
                    if isinstance(outcome, WorkerDied):
                        deaths[key] += 1
                        worker = self._replaced(worker)
                        if deaths[key] < ATTEMPTS:
                            worker.submit(key, tasks[key])
                            continue
                        outcome = (outcome, None)
                    if outcome is not None:
                        if worker.memory > LARGEST_MEMORY:
                            worker.end()
                            worker = self._replaced(worker)
                        submit_next(worker)  # before the yield: the caller may be slow
                        yield key, *outcome
        finally:
            for worker in self._workers:
                worker.end()

    def _receive(self, worker: _Worker) -> tuple[Exception | None, Any] | WorkerDied | None:
        """Error and result, a :class:`WorkerDied` if the process died, or None after a log
        message."""
        try:
            kind, content, worker.memory = worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join(GRACE)  # the pipe closes shortly before the process ends
            worker.end()
            return WorkerDied(
                f"its process died {ATTEMPTS} times, with exit status {worker.process.exitcode}"
            )
        if kind == "log":
            if content not in self._reported:
                self._reported.add(content)
                self._say(content)
            return None
        if kind == "error":
            return content, None
        return None, content

    def _replaced(self, ended: _Worker) -> _Worker:
        with _interrupts_deferred():
            new = self._workers[self._workers.index(ended)] = _Worker()
        return new


@contextmanager
def _interrupts_deferred() -> Iterator[None]:
    """Defers interrupts until the end. A process that is started meanwhile never receives any,
    because processes inherit the mask."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start removes the mask
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _serve(pipe: Connection) -> None:
    """Main loop of a worker: runs one computation after the other until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logger = logging.getLogger("cablebot_gym")
    logger.addHandler(_PipeHandler(pipe))
    logger.propagate = False
    with suppress(BrokenPipeError):  # the parent process is gone
        while True:
            try:
                data = pipe.recv_bytes()
            except EOFError:
                return
            failure, reply = _outcome(partial(_pickled_result, data))
            if failure is not None:
                reply = pickle.dumps(("error", _portable(failure), _memory()))
            pipe.send_bytes(reply)


def _pickled_result(data: bytes) -> bytes:
    """Result of a pickled computation, pickled."""
    return pickle.dumps(("result", pickle.loads(data)(), _memory()))


def _memory() -> int:
    """Largest memory of this process until now [bytes]; 0 where the system does not say."""
    if resource is None:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _portable(error: Exception) -> Exception:
    """The error, or a RuntimeError with its message if it cannot be pickled. The traceback is
    attached as a note."""
    portable = error
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        copy = None
    if type(copy) is not type(error):
        portable = RuntimeError(f"{type(error).__name__}: {error}")
    keep_sentence(portable, sentence_of_user_code(error))
    portable.add_note("".join(traceback.format_exception(error)))
    return portable


class _PipeHandler(logging.Handler):
    """Sends the log messages of a worker to the parent process."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__()
        self._pipe = pipe

    def emit(self, record: logging.LogRecord) -> None:
        self._pipe.send(("log", record.getMessage(), 0))
