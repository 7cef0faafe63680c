"""Policies in processes of their own. They get observations and public tasks, and return actions."""

from __future__ import annotations

import json
import logging
import math
import os
import pickle
import queue
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from cablebot_gym.isolation.sandbox import opted_out, prepare_sandbox, sandboxed
from cablebot_gym.isolation.server import (
    ANSWER,
    DESCRIBE,
    FAILURE,
    FOLDER,
    HEADER,
    INVALID,
    LENGTH,
    LOAD,
    MAGIC,
    PREDICT,
    RESET,
    memory_limit,
)
from cablebot_gym.measurement import POSE
from cablebot_gym.policies.entry import is_entry
from cablebot_gym.policies.loading import as_robot, is_own, policy_points, split_estimator
from cablebot_gym.policies.protocol import Array, PolicyEntry, PolicyError
from cablebot_gym.policies.wrapped import say
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.workers import GRACE

_LOGGER = logging.getLogger("cablebot_gym")

DEADLINE = 60.0
"""Default deadline of a call of a policy [s]."""

START_UP = 10
"""Deadline of loading, reset and first call together, in deadlines of a call: plans and compiled code are made then."""

TOTAL = 240
"""Deadline of all calls together, in deadlines of a call."""

_TEXT = 16_384
"""Largest length of a reply that is not an array of actions [bytes]."""

_STDERR = 4096
"""Number of last bytes of standard error that are kept."""

_LINE = 1200
"""Number of characters of a text of the policy that messages repeat."""

