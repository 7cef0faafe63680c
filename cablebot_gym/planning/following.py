"""Torques that follow a planned motion: feedforward from the plan plus feedback on the error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.planning.motion import PlannedMotion, PlannedMotions
from cablebot_gym.robots import Robot


@dataclass(frozen=True, kw_only=True)
class State:
    """Measured state at a control instant; each array has shape (..., size) unless stated
    otherwise."""

    time: Array
    """Time of the control instant since the start of the motion, shape (...) [s]."""
    pose: Array
    """Pose X [m, rad]."""
    velocity: Array
    """Velocity Ẋ [m/s, rad/s]."""
    motor_angle: Array | None = None
    """Motor angle β′ of a flexible robot [rad]; None if rigid."""
    motor_speed: Array | None = None
    """Motor speed β̇′ of a flexible robot [rad/s]; None if rigid."""

    @classmethod
    def from_blocks(cls, blocks: Mapping[str, Array], time: Array) -> State:
        """The state from the blocks of an observation by name, at a time since the start of the
        motion, shape (...) [s]."""
        return cls(
            time=time,
            pose=blocks["pose"],
            velocity=blocks["velocity"],
            motor_angle=blocks.get("motor_angle"),
            motor_speed=blocks.get("motor_speed"),
        )


@dataclass(frozen=True, kw_only=True)
class Follower:
    """Controller that follows a planned motion: computed torque on a rigid robot, PD control of the
    motor angles on a flexible robot.

    The torque is constant over a control period h. The controller therefore uses the mean
    acceleration of the plan over the period, (Ẋ(t+h) − Ẋ(t))/h, and the inverse dynamics at the
    middle of the period. At the end of the period the velocity then equals that of the plan up to
    O(h³).

    On a flexible robot the mean motor acceleration is used in the same way. The correction v = K_P
    e + K_D ė, with the pose error e, changes the spring torque κ by ∂κ/∂Ẍ v; the motor angles move
    by this torque over the stiffness of the springs (joint springs or elastic cables).
    """

    robot: Robot
    """Nominal robot."""
    gains: tuple[float, float]
    """Gains K_P on the pose error and K_D on the velocity error of the platform [1/s², 1/s]; ≥ 0."""
    motor_frequency: float = 100.0
    """Natural angular frequency of the motor loop of a flexible robot [rad/s]; > 0."""
    motor_damping_ratio: float = 0.7
    """Damping ratio of the motor loop [-]; > 0."""

    def action(
        self,
        plan: PlannedMotion | PlannedMotions,
        state: State,
        payload: Array,
        period: float,
        minimum_tension: ArrayLike | None = None,
    ) -> Array:
        """Actions for the torques of :meth:`torques`, shape (..., m)."""
        torques, motor_speeds = self.torques(plan, state, payload, period, minimum_tension)
        return textbook.normalised_action(self.robot, torques, motor_speeds)

    def torques(
        self,
        plan: PlannedMotion | PlannedMotions,
        state: State,
        payload: Array,
        period: float,
        minimum_tension: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Requested torques [N·m] and present motor speeds [rad/s], each (..., m).

        Args:
            plan: planned motion, or one for each row, with motor angles if the robot is flexible.
            state: state at the control instant.
            payload: payload of the controller's model [kg], shape (...).
            period: control period, over which the torque is constant [s].
            minimum_tension: minimum tension of redundant cables of a rigid robot in this period, shape
                (...) [N]; None for that of the plan.
        """
        planned = plan(state.time)
        pose_error = planned.position - state.pose
        velocity_error = planned.velocity - state.velocity
        pose_gain, velocity_gain = self.gains
        # Additional acceleration of the platform [m/s², rad/s²].
        correction = pose_gain * pose_error + velocity_gain * velocity_error
        if self.robot.flexible:
            return self._motor_pd(plan, state, payload, period, correction)
        # After its end the plan has velocity 0. If rounding put the end of the last period there,
        # the mean acceleration would contain this stop, and the robot would brake.
        period_end = np.minimum(state.time + period, plan.duration)
        velocity_change = plan(period_end).velocity - planned.velocity
        # A period that starts at the end of the plan or later has no time left to divide by.
        duration = np.where(period_end > state.time, period_end - state.time, period)
        acceleration = velocity_change / duration[..., None] + correction
        if minimum_tension is None:
            minimum_tension = plan.minimum_tension
        return self._computed_torque(state, payload, period, acceleration, minimum_tension)

    def _computed_torque(
        self,
        state: State,
        payload: Array,
        period: float,
        acceleration: Array,
        minimum_tension: ArrayLike,
    ) -> tuple[Array, Array]:
        """Torques [N·m] and present motor speeds [rad/s] of a rigid robot, each (..., m): inverse
        dynamics at the middle of the period.

        Args:
            state: state at the control instant.
            payload: payload of the controller's model [kg], shape (...).
            period: control period [s].
            acceleration: platform acceleration Ẍ over the period, shape (..., n) [m/s², rad/s²].
            minimum_tension: minimum tension of all cables, shape (...) [N].
        """
        mass = self.robot.mass + payload
        half_period = period / 2
        middle_velocity = state.velocity + half_period * acceleration
        middle_pose = state.pose + half_period * (state.velocity + half_period / 2 * acceleration)
        required = inverse_dynamics(
            self.robot, mass, middle_pose, middle_velocity, acceleration, minimum=minimum_tension
        )
        present = inverse_dynamics(self.robot, mass, state.pose, state.velocity, acceleration)
        return required.torques, present.speeds

    def _motor_pd(
        self,
        plan: PlannedMotion | PlannedMotions,
        state: State,
        payload: Array,
        period: float,
        correction: Array,
    ) -> tuple[Array, Array]:
        """Torques [N·m] and measured motor speeds [rad/s] of a flexible robot, each (..., m):
        feedforward at the middle of the period, and PD control of the motor angles.

        Args:
            plan: planned motion with motor angles.
            state: state at the control instant, with motor angles and speeds.
            payload: payload of the controller's model [kg], shape (...).
            period: control period [s].
            correction: additional platform acceleration v, shape (..., n) [m/s², rad/s²].
        """
        assert state.motor_angle is not None
        assert state.motor_speed is not None
        model = self.robot
        inertia = model.pulley_inertia  # without joint springs the pulley turns with the motor
        if model.jointed:
            inertia = model.motor_inertia
        middle_time = state.time + period / 2
        planned_angle, planned_speed, _ = plan.motor_motion(state.time, payload)
        middle_angle, middle_speed, _ = plan.motor_motion(middle_time, payload)
        _, end_speed, _ = plan.motor_motion(state.time + period, payload)
        middle = plan(middle_time)
        plan_torque, _ = textbook.spring_drive(
            model,
            middle.position,
            middle.velocity,
            middle_angle,
            middle_speed,
            (end_speed - planned_speed) / period,
        )
        correction_torque = self._correction_torque(
            model, model.mass + payload, state.pose, correction
        )
        feedforward = plan_torque + correction_torque
        spring_stiffness = textbook.joint_stiffness(model, state.pose)
        desired_angle = planned_angle + correction_torque / spring_stiffness
        # With these gains the angle error δ obeys δ̈ + 2 ζ ω δ̇ + ω² δ = 0.
        angle_gain = inertia * self.motor_frequency**2
        speed_gain = 2 * self.motor_damping_ratio * inertia * self.motor_frequency
        angle_error = desired_angle - state.motor_angle
        speed_error = planned_speed - state.motor_speed
        feedback = angle_gain * angle_error + speed_gain * speed_error
        return feedforward + feedback, state.motor_speed

    @staticmethod
    def _correction_torque(robot: Robot, mass: Array, pose: Array, correction: Array) -> Array:
        """Change ∂κ/∂Ẍ v of the spring torques [N·m] for an additional platform acceleration v,
        shape (..., m). Of all suitable changes of the tensions, the one with
        the least norm is taken.

        Args:
            robot: flexible robot.
            mass: mass of platform and payload [kg], shape (...).
            pose: X, shape (..., n).
            correction: v, shape (..., n) [m/s², rad/s²].
        """
        structure = textbook.jacobian(robot, pose)
        wrench = textbook.mass_matrix(robot, mass, pose) @ correction[..., None]  # D(X) v
        # The cables pull along −Sᵀ: −Sᵀ T = D v, so T = −S (SᵀS)⁻¹ D v.
        square = structure.mT @ structure
        tensions = -(structure @ np.linalg.solve(square, wrench))[..., 0]
        cable_torque: Array = robot.pulley_radius * tensions
        if not robot.jointed:
            return cable_torque
        # The joint springs also accelerate the pulleys, by J β̈ with β̈ = −S v/r.
        cable_acceleration = textbook.times_vector(structure, correction)  # S v
        return cable_torque - robot.pulley_inertia * cable_acceleration / robot.pulley_radius
