"""Any policy behind an estimator, and forward kinematics as the simplest estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.episodes import first_steps
from cablebot_baselines.observer.expectation import UNKNOWN_START, Expectation, possible_payload
from cablebot_baselines.observer.observer import RobotObserver
from cablebot_baselines.observer.observer_state import ObserverState
from cablebot_gym.envs.observation import ObservationLayout, observation_layout
from cablebot_gym.measurement import POSE
from cablebot_gym.physics import textbook
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.policies.protocol import Policy, declarations, reset_policy
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import (
    ExternalWrench,
    ParameterDistribution,
    SensorNoise,
    Uncertainty,
)

Array = NDArray[Any]

DATA_SHEET = SensorNoise(
    motor_angle=1e-4, motor_speed=1e-2, tension=0.4, angular_rate=4e-3, specific_force=2e-2
)
"""White noise of a servo drive, a load cell and the IMU MTi-300."""

ZERO_ERROR = 0.3e-3
"""Zero error of a calibrated cable length [m]."""

CELL_BIAS = 0.01
"""Bias of a load cell as a fraction of the tension at the stall torque."""

START_SPREAD = (1.5e-4, 3.5e-4)
"""Standard deviations of a start pose that motion capture finds [m, rad], as in the uncertainty
``hardware``."""

DIVERGED = 1e6
"""Value of a part of the state, in its unit, above which an estimator starts anew."""


def usual_expectation(robot: Robot, *, homing: bool = False) -> Expectation:
    """Errors of data sheets for a robot whose other errors are unknown.

    With homing the start pose is found by motion capture, and the zeros of motor angles and load
    cells are unknown.
    """
    full_scale = float(robot.stall_torque.min() / robot.pulley_radius.max())
    zero = ZERO_ERROR / float(robot.pulley_radius.min())
    cell = CELL_BIAS * full_scale
    if homing:
        zero = 1.0
        cell = full_scale
    few_percent = ParameterDistribution(low=-0.03, high=0.03)
    uncertainty = Uncertainty(
        parameters={"platform_mass": few_percent, "motor_strength": few_percent},
        wrench=ExternalWrench(force_std=0.5, moment_std=0.05, correlation_time=0.1),
        sensors=DATA_SHEET,
        sensor_bias=SensorNoise(motor_angle=zero, tension=cell, tilt=3.5e-3, yaw=17.5e-3),
    )
    spread = START_SPREAD if homing else UNKNOWN_START
    return Expectation.of(robot, uncertainty, start_spread=spread)


class KinematicEstimator:
    """Pose by forward kinematics, and velocity from the motor speeds; no dynamics and no filter.

    The spring deflection of a flexible robot is that at rest at the reference pose.

    Args:
        robot: nominal robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads nothing."""

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
        pose = forward_kinematics(robot, home - robot.pulley_radius * angle, guess)
        inverse = np.linalg.pinv(textbook.jacobian(robot, pose))
        rates = -robot.pulley_radius * blocks["motor_speed"]
        velocity = textbook.times_vector(inverse, rates)
        return {"pose": pose, "velocity": velocity}, pose


class WinchEstimator:
    """Pose and velocity by a :class:`~cablebot_baselines.observer.observer.RobotObserver` that
    reads the sensors of winches and platform.

    Args:
        robot: nominal robot.
        expectation: what is expected of the robot and its sensors; None for
            :func:`usual_expectation`.
    """

    observer: RobotObserver
    """Observer of the robots of the tasks; :meth:`reset` makes it."""

    def __init__(self, robot: Robot, expectation: Expectation | None = None) -> None:
        self.robot = robot
        self.expectation = expectation or usual_expectation(robot)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Makes the observer for sensors, control period and start poses of the tasks."""
        self.observer = RobotObserver(
            self.expectation,
            1 / tasks[0].control_frequency,
            largest_payload=possible_payload(self.robot, tasks[0]),
            measurement=tasks[0].measurement,
            start_pose=np.array([task.start_pose for task in tasks]),
        )

    def update(
        self, blocks: dict[str, Array], state: ObserverState | None, starts: NDArray[np.bool_]
    ) -> tuple[dict[str, Array], ObserverState]:
        """Pose and velocity, motor angles without their zero errors and tensions without their
        biases, and the next state. Diverged episodes start anew."""
        if state is not None:
            variance = np.diagonal(state.covariance, axis1=-2, axis2=-1)
            values = np.concatenate([state.mean, np.sqrt(np.abs(variance))], axis=-1)
            starts = starts | ~(np.abs(values) < DIVERGED).all(axis=-1)
        state = self.observer.update(blocks, state, starts)
        columns = self.observer.columns
        mean = state.mean
        estimated = {
            "pose": mean[:, columns.pose],
            "velocity": mean[:, columns.velocity],
            "motor_angle": blocks["motor_angle"] - mean[:, columns.zero],
        }
        if "tensions" in blocks:
            estimated["tensions"] = blocks["tensions"] - mean[:, columns.cell]
        return estimated, state


class Estimated:
    """A policy that reads pose and velocity, for environments that measure winches only.

    An estimator adds pose and velocity to the observation, and subtracts the constant errors of the
    readings that it has found. If an estimate is not finite, the actions are zero.

    Args:
        policy: any policy that reads pose and velocity.
        robot: nominal robot.
        estimator: the estimator; None for a :class:`WinchEstimator`.
    """

    measurement = "winches"

    def __init__(
        self,
        policy: Policy,
        robot: Robot,
        estimator: KinematicEstimator | WinchEstimator | None = None,
    ) -> None:
        self.policy = policy
        self.robot = robot
        self.estimator = estimator or WinchEstimator(robot)
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
    """A policy behind the observer, the estimator ``ekf``."""
    return Estimated(policy, robot)


def ekf_homed(robot: Robot, policy: Policy) -> Estimated:
    """The same, with motor angles and load cells zeroed at the start pose, the estimator
    ``ekf-homed``."""
    return Estimated(policy, robot, WinchEstimator(robot, usual_expectation(robot, homing=True)))


def fk(robot: Robot, policy: Policy) -> Estimated:
    """A policy behind forward kinematics, the estimator ``fk``."""
    return Estimated(policy, robot, KinematicEstimator(robot))
