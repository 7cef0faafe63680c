"""The task's limits: episodes end where the task criterion would fail."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.wrappers.layers import LIMITS, Many, Single, SingleStep, check_number, restarted
from cablebot_gym.envs.settings import Settings
from cablebot_gym.envs.vector import VectorStep

SATURATED = 0.97
"""Drive command beyond which a motor counts as saturated, a little before it is."""


class _Rule:
    """Reward and end of an episode within limits, of N at once."""

    def __init__(self, alive: float, failure: float, saturation: float) -> None:
        for name, value in (("alive", alive), ("failure", failure), ("saturation", saturation)):
            check_number(name, value, 0.0)
        self._alive, self._failure, self._saturation = float(alive), float(failure), float(saturation)

    def reason(self, info: Mapping[str, Any], bounds: Array, judged: NDArray[np.bool_]) -> NDArray[np.str_]:
        """Why each episode ends by failing, (N,); empty where it goes on. What the environment itself says comes first.

        Args:
            info: the environment's, arrays (N, …).
            bounds: of position and rotation, (N, 2) [m, rad].
            judged: whether the motion still lasts, (N,).
        """
        found = np.select(
            [
                judged & info["slack"].any(axis=-1),
                judged & (info["tracking_error_peak"] > bounds[:, 0]),
                judged & (info["rotation_error_peak"] > bounds[:, 1]),
            ],
            ["slack", "tracking_error", "rotation_error"],
            "",
        )
        own = info["termination_reason"]
        return np.where(own != "", own, found)

    def reward(self, info: Mapping[str, Any], terminated: NDArray[np.bool_]) -> Array:
        """Of one control period, (N,)."""
        beyond = np.maximum(np.abs(info["drive_demand"]) - SATURATED, 0.0).mean(axis=-1)
        return self._alive - self._failure * terminated - self._saturation * beyond


def _motion_steps(settings: Settings) -> int:
    """Control steps of the default motion, as :attr:`cablebot_gym.task.Task.steps`."""
    return round(settings.trajectory.duration * settings.control_frequency)


class WithinLimitsVector(Many):
    """N :class:`WithinLimits`; arguments and errors as there."""

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
        """Starts episodes, which are not judged yet; ``info`` has ``is_success``."""
        observation, info = self.env.reset(seed=seed, options=options)
        marked = restarted(options, self.num_envs)
        settings = self._plant.settings
        limits, steps = settings.limits, _motion_steps(settings)
        if options and ("limits" in options or "trajectory" in options):  # so many tasks take their time to make
            task = self._plant.tasks[int(np.argmax(marked))]
            limits, steps = task.limits, task.steps
        self._bounds[marked], self._needed[marked] = (limits.position, limits.rotation), steps
        self._steps[marked], self._reason[marked] = 0, ""
        self._ended[marked] = self._succeeded[marked] = False
        return observation, info | self._told()

    def _told(self) -> dict[str, Any]:
        return {"termination_reason": self._reason.copy(), "is_success": self._succeeded.copy()}

    def step(self, actions: ArrayLike, *, past_end: bool = False) -> VectorStep:
        """One control period.

        Raises:
            ResetNeeded: for an environment that has ended, unless ``past_end``.
            ValueError: if the actions are not (N, m) finite numbers.
        """
        if self._ended.any() and not past_end:
            raise ResetNeeded("an environment has ended: restart it by reset(options={'reset_mask': …})")
        observation, _, _, truncated, info = self.env.step(actions, past_end=past_end)
        self._reason = self._rule.reason(info, self._bounds, self._steps < self._needed)
        self._steps += 1
        terminated = self._reason != ""
        self._succeeded = truncated & ~terminated
        self._ended |= truncated | terminated
        reward = self._rule.reward(info, terminated)
        return observation, reward, terminated, truncated, info | self._told()


class WithinLimits(Single):
    """Ends an episode where the task criterion would fail, and rewards lasting until the end.

    An episode terminates where the position or rotation error exceeds its bound at any physics step, or a cable is
    slack, while the motion lasts, as :class:`cablebot_gym.evaluation.constraints.DLCCMonitor` judges it; the start itself is not
    judged. It also terminates where the environment itself ends it. ``info["termination_reason"]`` is ``slack``,
    ``tracking_error``, ``rotation_error``, or the environment's own. ``info["is_success"]`` is true where an episode
    ends without terminating, and false before.

    The bounds are those of the episode, ``env.unwrapped.task.limits``. The reward takes the place of the
    environment's: ``alive − failure · terminated − saturation · mean(max(0, |a| − 0.97))``, the mean over the cables.

    Args:
        env: a single environment of this package.
        alive: per control period.
        failure: what terminating costs.
        saturation: what a drive command beyond ±0.97 costs.

    Raises:
        TypeError: if the environment is none of this package's.
        ValueError: if an argument is negative or no finite number, or the environment is already steered.
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
        """Starts an episode, which is not judged yet; ``info`` has ``is_success``."""
        observation, info = self.env.reset(seed=seed, options=options)
        task = self._plant.task
        self._bounds[0] = task.limits.position, task.limits.rotation
        self._steps, self._needed = 0, task.steps
        return observation, info | {"is_success": False}

    def step(self, action: ArrayLike) -> SingleStep:
        """One control period.

        Raises:
            ValueError: if the action is not m finite numbers.
        """
        observation, _, _, truncated, info = self.env.step(action)
        read = ("slack", "tracking_error_peak", "rotation_error_peak", "termination_reason", "drive_demand")
        batch = {name: np.asarray(info[name])[None] for name in read}
        reason = self._rule.reason(batch, self._bounds, np.array([self._steps < self._needed]))
        self._steps += 1
        reward, terminated = float(self._rule.reward(batch, reason != "")[0]), bool(reason[0] != "")
        ended = {"termination_reason": str(reason[0]), "is_success": truncated and not terminated}
        return observation, reward, terminated, truncated, info | ended
