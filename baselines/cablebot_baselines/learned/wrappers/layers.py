"""Base class of the wrappers, their order, and the adapter that makes their single-environment
form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.envs.vector import CableBotVectorEnv, VectorStep
from cablebot_gym.task import Task

CURRICULUM, STEERED = range(2)
"""Levels of the wrappers: a wrapper may wrap lower levels and its own level; :data:`STEERED` is
always outermost."""

SingleStep = tuple[Array, float, bool, bool, dict[str, Any]]


class OneRow(VectorEnv[Array, ArrayLike, Array]):
    """A single environment of this package as a vector environment with one row and autoreset
    disabled.

    Raises:
        TypeError: if the environment is not one of this package.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012 - Gymnasium's
    num_envs = 1

    def __init__(self, env: gym.Env[Array, ArrayLike]) -> None:
        if not isinstance(env, gym.Env) or not isinstance(env.unwrapped, CableBotEnv):
            raise TypeError(
                f"the wrapper needs an environment of this package, from gym.make, not {env!r}"
            )
        self.env = env
        """The single environment, with its wrappers."""
        self.settings = env.unwrapped.settings
        self.layout = env.unwrapped.layout
        self.single_observation_space = env.observation_space
        self.single_action_space = env.action_space
        self.observation_space = batch_space(env.observation_space, 1)
        self.action_space = batch_space(env.action_space, 1)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Task of the present episode."""
        return (self.env.get_wrapper_attr("task"),)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; seed and options as for the single environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation[None], _as_row(info)

    def step(self, actions: ArrayLike) -> VectorStep:
        """One step with actions (1, m)."""
        observation, reward, terminated, truncated, info = self.env.step(np.asarray(actions)[0])
        results = np.array([float(reward)]), np.array([terminated]), np.array([truncated])
        return observation[None], *results, _as_row(info)


def _as_row(info: Mapping[str, Any]) -> dict[str, Any]:
    """Info with a leading axis; values that are neither arrays nor scalars stay as they are."""
    kinds = (np.ndarray, np.generic, bool, int, float, str)
    return {
        name: np.asarray(value)[None] if isinstance(value, kinds) else value
        for name, value in info.items()
    }


def _from_row(info: Mapping[str, Any]) -> dict[str, Any]:
    """Info without the leading axis; scalars become Python objects."""
    rows = {
        name: value[0] if isinstance(value, np.ndarray) else value for name, value in info.items()
    }
    return {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in rows.items()
    }


if TYPE_CHECKING:
    _Wrapper = VectorWrapper[Array, ArrayLike, Array, ArrayLike, Array]
else:  # Gymnasium's class is generic from 1.4 on
    _Wrapper = VectorWrapper


class BatchWrapper(_Wrapper):
    """Wrapper of N environments of this package with autoreset disabled.

    Raises:
        TypeError: if the environment is not a :class:`CableBotVectorEnv`.
        ValueError: if it has another autoreset mode, or the order of the wrappers is wrong.
    """

    level: ClassVar[int]
    """Level in the order of the wrappers."""

    env: Any

    def __init__(self, env: VectorEnv[Array, ArrayLike, Array]) -> None:
        name = type(self).__name__
        if not isinstance(env, VectorEnv) or not isinstance(
            env.unwrapped, (CableBotVectorEnv, OneRow)
        ):
            raise TypeError(
                f"{name} needs a vector environment of this package, from gym.make_vec, not {env!r}"
            )
        super().__init__(env)
        if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
            raise ValueError(f"{name} needs gym.make_vec(…, autoreset_mode=AutoresetMode.DISABLED)")
        if any(level == STEERED or level > self.level for level in _levels(env)):
            raise ValueError(
                f"{name} is outside a wrapper that must be outside it: Steered must be outermost"
            )
        self._plant: CableBotVectorEnv | OneRow = env.unwrapped


def _levels(env: Any) -> Iterator[int]:
    """Levels of an environment's wrappers; wrappers of other packages are skipped."""
    while env is not None:
        if isinstance(env, (BatchWrapper, SingleWrapper)):
            yield env.level
        env = getattr(env, "env", None)


class SingleWrapper(gym.Wrapper[Array, ArrayLike, Array, ArrayLike], RecordConstructorArgs):
    """Single-environment form of a wrapper: it runs the vector form on one row.

    Args:
        env: single environment of this package, optionally with other wrappers.
        arguments: keyword arguments of the vector form.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is invalid, or the order of the wrappers is wrong.
    """

    vector: ClassVar[type[Any]]
    """The vector form, a :class:`BatchWrapper`."""

    def __init__(self, env: gym.Env[Array, ArrayLike], **arguments: Any) -> None:
        RecordConstructorArgs.__init__(self, **arguments)
        self.batch = self.vector(OneRow(env), **arguments)
        """The vector form around the environment."""
        gym.Wrapper.__init__(self, env)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    @property
    def level(self) -> int:
        """Level in the order of the wrappers."""
        return int(self.vector.level)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; seed and options as for the environment.

        Raises:
            ValueError: if the seed or an option is invalid.
        """
        observation, info = self.batch.reset(seed=seed, options=options)
        return observation[0], _from_row(info)

    def step(self, action: ArrayLike) -> SingleStep:
        """One step of the vector form.

        Raises:
            ResetNeeded: before the first reset.
            ValueError: if the action is invalid.
        """
        observation, reward, terminated, truncated, info = self.batch.step(np.asarray(action)[None])
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _from_row(info),
        )


def restart_mask(options: Mapping[str, Any] | None, count: int) -> NDArray[np.bool_]:
    """Mask of the environments that a reset with these options resets; all of them if its shape is
    invalid."""
    mask = np.array((options or {}).get("reset_mask"), np.bool_)
    return mask if mask.shape == (count,) else np.ones(count, np.bool_)
