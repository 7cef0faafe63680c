"""Torques of motors and springs in a control period, as the observer expects them."""

from __future__ import annotations

import numpy as np

from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.filtering import Drives, delayed_weights, weigh
from cablebot_baselines.observer.observer_state import Columns, ObserverState
from cablebot_baselines.observer.sensors import Readings, WinchSensors
from cablebot_gym.envs.observation import Blocks
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook

FRICTION_TIME = 0.1
"""Correlation time of the error of a motor's friction [s]."""

LAG_ERROR = 0.3
"""Error of the mean torque in a control period, as a fraction of the change of the torque: the model
has a delay in place of the motors' lag."""

LEAST_BALANCE_VARIANCE = 1e-12
"""Least variance of the torque balance of a motor [N²·m²], for exact sensors."""


class Torques:
    """Torques on the pulleys: those of the motors, or of the springs of a flexible robot.

    Args:
        expectation: expected robot and what differs from it.
        columns: columns of the state.
        period: control period [s].
        winches: the sensors of winches; None where the pose is measured.
    """

    def __init__(
        self,
        expectation: Expectation,
        columns: Columns,
        period: float,
        winches: WinchSensors | None,
    ) -> None:
        self._expectation = expectation
        self._robot = textbook.joint_equivalent(expectation.robot)
        self._columns = columns
        self._period = period
        self._winches = winches
        self._motors = np.stack([self._robot.stall_torque, self._robot.speed_slope])

    def on_pulleys(self, blocks: Blocks, state: ObserverState) -> tuple[Array, Array]:
        """Mean torques in the control period that began with a state, (N, m) [N·m], and their
        derivatives with respect to the state, (N, m, size)."""
        if self._robot.flexible:
            return self._of_springs(blocks, state)
        return self._of_motors(blocks, state)

    def jumps(self, blocks: Blocks) -> Array:
        """Standard deviations of the mean torques that move the platform at once, (N, m) [N·m]: by
        changes of the actions, or by the readings of the motor angles behind springs."""
        if not self._robot.flexible:
            return self.errors(blocks)
        if self._winches is None:
            return np.zeros_like(blocks["motor_angle"])
        jump = self._robot.stiffness * self._winches.angle_deviation / np.sqrt(2)
        return np.broadcast_to(jump, blocks["motor_angle"].shape)

    def _of_motors(self, blocks: Blocks, state: ObserverState) -> tuple[Array, Array]:
        """Mean torques on the pulleys of a rigid robot, (N, m), and their derivatives with respect
        to the state, (N, m, size)."""
        robot = self._robot
        columns = self._columns
        dynamics = state.dynamics
        speed = dynamics.pulley_speed
        drives = self._last(blocks, state, speed)
        torque = drives.torque - textbook.coulomb_torque(robot, speed)
        torque = torque / (1 + textbook.load_friction(robot, speed))
        gradient = np.zeros((*speed.shape, columns.total))
        speed_slope = state.mean[:, columns.strength] * robot.speed_slope + robot.damping
        rate_slope = speed_slope / robot.pulley_radius
        gradient[..., columns.velocity] = rate_slope[..., None] * dynamics.structure
        self._write_drives(gradient, drives)
        return torque, gradient

    def _write_drives(self, gradient: Array, drives: Drives) -> None:
        """Writes the derivatives of the motor torques, (N, m, size), but for those by the speed."""
        columns = self._columns
        strength_slope = drives.per_strength[..., None]
        gradient[..., columns.mass] = drives.per_mass
        gradient[..., columns.strength] = strength_slope * np.eye(self._robot.cables)
        gradient[..., columns.delay] = drives.per_delay

    def _of_springs(self, blocks: Blocks, state: ObserverState) -> tuple[Array, Array]:
        """Mean torques of the springs of a flexible robot, (N, m), and their derivatives, (N, m,
        size)."""
        robot = self._robot
        period = self._period
        columns = self._columns
        mean = state.mean
        angle_sum = blocks["motor_angle"] + state.motor_angle
        speed_change = blocks["motor_speed"] - state.motor_speed
        mean_angle = angle_sum / 2 - period / 12 * speed_change
        middle = mean[:, columns.pose] + period / 2 * mean[:, columns.velocity]
        stiffness = textbook.joint_stiffness(robot, middle)
        twist = mean_angle - mean[:, columns.zero] - textbook.pulley_angle(robot, middle)
        gradient = np.zeros((*twist.shape, columns.total))
        # β = (l₀ − l)/r, so a displacement winds the spring by S/r.
        winding = (stiffness / robot.pulley_radius)[..., None]
        gradient[..., columns.pose] = winding * state.dynamics.structure
        zero_slope = -np.eye(robot.cables)
        gradient[..., columns.zero] = zero_slope * stiffness[..., None, :]
        if self._winches is not None:
            anchor_error, by_anchors = self._winches.anchor_error(mean, middle)
            twist = twist - anchor_error
            gradient[..., columns.anchor] = -stiffness[..., None] * by_anchors
        torque = stiffness * twist
        if columns.compliance.stop > columns.compliance.start:
            torque = torque / (1 + mean[:, columns.compliance])
            gradient[..., columns.compliance] = -torque[..., None] * np.eye(robot.cables)
        return torque, gradient

    def balance(
        self, blocks: Blocks, state: ObserverState, spring: Array, spring_gradient: Array
    ) -> Readings:
        """Torque balance of the motors of a flexible robot, with the torques of the springs and their
        derivatives.

        It concerns the period before: its gradient refers to the predicted state, which hardly
        differs.
        """
        robot = self._robot
        speed = blocks["motor_speed"]
        speed_change = speed - state.motor_speed
        mean_speed = (speed + state.motor_speed) / 2
        drive_speed = mean_speed
        if self._winches is not None:
            # A drive holds its torque over a period, unless a limit that falls with the speed cuts
            # it.
            action = blocks["last_actions"][:, : robot.cables]
            is_cut = (np.abs(action) >= 1) & (action * speed_change > 0)
            drive_speed = np.where(is_cut, mean_speed, state.motor_speed)
        drives = self._last(blocks, state, drive_speed)
        friction = textbook.motor_friction(robot, mean_speed, spring)
        rotor_torque = robot.motor_inertia * speed_change / self._period
        excess = rotor_torque - (drives.torque - spring - friction)
        gradient = -spring_gradient
        self._write_drives(gradient, drives)
        return Readings(excess, gradient, self._balance_variance(blocks))

    def _balance_variance(self, blocks: Blocks) -> Array:
        """Variance of the torque balance of the motors in one control period, (N, m) [N²·m²]."""
        robot = self._robot
        noise = self._expectation.noise
        speed = robot.motor_inertia * noise.motor_speed * np.sqrt(2) / self._period
        angle = robot.stiffness * noise.motor_angle
        friction = self.friction_error()
        errors = self.errors(blocks)
        variance: Array = speed**2 + angle**2 + friction**2 + errors**2 + LEAST_BALANCE_VARIANCE
        if self._winches is not None:
            quantisation = self._winches.quantisation(blocks["motor_speed"])
            variance = variance + robot.stiffness**2 * quantisation
        return variance

    def friction_error(self) -> Array:
        """Standard deviation of independent errors of the motors' friction in each control period
        with the same mean over the correlation time, (m,) [N·m]."""
        correlated_periods = self._robot.cables * FRICTION_TIME / self._period
        friction = self._expectation.friction_spread * self._robot.coulomb_friction
        error: Array = friction * np.sqrt(correlated_periods)
        return error

    def errors(self, blocks: Blocks) -> Array:
        """Errors of the mean torques in one control period by changes of the actions, (N, m)."""
        robot = self._robot
        actions = blocks["last_actions"].reshape(len(blocks["last_actions"]), -1, robot.cables)
        changes = np.ptp(actions, axis=1)
        errors: Array = LAG_ERROR * robot.stall_torque * changes
        return errors * (self._expectation.lag[1] > 0)

    def _last(self, blocks: Blocks, state: ObserverState, speed: Array) -> Drives:
        """Mean torque of the motors in the last control period, at speeds (N, m) [rad/s]."""
        delay = np.ascontiguousarray(state.mean[:, self._columns.delay])
        weights, rates = delayed_weights(delay, self._period)
        sent = state.steps + 1
        return self.drives(blocks, weights, rates, sent, state, speed)

    def drives(
        self,
        blocks: Blocks,
        weights: Array,
        rates: Array,
        sent: Array,
        state: ObserverState,
        speed: Array,
    ) -> Drives:
        """Torque of the last actions, as ``filtering.weigh`` computes it."""
        actions = blocks["last_actions"].reshape(len(speed), -1, self._robot.cables)
        strength = state.mean[:, self._columns.strength]
        mass = state.mean[:, self._columns.mass]
        arguments = actions, weights, rates, sent, speed, strength, mass, state.holding
        drives = np.empty((4, *speed.shape))
        weigh(*map(np.ascontiguousarray, arguments), self._motors, drives)
        return Drives(*drives)
