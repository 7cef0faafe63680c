"""Adapter from Gymnasium's vector environment to Stable-Baselines3 (SB3), for training on one
compiled batch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

import cablebot_gym  # noqa: F401 - registers the ids
from cablebot_baselines.learned.wrappers.layers import layers
from cablebot_gym.utils.checks import choice

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

FINAL_KEYS = ("termination_reason", "payload", "episode", "is_success")
"""Info keys that an ended episode always has if the environment provides them; SB3 itself reads the
last two."""


class CableBotVecEnv(VecEnv):
    """SB3's interface of a Gymnasium vector environment; its results equal those of SB3's
    ``DummyVecEnv`` bit by bit.

    ``step`` returns observations (N, size) in the dtype of the observation space, rewards (N,) in
    float32, dones (N,) and N dicts. When an episode ends, the returned observation is the first of
    the next episode, and the dict contains the last observation as ``terminal_observation`` and the
    keys in :data:`FINAL_KEYS`. Every dict has ``TimeLimit.truncated``, which is true if only the
    time limit ended the episode. Seeds and options apply once, at the next ``reset``: environment i
    gets ``seed + i``.

    Args:
        env: vector environment from ``gym.make_vec(id, num_envs=N,
            autoreset_mode=AutoresetMode.DISABLED)``, with or without wrappers.
        info_keys: further keys of ``info`` that each dict gets at each step. None selects all keys,
            which for 1024 environments takes three times as long as the physics.

    Raises:
        TypeError: if ``env`` is not a vector environment.
        ValueError: if it has another autoreset mode. The first ``step`` raises it if one of
            ``info_keys`` is unknown.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], *, info_keys: Sequence[str] | None = ()
    ) -> None:
        if not isinstance(env, VectorEnv):
            raise TypeError(
                f"env must be a Gymnasium vector environment, from gym.make_vec, not {type(env).__name__}"
            )
        if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
            raise ValueError(
                "CableBotVecEnv needs gym.make_vec(…, autoreset_mode=AutoresetMode.DISABLED)"
            )
        self.env = env
        """The vector environment."""
        self.spec = env.spec
        """The environment's spec; SB3's ``VecMonitor`` reads its name."""
        self._info_keys = info_keys
        self._checked = False
        self._actions: NDArray[Any] | None = None
        self._all_indices = np.arange(env.num_envs)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Sets the options of the next reset: one dict, whose values may be per environment.

        Raises:
            ValueError: if the options are a list, or contain ``reset_mask``.
        """
        if isinstance(options, (list, tuple)) or "reset_mask" in (options or {}):
            raise ValueError(
                "options must be one dict without reset_mask; its values may have a leading axis N"
            )
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
        self.reset_infos = self._dicts(info, self._selected_keys(info), self._all_indices)
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
            RuntimeError: if no actions were set.
            ValueError: if the actions are not (N, m) finite numbers, or one of ``info_keys`` is
                unknown.
        """
        if self._actions is None:
            raise RuntimeError("call step_async(actions) before step_wait()")
        actions = self._actions
        self._actions = None
        observation, reward, terminated, truncated, info = self.env.step(actions)
        if not self._checked:
            for key in self._info_keys or ():
                choice("info key", key, (*_names(info), *FINAL_KEYS))
            self._checked = True
        done = terminated | truncated
        infos = self._dicts(info, self._selected_keys(info), self._all_indices)
        if done.any():
            ended = np.flatnonzero(done)
            endings = self._dicts(info, FINAL_KEYS, ended)
            for env_index, ending in zip(ended, endings, strict=True):
                infos[env_index] |= ending
                infos[env_index]["terminal_observation"] = observation[env_index].copy()
            start, info = self.env.reset(options={"reset_mask": done})
            observation[done] = start[done]
            start_infos = self._dicts(info, self._selected_keys(info), ended)
            for env_index, start_info in zip(ended, start_infos, strict=True):
                self.reset_infos[env_index] = start_info
        at_limit = (truncated & ~terminated).tolist()
        for env_info, is_truncated in zip(infos, at_limit, strict=True):
            env_info["TimeLimit.truncated"] = is_truncated
        return observation, reward.astype(np.float32), done, infos

    def _selected_keys(self, info: Mapping[str, Any]) -> Sequence[str]:
        if self._info_keys is None:
            return _names(info)
        return self._info_keys

    def _dicts(
        self, info: Mapping[str, Any], keys: Iterable[str], env_indices: NDArray[np.int64]
    ) -> list[dict[str, Any]]:
        """Splits a vector info into one dict per environment; the mask ``_key`` marks environments
        with a key."""
        dicts: list[dict[str, Any]] = [{} for _ in env_indices]
        for key in keys:
            if key not in info:
                continue
            values = self._items(info[key], env_indices)
            present = info.get(f"_{key}", np.ones(self.num_envs, np.bool_))[env_indices]
            for env_info, value, has_key in zip(dicts, values, present.tolist(), strict=True):
                if has_key:
                    env_info[key] = value
        return dicts

    def _items(self, value: Any, env_indices: NDArray[np.int64]) -> list[Any]:
        """Splits a value with N items, or a dict of these, into one per environment; any other
        value is repeated."""
        if isinstance(value, dict) and value:
            columns = [self._items(item, env_indices) for item in value.values()]
            return [dict(zip(value, row, strict=True)) for row in zip(*columns, strict=True)]
        is_array = isinstance(value, np.ndarray) and value.ndim > 0
        if not (is_array or isinstance(value, (list, tuple))) or len(value) != self.num_envs:
            return [value] * len(env_indices)
        if not is_array:
            return [value[env_index] for env_index in env_indices]
        if value.ndim == 1:
            return value[env_indices].tolist()  # Python's scalars
        return list(value[env_indices])

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
        for layer in layers(self.env):
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
        is_wrapped = any(isinstance(layer, wrapper_class) for layer in layers(self.env))
        return [is_wrapped for _ in self._get_indices(indices)]

    def close(self) -> None:
        """Closes the vector environment."""
        self.env.close()


def make_sb3_vec_env(
    env_id: str,
    n_envs: int = 1,
    *,
    seed: int | None = None,
    info_keys: Sequence[str] | None = (),
    **keywords: Any,
) -> CableBotVecEnv:
    """Makes N environments of one id as one compiled batch for SB3.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`, or another id with a vector environment.
        n_envs: number of environments N.
        seed: environment i gets ``seed + i`` at the first reset, and the action space gets
            ``seed``; None for random seeds.
        info_keys: see :class:`CableBotVecEnv`.
        keywords: keyword arguments of the environment, see ``help(gym.make(env_id).unwrapped)``,
            and ``max_episode_steps``, control steps after which an episode is truncated if its
            motion is longer.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if a keyword is unknown or a value is invalid.
    """
    env = gym.make_vec(env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.DISABLED, **keywords)
    vec_env = CableBotVecEnv(env, info_keys=info_keys)
    if seed is not None:
        vec_env.seed(seed)
        vec_env.action_space.seed(seed)
    return vec_env


def _names(info: Mapping[str, Any]) -> tuple[str, ...]:
    """Keys of a vector info, without the masks."""
    return tuple(key for key in info if not key.startswith("_"))
