"""The process of an isolated policy, which :mod:`cablebot_gym.isolation.process` starts.

It imports and loads the policy once. Each batch of episodes gets a fork of it, so the policy
remembers nothing of earlier batches, and a batch does not pay for imports. A process with several
threads or of a stochastic policy is not forked: it serves a single batch.

Requests and replies are frames: :data:`HEADER` and a body. The judge pickles its requests. Replies
are numbers or JSON, because the judge must never unpickle what a policy can have written.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import pickle
import shutil
import signal
import struct
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.policies.protocol import PolicyError, called, declarations, reset_policy, shaped
from cablebot_gym.policies.spec import load
from cablebot_gym.policies.wrappers import PolicyEnv, run_policy
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.user_code import raised

HEADER = struct.Struct("<BQ")
"""Header of a frame: kind, number of bytes of the body."""

LOAD, START, RESET, PREDICT, END = range(5)
"""Kinds of requests. ``START`` and ``END`` enclose a batch of a process that forks."""

ANSWER, FAILURE, INVALID, ENDED = range(4)
"""Kinds of replies: a result; JSON of an error of the policy; JSON of a policy that cannot be loaded;
JSON of the exit code of the process of a batch."""

_LARGEST_ERROR = 4000
"""Largest number of characters of an error."""

_MEMORY_FRACTION = 0.5
"""Fraction of the machine's memory that the process may allocate (Linux)."""

_WATCH_PERIOD = 1.0
"""Time between two checks whether the judge is alive [s]."""

_SUBREAPER = 36
"""Option of ``prctl``: processes that lose their parent become children of this process (Linux)."""


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


def make_folders(folder: Path) -> dict[str, str]:
    """Makes an empty home, working folder and folder for temporary files in a folder, and returns
    the environment variables that name them."""
    for name in ("home", "work", "tmp"):
        (folder / name).mkdir()
    variables = dict.fromkeys(("HOME", "USERPROFILE"), str(folder / "home"))
    return variables | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder / "tmp"))


class _Server:
    """A policy and its state.

    Args:
        requests: pipe of the requests.
        replies: pipe of the replies.
    """

    def __init__(self, requests: IO[bytes], replies: IO[bytes]) -> None:
        self._requests, self._replies = requests, replies
        self._tasks: tuple[Task, ...] = ()

    def load(self, name: str, robot: Any, path: list[str], wrappers: tuple[str, ...] = ()) -> bytes:
        """Loads the policy and returns its declarations as JSON."""
        sys.path[:] = path
        loaded = load(name, robot, wrappers=wrappers)
        self._policy = loaded.policy
        self._robot: Robot = robot
        self._state = None
        declared = declarations(self._policy)
        described = declared._asdict() | {
            "wrappers": loaded.wrappers,
            "alone": loaded.alone,
            "fallbacks": hasattr(self._policy, "fallbacks"),
            # forks would repeat the random numbers
            "forks": _can_fork() and not declared.stochastic,
        }
        return json.dumps(described).encode()

    def start(self) -> bytes:
        """Starts a batch."""
        return b""

    def reset(self, tasks: Any) -> bytes:
        """Resets the policy."""
        self._state = None
        self._tasks = tasks
        reset_policy(self._policy, "", lambda: tasks)
        return b""

    def predict(self, observation: Any, start: Any, fresh: bool) -> bytes:
        """Actions as float64, followed by the number of fallbacks, which is NaN if the policy does
        not count them.

        A policy with wrappers makes all steps of the batch here, until an error or the end of the
        process.
        """
        self._rows = len(observation)
        if hasattr(self._policy, "wrap"):
            layout, cables = observation_layout(self._robot), self._robot.cables
            env = PolicyEnv(layout, cables, observation, self._advance, lambda: self._tasks)
            run_policy(self._policy, env)
        state = None if fresh else self._state
        actions, self._state = called(self._policy, observation, state, start)
        return self._reply(actions)

    def _advance(self, actions: Any) -> Any:
        """Sends actions and receives the next observations.

        Raises:
            PolicyError: if the actions are invalid, or if another batch begins.
        """
        send_frame(self._replies, ANSWER, self._reply(actions))
        kind, request = receive_frame(self._requests)
        if kind == END:
            os._exit(0)
        observation, _, fresh = pickle.loads(request)
        if fresh:
            raise PolicyError("with wrappers, call reset(tasks) before each batch")
        return observation

    def _reply(self, actions: Any) -> bytes:
        fallbacks = math.nan
        with suppress(Exception):
            fallbacks = float(getattr(self._policy, "fallbacks", math.nan))
        return shaped(actions, self._rows, self._robot.cables).tobytes() + struct.pack(
            "<d", fallbacks
        )


