"""Compiled parts of the observer, one robot of a batch after the other: NumPy would take most of its
time for its calls."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics.compiling import entry_point, helper
from cablebot_gym.physics.inverse import demands
from cablebot_gym.physics.textbook import times_vector
from cablebot_gym.robots import Robot


class Dynamics(NamedTuple):
    """Motion of N robots at a state, for any torques on the pulleys."""

    structure: Array
    """S, (N, m, n)."""
    pulley_speed: Array
    """β̇, (N, m) [rad/s]."""
    mobility: Array
    """Acceleration by a wrench, (N, n, n) [1/kg, …]: the inverse of the inertia of platform and
    pulleys."""
    torque_slope: Array
    """Acceleration by the torques on the pulleys, (N, n, m)."""
    passive_wrench: Array
    """Wrench of weight, velocity and drag of the pulleys, (N, n) [N, N·m]."""
    matrix_per_mass: Array
    """Derivative of the mass matrix, (N, n, n) [1/kg]."""
    bias_per_mass: Array
    """Derivative of the bias h, (N, n)."""

    def acceleration(self, torque: Array, wrench: Array) -> Array:
        """Ẍ for torques on the pulleys, (N, m) [N·m], and wrenches, (N, n) [N, N·m]."""
        free = times_vector(self.mobility, wrench + self.passive_wrench)
        return free + times_vector(self.torque_slope, torque)


class Drives(NamedTuple):
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


def dynamics_of(robot: Robot, masses: Array, pose: Array, velocity: Array) -> Dynamics:
    """Dynamics of robots with masses (N,) [kg] at poses and velocities, each (N, n)."""
    n = robot.coordinates
    m = robot.cables
    count = len(masses)
    # Load and y are affine in Ẍ and in the mass: without acceleration and with 1 of each
    # coordinate, for the masses and for 1 kg more.
    motion = np.zeros((3, 2, count, n + 1, n))
    motion[0] = pose[:, None]
    motion[1] = velocity[:, None]
    motion[2, ..., 1:, :] = np.eye(n)
    two_masses = np.empty((2, count, n + 1))
    two_masses[0] = masses[:, None]
    two_masses[1] = two_masses[0] + 1.0
    dynamics = Dynamics(
        structure=np.empty((count, m, n)),
        pulley_speed=np.empty((count, m)),
        mobility=np.empty((count, n, n)),
        torque_slope=np.empty((count, n, m)),
        passive_wrench=np.empty((count, n)),
        matrix_per_mass=np.empty((count, n, n)),
        bias_per_mass=np.empty((count, n)),
    )
    pulleys = np.stack([robot.pulley_radius, robot.pulley_inertia, robot.damping])
    _combine(demands(robot, two_masses, motion), pulleys, dynamics)
    return dynamics


def _product_seconds(gradient: Array) -> float:
    """Estimated time of Python for products of a gradient, (N, k, size), and a covariance [s]."""
    return 1e-6 * gradient.size * gradient.shape[-1]


@helper
def _add_multiple(target, factor, source):
    """Adds a multiple of a vector to another one."""
    for c in range(len(target)):
        target[c] += factor * source[c]


@helper
def _add_products(total, left, right):
    """Total plus the products of the entries of two vectors, one after the other."""
    for c in range(len(left)):
        total += left[c] * right[c]
    return total


@helper
def _multiply_transposed(left, right, product):
    """Product of a matrix and the transpose of another one."""
    for a in range(len(left)):
        for b in range(len(right)):
            total = 0.0
            for c in range(left.shape[1]):
                total += left[a, c] * right[b, c]
            product[a, b] = total


@helper
def _invert(matrix, inverse):
    """Inverse of a positive definite matrix by Gauss-Jordan elimination, which changes the matrix."""
    size = len(matrix)
    inverse[:] = 0.0
    for p in range(size):
        inverse[p, p] = 1.0
    for p in range(size):
        scale = 1.0 / matrix[p, p]
        for c in range(size):
            matrix[p, c] *= scale
            inverse[p, c] *= scale
        for a in range(size):
            if a != p:
                factor = -matrix[a, p]
                _add_multiple(matrix[a], factor, matrix[p])
                _add_multiple(inverse[a], factor, inverse[p])


@helper
def _dynamics_of_robot(dynamics, i):
    """Views of the dynamics of robot i."""
    return Dynamics(
        dynamics.structure[i],
        dynamics.pulley_speed[i],
        dynamics.mobility[i],
        dynamics.torque_slope[i],
        dynamics.passive_wrench[i],
        dynamics.matrix_per_mass[i],
        dynamics.bias_per_mass[i],
    )


@helper
def _add_pulleys(pulleys, pulley_acceleration, dynamics, inertia):
    """Adds the wrench and the inertia of the pulleys of a robot, with accelerations (m,)
    [rad/s²]."""
    wrench = dynamics.passive_wrench
    for j in range(len(pulley_acceleration)):
        radius = pulleys[0, j]
        rotor_inertia = pulleys[1, j]
        pull = dynamics.structure[j]
        drag = rotor_inertia * pulley_acceleration[j]
        drag += pulleys[2, j] * dynamics.pulley_speed[j]
        rotor_mass = rotor_inertia / (radius * radius)
        for a in range(len(wrench)):
            wrench[a] += pull[a] * drag / radius
            _add_multiple(inertia[a], pull[a] * rotor_mass, pull)


@entry_point(seconds=lambda demand, *_: 1e-6 * demand.structure.size)
def _combine(demand, pulleys, dynamics):
    """Writes dynamics from the demands of (2, N, n + 1) motions, see :func:`dynamics_of`.

    ``pulleys`` are radius, inertia and damping, (3, m).
    """
    inertia = np.empty(dynamics.mobility.shape[1:])
    for i in range(len(dynamics.mobility)):
        robot_dynamics = _dynamics_of_robot(dynamics, i)
        robot_dynamics.pulley_speed[:] = demand.speeds[0, i, 0]
        load = demand.load[0, i]
        heavier_load = demand.load[1, i]
        y = demand.y[0, i]
        y_slopes = y[1:] - y[0]
        _multiply_transposed(demand.structure[0, i, 0], y_slopes, robot_dynamics.structure)
        for a in range(len(y_slopes)):
            bias = _add_products(0.0, y_slopes[a], load[0])
            heavier_bias = _add_products(0.0, y_slopes[a], heavier_load[0])
            robot_dynamics.bias_per_mass[a] = heavier_bias - bias
            robot_dynamics.passive_wrench[a] = -bias
        _multiply_transposed(y_slopes, load[1:] - load[0], inertia)
        heavier_slopes = heavier_load[1:] - heavier_load[0]
        _multiply_transposed(y_slopes, heavier_slopes, robot_dynamics.matrix_per_mass)
        dynamics.matrix_per_mass[i] -= inertia
        _add_pulleys(pulleys, demand.pulley_accelerations[0, i, 0], robot_dynamics, inertia)
        _invert(inertia, robot_dynamics.mobility)
        slope = robot_dynamics.torque_slope
        _multiply_transposed(robot_dynamics.mobility, robot_dynamics.structure, slope)
        # unlike −x, 0.0 − x is never a negative zero
        dynamics.torque_slope[i] = (0.0 - slope) / pulleys[0]


@entry_point(seconds=lambda delay, period: 1e-5 * len(delay))
def delayed_weights(delay, period):
    """Fraction of a control period in which each of the last three actions acts, the latest first,
    and its derivative with respect to the delay [1/s], each (N, 3).

    Args:
        delay: time between the request of an action and its torque, (N,) [s].
        period: control period [s].
    """
    weights = np.zeros((len(delay), 3))
    rates = np.zeros((len(delay), 3))
    for i in range(len(delay)):
        periods = min(max(delay[i] / period, 0.0), 2.0)
        # An action of age k acts from k h + τ before the end of the period on, for one period.
        for age in range(3):
            weight = 1.0 - abs(periods - age)
            if weight > 0.0:
                weights[i, age] = weight
                rates[i, age] = 1.0 / period
                if age <= periods:
                    rates[i, age] = -1.0 / period
    return weights, rates


@entry_point(seconds=lambda actions, *_: 2e-6 * actions.size)
def weigh(actions, weights, rates, sent, speed, strength, mass, holding, motors, drives):
    """Torque of actions that act in parts of a time.

    Args:
        actions: the last actions, the latest first, (N, k, m).
        weights: fraction of the time in which each acts, (N, k).
        rates: derivative of the weights with respect to the delay, (N, k) [1/s].
        sent: number of actions since the start, (N,). Those before hold the robot.
        speed: motor speeds, (N, m) [rad/s].
        strength: strengths of the motors, (N, m).
        mass: masses of platform and payload, (N,) [kg].
        holding: torque that holds the robot per mass, and that without mass, (N, m, 2).
        motors: stall torque [N·m] and its drop with the speed [N·m·s/rad], (2, m).
        drives: the results, in the order of :class:`Drives`, (4, N, m).
    """
    ages = weights.shape[1]
    for i in range(len(mass)):
        acting = min(int(sent[i]), ages)
        held = 0.0
        held_rate = 0.0
        for k in range(acting, ages):
            held += weights[i, k]
            held_rate += rates[i, k]
        for j in range(motors.shape[1]):
            requested = 0.0
            requested_rate = 0.0
            for k in range(acting):
                action = min(max(actions[i, k, j], -1.0), 1.0)
                requested += weights[i, k] * action
                requested_rate += rates[i, k] * action
            stall = motors[0, j]
            slope = motors[1, j]
            holding_per_mass = holding[i, j, 0]
            holding_torque = holding_per_mass * mass[i] + holding[i, j, 1]
            unit = stall * requested - (1.0 - held) * slope * speed[i, j]
            unit_rate = stall * requested_rate + held_rate * slope * speed[i, j]
            drives[0, i, j] = strength[i, j] * unit + held * holding_torque
            drives[1, i, j] = unit
            drives[2, i, j] = strength[i, j] * unit_rate + held_rate * holding_torque
            drives[3, i, j] = held * holding_per_mass


@helper
def _accelerate(dynamics, torque, wrench, acceleration):
    """Ẍ of a robot with torques, (m,), and a wrench, (n,)."""
    force = wrench + dynamics.passive_wrench
    for a in range(len(acceleration)):
        total = _add_products(0.0, dynamics.mobility[a], force)
        acceleration[a] = _add_products(total, dynamics.torque_slope[a], torque)


@helper
def _write_slopes(dynamics, gradient, by_pose, acceleration, wrench, mass, slopes):
    """Derivatives of Ẍ of a robot with respect to the state, from those of the torques and those
    with respect to the pose at constant torques."""
    n, m = dynamics.torque_slope.shape
    slopes[:] = 0.0
    slopes[:, :n] = by_pose
    for a in range(n):
        for j in range(m):
            _add_multiple(slopes[a], dynamics.torque_slope[a, j], gradient[j])
        for b in range(n):
            mobility = dynamics.mobility[a, b]
            force_per_mass = _add_products(
                dynamics.bias_per_mass[b], dynamics.matrix_per_mass[b], acceleration
            )
            slopes[a, wrench + b] += mobility
            slopes[a, mass] -= mobility * force_per_mass


@helper
def _advance(slopes, wrench, period, decay, matrix, moved):
    """Multiplies a matrix by the derivatives of the state after a period with respect to that
    before."""
    n = len(slopes)
    moved[:] = 0.0
    for a in range(n):
        for b in range(len(matrix)):
            if slopes[a, b] != 0.0:
                _add_multiple(moved[a], slopes[a, b], matrix[b])
    for a in range(n):
        _add_multiple(matrix[a], period, matrix[n + a])
        _add_multiple(matrix[a], period * period / 2, moved[a])
        _add_multiple(matrix[n + a], period, moved[a])
        matrix[wrench + a] *= decay


@entry_point(seconds=lambda dynamics, torque, gradient, *_: _product_seconds(gradient))
def predict(
    dynamics,
    torque,
    gradient,
    by_pose,
    growth,
    jumps,
    wrench,
    mass,
    period,
    decay,
    mean,
    covariance,
):
    """Changes means and covariances to those after one control period.

    Args:
        dynamics: motion in the middle of the period.
        torque: mean torques on the pulleys, (N, m) [N·m].
        gradient: their derivatives with respect to the state, (N, m, size).
        by_pose: derivatives of Ẍ with respect to the pose at constant torques, (N, n, n).
        growth: variances that the period adds, (N, size).
        jumps: standard deviations of the torques, which move the platform at once, (N, m) [N·m].
        wrench: index of the first component of the wrench in the state.
        mass: index of the mass.
        period: control period [s].
        decay: factor of the wrench.
        mean: pose, velocity and further components, (N, size).
        covariance: (N, size, size).
    """
    n = dynamics.mobility.shape[1]
    size = mean.shape[1]
    acceleration = np.empty(n)
    slopes = np.empty((n, size))
    moved = np.empty((n, size))
    transposed = np.empty((size, size))
    for i in range(len(mean)):
        robot_dynamics = _dynamics_of_robot(dynamics, i)
        estimated_wrench = mean[i, wrench : wrench + n]
        _accelerate(robot_dynamics, torque[i], estimated_wrench, acceleration)
        _write_slopes(robot_dynamics, gradient[i], by_pose[i], acceleration, wrench, mass, slopes)
        mean[i, :n] += period * mean[i, n : 2 * n] + period * period / 2 * acceleration
        mean[i, n : 2 * n] += period * acceleration
        mean[i, wrench : wrench + n] *= decay
        # F P Fᵀ = F (F P)ᵀ
        _advance(slopes, wrench, period, decay, covariance[i], moved)
        transposed[:] = covariance[i].T
        _advance(slopes, wrench, period, decay, transposed, moved)
        covariance[i] = (transposed + transposed.T) / 2
        for c in range(size):
            covariance[i, c, c] += growth[i, c]
        for a in range(n):
            for j in range(jumps.shape[1]):
                jump = period * dynamics.torque_slope[i, a, j] * jumps[i, j]
                covariance[i, n + a, n + a] += jump * jump


@entry_point(seconds=lambda innovation, gradient, *_: _product_seconds(gradient))
def correct(innovation, gradient, variance, mean, covariance):
    """Changes means and covariances to those after readings with independent errors, one reading
    after the other.

    Args:
        innovation: readings minus their expectations, (N, k).
        gradient: derivatives of the readings with respect to the state, (N, k, size).
        variance: variances of their errors, (N, k).
        mean: (N, size).
        covariance: (N, size, size).
    """
    size = mean.shape[1]
    change = np.empty(size)
    crossed = np.empty(size)
    for i in range(len(mean)):
        change[:] = 0.0
        for k in range(innovation.shape[1]):
            slopes = gradient[i, k]
            crossed[:] = 0.0
            for a in range(size):
                if slopes[a] != 0.0:
                    _add_multiple(crossed, slopes[a], covariance[i, a])
            total = _add_products(variance[i, k], slopes, crossed)
            unexplained = innovation[i, k]
            for a in range(size):
                unexplained -= slopes[a] * change[a]
            _add_multiple(change, unexplained / total, crossed)
            for a in range(size):
                _add_multiple(covariance[i, a], -crossed[a] / total, crossed)
        mean[i] += change
