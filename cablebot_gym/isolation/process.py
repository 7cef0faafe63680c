"""The judge's side of the process of an isolated policy: start, requests and replies, end."""

from __future__ import annotations

import math
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO

from cablebot_gym.isolation.deadlines import ProcessorTime
from cablebot_gym.isolation.sandbox import sandboxed
from cablebot_gym.isolation.server import FOLDER, memory_limit, receive_frame, send_frame
from cablebot_gym.isolation.system_calls import filter_descriptor
from cablebot_gym.utils.workers import GRACE

TEXT = 16_384
"""Largest length of a reply that is not an array of actions [bytes]."""

_STDERR = 4096
"""Number of last bytes of standard error that are kept."""

_LINE = 1200
"""Number of characters of a text of the policy that messages repeat."""

SAMPLING = 0.5
"""Time between two samples of the processor time [s]."""

_SWEEPS = 20
"""Largest number of searches for processes that a policy has started: they may start others
meanwhile."""

_ENVIRONMENT = {
    *(
        "PATH",
        "HOME",
        "USER",
        "LANG",
        "LANGUAGE",
        "TZ",
        "LD_LIBRARY_PATH",
        "DYLD_LIBRARY_PATH",
        "VIRTUAL_ENV",
    ),
    *(
        "CONDA_PREFIX",
        "XDG_CACHE_HOME",
        "CABLEBOT_CACHE",
        "SYSTEMROOT",
        "WINDIR",
        "COMSPEC",
        "PATHEXT",
    ),
    *("USERPROFILE", "APPDATA", "LOCALAPPDATA", "PROGRAMDATA", "NUMBER_OF_PROCESSORS"),
}
_ENVIRONMENT_PREFIXES = (
    *(
        "LC_",
        "PYTHON",
        "COVERAGE_",
        "NUMBA_",
        "OMP_",
        "OPENBLAS_",
        "MKL_",
        "KMP_",
        "VECLIB_",
        "NUMEXPR_",
    ),
    *("TORCH", "PYTORCH_", "CUDA_", "NVIDIA_", "HIP_", "ROCR_"),
)
"""Environment variables of this process that the policy gets, by name and by the beginning of their
name."""


class ProcessorTimeError(Exception):
    """A policy has used more processor time than it may."""


class EndedError(Exception):
    """The process of a policy has ended, or what it sent is invalid. The message is the cause as a
    clause."""


