"""Policies that were trained behind wrappers: the same wrappers, around a stand-in of the environment."""

from __future__ import annotations

import logging
import pickle
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache, partial, reduce
from itertools import groupby
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv, VectorObservationWrapper

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.policies.protocol import Array, BatchItemError, Policy, declarations, reset_policy
from cablebot_gym.policies.stand_in import GROUP, Exchange, Rows, StandIn, Suspended, as_vec_env
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.imports import import_object
from cablebot_gym.utils.user_code import raised

_LOGGER = logging.getLogger("cablebot_gym")

Wrapper = str | Path | Callable[[Any], Any]
"""A wrapper of the training: a class or function that takes an environment and returns the wrapped one, its name
``package.module:name`` or ``file.py:name``, a file ``.pkl`` with the ``VecNormalize`` of Stable-Baselines3, or
:data:`NORMALISED`. The environment is a vector environment of Gymnasium, a single one, or a ``VecEnv``: the first form
that the wrapper accepts."""

NORMALISED = "normalised_observation"
"""Name of the wrapper that does what the environment's keyword of this name does."""

VECTOR, SINGLE, SB3 = "vector environment", "single environment", "VecEnv"
"""Forms of wrappers."""


class NormalisedObservation(VectorObservationWrapper):
    """Observations of order one, as from the environment with ``normalised_observation``."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self._layout = env.unwrapped.layout
        self.single_observation_space = self._layout.space(normalised=True)
        self.observation_space = gym.vector.utils.batch_space(self.single_observation_space, self.num_envs)

    def observations(self, observations: Array) -> Array:
        """The normalised observations."""
        normalised: Array = self._layout.normalise(observations)
        return normalised


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
        name, wrap = str(wrapper), wrapper
        if isinstance(wrapper, (str, Path)):
            if name == NORMALISED:
                return cls(name=name, wrap=NormalisedObservation, forms=(VECTOR,))
            if name.endswith(".pkl"):
                return statistics(name, _read(name))
            try:
                wrap = import_object(name)
            except Exception as error:
                raise ValueError(f"wrapper {name!r}: cannot import it ({error})") from error
        else:
            name = getattr(wrapper, "__name__", None) or type(wrapper).__name__
        if not callable(wrap):
            raise ValueError(
                f"wrapper {name!r} must be a function or class that takes an environment, such as file.py:name, "
                "or a .pkl file of VecNormalize"
            )
        return cls(name=name, wrap=wrap, forms=_forms(wrap))

    def applied(self, form: str, env: Any) -> Any:
        """An environment in this wrapper.

        Raises:
            TypeError: if the wrapper returns anything but an environment of the form.
        """
        if form == SINGLE:
            return Rows(env, self.wrap)
        wrapped = self.wrap(env if form == VECTOR or not isinstance(env, VectorEnv) else as_vec_env(env))
        if (isinstance(wrapped, VectorEnv) if form == VECTOR else hasattr(wrapped, "step_wait")) is False:
            raise TypeError(f"it returned {type(wrapped).__name__}")
        return wrapped


def _forms(wrap: Any) -> tuple[str, ...]:
    """Forms of a wrapper. Its base class tells, if it is a class with one."""
    names = {kind.__name__ for kind in wrap.__mro__} if isinstance(wrap, type) else set()
    for name, form in (("VectorWrapper", VECTOR), ("Wrapper", SINGLE), ("VecEnvWrapper", SB3)):
        if name in names:
            return (form,)
    return VECTOR, SINGLE, SB3


def _read(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"cannot read the statistics {path!r}: {error.strerror}") from error


def statistics(name: str, data: bytes) -> NamedWrapper:
    """The wrapper of a pickled ``VecNormalize``, with frozen statistics. A pickle can execute any code."""
    return NamedWrapper(name=name, wrap=partial(_vec_normalize, data), forms=(SB3,))


def _vec_normalize(data: bytes, env: Any) -> Any:
    try:
        normalize = pickle.loads(data)
    except Exception as error:
        raise ValueError(f"it is no pickle of VecNormalize, or one of another version ({error})") from error
    if not hasattr(normalize, "set_venv"):
        raise ValueError(f"it holds {type(normalize).__name__}; save it by VecNormalize.save")
    normalize.training = normalize.norm_reward = False
    if normalize.observation_space.shape != env.observation_space.shape:
        own, other = (" × ".join(map(str, one.observation_space.shape)) for one in (normalize, env))
        raise ValueError(f"its statistics are those of {own} numbers, but the environment has {other}")
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
        low, high = self.layout.space().low, self.layout.space().high
        first = np.clip(np.zeros((1, self.layout.size)), low, high)
        env: Any = StandIn(self.layout, robot.cables, first, lambda _: first)
        forms = []
        with ExitStack() as closing, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for wrapper in self.wrappers:
                form, env = _tried(wrapper, env)
                forms.append(form)
                if isinstance(env, Rows):
                    closing.callback(env.close)
            for layer in _layers(env):
                _check_frozen(layer)
            single = not isinstance(env, VectorEnv)
            self.observation_space = env.observation_space if single else env.single_observation_space
            self.action_space = env.action_space if single else env.single_action_space
            self.normalises = any(_is_vec_normalize(layer) for layer in _layers(env))
            """Whether a ``VecNormalize`` is among the wrappers."""
            self._size = GROUP if _steps_once(env) else 1
        self._forms = tuple(forms)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the wrappers, the innermost first."""
        return tuple(wrapper.name for wrapper in self.wrappers)

    def with_first(self, *wrappers: Wrapper | NamedWrapper) -> Stack:
        """A stack with further wrappers inside these."""
        return Stack([*wrappers, *self.wrappers], self.robot)

    def with_last(self, *wrappers: Wrapper | NamedWrapper) -> Stack:
        """A stack with further wrappers around these."""
        return Stack([*self.wrappers, *wrappers], self.robot)

    def run(self, tasks: Sequence[Task] | None, exchange: Exchange, observation: Array) -> None:
        """Runs the wrappers of a batch until an exception ends it. Hands out pairs and waits for the answers.

        ``(True, x)`` asks the policy for the actions of the wrapped observations x, ``(False, a)`` hands out the
        actions a of the robot and asks for the next observations.
        """
        env: Any = StandIn(
            self.layout, self.robot.cables, observation, lambda actions: exchange((False, actions)), tasks
        )
        with ExitStack() as closing:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the training has shown them
                for form, group in groupby(zip(self._forms, self.wrappers, strict=True), key=lambda pair: pair[0]):
                    wrappers = [wrapper for _, wrapper in group]
                    if form == SINGLE:  # one thread for each row, whatever the number of wrappers
                        env = Rows(env, partial(reduce, _wrap, wrappers), self._size)
                        closing.callback(env.close)
                        continue
                    for wrapper in wrappers:
                        env = wrapper.applied(form, env)
            first = env.reset()
            wrapped = first[0] if isinstance(env, VectorEnv) else first
            while True:
                wrapped = env.step(exchange((True, wrapped)))[0]


