"""What the classical laws share: nominal robot, told payload, observation, outer loop, and the drive command."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics.textbook import MINIMUM_TENSION
from cablebot_gym.robots import Robot

Array = NDArray[Any]

PAPER_GAINS = {"planar": (2000.0, 10.0), "spatial": (30.0, 20.0)}
"""(K_P, K_D) of Tables 2 and 4 [1/s², 1/s]."""


class ClassicalLaw:
    """A law that gives motor torques from the blocks of the observation and from nominal parameters.

    Its drive command is not clipped, so that |a| > 1 is the paper's torque violation.

    Raises:
        ValueError: if ``minimum_tension`` is negative.
    """

    unclipped = True

    def __init__(self, robot: Robot, *, minimum_tension: float = MINIMUM_TENSION) -> None:
        if not 0 <= minimum_tension < math.inf:
            raise ValueError(f"minimum_tension must be at least 0 N, not {minimum_tension}")
        self.robot, self.minimum_tension = robot, minimum_tension
        self._layout = observation_layout(robot)

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Drive commands (m,) for one observation or (N, m) for a batch; ``state`` is passed through.

        Raises:
            ValueError: if the observation is not of this robot's layout.
        """
        part = self._layout.split(self._layout.checked(observation, self.robot.name))
        mass = self.robot.mass + part["told_payload"][..., 0]
        torques, speeds = self._torques(part, mass)
        return (torques + self.robot.speed_slope * speeds) / self.robot.stall_torque, state

    def _torques(self, part: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Torques asked of the motors [N·m] and the motors' speeds [rad/s], each (..., m)."""
        raise NotImplementedError


def checked_gains(gains: tuple[float, float] | None, robot: Robot) -> tuple[float, float]:
    """(K_P, K_D), the paper's for None.

    Raises:
        ValueError: if they are not two positive numbers.
    """
    if gains is None:
        return PAPER_GAINS["planar" if robot.planar else "spatial"]
    checked = np.asarray(gains)
    if checked.shape != (2,) or checked.dtype.kind not in "iuf" or not np.all((checked > 0) & (checked < np.inf)):
        raise ValueError(f"gains must be two positive numbers (K_P, K_D), not {gains!r}")
    return float(checked[0]), float(checked[1])


def outer_loop(part: dict[str, Array], gains: tuple[float, float]) -> Array:
    """``v = Ẍ_d + K_D ė + K_P e`` (Eqs. 13 and 18) from the blocks of an observation, (..., n)."""
    stiffness, damping = gains
    correction = damping * (part["reference_velocity"] - part["velocity"])
    correction = correction + stiffness * (part["reference_pose"] - part["pose"])
    return part["reference_acceleration"] + correction
