"""Extended Kalman filter of pose, velocity and disturbance from the sensors of winches and platform."""

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
    motor_angle=1e-4, motor_speed=1e-2, tension=0.4, tilt=3.5e-3, yaw=17.5e-3, angular_rate=4e-3, specific_force=2e-2
)
"""Default errors of the sensors: a servo drive, a load cell and the IMU MTi-300. Encoder resolution is added."""

INITIAL_DISTURBANCE = 0.3
"""Standard deviation of the disturbance d at the start [m/s²]; of angles, divided by the platform's size."""

TARE_READINGS = 50
"""Number of readings whose mean is the bias of the load cells that homing finds. During them the torque of the motors
is taken as exact."""

CELL_TIME = 0.1
"""Time constant of the correction of the torque by load cells [s]."""

BIAS_TIME = 10.0
"""Time over which the errors of orientation and the zero errors of angles are correlated [s]. After the first reading,
white noise of the same information stands for them."""

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

    The torque τ on the pulleys is that of the last action; of a flexible robot, the torque balance of the motors gives
    that of the springs, ``κ = τ − J′β̈′ − c′β̇′``, and the pulley angle ``β = β′ − κ/K``. Load cells correct a constant
    error of this torque, such as friction. d takes up an unknown payload and wrench. An IMU adds orientation, angular
    rate and, by the specific force, acceleration.

    Args:
        robot: nominal robot.
        noise: standard deviations of the sensors.
        disturbance: growth of the disturbance d in one second [m/s²]; of angles, divided by the platform's size. None
            for 3 with rigid and 0.3 with flexible joints: the pose of a flexible robot follows from the small
            difference of two angles, and a law that damps the springs amplifies the noise of a faster filter.
        torque_error: standard deviation of the constant error of the motor torque, as a fraction of the stall torque.
        cell_bias: standard deviation of the constant error of a load cell, as a fraction of the tension at this torque.
        zero_error: standard deviation of the zero errors of the cable lengths [m]. It weights the angles against the
            orientation of an IMU; without one, or with homing, it has no effect.
        homing: whether the zeros of motor angles and load cells are set at the start: the robot then rests at the start
            pose of the task with the payload of the model. Errors of these two become errors of the zeros.
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
        self._given, self.robot = robot, textbook.joint_equivalent(robot)  # springs in place of elastic cables
        self.noise, self.homing = noise, homing
        self._zero_error = 0.0 if homing else zero_error / robot.pulley_radius
        n, axes = robot.coordinates, robot.dimensions
        size = float(np.mean(np.linalg.norm(robot.platform, axis=-1))) or 1.0
        self._unit = np.where(np.arange(n) < axes, 1.0, 1.0 / size)
        self._disturbance = (0.3 if robot.flexible else 3.0) if disturbance is None else disturbance
        self._torque_error, self._cell_bias = torque_error, cell_bias
        self._measurement, self._start, self._period = Measurement(kind="winches"), robot.home[None], 2e-3

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads measurement, control period and start poses of the tasks."""
        self._measurement, self._period = tasks[0].measurement, 1 / tasks[0].control_frequency
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
        first = state is None or bool(starts.all())
        new = self._initial(blocks) if first or starts.any() else None
        if not first and state is not None:
            following = self._following(blocks, state)
            if new is not None:
                names = KalmanState.__dataclass_fields__
                mixed = {}
                for name in names:
                    old, fresh = getattr(following, name), getattr(new, name)
                    mixed[name] = np.where(starts.reshape(-1, *(1,) * (old.ndim - 1)), fresh, old)
                following = KalmanState(**mixed)
            new = following
        assert new is not None
        n = self.robot.coordinates
        return new.mean[:, :n], new.mean[:, n : 2 * n], new

    @property
    def _speed_noise(self) -> float:
        return self.noise.motor_speed

    @property
    def _angle_noise(self) -> float:
        return float(np.hypot(self.noise.motor_angle, self._measurement.encoder_resolution / np.sqrt(12)))

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
        robot, n, angle = self.robot, self.robot.coordinates, blocks["motor_angle"]
        count, mass = len(angle), self._mass(blocks)
        start = np.broadcast_to(self._start if len(self._start) == count else self._start[:1], (count, n))
        torque = textbook.static_torque(robot, mass, start, minimum=textbook.allocated_minimum(robot))
        wound = torque / textbook.joint_stiffness(self._given, start) if robot.flexible else np.zeros_like(angle)
        offset = np.zeros_like(angle)
        tare = np.zeros_like(angle)
        if self.homing:
            offset = angle - wound - textbook.pulley_angle(robot, start)
            if "tensions" in blocks:
                tare = blocks["tensions"] - torque / robot.pulley_radius
        home = textbook.cable_lengths(robot, robot.home)
        lengths = home - robot.pulley_radius * (angle - wound - offset)
        pose = forward_kinematics(robot, lengths, start).pose
        structure = textbook.jacobian(robot, pose)
        inverse = np.linalg.pinv(structure)
        velocity = -(inverse @ (robot.pulley_radius * blocks["motor_speed"])[..., None])[..., 0]
        covariance = np.zeros((count, 3 * n, 3 * n))
        angle_error = np.hypot(self._angle_noise, self._zero_error if "orientation" in blocks else 0.0)
        if robot.flexible:
            angle_error = np.hypot(angle_error, self._torque_error * robot.stall_torque / robot.stiffness)
        spread = angle_error, self._speed_noise
        for block, deviation in enumerate(spread):
            scaled = inverse * (robot.pulley_radius * deviation)
            at = slice(block * n, (block + 1) * n)
            covariance[:, at, at] = scaled @ np.swapaxes(scaled, -1, -2)
        covariance[:, 2 * n :, 2 * n :] = np.diag((INITIAL_DISTURBANCE * self._unit) ** 2)
        mean = np.concatenate([pose, velocity, np.zeros_like(pose)], axis=-1)
        if "orientation" in blocks:
            gradient = np.broadcast_to(np.eye(3, 3 * n, n - 3), (count, 3, 3 * n))
            mean, covariance = _corrected(
                mean, covariance, blocks["orientation"] - pose[:, -3:], gradient, self._orientation_variance
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

    def _following(self, blocks: dict[str, Array], state: KalmanState) -> KalmanState:
        """Prediction over one control period, and correction by the sensors."""
        robot, n, period, mass = self.robot, self.robot.coordinates, self._period, self._mass(blocks)
        angle, speed = blocks["motor_angle"] - state.offset, blocks["motor_speed"]
        action = np.clip(blocks["last_actions"][:, : robot.cables], -1.0, 1.0)
        # The request is constant over the period; the torque-speed line clips it at the changing speed.
        request = robot.stall_torque * action - robot.speed_slope * state.speed
        drop = robot.speed_slope * (state.speed + _FRACTIONS * (speed - state.speed))
        torque = np.mean(np.clip(request, -robot.stall_torque - drop, robot.stall_torque - drop), axis=0)
        if robot.flexible:
            friction = textbook.motor_friction(robot, (speed + state.speed) / 2)
            torque = torque - robot.motor_inertia * (speed - state.speed) / period - friction
        pose, velocity, disturbance = np.split(state.mean, 3, axis=-1)
        acceleration, tensions = textbook.forward_dynamics(
            robot, mass, pose + period / 2 * velocity, velocity, torque + state.correction, cable="bilateral"
        )
        correction, tare, count = state.correction, state.tare, state.count + 1
        if "tensions" in blocks:  # at the start of the period: of springs, the mean over the period before counts too
            then = (tensions + state.tensions) / 2 if robot.flexible else tensions
            excess = blocks["tensions"] - np.maximum(then, 0.0)
            taring = (count <= TARE_READINGS)[:, None] & self.homing
            tare = np.where(taring, tare + (excess - tare) / count[:, None], tare)
            seen = robot.pulley_radius * (excess - tare) + correction
            correction = correction + self._cell_gain * np.where(taring, 0.0, self._cell_weight * seen - correction)
        acceleration = acceleration + disturbance
        pose = pose + period * velocity + period**2 / 2 * acceleration
        velocity = velocity + period * acceleration
        mean = np.concatenate([pose, velocity, disturbance], axis=-1)

        # The transition mixes X, Ẋ and d of a coordinate alone: the dynamics hardly change within a period.
        mix = np.array([[1.0, period, period**2 / 2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
        transition = np.kron(mix, np.eye(n))
        covariance = transition @ state.covariance @ transition.T
        growth = (self._disturbance * self._unit) ** 2 * period
        jerk = np.array([period**2 / 6, period / 2, 1.0])
        covariance = covariance + np.kron(np.outer(jerk, jerk), np.diag(growth))

        if robot.flexible:  # means over the last period: of the motor angle by its cubic, of the spring by its torque
            angles = (angle + state.angle) / 2 - period / 12 * (speed - state.speed)
            angles = angles - (torque + correction) / textbook.joint_stiffness(self._given, pose)
        else:
            angles = angle
        values = self._readings(blocks, pose, velocity, acceleration, angles)
        mean, covariance = _corrected(mean, covariance, *values)
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

    def _readings(
        self,
        blocks: dict[str, Array],
        pose: Array,
        velocity: Array,
        acceleration: Array,
        angles: Array,
    ) -> tuple[Array, Array, Array]:
        """Innovations (N, k), their gradient with respect to the state (N, k, 3n), and their variances (k,).

        ``angles`` are the pulley angles now, or of a flexible robot in the middle of the last control period.
        """
        robot, n, ago = self.robot, self.robot.coordinates, self._period / 2 if self.robot.flexible else 0.0
        structure, rate = jacobian_and_rate(robot.base, robot.platform, pose, velocity, robot.swivel)
        turning, turning_rate = (-matrix / robot.pulley_radius[:, None] for matrix in (structure, rate))
        zero = np.zeros_like(turning)
        variance = [np.full(robot.cables, self._angle_noise**2)]
        if robot.flexible:
            cells = self._cell_weight * robot.pulley_radius * self.noise.tension * np.sqrt(self._cell_gain / 2)
            torque = np.hypot(self._balance_noise, cells if "tensions" in blocks else 0.0)
            variance[0] = variance[0] + (torque / robot.stiffness) ** 2
        then = pose - ago * velocity + ago**2 / 2 * acceleration
        innovations = [angles - textbook.pulley_angle(robot, then)]
        gradients = [np.concatenate([turning, -ago * turning, ago**2 / 2 * turning], axis=-1)]
        if not robot.flexible:
            innovations.append(blocks["motor_speed"] - (turning @ velocity[..., None])[..., 0])
            gradients.append(np.concatenate([turning_rate, turning, zero], axis=-1))
            variance.append(np.full(robot.cables, self._speed_noise**2))
        if "orientation" in blocks:
            euler = pose[:, -3:]
            to_omega, turned = euler_rate_matrix(euler), np.swapaxes(rotation_matrix(euler), -1, -2)
            free = acceleration[:, :3] - robot.gravity_vector
            innovations += [
                blocks["orientation"] - euler,
                blocks["angular_rate"] - (to_omega @ velocity[:, -3:, None])[..., 0],
                blocks["specific_force"] - (turned @ free[..., None])[..., 0],
            ]
            for matrix, first in ((np.eye(3), n - 3), (to_omega, 2 * n - 3), (turned, 2 * n)):
                gradient = np.zeros((len(pose), 3, 3 * n))
                gradient[:, :, first : first + 3] = matrix
                gradients.append(gradient)
            white, own = BIAS_TIME / self._period, self.noise
            variance[0] = variance[0] + white * self._zero_error**2
            variance += [white * self._orientation_variance]
            variance += [np.full(3, own.angular_rate**2), np.full(3, own.specific_force**2)]
        return np.concatenate(innovations, axis=-1), np.concatenate(gradients, axis=-2), np.concatenate(variance)


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
