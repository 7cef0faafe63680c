"""Policies in processes of their own. They get observations and public tasks, and return
actions."""

from __future__ import annotations

import json
import math
import os
import pickle
import queue
import struct
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from cablebot_gym.isolation.deadlines import DEADLINE, Deadlines
from cablebot_gym.isolation.process import EndedError, PolicyProcess, ProcessorTimeError, plain
from cablebot_gym.isolation.sandbox import prepare_sandbox
from cablebot_gym.isolation.server import ANSWER, FAILURE, INVALID, LOAD, PREDICT, RESET
from cablebot_gym.policies.protocol import Array, LoadedPolicy, PolicyError, declarations, say
from cablebot_gym.policies.spec import PolicySpec, as_robot
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task


class IsolatedPolicy:
    """A policy in a process of its own, with a fresh process for each batch of episodes.

    The process gets the nominal robot, observations and public tasks, some environment variables,
    and a folder of its own for temporary files. It knows neither the environment nor the
    evaluation. Its working directory is that of this process, so that files given by relative paths
    are found.

    Every misbehaviour of the policy is a :class:`~cablebot_gym.policies.protocol.PolicyError`: an
    exception, an end of its process, no answer before the deadline, invalid actions or invalid
    data. The process is then ended, and on Linux all processes that have inherited its memory
    limit, so all that it has started unless it changes that limit. Other processes and files of the
    same user are protected from the policy only in a sandbox.

    Args:
        name: name of the policy, as on the command line.
        robot: nominal robot.
        deadline: largest processor time of a call [s]; > 0. Loading, reset and first call for a
            batch together may take :data:`~cablebot_gym.isolation.deadlines.START_UP` times as
            long, and all calls for all batches :data:`~cablebot_gym.isolation.deadlines.TOTAL`
            times. The elapsed time may be :data:`~cablebot_gym.isolation.deadlines.WAITING` times
            as long, that of all calls
            :data:`~cablebot_gym.isolation.deadlines.WAITING_FOR_ALL` times.
        wrappers: names of the wrappers of the training, the innermost first, see
            :data:`~cablebot_gym.policies.wrappers.Wrapper`. They run in the process of the policy.
        sandbox: whether the process runs in a sandbox without network, other processes, and most
            files, see :func:`~cablebot_gym.isolation.sandbox.sandboxed`.

    Raises:
        ValueError: if the name is unknown or the policy cannot be loaded, if a wrapper is given by
            an object, or if there is no sandbox.
        PolicyError: if the process of the policy ends or does not answer while the policy is
            loaded.
    """

    def __init__(
        self,
        name: str,
        robot: Robot | str,
        *,
        deadline: float = DEADLINE,
        wrappers: Sequence[str | Path] = (),
        sandbox: bool = False,
    ) -> None:
        self.name = name
        self._process: PolicyProcess | None = None
        self._fresh = False
        self._deadlines = Deadlines(deadline)
        self._spec = PolicySpec.parse(name)
        robot = as_robot(robot)
        self._cables = robot.cables
        if not all(isinstance(wrapper, (str, Path)) for wrapper in wrappers):
            raise ValueError(
                "an isolated policy takes the names of its wrappers, such as file.py:name: its process imports them"
            )
        wrapper_names = tuple(map(str, wrappers))
        self._sandboxed_names: tuple[str, ...] | None = None
        if sandbox:
            prepare_sandbox(robot)
            self._sandboxed_names = (self._spec.target, *wrapper_names)
        self._load = pickle.dumps((name, robot, search_path(), wrapper_names))
        described = self._start()
        declared = declarations(SimpleNamespace(**described))
        self.unsaturated_actions = declared.unsaturated_actions
        self.stochastic = declared.stochastic
        self.measurement = plain(declared.measurement)
        self.wrappers = _texts(described.get("wrappers"))
        """Names of the wrappers, the innermost first, with those that were found beside the
        policy."""
        self._notes = _texts(described.get("notes"))
        for note in self._notes:
            say(note)
        self.fallbacks: float | None = 0.0 if described.get("fallbacks") is True else None
        """Number of fallbacks that the policy has counted; None if it does not count them."""

    @property
    def loaded(self) -> LoadedPolicy:
        """This policy for evaluations."""
        return LoadedPolicy(
            policy=self,
            name=self.name,
            declarations=declarations(self),
            held=self._spec.held and not self.wrappers,
            shipped=self._spec.shipped and not self.wrappers,
            isolated=True,
            wrappers=self.wrappers,
            notes=self._notes,
        )

    def reset(self, tasks: Sequence[Task]) -> None:
        """Starts a fresh process and passes the tasks, one for each observation of the batch, to
        its policy.

        Raises:
            ValueError: if the tasks cannot be pickled, for example because a motion is defined
                inside a function.
            PolicyError: if the policy fails.
        """
        try:
            request = pickle.dumps((tuple(tasks),))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ValueError(f"the tasks cannot be passed to another process: {error}") from error
        if self._process is None or not self._fresh:
            self._start()
        self._fresh = False
        self._ask(RESET, request)

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions of the policy for a batch (N, size) or one observation (size,); the state is the
        number of calls.

        The state of the policy stays in its process. ``state=None`` starts with no state.

        Raises:
            PolicyError: if the policy fails.
        """
        rows = np.atleast_2d(observation)
        starts = (
            np.zeros(len(rows), np.bool_) if episode_start is None else np.atleast_1d(episode_start)
        )
        if self._process is None:
            self._start()
        self._fresh = False
        size = 8 * len(rows) * self._cables
        reply = self._ask(PREDICT, pickle.dumps((rows, starts, state is None), 5), size + 8)
        if len(reply) != size + 8:
            raise self._failed("its process sent invalid data")
        self._deadlines.finish_start_up()
        (fallbacks,) = struct.unpack("<d", reply[size:])
        if self.fallbacks is not None and math.isfinite(fallbacks) and fallbacks >= 0:
            self.fallbacks = fallbacks
        actions = np.frombuffer(reply[:size]).reshape(len(rows), self._cables).copy()
        return (actions if np.ndim(observation) > 1 else actions[0]), (state or 0) + 1

    def close(self) -> None:
        """Ends the process of the policy and all processes that it has started. The next call
        starts a new one."""
        if self._process is not None:
            self._process.end()
            self._process = None

    def __enter__(self) -> IsolatedPolicy:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _start(self) -> dict[str, Any]:
        """Starts a process in place of the present one, loads the policy and returns its
        description."""
        self.close()
        self._process = PolicyProcess(self._sandboxed_names)
        self._deadlines.start_process()
        self._fresh = True  # it has only loaded the policy
        described = parse_json(self._ask(LOAD, self._load))
        if not isinstance(described, dict):
            raise self._failed("its process sent invalid data")
        return described

    def _ask(self, kind: int, request: bytes, largest: int = 0) -> bytes:
        """Body of the answer to a request, see
        :meth:`~cablebot_gym.isolation.process.PolicyProcess.exchange`."""
        process = self._process
        assert process is not None
        limits = self._deadlines.remaining()
        started = time.monotonic()
        try:
            reply_kind, body = process.exchange(
                kind, request, largest, limits.elapsed, limits.processor
            )
        except queue.Empty:
            raise self._failed(f"it did not answer within {limits.elapsed_words}") from None
        except ProcessorTimeError:
            raise self._failed(f"it used more than {limits.processor_words}") from None
        except EndedError as error:
            raise self._failed(str(error)) from None
        except BaseException:  # an interrupt
            self.close()
            raise
        finally:  # the time of a policy that fails counts too
            self._deadlines.wait(time.monotonic() - started, process.processor_time())
        if reply_kind == ANSWER:
            return body
        content = parse_json(body)
        if (
            reply_kind not in (FAILURE, INVALID)
            or not isinstance(content, dict)
            or "error" not in content
        ):
            raise self._failed("its process sent invalid data")
        cause = plain(content["error"])
        index = content.get("index")
        if reply_kind == INVALID:
            self.close()
            raise ValueError(cause)
        raise self._failed(cause, index if isinstance(index, int) else None)

    def _failed(self, cause: str, index: int | None = None) -> PolicyError:
        """Ends the process and makes an error."""
        self.close()
        return PolicyError.of(self.name, cause, index)


def search_path() -> list[str]:
    """Search path of modules for another process."""
    return [folder or os.getcwd() for folder in sys.path]


def parse_json(body: bytes) -> Any:
    """JSON data of a reply; None if it is invalid."""
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        return None


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(map(plain, value)) if isinstance(value, list) else ()
