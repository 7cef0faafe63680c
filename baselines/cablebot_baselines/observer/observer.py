"""Observer of a robot that is not exactly known: pose, velocity, mass, motors and delay.

It is an extended Kalman filter with the expected robot as its model. A law that uses its estimates
acts for the robot that it meets, at the instant at which its action takes effect.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.episodes import merged
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.filtering import Dynamics, correct, dynamics_of, predict
from cablebot_baselines.observer.observer_state import Columns, ObserverState, RobotEstimate
from cablebot_baselines.observer.sensors import (
    STEP,
    Period,
    PoseSensors,
    Readings,
    WinchSensors,
    varied,
)
from cablebot_baselines.observer.torques import LEAST_BALANCE_VARIANCE, Torques
from cablebot_gym.envs.observation import Blocks
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import POSE, Measurement
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import times_vector

MASS_DRIFT = 0.03
"""Growth of the relative standard deviation of the mass in one second [√(1/s)]. The mass is constant;
this covers the linearisation about a wrong one."""

STRENGTH_DRIFT = 0.02
"""Growth of the standard deviation of a motor's strength in one second [√(1/s)]. It takes up friction
and errors of the directions of the cables, which change along a motion."""

EXACT_STRENGTH_DRIFT = 0.002
"""The same where the strength is expected to be exact: the observer integrates the motion less exactly
than it happens."""

ACCELERATION_NOISE = 0.005
"""Root of the spectral density of the error of the model's acceleration [m/s² √s]; of angles, divided
by the platform's size."""

OFFSET_DRIFT = 0.1
"""Growth of the standard deviation of a spring's zero angle in one second, in units of its initial
one."""

START = 0.5
"""Payload with which the filter starts if it is unknown, as a fraction of the largest possible one. A
platform that is heavier than expected sags and turns. A point mass does not turn, and one on springs
that is lighter than the rotors hardly sags: they start unloaded. A mass below the expected one rises,
and the law that stops it slackens redundant cables."""

_AHEAD_STEPS = 4
"""Number of steps in which the motion of a flexible robot is predicted until an action takes
effect."""

_LEAST_DELAY = 1e-12


