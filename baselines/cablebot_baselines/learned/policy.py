"""A learned policy at work: its network decides, its steering does the rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.steering import Memory
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task


class LearnedPolicy:
    """Runs a bundle; needs neither torch nor Stable-Baselines3.

    Args:
        bundle: what it is.
        robot: nominal.

    Raises:
        ValueError: if the robot has another observation than the policy was trained on.
    """

    unclipped = False

    def __init__(self, bundle: Bundle, robot: Robot) -> None:
        self.bundle, self.robot = bundle, robot
        self._steering = bundle.steering(robot)

    def begin(self, tasks: Sequence[Task]) -> None:
        """Reads limits and control frequency.

        Raises:
            ValueError: if the tasks differ in these, or a task's robot does not fit.
        """
        self._steering.begin(tasks)

    def predict(
        self,
        observation: ArrayLike,
        state: Memory | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Memory]:
        """Drive commands (m,) or (N, m), and the state to pass next time.

        Raises:
            ValueError: if the observation is not of this robot's layout.
        """
        steering = self._steering
        part = steering.split(observation)
        memory = steering.remembered(part, state, episode_start)
        action = memory.actions[..., -1, :]
        if np.any(steering.due(memory)):
            action = self.bundle.network(steering.seen(part, memory))
        return steering.respond(part, action, memory, episode_start)
