"""Wrappers of a policy's training, around an environment that passes on observations and
actions."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space, iterate
from gymnasium.wrappers.vector import TransformObservation

from cablebot_gym.envs.observation import ObservationLayout, observation_layout
from cablebot_gym.policies.protocol import Array, Policy, PolicyError, called, name_of
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
VEC_ENV = "VecEnv"
"""Forms of wrappers."""


class PolicyEnv(VectorEnv[Any, Any, Any]):
    """The environment inside the wrappers of a policy. Rewards are 0, info is empty and no episode
    ends.

    Args:
        layout: layout of the observation.
        cables: number of cables m.
        observation: first observations, (N, size).
        advance: makes a control step with actions as the policy or a wrapper returned them, and
            returns the next observations, (N, size).
        tasks: makes the public tasks of the episodes.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - Gymnasium's

    def __init__(
        self,
        layout: ObservationLayout,
        cables: int,
        observation: Array,
        advance: Callable[[Any], Array],
        tasks: Callable[[], tuple[Task, ...]],
    ) -> None:
        self.layout = layout
        self.over = False
        """Whether all episodes are over: further steps change nothing."""
        self._observation = observation
        self._advance, self._tasks = advance, tasks
        self._stepped = False
        self.num_envs = len(observation)
        self.single_observation_space = layout.space()
        self.single_action_space = Box(-1.0, 1.0, (cables,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Public tasks of the episodes; none before the first episode."""
        return self._tasks()

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """The first observations.

        Raises:
            RuntimeError: after the first step.
        """
        if self._stepped and not self.over:
            raise RuntimeError(
                "a wrapper resets the environment in the middle of an episode: leave wrappers that "
                "restart episodes out"
            )
        return self._observation.copy(), {}

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """The observations after these actions."""
        self._stepped = True
        if not self.over:
            self._observation = self._advance(actions)
        never = np.zeros(self.num_envs, np.bool_)
        return self._observation.copy(), np.zeros(self.num_envs), never, never.copy(), {}


class SingleEnv(gym.Env[Any, Any]):
    """The only row of a vector environment as a single environment.

    Args:
        env: the vector environment, in the first wrappers of a policy.
        innermost: the environment inside these wrappers.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], innermost: PolicyEnv) -> None:
        self.layout = innermost.layout
        self.env, self._innermost = env, innermost
        self.observation_space = env.single_observation_space
        self.action_space = env.single_action_space

    @property
    def task(self) -> Task:
        """Public task of the episode."""
        return self._innermost.tasks[0]

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """The first observation."""
        super().reset(seed=seed)
        return self._row(self.env.reset()[0]), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """The observation after this action."""
        return self._row(self.env.step(np.asarray(action)[None])[0]), 0.0, False, False, {}

    def _row(self, observations: Any) -> Any:
        return next(iter(iterate(self.env.observation_space, observations)))


def as_vec_env(env: VectorEnv[Any, Any, Any]) -> Any:
    """A vector environment of Gymnasium as a ``VecEnv`` of Stable-Baselines3 (extra ``sb3``)."""
    from stable_baselines3.common.vec_env import VecEnv

    class PolicyVecEnv(VecEnv):
        """The vector environment in the form of Stable-Baselines3."""

        def __init__(self) -> None:
            self.env = env
            super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

        def reset(self) -> Any:
            return env.reset()[0]

        def step_async(self, actions: Array) -> None:
            self._actions = actions

        def step_wait(self) -> Any:
            observation, reward, terminated, _, _ = env.step(self._actions)
            return observation, reward, terminated, [{} for _ in range(self.num_envs)]

        def close(self) -> None:
            pass

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            return [getattr(env, attr_name)] * self.num_envs

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            return [False] * self.num_envs

        def env_method(self, method_name: str, *args: Any, **kwargs: Any) -> list[Any]:
            raise NotImplementedError(
                "the environment has no further methods, and its attributes cannot be set"
            )

        set_attr: Any = env_method

    return PolicyVecEnv()


@dataclass(frozen=True)
class Transform:
    """A wrapper of a vector environment that is a function of the observation."""

    name: str
    """Name in messages, as the user gave it if it is text."""
    function: Callable[[Any], Any]
    """Function of one observation or of a batch."""
    reads: tuple[int, ...]
    """Shape of one observation."""
    space: Box | None = None
    """Space of one transformed observation; None for that of the observation."""

    def transformed(self, space: Any) -> Any:
        """The transformed space of an observation space.

        Raises:
            ValueError: if the function does not fit the space.
        """
        if space.shape != self.reads:
            raise ValueError(
                f"wrapper {self.name!r} reads shape {self.reads}, and the observation has "
                f"{space.shape}"
            )
        return self.space or space

    def __call__(self, env: VectorEnv[Any, Any, Any]) -> VectorEnv[Any, Any, Any]:
        """A vector environment in this wrapper."""
        space = self.transformed(env.single_observation_space)
        return TransformObservation(env, self.function, single_observation_space=space)


