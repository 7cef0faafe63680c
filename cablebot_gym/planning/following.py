"""Torques that follow a planned motion, held for a control period: the plan's own, and feedback on what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.planning.motion import PlannedMotion
from cablebot_gym.robots import Robot


@dataclass(frozen=True, kw_only=True)
class State:
    """What the torques depend on; each array is (..., size)."""

    time: Array
    """Of the control instant, since the motion's start (...) [s]."""
    pose: Array
    """X."""
    velocity: Array
    """Ẋ."""
    motor_angle: Array | None = None
    """β′ [rad], of a flexible robot."""
    motor_speed: Array | None = None
    """β̇′ [rad/s], of a flexible robot."""

    @classmethod
    def of(cls, part: Mapping[str, Array], time: Array) -> State:
        """From the blocks of an observation at a time [s]."""
        motor = {name: part[name] for name in ("motor_angle", "motor_speed") if name in part}
        return cls(time=time, pose=part["pose"], velocity=part["velocity"], **motor)


@dataclass(frozen=True, kw_only=True)
class Follower:
    """A rigid robot: computed torque. A flexible one: PD of the motors about the plan's motor angles.

    The torque is held for a period h. So the plan's Ẍ is its mean over the period, (Ẋ(t+h) − Ẋ(t))/h, and inverse
    dynamics are those of the period's middle; after the period the velocity is the plan's to the order of h³. On a
    flexible robot the same holds of β̈′. There the platform's error asks for v = K_P e + K_D ė, for which the springs
    need ∂κ/∂Ẍ v, and the motors' angles follow by that over K.

    Raises:
        ValueError: if a number is not positive.
    """

    robot: Robot
    """Nominal."""
    gains: tuple[float, float]
    """(K_P, K_D) on the platform's error [1/s², 1/s]; ≥ 0."""
    motor_frequency: float = 100.0
    """Of the motor loop of a flexible robot [rad/s]."""
    motor_damping: float = 0.7
    """Damping ratio of the motor loop."""

    def __post_init__(self) -> None:
        if not all(0 <= gain < math.inf for gain in self.gains):
            raise ValueError(f"gains must be at least 0, not {self.gains}")
        if not (0 < self.motor_frequency < math.inf and 0 < self.motor_damping < math.inf):
            raise ValueError("motor_frequency and motor_damping must be greater than 0")

    def command(self, plan: PlannedMotion, state: State, payload: Array, period: float) -> Array:
        """Drive commands for :meth:`torques` along a plan, (..., m), held for a control period [s]."""
        return textbook.drive_command(self.robot, *self.torques(plan, state, payload, period))

    def torques(self, plan: PlannedMotion, state: State, payload: Array, period: float) -> tuple[Array, Array]:
        """Torques to ask of the motors [N·m] and the motors' present speeds [rad/s], each (..., m).

        Args:
            plan: the motion, for a robot like this one.
            state: at the control instant.
            payload: believed [kg], (...).
            period: for which torques are held [s].
        """
        # Beyond its end a plan rests, at once: a last period that reaches over it by rounding must not brake.
        end = np.minimum(state.time + period, plan.duration)
        asked, after = plan(state.time), plan(end)
        error, rate = asked.position - state.pose, asked.velocity - state.velocity
        correction = self.gains[0] * error + self.gains[1] * rate
        if self.robot.flexible:
            return self._motors(plan, state, payload, period, correction)
        span = np.where(end > state.time, end - state.time, period)[..., None]
        acceleration = (after.velocity - asked.velocity) / span + correction
        return self._computed(state, payload, period, acceleration, plan.minimum_tension)

    def _computed(
        self, state: State, payload: Array, period: float, acceleration: Array, minimum: float
    ) -> tuple[Array, Array]:
        robot, half = self.robot, period / 2
        mass, velocity = robot.mass + payload, state.velocity + half * acceleration
        pose = state.pose + half * (state.velocity + half / 2 * acceleration)
        needed = inverse_dynamics(robot, mass, pose, velocity, acceleration, minimum=minimum)
        speeds = inverse_dynamics(robot, mass, state.pose, state.velocity, acceleration).speeds
        return needed.torques, speeds

    def _motors(
        self, plan: PlannedMotion, state: State, payload: Array, period: float, correction: Array
    ) -> tuple[Array, Array]:
        robot, time = self.robot, state.time
        assert state.motor_angle is not None
        assert state.motor_speed is not None
        angle, speed, _ = plan.motor_motion(time, payload)
        middle, middle_speed, _ = plan.motor_motion(time + period / 2, payload)
        _, speed_after, _ = plan.motor_motion(time + period, payload)
        spring = robot.stiffness * (middle - textbook.pulley_angle(robot, plan(time + period / 2).position))
        more = self._spring_change(robot.mass + payload, state.pose, correction)
        spring, angle = spring + more, angle + more / robot.stiffness
        held = robot.motor_inertia * (speed_after - speed) / period + spring + robot.motor_damping * middle_speed
        stiffness = robot.motor_inertia * self.motor_frequency**2
        damping = 2 * self.motor_damping * robot.motor_inertia * self.motor_frequency
        feedback = stiffness * (angle - state.motor_angle) + damping * (speed - state.motor_speed)
        return held + feedback, state.motor_speed

    def _spring_change(self, mass: Array, pose: Array, acceleration: Array) -> Array:
        """∂κ/∂Ẍ times an acceleration [N·m], by the smallest change of tensions; (..., m)."""
        robot, structure = self.robot, textbook.jacobian(self.robot, pose)
        transposed = np.swapaxes(structure, -1, -2)
        wrench = textbook.mass_matrix(robot, mass, pose) @ acceleration[..., None]
        tensions = -(structure @ np.linalg.solve(transposed @ structure, wrench))[..., 0]
        winding = -(structure @ acceleration[..., None])[..., 0] / robot.pulley_radius
        change: Array = robot.pulley_radius * tensions + robot.pulley_inertia * winding
        return change