def _wrap(env: Any, wrapper: NamedWrapper) -> Any:
    return wrapper.wrap(env)


def _tried(wrapper: NamedWrapper, env: Any) -> tuple[str, Any]:
    """Form of a wrapper and the environment in it."""
    errors = {}
    for form in wrapper.forms:
        if form != SB3 and not isinstance(env, VectorEnv):
            errors[form] = "it must stand before the wrappers of Stable-Baselines3's VecEnv"
            continue
        try:
            return form, wrapper.applied(form, env)
        except ImportError as error:
            errors[form] = f"{error}: pip install 'cablebot-gym[sb3]'"
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            plain = isinstance(error, BatchItemError) or wrapper.forms == (SB3,)
            errors[form] = str(error) if plain else raised(error)
    text = "; ".join(f"around a {form} {cause}" for form, cause in errors.items())
    raise ValueError(f"wrapper {wrapper.name!r}: {text if len(errors) > 1 else next(iter(errors.values()))}")


def _layers(env: Any) -> Iterator[Any]:
    """The environment and all that it wraps, from outside; of rows, the wrappers of the first row too."""
    while env is not None:
        yield env
        if isinstance(env, Rows):
            yield from _layers(env.first)
        inner = vars(env)
        env = inner.get("env") or inner.get("venv")