@dataclass(frozen=True)
class Layer:
    """A wrapper with its name in messages."""

    name: str
    """Name, as the user gave it if it is text."""
    function: Callable[[Any], Any]
    """Function that wraps an environment."""
    forms: tuple[str, ...] = (VECTOR, SINGLE, VEC_ENV)
    """Forms to try, in this order."""

    @classmethod
    def of(cls, wrapper: Wrapper | Transform, layout: ObservationLayout) -> Layer:
        """The layer of a wrapper that a user gives.

        Raises:
            ValueError: if it is not a :data:`Wrapper`, or if its code cannot be imported.
        """
        function: Any = wrapper
        name = name_of(wrapper)
        if isinstance(wrapper, (str, Path)):
            name = str(wrapper)
            function = _named(name, layout)
        if not callable(function):
            raise ValueError(
                f"wrapper {name!r} must be a function or class that takes an environment, such as "
                "file.py:name, or a .pkl file of VecNormalize"
            )
        if isinstance(function, Transform):
            return cls(name, function, (VECTOR,))
        return cls(name, function)

    def wrap(self, env: Any, innermost: PolicyEnv) -> Any:
        """An environment in this wrapper, in the first form that it accepts: a vector environment,
        or a ``VecEnv`` of Stable-Baselines3.

        Raises:
            ValueError: if the wrapper raises in every form.
        """
        errors = []
        for form in self.forms:
            try:
                return self._wrapped(form, env, innermost)
            except ImportError as error:
                cause = f"{error}: pip install 'cablebot-gym[sb3]'"
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                cause = raised(error)
            errors.append(f"around a {form} {cause}")
        raise ValueError(f"wrapper {self.name!r}: {'; '.join(errors)}")

    def _wrapped(self, form: str, env: Any, innermost: PolicyEnv) -> Any:
        is_vector = isinstance(env, VectorEnv)
        if form == VEC_ENV:
            wrapped = self.function(as_vec_env(env) if is_vector else env)
            is_of_form = hasattr(wrapped, "step_wait")
        elif not is_vector:
            raise TypeError("it must stand before the wrappers of Stable-Baselines3's VecEnv")
        elif form == VECTOR:
            wrapped = self.function(env)
            is_of_form = isinstance(wrapped, VectorEnv)
        else:
            single = self.function(SingleEnv(env, innermost))
            is_of_form = isinstance(single, gym.Env)
            wrapped = SyncVectorEnv([lambda: single]) if is_of_form else single
        if not is_of_form:
            raise TypeError(f"it returned {type(wrapped).__name__}")
        return wrapped


def _named(name: str, layout: ObservationLayout) -> Any:
    """The wrapper of a name.

    Raises:
        ValueError: if its file cannot be read, or if its code cannot be imported.
    """
    if name == NORMALISED:
        space = layout.space(normalised=True)
        return Transform(name, layout.normalise, (layout.size,), space)
    try:
        if not name.endswith(".pkl"):
            return import_object(name)
        data = foreign_bytes(Path(name))
    except OSError as error:
        raise ValueError(f"cannot read wrapper {name!r}: {error.strerror}") from error
    except Exception as error:
        raise ValueError(f"wrapper {name!r}: cannot import it ({error})") from error
    return statistics(name, data)


def statistics(name: str, data: bytes) -> Transform:
    """The observations of a pickled ``VecNormalize``, whose statistics stay as they are. A pickle
    can execute any code.

    Raises:
        ValueError: if it is no pickle of a ``VecNormalize``.
    """
    try:
        normalize = pickle.loads(data)
    except Exception as error:
        raise ValueError(
            f"wrapper {name!r} is no pickle of VecNormalize, or one of another version ({error})"
        ) from error
    if not hasattr(type(normalize), "normalize_obs"):
        raise ValueError(
            f"wrapper {name!r} holds {type(normalize).__name__}; save it by VecNormalize.save"
        )
    return Transform(name, normalize.normalize_obs, normalize.observation_space.shape)


