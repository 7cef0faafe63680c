"""Wrappers of a policy's training, around a stand-in that returns the observations that it is
given.

Wrappers call ``reset`` and ``step`` of an environment, but a policy is called with observations.
:class:`Coroutine` turns this round: the wrappers pause wherever they step the environment.
"""

from __future__ import annotations

import pickle
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from greenlet import getcurrent, greenlet
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate
from gymnasium.wrappers.vector import TransformObservation
from numpy.typing import ArrayLike

from cablebot_gym.envs.observation import ObservationLayout, observation_layout
from cablebot_gym.policies.protocol import Array, BatchItemError, Policy
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.foreign import foreign_bytes
from cablebot_gym.utils.imports import import_object
from cablebot_gym.utils.user_code import raised

Wrapper = str | Path | Callable[[Any], Any]
"""A wrapper of the training: a class or function that takes an environment and returns the wrapped
one, its name ``package.module:name`` or ``file.py:name``, a file ``.pkl`` with the ``VecNormalize``
of Stable-Baselines3, or :data:`NORMALISED`. The environment is a vector environment of Gymnasium, a
single one, or a ``VecEnv``: the first form that the wrapper accepts."""

NORMALISED = "normalised_observation"
"""Name of the wrapper that does what the environment's keyword of this name does."""

VECTOR = "vector environment"
SINGLE = "single environment"
SB3 = "VecEnv"
"""Forms of wrappers."""

UNEQUAL = (
    "the wrappers step the environments of a batch different numbers of times: "
    "pass a wrapper of the vector environment"
)
"""An error about wrappers of single environments."""


class Coroutine:
    """A function that runs only while :meth:`send` waits for it, and hands out values with
    :func:`pause`.

    It ends when the object is collected.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._greenlet = greenlet(function)
        # Paused greenlets hold their callers. In such a cycle they are never collected by
        # themselves.
        weakref.finalize(self, _end, self._greenlet)

    def send(self, *values: Any) -> Any:
        """Resumes the function with values, and returns what it hands out or returns next.

        Raises:
            BaseException: whatever the function raises.
        """
        if self._greenlet.dead:
            raise RuntimeError("the wrappers of this batch have ended: start with state=None")
        self._greenlet.parent = getcurrent()
        return self._greenlet.switch(*values)


def pause(value: Any) -> Any:
    """Hands a value out of the present :class:`Coroutine`, and returns what is sent to it next."""
    caller = getcurrent().parent
    assert caller is not None
    return caller.switch(value)


def _end(paused: greenlet) -> None:
    if paused:
        paused.parent = getcurrent()
        paused.throw()


class _Still:
    """What both forms of the stand-in share. Attributes of the true environment that are public
    knowledge."""

    layout: ObservationLayout
    _observation: Array
    _exchange: Callable[[Array], Array]
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


class _Vector(VectorEnv[Any, Any, Any]):
    """A vector environment with equal spaces in which no episode ends."""

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - Gymnasium's

    def _set_spaces(self, count: int, observation_space: Any, action_space: Any) -> None:
        self.num_envs = count
        self.single_observation_space = observation_space
        self.single_action_space = action_space
        self.observation_space = batch_space(observation_space, count)
        self.action_space = batch_space(action_space, count)

    def _still(self, observation: Any) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """A step without reward, end and info."""
        never = np.zeros(self.num_envs, np.bool_)
        return observation, np.zeros(self.num_envs), never, never.copy(), {}


class StandIn(_Still, _Vector):
    """Vector environment without physics: ``step`` hands out the actions and returns the
    observations that come back.

    Rewards are 0, info is empty and no episode ends. ``layout`` and ``tasks`` are those of the true
    environment.

    Args:
        layout: layout of the observation.
        cables: number of cables m.
        observation: first observations, (N, size).
        exchange: takes the actions (N, m) and returns the next observations.
        tasks: public tasks of the episodes; None if there is no episode yet.
    """

    def __init__(
        self,
        layout: ObservationLayout,
        cables: int,
        observation: Array,
        exchange: Callable[[Array], Array],
        tasks: Sequence[Task] | None = None,
    ) -> None:
        self.layout = layout
        self._observation = observation
        self._exchange = exchange
        self._tasks = tasks
        self._set_spaces(
            len(observation), layout.space(), Box(-1.0, 1.0, (cables,), dtype=np.float32)
        )

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Public tasks of the episodes.

        Raises:
            RuntimeError: before the first episode.
        """
        if self._tasks is None:
            raise RuntimeError("the tasks are known from the first reset of the environment")
        return tuple(self._tasks)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """The first observations."""
        return self._reset(), {}

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """The observations after these actions."""
        return self._still(self._step(actions))


