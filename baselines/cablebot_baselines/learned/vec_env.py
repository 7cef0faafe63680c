"""Stable-Baselines3's vector environment over Gymnasium's, so that SB3 trains on one compiled batch (extra ``sb3``)."""

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

AT_THE_END = ("termination_reason", "payload", "episode", "is_success")
"""Info keys that an ended episode always has, where the environment knows them; SB3 itself reads the last two."""

_FINAL = ("final_obs", "final_info")


class CableBotVecEnv(VecEnv):
    """A Gymnasium vector environment with same-step autoreset, as SB3 wants it: bit for bit SB3's ``DummyVecEnv``.

    ``step`` returns observations (N, size) in the dtype of the observation space, rewards (N,) in float32, dones (N,)
    and N dicts. Of an ended episode the observation is the first of the next one, and the dict has its last one as
    ``terminal_observation`` and the keys in :data:`AT_THE_END`; every dict has ``TimeLimit.truncated``, true if the
    time limit alone ended the episode. Seeds and options count at the next ``reset``, once: environment i gets
    ``seed + i``.

    Args:
        env: made by ``gym.make_vec(id, num_envs=N, autoreset_mode=AutoresetMode.SAME_STEP)``; may be wrapped, where a
            wrapper that changes observations has to change ``final_obs`` too.
        info_keys: further keys of ``info`` that each dict gets at each step. None is all of them: of 1024
            environments, three times as long as the physics.

    Raises:
        TypeError: if ``env`` is no vector environment.
        ValueError: if it has another autoreset mode, or ``info_keys`` is a string; by the first ``step``, if one of the
            keys is unknown.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], *, info_keys: Sequence[str] | None = ()) -> None:
        if not isinstance(env, VectorEnv):
            raise TypeError(f"env must be a Gymnasium vector environment, from gym.make_vec, not {type(env).__name__}")
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"SB3 needs autoreset in the same step, this environment has {getattr(mode, 'name', mode)}: make it by "
                "gym.make_vec(…, autoreset_mode=AutoresetMode.SAME_STEP), or by make_sb3_vec_env"
            )
        if isinstance(info_keys, str):
            raise ValueError(f"info_keys must be several names, ({info_keys!r},), not the string {info_keys!r}")
        self.env = env
        """The vector environment."""
        self.spec = env.spec
        """What :class:`VecMonitor` names its file's environment by."""
        self._info_keys = None if info_keys is None else tuple(info_keys)
        self._unchecked = bool(info_keys)
        self._reset_keys: frozenset[str] = frozenset()
        self._actions: NDArray[Any] | None = None
        self._started = False
        self._everyone = np.arange(env.num_envs)
        self._marked = np.ones(env.num_envs, np.bool_)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Options of the next reset: one dict for all, where values may be one per environment, or a list of N dicts.

        Raises:
            ValueError: if it is a list of another length, or has ``reset_mask``.
        """
        each = list(options) if isinstance(options, (list, tuple)) else [options] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"options must be one dict or {self.num_envs}, one for each environment, not {len(each)}")
        if any("reset_mask" in (one or {}) for one in each):
            raise ValueError("reset() of a VecEnv restarts all environments: leave reset_mask out of the options")
        super().set_options(options)

    def reset(self) -> VecEnvObs:
        """Starts an episode in every environment, with the seeds and options set before; observations (N, size).

        Raises:
            ValueError: if a seed or an option is not valid; seeds and options stay set then.
        """
        groups: dict[int, list[int]] = {}
        for lane, options in enumerate(self._options):  # the base class keeps one dict for all as one object
            groups.setdefault(id(options) if options else 0, []).append(lane)
        observation: Any = None
        for group in groups.values():
            lanes, options = np.array(group), dict(self._options[group[0]] or {})
            # The very first group starts all: others that were not yet started cannot be left alone.
            if len(groups) > 1 and self._started:
                options["reset_mask"] = np.isin(self._everyone, lanes)
            # The base class's seeds count up by one, as Gymnasium's do.
            observation, info = self.env.reset(seed=self._seeds[0], options=options or None)
            self._started = True
            self._reset_keys = frozenset(info)
            for lane, found in zip(group, self._dicts(info, self._wanted(info), lanes), strict=True):
                self.reset_infos[lane] = found
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Takes the actions (N, m) of the next :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """One control period of every environment: observations, rewards, dones and info dicts, see the class.

        Raises:
            RuntimeError: without actions.
            ValueError: if the actions are not (N, m) finite numbers, or one of ``info_keys`` is unknown.
        """
        if self._actions is None:
            raise RuntimeError("call step_async(actions) before step_wait()")
        actions, self._actions = self._actions, None
        observation, reward, terminated, truncated, info = self.env.step(actions)
        done = terminated | truncated
        if self._unchecked:
            self._check_keys(info)
        infos = self._dicts(info, self._wanted(info), self._everyone)
        if done.any():
            self._end(np.flatnonzero(done), info, infos)
        for found, limit in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            found["TimeLimit.truncated"] = limit
        return observation, reward.astype(np.float32), done, infos

    def _end(self, ended: NDArray[np.int64], info: Mapping[str, Any], infos: list[dict[str, Any]]) -> None:
        """Puts the last observation and info of ended episodes into their dicts, which have the next episodes' first.

        What ``reset`` does not return, such as a wrapper's ``episode``, stands beside ``final_info``.
        """
        own = {key: value for key, value in info.items() if key not in self._reset_keys}
        last = own | info.get("final_info", {})
        dicts = self._dicts(last, (*self._wanted(last), *AT_THE_END), ended)
        for lane, found in zip(ended.tolist(), dicts, strict=True):
            self.reset_infos[lane] = {key: value for key, value in infos[lane].items() if key in self._reset_keys}
            infos[lane] = found | {"terminal_observation": info["final_obs"][lane]}

    def _wanted(self, info: Mapping[str, Any]) -> tuple[str, ...]:
        return _names(info) if self._info_keys is None else self._info_keys

    def _check_keys(self, info: Mapping[str, Any]) -> None:
        known = sorted({*self._reset_keys, *_names(info), *_names(info.get("final_info", {})), *AT_THE_END})
        if unknown := [key for key in self._info_keys or () if key not in known]:
            raise ValueError(f"unknown info key {unknown[0]!r}; choose of {', '.join(known)}")
        self._unchecked = False

    def _dicts(self, info: Mapping[str, Any], keys: Iterable[str], lanes: NDArray[np.int64]) -> list[dict[str, Any]]:
        """What a vector info says of each of the lanes; ``_key`` marks the lanes that have a key."""
        dicts: list[dict[str, Any]] = [{} for _ in range(len(lanes))]
        for key in keys:
            if key not in info:
                continue
            value, marked = info[key], info.get(f"_{key}", self._marked)[lanes].tolist()
            nested = isinstance(value, dict)
            parts = self._dicts(value, _names(value), lanes) if nested else self._parts(value, lanes)
            for found, part, mark in zip(dicts, parts, marked, strict=True):
                if mark:
                    found[key] = part
        return dicts

    def _parts(self, value: Any, lanes: NDArray[np.int64]) -> list[Any]:
        """What a value says of each of the lanes: its item, where it has N of them, otherwise the value itself."""
        if isinstance(value, dict) and value and all(self._batched(item) for item in value.values()):
            columns = [self._parts(item, lanes) for item in value.values()]
            return [dict(zip(value, row, strict=True)) for row in zip(*columns, strict=True)]
        if not self._batched(value):
            return [value] * len(lanes)
        if isinstance(value, np.ndarray):
            rows = value[lanes]
            return rows.tolist() if rows.ndim == 1 else list(rows)
        return [value[lane] for lane in lanes]

    def _batched(self, value: Any) -> bool:
        array = isinstance(value, np.ndarray) and value.ndim > 0
        return (array or isinstance(value, (list, tuple))) and len(value) == self.num_envs

    def _lanes(self, indices: VecEnvIndices) -> NDArray[np.int64]:
        return self._everyone[list(self._get_indices(indices))]

    def _layers(self) -> Iterator[VectorEnv[Any, Any, Any]]:
        """The environment and all that it wraps, from the outside in."""
        layer = self.env
        while isinstance(layer, VectorWrapper):
            yield layer
            layer = layer.env
        yield layer

    def _attribute(self, name: str) -> Any:
        return getattr(next((layer for layer in self._layers() if hasattr(layer, name)), self.env.unwrapped), name)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of each environment: its item if the vector environment holds N of them, otherwise the value.

        Raises:
            AttributeError: if the vector environment has no such attribute.
        """
        # Its own spaces are those of the whole batch.
        name = f"single_{attr_name}" if attr_name in ("action_space", "observation_space") else attr_name
        return self._parts(self._attribute(name), self._lanes(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Not available.

        Raises:
            NotImplementedError: always, with what to do.
        """
        raise NotImplementedError(
            f"{attr_name!r} cannot be set, the environments are one compiled batch: give keywords where it is made, or "
            "set_options() for the next episodes"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls a method of the vector environment once, for all; the result is taken apart as by :meth:`get_attr`.

        Raises:
            AttributeError: if the vector environment has no such method.
            NotImplementedError: for ``reset``, ``step`` and ``close``, or if ``indices`` leave some environment out.
        """
        if method_name in ("reset", "step", "close"):
            raise NotImplementedError(f"no environment can {method_name} on its own: use {method_name}() of the VecEnv")
        method, lanes = self._attribute(method_name), self._lanes(indices)
        if len(set(lanes.tolist())) < self.num_envs:
            raise NotImplementedError(f"{method_name!r} acts on all environments at once: leave indices out")
        return self._parts(method(*method_args, **method_kwargs), lanes)

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Whether a wrapper of ``wrapper_class`` is around the batch; wrappers of single environments never are."""
        wrapped = any(isinstance(layer, wrapper_class) for layer in self._layers())
        return [wrapped] * len(self._lanes(indices))

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
    """N environments of one id as one compiled batch for SB3.

    Args:
        env_id: out of :data:`cablebot_gym.ENV_IDS`, or another with such a vector environment.
        n_envs: N.
        seed: environment i gets ``seed + i`` at the first reset, and the action space gets ``seed``; None draws them.
        max_episode_steps: control steps to truncation; None for no limit. Left out, it is the id's own, 500.
        info_keys: see :class:`CableBotVecEnv`.
        keywords: the environment's, see ``help(gym.make(env_id).unwrapped)``.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if a keyword is unknown or not valid.
    """
    if max_episode_steps is not ...:
        keywords["max_episode_steps"] = max_episode_steps
    env = gym.make_vec(env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.SAME_STEP, **keywords)
    made = CableBotVecEnv(env, info_keys=info_keys)
    if seed is not None:
        made.seed(seed)
        made.action_space.seed(seed)
    return made


def _names(info: Mapping[str, Any]) -> tuple[str, ...]:
    """Keys of a vector info that say something of the present instant, without the marks."""
    return tuple(key for key in info if not key.startswith("_") and key not in _FINAL)
