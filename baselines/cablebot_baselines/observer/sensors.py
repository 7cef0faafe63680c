"""Measurement models of the observer: readings of pose and velocity, or of winches and platform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.filtering import correct
from cablebot_baselines.observer.observer_state import Columns
from cablebot_gym.envs.observation import Blocks
from cablebot_gym.kinematics import Array, cable_vectors, euler_rate_matrix, rotation_matrix
from cablebot_gym.measurement import Measurement
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import times_vector
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import SensorNoise

LEAST_VARIANCE = 1e-14
"""Least variance of a reading, in its squared unit: the arithmetic needs it for exact sensors."""

STEP = 1e-4
"""Step of the difference quotients with respect to coordinates [m, rad] and mass [kg]. With a smaller
one, rounding of the differences would show in the estimates."""

START_ITERATIONS = 4
"""Number of linearisations at the start, where the pose changes most."""

QUANTISED_TIME = 0.03
"""Longest time for which the quantisation error of an encoder is taken as constant [s]."""


class Readings(NamedTuple):
    """Readings of N episodes with independent errors."""

    innovation: Array
    """Readings minus their predictions, (N, k)."""
    gradient: Array
    """Derivatives of the readings with respect to the state, (N, k, size)."""
    variance: Array
    """Variances of their errors, (N, k)."""

    @classmethod
    def joined(cls, parts: list[Readings]) -> Readings:
        """Readings of several kinds."""
        innovations, gradients, variances = zip(*parts, strict=True)
        return cls(
            innovation=np.concatenate(innovations, axis=-1),
            gradient=np.concatenate(gradients, axis=-2),
            variance=np.concatenate(variances, axis=-1),
        )

    def correct(self, mean: Array, covariance: Array) -> None:
        """Changes means (N, size) and covariances (N, size, size) to those after the readings."""
        correct(*self, mean, covariance)


@dataclass(frozen=True, kw_only=True, eq=False)
class Period:
    """Motion of N robots in the last control period."""

    torque_gradient: Array
    """Derivatives of the torques on the pulleys with respect to the state, (N, m, size)."""
    acceleration: Array
    """Ẍ, (N, n)."""
    gradient: Array
    """Derivatives of Ẍ with respect to the state, (N, n, size)."""
    tensions: Array
    """Tensions T, (N, m) [N]."""
    torque_error: Array
    """Standard deviations of further errors of the torques, (N, m) [N·m]."""


class PoseSensors:
    """Pose and velocity of the platform.

    Args:
        expectation: expected robot and noise.
        columns: columns of the state.
    """

    def __init__(self, expectation: Expectation, columns: Columns) -> None:
        deviations = expectation.noise.deviations(expectation.robot)
        self._columns = columns
        self._variance = deviations[: columns.mass] ** 2 + LEAST_VARIANCE
        self._gradient = np.eye(columns.mass, columns.total)

    def start(self, blocks: Blocks, mean: Array, variance: Array) -> None:
        """Writes pose and velocity of the first observation, and their variances, each (N, size)."""
        columns = self._columns
        mean[:, columns.pose] = blocks["pose"]
        mean[:, columns.velocity] = blocks["velocity"]
        variance[:, : columns.mass] = self._variance

    def read(self, blocks: Blocks, mean: Array) -> Readings:
        """Readings of an observation, for predicted means (N, size)."""
        count = len(mean)
        values = np.concatenate([blocks["pose"], blocks["velocity"]], axis=-1)
        innovation = values - mean[:, : self._columns.mass]
        gradient = np.repeat(self._gradient[None], count, axis=0)
        variance = np.repeat(self._variance[None], count, axis=0)
        return Readings(innovation, gradient, variance)


class WinchSensors:
    """Angles and speeds of the motors, load cells and an IMU.

    The angles and speeds of a flexible robot are no readings here: its spring torques and the
    balance of its motors follow from them.

    Args:
        expectation: expected robot, noise and constant errors.
        columns: columns of the state.
        measurement: the sensors.
        start_pose: start pose of each task, (tasks, n); one serves any number of episodes.
        period: control period [s].
    """

    def __init__(
        self,
        expectation: Expectation,
        columns: Columns,
        measurement: Measurement,
        start_pose: Array,
        period: float,
    ) -> None:
        self._expectation = expectation
        self._robot = textbook.joint_equivalent(expectation.robot)
        self._columns = columns
        self._measurement = measurement
        self._start_pose = start_pose
        self._period = period

    def start(self, blocks: Blocks, mean: Array, variance: Array) -> None:
        """Writes the pose of the task, the velocity by the motor speeds, and their variances and
        those of the constant errors, each (N, size)."""
        robot = self._robot
        columns = self._columns
        expected = self._expectation
        position, rotation = expected.start_spread
        is_position = np.arange(robot.coordinates) < robot.dimensions
        pose = np.broadcast_to(self._start_pose, (len(mean), robot.coordinates))
        inverse = np.linalg.pinv(textbook.jacobian(robot, pose))
        mean[:, columns.pose] = pose
        mean[:, columns.velocity] = times_vector(
            inverse, -robot.pulley_radius * blocks["motor_speed"]
        )
        rate_noise = inverse * (robot.pulley_radius * expected.noise.motor_speed)
        variance[:, columns.pose] = np.where(is_position, position, rotation) ** 2
        variance[:, columns.velocity] = np.sum(rate_noise**2, axis=-1) + LEAST_VARIANCE
        variance[:, columns.zero] = expected.bias.motor_angle**2
        variance[:, columns.compliance] = expected.stiffness_spread**2
        variance[:, columns.anchor] = expected.anchor_spread**2
        variance[:, columns.cell] = expected.bias.tension**2
        if self._measurement.imu:
            variance[:, columns.orientation] = _orientation(expected.bias)

    def correct_at_rest(self, blocks: Blocks, mean: Array, covariance: Array) -> None:
        """Changes means and covariances to those after the first readings of robots at rest, whose
        tensions follow from pose and mass."""
        prior_mean = mean.copy()
        prior_covariance = covariance.copy()
        for _ in range(START_ITERATIONS):
            innovation, gradient, variance = Readings.joined(self._at_rest(blocks, mean))
            innovation = innovation + times_vector(gradient, mean - prior_mean)
            mean[:] = prior_mean
            covariance[:] = prior_covariance
            Readings(innovation, gradient, variance).correct(mean, covariance)

    def _at_rest(self, blocks: Blocks, mean: Array) -> list[Readings]:
        robot = self._robot
        columns = self._columns
        noise = self._expectation.noise
        pose = mean[:, columns.pose]
        torque, by_pose, by_mass = _static(robot, mean[:, columns.mass], pose)
        deflections = []
        slopes: list[tuple[slice | int, Array]] = []
        if robot.flexible:
            compliance = 1 / textbook.joint_stiffness(robot, pose)
            deflection = compliance * torque
            deflections = [deflection]
            slopes = [
                (columns.pose, compliance[..., None] * by_pose),
                (columns.mass, compliance * by_mass),
            ]
            if columns.compliance.stop > columns.compliance.start:
                deflections.append(deflection * mean[:, columns.compliance])
                slopes.append((columns.compliance, deflection[..., None] * np.eye(robot.cables)))
        parts = [self._angles(blocks, mean, self.angle_deviation**2, deflections, slopes)]
        if "tensions" in blocks:
            radius = robot.pulley_radius
            cells = self._readings(
                blocks["tensions"] - torque / radius - mean[:, columns.cell],
                noise.tension**2,
                (columns.pose, by_pose / radius[:, None]),
                (columns.mass, by_mass / radius),
                (columns.cell, np.eye(robot.cables)),
            )
            parts.append(cells)
        if "orientation" in blocks:
            parts.append(self._orientation(blocks, mean))
        return parts

    def read(
        self, blocks: Blocks, mean: Array, period: Period, last_tensions: Array
    ) -> list[Readings]:
        """Readings of an observation, for predicted means (N, size).

        Args:
            blocks: blocks of the observation, each (N, size).
            mean: the predicted state.
            period: motion in the last control period.
            last_tensions: tensions in the period before, (N, m) [N].
        """
        parts = []
        if not self._robot.flexible:
            noise = self._expectation.noise.motor_angle**2
            variance = noise + self.quantisation(blocks["motor_speed"])
            parts += [self._angles(blocks, mean, variance), self._speeds(blocks, mean)]
        if "tensions" in blocks:
            parts.append(self._tensions(blocks, mean, period, last_tensions))
        if "orientation" in blocks:
            parts.append(self._orientation(blocks, mean))
            parts += self._inertial(blocks, mean, period)
        return parts

    @property
    def angle_deviation(self) -> float:
        """Standard deviation of a motor angle by noise and quantisation [rad]."""
        quantisation = self._measurement.encoder_resolution / np.sqrt(12)
        return float(np.hypot(self._expectation.noise.motor_angle, quantisation))

    def quantisation(self, speed: Array) -> Array:
        """Variance of the quantisation error of motor angles at speeds (N, m) [rad²], as large as
        that of independent errors with the same mean over the time in which it stays the same."""
        resolution = self._measurement.encoder_resolution
        turned = np.maximum(np.abs(speed) * self._period, 1e-12)
        periods = np.clip(resolution / turned, 1.0, QUANTISED_TIME / self._period)
        variance: Array = resolution**2 / 12 * periods
        return variance

    def anchor_error(self, mean: Array, pose: Array) -> tuple[Array, Array]:
        """Errors of the pulley angles at poses (N, n) by those of the anchors, (N, m) [rad], and their
        derivatives, (N, m, columns).

        They are zero at the home pose, where the angles are.
        """
        columns = self._columns.anchor
        if columns.stop == columns.start:
            return np.zeros(len(mean))[:, None], np.zeros((len(mean), self._robot.cables, 0))
        gradient = self._anchor_gradient(pose) - self._anchor_gradient(self._robot.home[None])
        return times_vector(gradient, mean[:, columns]), gradient

    def _anchor_gradient(self, pose: Array) -> Array:
        robot = self._robot
        vectors = cable_vectors(robot.base, robot.platform, pose)
        lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
        own_anchor = np.eye(robot.cables)[:, :, None]
        by_cable = own_anchor * (vectors / lengths)[:, :, None, :]
        gradient: Array = by_cable.reshape(len(pose), robot.cables, -1)
        return gradient / robot.pulley_radius[:, None]

    def _angles(
        self,
        blocks: Blocks,
        mean: Array,
        variance: ArrayLike,
        deflections: Sequence[Array] = (),
        slopes: Sequence[tuple[slice | int, Array]] = (),
    ) -> Readings:
        """Motor angles, with deflections of springs (N, m) [rad] and their derivatives with respect
        to some columns of the state."""
        robot = self._robot
        columns = self._columns
        pose = mean[:, columns.pose]
        anchor_error, by_anchors = self.anchor_error(mean, pose)
        predicted = textbook.pulley_angle(robot, pose) + mean[:, columns.zero] + anchor_error
        for deflection in deflections:
            predicted = predicted + deflection
        return self._readings(
            blocks["motor_angle"] - predicted,
            variance,
            (columns.pose, self._turning(pose)),
            (columns.zero, np.eye(robot.cables)),
            (columns.anchor, by_anchors),
            *slopes,
        )

    def _turning(self, pose: Array) -> Array:
        """Derivatives of the pulley angles with respect to poses (N, n), (N, m, n)."""
        robot = self._robot
        turning: Array = -textbook.jacobian(robot, pose) / robot.pulley_radius[:, None]
        return turning

    def _speeds(self, blocks: Blocks, mean: Array) -> Readings:
        """Motor speeds of a rigid robot."""
        robot = self._robot
        columns = self._columns
        velocity = mean[:, columns.velocity]
        pose = mean[:, columns.pose]
        turning = self._turning(pose)
        rate = textbook.jacobian_rate(robot, pose, velocity)
        error, by_anchors = self.anchor_error(mean, pose)
        last_error, last_by_anchors = self.anchor_error(mean, pose - self._period * velocity)
        anchor_rate = (error - last_error) / self._period
        return self._readings(
            blocks["motor_speed"] - times_vector(turning, velocity) - anchor_rate,
            self._expectation.noise.motor_speed**2,
            (columns.pose, -rate / robot.pulley_radius[:, None]),
            (columns.velocity, turning),
            (columns.anchor, (by_anchors - last_by_anchors) / self._period),
        )

    def _tensions(
        self, blocks: Blocks, mean: Array, period: Period, last_tensions: Array
    ) -> Readings:
        """Tensions at load cells. They read at the start of the period; with springs, the mean over
        the period before counts too."""
        robot = self._robot
        columns = self._columns
        expected = period.tensions
        if robot.flexible:
            expected = (expected + last_tensions) / 2
        radius = robot.pulley_radius[:, None]
        rotor_mass = (robot.pulley_inertia / robot.pulley_radius**2)[:, None]
        structure = textbook.jacobian(robot, mean[:, columns.pose])
        by_torque = period.torque_gradient / radius + rotor_mass * (structure @ period.gradient)
        return self._readings(
            blocks["tensions"] - np.maximum(expected, 0.0) - mean[:, columns.cell],
            self._expectation.noise.tension**2 + (period.torque_error / robot.pulley_radius) ** 2,
            (slice(0, columns.total), by_torque),
            (columns.cell, np.eye(robot.cables)),
        )

    def _orientation(self, blocks: Blocks, mean: Array) -> Readings:
        """Orientation of an IMU."""
        columns = self._columns
        euler = slice(columns.pose.stop - 3, columns.pose.stop)
        return self._readings(
            blocks["orientation"] - mean[:, euler] - mean[:, columns.orientation],
            _orientation(self._expectation.noise),
            (euler, np.eye(3)),
            (columns.orientation, np.eye(3)),
        )

    def _inertial(self, blocks: Blocks, mean: Array, period: Period) -> list[Readings]:
        """Angular rate and specific force of an IMU."""
        columns = self._columns
        noise = self._expectation.noise
        angles = slice(columns.pose.stop - 3, columns.pose.stop)
        rates = slice(columns.velocity.stop - 3, columns.velocity.stop)
        to_omega = euler_rate_matrix(mean[:, angles])
        angular_rate = self._readings(
            blocks["angular_rate"] - times_vector(to_omega, mean[:, rates]),
            noise.angular_rate**2,
            (rates, to_omega),
        )
        free = period.acceleration[:, :3] - self._robot.gravity_vector
        varied = mean[:, angles] + STEP * np.eye(4, 3, -1)[:, None]  # then each angle changed
        to_platform = rotation_matrix(varied).mT
        force = times_vector(to_platform, free)
        specific_force = self._readings(
            blocks["specific_force"] - force[0],
            noise.specific_force**2,
            (slice(0, columns.total), to_platform[0] @ period.gradient[:, :3]),
            (angles, np.moveaxis(force[1:] - force[0], 0, -1) / STEP),
        )
        return [angular_rate, specific_force]

    def _readings(
        self, innovation: Array, variance: ArrayLike, *parts: tuple[slice | int, Array]
    ) -> Readings:
        """Readings with the derivatives with respect to some columns of the state."""
        gradient = np.zeros((*innovation.shape, self._columns.total))
        for columns, derivative in parts:
            gradient[..., columns] += derivative
        variances = np.broadcast_to(np.add(variance, LEAST_VARIANCE), innovation.shape)
        return Readings(innovation, gradient, variances)


def _orientation(noise: SensorNoise) -> Array:
    """Variances of the angles ψ, θ and φ of an IMU, (3,) [rad²]."""
    return np.array([noise.tilt, noise.tilt, noise.yaw]) ** 2


def _static(robot: Robot, mass: Array, pose: Array) -> tuple[Array, Array, Array]:
    """Torques at rest (N, m), and their derivatives with respect to X (N, m, n) and to the mass (N,
    m)."""
    poses, masses = varied(pose, mass)
    torques = textbook.static_torque(robot, masses, poses)
    quotients = np.moveaxis(torques[1:] - torques[0], 0, -1) / STEP
    return torques[0], quotients[..., :-1], quotients[..., -1]


def varied(pose: Array, mass: Array) -> tuple[Array, Array]:
    """Poses (n + 2, N, n) and masses (n + 2, N): as given, each coordinate changed by :data:`STEP`,
    the mass changed."""
    n = pose.shape[-1]
    poses = pose + STEP * np.eye(n + 2, n, -1)[:, None]
    masses = np.repeat(mass[None], n + 2, axis=0)
    masses[-1] += STEP
    return poses, masses