class SingleStandIn(_Still, gym.Env[Any, Any]):
    """Single environment without physics, one row of a :class:`Rows`."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's

    def __init__(self, vector: VectorEnv[Any, Any, Any], index: int, observation: Array) -> None:
        innermost: Any = vector.unwrapped
        self.layout, self._vector = innermost.layout, innermost
        self._index = index
        self._observation = observation
        self._exchange = pause
        self.observation_space = vector.single_observation_space
        self.action_space = vector.single_action_space

    @property
    def task(self) -> Task:
        """Public task of the episode."""
        task: Task = self._vector.tasks[self._index]
        return task

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """The first observation."""
        super().reset(seed=seed)
        return self._reset(), {}

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """The observation after this action."""
        return self._step(action), 0.0, False, False, {}


class Rows(_Vector):
    """A stack of single-environment wrappers for each row of a vector environment.

    Args:
        env: the vector environment.
        wrap: function that wraps a single environment.

    Raises:
        BatchItemError: if the wrappers of a row raise.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], wrap: Callable[[Any], Any]) -> None:
        self.env = env
        self.num_envs = env.num_envs
        self.render_mode = None
        observation, _ = env.reset()

        def wrapped_row(index: int) -> Any:
            single = wrap(SingleStandIn(env, index, observation[index]))
            if not isinstance(single, gym.Env):
                raise TypeError(f"it returned {type(single).__name__} instead of an environment")
            return single

        # One for each row and all its steps: to make a greenlet takes as long as several steps.
        self._greenlets = [greenlet(partial(_call_row, index)) for index in range(env.num_envs)]
        self._rows = self._run([partial(wrapped_row, index) for index in range(env.num_envs)])
        self.first = self._rows[0]
        """The wrapped environment of the first row."""
        self._set_spaces(env.num_envs, self.first.observation_space, self.first.action_space)

    @property
    def unwrapped(self) -> Any:
        """The stand-in."""
        return self.env.unwrapped

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """The first observations."""
        return self._observed([row.reset for row in self._rows]), {}

    def step(self, actions: Any) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """The observations after these actions."""
        pairs = zip(self._rows, iterate(self.action_space, actions), strict=True)
        return self._still(self._observed([partial(row.step, action) for row, action in pairs]))

    def _observed(self, calls: Sequence[Callable[[], Any]]) -> Any:
        space = self.single_observation_space
        empty = create_empty_array(space, self.num_envs)
        return concatenate(space, [answer[0] for answer in self._run(calls)], cast(Any, empty))

    def _run(self, calls: Sequence[Callable[[], Any]]) -> list[Any]:
        """The result of a call for each row. All calls step the environment together."""
        answers = [row.switch(call) for row, call in zip(self._greenlets, calls, strict=True)]
        while True:
            finished = [isinstance(answer, _Result) for answer in answers]
            if all(finished):
                return [answer.value for answer in answers]
            if any(finished):
                raise RuntimeError(UNEQUAL)
            observation = self.env.step(np.stack(answers))[0]
            answers = [row.switch(observation[index]) for index, row in enumerate(self._greenlets)]


@dataclass(frozen=True)
class _Result:
    value: Any


def _call_row(index: int, call: Callable[[], Any]) -> None:
    """Runs calls of a row. It pauses in their steps of the environment, and with the
    :class:`_Result` of each call."""
    try:
        while True:
            call = pause(_Result(call()))
    except BatchItemError:
        raise
    except Exception as error:
        raise BatchItemError(index, raised(error, "a wrapper raised")) from error


def as_vec_env(env: VectorEnv[Any, Any, Any]) -> Any:
    """A vector environment of Gymnasium as a ``VecEnv`` of Stable-Baselines3 (extra ``sb3``)."""
    from stable_baselines3.common.vec_env.base_vec_env import (
        VecEnv,
        VecEnvIndices,
        VecEnvObs,
        VecEnvStepReturn,
    )

    class VecEnvStandIn(VecEnv):
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

        def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
            return [False] * self.num_envs

        def env_method(self, method_name: str, *args: Any, **kwargs: Any) -> list[Any]:
            raise NotImplementedError(
                "the environment has no further methods, and its attributes cannot be set"
            )

        set_attr: Any = env_method

    return VecEnvStandIn()


def normalised_observation(env: Any) -> VectorEnv[Any, Any, Any]:
    """Observations of order one, as from the environment with the keyword
    ``normalised_observation``."""
    layout: ObservationLayout = env.unwrapped.layout
    return TransformObservation(
        env, layout.normalise, single_observation_space=layout.space(normalised=True)
    )