_ENVIRONMENT = {
    *("PATH", "HOME", "USER", "LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "VIRTUAL_ENV"),
    *("CONDA_PREFIX", "XDG_CACHE_HOME", "CABLEBOT_CACHE", "SYSTEMROOT", "WINDIR", "COMSPEC", "PATHEXT"),
    *("USERPROFILE", "APPDATA", "LOCALAPPDATA", "PROGRAMDATA", "NUMBER_OF_PROCESSORS"),
}
_ENVIRONMENT_PREFIXES = (
    *("LC_", "PYTHON", "COVERAGE_", "NUMBA_", "OMP_", "OPENBLAS_", "MKL_", "KMP_", "VECLIB_", "NUMEXPR_"),
    *("TORCH", "PYTORCH_", "CUDA_", "NVIDIA_", "HIP_", "ROCR_"),
)
"""Environment variables of this process that the policy gets, by name and by the beginning of their name."""


class IsolatedPolicy:
    """A policy in a process of its own, with a fresh process for each batch of episodes.

    The process gets the nominal robot, observations and public tasks, some environment variables, and a folder of its
    own for temporary files. It knows neither the environment nor the evaluation. Its working directory is that of
    this process, so that files given by relative paths are found.

    Every misbehaviour of the policy is a :class:`~cablebot_gym.policies.protocol.PolicyError`: an exception, an end of
    its process, no answer before the deadline, invalid actions or invalid data. The process is then ended, and on Linux
    all processes that have inherited its memory limit, so all that it has started unless it changes that limit. Other
    processes and files of the same user are protected from the policy only in a sandbox.

    Args:
        spec: name of the policy, as on the command line.
        robot: nominal robot.
        deadline: largest wall-clock time of a call [s]; > 0. Loading, reset and first call for a batch together may
            take :data:`START_UP` times as long, and all calls for all batches :data:`TOTAL` times.
        real_time: control period after which an action is replaced by the last one of its episode [s]; None for no
            limit. The process of the policy measures the time, so it has to be honest. See
            :class:`~cablebot_gym.policies.real_time.RealTime`.
        wrappers: names of the wrappers of the training, the innermost first, see
            :data:`~cablebot_gym.policies.wrapped.Wrapper`. They run in the process of the policy.
        sandbox: whether the process runs in a sandbox without network, other processes, and most files, see
            :func:`~cablebot_gym.isolation.sandbox.sandboxed`. Entries of others always do, unless
            :func:`~cablebot_gym.isolation.sandbox.opt_out` was called.

    Raises:
        ValueError: if the name is unknown or the policy cannot be loaded, if a wrapper is given by an object, or if
            there is no sandbox.
        PolicyError: if the process of the policy ends or does not answer while the policy is loaded.
    """

    def __init__(
        self,
        spec: str,
        robot: Robot | str,
        *,
        deadline: float = DEADLINE,
        real_time: float | None = None,
        wrappers: Sequence[str | Path] = (),
        sandbox: bool = False,
    ) -> None:
        self.name = self.spec = spec
        robot, names = as_robot(robot), tuple(map(str, wrappers))
        self._wrappers = names
        self._sandbox = sandbox or (is_entry(spec) and not opted_out())
        if self._sandbox:
            prepare_sandbox(robot)
        self._deadline = number("deadline", deadline, above=0, unit="s")
        if not all(isinstance(wrapper, (str, Path)) for wrapper in wrappers):
            raise ValueError(
                "an isolated policy takes the names of its wrappers, such as file.py:name: its process imports them"
            )
        path = [entry or os.getcwd() for entry in sys.path]
        self._load = pickle.dumps((LOAD, spec, robot, path, real_time, names))
        self._cables, self._process, self._waited = robot.cables, None, 0.0
        flags = self._start()
        self.unsaturated_actions = flags.get("unsaturated_actions") is True
        """Whether the policy declares ``unsaturated_actions``."""
        self.stochastic = flags.get("stochastic") is True
        """Whether the policy declares ``stochastic``."""
        self.measurement = str(flags.get("measurement", POSE.kind))
        """Kind of measurement that the policy reads."""
        found = flags.get("wrappers")
        self.wrappers = tuple(_plain(str(name)) for name in found) if isinstance(found, list) else names
        """Names of the wrappers, the innermost first, with those that were found beside the policy."""
        if note := _plain(str(flags.get("note", ""))):
            say(note)
        self.fallbacks: float | None = 0.0 if flags.get("fallbacks") is True else None
        """Number of fallbacks that the policy has counted; None if it does not count them."""

    _process: _Process | None
    _fresh: bool
    """Whether the process has only loaded the policy."""
    _called: bool
    """Whether the process has returned actions."""
    _started: float
    """Time for which this process had waited for the policy when its process started [s]."""

    def reset(self, tasks: Sequence[Task]) -> None:
        """Starts a fresh process and passes the tasks, one for each observation of the batch, to its policy.

        Raises:
            ValueError: if the tasks cannot be pickled, for example because a motion is defined inside a function.
            PolicyError: if the policy fails.
        """
        try:
            request = pickle.dumps((RESET, tuple(tasks)))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ValueError(f"the tasks cannot be passed to another process: {error}") from error
        if self._process is None or not self._fresh:
            self._start()
        self._fresh = False
        self._ask(request, 0)

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions of the policy for a batch (N, size) or one observation (size,); the state is the number of calls.

        The state of the policy stays in its process. ``state=None`` starts with no state.

        Raises:
            PolicyError: if the policy fails.
        """
        single = np.ndim(observation) == 1
        rows = np.atleast_2d(observation)
        starts = np.zeros(len(rows), np.bool_) if episode_start is None else np.atleast_1d(episode_start)
        if self._process is None:
            self._start()
        size = 8 * len(rows) * self._cables
        self._fresh = False
        body = self._ask(pickle.dumps((PREDICT, rows, starts, state is None), 5), size + 8, exact=True)
        self._called = True
        (fallbacks,) = struct.unpack("<d", body[size:])
        if self.fallbacks is not None and math.isfinite(fallbacks) and fallbacks >= 0:
            self.fallbacks = fallbacks
        actions = np.frombuffer(body[:size]).reshape(len(rows), self._cables).copy()
        return actions[0] if single else actions, (state or 0) + 1

    def close(self) -> None:
        """Ends the process of the policy and all processes that it has started. The next call starts a new one."""
        if self._process is not None:
            self._process.end()
            self._process = None

    def __enter__(self) -> IsolatedPolicy:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _start(self) -> dict[str, Any]:
        """Starts a process in place of the present one, loads the policy and returns its declarations."""
        self.close()
        self._process = _Process((self.spec, *self._wrappers) if self._sandbox else None)
        self._fresh, self._called, self._started = True, False, self._waited
        body = self._ask(self._load, _TEXT)
        flags = _json(body)
        if not isinstance(flags, dict):
            raise self._failed("its process sent invalid data")
        return flags

    def _ask(self, request: bytes, largest: int, *, exact: bool = False) -> bytes:
        """Body of the answer to a request.

        Args:
            request: the request.
            largest: largest length of the body [bytes].
            exact: whether the body must have this length.
        """
        assert self._process is not None
        start_up, total = START_UP * self._deadline, TOTAL * self._deadline
        limits = [(total - self._waited, total, "all calls together")]
        if self._called:
            limits.append((self._deadline, self._deadline, "a call"))
        else:
            limits.append((start_up - self._waited + self._started, start_up, "loading, reset() and the first call"))
        allowed, limit, what = min(limits)
        started = time.monotonic()
        try:
            kind, body = self._process.exchange(request, largest, max(allowed, 0.0))
        except queue.Empty:
            raise self._failed(f"it did not answer within {limit:g} s, the deadline of {what}") from None
        except _EndedError as error:
            raise self._failed(str(error)) from None
        except BaseException:  # an interrupt
            self.close()
            raise
        self._waited += time.monotonic() - started
        if kind == ANSWER and (len(body) == largest or not exact):
            return body
        content = _json(body) if kind != ANSWER else None
        if not isinstance(content, dict) or not isinstance(content.get("error"), str):
            raise self._failed("its process sent invalid data")
        index = content.get("index")
        if kind == INVALID:
            self.close()
            raise ValueError(_plain(content["error"]))
        raise self._failed(_plain(content["error"]), index if isinstance(index, int) else None)

    def _failed(self, cause: str, index: int | None = None) -> PolicyError:
        """Ends the process and makes an error."""
        self.close()
        return PolicyError.of(self.name, cause, index)


def public_entries() -> dict[str, PolicyEntry]:
    """All installed policies by name, sorted, see :func:`public_entry`. A policy without entry is skipped."""
    names = sorted({point.name for point in policy_points()})
    return {name: entry for name in names if (entry := public_entry(name)) is not None}


@cache
def public_entry(name: str) -> PolicyEntry | None:
    """The entry of an installed policy, without code of other packages; None if there is none.

    The package of another project is imported in a process of its own, which sends the environment ids, the data files
    and whether the policy is slow. The factory of such an entry makes an :class:`IsolatedPolicy`. A policy whose
    package cannot be imported is skipped with a warning.
    """
    estimator, inner = split_estimator(name)
    if estimator is not None:
        entry = public_entry(inner)
        return None if entry is None else replace(entry, name=name, unsaturated_actions=False)
    points = policy_points(name)
    try:
        if points:
            return points[0].load() if is_own(points[0]) else _described(name)
    except Exception as error:
        _LOGGER.warning("policy %r is skipped: %s", name, error)
    return None


def _described(name: str) -> PolicyEntry:
    process = _Process()
    try:
        request = pickle.dumps((DESCRIBE, name, [entry or os.getcwd() for entry in sys.path]))
        kind, body = process.exchange(request, _TEXT, START_UP * DEADLINE)
    finally:
        process.end()
    data = _json(body)
    if kind != ANSWER:
        raise ValueError(_plain(str(data["error"])))
    files = None if data["files"] is None else [Path(str(path)) for path in data["files"]]
    return PolicyEntry(
        name=name,
        kind="learned",
        env_ids=tuple(str(env_id) for env_id in data["env_ids"]),
        factory=partial(IsolatedPolicy, name),
        summary="",
        slow=data["slow"] is True,
        files=None if files is None else tuple(path for path in files if path.is_file()),
    )


class _EndedError(Exception):
    """The process of a policy has ended, or what it sent is invalid. The message is the cause as a clause."""


class _Process:
    """A process, the thread that talks to it, and the thread that drains its standard error.

    Args:
        sandboxed_specs: names of the policy and of its wrappers for which the process is put into a sandbox; None for
            no sandbox.
    """

    def __init__(self, sandboxed_specs: Sequence[str] | None = None) -> None:
        folder = tempfile.mkdtemp(prefix=FOLDER)
        path = os.pathsep.join(entry for entry in sys.path if entry)
        environment = {
            name: value
            for name, value in os.environ.items()
            if name.upper() in _ENVIRONMENT or name.startswith(_ENVIRONMENT_PREFIXES)
        } | {"PYTHONPATH": path, "TMPDIR": folder, "TEMP": folder, "TMP": folder}
        command = [sys.executable, "-P", "-c", "from cablebot_gym.isolation.server import main; main()"]
        self._sandboxed = sandboxed_specs is not None
        self._popen = subprocess.Popen(
            command if sandboxed_specs is None else sandboxed(command, sandboxed_specs, Path(folder)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            env=environment,
            start_new_session=True,
        )
        self._stderr = bytearray()
        self._jobs: queue.SimpleQueue[tuple[bytes, int] | None] = queue.SimpleQueue()
        self._outcomes: queue.SimpleQueue[tuple[int, bytes] | None] = queue.SimpleQueue()
        self._drainer = threading.Thread(target=_drain, args=(self._popen.stderr, self._stderr), daemon=True)
        threads = [
            threading.Thread(target=_talk, args=(self._popen, self._jobs, self._outcomes), daemon=True),
            self._drainer,
        ]
        for thread in threads:
            thread.start()
        self.end = weakref.finalize(self, _end, self._popen, folder, self._jobs, threads)
        """Ends the process; also called when the object is collected and when the interpreter exits."""

    def exchange(self, request: bytes, largest: int, seconds: float) -> tuple[int, bytes]:
        """Kind and body of the reply to a request.

        Raises:
            queue.Empty: if there is no reply within ``seconds``.
            _EndedError: if the process has ended, or if the reply is invalid.
        """
        self._jobs.put((request, largest))
        outcome = self._outcomes.get(timeout=seconds)
        if outcome is not None:
            return outcome
        try:
            status = self._popen.wait(GRACE)  # the pipe closes shortly before the process ends
        except subprocess.TimeoutExpired:
            raise _EndedError("its process closed its pipe or sent invalid data") from None
        if self._sandboxed and status > 128:  # as shells report a signal
            status = 128 - status
        cause = f"its process ended with exit status {status}"
        if status < 0:
            with suppress(ValueError):
                cause = f"its process was ended by {signal.Signals(-status).name}"
        self._drainer.join(GRACE)  # the last bytes of standard error
        lines = _plain(bytes(self._stderr).decode(errors="replace").strip().rpartition("\n")[2])
        raise _EndedError(f"{cause}; the last line of its standard error is {lines!r}" if lines else cause)


def _talk(
    popen: subprocess.Popen[bytes],
    jobs: queue.SimpleQueue[tuple[bytes, int] | None],
    outcomes: queue.SimpleQueue[tuple[int, bytes] | None],
) -> None:
    """Thread that sends requests and puts kind and body of each reply, or None after an error."""
    assert popen.stdin is not None
    assert popen.stdout is not None
    while (job := jobs.get()) is not None:
        request, largest = job
        outcome = None
        with suppress(OSError, ValueError):
            view = memoryview(LENGTH.pack(len(request)) + request)
            while view:
                view = view[popen.stdin.write(view) :]
            magic, kind, size = HEADER.unpack(_read(popen.stdout, HEADER.size))
            known = magic == MAGIC and kind in (ANSWER, FAILURE, INVALID)
            if known and size <= (largest if kind == ANSWER else _TEXT):
                outcome = kind, _read(popen.stdout, size)
        outcomes.put(outcome)


def _read(pipe: IO[bytes], size: int) -> bytes:
    parts = []
    while size > 0:
        part = pipe.read(min(size, 1 << 20))
        if not part:
            raise OSError("the pipe is closed")
        parts.append(part)
        size -= len(part)
    return b"".join(parts)


def _drain(pipe: IO[bytes], tail: bytearray) -> None:
    """Thread that reads standard error and keeps its last bytes."""
    with suppress(OSError, ValueError):
        while part := pipe.read(1 << 16):
            tail += part
            del tail[:-_STDERR]


def _end(
    popen: subprocess.Popen[bytes],
    folder: str,
    jobs: queue.SimpleQueue[tuple[bytes, int] | None],
    threads: list[threading.Thread],
) -> None:
    """Ends a process, its process group and, on Linux, every other process that has inherited its limit of memory."""
    jobs.put(None)
    with suppress(OSError):
        popen.kill()
    if hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(popen.pid, signal.SIGKILL)
    popen.wait()
    for _ in range(20):  # a process may start others meanwhile
        if not (found := _processes_of(popen.pid)):
            break
        for number_ in found:
            with suppress(OSError):
                os.kill(number_, signal.SIGKILL)
    for thread in threads:
        thread.join(1.0)
    if not any(thread.is_alive() for thread in threads):
        for pipe in (popen.stdin, popen.stdout, popen.stderr):
            if pipe is not None:
                pipe.close()
    shutil.rmtree(folder, ignore_errors=True)


def _processes_of(number_: int) -> list[int]:
    """Numbers of the processes that have the limit of memory of the policy's process with a number (Linux)."""
    if not sys.platform.startswith("linux"):
        return []
    found, wanted = [], f" {memory_limit(number_)} "
    for path in Path("/proc").glob("[0-9]*/limits"):
        with suppress(OSError):
            if wanted in path.read_text(encoding="ascii"):
                found.append(int(path.parent.name))
    return found


def _json(body: bytes) -> Any:
    """JSON data of a reply; None if it is invalid."""
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        return None


def _plain(text: str) -> str:
    """A text in one line of printable characters."""
    plain = "".join(character if character.isprintable() else " " for character in text)
    return " ".join(plain.split())[:_LINE]
