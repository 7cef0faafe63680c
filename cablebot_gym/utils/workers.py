"""Computations in worker processes.

No process outlives its iterator.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar, cast

from cablebot_gym.utils.user_code import keep_sentence, sentence_of_user_code

Task = TypeVar("Task", bound=Callable[[], Any])
"""A computation. For workers it must be picklable: a module-level function or a
``functools.partial`` of one."""

MEMORY = 3e9
"""Memory above which a process ends after its computation, and a new one takes its place [B]: compiled
code and nonlinear programs stay in a process."""

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
    memory: float = MEMORY,
) -> Iterator[tuple[str, Any]]:
    """Yields keys and results in the order of completion, a :class:`WorkerDied` in place of a lost
    one. Other exceptions are raised. Closing the iterator or an interrupt ends the processes.

    Args:
        tasks: computations by key. With ``workers`` = 1 they run one after the other in this
            process.
        workers: number of processes.
        memory: memory above which a process is replaced [B].
    """
    results = _sequential
    if workers > 1 and tasks:
        results = _Pool(min(workers, len(tasks)), memory).results
    # The loop alone refers to the iterator, which therefore ends the processes at any error.
    for key, failure, result in results(tasks):
        if failure is None:
            yield key, result
        elif isinstance(failure, WorkerDied):
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

    def __init__(self, memory: float) -> None:
        context = multiprocessing.get_context("spawn")  # BLAS threads do not survive a fork
        self.pipe, remote = context.Pipe()
        self.process = context.Process(target=_serve, args=(remote, memory), daemon=True)
        self.process.start()
        remote.close()  # the pipe then closes when the process ends
        self.key: str | None = None

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

    def __init__(self, size: int, memory: float) -> None:
        self._size = size
        self._memory = memory
        self._workers: list[_Worker] = []

    def results(self, tasks: Mapping[str, Task]) -> Iterator[tuple[str, Exception | None, Any]]:
        """Key, error and result of each computation in the order of completion."""
        queue = deque(tasks)

        def submit_next(worker: _Worker) -> None:
            worker.key = None
            if queue:
                key = queue.popleft()
                worker.submit(key, tasks[key])

        try:
            for _ in range(self._size):
                with _interrupts_deferred():
                    self._workers.append(_Worker(self._memory))
                submit_next(self._workers[-1])
            while True:
                busy = {worker.pipe: worker for worker in self._workers if worker.key is not None}
                if not busy:
                    return
                for worker in [busy[pipe] for pipe in cast(list[Connection], wait(list(busy)))]:
                    key = worker.key or ""
                    failure, result, is_full = self._receive(worker)
                    if is_full:
                        worker.end()
                        worker = self._replaced(worker)
                    submit_next(worker)  # before the yield: the caller may be slow
                    yield key, failure, result
        finally:
            for worker in self._workers:
                worker.end()

    def _receive(self, worker: _Worker) -> tuple[Exception | None, Any, bool]:
        """Error and result, and whether the process must be replaced. The error is a
        :class:`WorkerDied` if it died."""
        try:
            (failure, result), is_full = worker.pipe.recv(), worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join(GRACE)  # the pipe closes shortly before the process ends
            status = worker.process.exitcode
            return WorkerDied(f"its process died, with exit status {status}"), None, True
        return failure, result, is_full

    def _replaced(self, ended: _Worker) -> _Worker:
        with _interrupts_deferred():
            new = self._workers[self._workers.index(ended)] = _Worker(self._memory)
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


def _serve(pipe: Connection, memory: float) -> None:
    """Main loop of a worker: runs one computation after the other until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(BrokenPipeError):  # the parent process is gone
        while True:
            try:
                data = pipe.recv_bytes()
            except EOFError:
                return
            failure, reply = _outcome(partial(_pickled_result, data))
            if failure is not None:
                reply = pickle.dumps((_portable(failure), None))
            pipe.send_bytes(reply)
            pipe.send(_peak_memory() > memory)


def _peak_memory() -> float:
    """Largest memory of this process so far [B]; 0 where it is unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    unit = 1 if sys.platform == "darwin" else 1024
    return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def _pickled_result(data: bytes) -> bytes:
    """Result of a pickled computation, pickled."""
    return pickle.dumps((None, pickle.loads(data)()))


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