@dataclass(frozen=True, kw_only=True)
class NamedWrapper:
    """A wrapper with its name in messages and the forms in which it may be tried."""

    name: str
    """Name, as the user gave it if it is text."""
    wrap: Callable[[Any], Any]
    """Function that wraps an environment."""
    forms: tuple[str, ...] = (VECTOR, SINGLE, SB3)
    """Forms to try, in this order."""

    @classmethod
    def of(cls, wrapper: Any) -> NamedWrapper:
        """The wrapper that a user gives.

        Raises:
            ValueError: if it is not a :data:`Wrapper`, or if its code cannot be imported.
        """
        if isinstance(wrapper, NamedWrapper):
            return wrapper
        if isinstance(wrapper, (str, Path)):
            name = str(wrapper)
            if name == NORMALISED:
                return cls(name=name, wrap=normalised_observation, forms=(VECTOR,))
            try:
                if name.endswith(".pkl"):
                    return statistics(name, foreign_bytes(Path(name)))
                wrap = import_object(name)
            except OSError as error:
                raise ValueError(f"cannot read wrapper {name!r}: {error.strerror}") from error
            except Exception as error:
                raise ValueError(f"wrapper {name!r}: cannot import it ({error})") from error
        else:
            name = getattr(wrapper, "__name__", None) or type(wrapper).__name__
            wrap = wrapper
        if not callable(wrap):
            raise ValueError(
                f"wrapper {name!r} must be a function or class that takes an environment, such as file.py:name, "
                "or a .pkl file of VecNormalize"
            )
        bases = {kind.__name__ for kind in wrap.__mro__} if isinstance(wrap, type) else set()
        for base, form in (("VectorWrapper", VECTOR), ("Wrapper", SINGLE), ("VecEnvWrapper", SB3)):
            if base in bases:
                return cls(name=name, wrap=wrap, forms=(form,))
        return cls(name=name, wrap=wrap)

    def applied(self, form: str, env: Any) -> Any:
        """An environment in this wrapper.

        Raises:
            TypeError: if the wrapper returns anything but an environment of the form.
        """
        if form == SINGLE:
            return Rows(env, self.wrap)
        if form == SB3 and isinstance(env, VectorEnv):
            env = as_vec_env(env)
        wrapped = self.wrap(env)
        if not (
            isinstance(wrapped, VectorEnv) if form == VECTOR else hasattr(wrapped, "step_wait")
        ):
            raise TypeError(f"it returned {type(wrapped).__name__}")
        return wrapped

    def tried(self, env: Any) -> tuple[str, Any]:
        """The first form that the wrapper accepts, and the environment in it.

        Raises:
            ValueError: if the wrapper raises in every form.
        """
        errors = []
        for form in self.forms:
            if form != SB3 and not isinstance(env, VectorEnv):
                cause = "it must stand before the wrappers of Stable-Baselines3's VecEnv"
            else:
                try:
                    return form, self.applied(form, env)
                except ImportError as error:
                    cause = f"{error}: pip install 'cablebot-gym[sb3]'"
                except KeyboardInterrupt:
                    raise
                except BaseException as error:
                    explained = isinstance(error, BatchItemError) or self.forms == (SB3,)
                    cause = str(error) if explained else raised(error)
            errors.append(cause if len(self.forms) == 1 else f"around a {form} {cause}")
        raise ValueError(f"wrapper {self.name!r}: {'; '.join(errors)}")


def statistics(name: str, data: bytes) -> NamedWrapper:
    """The wrapper of a pickled ``VecNormalize``, with frozen statistics. A pickle can execute any
    code."""
    return NamedWrapper(name=name, wrap=partial(_vec_normalize, data), forms=(SB3,))


def _vec_normalize(data: bytes, env: Any) -> Any:
    try:
        normalize = pickle.loads(data)
    except Exception as error:
        raise ValueError(
            f"it is no pickle of VecNormalize, or one of another version ({error})"
        ) from error
    if not hasattr(normalize, "set_venv"):
        raise ValueError(f"it holds {type(normalize).__name__}; save it by VecNormalize.save")
    normalize.training = normalize.norm_reward = False
    if normalize.observation_space.shape != env.observation_space.shape:
        saved, present = (
            " × ".join(map(str, each.observation_space.shape)) for each in (normalize, env)
        )
        raise ValueError(
            f"its statistics are those of {saved} numbers, but the environment has {present}"
        )
    normalize.set_venv(env)
    normalize.observation_space = env.observation_space  # the pickle has that of the training
    return normalize


