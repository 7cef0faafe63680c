"""Wrapper that ends an episode when the task criterion fails."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.wrappers.layers import (
    LIMITS,
    BatchWrapper,
    SingleStep,
    SingleWrapper,
    check_number,
    restart_mask,
)
from cablebot_gym.envs.settings import Settings
from cablebot_gym.envs.vector import VectorStep

SATURATED = 0.97
"""Absolute action above which the saturation penalty applies; the motor itself saturates at 1."""


class _Rule:
    """Reward and termination of N episodes."""

    def __init__(self, alive: float, failure: float, saturation: float) -> None:
        for name, value in (("alive", alive), ("failure", failure), ("saturation", saturation)):
            check_number(name, value, 0.0)
        self._alive, self._failure, self._saturation = float(alive), float(failure), float(saturation)

    def reason(self, info: Mapping[str, Any], bounds: Array, active: NDArray[np.bool_]) -> NDArray[np.str_]:
        """Termination reason of each episode, (N,); empty if it continues. The environment's own reason has priority.

        Args:
            info: info of the environment, arrays (N, …).
            bounds: bounds of position and rotation error, (N, 2) [m, rad].
            active: whether the motion is still running, (N,).
        """
        reason = np.select(
            [
                active & info["slack"].any(axis=-1),
                active & (info["tracking_error_peak"] > bounds[:, 0]),
                active & (info["rotation_error_peak"] > bounds[:, 1]),
            ],
            ["slack", "tracking_error", "rotation_error"],
            "",
        )
        own = info["termination_reason"]
        return np.where(own != "", own, reason)

    def reward(self, info: Mapping[str, Any], terminated: NDArray[np.bool_]) -> Array:
        """Reward of one control period, (N,)."""
        beyond = np.maximum(np.abs(info["commanded_action"]) - SATURATED, 0.0).mean(axis=-1)
        return self._alive - self._failure * terminated - self._saturation * beyond


def _motion_steps(settings: Settings) -> int:
    """Number of control steps of the default motion, as :attr:`cablebot_gym.task.Task.steps`."""
    return round(settings.trajectory.duration * settings.control_frequency)


class WithinLimitsVector(BatchWrapper):
    """Vector form of :class:`WithinLimits` for N environments, with the same arguments and errors."""

    level: ClassVar[int] = LIMITS

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        alive: float = 0.02,
        failure: float = 1.0,
        saturation: float = 0.02,
    ) -> None:
        super().__init__(env)
        self._rule = _Rule(alive, failure, saturation)
        self._bounds, self._needed = np.zeros((self.num_envs, 2)), np.zeros(self.num_envs, np.int64)
        self._steps = np.zeros(self.num_envs, np.int64)
        self._ended, self._succeeded = (np.zeros(self.num_envs, np.bool_) for _ in range(2))
        self._reason = np.full(self.num_envs, "", "<U14")

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes; ``info`` has ``is_success``."""
        observation, info = self.env.reset(seed=seed, options=options)
        marked = restart_mask(options, self.num_envs)
        settings = self._plant.settings
        error_bounds, steps = settings.error_bounds, _motion_steps(settings)
        if options and ("error_bounds" in options or "trajectory" in options):  # creating the tasks is slow
            task = self._plant.tasks[int(np.argmax(marked))]
            error_bounds, steps = task.error_bounds, task.steps
        self._bounds[marked], self._needed[marked] = (error_bounds.position, error_bounds.rotation), steps
        self._steps[marked], self._reason[marked] = 0, ""
        self._ended[marked] = self._succeeded[marked] = False
        return observation, info | self._episode_info()

    def _episode_info(self) -> dict[str, Any]:
        return {"termination_reason": self._reason.copy(), "is_success": self._succeeded.copy()}

    def step(self, actions: ArrayLike, *, past_end: bool = False) -> VectorStep:
        """One control period.

        Raises:
            ResetNeeded: for an environment that has ended, unless ``past_end``.
            ValueError: if the actions are not (N, m) finite numbers.
        """
        if self._ended.any() and not past_end:
            raise ResetNeeded("an episode has ended: call reset(options={'reset_mask': …})")
        observation, _, _, truncated, info = self.env.step(actions, past_end=past_end)
        self._reason = self._rule.reason(info, self._bounds, self._steps < self._needed)
        self._steps += 1
        terminated = self._reason != ""
        self._succeeded = truncated & ~terminated
        self._ended |= truncated | terminated
        reward = self._rule.reward(info, terminated)
        return observation, reward, terminated, truncated, info | self._episode_info()


class WithinLimits(SingleWrapper):
    """Ends an episode when the task criterion fails, and rewards reaching the end.

    While the motion runs, an episode terminates if the position or rotation error exceeds its bound at any physics
    step, or if a cable is slack, as in :class:`cablebot_gym.evaluation.constraints.DLCCMonitor`; the initial state is
    not checked. An episode also terminates if the environment itself ends it. ``info["termination_reason"]`` is
    ``slack``, ``tracking_error``, ``rotation_error``, or the environment's own reason. ``info["is_success"]`` is true
    if an episode ends without terminating, and false before.

    The bounds are those of the episode, ``env.unwrapped.task.error_bounds``. The reward replaces the environment's:
    ``alive − failure · terminated − saturation · mean(max(0, |a| − 0.97))``, with the mean over the cables.

    Args:
        env: single environment of this package.
        alive: reward per control period.
        failure: penalty of a termination.
        saturation: penalty factor of actions beyond ±0.97.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is negative or not finite, or the environment is already steered.
    """

    level: ClassVar[int] = LIMITS
    vector: ClassVar[type[WithinLimitsVector]] = WithinLimitsVector

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        alive: float = 0.02,
        failure: float = 1.0,
        saturation: float = 0.02,
    ) -> None:
        super().__init__(env, alive=alive, failure=failure, saturation=saturation)
        self._rule = _Rule(alive, failure, saturation)
        self._bounds = np.zeros((1, 2))
        self._steps = self._needed = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; ``info`` has ``is_success``."""
        observation, info = self.env.reset(seed=seed, options=options)
        task = self._plant.task
        self._bounds[0] = task.error_bounds.position, task.error_bounds.rotation
        self._steps, self._needed = 0, task.steps
        return observation, info | {"is_success": False}

    def step(self, action: ArrayLike) -> SingleStep:
        """One control period.

        Raises:
            ValueError: if the action is not m finite numbers.
        """
        observation, _, _, truncated, info = self.env.step(action)
        read = ("slack", "tracking_error_peak", "rotation_error_peak", "termination_reason", "commanded_action")
        batch = {name: np.asarray(info[name])[None] for name in read}
        reason = self._rule.reason(batch, self._bounds, np.array([self._steps < self._needed]))
        self._steps += 1
        reward, terminated = float(self._rule.reward(batch, reason != "")[0]), bool(reason[0] != "")
        ended = {"termination_reason": str(reason[0]), "is_success": truncated and not terminated}
        return observation, reward, terminated, truncated, info | ended