class PolicyProcess:
    """A process, the thread that talks to it, and the thread that drains its standard error.

    Args:
        sandboxed_names: names of the policy and of its wrappers for which the process is put into a
            sandbox; None for no sandbox.
    """

    def __init__(self, sandboxed_names: Sequence[str] | None = None) -> None:
        folder = tempfile.mkdtemp(prefix=FOLDER)
        environment = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        environment |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder)
        for name, value in os.environ.items():
            if name.upper() in _ENVIRONMENT or name.startswith(_ENVIRONMENT_PREFIXES):
                environment.setdefault(name, value)
        command = [
            sys.executable,
            "-P",
            "-c",
            "from cablebot_gym.isolation.server import main; main()",
        ]
        self._sandboxed = sandboxed_names is not None
        passed: tuple[int, ...] = ()
        pipe = subprocess.PIPE
        with ExitStack() as stack:
            if sandboxed_names is not None:
                descriptor = stack.enter_context(filter_descriptor())
                passed = (descriptor,)
                command = sandboxed(command, sandboxed_names, Path(folder), descriptor)
            self._popen = subprocess.Popen(
                command,
                stdin=pipe,
                stdout=pipe,
                stderr=pipe,
                env=environment,
                start_new_session=True,
                pass_fds=passed,
            )
        self._requests: queue.SimpleQueue[_Request | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[tuple[int, bytes] | None] = queue.SimpleQueue()
        self._stderr = bytearray()
        self._processor_time = ProcessorTime()
        self._drainer = threading.Thread(
            target=_drain, args=(self._popen.stderr, self._stderr), daemon=True
        )
        talker = threading.Thread(
            target=_talk, args=(self._popen, self._requests, self._replies), daemon=True
        )
        threads = [talker, self._drainer]
        for thread in threads:
            thread.start()
        self.end = weakref.finalize(self, _end, self._popen, folder, self._requests, threads)
        """Ends the process; also called when the object is collected and when the interpreter
        exits."""

    def exchange(
        self,
        kind: int,
        body: bytes,
        largest: int,
        seconds: float,
        processor: float = math.inf,
    ) -> tuple[int, bytes]:
        """Kind and body of the reply to a request. The body has at most ``largest`` or :data:`TEXT`
        bytes.

        Raises:
            queue.Empty: if there is no reply within ``seconds``.
            ProcessorTimeError: if the policy uses more than ``processor`` seconds of processor
                time. Nothing is measured if they are infinite.
            EndedError: if the process has ended, or if the reply is invalid.
        """
        self._requests.put((kind, body, max(largest, TEXT)))
        reply = self._reply(seconds, processor)
        if reply is not None:
            return reply
        try:
            status = self._popen.wait(GRACE)  # the pipe closes shortly before the process ends
        except subprocess.TimeoutExpired:
            raise EndedError("its process closed its pipe or sent invalid data") from None
        if self._sandboxed and status > 128:  # as shells report a signal
            status = 128 - status
        cause = f"its process ended with exit status {status}"
        if status < 0:
            with suppress(ValueError):
                cause = f"its process was ended by {signal.Signals(-status).name}"
        self._drainer.join(GRACE)  # the last bytes of standard error
        last_line = plain(bytes(self._stderr).decode(errors="replace").strip().rpartition("\n")[2])
        if last_line:
            cause += f"; the last line of its standard error is {last_line!r}"
        raise EndedError(cause)

    def processor_time(self) -> float:
        """Processor time of the policy since the last question [s], rounded to its samples; 0 where
        it cannot be measured."""
        return self._processor_time.report()

    def _reply(self, seconds: float, processor: float) -> tuple[int, bytes] | None:
        """The next reply, with samples of the processor time while it is awaited."""
        start = time.monotonic()
        while True:
            reply = None
            is_late = True
            remaining = max(start + seconds - time.monotonic(), 0.0)
            with suppress(queue.Empty):
                reply = self._replies.get(timeout=min(remaining, SAMPLING))
                is_late = False
            now = time.monotonic()
            # calls can be short, so most of them are between two samples
            is_due = now - start >= SAMPLING or self._processor_time.is_due(now, SAMPLING)
            if is_due and not math.isinf(processor):
                self._processor_time.sample(now, processor_time_of(self._popen.pid))
                # a part of it may be that of the short calls since the last sample
                possible = (now - start) * (os.cpu_count() or 1)
                if min(self._processor_time.unreported, possible) > processor:
                    raise ProcessorTimeError
            if not is_late:
                return reply
            if now - start >= seconds:
                raise queue.Empty


_Request = tuple[int, bytes, int]
"""Kind and body of a request, and the largest length of the body of its reply [bytes]."""


def _talk(
    popen: subprocess.Popen[bytes],
    requests: queue.SimpleQueue[_Request | None],
    replies: queue.SimpleQueue[tuple[int, bytes] | None],
) -> None:
    """Thread that sends requests and puts each reply, or None after an error. The policy can block
    it without end."""
    assert popen.stdin is not None
    assert popen.stdout is not None
    for kind, body, largest in iter(requests.get, None):
        reply = None
        with suppress(OSError, ValueError):
            send_frame(popen.stdin, kind, body)
            reply = receive_frame(popen.stdout, largest)
        replies.put(reply)


def _drain(pipe: IO[bytes], tail: bytearray) -> None:
    """Thread that reads standard error and keeps its last bytes."""
    with suppress(OSError, ValueError):
        for part in iter(lambda: os.read(pipe.fileno(), 1 << 16), b""):
            tail += part
            del tail[:-_STDERR]


def _end(
    popen: subprocess.Popen[bytes],
    folder: str,
    requests: queue.SimpleQueue[_Request | None],
    threads: list[threading.Thread],
) -> None:
    """Ends a process, its process group and, on Linux, every other process that has inherited its
    limit of memory."""
    requests.put(None)
    with suppress(OSError):
        popen.kill()
    if hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(popen.pid, signal.SIGKILL)
    popen.wait()
    for _ in range(_SWEEPS):
        started = _processes_of(popen.pid)
        for number in started:
            with suppress(OSError):
                os.kill(number, signal.SIGKILL)
        if not started:
            break
    for thread in threads:
        thread.join(1.0)
    if not any(thread.is_alive() for thread in threads):
        for pipe in (popen.stdin, popen.stdout, popen.stderr):
            assert pipe is not None
            with suppress(OSError):  # closing writes the rest of a request
                pipe.close()
    shutil.rmtree(folder, ignore_errors=True)


def _processes_of(number: int) -> list[int]:
    """Numbers of the processes that have the limit of memory of the policy's process with a number
    (Linux).

    A process group would miss those in a session of their own.
    """
    if not sys.platform.startswith("linux"):
        return []
    processes = []
    limit = f" {memory_limit(number)} "
    for path in Path("/proc").glob("[0-9]*/limits"):
        with suppress(OSError):
            if limit in path.read_text(encoding="ascii"):
                processes.append(int(path.parent.name))
    return processes


def processor_time_of(number: int) -> float:
    """Processor time of the policy's process with a number [s]: its own, that of all processes
    below it, and that of those which have left it but have its limit of memory (Linux; 0
    elsewhere). Ended processes count if their parent has waited for them."""
    if not sys.platform.startswith("linux"):
        return 0.0
    times: dict[int, int] = {}
    children: dict[int, list[int]] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        # a process can end meanwhile
        with suppress(OSError, ValueError, IndexError):
            # the name of the program, in parentheses, can hold spaces and parentheses
            fields = path.read_bytes().rpartition(b")")[2].split()
            process = int(path.parent.name)
            parent = int(fields[1])
            times[process] = sum(map(int, fields[11:15]))  # user and system, own and of children
            children.setdefault(parent, []).append(process)
    counted: set[int] = set()
    waiting = [number, *_processes_of(number)]
    while waiting:
        process = waiting.pop()
        if process not in counted:
            counted.add(process)
            waiting += children.get(process, [])
    ticks = sum(times.get(process, 0) for process in counted)
    return ticks / os.sysconf("SC_CLK_TCK")


def plain(text: object) -> str:
    """A text of a policy in one line of printable characters."""
    printable = "".join(character if character.isprintable() else " " for character in str(text))
    return " ".join(printable.split())[:_LINE]
