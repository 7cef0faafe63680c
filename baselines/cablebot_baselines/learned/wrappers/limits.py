"""Wrapper that ends an episode when the task criterion fails."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.wrappers.layers import LIMITS, BatchWrapper, SingleWrapper, restart_mask
from cablebot_gym.envs.vector import VectorStep
from cablebot_gym.evaluation.constraints import KINDS, Judge
from cablebot_gym.utils.checks import number

SATURATED = 0.97
"""Absolute action above which the saturation penalty applies; the motor itself saturates at 1."""


_NAMES = {"position": "tracking_error", "rotation": "rotation_error"}
_REASONS = np.array([_NAMES.get(kind, kind) for kind in KINDS])
"""Termination reason by code of the judge's violations."""


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
        self._alive, self._failure = number("alive", alive, least=0.0), number("failure", failure, least=0.0)
        self._saturation = number("saturation", saturation, least=0.0)
        self._judge = Judge("task", self._plant.settings.robot.cables, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes; ``info`` has ``is_success``."""
        observation, info = self.env.reset(seed=seed, options=options)
        marked = restart_mask(options, self.num_envs)
        settings = self._plant.settings
        error_bounds, steps = settings.error_bounds, round(settings.trajectory.duration * settings.control_frequency)
        if options and ("error_bounds" in options or "trajectory" in options):  # creating the tasks is slow
            task = self._plant.tasks[int(np.argmax(marked))]
            error_bounds, steps = task.error_bounds, task.steps
        self._judge.reset(info, error_bounds, steps, marked, check_start=False)
        return observation, info | {"is_success": np.zeros(self.num_envs, np.bool_)}

    def step(self, actions: ArrayLike) -> VectorStep:
        """One control period.

        Raises:
            ValueError: if the actions are not (N, m) finite numbers.
        """
        observation, _, terminated, truncated, info = self.env.step(actions)
        self._judge.observe(info, terminated)
        own = info["termination_reason"]
        reason = np.where(own != "", own, np.where(self._judge.failed, _REASONS[self._judge.kind], ""))
        terminated = reason != ""
        beyond = np.maximum(np.abs(info["commanded_action"]) - SATURATED, 0.0).mean(axis=-1)
        reward = self._alive - self._failure * terminated - self._saturation * beyond
        ended = {"termination_reason": reason, "is_success": truncated & ~terminated}
        return observation, reward, terminated, truncated, info | ended


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

    vector: ClassVar[type[Any]] = WithinLimitsVector
