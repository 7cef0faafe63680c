"""Fourth-order feedback linearization, a stable law for joint springs that the claims of the paper
are compared with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablebot_baselines.laws.flexible import FlexibleLaw, JointMotion
from cablebot_baselines.laws.law import Array
from cablebot_gym.physics import textbook

POLES = (-15.0, -15.0, -60.0, -60.0)
"""Poles of the error dynamics [1/s]. The paper gives no gains for this law."""


class FourthOrder(FlexibleLaw):
    """Fourth-order feedback linearization of a spatial robot: the input is the snap of the
    platform, the error dynamics have the poles :data:`POLES`.

    The law computes acceleration and jerk from the state through the spring torques. κ is affine in
    Ẍ, κ̇ in the jerk and κ̈ in the snap, each with the matrix ∂κ/∂Ẍ.
    """

    def _motor_torques(self, blocks: dict[str, Array], mass: Array) -> Array:
        robot = self.model
        pose = blocks["pose"]
        velocity = blocks["velocity"]
        zero = np.zeros_like(pose)
        slope = self.torque_slope(mass, pose)
        # κ = K (β′ − β) and its rate are measured. They determine acceleration and jerk.
        deflection = blocks["motor_angle"] - textbook.pulley_angle(robot, pose)
        deflection_rate = blocks["motor_speed"] - self.pulley_speed(pose, velocity)
        spring = robot.stiffness * deflection
        spring_without_acceleration = self._inverse_dynamics(mass, pose, velocity, zero).torques
        acceleration = _solve(slope, spring - spring_without_acceleration)
        motion = JointMotion(
            position=pose, velocity=velocity, acceleration=acceleration, jerk=zero, snap=zero
        )
        _, rate_without_jerk, _ = self._spring_torque_derivatives(mass, motion)
        jerk = _solve(slope, robot.stiffness * deflection_rate - rate_without_jerk)
        motion = replace(motion, jerk=jerk)
        _, _, second_without_snap = self._spring_torque_derivatives(mass, motion)
        _, jerk_gain, acceleration_gain, velocity_gain, pose_gain = np.poly(POLES)
        snap = blocks["reference_snap"] + (
            jerk_gain * (blocks["reference_jerk"] - jerk)
            + acceleration_gain * (blocks["reference_acceleration"] - acceleration)
            + velocity_gain * (blocks["reference_velocity"] - velocity)
            + pose_gain * (blocks["reference_pose"] - pose)
        )
        spring_second = second_without_snap + textbook.times_vector(slope, snap)
        required = self._inverse_dynamics(mass, pose, velocity, acceleration)
        motor_acceleration = required.pulley_accelerations + spring_second / robot.stiffness
        inertial = robot.motor_inertia * motor_acceleration
        return spring + inertial + textbook.motor_friction(robot, blocks["motor_speed"], spring)


def _solve(matrix: Array, vector: Array) -> Array:
    return np.linalg.solve(matrix, vector[..., None])[..., 0]