class Stack:
    """Wrappers of a policy for a robot, tried once around an environment of one row.

    Args:
        wrappers: the wrappers, the innermost first.
        robot: nominal robot.

    Raises:
        ValueError: if a wrapper raises, fits no form, or goes on learning.
    """

    def __init__(self, wrappers: Sequence[Wrapper | NamedWrapper], robot: Robot) -> None:
        if isinstance(wrappers, (str, Path)) or callable(wrappers):
            raise ValueError(f"wrappers must be a list, such as [{wrappers!r}], not one wrapper")
        self.robot, self.layout = robot, observation_layout(robot)
        self.wrappers = tuple(NamedWrapper.of(wrapper) for wrapper in wrappers)
        layers = self.layers()
        env = layers[0]
        kinds = {kind.__name__ for layer in layers for kind in type(layer).__mro__}
        self.normalises = "VecNormalize" in kinds
        """Whether a ``VecNormalize`` is among the wrappers."""
        single = not isinstance(env, VectorEnv)
        self.observation_space = env.observation_space if single else env.single_observation_space
        self.action_space = env.action_space if single else env.single_action_space

    def layers(self) -> list[Any]:
        """An environment of one row in these wrappers, and all that it wraps, the outermost first.

        Raises:
            ValueError: if a wrapper raises, fits no form, or goes on learning.
        """
        space = self.layout.space()
        observation = np.clip(np.zeros((1, self.layout.size)), space.low, space.high)
        env: Any = StandIn(self.layout, self.robot.cables, observation, lambda _: observation)
        self._forms = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for wrapper in self.wrappers:
                form, env = wrapper.tried(env)
                self._forms.append(form)
        layers = list(_layers(env))
        for layer in layers:
            _check_frozen(layer)
        return layers

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the wrappers, the innermost first."""
        return tuple(wrapper.name for wrapper in self.wrappers)

    def normalised(self) -> Stack:
        """A stack with :data:`NORMALISED` inside these wrappers."""
        return Stack([NORMALISED, *self.wrappers], self.robot)

    def run(
        self,
        policy: Policy,
        tasks: Sequence[Task] | None,
        observation: Array,
        starts: Array,
        deterministic: bool,
    ) -> None:
        """Runs policy and wrappers in a :class:`Coroutine` until an exception ends it.

        Hands out the actions (N, m) of the robot, and gets the next arguments.

        Args:
            policy: the policy, which gets wrapped observations.
            tasks: public tasks of the episodes.
            observation: observations, (N, size).
            starts: True at the first step of an episode, (N,).
            deterministic: passed to the policy.
        """

        def exchange(actions: Array) -> Array:
            nonlocal starts, deterministic
            observation, started, deterministic = pause(actions)
            starts = starts | started
            return cast(Array, observation)

        env: Any = StandIn(self.layout, self.robot.cables, observation, exchange, tasks)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the training has shown them
            for form, pairs in groupby(
                zip(self._forms, self.wrappers, strict=True), key=itemgetter(0)
            ):
                wrappers = [wrapper for _, wrapper in pairs]
                if form == SINGLE:  # once for each row, whatever the number of wrappers
                    env = Rows(env, partial(reduce, _wrap, wrappers))
                    continue
                for wrapper in wrappers:
                    env = wrapper.applied(form, env)
        wrapped = env.reset()
        if isinstance(env, VectorEnv):
            wrapped = wrapped[0]
        state = None
        while True:
            started, starts = starts, np.zeros_like(starts)
            actions, state = policy.predict(
                wrapped, state=state, episode_start=started, deterministic=deterministic
            )
            wrapped = env.step(actions)[0]


def _wrap(env: Any, wrapper: NamedWrapper) -> Any:
    return wrapper.wrap(env)


def _layers(env: Any) -> Iterator[Any]:
    """The environment and all that it wraps, from outside; of rows, the wrappers of the first row
    too."""
    while env is not None:
        yield env
        if isinstance(env, Rows):
            yield from _layers(env.first)
        inner = vars(env)
        env = inner.get("env") or inner.get("venv")


def _check_frozen(layer: Any) -> None:
    """Raises a ValueError if a wrapper updates its statistics."""
    for name in ("update_running_mean", "training"):
        if "obs_rms" in vars(layer) and getattr(layer, name, False) is True:
            raise ValueError(
                f"wrapper {type(layer).__name__} goes on learning while the policy is judged. In the function that "
                f"makes it, set its statistics, obs_rms, to those of the training and {name} = False"
            )
