"""What the classical laws share: nominal robot, told payload, inverse dynamics, observation, and the drive command."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.textbook import MINIMUM_TENSION, InverseDynamics, drive_command
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

Array = NDArray[Any]


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

    def begin(self, tasks: Sequence[Task]) -> None:
        """Refuses episodes of another robot. Other parameters, such as a mass, are a study of mismatch and welcome.

        Raises:
            ValueError: if a task's robot is of another kind, or has other anchors.
        """
        for robot in {task.robot for task in tasks}:
            if difference := _difference(self.robot, robot):
                raise ValueError(
                    f"{type(self).__name__} was built for robot {self.robot.name!r}, but the task's {robot.name!r} has "
                    f"{difference}: build the law from the task's robot"
                )

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Drive commands (m,) for one observation or (N, m) for a batch, and the state to pass next time.

        A law without memory passes ``state`` through.

        Raises:
            ValueError: if the observation is not of this robot's layout.
        """
        return self.respond(self.split(observation), state, episode_start)

    def split(self, observation: ArrayLike) -> dict[str, Array]:
        """The blocks of an observation by name, each (..., size).

        Raises:
            ValueError: if the observation is not of this robot's layout.
        """
        return self._layout.split(self._layout.checked(observation, self.robot.name))

    def respond(self, part: dict[str, Array], state: Any = None, episode_start: Any = None) -> tuple[Array, Any]:
        """What :meth:`predict` does, from an observation's blocks, in which others may have put their own reference."""
        mass = self.robot.mass + part["told_payload"][..., 0]
        torques, speeds, state = self._control(part, mass, state, episode_start)
        return self._command(torques, speeds), state

    def _control(self, part: dict[str, Array], mass: Array, state: Any, episode_start: Any) -> tuple[Array, Array, Any]:
        """Torques asked of the motors [N·m], the motors' speeds [rad/s], each (..., m), and the next state."""
        return *self.torques(part, mass), state

    def torques(self, part: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """What a law without memory asks of the motors [N·m] and their speeds [rad/s], each (..., m).

        Args:
            part: the blocks of the observation by name, each (..., size).
            mass: of platform and payload [kg], (...).
        """
        raise NotImplementedError

    def _command(self, torques: Array, speeds: Array) -> Array:
        return drive_command(self.robot, torques, speeds)

    def _inverse_dynamics(self, mass: Array, pose: Array, velocity: Array, acceleration: Array) -> InverseDynamics:
        """Tensions, torques, speeds and windings β̈ at the pulleys."""
        return inverse_dynamics(self.robot, mass, pose, velocity, acceleration, minimum=self.minimum_tension)

    @property
    def turning_inertia(self) -> Array:
        """What the law's torque has to turn with the pulleys [kg·m²], (m,)."""
        return self.robot.pulley_inertia

    def torque_slope(self, mass: Array, pose: Array) -> Array:
        """∂(r T + J β̈)/∂Ẍ = −r S⁻ᵀ D − (J/r) S with as many cables as coordinates, (..., n, n).

        Column by column: both are affine in Ẍ, so that a unit of acceleration tells the column exactly.
        """
        n, still = self.robot.coordinates, np.zeros_like(pose)
        units = np.concatenate([np.zeros((1, n)), np.eye(n)]).reshape(n + 1, *(1,) * (pose.ndim - 1), n)
        needed = self._inverse_dynamics(mass, pose, still, units)
        torques = self.robot.pulley_radius * needed.tensions + self.turning_inertia * needed.windings
        return np.moveaxis(torques[1:] - torques[0], 0, -1)

    def pulley_speed(self, pose: Array, velocity: Array) -> Array:
        """β̇ [rad/s], (..., m)."""
        return self._inverse_dynamics(np.asarray(self.robot.mass), pose, velocity, np.zeros_like(pose)).speeds


def first_steps(state: Any, episode_start: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which observations of a batch of this shape have no past; without a state, all.

    Raises:
        ValueError: if ``episode_start`` is neither one boolean, in an array of any shape, nor one for each observation.
    """
    start = np.asarray(False if episode_start is None else episode_start, np.bool_)
    if start.size == 1:  # Stable-Baselines3 has an array of one for a single observation
        start = start.reshape(())
    elif start.shape != shape:
        raise ValueError(f"episode_start must be one boolean or have shape {shape}, not {start.shape}")
    return np.broadcast_to(start if state is not None else np.True_, shape)


def _difference(robot: Robot, other: Robot) -> str | None:
    """What another robot has that a law for ``robot`` cannot cope with."""
    if other.flexible != robot.flexible:
        return "joint springs" if other.flexible else "no joint springs"
    if other.cables != robot.cables or other.planar != robot.planar:
        return f"{other.cables} cables {'in the plane' if other.planar else 'in space'}"
    if not (np.array_equal(other.base, robot.base) and np.array_equal(other.platform, robot.platform)):
        return "other anchors"
    if robot.flexible and not np.array_equal(other.home, robot.home):
        return "another home pose, from which its motor angles are measured"
    return None
