"""Policies in processes of their own. They get observations and public tasks, and return
actions."""

from __future__ import annotations

import math
import os
import pickle
import struct
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from cablebot_gym.isolation.process import (
    DeadlineError,
    EndedError,
    PolicyProcess,
    parse_json,
    plain,
    search_path,
)
from cablebot_gym.isolation.server import (
    ANSWER,
    END,
    ENDED,
    INVALID,
    LOAD,
    PREDICT,
    RESET,
    START,
)
from cablebot_gym.policies.protocol import Array, LoadedPolicy, PolicyError, declarations
from cablebot_gym.policies.spec import POLICY_SUFFIXES, PolicySpec
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number

DEADLINE = 300.0
"""Default deadline of an answer of a policy [s of processor time]. An answer is loading, a reset, or
the actions of one control step of all episodes of a batch."""


class IsolatedPolicy:
    """A policy in a process of its own, with a fresh one for each batch of episodes.

    The process gets the nominal robot, observations and public tasks, and some environment
    variables. Home, working folder, cache and folder for temporary files are empty and its own. It
    knows neither the environment nor the evaluation. Relative names of files are those of this
    process.

    Every misbehaviour of the policy is a :class:`~cablebot_gym.policies.protocol.PolicyError`: an
    exception, an end of its process, no answer before the deadline, invalid actions or invalid
    data. The process is then ended, on Linux with all processes that it has started. Behind
    bubblewrap it has no network, sees no other process, and can read but not write the files of
    the machine; elsewhere it has the rights of its user.

    Args:
        name: name of the policy, as on the command line.
        robot: nominal robot.
        deadline: largest processor time of an answer [s]; > 0. The elapsed time may be
            :data:`~cablebot_gym.isolation.process.WAITING` times as long.
        wrappers: names of the wrappers of the training, the innermost first, see
            :data:`~cablebot_gym.policies.wrappers.Wrapper`. They run in the process of the policy.

    Raises:
        ValueError: if the name is unknown or the policy cannot be loaded, or if a wrapper is given
            by an object.
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
    ) -> None:
        self.name = name
        self._process: PolicyProcess | None = None
        self._is_fresh = False
        self._in_batch = False
        self._deadline = number("deadline", deadline, above=0, unit="s")
        self._spec = PolicySpec.parse(name)
        robot = find_robot(robot)
        self._cables = robot.cables
        if not all(isinstance(wrapper, (str, Path)) for wrapper in wrappers):
            raise ValueError(
                "an isolated policy takes the names of its wrappers, such as file.py:name: its process imports them"
            )
        _compile(robot)
        wrapper_names = tuple(_absolute(str(wrapper)) for wrapper in wrappers)
        self._target = _absolute(self._spec.target)
        loaded_name = name.removesuffix(self._spec.target) + self._target
        self._load = pickle.dumps((loaded_name, robot, search_path(), wrapper_names))
        described = self._start()
        self._forks = described.get("forks") is True
        declared = declarations(SimpleNamespace(**described))
        self.unsaturated_actions = declared.unsaturated_actions
        self.stochastic = declared.stochastic
        self.measurement = plain(declared.measurement)
        self.wrappers = _texts(described.get("wrappers"))
        """Names of the wrappers, the innermost first."""
        self.alone = described.get("alone") is True
        """Whether each episode runs alone, because a wrapper wraps a single environment."""
        self.fallbacks: float | None = 0.0 if described.get("fallbacks") is True else None
        """Number of fallbacks that the policy has counted; None if it does not count them."""

    @property
    def loaded(self) -> LoadedPolicy:
        """This policy for evaluations."""
        return LoadedPolicy(
            policy=self,
            name=self.name,
            declarations=declarations(self),
            shipped=self._spec.shipped and not self.wrappers,
            isolated=True,
            bubblewrap=self.bubblewrap,
            wrappers=self.wrappers,
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
        self._start_batch()
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
        if not self._in_batch:
            self._start_batch()
        size = 8 * len(rows) * self._cables
        reply = self._ask(PREDICT, pickle.dumps((rows, starts, state is None), 5), size + 8)
        if len(reply) != size + 8:
            raise self._failed("its process sent invalid data")
        (fallbacks,) = struct.unpack("<d", reply[size:])
        if self.fallbacks is not None and math.isfinite(fallbacks) and fallbacks >= 0:
            self.fallbacks = fallbacks
        actions = np.frombuffer(reply[:size]).reshape(len(rows), self._cables).copy()
        return (actions if np.ndim(observation) > 1 else actions[0]), (state or 0) + 1

    def close(self) -> None:
        """Ends the process of the policy and all processes that it has started. The next call
        starts a new one."""
        self._in_batch = False
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
        self._process = PolicyProcess()
        self.bubblewrap = self._process.is_behind_bubblewrap
        """Whether the process runs behind bubblewrap."""
        self._is_fresh = True  # it has only loaded the policy
        described = parse_json(self._ask(LOAD, self._load))
        if not isinstance(described, dict):
            raise self._failed("its process sent invalid data")
        return described

    def _start_batch(self) -> None:
        """Gives the next batch a process that has only loaded the policy: a fork of the present one,
        or a new one if it cannot be forked."""
        if self._process is not None and self._in_batch and self._forks:
            self._ask(END, b"")
        if self._process is None or not (self._is_fresh or self._forks):
            self._start()
        if self._forks:
            self._ask(START, pickle.dumps(()))
        self._in_batch = True
        self._is_fresh = False

    def _ask(self, kind: int, request: bytes, largest: int = 0) -> bytes:
        """Body of the answer to a request, see
        :meth:`~cablebot_gym.isolation.process.PolicyProcess.exchange`."""
        process = self._process
        assert process is not None
        try:
            reply_kind, body = process.exchange(kind, request, largest, self._deadline)
        except (DeadlineError, EndedError) as error:
            raise self._failed(str(error)) from None
        except BaseException:  # an interrupt
            self.close()
            raise
        if reply_kind == ANSWER or (reply_kind == ENDED and kind == END):
            return body
        content = parse_json(body)
        if reply_kind == ENDED and isinstance(content, int):
            raise self._failed(str(process.ended(content)))
        if not isinstance(content, dict):
            raise self._failed("its process sent invalid data")
        cause = plain(content.get("error"))
        index = content.get("index")
        if reply_kind == INVALID:
            self.close()
            raise ValueError(cause.replace(self._target, self._spec.target))
        raise self._failed(cause, index if isinstance(index, int) else None)

    def _failed(self, cause: str, index: int | None = None) -> PolicyError:
        """Ends the process and makes an error."""
        self.close()
        return PolicyError.of(self.name, cause, index)


def _absolute(name: str) -> str:
    """A name whose file, if it has one, is given by its absolute path: the process of the policy has
    another working folder."""
    file, _, attribute = name.rpartition(":")
    if file.endswith(".py"):
        return f"{os.path.abspath(file)}:{attribute}"
    if name.endswith((*POLICY_SUFFIXES, ".pkl")):
        return os.path.abspath(name)
    return name


def _compile(robot: Robot) -> None:
    """Compiles and stores the equations of a robot, which the processes of its policies call and
    could not store."""
    # numba takes a second, which other commands save
    from cablebot_gym.physics.inverse import inverse_dynamics

    pose = np.zeros(robot.coordinates)
    inverse_dynamics(robot, 1.0, pose, pose, pose)


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(map(plain, value)) if isinstance(value, list) else ()
