"""Torques that follow a planned motion: feedforward from the plan plus feedback on the error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.planning.motion import PlannedMotion
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import number, numbers


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
    def of(cls, blocks: Mapping[str, Array], time: Array) -> State:
        """The state from the blocks of an observation at a time [s]."""
        motor = {name: blocks[name] for name in ("motor_angle", "motor_speed") if name in blocks}
        return cls(time=time, pose=blocks["pose"], velocity=blocks["velocity"], **motor)


@dataclass(frozen=True, kw_only=True)
class Follower:
    """Controller for a planned motion: computed torque if rigid, PD control of the planned motor
    angles if flexible.

    The torque is constant over a control period h. The controller therefore uses the mean
    acceleration of the plan over the period, (Ẋ(t+h) − Ẋ(t))/h, and the inverse dynamics at the
    middle of the period. After the period the velocity matches the plan up to O(h³). On a flexible
    robot the same applies to β̈′. There the correction v = K_P e + K_D ė of the platform error
    requires the additional spring torque ∂κ/∂Ẍ v, which shifts the motor angles by this torque over
    the stiffness of the springs, which are joint springs or elastic cables.

    Raises:
        ValueError: if a gain is negative, or another number is not positive.
    """

    robot: Robot
    """Nominal robot."""
    gains: tuple[float, float]
    """Gains (K_P, K_D) on the platform error [1/s², 1/s]; ≥ 0."""
    motor_frequency: float = 100.0
    """Frequency of the motor loop of a flexible robot [rad/s]; > 0."""
    motor_damping: float = 0.7
    """Damping ratio of the motor loop; > 0."""

    def __post_init__(self) -> None:
        numbers("gains", self.gains, shapes=[(2,)], least=0.0)
        number("motor_frequency", self.motor_frequency, above=0.0, unit="rad/s")
        number("motor_damping", self.motor_damping, above=0.0)

    def action(self, plan: PlannedMotion, state: State, payload: Array, period: float) -> Array:
        """Actions for the torques of :meth:`torques`, shape (..., m)."""
        return textbook.normalised_action(self.robot, *self.torques(plan, state, payload, period))

    def torques(
        self, plan: PlannedMotion, state: State, payload: Array, period: float
    ) -> tuple[Array, Array]:
        """Requested torques [N·m] and current motor speeds [rad/s], each (..., m).

        Args:
            plan: planned motion for this kind of robot.
            state: state at the control instant.
            payload: payload of the controller's model [kg], shape (...).
            period: control period, over which the torque is constant [s].
        """
        # The plan rests after its end. Without the minimum, a last period that ends late by
        # rounding would brake.
        end = np.minimum(state.time + period, plan.duration)
        now, after = plan(state.time), plan(end)
        error = now.position - state.pose
        rate = now.velocity - state.velocity
        correction = self.gains[0] * error + self.gains[1] * rate
        if self.robot.flexible:
            return self._motor_pd(plan, state, payload, period, correction)
        span = np.where(end > state.time, end - state.time, period)[..., None]
        acceleration = (after.velocity - now.velocity) / span + correction
        return self._computed_torque(state, payload, period, acceleration, plan.minimum_tension)

    def _computed_torque(
        self, state: State, payload: Array, period: float, acceleration: Array, minimum: float
    ) -> tuple[Array, Array]:
        robot, half = self.robot, period / 2
        mass = robot.mass + payload
        velocity = state.velocity + half * acceleration
        pose = state.pose + half * (state.velocity + half / 2 * acceleration)
        needed = inverse_dynamics(robot, mass, pose, velocity, acceleration, minimum=minimum)
        speeds = inverse_dynamics(robot, mass, state.pose, state.velocity, acceleration).speeds
        return needed.torques, speeds

    def _motor_pd(
        self, plan: PlannedMotion, state: State, payload: Array, period: float, correction: Array
    ) -> tuple[Array, Array]:
        model = textbook.cable_equivalent(self.robot)
        time = state.time
        inertia = model.motor_inertia if model.jointed else model.pulley_inertia
        assert state.motor_angle is not None
        assert state.motor_speed is not None
        angle, speed, _ = plan.motor_motion(time, payload)
        middle, middle_speed, _ = plan.motor_motion(time + period / 2, payload)
        _, speed_after, _ = plan.motor_motion(time + period, payload)
        half = plan(time + period / 2)
        change = self._spring_change(model, model.mass + payload, state.pose, correction)
        moved = half.position, half.velocity, middle, middle_speed, (speed_after - speed) / period
        feedforward = textbook.spring_drive(model, *moved)[0] + change
        angle = angle + change / textbook.joint_stiffness(model, state.pose)
        stiffness = inertia * self.motor_frequency**2
        damping = 2 * self.motor_damping * inertia * self.motor_frequency
        feedback = stiffness * (angle - state.motor_angle) + damping * (speed - state.motor_speed)
        return feedforward + feedback, state.motor_speed

    @staticmethod
    def _spring_change(robot: Robot, mass: Array, pose: Array, acceleration: Array) -> Array:
        """Spring torque ∂κ/∂Ẍ times an acceleration [N·m], with the smallest change of tensions;
        shape (..., m)."""
        structure = textbook.jacobian(robot, pose)
        transposed = np.swapaxes(structure, -1, -2)
        wrench = textbook.mass_matrix(robot, mass, pose) @ acceleration[..., None]
        tensions = -(structure @ np.linalg.solve(transposed @ structure, wrench))[..., 0]
        change: Array = robot.pulley_radius * tensions
        if not robot.jointed:
            return change
        return (
            change
            - robot.pulley_inertia
            * (structure @ acceleration[..., None])[..., 0]
            / robot.pulley_radius
        )
