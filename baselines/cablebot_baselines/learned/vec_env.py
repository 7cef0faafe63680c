"""Adapter from Gymnasium's vector environment to Stable-Baselines3 (SB3), for training on one compiled batch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import EllipsisType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

import cablebot_gym  # noqa: F401 - registers the ids

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn
except ImportError as error:
    raise ImportError("SB3's VecEnv needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error

FINAL_KEYS = ("termination_reason", "payload", "episode", "is_success")
"""Info keys that an ended episode always has if the environment provides them; SB3 itself reads the last two."""

_FINAL = ("final_obs", "final_info")


class CableBotVecEnv(VecEnv):
    """SB3's interface of a Gymnasium vector environment; its results equal those of SB3's ``DummyVecEnv`` bit by bit.

    ``step`` returns observations (N, size) in the dtype of the observation space, rewards (N,) in float32, dones (N,)
    and N dicts. When an episode ends, the returned observation is the first of the next episode, and the dict contains
    the last observation as ``terminal_observation`` and the keys in :data:`FINAL_KEYS`. Every dict has
    ``TimeLimit.truncated``, which is true if only the time limit ended the episode. Seeds and options apply once, at
    the next ``reset``: environment i gets ``seed + i``.

    Args:
        env: vector environment from ``gym.make_vec(id, num_envs=N, autoreset_mode=AutoresetMode.SAME_STEP)``, with or
            without wrappers; a wrapper that changes observations must also change ``final_obs``.
        info_keys: further keys of ``info`` that each dict gets at each step. None selects all keys, which for 1024
            environments takes three times as long as the physics.

    Raises:
        TypeError: if ``env`` is not a vector environment.
        ValueError: if it has another autoreset mode, or ``info_keys`` is a string. The first ``step`` raises it if a
            key is unknown.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], *, info_keys: Sequence[str] | None = ()) -> None:
        if not isinstance(env, VectorEnv):
            raise TypeError(f"env must be a Gymnasium vector environment, from gym.make_vec, not {type(env).__name__}")
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"SB3 needs autoreset mode SAME_STEP, but this environment has {getattr(mode, 'name', mode)}: use "
                "gym.make_vec(…, autoreset_mode=AutoresetMode.SAME_STEP), or make_sb3_vec_env"
            )
        if isinstance(info_keys, str):
            raise ValueError(f"info_keys must be a sequence of names, ({info_keys!r},), not the string {info_keys!r}")
        self.env = env
        """The vector environment."""
        self.spec = env.spec
        """The environment's spec; SB3's ``VecMonitor`` reads its name."""
        self._info_keys = None if info_keys is None else tuple(info_keys)
        self._unchecked = bool(info_keys)
        self._reset_keys: frozenset[str] = frozenset()
        self._actions: NDArray[Any] | None = None
        self._started = False
        self._all_indices = np.arange(env.num_envs)
        self._all_true = np.ones(env.num_envs, np.bool_)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Sets the options of the next reset: a list of N dicts, or one dict whose values may be per environment.

        Raises:
            ValueError: if it is a list of another length, or has ``reset_mask``.
        """
        each = list(options) if isinstance(options, (list, tuple)) else [options] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"options must be one dict or a list of {self.num_envs} dicts, not of {len(each)}")
        if any("reset_mask" in (one or {}) for one in each):
            raise ValueError("reset() of a VecEnv resets all environments: remove reset_mask from the options")
        super().set_options(options)

    def reset(self) -> VecEnvObs:
        """Resets every environment with the seeds and options set before; returns observations (N, size).

        Raises:
            ValueError: if a seed or an option is invalid; seeds and options then stay set.
        """
        groups: dict[int, list[int]] = {}
        for env_index, options in enumerate(self._options):  # the base class keeps one dict for all as one object
            groups.setdefault(id(options) if options else 0, []).append(env_index)
        observation: Any = None
        for group in groups.values():
            env_indices, options = np.array(group), dict(self._options[group[0]] or {})
            # The very first reset must reset all environments.
            if len(groups) > 1 and self._started:
                options["reset_mask"] = np.isin(self._all_indices, env_indices)
            # The base class's seeds increase by one per environment, as Gymnasium's do.
            observation, info = self.env.reset(seed=self._seeds[0], options=options or None)
            self._started = True
            self._reset_keys = frozenset(info)
            for env_index, one in zip(group, self._dicts(info, self._selected_keys(info), env_indices), strict=True):
                self.reset_infos[env_index] = one
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Sets the actions (N, m) for the next :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Steps every environment once; returns observations, rewards, dones and info dicts, see the class.

        Raises:
            RuntimeError: if no actions were set.
            ValueError: if the actions are not (N, m) finite numbers, or one of ``info_keys`` is unknown.
        """
        if self._actions is None:
            raise RuntimeError("call step_async(actions) before step_wait()")
        actions, self._actions = self._actions, None
        observation, reward, terminated, truncated, info = self.env.step(actions)
        done = terminated | truncated
        if self._unchecked:
            self._check_keys(info)
        infos = self._dicts(info, self._selected_keys(info), self._all_indices)
        if done.any():
            self._add_final(np.flatnonzero(done), info, infos)
        for one, limit in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            one["TimeLimit.truncated"] = limit
        return observation, reward.astype(np.float32), done, infos

    def _add_final(self, ended: NDArray[np.int64], info: Mapping[str, Any], infos: list[dict[str, Any]]) -> None:
        """Adds the last observation and info of ended episodes to their dicts.

        Keys that ``reset`` does not return, such as a wrapper's ``episode``, are next to ``final_info``.
        """
        own = {key: value for key, value in info.items() if key not in self._reset_keys}
        last = own | info.get("final_info", {})
        dicts = self._dicts(last, (*self._selected_keys(last), *FINAL_KEYS), ended)
        for env_index, final in zip(ended.tolist(), dicts, strict=True):
            self.reset_infos[env_index] = {
                key: value for key, value in infos[env_index].items() if key in self._reset_keys
            }
            infos[env_index] = final | {"terminal_observation": info["final_obs"][env_index]}

    def _selected_keys(self, info: Mapping[str, Any]) -> tuple[str, ...]:
        return _names(info) if self._info_keys is None else self._info_keys

    def _check_keys(self, info: Mapping[str, Any]) -> None:
        known = sorted({*self._reset_keys, *_names(info), *_names(info.get("final_info", {})), *FINAL_KEYS})
        if unknown := [key for key in self._info_keys or () if key not in known]:
            raise ValueError(f"unknown info key {unknown[0]!r}; choose from {', '.join(known)}")
        self._unchecked = False

    def _dicts(
        self, info: Mapping[str, Any], keys: Iterable[str], env_indices: NDArray[np.int64]
    ) -> list[dict[str, Any]]:
        """Splits a vector info into one dict per environment; the mask ``_key`` marks environments with a key."""
        dicts: list[dict[str, Any]] = [{} for _ in range(len(env_indices))]
        for key in keys:
            if key not in info:
                continue
            value, present = info[key], info.get(f"_{key}", self._all_true)[env_indices].tolist()
            nested = isinstance(value, dict)
            items = self._dicts(value, _names(value), env_indices) if nested else self._items(value, env_indices)
            for one, item, has_key in zip(dicts, items, present, strict=True):
                if has_key:
                    one[key] = item
        return dicts

    def _items(self, value: Any, env_indices: NDArray[np.int64]) -> list[Any]:
        """Splits a value with N items into one item per environment; any other value is repeated."""
        if isinstance(value, dict) and value and all(self._batched(item) for item in value.values()):
            columns = [self._items(item, env_indices) for item in value.values()]
            return [dict(zip(value, row, strict=True)) for row in zip(*columns, strict=True)]
        if not self._batched(value):
            return [value] * len(env_indices)
        if isinstance(value, np.ndarray):
            rows = value[env_indices]
            return rows.tolist() if rows.ndim == 1 else list(rows)
        return [value[env_index] for env_index in env_indices]

    def _batched(self, value: Any) -> bool:
        array = isinstance(value, np.ndarray) and value.ndim > 0
        return (array or isinstance(value, (list, tuple))) and len(value) == self.num_envs

    def _env_indices(self, indices: VecEnvIndices) -> NDArray[np.int64]:
        return self._all_indices[list(self._get_indices(indices))]

    def _layers(self) -> Iterator[VectorEnv[Any, Any, Any]]:
        """The environment and the environments that it wraps, from the outside in."""
        layer = self.env
        while isinstance(layer, VectorWrapper):
            yield layer
            layer = layer.env
        yield layer

    def _attribute(self, name: str) -> Any:
        return getattr(next((layer for layer in self._layers() if hasattr(layer, name)), self.env.unwrapped), name)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of each environment: one item each if the attribute has N items, otherwise the same value.

        Raises:
            AttributeError: if the vector environment has no such attribute.
        """
        # The vector environment's own spaces are those of the whole batch.
        name = f"single_{attr_name}" if attr_name in ("action_space", "observation_space") else attr_name
        return self._items(self._attribute(name), self._env_indices(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Not available.

        Raises:
            NotImplementedError: always; the message names the alternatives.
        """
        raise NotImplementedError(
            f"{attr_name!r} cannot be set because the environments are one compiled batch: give keyword arguments when "
            "the environment is made, or use set_options() for the next episodes"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls a method of the vector environment once for all; the result is split as by :meth:`get_attr`.

        Raises:
            AttributeError: if the vector environment has no such method.
            NotImplementedError: for ``reset``, ``step`` and ``close``, or if ``indices`` are not all environments.
        """
        if method_name in ("reset", "step", "close"):
            raise NotImplementedError(f"a single environment cannot {method_name}: use {method_name}() of the VecEnv")
        method, env_indices = self._attribute(method_name), self._env_indices(indices)
        if len(set(env_indices.tolist())) < self.num_envs:
            raise NotImplementedError(f"{method_name!r} acts on all environments at once: omit indices")
        return self._items(method(*method_args, **method_kwargs), env_indices)

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Whether a ``wrapper_class`` wraps the batch; always false for wrappers of single environments."""
        wrapped = any(isinstance(layer, wrapper_class) for layer in self._layers())
        return [wrapped] * len(self._env_indices(indices))

    def close(self) -> None:
        """Closes the vector environment."""
        self.env.close()


def make_sb3_vec_env(
    env_id: str,
    n_envs: int = 1,
    *,
    seed: int | None = None,
    max_episode_steps: int | EllipsisType | None = ...,
    info_keys: Sequence[str] | None = (),
    **keywords: Any,
) -> CableBotVecEnv:
    """Makes N environments of one id as one compiled batch for SB3.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`, or another id with a vector environment.
        n_envs: number of environments N.
        seed: environment i gets ``seed + i`` at the first reset, and the action space gets ``seed``; None for random
            seeds.
        max_episode_steps: control steps to truncation; None for no limit. Default: that of the id, 500.
        info_keys: see :class:`CableBotVecEnv`.
        keywords: keyword arguments of the environment, see ``help(gym.make(env_id).unwrapped)``.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if a keyword is unknown or a value is invalid.
    """
    if max_episode_steps is not ...:
        keywords["max_episode_steps"] = max_episode_steps
    env = gym.make_vec(env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.SAME_STEP, **keywords)
    vec_env = CableBotVecEnv(env, info_keys=info_keys)
    if seed is not None:
        vec_env.seed(seed)
        vec_env.action_space.seed(seed)
    return vec_env


def _names(info: Mapping[str, Any]) -> tuple[str, ...]:
    """Keys of a vector info for the current instant, without the masks."""
    return tuple(key for key in info if not key.startswith("_") and key not in _FINAL)
