"""The judge's side of the process of an isolated policy: start, requests and replies, end."""

from __future__ import annotations

import json
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
from contextlib import suppress
from functools import cache
from pathlib import Path

from cablebot_gym.isolation.server import make_folders, receive_frame, send_frame
from cablebot_gym.utils.files import CACHE_VARIABLE
from cablebot_gym.utils.workers import GRACE

TEXT = 16_384
"""Largest length of a reply that is not an array of actions [bytes]."""

_STDERR = 4096
"""Number of last bytes of standard error in which the last line is looked for."""

_LINE = 1200
"""Number of characters of a text of the policy that messages repeat."""

SAMPLING = 0.5
"""Time between two samples of the processor time [s]."""

WAITING = 10
"""Largest elapsed time of an answer, in units of its deadline of processor time. It ends policies that
sleep, and is long enough for a busy machine."""

_SWEEPS = 20
"""Largest number of searches for processes that a policy has started: they may start others
meanwhile."""

_VARIABLES = (
    *("PATH", "LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"),
    *("VIRTUAL_ENV", "CONDA_PREFIX", "SYSTEMROOT", "WINDIR", "COMSPEC", "PATHEXT"),
)
_PREFIXES = ("LC_", "PYTHON", "COVERAGE_", "NUMBA_", "TORCH", "PYTORCH_", "CUDA_", "NVIDIA_")
"""Environment variables of this process that the policy gets, by name and by the beginning of their
name."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
"""Environment variables of numerical libraries with their number of threads. It is one, because a
process with several threads cannot be forked."""


class DeadlineError(Exception):
    """A policy has not answered before its deadline. The message is the cause as a clause."""


class EndedError(Exception):
    """The process of a policy has ended, or what it sent is invalid. The message is the cause as a
    clause."""


@cache
def has_bubblewrap() -> bool:
    """Whether bubblewrap is installed and may create namespaces."""
    if shutil.which("bwrap") is None:
        return False
    return subprocess.run([*_BUBBLEWRAP, "--", "true"], capture_output=True).returncode == 0


_BUBBLEWRAP = (
    *("bwrap", "--unshare-all", "--die-with-parent", "--cap-drop", "ALL"),
    *("--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc"),
    *("--ro-bind", "/proc/sys", "/proc/sys"),  # the administrator may write there
)
"""Beginning of a command that sees neither network nor other processes, and writes no file."""


class PolicyProcess:
    """A process with an empty home, working folder and cache of its own, behind bubblewrap where that
    is installed, and the thread that talks to it."""

    def __init__(self) -> None:
        folder = Path(tempfile.mkdtemp(prefix="cablebot-policy-"))
        command = [
            *(sys.executable, "-P", "-c"),
            "from cablebot_gym.isolation.server import main; main()",
        ]
        self.is_behind_bubblewrap = has_bubblewrap()
        if self.is_behind_bubblewrap:
            command = [*_BUBBLEWRAP, "--bind", str(folder), str(folder), "--", *command]
        environment = _environment(folder)
        self._stderr = folder / "stderr"
        with self._stderr.open("wb") as stderr:
            self._popen = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                env=environment,
                cwd=folder / "work",
                start_new_session=True,
            )
        self._requests: queue.SimpleQueue[_Request | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[tuple[int, bytes] | None] = queue.SimpleQueue()
        talker = threading.Thread(
            target=_talk, args=(self._popen, self._requests, self._replies), daemon=True
        )
        talker.start()
        self.end = weakref.finalize(self, _end, self._popen, folder, self._requests, talker)
        """Ends the process; also called when the object is collected and when the interpreter
        exits."""

    def exchange(self, kind: int, body: bytes, largest: int, deadline: float) -> tuple[int, bytes]:
        """Kind and body of the reply to a request. The body has at most ``largest`` or :data:`TEXT`
        bytes.

        Args:
            kind: kind of the request.
            body: its body.
            largest: largest length of the reply [bytes].
            deadline: largest processor time of the answer [s].

        Raises:
            DeadlineError: if the policy uses more processor time, or :data:`WAITING` times as much
                elapsed time.
            EndedError: if the process has ended, or if the reply is invalid.
        """
        self._requests.put((kind, body, max(largest, TEXT)))
        reply = self._reply(deadline)
        if reply is not None:
            return reply
        try:
            status = self._popen.wait(GRACE)  # the pipe closes shortly before the process ends
        except subprocess.TimeoutExpired:
            raise EndedError("its process closed its pipe or sent invalid data") from None
        if self.is_behind_bubblewrap and status > 128:  # as shells report a signal
            status = 128 - status
        raise self.ended(status)

    def ended(self, status: int) -> EndedError:
        """The error of a process that has ended with an exit status, which is negative for a
        signal."""
        cause = f"its process ended with exit status {status}"
        if status < 0:
            with suppress(ValueError):
                cause = f"its process was ended by {signal.Signals(-status).name}"
        text = self._stderr.read_bytes()[-_STDERR:].decode(errors="replace")
        last_line = plain(text.strip().rpartition("\n")[2])
        if last_line:
            cause += f"; the last line of its standard error is {last_line!r}"
        return EndedError(cause)

    def _reply(self, deadline: float) -> tuple[int, bytes] | None:
        """The next reply, with samples of the processor time while it is awaited."""
        start = time.monotonic()
        first_sample = None
        while True:
            with suppress(queue.Empty):
                return self._replies.get(timeout=SAMPLING)
            used = processor_time(self._popen.pid)
            if first_sample is None:
                first_sample = used
            if used - first_sample > deadline:
                raise DeadlineError(f"it used more than {deadline:g} s of processor time")
            if time.monotonic() - start > WAITING * deadline:
                raise DeadlineError(f"it did not answer within {WAITING * deadline:g} s")


_Request = tuple[int, bytes, int]
"""Kind and body of a request, and the largest length of the body of its reply [bytes]."""


def _environment(folder: Path) -> dict[str, str]:
    """Environment variables of a policy's process, with home, working folder, temporary files and
    cache in a folder. It reads the compiled code of this process, and writes its own into its
    cache: a policy must not replace code that later runs execute."""
    # numba takes a second, which other commands save
    from cablebot_gym.physics.compiling.code_cache import SHARED_CODE, code_folders
    from cablebot_gym.physics.compiling.python_first import AT_ONCE

    environment = {}
    for name, value in os.environ.items():
        if name.upper() in _VARIABLES or name.startswith(_PREFIXES):
            environment[name] = value
    environment.pop("NUMBA_CACHE_DIR", None)
    environment |= make_folders(folder) | dict.fromkeys(_THREADS, "1")
    environment["PYTHONPATH"] = os.pathsep.join(search_path())
    environment[CACHE_VARIABLE] = str(folder / "cache")
    environment[AT_ONCE] = os.environ.get(AT_ONCE, "")
    environment[SHARED_CODE] = os.pathsep.join(map(str, code_folders()))
    return environment


def search_path() -> list[str]:
    """Search path of modules for another process, which has another working folder."""
    return [os.path.abspath(folder) for folder in sys.path]


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


def _end(
    popen: subprocess.Popen[bytes],
    folder: Path,
    requests: queue.SimpleQueue[_Request | None],
    talker: threading.Thread,
) -> None:
    """Ends a process, all processes below it (Linux), and its process group."""
    requests.put(None)
    for _ in range(_SWEEPS):
        below = _processes(popen.pid).keys() - {popen.pid}
        for number in below:
            with suppress(OSError):
                os.kill(number, signal.SIGKILL)
        if not below:
            break
    with suppress(OSError):
        popen.kill()
    if hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(popen.pid, signal.SIGKILL)
    popen.wait()
    talker.join(1.0)
    if not talker.is_alive():
        for pipe in (popen.stdin, popen.stdout):
            assert pipe is not None
            with suppress(OSError):  # closing writes the rest of a request
                pipe.close()
    shutil.rmtree(folder, ignore_errors=True)


def _processes(root: int) -> dict[int, int]:
    """Processor time of a process and of every running one below it, by their numbers [ticks]
    (Linux; empty elsewhere). The time of an ended process is that of the parent that waited for
    it."""
    times: dict[int, int] = {}
    children: dict[int, list[int]] = {}
    if not sys.platform.startswith("linux"):
        return times
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):  # a process can end meanwhile
            # the name of the program, in parentheses, can hold spaces and parentheses
            state, parent, *fields = path.read_bytes().rpartition(b")")[2].split()
            if state == b"Z":
                continue
            process = int(path.parent.name)
            times[process] = sum(map(int, fields[9:13]))  # user and system, own and of children
            children.setdefault(int(parent), []).append(process)
    found: dict[int, int] = {}
    waiting = [root]
    while waiting:
        process = waiting.pop()
        if process in times and process not in found:
            found[process] = times[process]
            waiting += children.get(process, [])
    return found


def processor_time(root: int) -> float:
    """Processor time of a process and of all that it has started [s]; 0 outside Linux."""
    ticks = sum(_processes(root).values())
    return ticks / os.sysconf("SC_CLK_TCK") if ticks else 0.0


def plain(text: object) -> str:
    """A text of a policy in one line of printable characters."""
    printable = "".join(character if character.isprintable() else " " for character in str(text))
    return " ".join(printable.split())[:_LINE]


def parse_json(body: bytes) -> object:
    """JSON data of a reply; None if it is invalid."""
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        return None
