"""Wrapper that makes a learner's actions steer a classical law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.base import Base, default_base, find_base
from cablebot_baselines.learned.steering import Memory, Shift, Steering, find_action_mapping
from cablebot_baselines.learned.wrappers.layers import TrainingWrapper, restart_mask
from cablebot_gym.envs.vector import VectorStep
from cablebot_gym.utils.checks import number, numbers

ACTIONS = 40
"""Default number of actions in an episode: one action each 40 ms of the paper's circle."""


class Steered(TrainingWrapper):
    """A learner's action steers a classical law: it shifts the law's reference.

    A step is one action of each of the N environments, which lasts ``Steering.periods`` control
    periods. Their rewards are summed. If an episode ends within an action, the rest of the action
    has no effect on its results; its ``info`` is that of its last control period. Wrappers that
    need every control period go inside. Actions are clipped to [−1, 1]. The observation, float32,
    consists of ``features``, see :mod:`cablebot_baselines.learned.features`. A
    :class:`cablebot_baselines.learned.bundle.Bundle` with the same ``base``, ``steering`` and
    ``features`` stores a trained policy.

    Reset ended environments with the option ``reset_mask`` before the next step.

    Args:
        env: vector environment of this package with autoreset disabled, optionally with other
            wrappers.
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
        ValueError: if the environment is not such a one, an argument is invalid, the law does not
            support the robot, the observation is normalised, or the environment is already steered.
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
        if env_settings.normalised_observation or env_settings.observation_dtype != "float64":
            raise ValueError(
                "Steered reads observations in physical units and float64: leave out "
                "normalised_observation and observation_dtype"
            )
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
        """Starts episodes; seed and options as for the environment.

        Raises:
            ValueError: if the seed or an option is invalid, or the environments would have
                different error bounds.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        marked = restart_mask(options, self.num_envs)
        if marked.all() or {"trajectory", "error_bounds"} & set(options or {}):
            self.steering.reset(self._base_env.tasks)
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
        form = f"{steering.actions} numbers in [−1, 1] for each environment"
        actions = numbers("action", actions, shapes=[(self.num_envs, steering.actions)], form=form)
        total = -self._effort * np.mean(np.clip(actions, -1.0, 1.0) ** 2, axis=-1)
        terminated, truncated, ended = np.zeros((3, self.num_envs), np.bool_)
        ends = []
        for _ in range(steering.periods):
            applied, memory = steering.respond(blocks, actions, memory, self._start)
            self._start = np.zeros_like(self._start)
            observation, reward, failed, over, info = self.env.step(applied)
            total += np.where(ended, 0.0, reward)
            last = {"observation": observation, "step": memory.step, "info": info}
            fresh = (failed | over) & ~ended
            if fresh.any():
                terminated |= fresh & failed
                truncated |= fresh & over
                ended |= fresh
                ends.append((np.flatnonzero(fresh), last))
                if ended.all():
                    break
            # The law must not be evaluated at the state of an ended plant, which may be anywhere.
            blocks = steering.split(np.where(ended[:, None], self._start_observation, observation))
        self._memory = memory
        self._blocks = blocks
        self._ended = ended
        for env_indices, at_end in ends:
            last = _with_rows(last, at_end, env_indices)
        memory = replace(memory, step=last["step"])
        observed = self._observe(steering.split(last["observation"]), memory)
        return observed, total, terminated, truncated, last["info"]


def _with_rows(values: Any, replacement: Any, env_indices: Array) -> Any:
    """A copy of an array, or of a dict of arrays, with some rows of another."""
    if isinstance(values, dict):
        return {
            name: _with_rows(value, replacement[name], env_indices)
            for name, value in values.items()
        }
    merged = values.copy()
    merged[env_indices] = replacement[env_indices]
    return merged