def _steps_once(env: Any) -> bool:
    """Whether a step of an environment of one row steps each environment in its wrappers once."""
    try:
        env.reset()
        actions: Any = env.action_space.sample()
        env.step(0 * (actions if isinstance(env, VectorEnv) else actions[None]))
    except Exception:  # it may need the tasks of an episode
        return False
    return all(layer.inner_steps == 1 for layer in _layers(env) if isinstance(layer, Rows))


def _is_vec_normalize(layer: Any) -> bool:
    return any(kind.__name__ == "VecNormalize" for kind in type(layer).__mro__)


def _check_frozen(layer: Any) -> None:
    """Raises a ValueError if a wrapper updates its statistics."""
    for name in ("update_running_mean", "training"):
        if "obs_rms" in vars(layer) and getattr(layer, name, False) is True:
            raise ValueError(
                f"wrapper {type(layer).__name__} goes on learning while the policy is judged. In the function that "
                f"makes it, set its statistics, obs_rms, to those of the training and {name} = False"
            )


class WrappedPolicy:
    """A policy behind the wrappers of its training, which get a stand-in and never the judge's environment.

    The wrappers are made anew for each batch of episodes, at the first call with ``state=None``, and wrap an
    environment without physics. The state that ``predict`` returns holds them, so it has to be passed to the next call.

    Args:
        policy: the policy, which gets wrapped observations and returns the actions that the wrappers expect.
        stack: the wrappers.
        note: a sentence about wrappers that the user did not give; may be empty.
    """

    def __init__(self, policy: Policy, stack: Stack, note: str = "") -> None:
        self.policy, self.note, self.wrappers = policy, note, stack.names
        self.unsaturated_actions, self.stochastic = declarations(policy)
        self._stack = stack
        self._tasks: tuple[Task, ...] | None = None

    @property
    def fallbacks(self) -> Any:
        """The fallbacks of the policy.

        Raises:
            AttributeError: if it does not count them.
        """
        return self.policy.fallbacks  # type: ignore[attr-defined]

    def reset(self, tasks: Sequence[Task]) -> None:
        """Resets the policy. The stand-in of the next batch has these tasks."""
        self._tasks = tuple(tasks)
        reset_policy(self.policy, "", lambda: tuple(tasks))

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions (N, m) or (m,) of the robot, and the state of the wrappers and of the policy.

        Raises:
            Exception: whatever a wrapper raises.
        """
        rows = np.atleast_2d(observation)
        starts = np.full(len(rows), state is None) if episode_start is None else np.atleast_1d(episode_start)
        running: _Running = _Running(partial(self._stack.run, self._tasks)) if state is None else state
        actions = running.actions(self.policy, rows, starts, deterministic)
        return actions if np.ndim(observation) > 1 else actions[0], running


class _Running:
    """The wrappers of a batch and the state of the policy."""

    def __init__(self, run: Callable[[Exchange, Array], None]) -> None:
        self._wrappers = Suspended(run)
        self._state: Any = None
        self._starts: Any = False

    def actions(self, policy: Policy, observation: Array, starts: Array, deterministic: bool) -> Array:
        """Actions (N, m) of the robot for the next observations (N, size)."""
        self._starts |= starts
        asks, value = self._wrappers.send(observation)
        while asks:
            actions, self._state = policy.predict(
                value, state=self._state, episode_start=self._starts, deterministic=deterministic
            )
            self._starts = np.zeros_like(starts)
            asks, value = self._wrappers.send(actions)
        return value


@cache
def say(note: str) -> None:
    """Logs a note once in a process; without a handler it goes to standard error."""
    _LOGGER.warning("note: %s", note)


def sizes(space: Any) -> str:
    """A space in words, such as ``31 numbers``."""
    return f"{'×'.join(map(str, space.shape))} numbers" if isinstance(space, Box) else str(space)
