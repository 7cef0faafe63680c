"""Extended Kalman filter of pose, velocity, disturbance and constant errors from the sensors of
winches and platform."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.episodes import merged
from cablebot_baselines.estimation.drives import pulley_torque
from cablebot_baselines.estimation.errors import FilterErrors
from cablebot_baselines.estimation.kalman import Columns, KalmanState
from cablebot_baselines.estimation.linearised import accelerated
from cablebot_baselines.estimation.sensor_model import (
    Prediction,
    SensorModel,
    orientation_deviations,
)
from cablebot_gym.envs.observation import Blocks
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import Measurement
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import times_vector
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

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
        anchor_distances = np.linalg.norm(robot.platform, axis=-1)
        platform_size = float(np.mean(anchor_distances)) or 1.0
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
        self, blocks: Blocks, state: KalmanState | None, starts: NDArray[np.bool_]
    ) -> tuple[Blocks, KalmanState]:
        """Pose and velocity, motor angles without their zero errors and tensions without their
        biases, and the next state.

        Args:
            blocks: blocks of the observation, each (N, size).
            state: the last state; None before the first observation.
            starts: whether an episode starts, (N,).
        """
        self._set_columns(frozenset(blocks))
        state = self._next(blocks, state, starts)
        mean = state.mean
        columns = self._columns
        estimated = {
            "pose": mean[:, columns.pose],
            "velocity": mean[:, columns.velocity],
            "motor_angle": blocks["motor_angle"] - mean[:, columns.zero],
        }
        if "tensions" in blocks:
            estimated["tensions"] = blocks["tensions"] - mean[:, columns.cell]
        return estimated, state

    def _next(
        self, blocks: Blocks, state: KalmanState | None, starts: NDArray[np.bool_]
    ) -> KalmanState:
        """The state after an observation. Diverged episodes start anew."""
        if state is None:
            return self._initial(blocks)
        starts = starts | ~self._is_usable(state)
        if not starts.any():
            return self._following(blocks, state)
        initial = self._initial(blocks)
        if starts.all():
            return initial
        usable = merged(starts, initial, state)
        following = self._following(blocks, usable)
        return merged(starts, initial, following)

    @staticmethod
    def _is_usable(state: KalmanState) -> NDArray[np.bool_]:
        """Whether the estimates have not diverged, (N,)."""
        variance = np.diagonal(state.covariance, axis1=-2, axis2=-1)
        deviation = np.sqrt(np.abs(variance))
        values = np.concatenate([state.mean, deviation], axis=-1)
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
        self._variances = self._initial_variances()

    def _initial_variances(self) -> Array:
        """Variances before the first reading, (k,), but for those of velocity, compliances and
        mass."""
        errors = self.errors
        columns = self._columns
        position, rotation = errors.start or (UNKNOWN_POSE, UNKNOWN_POSE)
        pose_error = np.where(self._is_position, position, rotation)
        disturbance = errors.initial_disturbance * self._unit
        torque_error = errors.torque * self.robot.stall_torque
        base_error, platform_error = errors.anchors
        variances = np.zeros(columns.total)
        variances[columns.pose] = pose_error**2
        variances[columns.disturbance] = disturbance**2
        variances[columns.zero] = errors.bias.motor_angle**2
        variances[columns.quantisation] = self._measurement.encoder_resolution**2 / 12
        variances[columns.noise] = errors.noise.motor_speed**2
        if errors.torque:
            variances[columns.torque] = torque_error**2
        variances[columns.strength] = errors.strength**2
        variances[columns.rotor] = errors.rotor**2
        variances[columns.lag] = errors.lag**2
        variances[columns.base] = base_error**2
        variances[columns.platform] = platform_error**2
        variances[columns.cell] = errors.bias.tension**2
        if columns.orientation.stop > columns.orientation.start:
            variances[columns.orientation] = orientation_deviations(errors.bias) ** 2
        return variances

    def _mass(self, blocks: Blocks) -> Array:
        return self.robot.mass + blocks["model_payload"][:, 0]

    def _initial(self, blocks: Blocks) -> KalmanState:
        """The state at the first observation: at rest, or at the speed of the motors."""
        robot = self.robot
        columns = self._columns
        angle = blocks["motor_angle"]
        speed = blocks["motor_speed"]
        count = len(angle)
        start = self._start
        if len(start) != count:
            start = start[:1]
        pose = np.broadcast_to(start, (count, robot.coordinates))
        structure = textbook.jacobian(robot, pose)
        inverse = np.linalg.pinv(structure)
        cable_rates = -robot.pulley_radius * speed
        prior_mean = np.zeros((count, columns.total))
        prior_mean[:, columns.pose] = pose
        prior_mean[:, columns.velocity] = times_vector(inverse, cable_rates)
        prior_covariance = self._prior_covariance(blocks, inverse)
        mass = self._mass(blocks)
        mean = prior_mean
        for _ in range(START_ITERATIONS):
            readings, torque = self._sensors.at_rest(blocks, mean, mass)
            mean, covariance = readings.corrected(prior_mean, prior_covariance, at=mean)
        return KalmanState(
            mean=mean,
            covariance=covariance,
            angle=angle,
            speed=speed,
            motor_torque=textbook.holding_torque(self._nominal, torque),
            slow_speed=np.zeros_like(angle),
            tensions=torque / robot.pulley_radius,
        )

    def _prior_covariance(self, blocks: Blocks, inverse: Array) -> Array:
        """Covariance before the first reading, (N, k, k), with the inverse of the Jacobian."""
        robot = self.robot
        errors = self.errors
        columns = self._columns
        platform_error = errors.mass * robot.mass
        payload_error = errors.payload * blocks["model_payload"]
        variances = np.repeat(self._variances[None], len(inverse), axis=0)
        variances[:, columns.mass] = platform_error**2 + payload_error**2
        covariance = variances[:, :, None] * np.eye(columns.total)
        velocity = inverse * (robot.pulley_radius * errors.noise.motor_speed)
        covariance[:, columns.velocity, columns.velocity] = velocity @ velocity.mT
        if columns.compliance.stop > columns.compliance.start:
            compliance = errors.compliance_covariance(robot.cables)
            covariance[:, columns.compliance, columns.compliance] = compliance
        return covariance

    def _following(self, blocks: Blocks, state: KalmanState) -> KalmanState:
        """Prediction over one control period, and correction by the sensors."""
        speed = blocks["motor_speed"]
        speed_gain = self._period / SPEED_TIME
        slow_speed = state.slow_speed + speed_gain * (speed - state.slow_speed)
        mean, covariance = self._aged_errors(state, slow_speed)
        prediction = self._predicted(blocks, state, mean)
        covariance = self._predicted_covariance(covariance, prediction)
        readings = self._sensors.following(blocks, state, prediction)
        mean, covariance = readings.corrected(prediction.mean, covariance)
        return KalmanState(
            mean=mean,
            covariance=covariance,
            angle=blocks["motor_angle"],
            speed=speed,
            motor_torque=prediction.pulled.motor,
            slow_speed=slow_speed,
            tensions=prediction.motion.tensions,
        )

    def _predicted(self, blocks: Blocks, state: KalmanState, mean: Array) -> Prediction:
        """Prediction of a mean, (N, k), over one control period that began with ``state``."""
        robot = self.robot
        columns = self._columns
        period = self._period
        pose = mean[:, columns.pose]
        velocity = mean[:, columns.velocity]
        disturbance = mean[:, columns.disturbance]
        mass_error = mean[:, columns.mass].sum(axis=-1)
        mass = self._mass(blocks) + mass_error
        pulled = pulley_torque(robot, blocks, state, mean, columns, period)
        torque = pulled.torque
        at_start, _ = textbook.forward_dynamics(
            robot, mass, pose, velocity, torque, cable="bilateral"
        )
        at_start = at_start + disturbance
        # of second order: the velocity in the middle of the period matters for friction and rotors
        middle = pose + period / 2 * velocity + period**2 / 8 * at_start
        middle_velocity = velocity + period / 2 * at_start
        motion = accelerated(robot, mass, middle, middle_velocity, torque)
        mean_wrench, _ = self.errors.wrench.statistics(robot)
        by_wrench = times_vector(motion.by_wrench, mean_wrench)
        acceleration = motion.acceleration + disturbance + by_wrench
        displacement = period * velocity
        predicted = mean.copy()
        predicted[:, columns.pose] = pose + displacement + period**2 / 2 * acceleration
        predicted[:, columns.velocity] = velocity + period * acceleration
        by_pose, _ = motion.by_pose
        by_mass, _ = motion.by_mass
        by_torque, _ = motion.by_torque
        n = robot.coordinates
        by_state = np.zeros((len(by_pose), n, columns.total))
        by_state[:, :, columns.pose] = by_pose
        by_state[:, :, columns.velocity] = period / 2 * by_pose
        by_state[:, :, columns.disturbance] = np.eye(n)
        by_state[:, :, columns.mass] = by_mass
        for error_columns, factor in pulled.errors:
            by_state[:, :, error_columns] = factor[..., None, :] * by_torque
        return Prediction(
            mean=predicted,
            acceleration=acceleration,
            by_state=by_state,
            motion=motion,
            pulled=pulled,
        )

    def _predicted_covariance(self, covariance: Array, prediction: Prediction) -> Array:
        """Covariance after one control period."""
        columns = self._columns
        period = self._period
        n = self.robot.coordinates
        motion = slice(0, 2 * n)  # pose and velocity
        by_state = prediction.by_state
        count = len(by_state)
        change = np.zeros((count, 2 * n, columns.total))
        change[:, :n] = period**2 / 2 * by_state
        change[:, n:] = period * by_state
        change[:, :n, columns.velocity] += period * np.eye(n)
        moved = change @ covariance
        covariance[:, motion] += moved
        covariance[:, :, motion] += moved.mT
        covariance[:, motion, motion] += moved @ change.mT
        covariance[:, : 3 * n, : 3 * n] += self._disturbance_walk()
        shaken = self._wrench_deviation(prediction.motion.by_wrench)
        covariance[:, motion, motion] += shaken @ shaken.mT
        return covariance

    def _disturbance_walk(self) -> Array:
        """Covariance of pose, velocity and disturbance that the walk of the disturbance adds in one
        control period, (3n, 3n)."""
        period = self._period
        deviation = self.errors.disturbance * self._unit
        growth = deviation**2 * period
        factors = np.array([period**2 / 6, period / 2, 1.0])
        products = np.outer(factors, factors)
        return np.kron(products, np.diag(growth))

    def _wrench_deviation(self, by_wrench: Array) -> Array:
        """Deviations of pose and velocity by each component of the wrench in one control period,
        (N, 2n, n), with the gradient of the acceleration.

        A short wrench acts on the velocity like white noise with the same impulse.
        """
        wrench = self.errors.wrench
        _, deviation = wrench.statistics(self.robot)
        duration = np.sqrt(wrench.correlation_time * self._period)
        velocity = by_wrench * deviation * duration
        pose = self._period / 2 * velocity
        return np.concatenate([pose, velocity], axis=-2)

    def _aged_errors(self, state: KalmanState, speed: Array) -> tuple[Array, Array]:
        """Mean and covariance after the errors that change forget a part of their past, for motor
        speeds (N, m)."""
        columns = self._columns
        mean = state.mean.copy()
        covariance = state.covariance.copy()
        memory = np.ones_like(mean)
        memory[:, columns.torque] = np.exp(-self._period / TORQUE_TIME)
        if self._measurement.encoder_resolution:
            memory[:, columns.quantisation] = self._quantisation_memory(speed)
        if self.robot.flexible:
            for array in (mean, covariance, covariance.mT):
                array[:, columns.last_noise] = array[:, columns.noise]
            memory[:, columns.noise] = 0.0
        mean *= memory
        covariance *= memory[:, :, None] * memory[:, None, :]
        index = np.arange(columns.total)
        covariance[:, index, index] += (1 - memory**2) * self._variances
        return mean, covariance

    def _quantisation_memory(self, speed: Array) -> Array:
        """Correlation of the quantisation error over a control period at motor speeds (N, m).

        The autocorrelation of a sawtooth falls as 1 − 6u over the fraction u of a step.
        """
        resolution = self._measurement.encoder_resolution
        turned = np.abs(speed) * self._period
        memory: Array = np.exp(-6 * turned / resolution)
        return memory
