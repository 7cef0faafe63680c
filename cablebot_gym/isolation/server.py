"""The process of an isolated policy, which :mod:`cablebot_gym.isolation.process` starts.

Requests and replies are frames: :data:`HEADER` and a body. The judge pickles its requests. Replies
are numbers or JSON, because the judge must never unpickle what a policy can have written.
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
from typing import IO, Any

from cablebot_gym.policies.protocol import PolicyError, declarations, predicted, reset_policy
from cablebot_gym.policies.spec import PolicySpec, load
from cablebot_gym.utils.user_code import raised

HEADER = struct.Struct("<BQ")
"""Header of a frame: kind, number of bytes of the body."""
LOAD, RESET, PREDICT, DESCRIBE = range(4)
"""Kinds of requests."""
ANSWER, FAILURE, INVALID = range(3)
"""Kinds of replies: a result; JSON of an error of the policy; JSON of a policy that cannot be
loaded."""
FOLDER = "cablebot-policy-"
"""Beginning of the name of the folder for temporary files."""

_MEMORY_FRACTION = 0.5
"""Fraction of the machine's memory that the process may allocate (Linux)."""

_WATCH_PERIOD = 1.0
"""Time between two checks whether the parent process is alive [s]."""


def send_frame(pipe: IO[bytes], kind: int, body: bytes) -> None:
    """Writes a frame.

    Raises:
        OSError: if the pipe is closed.
    """
    pipe.write(HEADER.pack(kind, len(body)) + body)
    pipe.flush()


def receive_frame(pipe: IO[bytes], largest: float = math.inf) -> tuple[int, bytes]:
    """Kind and body of the next frame.

    Args:
        pipe: the pipe.
        largest: largest length of the body [bytes].

    Raises:
        OSError: if the pipe is closed.
        ValueError: if the body is longer.
    """
    header = pipe.read(HEADER.size)
    if len(header) < HEADER.size:
        raise OSError("the pipe is closed")
    kind, size = HEADER.unpack(header)
    if size > largest:
        raise ValueError(f"a frame of {size} bytes")
    body = pipe.read(size)
    if len(body) < size:
        raise OSError("the pipe is closed")
    return kind, body


class _Server:
    """A policy and its state."""

    def load(
        self,
        name: str,
        robot: Any,
        path: list[str],
        wrappers: tuple[str, ...] = (),
    ) -> bytes:
        """Loads the policy and returns its declarations as JSON."""
        sys.path[:] = path
        loaded = load(name, robot, wrappers=wrappers)
        self._policy = loaded.policy
        self._cables = robot.cables
        self._state = None
        described = declarations(self._policy)._asdict() | {
            "notes": loaded.notes,
            "wrappers": loaded.wrappers,
            "fallbacks": hasattr(self._policy, "fallbacks"),
        }
        return json.dumps(described).encode()

    def reset(self, tasks: Any) -> bytes:
        """Resets the policy."""
        self._state = None
        reset_policy(self._policy, "", lambda: tasks)
        return b""

    def predict(self, observation: Any, start: Any, fresh: bool) -> bytes:
        """Actions as float64, followed by the number of fallbacks, which is NaN if the policy does
        not count them."""
        state = None if fresh else self._state
        actions, self._state = predicted(self._policy, observation, state, start, self._cables)
        fallbacks = math.nan
        with suppress(Exception):
            fallbacks = float(getattr(self._policy, "fallbacks", math.nan))
        return actions.tobytes() + struct.pack("<d", fallbacks)

    def describe(self, name: str, path: list[str]) -> bytes:
        """Data of the entry of an installed policy as JSON."""
        sys.path[:] = path
        entry = PolicySpec.parse(name).entry()
        if entry is None:
            raise ValueError(
                f"its package cannot be imported, or its entry has another name than {name!r}"
            )
        files = None if entry.files is None else [os.path.abspath(file) for file in entry.files]
        return json.dumps(
            {
                "env_ids": list(entry.env_ids),
                "slow": entry.slow,
                "plans": entry.plans,
                "files": files,
            }
        ).encode()


def serve(requests: IO[bytes], replies: IO[bytes]) -> None:
    """Answers requests.

    Raises:
        OSError: if a pipe is closed.
    """
    server = _Server()
    methods: dict[int, Callable[..., bytes]] = {
        LOAD: server.load,
        RESET: server.reset,
        PREDICT: server.predict,
        DESCRIBE: server.describe,
    }
    while True:
        kind, request = receive_frame(requests)
        try:
            body = methods[kind](*pickle.loads(request))
        except BaseException as error:
            failure = FAILURE
            text = raised(error)
            index = None
            if isinstance(error, PolicyError):
                text = error.cause
                index = error.index
            elif kind == LOAD and isinstance(error, (ValueError, ImportError)):
                failure = INVALID
                text = str(error)
            send_frame(
                replies, failure, json.dumps({"error": text[:4000], "index": index}).encode()
            )
        else:
            send_frame(replies, ANSWER, body)


def main() -> None:
    """Keeps the two pipes for itself and serves them. Output of the policy goes to the null
    device."""
    requests = os.fdopen(os.dup(0), "rb")
    replies = os.fdopen(os.dup(1), "wb")
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(null, 1)
    _limit_resources()
    # the policy may change the environment variables
    parent = os.getppid()
    folder = tempfile.gettempdir()
    threading.Thread(target=_end_with, args=(parent, folder), daemon=True).start()
    with suppress(OSError):  # the parent process is gone, or the policy has closed the pipes
        serve(requests, replies)
    _remove(folder)
    os._exit(0)  # threads of the policy may still run


def _limit_resources() -> None:
    """Limits the memory, so that a policy that allocates without end fails before other processes
    do."""
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

    It differs between processes. A process inherits it, whatever its environment and session, so it
    tells which processes a policy has started.
    """
    import resource

    limit = int(_MEMORY_FRACTION * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    return limit - number


def _end_with(parent: int, folder: str) -> None:
    """Ends the process and its children when the parent process has ended, and removes the
    temporary files."""
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