class Stack:
    """Wrappers of a policy for a robot, tried once around an environment of one row.

    The outermost functions of the observation, such as a ``VecNormalize``, need no environment:
    they become :attr:`transforms`.

    Args:
        wrappers: the wrappers, the innermost first.
        robot: nominal robot.

    Raises:
        ValueError: if a wrapper raises, fits no form, or goes on learning.
    """

    def __init__(self, wrappers: Sequence[Wrapper | Transform], robot: Robot) -> None:
        if isinstance(wrappers, (str, Path)) or callable(wrappers):
            raise ValueError(f"wrappers must be a list, such as [{wrappers!r}], not one wrapper")
        self.robot, self.layout = robot, observation_layout(robot)
        self._given = wrappers
        layers = [Layer.of(wrapper, self.layout) for wrapper in wrappers]
        self.names = tuple(layer.name for layer in layers)
        """Names of the wrappers, the innermost first."""
        self.layers: list[Layer] = []
        """Wrappers of the environment, the innermost first."""
        self.transforms: list[Transform] = []
        """Functions of the observations of the wrapped environment, in their order."""
        for count, layer in enumerate(layers, 1):
            if isinstance(layer.function, Transform):
                self.transforms.append(layer.function)
            else:
                self.layers = layers[:count]
                self.transforms = []
        space = self.layout.space()
        observation = np.clip(np.zeros((1, self.layout.size)), space.low, space.high)
        env = self.wrap(
            PolicyEnv(self.layout, robot.cables, observation, lambda _: observation, tuple)
        )
        envs = list(_inside(env))
        for each in envs:
            _check_frozen(each)
        self.alone = any(isinstance(each, SingleEnv) for each in envs)
        """Whether each episode runs alone, because a wrapper wraps a single environment."""
        kinds = {kind.__name__ for each in envs for kind in type(each).__mro__}
        self.normalises = "VecNormalize" in kinds or any(t.space is None for t in self.transforms)
        """Whether a ``VecNormalize`` is among the wrappers."""
        is_vector = isinstance(env, VectorEnv)
        self.action_space = env.single_action_space if is_vector else env.action_space
        self.observation_space = (
            env.single_observation_space if is_vector else env.observation_space
        )
        for transform in self.transforms:
            self.observation_space = transform.transformed(self.observation_space)

    def normalised(self) -> Stack:
        """A stack with :data:`NORMALISED` inside these wrappers."""
        return Stack([NORMALISED, *self._given], self.robot)

    def wrap(self, env: PolicyEnv) -> Any:
        """An environment in new wrappers: a vector environment or a ``VecEnv``.

        Raises:
            ValueError: if a wrapper raises, or fits no form.
        """
        wrapped: Any = env
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the training has shown them
            for layer in self.layers:
                wrapped = layer.wrap(wrapped, env)
        return wrapped


def run_policy(policy: Policy, env: PolicyEnv) -> None:
    """Calls a policy until all episodes of an environment are over, in its wrappers if it has some.

    Raises:
        PolicyError: if the policy or a wrapper raises anything but a KeyboardInterrupt. The message
            lacks the name of the policy.
    """
    wrap = getattr(policy, "wrap", None)
    if wrap is None:
        _run(policy, env, env)
        return
    try:
        _run(policy, env, wrap(env))
    except (KeyboardInterrupt, PolicyError):
        raise
    except BaseException as error:
        raise PolicyError(raised(error, "a wrapper raised")) from error


def _run(policy: Policy, env: PolicyEnv, wrapped: Any) -> None:
    observation = wrapped.reset()
    if isinstance(wrapped, VectorEnv):
        observation = observation[0]
    state = None
    starts = np.ones(env.num_envs, np.bool_)
    while not env.over:
        actions, state = called(policy, observation, state, starts)
        observation = wrapped.step(actions)[0]
        starts = np.zeros(env.num_envs, np.bool_)


def _inside(env: Any) -> Iterator[Any]:
    """The environment and all that it wraps, from outside."""
    while env is not None:
        yield env
        inner = vars(env)
        first_row = next(iter(inner.get("envs", ())), None)
        env = inner.get("env") or inner.get("venv") or first_row


def _check_frozen(layer: Any) -> None:
    """Raises a ValueError if a wrapper updates its statistics."""
    for name in ("update_running_mean", "training"):
        if "obs_rms" in vars(layer) and getattr(layer, name, False) is True:
            raise ValueError(
                f"wrapper {type(layer).__name__} goes on learning while the policy is judged. In "
                "the function that makes it, set its statistics, obs_rms, to those of the training "
                f"and {name} = False"
            )
