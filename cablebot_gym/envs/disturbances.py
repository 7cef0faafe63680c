"""Disturbances of running episodes: external wrench, sensor noise and bias, and actuation delay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.streams import NormalRows, Purpose, Streams
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import Measurement
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import SensorNoise, Uncertainty

EnvIndices = NDArray[np.int64]


class Disturbances:
    """Disturbances of N environments, from the uncertainties of their episodes. Allocates memory at
    first use."""

    def __init__(
        self,
        robot: Robot,
        measurement: Measurement,
        count: int,
        control_frequency: float,
        streams: Streams,
    ) -> None:
        self._robot = robot
        self._measurement = measurement
        self._count = count
        self._frequency = control_frequency
        self._streams = streams
        self._all_indices = np.arange(count)
        self._wrench_interval = np.zeros(count, np.int64)  # [control steps], 0 without wrench
        self._wrench_mean = self._wrench_std = self._factor = np.zeros((count, 0))
        self._wrench: NormalRows | None = None
        self._noise_std = self._bias = np.zeros((count, 0))
        self._noise: NormalRows | None = None
        self.noise = np.zeros((count, 0))
        """Present noise and bias on the measured blocks of the observation, (N, components); (N, 0)
        without any."""
        self._delay = np.zeros(count, np.int64)
        self._pending = np.zeros((count, 0, robot.cables))
        self.quiet = True
        """Whether no environment has had a disturbance so far. If so, only :meth:`reset` needs to
        be called."""

    def reset(self, env_indices: EnvIndices, uncertainty: Uncertainty, holding: Array) -> None:
        """Starts episodes in ``env_indices``.

        Args:
            env_indices: environments, (k,).
            uncertainty: the uncertainty of these episodes.
            holding: actions that are applied until the first delayed action arrives, (k, m).
        """
        shortest, longest = uncertainty.delay_range
        has_noise = uncertainty.sensors is not None or uncertainty.sensor_bias is not None
        self.quiet &= uncertainty.wrench is None and not has_noise and longest == 0
        if self.quiet:
            return
        self._reset_wrench(env_indices, uncertainty)
        self._reset_noise(env_indices, uncertainty)
        capacity = self._pending.shape[1]
        if longest > capacity:
            pending = np.zeros((self._count, longest, self._robot.cables))
            pending[:, :capacity] = self._pending
            self._pending = pending
        self._delay[env_indices] = shortest
        if longest > shortest:
            uniform = self._streams.uniform(env_indices, Purpose.DELAY, 1)[:, 0]
            additional = uniform * (longest - shortest + 1)
            self._delay[env_indices] += additional.astype(np.int64)
        if longest:
            self._pending[env_indices, :longest] = holding[:, None]

    def _reset_wrench(self, env_indices: EnvIndices, uncertainty: Uncertainty) -> None:
        self._wrench_interval[env_indices] = 0
        if uncertainty.wrench is None:
            return
        mean, std = uncertainty.wrench.statistics(self._robot)
        components = mean.size
        if self._wrench is None:
            self._wrench_mean = np.zeros((self._count, components))
            self._wrench_std = np.zeros((self._count, components))
            self._factor = np.zeros((self._count, components))
            self._wrench = NormalRows(self._streams, Purpose.WRENCH, self._count, components)
        self._wrench.restart(env_indices)
        # the largest int64 is 2^63 − 1
        periods = min(uncertainty.wrench.correlation_time * self._frequency, 2.0**62)
        self._wrench_interval[env_indices] = max(1, round(periods))
        self._wrench_mean[env_indices] = mean
        self._wrench_std[env_indices] = std
        low, high = uncertainty.wrench.factor
        uniform = self._streams.uniform(env_indices, Purpose.WRENCH_FACTOR, components)
        self._factor[env_indices] = low + (high - low) * uniform

    def _reset_noise(self, env_indices: EnvIndices, uncertainty: Uncertainty) -> None:
        if uncertainty.sensors is None and uncertainty.sensor_bias is None:
            self._noise_std[env_indices] = self._bias[env_indices] = 0.0
            return
        white = uncertainty.sensors or SensorNoise()
        bias = uncertainty.sensor_bias or SensorNoise()
        noise_std = white.deviations(self._robot, self._measurement)
        bias_std = bias.deviations(self._robot, self._measurement)
        components = noise_std.size
        if self._noise is None:
            self._noise_std = np.zeros((self._count, components))
            self._bias = np.zeros((self._count, components))
            self.noise = np.zeros((self._count, components))
            self._noise = NormalRows(self._streams, Purpose.SENSORS, self._count, components)
        self._noise.restart(env_indices)
        self._noise_std[env_indices] = noise_std
        first = np.zeros(len(env_indices), np.int64)
        normal = self._streams.normal(env_indices, Purpose.SENSOR_BIAS, first, (components,))
        self._bias[env_indices] = bias_std * normal

    def delayed(self, action: Array) -> Array:
        """The actions (N, m) that arrive now; ``action`` is sent now, (N, m), or (m,) for one
        environment."""
        is_late = self._delay > 0
        if not is_late.any():
            return action
        action = action.reshape(self._count, -1)
        arriving = np.where(is_late[:, None], self._pending[:, 0], action)
        self._pending[:, :-1] = self._pending[:, 1:]
        self._pending[is_late, self._delay[is_late] - 1] = action[is_late]
        return arriving

    def update_wrench(self, plant: Plant) -> None:
        """Draws a new wrench for the environments in which the correlation time has elapsed."""
        if self._wrench is None:
            return
        step = plant.step_index[: self._count]
        interval = self._wrench_interval
        is_new = step % np.maximum(interval, 1) == 0
        due = np.flatnonzero((interval > 0) & is_new)
        if due.size:
            normal = self._wrench.at(due, step[due] // interval[due])
            wrench = self._wrench_mean[due] + self._wrench_std[due] * normal
            wrench = self._factor[due] * wrench
            d = self._robot.dimensions
            plant.set_wrench(due, wrench[:, :d], wrench[:, d:])

    def measure(self, env_indices: EnvIndices, step: NDArray[np.int64]) -> None:
        """Draws :attr:`noise` of the environments ``env_indices`` at their control steps ``step``,
        (k,)."""
        if self._noise is not None:
            white = self._noise_std[env_indices] * self._noise.at(env_indices, step)
            self.noise[env_indices] = self._bias[env_indices] + white
