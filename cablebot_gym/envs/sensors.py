"""Exact readings of the sensors of winches and platform. Noise, bias and resolution are added in
the outcome."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import Measurement
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import Robot


class Sensors:
    """Sensors of N environments. They read the true state of the true robots.

    Args:
        robot: nominal robot.
        measurement: the sensors.
        count: number of environments, N.
        period: control period [s].
    """

    def __init__(self, robot: Robot, measurement: Measurement, count: int, period: float) -> None:
        self._robot = robot
        self._measurement = measurement
        self._period = period
        sizes = measurement.sizes(robot) if measurement.winches else {}
        self.readings = np.zeros((count, sum(sizes.values())))
        """Readings in the order of the observation, (N, components); (N, 0) if pose and velocity
        are measured."""
        self._velocity = np.zeros((count, robot.dimensions))  # of the last control instant

    def read(
        self,
        env_indices: NDArray[np.int64],
        plant: Plant,
        truth: Mapping[str, Array],
        *,
        fresh: bool,
    ) -> None:
        """Writes the readings of the environments ``env_indices``.

        Args:
            env_indices: environments, (k,).
            plant: the plant.
            truth: true parameters by name, each (N, …).
            fresh: whether the environments have just been reset.
        """
        robot = self._robot
        pose = plant.pose[env_indices]
        velocity = plant.velocity[env_indices]
        if robot.flexible:
            values = [plant.motor_angle[env_indices], plant.motor_speed[env_indices]]
        else:
            base = truth["base_anchors"][env_indices]
            platform = robot.platform
            if "platform_anchors" in truth:
                platform = truth["platform_anchors"][env_indices]
            home = np.broadcast_to(robot.home, pose.shape)
            home_lengths = kinematics.cable_lengths(base, platform, home, robot.swivel)
            lengths = kinematics.cable_lengths(base, platform, pose, robot.swivel)
            structure = kinematics.structure_jacobian(base, platform, pose, robot.swivel)
            length_rates = kinematics.times_vector(structure, velocity)
            angles = (home_lengths - lengths) / robot.pulley_radius
            speeds = -length_rates / robot.pulley_radius
            values = [angles, speeds]
        if self._measurement.tensions:
            if fresh:  # the record has no tensions yet, but the torques at rest
                torques = plant.per_cable(rows.TORQUE)[env_indices]
                values.append(torques / robot.pulley_radius)
            else:
                values.append(plant.per_cable(rows.TENSION)[env_indices])
        if self._measurement.imu:
            axes = self._velocity.shape[-1]
            acceleration = np.zeros_like(pose[:, :axes])
            if not fresh:  # at rest before the start
                acceleration = (velocity[:, :axes] - self._velocity[env_indices]) / self._period
            self._velocity[env_indices] = velocity[:, :axes]
            values += inertial(robot, pose, velocity, acceleration)
        self.readings[env_indices] = np.concatenate(values, axis=-1)


def inertial(robot: Robot, pose: Array, velocity: Array, acceleration: Array) -> list[Array]:
    """Orientation, angular rate and specific force in the platform frame, each (..., 3).

    Args:
        robot: robot with three angles.
        pose: X, (..., 6).
        velocity: Ẋ, (..., 6).
        acceleration: acceleration of the frame's origin, where the sensor is, (..., 3) [m/s²].
    """
    euler = pose[..., -3:]
    rate = kinematics.times_vector(kinematics.euler_rate_matrix(euler), velocity[..., -3:])
    to_platform = kinematics.rotation_matrix(euler).mT
    force = kinematics.times_vector(to_platform, acceleration - robot.gravity_vector)
    return [euler, rate, force]
