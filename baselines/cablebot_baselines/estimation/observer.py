"""Observer of a robot that is not exactly known: pose, velocity, mass, motors and delay.

It is an extended Kalman filter with the expected robot as its model. A law that uses its estimates
acts for the robot that it meets, at the instant at which its action takes effect.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.episodes import merged
from cablebot_baselines.estimation.expectation import Expectation
from cablebot_baselines.estimation.filtering import (
    Drives,
    Dynamics,
    correct,
    delayed_weights,
    dynamics_of,
    predict,
    weigh,
)
from cablebot_baselines.estimation.observer_state import ObserverState, RobotEstimate
from cablebot_gym.envs.observation import Blocks
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import times_vector

MASS_DRIFT = 0.03
"""Growth of the relative standard deviation of the mass in one second [√(1/s)]. The mass is constant;
this covers the linearisation about a wrong one."""

STRENGTH_DRIFT = 0.02
"""Growth of the standard deviation of a motor's strength in one second [√(1/s)]. It takes up friction
and errors of the directions of the cables, which change along a motion."""

ACCELERATION_NOISE = 0.005
"""Root of the spectral density of the error of the model's acceleration [m/s² √s]; of angles, divided
by the platform's size."""

OFFSET_DRIFT = 0.1
"""Growth of the standard deviation of a spring's zero angle in one second, in units of its initial
one."""

FRICTION_TIME = 0.1
"""Correlation time of the error of a motor's friction [s]."""

LAG_ERROR = 0.3
"""Error of the mean torque in a control period, as a fraction of the change of the torque: the model
has a delay in place of the motors' lag."""

_AHEAD_STEPS = 4
"""Number of steps in which the motion of a flexible robot is predicted until an action takes
effect."""

_EPS = 1e-12


