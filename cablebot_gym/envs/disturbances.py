"""What acts on running episodes beside the commands: external wrench, sensor noise, late commands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.streams import NormalRows, Purpose, Streams
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import Uncertainty

Lanes = NDArray[np.int64]


class Disturbances:
    """The disturbances of N lanes, each by the uncertainty of its episode. Memory is taken when one is used first."""

    def __init__(self, robot: Robot, count: int, control_frequency: float, streams: Streams) -> None:
        self._robot, self._count, self._frequency, self._streams = robot, count, control_frequency, streams
        self._everyone = np.arange(count)
        self._hold = np.zeros(count, np.int64)
        self._wrench_mean = self._wrench_std = self._factor = np.zeros((count, 0))
        self._wrench: NormalRows | None = None
        self._noise_std = np.zeros((count, 0))
        self._noise: NormalRows | None = None
        self.noise = np.zeros((count, 0))
        """Present noise on the measured part of the observation, (N, components), or (N, 0) before any is noisy."""
        self._delay = np.zeros(count, np.int64)
        self._pending = np.zeros((count, 0, robot.cables))
        self.quiet = True
        """Whether no lane has ever had a disturbance: then none of the methods below needs to be called."""

    def begin(self, lanes: Lanes, uncertainty: Uncertainty, holding: Array) -> None:
        """Starts episodes in ``lanes``; ``holding`` (len(lanes), m) are the commands until the first one arrives."""
        self.quiet &= uncertainty.wrench is None and uncertainty.sensors is None and uncertainty.delay == 0
        if self.quiet:
            return
        self._begin_wrench(lanes, uncertainty)
        self._begin_noise(lanes, uncertainty)
        delay = uncertainty.delay
        if delay > self._pending.shape[1]:
            longer = np.zeros((self._count, delay, self._robot.cables))
            longer[:, : self._pending.shape[1]] = self._pending
            self._pending = longer
        self._delay[lanes] = delay
        if delay:
            self._pending[lanes, :delay] = holding[:, None]

    def _begin_wrench(self, lanes: Lanes, uncertainty: Uncertainty) -> None:
        self._hold[lanes] = 0
        if uncertainty.wrench is None:
            return
        mean, std = uncertainty.wrench.statistics(self._robot)
        if self._wrench is None:
            self._wrench_mean, self._wrench_std, self._factor = (np.zeros((self._count, mean.size)) for _ in range(3))
            self._wrench = NormalRows(self._streams, Purpose.WRENCH, self._count, mean.size)
        self._wrench.restart(lanes)
        periods = min(uncertainty.wrench.correlation_time * self._frequency, 2.0**62)  # whole numbers end there
        self._hold[lanes] = max(1, round(periods))
        self._wrench_mean[lanes], self._wrench_std[lanes] = mean, std
        low, high = uncertainty.wrench.factor
        self._factor[lanes] = low + (high - low) * self._streams.uniform(lanes, Purpose.WRENCH_FACTOR, mean.size)

    def _begin_noise(self, lanes: Lanes, uncertainty: Uncertainty) -> None:
        if uncertainty.sensors is None:
            self._noise_std[lanes] = 0.0
            return
        std = uncertainty.sensors.deviations(self._robot)
        if self._noise is None:
            self._noise_std, self.noise = np.zeros((self._count, std.size)), np.zeros((self._count, std.size))
            self._noise = NormalRows(self._streams, Purpose.SENSORS, self._count, std.size)
        self._noise.restart(lanes)
        self._noise_std[lanes] = std

    def late(self, action: Array) -> Array:
        """The commands (N, m) that arrive now, when ``action`` is sent, (N, m), or (m,) of one lane."""
        late = self._delay > 0
        if not late.any():
            return action
        action = action.reshape(self._count, -1)
        arriving = np.where(late[:, None], self._pending[:, 0], action)
        self._pending[:, :-1] = self._pending[:, 1:]
        self._pending[late, self._delay[late] - 1] = action[late]
        return arriving

    def push(self, plant: Plant) -> None:
        """Redraws the wrench of the lanes whose draw has lasted its time."""
        if self._wrench is None:
            return
        step = plant.step_index[: self._count]
        due = np.flatnonzero((self._hold > 0) & (step % np.maximum(self._hold, 1) == 0))
        if due.size:
            normal = self._wrench.at(due, step[due] // self._hold[due])
            wrench = self._factor[due] * (self._wrench_mean[due] + self._wrench_std[due] * normal)
            if self._robot.planar:
                plant.set_wrench(due, wrench)
            else:
                plant.set_wrench(due, wrench[:, :3], wrench[:, 3:])

    def measure(self, lanes: Lanes, step: NDArray[np.int64]) -> None:
        """Draws :attr:`noise` of ``lanes`` at their control steps."""
        if self._noise is not None:
            self.noise[lanes] = self._noise_std[lanes] * self._noise.at(lanes, step)
