"""Fourth-order feedback linearization, a stable law for joint springs that the claims of the paper
are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cablebot_baselines.classical.flexible import FlexibleLaw, Motion
from cablebot_baselines.classical.law import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot


class FourthOrder(FlexibleLaw):
    """Fourth-order feedback linearization: the input is the snap of the platform, the error
    dynamics have given poles.

    The law computes acceleration and jerk from the state through the spring torques. κ is affine in
    Ẍ, κ̇ in the jerk and κ̈ in the snap, each with the matrix ∂κ/∂Ẍ. The law needs as many cables
    as coordinates. The paper gives no gains for this law; the default poles are our choice.

    Args:
        robot: nominal spatial robot.
        poles: four poles in the left half plane, complex poles in conjugate pairs [1/s].

    Raises:
        ValueError: if the robot is planar or has no joint springs, or the poles are invalid.
    """

    def __init__(
        self, robot: Robot, *, poles: Sequence[complex] = (-15.0, -15.0, -60.0, -60.0)
    ) -> None:
        super().__init__(robot)
        if robot.cables != robot.coordinates:
            raise ValueError(
                "FourthOrder needs as many cables as coordinates, "
                f"but robot {robot.name!r} has {robot.cables} cables and {robot.coordinates} coordinates. "
            )
        gains = np.poly(np.asarray(poles))
        rounding = 1e-9 * np.abs(gains)
        are_stable = np.all(np.real(poles) < 0)
        are_conjugate = np.all(np.abs(np.imag(gains)) <= rounding)
        if len(poles) != 4 or not are_stable or not are_conjugate:
            raise ValueError(
                f"poles must be four stable poles, complex poles in conjugate pairs, not {poles}"
            )
        self._gains = np.real(gains)[1:]

    def _motor_torques(self, blocks: dict[str, Array], mass: Array) -> Array:
        robot = self.model
        pose = blocks["pose"]
        velocity = blocks["velocity"]
        zero = np.zeros_like(pose)
        slope = self.torque_slope(mass, pose)
        stiffness = textbook.joint_stiffness(self.robot, pose)
        # κ = K (β′ − β) and its rate are measured. They determine acceleration and jerk.
        deflection = blocks["motor_angle"] - textbook.pulley_angle(robot, pose)
        deflection_rate = blocks["motor_speed"] - self.pulley_speed(pose, velocity)
        spring = stiffness * deflection
        spring_rate = stiffness * deflection_rate
        spring_without_acceleration = self._spring_torques(mass, pose, velocity, zero)
        acceleration = _solve(slope, spring - spring_without_acceleration)
        motion = Motion(
            position=pose, velocity=velocity, acceleration=acceleration, jerk=zero, snap=zero
        )
        _, rate_without_jerk, _ = self._spring_torque_derivatives(mass, motion)
        jerk = _solve(slope, spring_rate - rate_without_jerk)
        motion = replace(motion, jerk=jerk)
        _, _, second_without_snap = self._spring_torque_derivatives(mass, motion)
        jerk_gain, acceleration_gain, velocity_gain, pose_gain = self._gains
        snap = blocks["reference_snap"] + (
            jerk_gain * (blocks["reference_jerk"] - jerk)
            + acceleration_gain * (blocks["reference_acceleration"] - acceleration)
            + velocity_gain * (blocks["reference_velocity"] - velocity)
            + pose_gain * (blocks["reference_pose"] - pose)
        )
        spring_second = second_without_snap + textbook.times_vector(slope, snap)
        pulley_acceleration = self._pulley_acceleration(pose, velocity, acceleration)
        motor_acceleration = pulley_acceleration + spring_second / stiffness
        inertial = robot.motor_inertia * motor_acceleration
        return spring + inertial + textbook.motor_friction(robot, blocks["motor_speed"], spring)


def _solve(matrix: Array, vector: Array) -> Array:
    return np.linalg.solve(matrix, vector[..., None])[..., 0]
