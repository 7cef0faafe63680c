"""The environment that the wrappers of a policy get: it returns the observations that it is given.

Wrappers call ``reset`` and ``step`` of an environment, but a policy is called with observations. :class:`Suspended`
turns this round: the wrappers run in a thread that waits wherever they step the environment.
"""

from __future__ import annotations

import queue
import threading
import weakref
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate
from numpy.typing import ArrayLike

from cablebot_gym.envs.observation import ObservationLayout
from cablebot_gym.policies.protocol import Array, BatchItemError
from cablebot_gym.task import Task
from cablebot_gym.utils.user_code import raised

Exchange = Callable[[Any], Any]
"""Hands out a value and waits for the answer."""

_STACK = 4 << 20
"""Size of the stack of a thread [bytes]. There may be many, and the memory of an isolated policy is limited."""

GROUP = 32
"""Number of rows that share a thread. Their calls are nested, so it is limited by Python's depth of recursion."""

UNEQUAL = (
    "the wrappers step the environments of a batch different numbers of times: pass a wrapper of the vector environment"
)
"""An error about wrappers of single environments."""

_JOIN = 1.0
"""Time to wait for the end of a thread [s]. Only code that catches every exception takes longer."""


class _StopError(BaseException):
    """Unwinds the wrappers of a batch that is over."""


class Suspended:
    """A function in a thread of its own, which runs only while :meth:`send` waits for it.

    Args:
        function: called with an :data:`Exchange` and the first value that is sent.
    """

    def __init__(self, function: Callable[[Exchange, Any], None]) -> None:
        channel = _Channel()
        self._channel = channel
        size = threading.stack_size(_STACK)
        try:
            thread = threading.Thread(target=_run, args=(function, channel), daemon=True)
            thread.start()
        finally:
            threading.stack_size(size)
        self.close = weakref.finalize(self, _end, channel, thread)
        """Ends the thread; also called when the object is collected and when the interpreter exits."""

    def send(self, value: Any) -> Any:
        """Resumes the function with a value, and returns the next value that it hands out.

        Raises:
            BaseException: whatever the function raises.
        """
        if not self.close.alive:
            raise RuntimeError("the wrappers of this batch have ended: start with state=None")
        self._channel.sent.put(value)
        error, answer = self._channel.handed.get()
        if error is not None:
            self.close()
            raise error
        return answer


class _Channel:
    def __init__(self) -> None:
        self.sent: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.handed: queue.SimpleQueue[tuple[BaseException | None, Any]] = queue.SimpleQueue()
        self.stopped = False

    def receive(self) -> Any:
        value = None if self.stopped else self.sent.get()
        if self.stopped:
            raise _StopError
        return value

    def exchange(self, value: Any) -> Any:
        self.handed.put((None, value))
        return self.receive()


def _run(function: Callable[[Exchange, Any], None], channel: _Channel) -> None:
    try:
        function(channel.exchange, channel.receive())
    except _StopError:
        pass
    except BaseException as error:
        channel.handed.put((error, None))


def _end(channel: _Channel, thread: threading.Thread) -> None:
    channel.stopped = True
    channel.sent.put(None)
    if thread is not threading.current_thread():
        thread.join(_JOIN)


