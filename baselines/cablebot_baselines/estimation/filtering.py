"""Compiled parts of the observer, one robot of a batch after the other: NumPy would take most of its
time for its calls."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics.inlining import entry_point, helper
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
    n, m = robot.coordinates, robot.cables
    count = len(masses)
    # Load and y are affine in Ẍ and in the mass: without acceleration and with 1 of each
    # coordinate, for the masses and for 1 kg more.
    motion = np.zeros((3, 2, count, n + 1, n))
    motion[0], motion[1] = pose[:, None], velocity[:, None]
    motion[2, ..., 1:, :] = np.eye(n)
    both = np.empty((2, count, n + 1))
    both[0] = masses[:, None]
    both[1] = both[0] + 1.0
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
    _combine(demands(robot, both, motion), pulleys, dynamics)
    return dynamics


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
            factor = matrix[a, p]
            if a != p:
                for c in range(size):
                    matrix[a, c] -= factor * matrix[p, c]
                    inverse[a, c] -= factor * inverse[p, c]


@helper
def _write_structure(demand, i, y_slope, dynamics):
    """∂y/∂Ẍ, S and the pulley speeds of robot i."""
    n, m = dynamics.torque_slope.shape[1:]
    for a in range(n):
        for b in range(n):
            y_slope[a, b] = demand.y[0, i, 1 + b, a] - demand.y[0, i, 0, a]
    for j in range(m):
        dynamics.pulley_speed[i, j] = demand.speeds[0, i, 0, j]
        for b in range(n):
            total = 0.0
            for a in range(n):
                total += demand.structure[0, i, 0, j, a] * y_slope[a, b]
            dynamics.structure[i, j, b] = total


@entry_point
def _combine(demand, pulleys, dynamics):
    """Writes dynamics from the demands of (2, N, n + 1) motions, see :func:`dynamics_of`.

    ``pulleys`` are radius, inertia and damping, (3, m).
    """
    n, m = dynamics.torque_slope.shape[1:]
    y_slope = np.empty((n, n))
    inertia = np.empty((n, n))
    for i in range(len(dynamics.mobility)):
        _write_structure(demand, i, y_slope, dynamics)
        structure = dynamics.structure[i]
        for a in range(n):
            bias, heavier_bias = 0.0, 0.0
            for c in range(n):
                bias += y_slope[c, a] * demand.load[0, i, 0, c]
                heavier_bias += y_slope[c, a] * demand.load[1, i, 0, c]
            dynamics.bias_per_mass[i, a] = heavier_bias - bias
            dynamics.passive_wrench[i, a] = -bias
            for j in range(m):
                drag = pulleys[1, j] * demand.pulley_accelerations[0, i, 0, j]
                drag += pulleys[2, j] * demand.speeds[0, i, 0, j]
                dynamics.passive_wrench[i, a] += structure[j, a] * drag / pulleys[0, j]
            for b in range(n):
                entry, heavier = 0.0, 0.0
                for c in range(n):
                    load = demand.load[0, i, 1 + b, c] - demand.load[0, i, 0, c]
                    heavier_load = demand.load[1, i, 1 + b, c] - demand.load[1, i, 0, c]
                    entry += y_slope[c, a] * load
                    heavier += y_slope[c, a] * heavier_load
                dynamics.matrix_per_mass[i, a, b] = heavier - entry
                for j in range(m):
                    rotor_mass = pulleys[1, j] / pulleys[0, j] ** 2
                    entry += structure[j, a] * rotor_mass * structure[j, b]
                inertia[a, b] = entry
        _invert(inertia, dynamics.mobility[i])
        for a in range(n):
            for j in range(m):
                total = 0.0
                for b in range(n):
                    total -= dynamics.mobility[i, a, b] * structure[j, b]
                dynamics.torque_slope[i, a, j] = total / pulleys[0, j]


@entry_point
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
                rates[i, age] = 1.0 / period if age > periods else -1.0 / period
    return weights, rates


@entry_point
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
    for i in range(len(mass)):
        for j in range(motors.shape[1]):
            stall, slope = motors[0, j], motors[1, j]
            requested, requested_rate, held, held_rate = 0.0, 0.0, 0.0, 0.0
            for k in range(weights.shape[1]):
                if k < sent[i]:
                    action = min(max(actions[i, k, j], -1.0), 1.0)
                    requested += weights[i, k] * action
                    requested_rate += rates[i, k] * action
                else:
                    held += weights[i, k]
                    held_rate += rates[i, k]
            unit = stall * requested - (1.0 - held) * slope * speed[i, j]
            rate = stall * requested_rate + held_rate * slope * speed[i, j]
            torque = holding[i, j, 0] * mass[i] + holding[i, j, 1]
            drives[0, i, j] = strength[i, j] * unit + held * torque
            drives[1, i, j] = unit
            drives[2, i, j] = strength[i, j] * rate + held_rate * torque
            drives[3, i, j] = held * holding[i, j, 0]


@helper
def _accelerate(dynamics, i, torque, gradient, wrench, mass, mean, acceleration, slopes):
    """Ẍ of robot i, and its derivatives with respect to the state."""
    n, m = dynamics.torque_slope.shape[1:]
    for a in range(n):
        total = 0.0
        for b in range(n):
            force = mean[i, wrench + b] + dynamics.passive_wrench[i, b]
            total += dynamics.mobility[i, a, b] * force
        for j in range(m):
            total += dynamics.torque_slope[i, a, j] * torque[i, j]
        acceleration[a] = total
    slopes[:] = 0.0
    for a in range(n):
        for j in range(m):
            slope = dynamics.torque_slope[i, a, j]
            for c in range(slopes.shape[1]):
                slopes[a, c] += slope * gradient[i, j, c]
        for b in range(n):
            slopes[a, wrench + b] += dynamics.mobility[i, a, b]
            change = dynamics.bias_per_mass[i, b]
            for c in range(n):
                change += dynamics.matrix_per_mass[i, b, c] * acceleration[c]
            slopes[a, mass] -= dynamics.mobility[i, a, b] * change


@helper
def _multiply(sparse, matrix, product):
    """Product of a matrix with many zeros and another matrix."""
    product[:] = 0.0
    for a in range(len(sparse)):
        for b in range(len(matrix)):
            factor = sparse[a, b]
            if factor != 0.0:
                for c in range(product.shape[1]):
                    product[a, c] += factor * matrix[b, c]


@entry_point
def predict(
    dynamics, torque, gradient, growth, jumps, wrench, mass, period, decay, mean, covariance
):
    """Changes means and covariances to those after one control period.

    Args:
        dynamics: motion in the middle of the period.
        torque: mean torques on the pulleys, (N, m) [N·m].
        gradient: their derivatives with respect to the state, (N, m, size).
        growth: variances that the period adds, (N, size).
        jumps: standard deviations of the torques, which move the platform at once, (N, m) [N·m].
        wrench: index of the first component of the wrench in the state.
        mass: index of the mass.
        period: control period [s].
        decay: factor of the wrench.
        mean: pose, velocity and further components, (N, size).
        covariance: (N, size, size).
    """
    n, m = dynamics.torque_slope.shape[1:]
    size = mean.shape[1]
    acceleration = np.empty(n)
    slopes = np.empty((n, size))
    transition = np.empty((size, size))
    product = np.empty((size, size))
    for i in range(len(mean)):
        _accelerate(dynamics, i, torque, gradient, wrench, mass, mean, acceleration, slopes)
        transition[:] = 0.0
        for c in range(size):
            transition[c, c] = 1.0
        for a in range(n):
            transition[a, n + a] = period
            transition[wrench + a, wrench + a] = decay
            for c in range(size):
                transition[a, c] += period * period / 2 * slopes[a, c]
                transition[n + a, c] += period * slopes[a, c]
            mean[i, a] += period * mean[i, n + a] + period * period / 2 * acceleration[a]
            mean[i, n + a] += period * acceleration[a]
            mean[i, wrench + a] *= decay
        # F P Fᵀ = F (F P)ᵀ
        _multiply(transition, covariance[i], product)
        _multiply(transition, product.T, covariance[i])
        for c in range(size):
            covariance[i, c, c] += growth[i, c]
            for d in range(c):
                mean_entry = (covariance[i, c, d] + covariance[i, d, c]) / 2
                covariance[i, c, d] = covariance[i, d, c] = mean_entry
        for a in range(n):
            for j in range(m):
                jump = period * dynamics.torque_slope[i, a, j] * jumps[i, j]
                covariance[i, n + a, n + a] += jump * jump


@entry_point
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
            total = variance[i, k]
            rest = innovation[i, k]
            for a in range(size):
                crossed[a] = 0.0
                for b in range(size):
                    crossed[a] += covariance[i, a, b] * gradient[i, k, b]
                total += gradient[i, k, a] * crossed[a]
                rest -= gradient[i, k, a] * change[a]
            for a in range(size):
                change[a] += crossed[a] * rest / total
                for b in range(size):
                    covariance[i, a, b] -= crossed[a] * crossed[b] / total
        for a in range(size):
            mean[i, a] += change[a]
