"""Adapter from Gymnasium's vector environment to Stable-Baselines3 (SB3), for training on one
compiled batch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

import cablebot_gym  # noqa: F401 - registers the ids

try:
    from stable_baselines3.common.vec_env.base_vec_env import (
        VecEnv,
        VecEnvIndices,
        VecEnvObs,
        VecEnvStepReturn,
    )
except ImportError as error:
    raise ImportError(
        "SB3's VecEnv needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error


class CableBotVecEnv(VecEnv):
    """SB3's interface of a Gymnasium vector environment; its observations, rewards and ends equal
    those of SB3's ``DummyVecEnv`` bit by bit.

    ``step`` returns observations (N, size) in the dtype of the observation space, rewards (N,) in
    float32, dones (N,) and N dicts. Every dict has ``TimeLimit.truncated``, which is true if only
    the time limit ended the episode. When an episode ends, the returned observation is the first of
    the next episode, and the dict also contains the last observation as ``terminal_observation``
    and the whole last ``info``. The other dicts have no more keys, because a thousand of them would
    take longer than the physics. Seeds and options apply once, at the next ``reset``: environment i
    gets ``seed + i``.

    Args:
        env: vector environment from ``gym.make_vec(id, num_envs=N,
            autoreset_mode=AutoresetMode.DISABLED)``, with or without wrappers.

    Raises:
        ValueError: if ``env`` is no vector environment, or has another autoreset mode.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
            raise ValueError(
                f"env must be from gym.make_vec(…, autoreset_mode=AutoresetMode.DISABLED), not {env!r}"
            )
        self.env = env
        """The vector environment."""
        self.spec = env.spec
        """The environment's spec; SB3's ``VecMonitor`` reads its name."""
        self._actions: Any = None
        self._all_indices = np.arange(env.num_envs)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Sets the options of the next reset: one dict, whose values may be per environment.

        Raises:
            ValueError: if the options are a list.
        """
        if isinstance(options, (list, tuple)):
            raise ValueError("options must be one dict; its values may have a leading axis N")
        super().set_options(options)

    def reset(self) -> VecEnvObs:
        """Resets every environment with the seeds and options set before; returns observations (N,
        size).

        Raises:
            ValueError: if a seed or an option is invalid; seeds and options then stay set.
        """
        # The base class's seeds increase by one per environment, as Gymnasium's do.
        options = dict(self._options[0] or {}) or None
        observation, info = self.env.reset(seed=self._seeds[0], options=options)
        self.reset_infos = self._dicts(info, self._all_indices)
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Sets the actions (N, m) for the next :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Steps every environment once; returns observations, rewards, dones and info dicts, see
        the class.

        Raises:
            ValueError: if the actions are not (N, m) finite numbers.
        """
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        at_limit = truncated & ~terminated
        infos: list[dict[str, Any]] = [
            {"TimeLimit.truncated": is_truncated} for is_truncated in at_limit.tolist()
        ]
        if done.any():
            ended = np.flatnonzero(done)
            for env_index, last_info in zip(ended, self._dicts(info, ended), strict=True):
                infos[env_index] |= last_info
                infos[env_index]["terminal_observation"] = observation[env_index].copy()
            start, info = self.env.reset(options={"reset_mask": done})
            observation[done] = start[done]
            for env_index, first_info in zip(ended, self._dicts(info, ended), strict=True):
                self.reset_infos[env_index] = first_info
        return observation, reward.astype(np.float32), done, infos

    def _dicts(
        self, info: Mapping[str, Any], env_indices: NDArray[np.int64]
    ) -> list[dict[str, Any]]:
        """One dict for each of some environments, from a vector info without its masks."""
        dicts: list[dict[str, Any]] = [{} for _ in env_indices]
        for name, values in info.items():
            if name.startswith("_"):
                continue
            for env_info, value in zip(dicts, self._items(values, env_indices), strict=True):
                env_info[name] = value
        return dicts

    def _items(self, value: Any, env_indices: NDArray[np.int64]) -> list[Any]:
        """One item for each of some environments, from an array (N, …) or a dict of these; any
        other value is repeated."""
        if isinstance(value, dict):
            return self._dicts(value, env_indices)
        if np.ndim(value) == 0 or len(value) != self.num_envs:
            return [value] * len(env_indices)
        if not isinstance(value, np.ndarray):
            return [value[env_index] for env_index in env_indices]
        rows = value[env_indices]
        if rows.ndim == 1:
            return rows.tolist()  # Python's scalars
        return list(rows)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of each environment: one item each if the attribute has N items, otherwise
        the same value.

        Raises:
            AttributeError: if the vector environment has no such attribute.
        """
        # The vector environment's own spaces are those of the whole batch.
        if attr_name in ("action_space", "observation_space"):
            attr_name = f"single_{attr_name}"
        env_indices = self._all_indices[list(self._get_indices(indices))]
        for layer in _layers(self.env):
            if hasattr(layer, attr_name):
                return self._items(getattr(layer, attr_name), env_indices)
        raise AttributeError(f"{self.env.unwrapped!r} has no attribute {attr_name!r}")

    def env_method(self, method_name: str, *arguments: Any, **keywords: Any) -> list[Any]:
        """Not available, as is ``set_attr``.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError(
            "the environments are one compiled batch: use keywords, set_options(), or methods of the vector environment"
        )

    set_attr: Any = env_method

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Whether a ``wrapper_class`` wraps the batch; always false for wrappers of single
        environments."""
        is_wrapped = any(isinstance(layer, wrapper_class) for layer in _layers(self.env))
        return [is_wrapped for _ in self._get_indices(indices)]

    def close(self) -> None:
        """Closes the vector environment."""
        self.env.close()


def _layers(env: Any) -> Iterator[Any]:
    """A vector environment and the environments that it wraps, from the outside in."""
    while isinstance(env, VectorWrapper):
        yield env
        env = env.env
    yield env


def make_sb3_vec_env(
    env_id: str, n_envs: int = 1, *, seed: int | None = None, **keywords: Any
) -> CableBotVecEnv:
    """Makes N environments of one id as one compiled batch for SB3.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`, or another id with a vector environment.
        n_envs: number of environments N.
        seed: environment i gets ``seed + i`` at the first reset, and the action space gets
            ``seed``; None for random seeds.
        keywords: keyword arguments of the environment, see ``help(gym.make(env_id).unwrapped)``,
            and ``max_episode_steps``, control steps after which an episode is truncated if its
            motion is longer.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if a keyword is unknown or a value is invalid.
    """
    vec_env = CableBotVecEnv(
        gym.make_vec(env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.DISABLED, **keywords)
    )
    if seed is not None:
        vec_env.seed(seed)
        vec_env.action_space.seed(seed)
    return vec_env
