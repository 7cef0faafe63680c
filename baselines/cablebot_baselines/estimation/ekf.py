"""Extended Kalman filter of pose, velocity and disturbance from the sensors of winches and
platform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import euler_rate_matrix, jacobian_and_rate, rotation_matrix
from cablebot_gym.measurement import Measurement
from cablebot_gym.physics import textbook
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import SensorNoise

Array = NDArray[Any]

DATA_SHEET = SensorNoise(
    motor_angle=1e-4,
    motor_speed=1e-2,
    tension=0.4,
    tilt=3.5e-3,
    yaw=17.5e-3,
    angular_rate=4e-3,
    specific_force=2e-2,
)
"""Default errors of the sensors: a servo drive, a load cell and the IMU MTi-300. Encoder resolution
is added."""

INITIAL_DISTURBANCE = 0.3
"""Standard deviation of the disturbance d at the start [m/s²]; of angles, divided by the platform's
size."""

TARE_READINGS = 50
"""Number of readings whose mean is the bias of the load cells, with homing. The filter considers
the torque of the motors exact during these readings."""

CELL_TIME = 0.1
"""Time constant of the correction of the torque by load cells [s]."""

BIAS_TIME = 10.0
"""Correlation time of the errors of orientation and of the zero errors of angles [s]. After the
first reading, the filter models them as white noise with the same information."""

_FRACTIONS = ((np.arange(8) + 0.5) / 8)[:, None, None]
"""Instants of a control period, as fractions."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KalmanState:
    """State of the filter for N episodes."""

    mean: Array
    """X, Ẋ and the disturbance d [m/s², rad/s²], (N, 3n)."""
    covariance: Array
    """Covariance of ``mean``, (N, 3n, 3n)."""
    offset: Array
    """Offset of the motor angles that homing found, (N, m) [rad]; zero without homing."""
    tare: Array
    """Bias of the load cells that homing found, (N, m) [N]; zero without homing."""
    count: Array
    """Number of readings since the start, (N,)."""
    angle: Array
    """Last motor angles, without offset (N, m) [rad]."""
    speed: Array
    """Last motor speeds (N, m) [rad/s]."""
    tensions: Array
    """Predicted mean tensions in the last control period (N, m) [N]."""
    correction: Array
    """Correction of the torque on the pulleys by the load cells (N, m) [N·m]."""


