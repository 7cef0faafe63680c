"""Wrapper that makes a learner's actions steer a classical law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.base import Base, find_base
from cablebot_baselines.learned.steering import Memory, Residual, Shift, Steering, find_action_mapping
from cablebot_baselines.learned.wrappers.layers import (
    STEERED,
    BatchWrapper,
    SingleStep,
    SingleWrapper,
    check_number,
    restart_mask,
)
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.envs.vector import CableBotVectorEnv, VectorStep


def _steering(
    plant: CableBotEnv | CableBotVectorEnv,
    base: Base | str | Mapping[str, Any],
    steering: Shift | Residual | str | Mapping[str, Any],
    features: Sequence[str],
) -> tuple[Steering, Box, Box]:
    """The steered law, and the spaces of a learner's observations and actions."""
    steered = Steering(
        plant.settings.robot, base=find_base(base), action_mapping=find_action_mapping(steering), features=features
    )
    return steered, Box(-np.inf, np.inf, (steered.inputs,), np.float32), Box(-1.0, 1.0, (steered.actions,), np.float32)


def _checked(action: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Checks that an action has finite numbers and the given shape, and returns it as floats.

    Raises:
        ValueError: if not.
    """
    try:
        checked = np.asarray(action, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"action must be {shape[-1]} numbers for each environment, not {action!r}") from error
    if checked.shape != shape:
        raise ValueError(f"action must have shape {shape}, with numbers in [−1, 1], not shape {checked.shape}")
    if not np.all(np.isfinite(checked)):
        raise ValueError("action must be finite; it contains NaN or infinity")
    return checked


def _mean_square(actions: Array) -> Array:
    """Mean square of each clipped action, (...)."""
    square: Array = np.mean(np.clip(actions, -1.0, 1.0) ** 2, axis=-1)
    return square


class SteeredVector(BatchWrapper):
    """Vector form of :class:`Steered` for N environments, with same-step autoreset and the same arguments.

    If an episode ends within an action, the rest of the action has no effect on it, and the environment is then reset.
    ``final_obs`` and ``final_info`` contain its last observation and info at the end of the episode, in the form of
    :class:`CableBotVectorEnv`.

    Raises:
        TypeError: if the environment is not a :class:`CableBotVectorEnv`.
        ValueError: as :class:`Steered`, or if its autoreset is not disabled.
    """

    level: ClassVar[int] = STEERED

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        base: Base | str | Mapping[str, Any],
        steering: Shift | Residual | str | Mapping[str, Any],
        features: Sequence[str],
        effort: float = 0.0,
    ) -> None:
        super().__init__(env)
        check_number("effort", effort, 0.0)
        self._effort = float(effort)
        self.steering, observation_space, action_space = _steering(self._plant, base, steering, features)
        """The steered base law."""
        self.metadata = {**env.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space, self.single_action_space = observation_space, action_space
        self.observation_space = batch_space(observation_space, self.num_envs)
        self.action_space = batch_space(action_space, self.num_envs)
        self._memory: Memory | None = None
        self._blocks: dict[str, Array] = {}
        self._start: NDArray[np.bool_] = np.zeros(self.num_envs, np.bool_)
        self._first = np.zeros((self.num_envs, self._plant.layout.size))

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes; seeds and options as for :class:`CableBotVectorEnv`, except ``error_bounds``.

        Raises:
            ValueError: if a seed or an option is invalid.
        """
        if "error_bounds" in (options or {}):
            raise ValueError(
                "error_bounds is not a valid option here, because it would apply to the first episodes only: give "
                "error_bounds when the environments are made"
            )
        observation, info = self.env.reset(seed=seed, options=options)
        marked = restart_mask(options, self.num_envs)
        if self._memory is None or marked.all():
            self.steering.reset(self._plant.tasks)
        return self._start_episodes(observation, marked), info

    def _start_episodes(self, observation: Array, marked: NDArray[np.bool_]) -> Array:
        """Starts the episodes of the marked environments; returns the learner's observation (N, features)."""
        self._first[marked] = observation[marked]
        self._blocks = self.steering.split(observation)
        self._memory = self.steering.reset_memory(self._blocks, self._memory, marked)
        self._start = self._start | marked
        return self._observe(self._blocks, self._memory)

    def _observe(self, blocks: dict[str, Array], memory: Memory) -> Array:
        return self.steering.observe(blocks, memory).astype(np.float32)

    def step(self, actions: ArrayLike) -> VectorStep:
        """One action, which lasts ``Steering.periods`` control periods.

        Raises:
            ResetNeeded: before the first reset.
            ValueError: if the actions are not (N, size) finite numbers.
        """
        if self._memory is None:
            raise ResetNeeded("call reset() before step()")
        actions = _checked(actions, (self.num_envs, self.steering.actions))
        steering, memory, blocks, start = self.steering, self._memory, self._blocks, self._start
        total = -self._effort * _mean_square(actions)
        terminated, truncated, ended = (np.zeros(self.num_envs, np.bool_) for _ in range(3))
        last = _Last()
        for _ in range(steering.periods):
            applied, memory = steering.respond(blocks, actions, memory, start)
            start = np.zeros_like(start)
            observation, reward, failed, over, info = self.env.step(applied, past_end=True)
            total += np.where(ended, 0.0, reward)
            fresh = (failed | over) & ~ended
            if fresh.any():
                terminated |= fresh & failed
                truncated |= fresh & over
                ended |= fresh
                last.keep(fresh, observation, memory.step, info)
                if ended.all():
                    break
            # The law must not be evaluated at the state of an ended plant, which may be anywhere.
            observation[ended] = self._first[ended]
            blocks = steering.split(observation)
        self._memory, self._blocks, self._start = memory, blocks, start
        if not ended.any():
            return self._observe(blocks, memory), total, terminated, truncated, info
        final = self._final(ended, last, memory)
        observation, info = self.env.reset(options={"reset_mask": ended.copy()})
        return self._start_episodes(observation, ended), total, terminated, truncated, info | final

    def _final(self, ended: NDArray[np.bool_], last: _Last, memory: Memory) -> dict[str, Any]:
        """The last observation and info of ended environments, in the form of :class:`CableBotVectorEnv`."""
        env_indices = np.flatnonzero(ended)
        then = replace(
            memory,
            actions=memory.actions[env_indices],
            anchors=memory.anchors[env_indices],
            step=last.steps[env_indices],
        )
        observations = np.full(self.num_envs, None, dtype=object)
        for env_index, row in zip(
            env_indices, self._observe(self.steering.split(last.observation[env_indices]), then), strict=True
        ):
            observations[env_index] = row.copy()
        info = last.info | {f"_{name}": ended.copy() for name in last.info}
        return {"final_obs": observations, "_final_obs": ended.copy(), "final_info": info, "_final_info": ended.copy()}


class _Last:
    """Last observations, control instants and infos of episodes that end within one action."""

    observation: Array
    steps: NDArray[np.int64]
    info: dict[str, Array]

    def __init__(self) -> None:
        self._empty = True

    def keep(
        self, ended: NDArray[np.bool_], observation: Array, steps: NDArray[np.int64], info: dict[str, Any]
    ) -> None:
        """Stores the values of the environments whose episodes have just ended."""
        if self._empty:
            self.observation, self.steps = observation.copy(), steps.copy()
            self.info = {name: np.array(value) for name, value in info.items()}
            self._empty = False
            return
        env_indices = np.flatnonzero(ended)
        self.observation[env_indices], self.steps[env_indices] = observation[env_indices], steps[env_indices]
        for name, kept in self.info.items():
            kept[env_indices] = info[name][env_indices]


class Steered(SingleWrapper):
    """A learner's action steers a classical law: it shifts the law's reference, or adds to the law's actions.

    A step is one action, which lasts ``Steering.periods`` control periods. Their rewards are summed, and the step ends
    early if the episode ends. ``info`` is that of the last control period; wrappers that need every control period go
    inside. Actions are clipped to [−1, 1]. The observation, float32, consists of ``features``, see
    :mod:`cablebot_baselines.learned.features`. A :class:`cablebot_baselines.learned.bundle.Bundle` with the same
    ``base``, ``steering`` and ``features`` stores a trained policy.

    Args:
        env: single environment of this package, optionally with other wrappers.
        base: base law as a name, a dict ``{"law": …, "gains": …}`` or a :class:`Base`.
        steering: action mapping: ``"shift"``, ``"residual"``, a dict ``{"kind": "shift", "action_period": 0.04, …}``, a
            :class:`Shift` or a :class:`Residual`.
        features: names of the features, in the order of the observation.
        effort: penalty factor of the mean square of each action; ≥ 0. At the end of an episode, actions have no
            consequence; without this penalty they drift to the edge of their range, where the gradient vanishes.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is invalid, the law does not support the robot, or the environment is already
            steered.
    """

    level: ClassVar[int] = STEERED
    vector: ClassVar[type[SteeredVector]] = SteeredVector

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        base: Base | str | Mapping[str, Any],
        steering: Shift | Residual | str | Mapping[str, Any],
        features: Sequence[str],
        effort: float = 0.0,
    ) -> None:
        super().__init__(env, base=base, steering=steering, features=features, effort=effort)
        check_number("effort", effort, 0.0)
        self._effort = float(effort)
        self.steering, self.observation_space, self.action_space = _steering(self._plant, base, steering, features)
        """The steered base law."""
        self._memory: Memory | None = None
        self._blocks: dict[str, Array] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; seed and options as for the environment.

        Raises:
            ValueError: if the seed or an option is invalid.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self.steering.reset([self._plant.task])
        self._blocks = self.steering.split(observation)
        self._memory = self.steering.reset_memory(self._blocks, None, None)
        return self._observe(self._blocks, self._memory), info

    def _observe(self, blocks: dict[str, Array], memory: Memory) -> Array:
        return self.steering.observe(blocks, memory).astype(np.float32)

    def step(self, action: ArrayLike) -> SingleStep:
        """One action, which lasts ``Steering.periods`` control periods or until the episode ends.

        Raises:
            ResetNeeded: before the first reset, and after the end of an episode.
            ValueError: if the action is not a vector of finite numbers of the right size.
        """
        if self._memory is None:
            raise ResetNeeded("no episode is running: call reset() before step()")
        action = _checked(action, (self.steering.actions,))
        steering, memory, blocks = self.steering, self._memory, self._blocks
        total = -self._effort * float(_mean_square(action))
        for _ in range(steering.periods):
            applied, memory = steering.respond(blocks, action, memory)
            observation, reward, terminated, truncated, info = self.env.step(applied)
            total += float(reward)
            blocks = steering.split(observation)
            if terminated or truncated:
                break
        self._blocks, self._memory = blocks, None if terminated or truncated else memory
        return self._observe(blocks, memory), total, terminated, truncated, info