class RobotObserver:
    """Extended Kalman filter of a robot that is not exactly known.

    The torque of a motor is its strength times that of the expected motor, for the action of a
    delay ago: in a control period h with the delay τ, actions of up to three periods count by the
    time in which they act. Until the first action arrives the motors hold the robot, whatever its
    mass.

    A flexible robot's platform is moved by its springs, whose torque K (β′ − β − zero) follows from
    measured motor angles. The zeros take up errors of anchors and stiffness. The change of the
    motor speeds compares this torque with that of the motors.

    Args:
        expectation: expected robot and what differs from it.
        period: control period [s].
        largest_payload: largest payload that is considered possible if the payload is unknown, one
            or one for each of N episodes [kg].
    """

    def __init__(
        self, expectation: Expectation, period: float, *, largest_payload: ArrayLike
    ) -> None:
        self.expectation = expectation
        self.robot = textbook.joint_equivalent(expectation.robot)
        self.period = period
        self.largest_payload = np.asarray(largest_payload, float)
        self._effect_times = expectation.effect_times(period)
        decay = np.exp(-period / expectation.wrench_time)
        self._wrench_decay = float(decay)
        self._set_columns()
        robot = self.robot
        is_position = np.arange(robot.coordinates) < robot.dimensions
        anchor_distances = np.linalg.norm(robot.platform, axis=-1)
        platform_size = float(np.mean(anchor_distances)) or 1.0
        unit = np.where(is_position, 1.0, 1.0 / platform_size)
        self._acceleration_noise = ACCELERATION_NOISE * unit
        noise = expectation.noise
        pose_noise = np.where(is_position, noise.position, noise.rotation)
        velocity_noise = np.where(is_position, noise.velocity, noise.rotation_rate)
        reading_noise = np.concatenate([pose_noise, velocity_noise])
        self._reading_variance = reading_noise**2 + 1e-14  # exact sensors
        self._reading_gradient = np.eye(self._mass, self._size)
        self._motors = np.stack([robot.stall_torque, robot.speed_slope])
        self._least_growth = self._growth_without_mass()

    def _set_columns(self) -> None:
        """Lays out the mean of :class:`ObserverState`."""
        n = self.robot.coordinates
        m = self.robot.cables
        springs = m * self.robot.flexible
        self._pose = slice(0, n)
        self._velocity = slice(n, 2 * n)
        self._mass = 2 * n
        self._strength = slice(self._mass + 1, self._mass + 1 + m)
        self._delay = self._strength.stop
        self._wrench = slice(self._delay + 1, self._delay + 1 + n)
        self._zero = slice(self._wrench.stop, self._wrench.stop + springs)
        self._size = self._zero.stop

    def estimate(self, state: ObserverState) -> RobotEstimate:
        """The estimates in a state of the filter."""
        mean = state.mean
        zero = state.motor_angle
        if self.robot.flexible:
            zero = mean[:, self._zero]
        return RobotEstimate(
            pose=mean[:, self._pose],
            velocity=mean[:, self._velocity],
            mass=mean[:, self._mass],
            strength=mean[:, self._strength],
            delay=mean[:, self._delay],
            wrench=mean[:, self._wrench],
            zero=zero,
        )

    def update(
        self, blocks: Blocks, state: ObserverState | None, starts: NDArray[np.bool_]
    ) -> ObserverState:
        """The state after an observation.

        Args:
            blocks: blocks of the observation, each (N, size).
            state: the last state; None before the first observation.
            starts: whether an episode starts, (N,).
        """
        if state is None or starts.all():
            return self._initial(blocks)
        following = self._following(blocks, state)
        if not starts.any():
            return following
        initial = self._initial(blocks)
        return merged(starts, initial, following)

    # Start

    def _initial(self, blocks: Blocks) -> ObserverState:
        """The state at the first observation: a robot at rest on its springs."""
        robot = self.robot
        pose = blocks["pose"]
        count = len(pose)
        mean, variance = self._prior(blocks)
        covariance = variance[:, :, None] * np.eye(self._size)
        # the torque is affine in the mass
        light = self._holding_torque(robot.mass, pose)
        heavy = self._holding_torque(2 * robot.mass, pose)
        per_mass = (heavy - light) / robot.mass
        without_mass = light - per_mass * robot.mass
        holding = np.stack([per_mass, without_mass], axis=-1)
        angle = np.zeros((count, robot.cables))
        speed = angle
        if robot.flexible:
            angle = blocks["motor_angle"]
            speed = blocks["motor_speed"]
            self._correct_at_rest(mean, covariance, holding, angle)
        return ObserverState(
            mean=mean,
            covariance=covariance,
            steps=np.zeros(count),
            holding=holding,
            motor_angle=angle,
            motor_speed=speed,
            dynamics=self._dynamics(mean),
        )

    def _prior(self, blocks: Blocks) -> tuple[Array, Array]:
        """Mean and variances of the state before the springs are read, each (N, size)."""
        robot = self.robot
        expected = self.expectation
        is_known = blocks["payload_known"][:, 0] > 0.5
        model_payload = blocks["model_payload"][:, 0]
        largest = np.broadcast_to(self.largest_payload, is_known.shape)
        payload = np.where(is_known, model_payload, largest / 2)
        known_spread = expected.payload_spread * payload
        unknown_spread = largest / np.sqrt(12)
        payload_spread = np.where(is_known, known_spread, unknown_spread)
        count = len(payload)
        mean = np.zeros((count, self._size))
        mean[:, self._pose] = blocks["pose"]
        mean[:, self._velocity] = blocks["velocity"]
        mean[:, self._mass] = robot.mass + payload
        mean[:, self._strength] = 1.0
        mean[:, self._delay] = np.mean(self._effect_times)
        variance = np.zeros_like(mean)
        variance[:, : self._mass] = self._reading_variance
        variance[:, self._mass] = payload_spread**2 + expected.mass_spread**2
        variance[:, self._strength] = expected.strength_spread**2
        variance[:, self._delay] = np.ptp(self._effect_times) ** 2 / 12
        variance[:, self._wrench] = expected.wrench_spread**2
        return mean, variance

    def _correct_at_rest(
        self, mean: Array, covariance: Array, holding: Array, angle: Array
    ) -> None:
        """Changes mean and covariance of a flexible robot to those with the motor angles at which
        its springs hold it at the start."""
        robot = self.robot
        expected = self.expectation
        stiffness = robot.stiffness
        pose = mean[:, self._pose]
        mass = mean[:, self._mass, None]
        torque = stiffness * (angle - textbook.pulley_angle(robot, pose))
        innovation = torque - holding[..., 0] * mass - holding[..., 1]
        stiffness_error = expected.stiffness_spread * torque / stiffness
        anchor_error = expected.anchor_spread / robot.pulley_radius
        zeros = np.arange(self._size)[self._zero]
        covariance[:, zeros, zeros] = stiffness_error**2 + anchor_error**2
        winding = (stiffness / robot.pulley_radius)[:, None]
        count = len(mean)
        gradient = np.zeros((count, robot.cables, self._size))
        gradient[..., self._pose] = -(winding * textbook.jacobian(robot, pose))
        gradient[..., self._zero] = np.diag(stiffness)
        gradient[..., self._mass] = holding[..., 0]
        noise = (stiffness * expected.noise.motor_angle) ** 2 + _EPS
        variance = np.repeat(noise[None], count, axis=0)
        correct(innovation, gradient, variance, mean, covariance)

    def _holding_torque(self, mass: float, pose: Array) -> Array:
        return textbook.static_torque(self.robot, np.full(len(pose), mass), pose)

    # One control period

    def _following(self, blocks: Blocks, state: ObserverState) -> ObserverState:
        """Prediction over one control period, and correction by the sensors."""
        mean = state.mean.copy()
        covariance = state.covariance.copy()
        count = len(mean)
        torque_errors = self._torque_errors(blocks)
        jumps = torque_errors
        if self.robot.flexible:
            torque, torque_gradient = self._spring_torques(blocks, state)
            jumps = np.zeros_like(torque_errors)
        else:
            torque, torque_gradient = self._rigid_torques(blocks, state)
        predict(
            state.dynamics,
            torque,
            torque_gradient,
            self._growth(mean),
            jumps,
            self._wrench.start,
            self._mass,
            self.period,
            self._wrench_decay,
            mean,
            covariance,
        )
        readings = np.concatenate([blocks["pose"], blocks["velocity"]], axis=-1)
        innovation = readings - mean[:, : self._mass]
        gradient = np.repeat(self._reading_gradient[None], count, axis=0)
        variance = np.repeat(self._reading_variance[None], count, axis=0)
        if self.robot.flexible:
            # The balance concerns the period before: its gradient refers to the predicted state,
            # which hardly differs.
            excess, slopes = self._motor_balance(blocks, state, torque, torque_gradient)
            noise = self._balance_variance(torque_errors)
            innovation = np.concatenate([innovation, excess], axis=-1)
            gradient = np.concatenate([gradient, slopes], axis=-2)
            variance = np.concatenate([variance, noise], axis=-1)
        correct(innovation, gradient, variance, mean, covariance)
        delay = mean[:, self._delay]
        mass = mean[:, self._mass]
        mean[:, self._delay] = np.clip(delay, *self._effect_times)
        mean[:, self._mass] = np.maximum(mass, self.robot.mass / 2)
        return ObserverState(
            mean=mean,
            covariance=covariance,
            steps=state.steps + 1,
            holding=state.holding,
            motor_angle=blocks.get("motor_angle", state.motor_angle),
            motor_speed=blocks.get("motor_speed", state.motor_speed),
            dynamics=self._dynamics(mean),
        )

    def _growth(self, mean: Array) -> Array:
        """Variances that one control period adds, (N, size)."""
        count = len(mean)
        mass_drift = MASS_DRIFT * mean[:, self._mass]
        variance = np.repeat(self._least_growth[None], count, axis=0)
        variance[:, self._mass] = mass_drift**2 * self.period
        return variance

    def _growth_without_mass(self) -> Array:
        """Variances that one control period adds, (size,), but for that of the mass."""
        period = self.period
        expected = self.expectation
        acceleration_density = self._acceleration_noise**2
        forgotten = 1 - self._wrench_decay**2
        variance = np.zeros(self._size)
        variance[self._velocity] = acceleration_density * period
        variance[self._pose] = acceleration_density * period**3 / 3
        variance[self._wrench] = forgotten * expected.wrench_spread**2
        variance[self._strength] = STRENGTH_DRIFT**2 * period
        if self.robot.flexible:
            drift = OFFSET_DRIFT * expected.anchor_spread / self.robot.pulley_radius
            variance[self._zero] = drift**2 * period
        return variance

    def _rigid_torques(self, blocks: Blocks, state: ObserverState) -> tuple[Array, Array]:
        """Mean torques on the pulleys of a rigid robot, (N, m), and their derivatives with respect
        to the state, (N, m, size)."""
        robot = self.robot
        dynamics = state.dynamics
        strength = state.mean[:, self._strength]
        speed = dynamics.pulley_speed
        drives = self._last_drives(blocks, state, speed)
        torque = drives.torque - textbook.coulomb_torque(robot, speed)
        torque = torque / (1 + textbook.load_friction(robot, speed))
        gradient = np.zeros((*speed.shape, self._size))
        speed_slope = strength * robot.speed_slope + robot.damping
        rate_slope = speed_slope / robot.pulley_radius
        gradient[..., self._velocity] = rate_slope[..., None] * dynamics.structure
        self._set_drive_gradient(gradient, drives)
        return torque, gradient

    def _set_drive_gradient(self, gradient: Array, drives: Drives) -> None:
        """Writes the derivatives of the motor torques, (N, m, size), but for those by the speed."""
        strength_slope = drives.per_strength[..., None]
        gradient[..., self._mass] = drives.per_mass
        gradient[..., self._strength] = strength_slope * np.eye(self.robot.cables)
        gradient[..., self._delay] = drives.per_delay

    def _spring_torques(self, blocks: Blocks, state: ObserverState) -> tuple[Array, Array]:
        """Mean torques of the springs of a flexible robot, (N, m), and their derivatives, (N, m,
        size)."""
        robot = self.robot
        period = self.period
        now = self.estimate(state)
        angle_sum = blocks["motor_angle"] + state.motor_angle
        speed_change = blocks["motor_speed"] - state.motor_speed
        mean_angle = angle_sum / 2 - period / 12 * speed_change
        middle = now.pose + period / 2 * now.velocity
        stiffness = textbook.joint_stiffness(robot, middle)
        twist = mean_angle - now.zero - textbook.pulley_angle(robot, middle)
        gradient = np.zeros((*twist.shape, self._size))
        # β = (l₀ − l)/r, so a displacement winds the spring by S/r.
        winding = (stiffness / robot.pulley_radius)[..., None]
        gradient[..., self._pose] = winding * state.dynamics.structure
        zero_slope = -np.eye(robot.cables)
        gradient[..., self._zero] = zero_slope * stiffness[..., None, :]
        return stiffness * twist, gradient

    def _motor_balance(
        self, blocks: Blocks, state: ObserverState, spring: Array, spring_gradient: Array
    ) -> tuple[Array, Array]:
        """Excess in the torque balance of the motors of a flexible robot, (N, m), and its
        derivatives, (N, m, size), with the torques of the springs and their derivatives."""
        robot = self.robot
        speed = blocks["motor_speed"]
        mean_speed = (speed + state.motor_speed) / 2
        drives = self._last_drives(blocks, state, mean_speed)
        friction = textbook.motor_friction(robot, mean_speed, spring)
        speed_change = speed - state.motor_speed
        rotor_torque = robot.motor_inertia * speed_change / self.period
        excess = rotor_torque - (drives.torque - spring - friction)
        gradient = -spring_gradient
        self._set_drive_gradient(gradient, drives)
        return excess, gradient

    def _balance_variance(self, errors: Array) -> Array:
        """Variance of the torque balance of the motors in one control period, with errors of their
        torques, each (N, m) [N²·m²]."""
        robot = self.robot
        noise = self.expectation.noise
        speed = robot.motor_inertia * noise.motor_speed * np.sqrt(2) / self.period
        angle = robot.stiffness * noise.motor_angle
        correlated_periods = robot.cables * FRICTION_TIME / self.period
        friction = self.expectation.friction_spread * robot.coulomb_friction
        friction = friction * np.sqrt(correlated_periods)
        variance: Array = speed**2 + angle**2 + friction**2 + errors**2 + _EPS
        return variance

    def _torque_errors(self, blocks: Blocks) -> Array:
        """Errors of the mean torques in one control period by changes of the actions, (N, m)."""
        robot = self.robot
        actions = blocks["last_actions"].reshape(len(blocks["pose"]), -1, robot.cables)
        changes = np.ptp(actions, axis=1)
        errors: Array = LAG_ERROR * robot.stall_torque * changes
        return errors

    def _dynamics(self, mean: Array) -> Dynamics:
        """Motion with the estimates of a mean, (N, size)."""
        mass = mean[:, self._mass]
        velocity = mean[:, self._velocity]
        middle = mean[:, self._pose] + self.period / 2 * velocity
        return dynamics_of(self.robot, mass, middle, velocity)

    # Actions

    def _last_drives(self, blocks: Blocks, state: ObserverState, speed: Array) -> Drives:
        """Mean torque of the motors in the last control period, at speeds (N, m) [rad/s]."""
        delay = np.ascontiguousarray(state.mean[:, self._delay])
        weights, rates = delayed_weights(delay, self.period)
        sent = state.steps + 1
        return self._drives(blocks, weights, rates, sent, state, speed)

    def _drives(
        self,
        blocks: Blocks,
        weights: Array,
        rates: Array,
        sent: Array,
        state: ObserverState,
        speed: Array,
    ) -> Drives:
        """Torque of the last actions, see :func:`~cablebot_baselines.estimation.filtering.weigh`."""
        actions = blocks["last_actions"].reshape(len(speed), -1, self.robot.cables)
        strength = state.mean[:, self._strength]
        mass = state.mean[:, self._mass]
        arguments = actions, weights, rates, sent, speed, strength, mass, state.holding
        drives = np.empty((4, *speed.shape))
        weigh(*map(np.ascontiguousarray, arguments), self._motors, drives)
        return Drives(*drives)

    # Prediction

    def at_effect(self, blocks: Blocks, state: ObserverState) -> Blocks:
        """Pose, velocity, acceleration ``disturbance`` by the wrench and, of a flexible robot, motor
        angle without zero error and motor speed at the instant at which the next action takes
        effect, by block name."""
        delay = state.mean[:, self._delay]
        positive_delay = np.maximum(delay, _EPS)
        latest = np.minimum(1.0, self.period / positive_delay)
        weights = np.stack([latest, 1 - latest], axis=1)
        if self.robot.flexible:
            ahead = self._flexible_at_effect(blocks, state, weights)
        else:
            ahead = self._rigid_at_effect(blocks, state, weights)
        wrench = state.mean[:, self._wrench]
        ahead["disturbance"] = times_vector(state.dynamics.mobility, wrench)
        return ahead

    def _rigid_at_effect(self, blocks: Blocks, state: ObserverState, weights: Array) -> Blocks:
        """Pose and velocity of a rigid robot when the next action takes effect."""
        now = self.estimate(state)
        delay = now.delay[:, None]
        dynamics = state.dynamics
        speed = dynamics.pulley_speed
        rates = np.zeros_like(weights)
        drives = self._drives(blocks, weights, rates, state.steps, state, speed)
        torque = drives.torque - textbook.coulomb_torque(self.robot, speed)
        torque = torque / (1 + textbook.load_friction(self.robot, speed))
        acceleration = dynamics.acceleration(torque, now.wrench)
        displacement = delay * now.velocity
        return {
            "pose": now.pose + displacement + delay**2 / 2 * acceleration,
            "velocity": now.velocity + delay * acceleration,
        }

    def _flexible_at_effect(self, blocks: Blocks, state: ObserverState, weights: Array) -> Blocks:
        """Pose, velocity, motor angle and motor speed of a flexible robot when the next action
        takes effect."""
        robot = self.robot
        dynamics = state.dynamics
        now = self.estimate(state)
        pose = now.pose
        velocity = now.velocity
        angle = blocks["motor_angle"] - now.zero
        speed = blocks["motor_speed"]
        rates = np.zeros_like(weights)
        twist = angle - textbook.pulley_angle(robot, pose)
        stiffness = textbook.joint_stiffness(robot, pose)
        step = now.delay[:, None] / _AHEAD_STEPS
        for _ in range(_AHEAD_STEPS):
            drives = self._drives(blocks, weights, rates, state.steps, state, speed)
            spring = stiffness * twist
            net_torque = drives.torque - spring - textbook.motor_friction(robot, speed, spring)
            speed = speed + step * net_torque / robot.motor_inertia
            velocity = velocity + step * dynamics.acceleration(spring, now.wrench)
            pose = pose + step * velocity
            angle = angle + step * speed
            winding = times_vector(dynamics.structure, velocity) / robot.pulley_radius
            twist = twist + step * (speed + winding)
        return {
            "pose": pose,
            "velocity": velocity,
            "motor_angle": angle,
            "motor_speed": speed,
        }
