"""Base class of the classical control laws: observation, inverse dynamics and action of the nominal
robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.textbook import (
    MINIMUM_TENSION,
    TENSION_RESERVE,
    InverseDynamics,
    allocated_minimum,
    central_tensions,
    joint_equivalent,
    normalised_action,
)
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number

Array = NDArray[Any]


class ClassicalLaw:
    """Control law that computes motor torques from the blocks of the observation and the nominal
    parameters.

    The action is not saturated: |a| > 1 is the paper's torque violation.

    Args:
        robot: nominal robot.
        minimum_tension: least tension that the law allocates with more cables than coordinates [N];
            ≥ 0. None for :func:`~cablebot_gym.physics.textbook.drives.allocated_minimum`.

    Raises:
        ValueError: if ``minimum_tension`` is negative.
    """

    unsaturated_actions = True
    usual_minimum = MINIMUM_TENSION
    """Usual least tension [N]."""
    tension_reserve = TENSION_RESERVE
    """Least allocated tension as a multiple of the robot's ``minimum_tension``, if that is more."""

    def __init__(self, robot: Robot, *, minimum_tension: float | None = None) -> None:
        if minimum_tension is None:
            minimum_tension = allocated_minimum(robot, self.usual_minimum, self.tension_reserve)
        self.robot = robot
        self.minimum_tension: Any = number("minimum_tension", minimum_tension, least=0.0, unit="N")
        """Least allocated tension, one number or one for each row of a batch, (N,) [N]."""
        self.model = joint_equivalent(robot)
        """Robot of the law's equations: that with joint springs in place of elastic cables."""
        self._layout = observation_layout(robot)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Checks that the law fits the robots of the tasks. Other parameters, such as the mass, may
        differ.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        names = ["flexible", "base", "platform", "swivel"]
        if self.robot.flexible:
            names.append("home")  # the zero of the motor angles
        for robot in {task.robot for task in tasks}:
            for name in names:
                if not np.array_equal(getattr(robot, name), getattr(self.robot, name)):
                    raise ValueError(
                        f"{type(self).__name__} was built for robot {self.robot.name!r}, but the task's robot "
                        f"{robot.name!r} differs in kind or anchors. Build the law from the task's robot."
                    )

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions (m,) for one observation or (N, m) for a batch, and the state to pass next time.

        A law without memory returns ``state`` unchanged.

        Raises:
            ValueError: if the observation does not have this robot's layout.
        """
        return self.respond(self.split(observation), state, episode_start)

    def split(self, observation: ArrayLike) -> dict[str, Array]:
        """The blocks of an observation by name, each (..., size).

        Raises:
            ValueError: if the observation does not have this robot's layout.
        """
        return self._layout.split(observation)

    def respond(
        self, blocks: dict[str, Array], state: Any = None, episode_start: Any = None
    ) -> tuple[Array, Any]:
        """Like :meth:`predict`, from the blocks of an observation. A caller may replace the
        reference in the blocks."""
        mass = self.robot.mass + blocks["model_payload"][..., 0]
        torques, speeds, state = self._control(blocks, mass, state, episode_start)
        return normalised_action(self.robot, torques, speeds), state

    def _control(
        self, blocks: dict[str, Array], mass: Array, state: Any, episode_start: Any
    ) -> tuple[Array, Array, Any]:
        """Requested torques [N·m] and motor speeds [rad/s], each (..., m), and the next state."""
        return *self.torques(blocks, mass), state

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Requested torques [N·m] and motor speeds [rad/s] of a law without memory, each (..., m).

        Args:
            blocks: blocks of the observation by name, each (..., size).
            mass: mass of platform and payload [kg], (...).
        """
        raise NotImplementedError

    def _inverse_dynamics(
        self, mass: Array, pose: Array, velocity: Array, acceleration: Array
    ) -> InverseDynamics:
        """Tensions, torques, pulley speeds β̇ and pulley accelerations β̈ for a motion."""
        return inverse_dynamics(
            self.model,
            mass,
            pose,
            velocity,
            acceleration,
            minimum=self.minimum_tension,
            distribute=central_tensions,
        )

    @property
    def rotor_inertia(self) -> Array:
        """Inertia that the law's torque accelerates at the angular acceleration of the pulley
        [kg·m²], (m,)."""
        return self.model.pulley_inertia

    def torque_slope(self, mass: Array, pose: Array) -> Array:
        """∂(r T + J β̈)/∂Ẍ = −r S⁻ᵀ D − (J/r) S for as many cables as coordinates, (..., n, n).

        T and β̈ are affine in Ẍ, so each column follows exactly from a unit acceleration.
        """
        n = self.robot.coordinates
        units = np.concatenate([np.zeros((1, n)), np.eye(n)])
        batch_axes = (1,) * (pose.ndim - 1)
        accelerations = units.reshape(n + 1, *batch_axes, n)
        required = self._inverse_dynamics(mass, pose, np.zeros_like(pose), accelerations)
        torques = (
            self.robot.pulley_radius * required.tensions
            + self.rotor_inertia * required.pulley_accelerations
        )
        return np.moveaxis(torques[1:] - torques[0], 0, -1)

    def pulley_speed(self, pose: Array, velocity: Array) -> Array:
        """Pulley speeds β̇ [rad/s], (..., m)."""
        return self._inverse_dynamics(
            np.asarray(self.robot.mass), pose, velocity, np.zeros_like(pose)
        ).speeds
