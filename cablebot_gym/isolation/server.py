"""The process of an isolated policy, which :mod:`cablebot_gym.isolation.isolated` starts.

Requests are pickled by the parent process. Replies are frames: :data:`HEADER` and a body of bytes or JSON. The parent
process checks them and never unpickles anything.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import shutil
import signal
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from cablebot_gym.policies.entry import entry_spec
from cablebot_gym.policies.loading import load_policy, policy_entry
from cablebot_gym.policies.protocol import (
    PolicyError,
    PolicyFactory,
    declarations,
    measured_kind,
    predicted,
    reset_policy,
)
from cablebot_gym.policies.real_time import RealTime
from cablebot_gym.utils.user_code import raised

HEADER = struct.Struct("<4sBQ")
"""Header of a reply: :data:`MAGIC`, kind, number of bytes of the body."""
LENGTH = struct.Struct("<Q")
"""Header of a request: number of bytes of the body."""
FOLDER = "cablebot-policy-"
"""Beginning of the name of the folder for temporary files."""
MAGIC = b"CBG1"
"""First bytes of every reply."""
ANSWER, FAILURE, INVALID = range(3)
"""Kinds of replies: a result; JSON of an error of the policy; JSON of a policy that cannot be loaded."""
LOAD, RESET, PREDICT, DESCRIBE = range(4)
"""Kinds of requests."""

_MEMORY_FRACTION = 0.5
"""Fraction of the machine's memory that the process may allocate (Linux)."""

_WATCH_PERIOD = 1.0
"""Time between two checks whether the parent process is alive [s]."""


class _Server:
    """A policy and its state."""

    def load(
        self, spec: str, robot: Any, path: list[str], real_time: float | None = None, wrappers: tuple[str, ...] = ()
    ) -> bytes:
        """Loads the policy, for real time if there is a control period, and returns its declarations as JSON."""
        sys.path[:] = path
        spec = entry_spec(spec)
        self._policy, self._cables, self._state = load_policy(spec, robot, wrappers=wrappers), robot.cables, None
        note, names = getattr(self._policy, "note", ""), getattr(self._policy, "wrappers", ())
        if real_time is not None:
            self._policy = PolicyFactory(lambda: RealTime(load_policy(spec, robot, wrappers=wrappers), real_time))
        unsaturated, stochastic = declarations(self._policy)
        flags = {"unsaturated_actions": unsaturated, "stochastic": stochastic, "note": note, "wrappers": names}
        flags["measurement"] = measured_kind(self._policy)
        return json.dumps(flags | {"fallbacks": hasattr(self._policy, "fallbacks")}).encode()

    def reset(self, tasks: Any) -> bytes:
        """Resets the policy."""
        self._state = None
        reset_policy(self._policy, "", lambda: tasks)
        return b""

    def predict(self, observation: Any, start: Any, fresh: bool) -> bytes:
        """Actions as float64, followed by the number of fallbacks, which is NaN if the policy does not count them."""
        rows = np.atleast_2d(observation)
        state = None if fresh else self._state
        actions, self._state = predicted(self._policy, rows, state, start, self._cables)
        fallbacks = math.nan
        with suppress(Exception):
            fallbacks = float(getattr(self._policy, "fallbacks", math.nan))
        return actions.tobytes() + struct.pack("<d", fallbacks)

    def describe(self, name: str, path: list[str]) -> bytes:
        """Data of the entry of an installed policy as JSON."""
        sys.path[:] = path
        entry = policy_entry(name)
        if entry is None:
            raise ValueError(f"its package cannot be imported, or its entry has another name than {name!r}")
        files = None if entry.files is None else [os.path.abspath(file) for file in entry.files]
        return json.dumps({"env_ids": list(entry.env_ids), "slow": entry.slow, "files": files}).encode()


def serve(receive: Callable[[], bytes], send: Callable[[int, bytes], None]) -> None:
    """Answers requests until ``receive`` returns nothing."""
    server = _Server()
    while request := receive():
        kind, failure = -1, FAILURE
        try:
            kind, *content = pickle.loads(request)
            body = (server.load, server.reset, server.predict, server.describe)[kind](*content)
        except BaseException as error:
            text, index = raised(error), None
            if isinstance(error, PolicyError):
                text, index = error.cause, error.index
            elif kind == LOAD and isinstance(error, (ValueError, ImportError)):
                text, failure = str(error), INVALID
            send(failure, json.dumps({"error": text[:4000], "index": index}).encode())
        else:
            send(ANSWER, body)


def main() -> None:
    """Keeps the two pipes for itself and serves them. Output of the policy goes to the null device."""
    requests, replies = os.dup(0), os.dup(1)
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(null, 1)
    _limit_resources()
    parent, folder = os.getppid(), tempfile.gettempdir()  # the policy may change the environment variables
    threading.Thread(target=_end_with, args=(parent, folder), daemon=True).start()

    def read(size: int) -> bytes:
        parts = []
        while size > 0 and (part := os.read(requests, min(size, 1 << 20))):
            parts.append(part)
            size -= len(part)
        return b"".join(parts)

    def receive() -> bytes:
        header = read(LENGTH.size)
        return read(*LENGTH.unpack(header)) if len(header) == LENGTH.size else b""

    def send(kind: int, body: bytes) -> None:
        view = memoryview(HEADER.pack(MAGIC, kind, len(body)) + body)
        while view:
            view = view[os.write(replies, view) :]

    with suppress(OSError):  # the parent process is gone, or the policy has closed the pipes
        serve(receive, send)
    _remove(folder)
    os._exit(0)  # threads of the policy may still run


def _limit_resources() -> None:
    """Limits the memory, so that a policy that allocates without end fails before other processes do."""
    if not sys.platform.startswith("linux"):
        return
    import resource

    memory = memory_limit(os.getpid())
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
        with open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
            file.write("1000")


def memory_limit(number: int) -> int:
    """Limit of the memory of the policy's process with a number [bytes] (Linux).

    It differs between processes. A process inherits it, whatever its environment and session, so it tells which
    processes a policy has started.
    """
    import resource

    limit, hard = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"), resource.getrlimit(resource.RLIMIT_DATA)[1]
    limit = int(_MEMORY_FRACTION * limit)
    return (limit if hard == resource.RLIM_INFINITY else min(limit, hard)) - number


def _end_with(parent: int, folder: str) -> None:
    """Ends the process and its children when the parent process has ended, and removes the temporary files."""
    while os.getppid() == parent:
        time.sleep(_WATCH_PERIOD)
    _remove(folder)
    if hasattr(os, "killpg"):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def _remove(folder: str) -> None:
    """Removes the folder for temporary files, which the parent process does if it is alive."""
    if os.path.basename(folder).startswith(FOLDER):
        shutil.rmtree(folder, ignore_errors=True)
