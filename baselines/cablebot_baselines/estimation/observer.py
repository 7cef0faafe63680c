"""Observer of a robot that is not exactly known: pose, velocity, mass, motors and delay.

It is an extended Kalman filter with the expected robot as its model. A law that uses its estimates
acts for the robot that it meets, at the instant at which its action takes effect.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotEstimate:
    """What the observer knows of N robots."""

    pose: Array
    """Pose X, (N, n) [m, rad]."""
    velocity: Array
    """Velocity Ẋ, (N, n) [m/s, rad/s]."""
    mass: Array
    """Mass of platform and payload, (N,) [kg]."""
    strength: Array
    """Strength of each motor as a fraction of the expected one, (N, m)."""
    delay: Array
    """Time between the request of an action and its torque, (N,) [s]."""
    wrench: Array
    """Wrench on the platform, (N, n) [N, N·m]."""
    zero: Array
    """Zero error of the deflection of each spring, (N, m) [rad]; zero for a rigid robot."""

    def of(self, rows: NDArray[np.intp]) -> RobotEstimate:
        """The estimates of some of the robots."""
        return RobotEstimate(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverState:
    """State of the filter for N episodes."""

    mean: Array
    """Pose, velocity, mass, strengths, delay, wrench and, of a flexible robot, zeros of the springs,
    (N, size)."""
    covariance: Array
    """Covariance of ``mean``, (N, size, size)."""
    steps: Array
    """Control steps since the start, (N,)."""
    holding: Array
    """Torque per mass that holds the robot at the start, (N, m) [N·m/kg], and that without mass."""
    motor_angle: Array
    """Last motor angles of a flexible robot, (N, m) [rad]; zero for a rigid robot."""
    motor_speed: Array
    """Last motor speeds of a flexible robot, (N, m) [rad/s]; zero for a rigid robot."""
    dynamics: Dynamics
    """Motion with the estimates, at the pose half a control period later."""


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
        robot = self.robot
        n, m = robot.coordinates, robot.cables
        self._pose = slice(0, n)
        self._velocity = slice(n, 2 * n)
        self._mass = 2 * n
        self._strength = slice(2 * n + 1, 2 * n + 1 + m)
        self._delay = 2 * n + 1 + m
        self._wrench = slice(self._delay + 1, self._delay + 1 + n)
        self._zero = slice(self._wrench.stop, self._wrench.stop + (m if robot.flexible else 0))
        self._size = self._zero.stop
        size = float(np.mean(np.linalg.norm(robot.platform, axis=-1))) or 1.0
        is_position = np.arange(n) < robot.dimensions
        self._wrench_decay = float(np.exp(-period / expectation.wrench_time))
        self._acceleration_noise = ACCELERATION_NOISE * np.where(is_position, 1.0, 1.0 / size)
        noise = expectation.noise
        rotations = n - robot.dimensions
        self._reading_variance = (
            np.array(
                [noise.position] * robot.dimensions
                + [noise.rotation] * rotations
                + [noise.velocity] * robot.dimensions
                + [noise.rotation_rate] * rotations
            )
            ** 2
        )
        self._reading_variance += 1e-14  # exact sensors
        self._reading_gradient = np.eye(self._mass, self._size)
        self._motors = np.stack([robot.stall_torque, robot.speed_slope])
        self._least_growth = self._growth_without_mass()

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
        self, blocks: dict[str, Array], state: ObserverState | None, starts: NDArray[np.bool_]
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
        if starts.any():
            return _merged(starts, self._initial(blocks), following)
        return following

    # Start

    def _initial(self, blocks: dict[str, Array]) -> ObserverState:
        """The state at the first observation: a robot at rest on its springs."""
        robot, expected = self.robot, self.expectation
        pose = blocks["pose"]
        count = len(pose)
        is_known = blocks["payload_known"][:, 0] > 0.5
        largest = np.broadcast_to(self.largest_payload, is_known.shape)
        payload = np.where(is_known, blocks["model_payload"][:, 0], largest / 2)
        spread = np.where(is_known, expected.payload_spread * payload, largest / np.sqrt(12))
        mean = np.zeros((count, self._size))
        mean[:, self._pose] = pose
        mean[:, self._velocity] = blocks["velocity"]
        mean[:, self._mass] = robot.mass + payload
        mean[:, self._strength] = 1.0
        mean[:, self._delay] = np.mean(self._effect_times)
        variance = np.zeros((count, self._size))
        variance[:, : self._mass] = self._reading_variance
        variance[:, self._mass] = spread**2 + expected.mass_spread**2
        variance[:, self._strength] = expected.strength_spread**2
        variance[:, self._delay] = np.ptp(self._effect_times) ** 2 / 12
        variance[:, self._wrench] = expected.wrench_spread**2
        light, heavy = (self._holding_torque(mass, pose) for mass in (robot.mass, 2 * robot.mass))
        slope = (heavy - light) / robot.mass
        holding = np.stack([slope, light - slope * robot.mass], axis=-1)
        covariance = variance[:, :, None] * np.eye(self._size)
        angle = speed = np.zeros((count, robot.cables))
        if robot.flexible:
            angle, speed = blocks["motor_angle"], blocks["motor_speed"]
            mean, covariance = self._at_rest(mean, covariance, holding, angle)
        return ObserverState(
            mean=mean,
            covariance=covariance,
            steps=np.zeros(count),
            holding=holding,
            motor_angle=angle,
            motor_speed=speed,
            dynamics=self._dynamics(mean),
        )

    def _at_rest(
        self, mean: Array, covariance: Array, holding: Array, angle: Array
    ) -> tuple[Array, Array]:
        """Mean and covariance of a flexible robot whose springs hold it at the start."""
        robot, expected = self.robot, self.expectation
        pose = mean[:, self._pose]
        torque = robot.stiffness * (angle - textbook.pulley_angle(robot, pose))
        zero_variance = (expected.stiffness_spread * torque / robot.stiffness) ** 2
        zero_variance += (expected.anchor_spread / robot.pulley_radius) ** 2
        covariance = covariance.copy()
        zeros = np.arange(self._size)[self._zero]
        covariance[:, zeros, zeros] = zero_variance
        innovation = torque - holding[..., 0] * mean[:, self._mass, None] - holding[..., 1]
        gradient = np.zeros((len(mean), robot.cables, self._size))
        wound = (robot.stiffness / robot.pulley_radius)[:, None] * textbook.jacobian(robot, pose)
        gradient[..., self._pose] = -wound
        gradient[..., self._zero] = np.diag(robot.stiffness)
        gradient[..., self._mass] = holding[..., 0]
        noise = (robot.stiffness * expected.noise.motor_angle) ** 2 + _EPS
        mean = mean.copy()
        variance = np.broadcast_to(noise, innovation.shape).copy()
        correct(innovation, gradient, variance, mean, covariance)
        return mean, covariance

    def _holding_torque(self, mass: float, pose: Array) -> Array:
        minimum = textbook.allocated_minimum(self.robot)
        return textbook.static_torque(self.robot, np.full(len(pose), mass), pose, minimum=minimum)

    # One control period

    def _following(self, blocks: dict[str, Array], state: ObserverState) -> ObserverState:
        """Prediction over one control period, and correction by the sensors."""
        mean, covariance = state.mean.copy(), state.covariance.copy()
        count = len(mean)
        jumps = self._torque_errors(blocks)
        variance = np.repeat(self._reading_variance[None], count, axis=0)
        gradient = np.repeat(self._reading_gradient[None], count, axis=0)
        balance = None
        if self.robot.flexible:
            torque, torque_gradient, balance = self._flexible_torques(blocks, state, jumps)
            jumps = np.zeros_like(jumps)
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
        if balance is not None:
            # The balance concerns the period before: its gradient refers to the predicted state,
            # which hardly differs.
            excess, slopes, noise = balance
            innovation = np.concatenate([innovation, excess], axis=-1)
            gradient = np.concatenate([gradient, slopes], axis=-2)
            variance = np.concatenate([variance, noise], axis=-1)
        correct(innovation, gradient, variance, mean, covariance)
        mean[:, self._delay] = np.clip(mean[:, self._delay], *self._effect_times)
        mean[:, self._mass] = np.maximum(mean[:, self._mass], self.robot.mass / 2)
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
        variance = np.repeat(self._least_growth[None], len(mean), axis=0)
        variance[:, self._mass] = (MASS_DRIFT * mean[:, self._mass]) ** 2 * self.period
        return variance

    def _growth_without_mass(self) -> Array:
        """Variances that one control period adds, (size,), but for that of the mass."""
        period, expected = self.period, self.expectation
        variance = np.zeros(self._size)
        variance[self._velocity] = self._acceleration_noise**2 * period
        variance[self._pose] = self._acceleration_noise**2 * period**3 / 3
        variance[self._wrench] = (1 - self._wrench_decay**2) * expected.wrench_spread**2
        variance[self._strength] = STRENGTH_DRIFT**2 * period
        if self.robot.flexible:
            drift = OFFSET_DRIFT * expected.anchor_spread / self.robot.pulley_radius
            variance[self._zero] = drift**2 * period
        return variance

    def _rigid_torques(self, blocks: dict[str, Array], state: ObserverState) -> tuple[Array, Array]:
        """Mean torques on the pulleys of a rigid robot, (N, m), and their derivatives with respect
        to the state, (N, m, size)."""
        robot = self.robot
        now = self.estimate(state)
        dynamics = state.dynamics
        speed = dynamics.pulley_speed
        drives = self._drives(blocks["last_actions"], state, now, speed)
        speed_slope = (now.strength * robot.speed_slope + robot.damping) / robot.pulley_radius
        gradient = np.zeros((*speed.shape, self._size))
        gradient[..., self._velocity] = speed_slope[..., None] * dynamics.structure
        gradient[..., self._mass] = drives.per_mass
        gradient[..., self._strength] = drives.per_strength[..., None] * np.eye(robot.cables)
        gradient[..., self._delay] = drives.per_delay
        return drives.torque - textbook.coulomb_torque(robot, speed), gradient

    def _flexible_torques(
        self, blocks: dict[str, Array], state: ObserverState, errors: Array
    ) -> tuple[Array, Array, tuple[Array, Array, Array]]:
        """Mean torques of the springs of a flexible robot, (N, m), their derivatives, (N, m, size),
        and the torque balance of the motors: excess, derivatives and variance."""
        robot, period = self.robot, self.period
        now = self.estimate(state)
        angle, speed = blocks["motor_angle"], blocks["motor_speed"]
        mean_angle = (angle + state.motor_angle) / 2 - period / 12 * (speed - state.motor_speed)
        mean_speed = (speed + state.motor_speed) / 2
        middle = now.pose + period / 2 * now.velocity
        stiffness = textbook.joint_stiffness(robot, middle)
        spring = stiffness * (mean_angle - now.zero - textbook.pulley_angle(robot, middle))
        spring_gradient = np.zeros((*spring.shape, self._size))
        # β = (l₀ − l)/r, so a displacement winds the spring by S/r.
        wound = (stiffness / robot.pulley_radius)[..., None] * state.dynamics.structure
        spring_gradient[..., self._pose] = wound
        spring_gradient[..., self._zero] = -np.eye(robot.cables) * stiffness[..., None, :]
        drives = self._drives(blocks["last_actions"], state, now, mean_speed)
        change = robot.motor_inertia * (speed - state.motor_speed) / period
        friction = textbook.motor_friction(robot, mean_speed)
        excess = change - (drives.torque - spring - friction)
        gradient = -spring_gradient
        gradient[..., self._mass] = drives.per_mass
        gradient[..., self._strength] = np.eye(robot.cables) * drives.per_strength[:, None, :]
        gradient[..., self._delay] = drives.per_delay
        return spring, spring_gradient, (excess, gradient, self._balance_variance(errors))

    def _balance_variance(self, errors: Array) -> Array:
        """Variance of the torque balance of the motors in one control period, with errors of their
        torques, each (N, m) [N²·m²]."""
        robot, noise = self.robot, self.expectation.noise
        speed = robot.motor_inertia * noise.motor_speed * np.sqrt(2) / self.period
        angle = robot.stiffness * noise.motor_angle
        friction = self.expectation.friction_spread * robot.coulomb_friction
        friction = friction * np.sqrt(robot.cables * FRICTION_TIME / self.period)
        variance: Array = speed**2 + angle**2 + friction**2 + errors**2 + _EPS
        return variance

    def _torque_errors(self, blocks: dict[str, Array]) -> Array:
        """Errors of the mean torques in one control period by changes of the actions, (N, m)."""
        actions = blocks["last_actions"].reshape(len(blocks["pose"]), -1, self.robot.cables)
        errors: Array = LAG_ERROR * self.robot.stall_torque * np.ptp(actions, axis=1)
        return errors

    def _dynamics(self, mean: Array) -> Dynamics:
        """Motion with the estimates of a mean, (N, size)."""
        mass, velocity = mean[:, self._mass], mean[:, self._velocity]
        middle = mean[:, self._pose] + self.period / 2 * velocity
        return dynamics_of(self.robot, mass, middle, velocity)

    # Actions

    def _drives(
        self, last_actions: Array, state: ObserverState, now: RobotEstimate, speed: Array
    ) -> Drives:
        """Mean torque of the motors in the last control period, at speeds (N, m) [rad/s]."""
        weights, rates = delayed_weights(np.ascontiguousarray(now.delay), self.period)
        return self._weighed(last_actions, weights, rates, state.steps + 1, state, now, speed)

    def _weighed(
        self,
        last_actions: Array,
        weights: Array,
        rates: Array,
        sent: Array,
        state: ObserverState,
        now: RobotEstimate,
        speed: Array,
    ) -> Drives:
        """Torque of the last actions, see :func:`~cablebot_baselines.estimation.filtering.weigh`."""
        actions = last_actions.reshape(len(speed), -1, self.robot.cables)
        robots = speed, now.strength, now.mass, state.holding
        drives = np.empty((4, *speed.shape))
        weigh(
            *map(np.ascontiguousarray, (actions, weights, rates, sent, *robots)),
            self._motors,
            drives,
        )
        return Drives(*drives)

    # Prediction

    def at_effect(self, blocks: dict[str, Array], state: ObserverState) -> dict[str, Array]:
        """Pose, velocity, acceleration ``disturbance`` by the wrench and, of a flexible robot, motor
        angle without zero error and motor speed at the instant at which the next action takes
        effect, by block name."""
        robot = self.robot
        now = self.estimate(state)
        actions = blocks["last_actions"]
        delay = now.delay[:, None]
        latest = np.minimum(1.0, self.period / np.maximum(now.delay, _EPS))
        weights = np.stack([latest, 1 - latest], axis=1)
        rates = np.zeros_like(weights)
        dynamics = state.dynamics
        disturbance = times_vector(dynamics.mobility, now.wrench)
        if not robot.flexible:
            speed = dynamics.pulley_speed
            drives = self._weighed(actions, weights, rates, state.steps, state, now, speed)
            friction = textbook.coulomb_torque(robot, speed)
            acceleration = dynamics.acceleration(drives.torque - friction, now.wrench)
            return {
                "pose": now.pose + delay * now.velocity + delay**2 / 2 * acceleration,
                "velocity": now.velocity + delay * acceleration,
                "disturbance": disturbance,
            }
        pose, velocity = now.pose, now.velocity
        angle, speed = blocks["motor_angle"] - now.zero, blocks["motor_speed"]
        twist = angle - textbook.pulley_angle(robot, pose)
        stiffness = textbook.joint_stiffness(robot, pose)
        step = delay / _AHEAD_STEPS
        for _ in range(_AHEAD_STEPS):
            drives = self._weighed(actions, weights, rates, state.steps, state, now, speed)
            spring = stiffness * twist
            friction = textbook.motor_friction(robot, speed)
            speed = speed + step * (drives.torque - spring - friction) / robot.motor_inertia
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
            "disturbance": disturbance,
        }


def _merged(
    starts: NDArray[np.bool_], initial: ObserverState, following: ObserverState
) -> ObserverState:
    """The initial state of the episodes that start, and the following state of the others."""

    def either(old: Array, new: Array) -> Array:
        return np.where(starts.reshape(-1, *(1,) * (new.ndim - 1)), old, new)

    merged: dict[str, Any] = {}
    for field in fields(following):
        old, new = getattr(initial, field.name), getattr(following, field.name)
        if isinstance(new, Dynamics):
            merged[field.name] = Dynamics(*map(either, old, new))
        else:
            merged[field.name] = either(old, new)
    return ObserverState(**merged)
