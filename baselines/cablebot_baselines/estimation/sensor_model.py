"""Models of the sensors of winches and platform for the extended Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.estimation.drives import PulleyTorque
from cablebot_baselines.estimation.errors import FilterErrors
from cablebot_baselines.estimation.kalman import Columns, KalmanState, Readings
from cablebot_baselines.estimation.linearised import (
    STEP,
    Accelerated,
    anchor_gradients,
    static,
)
from cablebot_gym.kinematics import euler_rate_matrix, jacobian_and_rate, rotation_matrix
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import SensorNoise

Array = NDArray[Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Prediction over one control period."""

    mean: Array
    """Predicted state, (N, k)."""
    acceleration: Array
    """Mean acceleration in the period, (N, n)."""
    by_state: Array
    """Gradient of the acceleration with respect to the state, (N, n, k)."""
    motion: Accelerated
    """Nominal dynamics in the middle of the period."""
    pulled: PulleyTorque
    """Torque on the pulleys in the period."""


class SensorModel:
    """Readings that a state predicts.

    Args:
        nominal: nominal robot.
        robot: the same with joint springs in place of elastic cables.
        errors: the expected errors.
        columns: columns of the state.
        period: control period [s].
    """

    def __init__(
        self,
        nominal: Robot,
        robot: Robot,
        errors: FilterErrors,
        columns: Columns,
        period: float,
    ) -> None:
        self._nominal = nominal
        self.robot = robot
        self.errors = errors
        self._columns = columns
        self._period = period

    def at_rest(self, blocks: dict[str, Array], mean: Array, mass: Array) -> tuple[Readings, Array]:
        """First readings, and torques on the pulleys: the robot rests, so its tensions depend on
        pose and mass (N,)."""
        robot, columns = self.robot, self._columns
        readings = Readings(*mean.shape)
        pose = mean[:, columns.pose]
        mass = mass + mean[:, columns.mass].sum(axis=-1)
        torque, by_pose, by_mass = static(robot, mass, pose)
        deflection = self._deflection(torque, pose)
        compliance = self._deflection(np.ones_like(torque), pose)[..., None]
        turning = -textbook.jacobian(robot, pose) / robot.pulley_radius[:, None]
        by_base, by_platform = self._anchor_gradients(pose)
        readings.add(
            blocks["motor_angle"] - self._predicted_angle(mean, pose, deflection),
            self.errors.noise.motor_angle**2,
            (columns.pose, turning + compliance * by_pose),
            (columns.zero, 1.0),
            (columns.quantisation, 1.0),
            (columns.compliance, deflection[..., None] * np.eye(robot.cables)),
            (columns.mass, compliance * by_mass),
            (columns.base, by_base),
            (columns.platform, by_platform),
        )
        if "tensions" in blocks:
            readings.add(
                blocks["tensions"] - torque / robot.pulley_radius - mean[:, columns.cell],
                self.errors.noise.tension**2,
                (columns.pose, by_pose / robot.pulley_radius[:, None]),
                (columns.mass, by_mass / robot.pulley_radius[:, None]),
                (columns.cell, 1.0),
            )
        if "orientation" in blocks:
            self._read_orientation(blocks, readings, mean)
        return readings, torque

    def following(
        self, blocks: dict[str, Array], state: KalmanState, prediction: Prediction
    ) -> Readings:
        """Readings after a control period that began with ``state``."""
        readings = Readings(*prediction.mean.shape)
        self._read_angles(blocks, readings, state, prediction)
        if not self.robot.flexible:
            self._read_speeds(blocks, readings, prediction.mean)
        if "tensions" in blocks:
            self._read_tensions(blocks, readings, state, prediction)
        if "orientation" in blocks:
            self._read_orientation(blocks, readings, prediction.mean)
            self._read_inertial(blocks, readings, prediction)
        return readings

    def _deflection(self, torque: Array, pose: Array) -> Array:
        """Nominal deflections of the springs, (N, m) [rad]; zero if the robot is rigid."""
        if not self.robot.flexible:
            return np.zeros_like(torque)
        return torque / textbook.joint_stiffness(self._nominal, pose)

    def _predicted_angle(self, mean: Array, pose: Array, deflection: Array) -> Array:
        """Motor angles as measured at poses (N, n) with the nominal deflections (N, m)."""
        columns = self._columns
        predicted = textbook.pulley_angle(self.robot, pose) + mean[:, columns.zero] + deflection
        by_base, by_platform = self._anchor_gradients(pose)
        for part, gradient in (
            (columns.quantisation, 1.0),
            (columns.compliance, deflection),
        ):
            if part.stop > part.start:
                predicted = predicted + gradient * mean[:, part]
        for part, gradient in ((columns.base, by_base), (columns.platform, by_platform)):
            if part.stop > part.start:
                predicted = predicted + textbook.times_vector(gradient, mean[:, part])
        return predicted

    def _anchor_gradients(self, pose: Array) -> tuple[Any, Any]:
        if self._columns.base.stop == self._columns.platform.stop == self._columns.base.start:
            return 0.0, 0.0
        return anchor_gradients(self.robot, pose)

    def _read_angles(
        self,
        blocks: dict[str, Array],
        readings: Readings,
        state: KalmanState,
        prediction: Prediction,
    ) -> None:
        """Adds the pulley angles: now, or of a flexible robot in the middle of the last period."""
        robot, columns, period = self.robot, self._columns, self._period
        mean, pulled = prediction.mean, prediction.pulled
        angle = blocks["motor_angle"]
        pose, velocity = mean[:, columns.pose], mean[:, columns.velocity]
        deflection = np.zeros_like(angle)
        compliance = np.zeros((1, 1))
        ago = 0.0
        if robot.flexible:
            # Means over the last period: the motor angle by its cubic, the deflection by the mean
            # torque.
            change = blocks["motor_speed"] - state.speed
            angle = (angle + state.angle) / 2 - period / 12 * change
            deflection = self._deflection(pulled.torque, pose)
            compliance = self._deflection(np.ones_like(angle), pose)
            ago = period / 2
        earlier = pose - ago * velocity + ago**2 / 2 * prediction.acceleration
        turning = -textbook.jacobian(robot, earlier) / robot.pulley_radius[:, None]
        by_base, by_platform = self._anchor_gradients(earlier)
        identity = np.eye(robot.cables)
        readings.add(
            angle - self._predicted_angle(mean, earlier, deflection),
            self.errors.noise.motor_angle**2,
            (columns.pose, turning),
            (columns.velocity, -ago * turning),
            (columns.disturbance, ago**2 / 2 * turning),
            (columns.zero, 1.0),
            (columns.quantisation, 1.0),
            (columns.compliance, deflection[..., None] * identity),
            *(
                (part, (factor * compliance)[..., None] * identity)
                for part, factor in pulled.errors
            ),
            (columns.base, by_base),
            (columns.platform, by_platform),
        )

    def _read_speeds(self, blocks: dict[str, Array], readings: Readings, mean: Array) -> None:
        """Adds the motor speeds of a rigid robot."""
        robot, columns = self.robot, self._columns
        pose, velocity = mean[:, columns.pose], mean[:, columns.velocity]
        structure, rate = jacobian_and_rate(
            robot.base, robot.platform, pose, velocity, robot.swivel
        )
        turning = -structure / robot.pulley_radius[:, None]
        predicted = textbook.times_vector(turning, velocity)
        parts = [(columns.pose, -rate / robot.pulley_radius[:, None]), (columns.velocity, turning)]
        earlier = self._anchor_gradients(pose - self._period * velocity)
        later = self._anchor_gradients(pose)
        for part, before, after in zip(
            (columns.base, columns.platform), earlier, later, strict=True
        ):
            if part.stop > part.start:
                by_anchors = (after - before) / self._period
                predicted = predicted + textbook.times_vector(by_anchors, mean[:, part])
                parts.append((part, by_anchors))
        readings.add(
            blocks["motor_speed"] - predicted,
            self.errors.noise.motor_speed**2,
            *parts,
        )

    def _read_tensions(
        self,
        blocks: dict[str, Array],
        readings: Readings,
        state: KalmanState,
        prediction: Prediction,
    ) -> None:
        """Adds the tensions."""
        columns, motion = self._columns, prediction.motion
        # The cells read at the start of the period. With springs, the mean over the period before
        # counts too.
        expected = motion.tensions
        if self.robot.flexible:
            expected = (motion.tensions + state.tensions) / 2
        readings.add(
            blocks["tensions"] - np.maximum(expected, 0.0) - prediction.mean[:, columns.cell],
            self.errors.noise.tension**2,
            (columns.pose, motion.by_pose[1]),
            *(
                (part, factor[..., None, :] * motion.by_torque[1])
                for part, factor in prediction.pulled.errors
            ),
            (columns.mass, motion.by_mass[1]),
            (columns.cell, 1.0),
        )

    def _read_orientation(self, blocks: dict[str, Array], readings: Readings, mean: Array) -> None:
        """Adds the orientation of an IMU."""
        columns = self._columns
        euler = slice(columns.pose.stop - 3, columns.pose.stop)
        readings.add(
            blocks["orientation"] - mean[:, euler] - mean[:, columns.orientation],
            orientation_deviations(self.errors.noise) ** 2,
            (euler, 1.0),
            (columns.orientation, 1.0),
        )

    def _read_inertial(
        self,
        blocks: dict[str, Array],
        readings: Readings,
        prediction: Prediction,
    ) -> None:
        """Adds angular rate and specific force of an IMU."""
        robot, columns, noise = self.robot, self._columns, self.errors.noise
        mean = prediction.mean
        euler, rates = mean[:, columns.pose][:, -3:], mean[:, columns.velocity][:, -3:]
        to_omega = euler_rate_matrix(euler)
        turning = slice(columns.velocity.stop - 3, columns.velocity.stop)
        readings.add(
            blocks["angular_rate"] - textbook.times_vector(to_omega, rates),
            noise.angular_rate**2,
            (turning, to_omega),
        )
        free = prediction.acceleration[:, :3] - robot.gravity_vector
        varied = euler + STEP * np.eye(4, 3, -1)[:, None]  # nominal, then each angle changed
        to_platform = np.swapaxes(rotation_matrix(varied), -1, -2)
        force = textbook.times_vector(to_platform, free)
        readings.add(
            blocks["specific_force"] - force[0],
            noise.specific_force**2,
            (slice(0, columns.total), to_platform[0] @ prediction.by_state[:, :3]),
            # the direction of gravity in the platform frame
            (
                slice(columns.pose.stop - 3, columns.pose.stop),
                np.moveaxis(force[1:] - force[0], 0, -1) / STEP,
            ),
        )


def orientation_deviations(noise: SensorNoise) -> Array:
    """Standard deviations of the angles ψ, θ and φ of an IMU, (3,) [rad]."""
    return np.array([noise.tilt, noise.tilt, noise.yaw])
