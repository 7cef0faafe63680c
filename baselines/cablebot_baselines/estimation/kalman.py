"""State and arithmetic of the extended Kalman filter."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cablebot_baselines.estimation.errors import FilterErrors
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import times_vector
from cablebot_gym.robots import Robot

LEAST_DEVIATION = 1e-6
"""Least deviation of a reading, in its unit. The arithmetic needs it for exact sensors."""


class Columns:
    """Columns of the state of N episodes, k in total. A part that the filter does not estimate is
    empty.

    Args:
        robot: nominal robot with joint springs in place of elastic cables.
        errors: the expected errors.
        names: names of the blocks of the observation.
        quantised: whether the encoders have a resolution.
    """

    def __init__(
        self, robot: Robot, errors: FilterErrors, names: frozenset[str], *, quantised: bool
    ) -> None:
        n = robot.coordinates
        m = robot.cables
        springs = m * robot.flexible
        base_error, platform_error = errors.anchors
        has_mass_error = errors.mass > 0 or errors.payload > 0
        self.total = 0
        self.pose = self._next(n)
        """Pose X."""
        self.velocity = self._next(n)
        """Velocity Ẋ."""
        self.disturbance = self._next(n)
        """Disturbance d, an acceleration [m/s², rad/s²]."""
        self.zero = self._next(m)
        """Zero errors of the motor angles [rad]."""
        self.quantisation = self._next(m, quantised)
        """Quantisation errors of the last motor angles [rad]."""
        self.last_noise = self._next(springs)
        """Noise of the motor speeds before the last ones [rad/s]."""
        self.noise = self._next(springs)
        """Noise of the last motor speeds [rad/s]."""
        self.compliance = self._next(springs, errors.compliance is not None)
        """Relative errors of the compliances 1/K."""
        self.torque = self._next(m, errors.torque > 0)
        """Error of the torque on the pulleys [N·m]."""
        self.strength = self._next(m, errors.strength > 0)
        """Relative errors of the torques of the motors."""
        self.rotor = self._next(springs, errors.rotor > 0)
        """Relative errors of the motor inertias."""
        self.lag = self._next(m, errors.lag > 0)
        """Lags of the motor torques [s]."""
        self.mass = self._next(1, has_mass_error)
        """Error of the mass of platform and payload [kg]."""
        self.base = self._next(robot.base.size, base_error > 0)
        """Errors of the base anchors [m], cable by cable."""
        self.platform = self._next(robot.platform.size, platform_error > 0)
        """Errors of the platform anchors [m], cable by cable."""
        self.cell = self._next(m, "tensions" in names)
        """Biases of the load cells [N]."""
        self.orientation = self._next(3, "orientation" in names)
        """Biases of the orientation [rad]."""

    def _next(self, size: int, is_estimated: bool = True) -> slice:
        start = self.total
        if is_estimated:
            self.total += size
        return slice(start, self.total)


@dataclass(frozen=True, kw_only=True, eq=False)
class KalmanState:
    """State of the filter for N episodes."""

    mean: Array
    """Mean of the parts of :class:`Columns`, (N, k)."""
    covariance: Array
    """Covariance of ``mean``, (N, k, k)."""
    angle: Array
    """Last motor angles as measured, (N, m) [rad]."""
    speed: Array
    """Last motor speeds, (N, m) [rad/s]."""
    motor_torque: Array
    """Mean torques of the motors in the last control period, (N, m) [N·m]."""
    slow_speed: Array
    """Motor speeds without most of their noise, (N, m) [rad/s]."""
    tensions: Array
    """Predicted mean tensions in the last control period, (N, m) [N]."""


class Readings:
    """Innovations of the sensors of N episodes, their gradient with respect to the state, and their
    variances.

    Args:
        count: number of episodes, N.
        size: number of columns of the state, k.
    """

    def __init__(self, count: int, size: int) -> None:
        self._shape = (count, size)
        self._innovations: list[Array] = []
        self._gradients: list[Array] = []
        self._variances: list[Array] = []

    def add(
        self, innovation: Array, variance: Array | float, *parts: tuple[slice, Array | float]
    ) -> None:
        """Adds readings of one kind.

        Args:
            innovation: reading minus its prediction, (N, j).
            variance: variance of the independent errors, broadcast to (N, j);
                :data:`LEAST_DEVIATION` is added.
            parts: columns of the state and the gradient with respect to them, broadcast to (N, j,
                columns); a number stands for a multiple of the identity. Empty columns are skipped.
        """
        count, size = self._shape
        readings = innovation.shape[-1]
        identity = np.eye(readings)
        gradient = np.zeros((count, readings, size))
        for columns, part in parts:
            if columns.start == columns.stop:
                continue
            if np.ndim(part) == 0:
                part = part * identity
            gradient[:, :, columns] += part
        variances = np.broadcast_to(variance + LEAST_DEVIATION**2, innovation.shape)
        self._innovations.append(innovation)
        self._gradients.append(gradient)
        self._variances.append(variances)

    def corrected(
        self, mean: Array, covariance: Array, at: Array | None = None
    ) -> tuple[Array, Array]:
        """Mean and covariance after the readings.

        Args:
            mean: mean before the readings, (N, k).
            covariance: covariance before the readings, (N, k, k).
            at: state for which the readings were predicted, (N, k); None for ``mean``.
        """
        innovation = np.concatenate(self._innovations, axis=-1)
        gradient = np.concatenate(self._gradients, axis=-2)
        variance = np.concatenate(self._variances, axis=-1)
        if at is not None:
            innovation = innovation + times_vector(gradient, at - mean)
        crossed = covariance @ gradient.mT
        readings = variance.shape[-1]
        noise = variance[..., None] * np.eye(readings)
        innovation_covariance = gradient @ crossed + noise
        gain = _solved(innovation_covariance, crossed.mT).mT
        mean = mean + times_vector(gain, innovation)
        covariance = covariance - gain @ crossed.mT
        covariance = (covariance + covariance.mT) / 2
        return mean, covariance


def _solved(left: Array, right: Array) -> Array:
    """Solutions of N systems; NaN where one has none, so that the others keep theirs."""
    try:
        return np.linalg.solve(left, right)
    except np.linalg.LinAlgError:
        solutions = np.full(right.shape, np.nan)
    for episode in range(len(left)):
        with suppress(np.linalg.LinAlgError):
            solutions[episode] = np.linalg.solve(left[episode], right[episode])
    return solutions