class _Still:
    """What both forms of the stand-in share. Attributes of the true environment that are public knowledge."""

    layout: ObservationLayout
    _observation: Array
    _exchange: Exchange
    _tasks: Sequence[Task] | None
    _stepped = False

    def _reset(self) -> Array:
        if self._stepped:
            raise RuntimeError(
                "a wrapper resets the environment in the middle of an episode: leave wrappers that restart episodes out"
            )
        return self._observation.copy()

    def _step(self, action: Any) -> Array:
        self._stepped = True
        self._observation = self._exchange(np.array(action))
        return self._observation.copy()

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Public tasks of the episodes.

        Raises:
            RuntimeError: before the first episode.
        """
        if self._tasks is None:
            raise RuntimeError("the tasks are known from the first reset of the environment")
        return tuple(self._tasks)


class StandIn(_Still, VectorEnv[Array, Array, Array]):
    """Vector environment without physics: ``step`` hands out the actions and returns the observations that come back.

    Rewards are 0, info is empty and no episode ends. ``layout`` and ``tasks`` are those of the true environment.

    Args:
        layout: layout of the observation.
        observation: first observations, (N, size).
        exchange: takes the actions and returns the next observations.
        tasks: public tasks of the episodes; None if there is no episode yet.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - Gymnasium's

    def __init__(
        self,
        layout: ObservationLayout,
        cables: int,
        observation: Array,
        exchange: Exchange,
        tasks: Sequence[Task] | None = None,
    ) -> None:
        self.layout, self._observation, self._exchange, self._tasks = layout, observation, exchange, tasks
        self.num_envs = len(observation)
        self.single_observation_space = layout.space()
        self.single_action_space = Box(-1.0, 1.0, (cables,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """The first observations."""
        return self._reset(), {}

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """The observations after these actions."""
        return _still(self._step(actions), self.num_envs)


class SingleStandIn(_Still, gym.Env[Any, Any]):
    """Single environment without physics, one row of a :class:`Rows`."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's

    def __init__(self, rows: VectorEnv[Any, Any, Any], index: int, observation: Array, exchange: Exchange) -> None:
        inner: Any = rows.unwrapped
        self.layout, self._observation, self._exchange, self._rows, self._index = (
            *(inner.layout, observation, exchange),
            *(inner, index),
        )
        self.observation_space, self.action_space = rows.single_observation_space, rows.single_action_space

    @property
    def task(self) -> Task:
        """Public task of the episode."""
        return self._rows.tasks[self._index]

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """The first observation."""
        super().reset(seed=seed)
        return self._reset(), {}

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """The observation after this action."""
        return self._step(action), 0.0, False, False, {}


class Rows(VectorEnv[Any, Any, Any]):
    """A stack of single-environment wrappers for each row of a vector environment.

    Args:
        env: the vector environment.
        wrap: function that wraps a single environment.
        size: number of rows that share a thread, see :class:`_Group`; 1 if a step of the wrappers may step the
            environment several times.

    Raises:
        BatchItemError: if the wrappers of a row raise.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - Gymnasium's

    def __init__(self, env: VectorEnv[Any, Any, Any], wrap: Callable[[Any], Any], size: int = 1) -> None:
        self.env, self.num_envs, self.render_mode, self.inner_steps = env, env.num_envs, None, 0
        observation, _ = env.reset()
        self._parts = [slice(start, start + size) for start in range(0, self.num_envs, size)]
        self._threads: list[Suspended] = []
        with ExitStack() as failed:
            failed.callback(self.close)
            for part in self._parts:
                group = _Group(env, wrap, range(self.num_envs)[part])
                self._threads.append(Suspended(group.run))
            self.first = self._send(observation)[0][1]
            """The wrapped environment of the first row."""
            failed.pop_all()
        self.single_observation_space, self.single_action_space = self.first.observation_space, self.first.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def unwrapped(self) -> Any:
        """The stand-in."""
        return self.env.unwrapped

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """The first observations."""
        return self._observed([None] * self.num_envs), {}

    def step(self, actions: Any) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """The observations after these actions."""
        return _still(self._observed(list(iterate(self.action_space, actions))), self.num_envs)

    def close_extras(self, **_: Any) -> None:
        """Ends the threads."""
        for thread in self._threads:
            thread.close()

    def _observed(self, actions: Sequence[Any]) -> Any:
        answers, self.inner_steps = self._send(actions), 0
        while any(steps for steps, _ in answers):
            if not all(steps for steps, _ in answers):
                raise RuntimeError(UNEQUAL)
            self.inner_steps += 1
            answers = self._send(self.env.step(np.concatenate([inner for _, inner in answers]))[0])
        space, empty = self.single_observation_space, create_empty_array(self.single_observation_space, self.num_envs)
        return concatenate(space, [item for _, items in answers for item in items], cast(Any, empty))

    def _send(self, values: Any) -> list[tuple[bool, Any]]:
        """Resumes every thread with the values of its rows."""
        return [thread.send(values[part]) for thread, part in zip(self._threads, self._parts, strict=True)]


class _Group:
    """The wrappers of a few rows in one thread.

    The thread waits for all rows together: the step of a row's environment makes the step of the next row, and only
    that of the last row waits for the observations. This works if every wrapped step makes one such step.

    Args:
        env: the vector environment.
        wrap: function that wraps a single environment.
        indices: rows of the group.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], wrap: Callable[[Any], Any], indices: range) -> None:
        self._env, self._wrap, self._indices = env, wrap, indices
        self._actions: Sequence[Any] = []

    def run(self, exchange: Exchange, first: Array) -> None:
        """Makes the wrappers; then resets them if the messages are None, else steps them with these actions.

        Hands out pairs: ``(True, a)`` asks for the observations after the actions a of the robot, ``(False, x)`` has
        the wrapped observations x, at first the wrapped environment.
        """
        self._exchange = exchange
        self._singles = [self._called(place, self._made, place, observation) for place, observation in enumerate(first)]
        self._actions = exchange((False, self._singles[0]))
        while True:
            count = len(self._singles)
            self._inner: list[Any] = [None] * count
            self._results: list[Any] = [None] * count
            if self._actions[0] is None:
                self._results = [self._called(place, single.reset)[0] for place, single in enumerate(self._singles)]
            else:
                self._step(0)
            if any(result is None for result in self._results):
                raise RuntimeError(UNEQUAL)
            self._actions = exchange((False, self._results))

    def _made(self, place: int, observation: Array) -> Any:
        single = self._wrap(SingleStandIn(self._env, self._indices[place], observation, partial(self._stepped, place)))
        if not isinstance(single, gym.Env):
            raise TypeError(f"it returned {type(single).__name__} instead of an environment")
        return single

    def _called(self, place: int, function: Callable[..., Any], *arguments: Any) -> Any:
        """The result of code of a row."""
        try:
            return function(*arguments)
        except BatchItemError:
            raise
        except Exception as error:
            raise BatchItemError(self._indices[place], raised(error, "a wrapper raised")) from error

    def _step(self, place: int) -> None:
        """Steps the wrappers of a row."""
        self._results[place] = self._called(place, self._singles[place].step, self._actions[place])[0]

    def _stepped(self, place: int, action: Any) -> Array:
        """The step of the environment of a row."""
        count = len(self._singles)
        if count > 1 and self._inner[place] is not None:
            raise BatchItemError(self._indices[place], UNEQUAL)
        self._inner[place] = action
        if place + 1 < count:
            self._step(place + 1)
        else:
            self._observation = self._exchange((True, np.stack(self._inner)))
        return self._observation[place]


def _still(observation: Any, count: int) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
    """A step of a vector environment without reward, end and info."""
    return observation, np.zeros(count), np.zeros(count, np.bool_), np.zeros(count, np.bool_), {}


def as_vec_env(env: VectorEnv[Any, Any, Any]) -> Any:
    """A vector environment of Gymnasium as a ``VecEnv`` of Stable-Baselines3 (extra ``sb3``)."""
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

    class Adapter(VecEnv):
        """The stand-in in the form of Stable-Baselines3."""

        def __init__(self) -> None:
            self.env = env
            super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

        def reset(self) -> VecEnvObs:
            return env.reset()[0]

        def step_async(self, actions: Array) -> None:
            self._actions = actions

        def step_wait(self) -> VecEnvStepReturn:
            observation, reward, terminated, _, _ = env.step(self._actions)
            return observation, reward, terminated, [{} for _ in range(self.num_envs)]

        def close(self) -> None:
            pass

        def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
            return [getattr(env, attr_name)] * self.num_envs

        def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
            raise NotImplementedError("the attributes of the environment cannot be set")

        def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
            raise NotImplementedError("the environment has no further methods")

        def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
            return [False] * self.num_envs

    return Adapter()