class RobotObserver:
    """Extended Kalman filter of a robot that is not exactly known.

    The torque of a motor is its strength times that of the expected motor, for the action of a
    delay ago: in a control period h with the delay τ, actions of up to three periods count by the
    time in which they act. Until the first action arrives the motors hold the robot, whatever its
    mass.

    A flexible robot's platform is moved by its springs, whose torque K (β′ − β − zero) follows from
    measured motor angles. The change of the motor speeds compares this torque with that of the
    motors. The zeros take up errors of anchors and stiffness where the pose is measured.

    Where winches are measured in place of the pose, errors of stiffness and anchors and the biases
    of load cells and orientation are part of the state. The robot rests at the start pose, up to the
    expected error. The first readings then correlate the errors of the pose with those of the zeros:
    the angle at rest is ``β(X) + κ(X)/K`` plus the zero, and the tension is ``κ(X)/r`` plus the bias.
    Later readings separate them.

    Args:
        expectation: expected robot and what differs from it.
        period: control period [s].
        largest_payload: largest payload that is considered possible if the payload is unknown, one
            or one for each of N episodes [kg].
        measurement: the sensors.
        start_pose: start poses of the tasks, (N, n) or (1, n), if winches are measured.
    """

    def __init__(
        self,
        expectation: Expectation,
        period: float,
        *,
        largest_payload: ArrayLike,
        measurement: Measurement = POSE,
        start_pose: Array | None = None,
    ) -> None:
        self.expectation = expectation
        self.robot = textbook.joint_equivalent(expectation.robot)
        self.period = period
        self.largest_payload = np.asarray(largest_payload, float)
        self.columns = Columns(self.robot, expectation, measurement)
        self._effect_times = expectation.effect_times(period)
        self._wrench_decay = float(np.exp(-period / expectation.wrench_time))
        robot = self.robot
        is_position = np.arange(robot.coordinates) < robot.dimensions
        anchor_distances = np.linalg.norm(robot.platform, axis=-1)
        platform_size = float(np.mean(anchor_distances)) or 1.0
        unit = np.where(is_position, 1.0, 1.0 / platform_size)
        self._acceleration_noise = ACCELERATION_NOISE * unit
        self._pose = PoseSensors(expectation, self.columns)
        self._winches = None
        if start_pose is not None:
            self._winches = WinchSensors(expectation, self.columns, measurement, start_pose, period)
        self._torques = Torques(expectation, self.columns, period, self._winches)
        self._least_growth = self._growth_without_mass()
        starts_unloaded = self.robot.point_mass or expectation.light_on_springs
        self._start = 0.0 if starts_unloaded else START
        self._least_mass = self.robot.mass - 3 * expectation.mass_spread

    def estimate(self, state: ObserverState) -> RobotEstimate:
        """The estimates in a state of the filter."""
        columns = self.columns
        mean = state.mean
        return RobotEstimate(
            mass=mean[:, columns.mass],
            strength=mean[:, columns.strength],
            delay=mean[:, columns.delay],
            wrench=mean[:, columns.wrench],
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
        if not starts.any():
            return self._following(blocks, state)
        initial = self._initial(blocks)
        following = self._following(blocks, merged(starts, initial, state))
        return merged(starts, initial, following)

    # Start

    def _initial(self, blocks: Blocks) -> ObserverState:
        """The state at the first observation: a robot at rest on its springs."""
        columns = self.columns
        robot = self.robot
        mean, variance = self._prior(blocks)
        covariance = variance[:, :, None] * np.eye(columns.total)
        pose = mean[:, columns.pose].copy()
        count = len(pose)
        # the torque is affine in the mass
        masses = np.full(count, robot.mass)
        light = textbook.static_torque(robot, masses, pose)
        heavy = textbook.static_torque(robot, 2 * masses, pose)
        per_mass = (heavy - light) / robot.mass
        without_mass = light - per_mass * robot.mass
        holding = np.stack([per_mass, without_mass], axis=-1)
        mass = mean[:, columns.mass, None].copy()
        at_rest = np.zeros((count, robot.cables))
        angle = blocks.get("motor_angle", at_rest)
        if self._winches is not None:
            self._winches.correct_at_rest(blocks, mean, covariance)
        elif robot.flexible:
            self._correct_at_rest(mean, covariance, holding, angle)
        return ObserverState(
            mean=mean,
            covariance=covariance,
            steps=np.zeros(count),
            holding=holding,
            motor_angle=angle,
            motor_speed=blocks.get("motor_speed", at_rest),
            tensions=(per_mass * mass + without_mass) / robot.pulley_radius,
            dynamics=self._dynamics(mean),
        )

    def _prior(self, blocks: Blocks) -> tuple[Array, Array]:
        """Mean and variances of the state before the springs are read, each (N, size)."""
        columns = self.columns
        robot = self.robot
        expected = self.expectation
        is_known = blocks["payload_known"][:, 0] > 0.5
        model_payload = blocks["model_payload"][:, 0]
        largest = np.broadcast_to(self.largest_payload, is_known.shape)
        start = self._start
        payload = np.where(is_known, model_payload, start * largest)
        known_spread = expected.payload_spread * payload
        unknown_spread = math.sqrt(((1 - start) ** 3 + start**3) / 3) * largest
        payload_spread = np.where(is_known, known_spread, unknown_spread)
        count = len(payload)
        mean = np.zeros((count, columns.total))
        mean[:, columns.mass] = robot.mass + payload
        mean[:, columns.strength] = 1.0
        mean[:, columns.delay] = np.mean(self._effect_times)
        variance = np.zeros_like(mean)
        variance[:, columns.mass] = payload_spread**2 + expected.mass_spread**2
        variance[:, columns.strength] = expected.strength_spread**2
        variance[:, columns.delay] = np.ptp(self._effect_times) ** 2 / 12
        mean[:, columns.wrench] = expected.wrench_mean
        variance[:, columns.wrench] = expected.wrench_spread**2
        if self._winches is None:
            self._pose.start(blocks, mean, variance)
        else:
            self._winches.start(blocks, mean, variance)
        return mean, variance

    def _correct_at_rest(
        self, mean: Array, covariance: Array, holding: Array, angle: Array
    ) -> None:
        """Changes mean and covariance of a flexible robot to those with the motor angles at which
        its springs hold it at the start."""
        columns = self.columns
        robot = self.robot
        expected = self.expectation
        stiffness = robot.stiffness
        pose = mean[:, columns.pose]
        mass = mean[:, columns.mass, None]
        torque = stiffness * (angle - textbook.pulley_angle(robot, pose))
        innovation = torque - holding[..., 0] * mass - holding[..., 1]
        stiffness_error = expected.stiffness_spread * torque / stiffness
        anchor_error = expected.anchor_spread / robot.pulley_radius
        zeros = np.arange(columns.total)[columns.zero]
        covariance[:, zeros, zeros] = stiffness_error**2 + anchor_error**2
        winding = (stiffness / robot.pulley_radius)[:, None]
        count = len(mean)
        gradient = np.zeros((count, robot.cables, columns.total))
        gradient[..., columns.pose] = -(winding * textbook.jacobian(robot, pose))
        gradient[..., columns.zero] = np.diag(stiffness)
        gradient[..., columns.mass] = holding[..., 0]
        noise = (stiffness * expected.noise.motor_angle) ** 2 + LEAST_BALANCE_VARIANCE
        variance = np.repeat(noise[None], count, axis=0)
        correct(innovation, gradient, variance, mean, covariance)

    # One control period

    def _following(self, blocks: Blocks, state: ObserverState) -> ObserverState:
        """Prediction over one control period, and correction by the sensors."""
        columns = self.columns
        mean = state.mean.copy()
        covariance = state.covariance.copy()
        torque, torque_gradient = self._torques.on_pulleys(blocks, state)
        by_pose = np.zeros_like(state.dynamics.mobility)
        period = None
        if self._winches is not None:
            by_pose = self._acceleration_by_pose(state, torque)
            period = self._last_period(blocks, state, torque, torque_gradient, by_pose)
        predict(
            state.dynamics,
            torque,
            torque_gradient,
            by_pose,
            self._growth(mean),
            self._torques.jumps(blocks),
            columns.wrench.start,
            columns.mass,
            self.period,
            self._wrench_decay,
            mean,
            covariance,
        )
        mean[:, columns.wrench] += (1 - self._wrench_decay) * self.expectation.wrench_mean
        if period is None or self._winches is None:
            readings = [self._pose.read(blocks, mean)]
        else:
            readings = self._winches.read(blocks, mean, period, state.tensions)
        if self.robot.flexible:
            readings.append(self._torques.balance(blocks, state, torque, torque_gradient))
        Readings.joined(readings).correct(mean, covariance)
        delay = mean[:, columns.delay]
        mass = mean[:, columns.mass]
        mean[:, columns.delay] = np.clip(delay, *self._effect_times)
        mean[:, columns.mass] = np.maximum(mass, self._least_mass)
        return ObserverState(
            mean=mean,
            covariance=covariance,
            steps=state.steps + 1,
            holding=state.holding,
            motor_angle=blocks.get("motor_angle", state.motor_angle),
            motor_speed=blocks.get("motor_speed", state.motor_speed),
            tensions=state.tensions if period is None else period.tensions,
            dynamics=self._dynamics(mean),
        )

    def _middle(self, mean: Array) -> Array:
        """Pose half a period later than that of a mean, (N, n)."""
        middle: Array = (
            mean[:, self.columns.pose] + self.period / 2 * mean[:, self.columns.velocity]
        )
        return middle

    def _acceleration_by_pose(self, state: ObserverState, torque: Array) -> Array:
        """Derivative of the acceleration with respect to the pose at constant torques (N, m), (N, n,
        n)."""
        velocity = state.mean[:, self.columns.velocity]
        poses, masses = varied(self._middle(state.mean), state.mean[:, self.columns.mass])
        accelerations, _ = textbook.forward_dynamics(
            self.robot, masses[:-1], poses[:-1], velocity, torque, cable="bilateral"
        )
        slopes: Array = np.moveaxis(accelerations[1:] - accelerations[0], 0, -1) / STEP
        return slopes

    def _last_period(
        self,
        blocks: Blocks,
        state: ObserverState,
        torque: Array,
        torque_gradient: Array,
        by_pose: Array,
    ) -> Period:
        """Motion in the control period that began with a state."""
        robot = self.robot
        columns = self.columns
        dynamics = state.dynamics
        velocity = state.mean[:, columns.velocity]
        acceleration = dynamics.acceleration(torque, state.mean[:, columns.wrench])
        gradient = dynamics.torque_slope @ torque_gradient
        gradient[..., columns.pose] += by_pose
        gradient[..., columns.wrench] += dynamics.mobility
        force_per_mass = dynamics.bias_per_mass
        force_per_mass = force_per_mass + times_vector(dynamics.matrix_per_mass, acceleration)
        gradient[..., columns.mass] -= times_vector(dynamics.mobility, force_per_mass)
        pulley_acceleration = textbook.pulley_acceleration(
            robot, self._middle(state.mean), velocity, acceleration
        )
        drag = robot.pulley_inertia * pulley_acceleration + robot.damping * dynamics.pulley_speed
        rotor_error = self.expectation.inertia_spread * robot.pulley_inertia * pulley_acceleration
        torque_error = np.hypot(rotor_error, self._torques.errors(blocks))
        if not robot.flexible:
            torque_error = np.hypot(torque_error, self._torques.friction_error())
        return Period(
            torque_error=torque_error,
            torque_gradient=torque_gradient,
            acceleration=acceleration,
            gradient=gradient,
            tensions=(torque - drag) / robot.pulley_radius,
        )

    def _growth(self, mean: Array) -> Array:
        """Variances that one control period adds, (N, size)."""
        count = len(mean)
        mass_drift = MASS_DRIFT * mean[:, self.columns.mass]
        variance = np.repeat(self._least_growth[None], count, axis=0)
        variance[:, self.columns.mass] = mass_drift**2 * self.period
        return variance

    def _growth_without_mass(self) -> Array:
        """Variances that one control period adds, (size,), but for that of the mass."""
        columns = self.columns
        period = self.period
        expected = self.expectation
        acceleration_density = self._acceleration_noise**2
        forgotten = 1 - self._wrench_decay**2
        variance = np.zeros(columns.total)
        variance[columns.velocity] = acceleration_density * period
        variance[columns.pose] = acceleration_density * period**3 / 3
        variance[columns.wrench] = forgotten * expected.wrench_spread**2
        strength_drift = STRENGTH_DRIFT
        if not expected.strength_spread:
            strength_drift = EXACT_STRENGTH_DRIFT
        variance[columns.strength] = strength_drift**2 * period
        if self._winches is None and self.robot.flexible:
            drift = OFFSET_DRIFT * expected.anchor_spread / self.robot.pulley_radius
            variance[columns.zero] = drift**2 * period
        return variance

    def _dynamics(self, mean: Array) -> Dynamics:
        """Motion with the estimates of a mean, (N, size)."""
        columns = self.columns
        middle = self._middle(mean)
        return dynamics_of(self.robot, mean[:, columns.mass], middle, mean[:, columns.velocity])

    # Prediction

    def at_effect(self, blocks: Blocks, state: ObserverState) -> Blocks:
        """Pose, velocity, acceleration ``disturbance`` by the wrench and, of a flexible robot, motor
        angle without zero error and motor speed at the instant at which the next action takes
        effect, by block name."""
        delay = state.mean[:, self.columns.delay]
        positive_delay = np.maximum(delay, _LEAST_DELAY)
        latest = np.minimum(1.0, self.period / positive_delay)
        weights = np.stack([latest, 1 - latest], axis=1)
        if self.robot.flexible:
            ahead = self._flexible_at_effect(blocks, state, weights)
        else:
            ahead = self._rigid_at_effect(blocks, state, weights)
        wrench = state.mean[:, self.columns.wrench]
        ahead["disturbance"] = times_vector(state.dynamics.mobility, wrench)
        return ahead

    def _rigid_at_effect(self, blocks: Blocks, state: ObserverState, weights: Array) -> Blocks:
        """Pose and velocity of a rigid robot when the next action takes effect."""
        columns = self.columns
        mean = state.mean
        delay = mean[:, columns.delay, None]
        velocity = mean[:, columns.velocity]
        dynamics = state.dynamics
        speed = dynamics.pulley_speed
        rates = np.zeros_like(weights)
        drives = self._torques.drives(blocks, weights, rates, state.steps, state, speed)
        torque = drives.torque - textbook.coulomb_torque(self.robot, speed)
        torque = torque / (1 + textbook.load_friction(self.robot, speed))
        acceleration = dynamics.acceleration(torque, mean[:, columns.wrench])
        displacement = delay * velocity
        return {
            "pose": mean[:, columns.pose] + displacement + delay**2 / 2 * acceleration,
            "velocity": velocity + delay * acceleration,
        }

    def _flexible_at_effect(self, blocks: Blocks, state: ObserverState, weights: Array) -> Blocks:
        """Pose, velocity, motor angle and motor speed of a flexible robot when the next action
        takes effect."""
        robot = self.robot
        dynamics = state.dynamics
        columns = self.columns
        mean = state.mean
        pose = mean[:, columns.pose]
        velocity = mean[:, columns.velocity]
        wrench = mean[:, columns.wrench]
        angle = blocks["motor_angle"] - mean[:, columns.zero]
        speed = blocks["motor_speed"]
        rates = np.zeros_like(weights)
        twist = angle - textbook.pulley_angle(robot, pose)
        stiffness = textbook.joint_stiffness(robot, pose)
        step = mean[:, columns.delay, None] / _AHEAD_STEPS
        for _ in range(_AHEAD_STEPS):
            drives = self._torques.drives(blocks, weights, rates, state.steps, state, speed)
            spring = stiffness * twist
            net_torque = drives.torque - spring - textbook.motor_friction(robot, speed, spring)
            speed = speed + step * net_torque / robot.motor_inertia
            velocity = velocity + step * dynamics.acceleration(spring, wrench)
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
