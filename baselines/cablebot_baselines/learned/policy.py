"""Policy of a bundle: the network selects actions, and the action mapping applies them to the base
law."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.steering import Memory
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task


class LearnedPolicy:
    """Policy of a bundle; needs neither torch nor Stable-Baselines3.

    Args:
        bundle: learned policy.
        robot: nominal robot.

    Raises:
        ValueError: if the robot's observation differs from the one that the policy was trained on.
    """

    unsaturated_actions = False

    def __init__(self, bundle: Bundle, robot: Robot) -> None:
        self.bundle, self.robot = bundle, robot
        self._steering = bundle.steering(robot)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads the error bounds and the control frequency of the tasks.

        Raises:
            ValueError: if the tasks differ in these, or a task's robot is not supported.
        """
        self._steering.reset(tasks)

    def predict(
        self,
        observation: ArrayLike,
        state: Memory | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Memory]:
        """Returns actions (m,) or (N, m) and the state for the next call.

        Raises:
            ValueError: if the observation does not have this robot's layout.
        """
        steering = self._steering
        blocks = steering.split(observation)
        memory = steering.reset_memory(blocks, state, episode_start)
        action = memory.actions[..., -1, :]
        if np.any(steering.due(memory)):
            action = self.bundle.network(steering.observe(blocks, memory))
        return steering.respond(blocks, action, memory, episode_start)
