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
from numpy.typing import ArrayLike

import cablebot_gym  # noqa: F401 - registers the ids
from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.base import Base, default_base, find_base
from cablebot_baselines.learned.steering import (
    Memory,
    Shift,
    Steering,
    find_action_mapping,
)
from cablebot_baselines.learned.wrappers.layers import BatchWrapper, SingleWrapper, restart_mask
from cablebot_gym.envs.vector import VectorStep
from cablebot_gym.utils.checks import number, numbers

ACTIONS = 40
"""Default number of actions in an episode: one action each 40 ms of the paper's circle."""


class SteeredVector(BatchWrapper):
    """Vector form of :class:`Steered` for N environments, with the same arguments.

    If an episode ends within an action, the rest of the action has no effect on its results. Reset
    ended environments with the option ``reset_mask`` before the next step.

    Raises:
        TypeError: if the environment is not a :class:`CableBotVectorEnv`.
        ValueError: as :class:`Steered`, or if its autoreset is not disabled.
    """

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        base: Base | str | Mapping[str, Any] | None = None,
        steering: Shift | str | Mapping[str, Any] | None = None,
        features: Sequence[str],
        effort: float = 0.0,
    ) -> None:
        super().__init__(env)
        env_settings = self._base_env.settings
        if env_settings.normalised_observation:
            raise ValueError(
                "Steered reads observations in physical units: leave out normalised_observation"
            )
        if env_settings.observation_dtype != "float64":
            raise ValueError("Steered reads observations in float64: leave out observation_dtype")
        self._effort = number("effort", effort, least=0.0)
        robot = env_settings.robot
        if base is None:
            base = default_base(robot)
        if steering is None:
            steering = Shift(action_period=env_settings.trajectory.duration / ACTIONS)
        self.steering = Steering(
            robot,
            base=find_base(base),
            action_mapping=find_action_mapping(steering),
            features=features,
        )
        """The steered base law."""
        self.single_observation_space = Box(-np.inf, np.inf, (self.steering.inputs,), np.float32)
        self.single_action_space = Box(-1.0, 1.0, (self.steering.actions,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._memory: Memory | None = None
        self._blocks: dict[str, Array] = {}
        self._start = np.zeros(self.num_envs, np.bool_)
        self._ended = np.zeros(self.num_envs, np.bool_)
        self._start_observation = np.zeros((self.num_envs, self._base_env.layout.size))

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts episodes; seeds and options as for the environment, except ``error_bounds`` for
        several environments.

        Raises:
            ValueError: if a seed or an option is invalid.
        """
        if self.num_envs > 1 and "error_bounds" in (options or {}):
            raise ValueError(
                "error_bounds must be the same in all environments and episodes: give error_bounds when the "
                "environments are made"
            )
        observation, info = self.env.reset(seed=seed, options=options)
        marked = restart_mask(options, self.num_envs)
        if marked.all() or "trajectory" in (options or {}):
            self.steering.reset(self.tasks)
        self._start_observation[marked] = observation[marked]
        self._blocks = self.steering.split(observation)
        self._memory = self.steering.reset_memory(self._blocks, self._memory, marked)
        self._start = self._start | marked
        self._ended = self._ended & ~marked
        return self._observe(self._blocks, self._memory), info

    def _observe(self, blocks: dict[str, Array], memory: Memory) -> Array:
        return self.steering.observe(blocks, memory).astype(np.float32)

    def step(self, actions: ArrayLike) -> VectorStep:
        """One action, which lasts ``Steering.periods`` control periods or until the episode ends.

        Raises:
            ResetNeeded: before the first reset, and if an episode has ended.
            ValueError: if the actions are not (N, size) finite numbers.
        """
        if self._memory is None or self._ended.any():
            raise ResetNeeded(
                "an episode has ended or was never started: call reset(), with reset_mask for some"
            )
        steering = self.steering
        memory = self._memory
        blocks = self._blocks
        start = self._start
        form = f"{steering.actions} numbers in [−1, 1] for each environment"
        actions = numbers("action", actions, shapes=[(self.num_envs, steering.actions)], form=form)
        total = -self._effort * np.mean(np.clip(actions, -1.0, 1.0) ** 2, axis=-1)
        terminated = np.zeros(self.num_envs, np.bool_)
        truncated = np.zeros(self.num_envs, np.bool_)
        ended = np.zeros(self.num_envs, np.bool_)
        ends = []
        for _ in range(steering.periods):
            applied, memory = steering.respond(blocks, actions, memory, start)
            start = np.zeros_like(start)
            observation, reward, failed, over, info = self.env.step(applied)
            total += np.where(ended, 0.0, reward)
            fresh = (failed | over) & ~ended
            if fresh.any():
                terminated = terminated | fresh & failed
                truncated = truncated | fresh & over
                ended = ended | fresh
                ends.append((np.flatnonzero(fresh), observation, memory.step, info))
                if ended.all():
                    break
            # The law must not be evaluated at the state of an ended plant, which may be anywhere.
            blocks = steering.split(np.where(ended[:, None], self._start_observation, observation))
        self._memory = memory
        self._blocks = blocks
        self._start = start
        self._ended = ended
        if not ends:
            return self._observe(blocks, memory), total, terminated, truncated, info
        for env_indices, its_observation, its_step, its_info in ends:
            if its_observation is observation:
                break
            observation = _with_rows(observation, its_observation, env_indices)
            memory = replace(memory, step=_with_rows(memory.step, its_step, env_indices))
            info = {
                name: _with_rows(value, its_info[name], env_indices) for name, value in info.items()
            }
        return (
            self._observe(steering.split(observation), memory),
            total,
            terminated,
            truncated,
            info,
        )


def _with_rows(values: Array, replacement: Array, env_indices: Array) -> Array:
    """A copy of an array with some rows of another."""
    merged = values.copy()
    merged[env_indices] = replacement[env_indices]
    return merged


class Steered(SingleWrapper):
    """A learner's action steers a classical law: it shifts the law's reference.

    A step is one action, which lasts ``Steering.periods`` control periods. Their rewards are
    summed, and the step ends early if the episode ends. ``info`` is that of the last control
    period; wrappers that need every control period go inside. Actions are clipped to [−1, 1]. The
    observation, float32, consists of ``features``, see :mod:`cablebot_baselines.learned.features`.
    A :class:`cablebot_baselines.learned.bundle.Bundle` with the same ``base``, ``steering`` and
    ``features`` stores a trained policy.

    Args:
        env: single environment of this package, optionally with other wrappers.
        base: base law as a name, a dict ``{"law": …, "gains": …}`` or a :class:`Base`; None for
            that of the robot, see :func:`~cablebot_baselines.learned.base.default_base`.
        steering: action mapping: ``"shift"``, a dict ``{"kind": "shift", "action_period": 0.04,
            …}``, or a :class:`Shift`; None for a shift with :data:`ACTIONS` actions in the
            motion.
        features: names of the features, in the order of the observation.
        effort: penalty factor of the mean square of each action; ≥ 0. At the end of an episode,
            actions have no consequence; without this penalty they drift to the edge of their range,
            where the gradient vanishes.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is invalid, the law does not support the robot, the observation
            is normalised, or the environment is already steered.
    """

    vector: ClassVar[type[Any]] = SteeredVector

    @property
    def steering(self) -> Steering:
        """The steered base law."""
        steering: Steering = self.batch.steering
        return steering


def make_steered_vec(
    env_id: str,
    n_envs: int,
    *,
    wrappers: Sequence[tuple[type[Any], Mapping[str, Any]]],
    seed: int | None = None,
    **keywords: Any,
) -> SteeredVector:
    """Makes N environments of one id as one compiled batch, with the vector forms of the given
    wrappers.

    Stable-Baselines3 trains on ``CableBotVecEnv(make_steered_vec(…))``. Autoreset is disabled.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        n_envs: number of environments N.
        wrappers: wrapper classes and their arguments, innermost first; the last one is
            :class:`Steered`.
        seed: environment i is reset with ``seed + i``, and the action space is seeded; later resets
            continue the random streams.
        keywords: keyword arguments of the environment, see ``help(gym.make(env_id).unwrapped)``,
            and ``max_episode_steps``.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if the last wrapper is not :class:`Steered`, the order is wrong, a wrapper has
            no vector form, or an argument is unknown, missing or invalid.
    """
    env: Any = gym.make_vec(
        env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.DISABLED, **keywords
    )
    for wrapper, arguments in wrappers:
        vector = getattr(wrapper, "vector", None)
        if vector is None:
            raise ValueError(
                f"wrappers: {wrapper.__name__} has no vector form (attribute 'vector')"
            )
        try:
            env = vector(env, **arguments)
        except TypeError as error:
            raise ValueError(f"wrappers: {wrapper.__name__}: {error}") from None
    if not isinstance(env, SteeredVector):
        raise ValueError("the last (outermost) wrapper must be Steered")
    if seed is not None:
        env.reset(seed=seed)
        env.action_space.seed(seed)
    return env