def serve(requests: IO[bytes], replies: IO[bytes]) -> None:
    """Answers requests, those of a batch in a fork.

    Raises:
        OSError: if a pipe is closed.
    """
    server = _Server(requests, replies)
    methods: dict[int, Callable[..., bytes]] = {
        LOAD: server.load,
        START: server.start,
        RESET: server.reset,
        PREDICT: server.predict,
    }
    while True:
        kind, request = receive_frame(requests)
        if kind == END:
            os._exit(0)  # threads of the policy may still run
        if kind == START:
            folder = Path(tempfile.mkdtemp())
            exit_code = _fork(folder)
            if exit_code is not None:
                shutil.rmtree(folder, ignore_errors=True)
                send_frame(replies, ENDED, json.dumps(exit_code).encode())
                continue
        try:
            body = methods[kind](*pickle.loads(request))
        except BaseException as error:
            failure, description = _described(error, is_loading=kind == LOAD)
            send_frame(replies, failure, description)
        else:
            send_frame(replies, ANSWER, body)


def _described(error: BaseException, *, is_loading: bool) -> tuple[int, bytes]:
    """Kind and body of the reply for an error."""
    failure = FAILURE
    text = raised(error)
    index = None
    if isinstance(error, PolicyError):
        text = error.cause
        index = error.index
    elif is_loading and isinstance(error, (ValueError, ImportError)):
        failure = INVALID
        text = str(error)
    return failure, json.dumps({"error": text[:_LARGEST_ERROR], "index": index}).encode()


def _can_fork() -> bool:
    """Whether a fork of this process works like it: a fork has no other threads."""
    return sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1


def _fork(folder: Path) -> int | None:
    """Forks this process. In the fork it returns None, with home, working folder and temporary files
    in a folder. Here it waits for the fork, and returns its exit code, which is negative for a
    signal. If the judge ends meanwhile, it ends the whole group of processes."""
    judge = os.getppid()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})
    child = os.fork()
    if child == 0:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
        os.environ.update(make_folders(folder))
        os.chdir(folder / "work")
        tempfile.tempdir = None
        return None
    while True:
        signal.sigtimedwait({signal.SIGCHLD}, _WATCH_PERIOD)
        if os.getppid() != judge:
            os.killpg(0, signal.SIGKILL)
        ended = -1
        while ended != 0:  # also processes that the policy has left
            ended, status = os.waitpid(-1, os.WNOHANG)
            if ended == child:
                return os.waitstatus_to_exitcode(status)


def main() -> None:
    """Keeps the two pipes for itself and serves them. Output of the policy goes to the null
    device."""
    requests = os.fdopen(os.dup(0), "rb")
    replies = os.fdopen(os.dup(1), "wb")
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(null, 1)
    if sys.platform == "linux":
        _prepare_linux()
    with suppress(OSError):  # the judge is gone, or the policy has closed the pipes
        serve(requests, replies)
    os._exit(0)  # threads of the policy may still run


def _prepare_linux() -> None:
    """Makes this process the parent of all that the policy leaves behind, and limits the memory, so
    that a policy that allocates without end fails before other processes do."""
    import resource

    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    memory = int(_MEMORY_FRACTION * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
