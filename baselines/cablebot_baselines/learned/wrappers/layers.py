"""Base classes of the wrappers: their form for a batch, and their form for a single environment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.laws.law import Array
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.envs.vector import CableBotVectorEnv, VectorStep
from cablebot_gym.task import Task

if TYPE_CHECKING:
    _Wrapper = VectorWrapper[Array, ArrayLike, Array, ArrayLike, Array]
else:  # Gymnasium's class is generic from 1.4 on
    _Wrapper = VectorWrapper


def layers(env: Any) -> Iterator[Any]:
    """A vector environment and the environments that it wraps, from the outside in."""
    while isinstance(env, VectorWrapper):
        yield env
        env = env.env
    yield env


class BatchWrapper(_Wrapper):
    """Wrapper of N environments of this package with autoreset disabled.

    Raises:
        TypeError: if the environment is not a :class:`CableBotVectorEnv`.
        ValueError: if it has another autoreset mode, or is already steered.
    """

    env: Any

    def __init__(self, env: VectorEnv[Array, ArrayLike, Array]) -> None:
        name = type(self).__name__
        base_env: Any = getattr(env, "unwrapped", None)
        is_steered = any(hasattr(layer, "steering") for layer in layers(env))
        if isinstance(base_env, OneRow):
            (single,) = base_env.envs
            is_steered = single.has_wrapper_attr("steering")
            base_env = single.unwrapped
        if not isinstance(env, VectorEnv) or not isinstance(
            base_env, (CableBotVectorEnv, CableBotEnv)
        ):
            raise TypeError(
                f"{name} needs a vector environment of this package, from gym.make_vec, not {env!r}"
            )
        super().__init__(env)
        if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
            raise ValueError(f"{name} needs gym.make_vec(…, autoreset_mode=AutoresetMode.DISABLED)")
        if is_steered:
            raise ValueError(
                f"{name} is outside a wrapper that must be outside it: Steered must be outermost"
            )
        self._base_env = base_env

    @property
    def tasks(self) -> Sequence[Task]:
        """Tasks of the present episodes."""
        if isinstance(self._base_env, CableBotEnv):
            return (self._base_env.task,)
        return self._base_env.tasks


class OneRow(SyncVectorEnv):
    """A single environment as a vector environment. After the end of an episode it steps on, as
    the environments of this package do; Gymnasium's step refuses that."""

    def __init__(self, env: gym.Env[Array, ArrayLike]) -> None:
        super().__init__([lambda: env], autoreset_mode=AutoresetMode.DISABLED)

    def step(self, actions: ArrayLike) -> VectorStep:
        """One step with actions (1, m)."""
        observation, reward, terminated, truncated, info = self.envs[0].step(np.asarray(actions)[0])
        return (
            observation[None],
            np.array([reward], float),
            np.array([terminated]),
            np.array([truncated]),
            self._add_info({}, info, 0),
        )


class SingleWrapper(gym.Wrapper[Array, ArrayLike, Array, ArrayLike], RecordConstructorArgs):
    """Single-environment form of a wrapper: it runs the vector form on one row.

    Args:
        env: single environment of this package, optionally with other wrappers.
        arguments: keyword arguments of the vector form.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is invalid, or the environment is already steered.
    """

    vector: ClassVar[type[Any]]
    """The vector form, a :class:`BatchWrapper`."""

    def __init__(self, env: gym.Env[Array, ArrayLike], **arguments: Any) -> None:
        RecordConstructorArgs.__init__(self, **arguments)
        if not isinstance(env, gym.Env) or not isinstance(env.unwrapped, CableBotEnv):
            raise TypeError(
                f"the wrapper needs an environment of this package, from gym.make, not {env!r}"
            )
        self.batch = self.vector(OneRow(env), **arguments)
        """The vector form around the environment."""
        gym.Wrapper.__init__(self, env)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; seed and options as for the environment.

        Raises:
            ValueError: if the seed or an option is invalid.
        """
        observation, info = self.batch.reset(seed=[seed], options=options)
        return observation[0], _first_row(info)

    def step(self, action: ArrayLike) -> tuple[Array, float, bool, bool, dict[str, Any]]:
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
            _first_row(info),
        )


def _first_row(info: Mapping[str, Any]) -> dict[str, Any]:
    """Info of the first environment, without the masks of a vector info; scalars are Python
    objects."""
    row: dict[str, Any] = {}
    for name, values in info.items():
        if name.startswith("_"):
            continue
        if isinstance(values, dict):
            row[name] = _first_row(values)
            continue
        row[name] = values[0]
        if isinstance(values[0], np.generic):
            row[name] = values[0].item()
    return row


def restart_mask(options: Mapping[str, Any] | None, count: int) -> NDArray[np.bool_]:
    """Mask of the environments that a reset with these options resets; all of them if its shape is
    invalid."""
    mask = np.array((options or {}).get("reset_mask"), np.bool_)
    if mask.shape != (count,):
        return np.ones(count, np.bool_)
    return mask