class ExtendedKalmanFilter:
    """Filter with the nominal dynamics, ``Ẍ = f(X, Ẋ, τ) + d``, where d is a random walk.

    The torque τ on the pulleys is that of the last action; of a flexible robot, the torque balance
    of the motors gives that of the springs, ``κ = τ − J′β̈′ − c′β̇′``, and the pulley angle ``β =
    β′ − κ/K``. Load cells correct a constant error of this torque, such as friction. d takes up an
    unknown payload and wrench. An IMU adds orientation, angular rate and, by the specific force,
    acceleration.

    Args:
        robot: nominal robot.
        noise: standard deviations of the sensors.
        disturbance: growth of the disturbance d in one second [m/s²]; of angles, divided by the
            platform's size. None for 3 with rigid and 0.3 with flexible joints: the pose of a
            flexible robot follows from the small difference of two angles, and a law that damps the
            springs amplifies the noise of a faster filter.
        torque_error: standard deviation of the constant error of the motor torque, as a fraction of
            the stall torque.
        cell_bias: standard deviation of the constant error of a load cell, as a fraction of the
            tension at this torque.
        zero_error: standard deviation of the zero errors of the cable lengths [m]. It weights the
            angles against the orientation of an IMU; without one, or with homing, it has no effect.
        homing: whether the zeros of motor angles and load cells are set at the start: the robot
            then rests at the start pose of the task with the payload of the model. Errors of these
            two become errors of the zeros.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        noise: SensorNoise = DATA_SHEET,
        disturbance: float | None = None,
        torque_error: float = 0.01,
        cell_bias: float = 0.01,
        zero_error: float = 0.3e-3,
        homing: bool = False,
    ) -> None:
        self._nominal = robot
        self.robot = textbook.joint_equivalent(robot)  # springs in place of elastic cables
        self.noise = noise
        self.homing = homing
        self._zero_error = 0.0 if homing else zero_error / robot.pulley_radius
        platform_size = float(np.mean(np.linalg.norm(robot.platform, axis=-1))) or 1.0
        is_position = np.arange(robot.coordinates) < robot.dimensions
        self._unit = np.where(is_position, 1.0, 1.0 / platform_size)
        if disturbance is None:
            disturbance = 0.3 if robot.flexible else 3.0
        self._disturbance = disturbance
        self._torque_error = torque_error
        self._cell_bias = cell_bias
        self._measurement = Measurement(kind="winches")
        self._start = robot.home[None]
        self._period = 2e-3

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads measurement, control period and start poses of the tasks."""
        self._measurement = tasks[0].measurement
        self._period = 1 / tasks[0].control_frequency
        self._start = np.array([task.start_pose for task in tasks])

    def update(
        self, blocks: dict[str, Array], state: KalmanState | None, starts: NDArray[np.bool_]
    ) -> tuple[Array, Array, KalmanState]:
        """Pose and velocity, each (N, n), and the next state.

        Args:
            blocks: blocks of the observation, each (N, size).
            state: the last state; None before the first observation.
            starts: whether an episode starts, (N,).
        """
        if state is None or starts.all():
            state = self._initial(blocks)
        elif starts.any():
            state = _merged(starts, self._initial(blocks), self._following(blocks, state))
        else:
            state = self._following(blocks, state)
        pose, velocity, _ = np.split(state.mean, 3, axis=-1)
        return pose, velocity, state

    @property
    def _speed_noise(self) -> float:
        return self.noise.motor_speed

    @property
    def _angle_noise(self) -> float:
        return float(
            np.hypot(self.noise.motor_angle, self._measurement.encoder_resolution / np.sqrt(12))
        )

    @property
    def _balance_noise(self) -> Array:
        """Standard deviation of the torque balance of the motors (m,) [N·m]."""
        return self.robot.motor_inertia * self._speed_noise * np.sqrt(2) / self._period

    @property
    def _orientation_variance(self) -> Array:
        return np.array([self.noise.tilt, self.noise.tilt, self.noise.yaw]) ** 2

    @property
    def _cell_gain(self) -> float:
        return self._period / CELL_TIME

    @property
    def _cell_weight(self) -> float:
        """Weight of the load cells against the torque of the motors, by their constant errors."""
        return self._torque_error**2 / (self._torque_error**2 + self._cell_bias**2)

    def _mass(self, blocks: dict[str, Array]) -> Array:
        return self.robot.mass + blocks["model_payload"][:, 0]

    def _initial(self, blocks: dict[str, Array]) -> KalmanState:
        """The state at the first observation: at rest, or at the speed of the motors."""
        robot, angle = self.robot, blocks["motor_angle"]
        count = len(angle)
        start = self._start
        if len(start) != count:
            start = start[:1]
        start = np.broadcast_to(start, (count, robot.coordinates))
        torque = textbook.static_torque(
            robot, self._mass(blocks), start, minimum=textbook.allocated_minimum(robot)
        )
        deflection = np.zeros_like(angle)
        if robot.flexible:
            deflection = torque / textbook.joint_stiffness(self._nominal, start)
        offset = np.zeros_like(angle)
        tare = np.zeros_like(angle)
        if self.homing:
            offset = angle - deflection - textbook.pulley_angle(robot, start)
            if "tensions" in blocks:
                tare = blocks["tensions"] - torque / robot.pulley_radius
        home = textbook.cable_lengths(robot, robot.home)
        lengths = home - robot.pulley_radius * (angle - deflection - offset)
        pose = forward_kinematics(robot, lengths, start).pose
        inverse = np.linalg.pinv(textbook.jacobian(robot, pose))
        velocity = -(inverse @ (robot.pulley_radius * blocks["motor_speed"])[..., None])[..., 0]
        mean = np.concatenate([pose, velocity, np.zeros_like(pose)], axis=-1)
        covariance = self._initial_covariance(inverse, has_orientation="orientation" in blocks)
        if "orientation" in blocks:
            n = robot.coordinates
            gradient = np.broadcast_to(np.eye(3, 3 * n, n - 3), (count, 3, 3 * n))
            innovation = blocks["orientation"] - pose[:, -3:]
            mean, covariance = _corrected(
                mean, covariance, innovation, gradient, self._orientation_variance
            )
        return KalmanState(
            mean=mean,
            covariance=covariance,
            offset=offset,
            tare=tare,
            count=np.ones(count),
            angle=angle - offset,
            speed=blocks["motor_speed"],
            tensions=torque / robot.pulley_radius,
            correction=np.zeros_like(torque),
        )

    def _initial_covariance(self, inverse: Array, *, has_orientation: bool) -> Array:
        """Covariance at the start, from the errors of motor angles and speeds and the inverse of
        the Jacobian."""
        robot, n = self.robot, self.robot.coordinates
        angle_error: Any = self._angle_noise
        if has_orientation:
            angle_error = np.hypot(angle_error, self._zero_error)
        if robot.flexible:
            angle_error = np.hypot(
                angle_error, self._torque_error * robot.stall_torque / robot.stiffness
            )
        pose_spread = inverse * (robot.pulley_radius * angle_error)
        velocity_spread = inverse * (robot.pulley_radius * self._speed_noise)
        covariance = np.zeros((len(inverse), 3 * n, 3 * n))
        covariance[:, :n, :n] = pose_spread @ np.swapaxes(pose_spread, -1, -2)
        covariance[:, n : 2 * n, n : 2 * n] = velocity_spread @ np.swapaxes(velocity_spread, -1, -2)
        covariance[:, 2 * n :, 2 * n :] = np.diag((INITIAL_DISTURBANCE * self._unit) ** 2)
        return covariance

    def _following(self, blocks: dict[str, Array], state: KalmanState) -> KalmanState:
        """Prediction over one control period, and correction by the sensors."""
        robot, period = self.robot, self._period
        angle = blocks["motor_angle"] - state.offset
        speed = blocks["motor_speed"]
        torque = self._mean_torque(blocks, state)
        pose, velocity, disturbance = np.split(state.mean, 3, axis=-1)
        middle = pose + period / 2 * velocity
        acceleration, tensions = textbook.forward_dynamics(
            robot,
            self._mass(blocks),
            middle,
            velocity,
            torque + state.correction,
            cable="bilateral",
        )
        count = state.count + 1
        correction, tare = state.correction, state.tare
        if "tensions" in blocks:
            correction, tare = self._cell_estimates(blocks["tensions"], tensions, count, state)
        acceleration = acceleration + disturbance
        pose = pose + period * velocity + period**2 / 2 * acceleration
        velocity = velocity + period * acceleration
        mean = np.concatenate([pose, velocity, disturbance], axis=-1)
        angles = angle
        if robot.flexible:
            # Means over the last period: the motor angle by its cubic, the deflection by the mean
            # torque.
            mean_angle = (angle + state.angle) / 2 - period / 12 * (speed - state.speed)
            stiffness = textbook.joint_stiffness(self._nominal, pose)
            angles = mean_angle - (torque + correction) / stiffness
        readings = self._readings(blocks, pose, velocity, acceleration, angles)
        mean, covariance = _corrected(mean, self._predicted_covariance(state.covariance), *readings)
        return KalmanState(
            mean=mean,
            covariance=covariance,
            offset=state.offset,
            tare=tare,
            count=count,
            angle=angle,
            speed=speed,
            tensions=tensions,
            correction=correction,
        )

    def _mean_torque(self, blocks: dict[str, Array], state: KalmanState) -> Array:
        """Mean torque on the pulleys in the last control period, without correction (N, m)
        [N·m]."""
        robot, speed = self.robot, blocks["motor_speed"]
        action = np.clip(blocks["last_actions"][:, : robot.cables], -1.0, 1.0)
        # The request is constant over the period; the torque-speed line clips it at the changing
        # speed.
        request = robot.stall_torque * action - robot.speed_slope * state.speed
        drop = robot.speed_slope * (state.speed + _FRACTIONS * (speed - state.speed))
        clipped = np.clip(request, -robot.stall_torque - drop, robot.stall_torque - drop)
        torque = np.mean(clipped, axis=0)
        if robot.flexible:
            friction = textbook.motor_friction(robot, (speed + state.speed) / 2)
            torque = torque - robot.motor_inertia * (speed - state.speed) / self._period - friction
        return torque

    def _cell_estimates(
        self, readings: Array, tensions: Array, count: Array, state: KalmanState
    ) -> tuple[Array, Array]:
        """Correction of the torque and bias of the load cells, from their readings and the
        predicted tensions."""
        robot = self.robot
        # The cells read at the start of the period. With springs, the mean over the period before
        # counts too.
        expected = tensions
        if robot.flexible:
            expected = (tensions + state.tensions) / 2
        excess = readings - np.maximum(expected, 0.0)
        is_taring = (count <= TARE_READINGS)[:, None] & self.homing
        tare = np.where(is_taring, state.tare + (excess - state.tare) / count[:, None], state.tare)
        measured = robot.pulley_radius * (excess - tare) + state.correction
        change = np.where(is_taring, 0.0, self._cell_weight * measured - state.correction)
        return state.correction + self._cell_gain * change, tare

    def _predicted_covariance(self, covariance: Array) -> Array:
        """Covariance after one control period.

        The transition mixes X, Ẋ and d of a coordinate alone: the dynamics hardly change within a
        period.
        """
        n, period = self.robot.coordinates, self._period
        mix = np.array([[1.0, period, period**2 / 2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
        transition = np.kron(mix, np.eye(n))
        growth = (self._disturbance * self._unit) ** 2 * period
        jerk = np.array([period**2 / 6, period / 2, 1.0])
        noise = np.kron(np.outer(jerk, jerk), np.diag(growth))
        return transition @ covariance @ transition.T + noise

    def _readings(
        self,
        blocks: dict[str, Array],
        pose: Array,
        velocity: Array,
        acceleration: Array,
        angles: Array,
    ) -> tuple[Array, Array, Array]:
        """Innovations (N, k), their gradient with respect to the state (N, k, 3n), and their
        variances (k,).

        ``angles`` are the pulley angles now, or of a flexible robot in the middle of the last
        control period.
        """
        robot = self.robot
        ago = 0.0
        if robot.flexible:
            ago = self._period / 2
        structure, rate = jacobian_and_rate(
            robot.base, robot.platform, pose, velocity, robot.swivel
        )
        turning = -structure / robot.pulley_radius[:, None]
        turning_rate = -rate / robot.pulley_radius[:, None]
        earlier_pose = pose - ago * velocity + ago**2 / 2 * acceleration
        innovations = [angles - textbook.pulley_angle(robot, earlier_pose)]
        gradients = [np.concatenate([turning, -ago * turning, ago**2 / 2 * turning], axis=-1)]
        variances = [self._angle_variance(blocks)]
        if not robot.flexible:
            innovations.append(blocks["motor_speed"] - (turning @ velocity[..., None])[..., 0])
            gradients.append(
                np.concatenate([turning_rate, turning, np.zeros_like(turning)], axis=-1)
            )
            variances.append(np.full(robot.cables, self._speed_noise**2))
        if "orientation" in blocks:
            n, euler = robot.coordinates, pose[:, -3:]
            to_omega = euler_rate_matrix(euler)
            to_platform = np.swapaxes(rotation_matrix(euler), -1, -2)
            free = acceleration[:, :3] - robot.gravity_vector
            innovations.append(blocks["orientation"] - euler)
            innovations.append(blocks["angular_rate"] - (to_omega @ velocity[:, -3:, None])[..., 0])
            innovations.append(blocks["specific_force"] - (to_platform @ free[..., None])[..., 0])
            for matrix, column in ((np.eye(3), n - 3), (to_omega, 2 * n - 3), (to_platform, 2 * n)):
                gradient = np.zeros((len(pose), 3, 3 * n))
                gradient[:, :, column : column + 3] = matrix
                gradients.append(gradient)
            variances.append(BIAS_TIME / self._period * self._orientation_variance)
            variances.append(np.full(3, self.noise.angular_rate**2))
            variances.append(np.full(3, self.noise.specific_force**2))
        return (
            np.concatenate(innovations, axis=-1),
            np.concatenate(gradients, axis=-2),
            np.concatenate(variances),
        )

    def _angle_variance(self, blocks: dict[str, Array]) -> Array:
        """Variance of the pulley angles (m,) [rad²]."""
        robot = self.robot
        variance = np.full(robot.cables, self._angle_noise**2)
        if robot.flexible:
            torque = self._balance_noise
            if "tensions" in blocks:
                cell_torque = self._cell_weight * robot.pulley_radius * self.noise.tension
                torque = np.hypot(torque, cell_torque * np.sqrt(self._cell_gain / 2))
            variance = variance + (torque / robot.stiffness) ** 2
        if "orientation" in blocks:
            variance = variance + BIAS_TIME / self._period * self._zero_error**2
        return variance


def _merged(starts: NDArray[np.bool_], initial: KalmanState, following: KalmanState) -> KalmanState:
    """The initial state of the episodes that start, and the following state of the others."""
    arrays = {}
    for name, values in vars(following).items():
        mask = starts.reshape(-1, *(1,) * (values.ndim - 1))
        arrays[name] = np.where(mask, getattr(initial, name), values)
    return KalmanState(**arrays)


def _corrected(
    mean: Array, covariance: Array, innovation: Array, gradient: Array, variance: Array
) -> tuple[Array, Array]:
    """Mean and covariance after readings with independent errors."""
    crossed = covariance @ np.swapaxes(gradient, -1, -2)
    total = gradient @ crossed + np.diag(variance)
    gain = np.swapaxes(np.linalg.solve(total, np.swapaxes(crossed, -1, -2)), -1, -2)
    mean = mean + (gain @ innovation[..., None])[..., 0]
    covariance = covariance - gain @ np.swapaxes(crossed, -1, -2)
    return mean, (covariance + np.swapaxes(covariance, -1, -2)) / 2
