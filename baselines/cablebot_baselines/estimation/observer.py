"""Observer of a robot that is not exactly known: pose, velocity, mass, motors and delay.

It is an extended Kalman filter with the expected robot as its model. A law that uses its estimates
acts for the robot that it meets, at the instant at which its action takes effect.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.estimation.expectation import Expectation
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import times_vector
from cablebot_gym.robots import Robot

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

    def estimate(self, state: ObserverState) -> RobotEstimate:
        """The estimates in a state of the filter."""
        mean = state.mean
        zero = np.zeros_like(state.motor_angle)
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
        return _corrected(mean, covariance, innovation, gradient, noise)

    def _holding_torque(self, mass: float, pose: Array) -> Array:
        minimum = textbook.allocated_minimum(self.robot)
        return textbook.static_torque(self.robot, np.full(len(pose), mass), pose, minimum=minimum)

    # One control period

    def _following(self, blocks: dict[str, Array], state: ObserverState) -> ObserverState:
        """Prediction over one control period, and correction by the sensors."""
        balance = None
        if self.robot.flexible:
            predicted, transition, balance = self._flexible_period(blocks, state)
            growth = self._growth(predicted)
        else:
            predicted, transition, torque_slope = self._rigid_period(blocks, state)
            growth = self._growth(predicted)
            # Errors of the torques move the platform at once.
            jumps = self.period * torque_slope * self._torque_errors(blocks)[:, None, :]
            growth[:, self._velocity] += np.sum(jumps**2, axis=-1)
        covariance = transition @ state.covariance @ np.swapaxes(transition, -1, -2)
        covariance = covariance + growth[:, :, None] * np.eye(self._size)
        readings = np.concatenate([blocks["pose"], blocks["velocity"]], axis=-1)
        innovation = readings - predicted[:, : self._mass]
        gradient = np.eye(self._mass, self._size)
        variance = np.broadcast_to(self._reading_variance, innovation.shape)
        if balance is not None:
            # The balance concerns the period before: its gradient refers to the predicted state,
            # which hardly differs.
            excess, slopes, noise = balance
            innovation = np.concatenate([innovation, excess], axis=-1)
            gradient = np.concatenate(
                [np.broadcast_to(gradient, (len(excess), *gradient.shape)), slopes], axis=-2
            )
            variance = np.concatenate([variance, noise], axis=-1)
        mean, covariance = _corrected(predicted, covariance, innovation, gradient, variance)
        mean[:, self._delay] = np.clip(mean[:, self._delay], *self._effect_times)
        mean[:, self._mass] = np.maximum(mean[:, self._mass], self.robot.mass / 2)
        zero = np.zeros_like(state.motor_angle)
        return ObserverState(
            mean=mean,
            covariance=covariance,
            steps=state.steps + 1,
            holding=state.holding,
            motor_angle=blocks.get("motor_angle", zero),
            motor_speed=blocks.get("motor_speed", zero),
        )

    def _growth(self, mean: Array) -> Array:
        """Variances that one control period adds, (N, size)."""
        period, expected = self.period, self.expectation
        variance = np.zeros((len(mean), self._size))
        variance[:, self._velocity] = self._acceleration_noise**2 * period
        variance[:, self._pose] = self._acceleration_noise**2 * period**3 / 3
        variance[:, self._wrench] = (1 - self._wrench_decay**2) * expected.wrench_spread**2
        variance[:, self._mass] = (MASS_DRIFT * mean[:, self._mass]) ** 2 * period
        variance[:, self._strength] = STRENGTH_DRIFT**2 * period
        if self.robot.flexible:
            drift = OFFSET_DRIFT * expected.anchor_spread / self.robot.pulley_radius
            variance[:, self._zero] = drift**2 * period
        return variance

    def _rigid_period(
        self, blocks: dict[str, Array], state: ObserverState
    ) -> tuple[Array, Array, Array]:
        """Predicted mean, transition and derivative of the acceleration with respect to the torques
        of a rigid robot."""
        robot, period = self.robot, self.period
        now = self.estimate(state)
        dynamics = self._dynamics(now, now.pose + period / 2 * now.velocity)
        speed = dynamics.equations.pulley_speed
        drives = self._drives(blocks["last_actions"], state, now, speed)
        friction = textbook.coulomb_torque(robot, speed)
        acceleration = dynamics.acceleration(drives.torque - friction, now.wrench)
        torque_slope, mobility = dynamics.torque_slope, dynamics.mobility
        structure = dynamics.equations.structure
        speed_slope = now.strength * robot.speed_slope + robot.damping
        slopes = np.zeros((len(acceleration), robot.coordinates, self._size))
        slopes[..., self._velocity] = torque_slope @ (
            (speed_slope / robot.pulley_radius)[..., None] * structure
        )
        slopes[..., self._mass] = dynamics.mass_slope(acceleration)
        slopes[..., self._mass] += times_vector(torque_slope, drives.per_mass)
        slopes[..., self._strength] = torque_slope * drives.per_strength[:, None, :]
        slopes[..., self._delay] = times_vector(torque_slope, drives.per_delay)
        slopes[..., self._wrench] = mobility
        predicted, transition = self._moved(state.mean, now.velocity, acceleration, slopes)
        return predicted, transition, torque_slope

    def _flexible_period(
        self, blocks: dict[str, Array], state: ObserverState
    ) -> tuple[Array, Array, tuple[Array, Array, Array]]:
        """Predicted mean, transition and torque balance of the motors of a flexible robot."""
        robot, period = self.robot, self.period
        now = self.estimate(state)
        angle, speed = blocks["motor_angle"], blocks["motor_speed"]
        mean_angle = (angle + state.motor_angle) / 2 - period / 12 * (speed - state.motor_speed)
        mean_speed = (speed + state.motor_speed) / 2
        middle = now.pose + period / 2 * now.velocity
        stiffness = textbook.joint_stiffness(robot, middle)
        spring = stiffness * (mean_angle - now.zero - textbook.pulley_angle(robot, middle))
        dynamics = self._dynamics(now, middle)
        acceleration = dynamics.acceleration(spring, now.wrench)
        torque_slope, structure = dynamics.torque_slope, dynamics.equations.structure
        # β = (l₀ − l)/r, so a displacement winds the spring by S/r.
        wound = (stiffness / robot.pulley_radius)[..., None] * structure
        slopes = np.zeros((len(acceleration), robot.coordinates, self._size))
        slopes[..., self._pose] = torque_slope @ wound
        slopes[..., self._mass] = dynamics.mass_slope(acceleration)
        slopes[..., self._zero] = -torque_slope * stiffness[..., None, :]
        slopes[..., self._wrench] = dynamics.mobility
        predicted, transition = self._moved(state.mean, now.velocity, acceleration, slopes)
        drives = self._drives(blocks["last_actions"], state, now, mean_speed)
        change = robot.motor_inertia * (speed - state.motor_speed) / period
        friction = textbook.motor_friction(robot, mean_speed)
        excess = change - (drives.torque - spring - friction)
        gradient = np.zeros((len(excess), robot.cables, self._size))
        gradient[..., self._pose] = -wound
        gradient[..., self._zero] = np.eye(robot.cables) * stiffness[..., None, :]
        gradient[..., self._mass] = drives.per_mass
        gradient[..., self._strength] = np.eye(robot.cables) * drives.per_strength[:, None, :]
        gradient[..., self._delay] = drives.per_delay
        return predicted, transition, (excess, gradient, self._balance_variance(blocks))

    def _balance_variance(self, blocks: dict[str, Array]) -> Array:
        """Variance of the torque balance of the motors in one control period, (N, m) [N²·m²]."""
        robot, noise = self.robot, self.expectation.noise
        speed = robot.motor_inertia * noise.motor_speed * np.sqrt(2) / self.period
        angle = robot.stiffness * noise.motor_angle
        friction = self.expectation.friction_spread * robot.coulomb_friction
        friction = friction * np.sqrt(robot.cables * FRICTION_TIME / self.period)
        jump = self._torque_errors(blocks)
        variance: Array = speed**2 + angle**2 + friction**2 + jump**2 + _EPS
        return variance

    def _torque_errors(self, blocks: dict[str, Array]) -> Array:
        """Errors of the mean torques in one control period by changes of the actions, (N, m)."""
        actions = blocks["last_actions"].reshape(len(blocks["pose"]), -1, self.robot.cables)
        errors: Array = LAG_ERROR * self.robot.stall_torque * np.ptp(actions, axis=1)
        return errors

    def _moved(
        self, mean: Array, velocity: Array, acceleration: Array, slopes: Array
    ) -> tuple[Array, Array]:
        """Mean after one control period with an acceleration, and its transition.

        Args:
            mean: mean at the start.
            velocity: velocity at the start, (N, n).
            acceleration: acceleration Ẍ, (N, n).
            slopes: its derivative with respect to the state, (N, n, size).
        """
        period = self.period
        predicted = mean.copy()
        predicted[:, self._pose] += period * velocity + period**2 / 2 * acceleration
        predicted[:, self._velocity] += period * acceleration
        predicted[:, self._wrench] *= self._wrench_decay
        n = self.robot.coordinates
        transition = np.zeros((len(mean), self._size, self._size))
        transition[...] = np.eye(self._size)
        transition[:, self._pose, self._velocity] += period * np.eye(n)
        transition[:, self._pose] += period**2 / 2 * slopes
        transition[:, self._velocity] += period * slopes
        transition[:, self._wrench, self._wrench] *= self._wrench_decay
        return predicted, transition

    def _dynamics(self, now: RobotEstimate, pose: Array) -> _Dynamics:
        """Dynamics with the estimates, at other poses (N, n)."""
        masses = np.stack([now.mass, now.mass + 1.0])
        equations = textbook.motion_equations(self.robot, masses, pose[None], now.velocity[None])
        return _Dynamics.of(self.robot, equations)

    # Actions

    def _drives(
        self, last_actions: Array, state: ObserverState, now: RobotEstimate, speed: Array
    ) -> _Drives:
        """Mean torque of the motors in the last control period, at speeds (N, m) [rad/s]."""
        weights, rates = delayed_weights(now.delay, self.period)
        actions = np.clip(last_actions.reshape(len(speed), -1, self.robot.cables), -1.0, 1.0)
        return self._weighed(actions, weights, rates, state.steps + 1, state, now, speed)

    def _weighed(
        self,
        actions: Array,
        weights: Array,
        rates: Array,
        sent: Array,
        state: ObserverState,
        now: RobotEstimate,
        speed: Array,
    ) -> _Drives:
        """Torque of actions that act in parts of a time.

        Args:
            actions: the last actions, the latest first, (N, k, m).
            weights: fraction of the time in which each acts, (N, k).
            rates: derivative of the weights with respect to the delay, (N, k) [1/s].
            sent: number of actions since the start, (N,). Those before hold the robot.
            state: state of the filter.
            now: its estimates.
            speed: motor speeds, (N, m) [rad/s].
        """
        robot = self.robot
        is_sent = np.arange(weights.shape[1]) < sent[:, None]
        held = np.sum(np.where(is_sent, 0.0, weights), axis=1)[:, None]
        held_rate = np.sum(np.where(is_sent, 0.0, rates), axis=1)[:, None]
        weights = np.where(is_sent, weights, 0.0)
        rates = np.where(is_sent, rates, 0.0)
        requested = robot.stall_torque * np.sum(weights[..., None] * actions, axis=1)
        unit = requested - (1 - held) * robot.speed_slope * speed
        holding = state.holding[..., 0] * now.mass[:, None] + state.holding[..., 1]
        rate = robot.stall_torque * np.sum(rates[..., None] * actions, axis=1)
        rate += held_rate * robot.speed_slope * speed
        return _Drives(
            torque=now.strength * unit + held * holding,
            per_strength=unit,
            per_delay=now.strength * rate + held_rate * holding,
            per_mass=held * state.holding[..., 0],
        )

    # Prediction

    def at_effect(self, blocks: dict[str, Array], state: ObserverState) -> dict[str, Array]:
        """Pose, velocity, acceleration ``disturbance`` by the wrench and, of a flexible robot, motor
        angle without zero error and motor speed at the instant at which the next action takes
        effect, by block name."""
        robot = self.robot
        now = self.estimate(state)
        actions = np.clip(
            blocks["last_actions"].reshape(len(now.pose), -1, robot.cables), -1.0, 1.0
        )
        delay = now.delay[:, None]
        latest = np.minimum(1.0, self.period / np.maximum(now.delay, _EPS))
        weights = np.stack([latest, 1 - latest], axis=1)
        rates = np.zeros_like(weights)
        actions = actions[:, :2]
        dynamics = self._dynamics(now, now.pose + delay / 2 * now.velocity)
        disturbance = times_vector(dynamics.mobility, now.wrench)
        if not robot.flexible:
            speed = dynamics.equations.pulley_speed
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
            winding = times_vector(dynamics.equations.structure, velocity) / robot.pulley_radius
            twist = twist + step * (speed + winding)
        return {
            "pose": pose,
            "velocity": velocity,
            "motor_angle": angle,
            "motor_speed": speed,
            "disturbance": disturbance,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class _Dynamics:
    """Motion of N robots at a state, for any torques on the pulleys."""

    equations: textbook.MotionEquations
    """Equations for the estimated masses."""
    mobility: Array
    """Acceleration by a wrench, (N, n, n) [1/kg, …]: the inverse of the inertia of platform and
    pulleys."""
    torque_slope: Array
    """Acceleration by the torques on the pulleys, (N, n, m)."""
    matrix_per_mass: Array
    """Derivative of the mass matrix, (N, n, n) [1/kg]."""
    bias_per_mass: Array
    """Derivative of the bias h, (N, n)."""

    @classmethod
    def of(cls, robot: Robot, equations: textbook.MotionEquations) -> _Dynamics:
        """From the equations for the masses and, (2, N, …), for 1 kg more. Both are affine in the
        mass."""
        matrix, heavier_matrix = equations.mass_matrix
        bias, heavier_bias = equations.bias
        now = replace(
            equations,
            mass_matrix=matrix,
            bias=bias,
            structure=equations.structure[0],
            pulley_speed=equations.pulley_speed[0],
            cable_drag=equations.cable_drag[0],
        )
        pulls = np.swapaxes(now.structure, -1, -2)
        inertia = matrix + pulls @ (now.rotor_masses[:, None] * now.structure)
        mobility = np.linalg.inv(inertia)
        return cls(
            equations=now,
            mobility=mobility,
            torque_slope=-mobility @ pulls / robot.pulley_radius,
            matrix_per_mass=heavier_matrix - matrix,
            bias_per_mass=heavier_bias - bias,
        )

    def acceleration(self, torque: Array, wrench: Array) -> Array:
        """Ẍ for torques on the pulleys, (N, m) [N·m], and wrenches, (N, n) [N, N·m]."""
        equations = self.equations
        drag = times_vector(np.swapaxes(equations.structure, -1, -2), equations.cable_drag)
        passive = times_vector(self.mobility, wrench - equations.bias - drag)
        return passive + times_vector(self.torque_slope, torque)

    def mass_slope(self, acceleration: Array) -> Array:
        """Derivative of an acceleration Ẍ with respect to the mass, (N, n)."""
        change = times_vector(self.matrix_per_mass, acceleration) + self.bias_per_mass
        return -times_vector(self.mobility, change)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Drives:
    """Mean torque of the motors in a time, and its derivatives, each (N, m)."""

    torque: Array
    """Torque [N·m]."""
    per_strength: Array
    """Derivative with respect to the strength of the motor [N·m]."""
    per_delay: Array
    """Derivative with respect to the delay [N·m/s]."""
    per_mass: Array
    """Derivative with respect to the mass [N·m/kg]: before the first action arrives, the motors hold
    the mass."""


def delayed_weights(delay: Array, period: float) -> tuple[Array, Array]:
    """Fraction of a control period in which each of the last three actions acts, the latest first,
    and its derivative with respect to the delay [1/s], each (N, 3).

    Args:
        delay: time between the request of an action and its torque, (N,) [s].
        period: control period [s].
    """
    periods = np.clip(delay / period, 0.0, 2.0)[:, None]
    ages = np.arange(3)
    # An action of age k acts from k h + τ before the end of the period on, for one period.
    weights = np.maximum(1 - np.abs(periods - ages), 0.0)
    is_growing = (ages > periods) & (weights > 0)
    is_shrinking = (ages <= periods) & (weights > 0)
    rates = (is_growing.astype(float) - is_shrinking.astype(float)) / period
    return weights, rates


def _merged(
    starts: NDArray[np.bool_], initial: ObserverState, following: ObserverState
) -> ObserverState:
    """The initial state of the episodes that start, and the following state of the others."""
    arrays = {}
    for field in fields(following):
        values = getattr(following, field.name)
        mask = starts.reshape(-1, *(1,) * (values.ndim - 1))
        arrays[field.name] = np.where(mask, getattr(initial, field.name), values)
    return ObserverState(**arrays)


def _corrected(
    mean: Array, covariance: Array, innovation: Array, gradient: Array, variance: Array
) -> tuple[Array, Array]:
    """Mean and covariance after readings with independent errors of a variance (..., k)."""
    crossed = covariance @ np.swapaxes(gradient, -1, -2)
    total = gradient @ crossed + variance[..., None] * np.eye(variance.shape[-1])
    gain = np.swapaxes(np.linalg.solve(total, np.swapaxes(crossed, -1, -2)), -1, -2)
    mean = mean + (gain @ innovation[..., None])[..., 0]
    covariance = covariance - gain @ np.swapaxes(crossed, -1, -2)
    return mean, (covariance + np.swapaxes(covariance, -1, -2)) / 2
