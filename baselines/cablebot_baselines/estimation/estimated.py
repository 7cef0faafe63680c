"""Any policy behind an estimator, and forward kinematics as the simplest estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.episodes import first_steps
from cablebot_baselines.estimation.ekf import ExtendedKalmanFilter
from cablebot_baselines.estimation.errors import FilterErrors
from cablebot_gym.envs.observation import ObservationLayout, observation_layout
from cablebot_gym.measurement import POSE
from cablebot_gym.physics import textbook
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.policies.protocol import Policy, declarations, reset_policy
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

Array = NDArray[Any]


class Estimator(Protocol):
    """Estimates pose and velocity of a batch of episodes."""

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads the public tasks of the next batch."""

    def update(
        self, blocks: dict[str, Array], state: Any, starts: NDArray[np.bool_]
    ) -> tuple[dict[str, Array], Any]:
        """Estimated blocks by name and the next state, from the blocks of an observation.

        ``pose`` and ``velocity``, each (N, n), are among the estimated blocks. Readings whose
        constant errors the estimator has found replace the measured ones.
        """


class KinematicEstimator:
    """Pose by forward kinematics, and velocity from the motor speeds; no dynamics and no filter.

    The spring deflection of a flexible robot is that at rest at the reference pose.

    Args:
        robot: nominal robot.
        difference: whether the velocity is the difference quotient of the poses instead.
    """

    def __init__(self, robot: Robot, *, difference: bool = False) -> None:
        self.robot = robot
        self._difference = difference
        self._period = 2e-3

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads the control period."""
        self._period = 1 / tasks[0].control_frequency

    def update(
        self, blocks: dict[str, Array], state: Any, starts: NDArray[np.bool_]
    ) -> tuple[dict[str, Array], Any]:
        """Pose and velocity, each (N, n), and the pose as the next guess."""
        robot = self.robot
        angle = blocks["motor_angle"]
        reference = blocks["reference_pose"]
        if robot.flexible:
            mass = robot.mass + blocks["model_payload"][:, 0]
            motor_angle = textbook.static_motor_angle(robot, mass, reference)
            deflection = motor_angle - textbook.pulley_angle(robot, reference)
            angle = angle - deflection
        guess = reference
        if state is not None:
            guess = np.where(starts[:, None], reference, state)
        home = textbook.cable_lengths(robot, robot.home)
        pose = forward_kinematics(robot, home - robot.pulley_radius * angle, guess).pose
        if self._difference:
            previous = pose
            if state is not None:
                previous = np.where(starts[:, None], pose, state)
            return {"pose": pose, "velocity": (pose - previous) / self._period}, pose
        inverse = np.linalg.pinv(textbook.jacobian(robot, pose))
        rates = -robot.pulley_radius * blocks["motor_speed"]
        velocity = (inverse @ rates[..., None])[..., 0]
        return {"pose": pose, "velocity": velocity}, pose


class Estimated:
    """A policy that reads pose and velocity, for environments that measure winches only.

    An estimator adds pose and velocity to the observation, and subtracts the constant errors of the
    readings that it has found. If an estimate is not finite, the actions are zero.

    Args:
        policy: any policy that reads pose and velocity.
        robot: nominal robot.
        estimator: the estimator; None for an
            :class:`~cablebot_baselines.estimation.ekf.ExtendedKalmanFilter`.
    """

    measurement = "winches"

    def __init__(self, policy: Policy, robot: Robot, estimator: Estimator | None = None) -> None:
        self.policy = policy
        self.robot = robot
        self.estimator = estimator or ExtendedKalmanFilter(robot)
        self.unsaturated_actions, self.stochastic, _ = declarations(policy)
        self._full = observation_layout(robot)
        self._measured: ObservationLayout | None = None

    @property
    def fallbacks(self) -> Any:
        """The fallbacks of the policy.

        Raises:
            AttributeError: if it does not count them.
        """
        return self.policy.fallbacks  # type: ignore[attr-defined]

    def reset(self, tasks: Sequence[Task]) -> None:
        """Resets estimator and policy, which gets the tasks with pose and velocity as the
        measurement."""
        self._measured = observation_layout(self.robot, tasks[0].measurement)
        self.estimator.reset(tasks)
        reset_policy(
            self.policy, "", lambda: tuple(replace(task, measurement=POSE) for task in tasks)
        )

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions (N, m) or (m,), and the state of estimator and policy.

        Raises:
            RuntimeError: before the first :meth:`reset`, which tells the sensors.
            ValueError: if the observation is not that of the sensors.
        """
        if self._measured is None:
            raise RuntimeError("call reset(tasks) first: the tasks tell the sensors")
        observations = np.atleast_2d(np.asarray(observation, float))
        blocks = self._measured.split(observations)
        estimator_state, policy_state = state or (None, None)
        starts = first_steps(state, episode_start, (len(observations),))
        with np.errstate(over="ignore", invalid="ignore"):  # an estimate may diverge
            estimated, estimator_state = self.estimator.update(blocks, estimator_state, starts)
        values = blocks | estimated
        full = np.concatenate([values[block.name] for block in self._full.blocks], axis=-1)
        space = self._full.space()
        full = np.clip(np.nan_to_num(full), space.low, space.high)
        actions, policy_state = self.policy.predict(full, policy_state, starts, deterministic)
        estimates = np.concatenate(list(estimated.values()), axis=-1)
        is_finite = np.isfinite(estimates).all(axis=-1, keepdims=True)
        actions = np.where(is_finite, actions, 0.0)
        if np.ndim(observation) == 1:
            actions = actions[0]
        return actions, (estimator_state, policy_state)


def ekf(robot: Robot, policy: Policy) -> Estimated:
    """A policy behind the extended Kalman filter, the estimator ``ekf``."""
    return Estimated(policy, robot)


def ekf_homed(robot: Robot, policy: Policy) -> Estimated:
    """The same, with motor angles and load cells zeroed at the start pose, the estimator
    ``ekf-homed``."""
    return Estimated(
        policy, robot, ExtendedKalmanFilter(robot, FilterErrors.usual(robot, homing=True))
    )


def fk(robot: Robot, policy: Policy) -> Estimated:
    """A policy behind forward kinematics, the estimator ``fk``."""
    return Estimated(policy, robot, KinematicEstimator(robot))
