"""Extended Kalman filter of pose, velocity, disturbance and constant errors from the sensors of
winches and platform."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.estimation.drives import PulleyTorque, pulley_torque
from cablebot_baselines.estimation.errors import FilterErrors
from cablebot_baselines.estimation.kalman import Columns, KalmanState, merged
from cablebot_baselines.estimation.linearised import Accelerated, accelerated
from cablebot_baselines.estimation.sensor_model import (
    Prediction,
    SensorModel,
    orientation_deviations,
)
from cablebot_gym.measurement import Measurement
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

Array = NDArray[Any]

TORQUE_TIME = 0.1
"""Correlation time of the error of the torque on the pulleys [s]."""

DIVERGED = 1e6
"""Value of a part of the state, in its unit, above which the filter starts anew. Otherwise one
diverged estimate would end the computation of all episodes."""

SPEED_TIME = 0.05
"""Time constant of the mean motor speed, which tells whether an encoder turns [s]."""

UNKNOWN_POSE = 1.0
"""Deviation of each coordinate of an unknown start pose from that of the task [m, rad]. Any large
value gives the same filter."""

START_ITERATIONS = 4
"""Number of linearisations at the start, where the pose changes most."""


class ExtendedKalmanFilter:
    """Filter with the nominal dynamics, ``Ẍ = f(X, Ẋ, τ) + d``, where d is a random walk.

    The torque τ on the pulleys is that of the last action; of a flexible robot, the torque balance
    of the motors gives that of the springs, ``κ = τ − J′β̈′ − c′β̇′``, and the pulley angle ``β =
    β′ − κ/K``. d takes up an unknown payload and wrench. Load cells measure the tensions. An IMU
    adds orientation, angular rate and, by the specific force, acceleration.

    The state includes the constant errors: zeros of the motor angles, compliances, anchors, biases
    of load cells and orientation. With a start error (homing), the robot rests at the start pose of
    the task with the payload of the model, up to this error. The first readings then correlate the
    errors of the pose with those of the zeros: the angle at rest is ``β(X) + κ(X)/K`` plus the zero,
    and the tension is ``κ(X)/r`` plus the bias. Later readings separate them.

    Args:
        robot: nominal robot.
        errors: the expected errors; None for ``FilterErrors.usual`` of the robot.
    """

    def __init__(self, robot: Robot, errors: FilterErrors | None = None) -> None:
        self._nominal = robot
        self.robot = textbook.joint_equivalent(robot)  # springs in place of elastic cables
        self.errors = errors or FilterErrors.usual(robot)
        platform_size = float(np.mean(np.linalg.norm(robot.platform, axis=-1))) or 1.0
        self._is_position = np.arange(robot.coordinates) < robot.dimensions
        self._unit = np.where(self._is_position, 1.0, 1.0 / platform_size)
        self._measurement = Measurement(kind="winches")
        self._start = robot.home[None]
        self._period = 2e-3
        self._names: frozenset[str] | None = None
        self._set_columns(frozenset())

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads measurement, control period and start poses of the tasks."""
        self._measurement = tasks[0].measurement
        self._period = 1 / tasks[0].control_frequency
        self._start = np.array([task.start_pose for task in tasks])
        self._names = None  # the layout depends on the tasks

    def update(
        self, blocks: dict[str, Array], state: KalmanState | None, starts: NDArray[np.bool_]
    ) -> tuple[dict[str, Array], KalmanState]:
        """Pose and velocity, motor angles without their zero errors and tensions without their
        biases, and the next state.

        Args:
            blocks: blocks of the observation, each (N, size).
            state: the last state; None before the first observation.
            starts: whether an episode starts, (N,).
        """
        self._set_columns(frozenset(blocks))
        if state is not None:
            starts = starts | ~self._is_usable(state)
        if state is None or starts.all():
            state = self._initial(blocks)
        elif starts.any():
            initial = self._initial(blocks)
            usable = merged(starts, initial, state)
            state = merged(starts, initial, self._following(blocks, usable))
        else:
            state = self._following(blocks, state)
        columns, mean = self._columns, state.mean
        estimated = {
            "pose": mean[:, columns.pose],
            "velocity": mean[:, columns.velocity],
            "motor_angle": blocks["motor_angle"] - mean[:, columns.zero],
        }
        if "tensions" in blocks:
            estimated["tensions"] = blocks["tensions"] - mean[:, columns.cell]
        return estimated, state

    @staticmethod
    def _is_usable(state: KalmanState) -> NDArray[np.bool_]:
        """Whether the estimates have not diverged, (N,)."""
        variance = np.diagonal(state.covariance, axis1=-2, axis2=-1)
        values = np.concatenate([state.mean, np.sqrt(np.abs(variance))], axis=-1)
        usable: NDArray[np.bool_] = (np.abs(values) < DIVERGED).all(axis=-1)
        return usable

    def _set_columns(self, names: frozenset[str]) -> None:
        """Lays out the state for the blocks of an observation, at the first one."""
        if names == self._names:
            return
        self._names = names
        quantised = self._measurement.encoder_resolution > 0
        self._columns = Columns(self.robot, self.errors, names, quantised=quantised)
        self._sensors = SensorModel(
            self._nominal, self.robot, self.errors, self._columns, self._period
        )

    def _mass(self, blocks: dict[str, Array]) -> Array:
        return self.robot.mass + blocks["model_payload"][:, 0]

    def _initial(self, blocks: dict[str, Array]) -> KalmanState:
        """The state at the first observation: at rest, or at the speed of the motors."""
        robot, columns, angle = self.robot, self._columns, blocks["motor_angle"]
        count = len(angle)
        start = self._start
        if len(start) != count:
            start = start[:1]
        pose = np.broadcast_to(start, (count, robot.coordinates))
        inverse = np.linalg.pinv(textbook.jacobian(robot, pose))
        rates = -robot.pulley_radius * blocks["motor_speed"]
        mean = np.zeros((count, columns.total))
        mean[:, columns.pose] = pose
        mean[:, columns.velocity] = textbook.times_vector(inverse, rates)
        prior, before = self._prior(blocks, inverse), mean
        for _ in range(START_ITERATIONS):
            readings, torque = self._sensors.at_rest(blocks, mean, self._mass(blocks))
            mean, covariance = readings.corrected(before, prior, at=mean)
        return KalmanState(
            mean=mean,
            covariance=covariance,
            angle=angle,
            speed=blocks["motor_speed"],
            motor_torque=textbook.holding_torque(self._nominal, torque),
            slow_speed=np.zeros_like(angle),
            tensions=torque / robot.pulley_radius,
        )

    def _prior(self, blocks: dict[str, Array], inverse: Array) -> Array:
        """Covariance before the first reading, (N, k, k), with the inverse of the Jacobian."""
        robot, errors, columns = self.robot, self.errors, self._columns
        position, rotation = errors.start or (UNKNOWN_POSE, UNKNOWN_POSE)
        payload = blocks["model_payload"]
        variances = np.zeros((len(payload), columns.total))
        variances[:, columns.pose] = np.where(self._is_position, position, rotation) ** 2
        variances[:, columns.disturbance] = (errors.initial_disturbance * self._unit) ** 2
        variances[:, columns.zero] = errors.bias.motor_angle**2
        variances[:, columns.quantisation] = self._quantisation_variance
        variances[:, columns.noise] = errors.noise.motor_speed**2
        variances[:, columns.torque] = self._torque_variance
        variances[:, columns.strength] = errors.strength**2
        variances[:, columns.rotor] = errors.rotor**2
        variances[:, columns.lag] = errors.lag**2
        variances[:, columns.mass] = (errors.mass * robot.mass) ** 2 + (
            errors.payload * payload
        ) ** 2
        for part, anchor in zip((columns.base, columns.platform), errors.anchors, strict=True):
            variances[:, part] = anchor**2
        variances[:, columns.cell] = errors.bias.tension**2
        if "orientation" in blocks:
            variances[:, columns.orientation] = orientation_deviations(errors.bias) ** 2
        covariance = variances[:, :, None] * np.eye(columns.total)
        speed = inverse * (robot.pulley_radius * self.errors.noise.motor_speed)
        covariance[:, columns.velocity, columns.velocity] = speed @ np.swapaxes(speed, -1, -2)
        if errors.compliance is not None and robot.flexible:
            covariance[:, columns.compliance, columns.compliance] = errors.compliance_covariance(
                robot.cables
            )
        return covariance

    def _following(self, blocks: dict[str, Array], state: KalmanState) -> KalmanState:
        """Prediction over one control period, and correction by the sensors."""
        robot, columns, period = self.robot, self._columns, self._period
        mean, covariance = state.mean.copy(), state.covariance.copy()
        slow_speed = state.slow_speed + self._speed_gain * (
            blocks["motor_speed"] - state.slow_speed
        )
        self._age_errors(mean, covariance, slow_speed)
        pose, velocity = mean[:, columns.pose], mean[:, columns.velocity]
        pulled = pulley_torque(robot, blocks, state, mean, columns, period)
        torque = pulled.torque
        mass = self._mass(blocks) + mean[:, columns.mass].sum(axis=-1)
        at_start, _ = textbook.forward_dynamics(
            robot, mass, pose, velocity, torque, cable="bilateral"
        )
        at_start = at_start + mean[:, columns.disturbance]
        # of second order: the velocity in the middle of the period matters for friction and rotors
        middle = pose + period / 2 * velocity + period**2 / 8 * at_start
        motion = accelerated(robot, mass, middle, velocity + period / 2 * at_start, torque)
        steady, _ = self.errors.wrench.statistics(robot)
        acceleration = motion.acceleration + mean[:, columns.disturbance]
        acceleration = acceleration + textbook.times_vector(motion.by_wrench, steady)
        mean[:, columns.pose] = pose + period * velocity + period**2 / 2 * acceleration
        mean[:, columns.velocity] = velocity + period * acceleration
        by_state = self._acceleration_gradient(motion, pulled)
        covariance = self._predicted_covariance(covariance, by_state, motion.by_wrench)
        prediction = Prediction(
            mean=mean, acceleration=acceleration, by_state=by_state, motion=motion, pulled=pulled
        )
        readings = self._sensors.following(blocks, state, prediction)
        mean, covariance = readings.corrected(mean, covariance)
        return KalmanState(
            mean=mean,
            covariance=covariance,
            angle=blocks["motor_angle"],
            speed=blocks["motor_speed"],
            motor_torque=pulled.motor,
            slow_speed=slow_speed,
            tensions=motion.tensions,
        )

    def _acceleration_gradient(self, motion: Accelerated, pulled: PulleyTorque) -> Array:
        """Gradient of the acceleration with respect to the state, (N, n, k)."""
        columns, n = self._columns, self.robot.coordinates
        gradient = np.zeros((len(motion.acceleration), n, columns.total))
        gradient[:, :, columns.pose] = motion.by_pose[0]
        gradient[:, :, columns.velocity] = self._period / 2 * motion.by_pose[0]
        gradient[:, :, columns.disturbance] = np.eye(n)
        for part, factor in pulled.errors:
            gradient[:, :, part] = factor[..., None, :] * motion.by_torque[0]
        if columns.mass.stop > columns.mass.start:
            gradient[:, :, columns.mass] = motion.by_mass[0]
        return gradient

    def _predicted_covariance(self, covariance: Array, by_state: Array, by_wrench: Array) -> Array:
        """Covariance after one control period."""
        columns, period, n = self._columns, self._period, self.robot.coordinates
        change = np.zeros((len(covariance), 2 * n, columns.total))
        change[:, :n] = period**2 / 2 * by_state
        change[:, n:] = period * by_state
        change[:, :n, columns.velocity] += period * np.eye(n)
        moved = change @ covariance
        both = slice(0, 2 * n)
        covariance[:, both] += moved
        covariance[:, :, both] += np.swapaxes(moved, -1, -2)
        covariance[:, both, both] += moved @ np.swapaxes(change, -1, -2)
        # d walks; a short wrench acts on the velocity like white noise with the same impulse
        growth = (self.errors.disturbance * self._unit) ** 2 * period
        jerk = np.array([period**2 / 6, period / 2, 1.0])
        covariance[:, : 3 * n, : 3 * n] += np.kron(np.outer(jerk, jerk), np.diag(growth))
        wrench = self.errors.wrench
        _, deviation = wrench.statistics(self.robot)
        impulse = by_wrench * deviation * np.sqrt(wrench.correlation_time * period)
        shaken = np.concatenate([period / 2 * impulse, impulse], axis=-2)
        covariance[:, both, both] += shaken @ np.swapaxes(shaken, -1, -2)
        return covariance

    def _age_errors(self, mean: Array, covariance: Array, speed: Array) -> None:
        """Lets the errors that change forget a part of their past, for motor speeds (N, m)."""
        robot, columns = self.robot, self._columns
        memory = np.ones_like(mean)
        variance = np.zeros_like(mean)
        memory[:, columns.torque] = np.exp(-self._period / TORQUE_TIME)
        variance[:, columns.torque] = self._torque_variance
        if self._measurement.encoder_resolution:
            memory[:, columns.quantisation] = self._quantisation_memory(speed)
            variance[:, columns.quantisation] = self._quantisation_variance
        if robot.flexible:
            for array in (mean, covariance, np.swapaxes(covariance, -1, -2)):
                array[:, columns.last_noise] = array[:, columns.noise]
            memory[:, columns.noise] = 0.0
            variance[:, columns.noise] = self.errors.noise.motor_speed**2
        mean *= memory
        covariance *= memory[:, :, None] * memory[:, None, :]
        index = np.arange(columns.total)
        covariance[:, index, index] += (1 - memory**2) * variance

    @property
    def _torque_variance(self) -> Any:
        if not self.errors.torque:
            return 0.0
        return (self.errors.torque * self.robot.stall_torque) ** 2

    @property
    def _quantisation_variance(self) -> float:
        return self._measurement.encoder_resolution**2 / 12

    @property
    def _speed_gain(self) -> float:
        return self._period / SPEED_TIME

    def _quantisation_memory(self, speed: Array) -> Array:
        """Correlation of the quantisation error over a control period at motor speeds (N, m).

        The autocorrelation of a sawtooth falls as 1 − 6u over the fraction u of a step.
        """
        turned = np.abs(speed) * self._period
        memory: Array = np.exp(-6 * turned / self._measurement.encoder_resolution)
        return memory
