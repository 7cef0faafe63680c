"""Tables of reference motions on the time grids that the compiled steps read."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.observation import PREVIEWS, observed_reference, preview_name
from cablebot_gym.kinematics import Array
from cablebot_gym.trajectories import ORDERS, Trajectory, sampled

LONGEST_MOTION = 1000.0
"""Longest duration of a motion [s]; also the upper bound of ``time_to_go`` in the observation."""

MOST_STEPS = 1_000_000
"""Largest number of control steps of a motion; longer tables would take gigabytes."""

CHANGE_ERROR = 0.05
"""Tolerance of the check of derivatives: largest difference between the integral of a derivative
over a physics step and the change of the lower order, as a fraction of the largest change."""

REST_TOLERANCE = 1e-9
"""Largest motion after the end of a trajectory: velocity [m/s, rad/s] and displacement [m, rad]."""

FAILED_STEPS = 0.1
"""Fraction of the steps that must fail the check before a warning is given: a jump fails in single
steps only."""


class ReferenceTables:
    """Tables of the motions that the environments of a batch follow at present, one table per
    motion.

    ``physics`` (trajectories, rows, n): poses at every physics step, ``substeps`` per control
    period. ``control`` (trajectories, rows, columns): reference blocks of the observation at every
    control instant, with jerk and snap if ``to_snap``. ``physics_ends`` and ``control_ends`` are
    the indices of the last rows: the final pose at rest, which is held from then on.
    """

    def __init__(self, control_frequency: float, substeps: int, *, to_snap: bool) -> None:
        self._frequency = control_frequency
        self._substeps = substeps
        self._to_snap = to_snap
        self._tables: list[tuple[Trajectory, Array, Array]] = []
        self._followed: dict[int, Trajectory] = {}
        self.physics = self.control = np.zeros((0, 0, 0))
        self.physics_ends = self.control_ends = np.zeros(0, np.int64)

    def prepare(self, trajectory: Trajectory) -> None:
        """Tabulates a motion for the next :meth:`follow`, if it has no table yet.

        Raises:
            ValueError: if the motion is too long, has too many steps, or returns values that are
                not finite or not of the right shape. The tables are unchanged then.
        """
        if not any(table[0] is trajectory for table in self._tables):
            self._tables = [*self._tables, (trajectory, *self._tabulate(trajectory))]

    def follow(
        self,
        env_indices: NDArray[np.int64],
        trajectory: Trajectory,
        trajectory_index: NDArray[np.int64],
    ) -> None:
        """Makes the environments ``env_indices`` follow a prepared motion.

        Args:
            env_indices: environments, (k,).
            trajectory: the motion, after :meth:`prepare`.
            trajectory_index: index of each environment's table, (width,); updated here, with the
                fill at its end.
        """
        if all(self._followed.get(env_index) is trajectory for env_index in env_indices.tolist()):
            return
        self._followed.update(dict.fromkeys(env_indices.tolist(), trajectory))
        followed = {id(motion) for motion in self._followed.values()}
        self._tables = [table for table in self._tables if id(table[0]) in followed]
        self.physics, self.physics_ends = _stacked([table[1] for table in self._tables])
        self.control, self.control_ends = _stacked([table[2] for table in self._tables])
        indices = {id(table[0]): index for index, table in enumerate(self._tables)}
        for env_index, motion in self._followed.items():
            trajectory_index[env_index] = indices[id(motion)]
        trajectory_index[len(self._followed) :] = trajectory_index[len(self._followed) - 1]

    def _tabulate(self, trajectory: Trajectory) -> tuple[Array, Array]:
        label = f"trajectory {trajectory.name!r}"
        duration = trajectory.duration
        if not 0 < duration <= LONGEST_MOTION:
            raise ValueError(
                f"{label} lasts {duration} s: its duration must be > 0 and at most {LONGEST_MOTION:g} s"
            )
        steps = int(np.ceil(duration * self._frequency - 1e-9)) + 1
        if steps > MOST_STEPS:
            raise ValueError(
                f"{label} has {steps:,} control steps, more than {MOST_STEPS:,}: lower control_frequency"
            )
        times = np.arange(steps + 1) / self._frequency
        physics_times = np.arange(steps * self._substeps + 1) / (self._frequency * self._substeps)
        orders = _evaluate(trajectory, physics_times, ORDERS if self._to_snap else ORDERS[:3])
        blocks = observed_reference(trajectory, times, to_snap=self._to_snap)
        control = np.concatenate(list(blocks.values()), axis=1)
        if not np.all(np.isfinite(control)):
            raise ValueError(
                f"{label} is not finite after its duration: return its final pose at rest there"
            )
        after = [
            blocks["reference_velocity"][-1],
            *(blocks[preview_name(ahead)][-1] for ahead in PREVIEWS),
        ]
        if np.max(np.abs(after)) > REST_TOLERANCE:
            _warn(
                f"{label} still moves after its duration of {duration:g} s: return its final pose at rest there"
            )
        return np.ascontiguousarray(orders[0]), control


def _warn(message: str) -> None:
    warnings.warn(message, stacklevel=3)


def _evaluate(trajectory: Trajectory, times: Array, orders: tuple[str, ...]) -> list[Array]:
    """The ``orders`` of a motion at the times (K,), each (K, n).

    Warns if an order is not the time derivative of the order below it.

    Raises:
        ValueError: if the values are not finite or not of the right shape.
    """
    label = f"trajectory {trajectory.name!r}"
    checked = sampled(trajectory, times, orders)
    for (below, before), (name, values) in pairwise(zip(orders, checked, strict=True)):
        change = np.diff(before, axis=0)
        integral = np.diff(times)[:, None] * (values[1:] + values[:-1]) / 2
        largest = np.max(np.maximum(np.abs(change), np.abs(integral)), axis=0)
        rounding = 1e-12 * (1 + np.max(np.abs(before), axis=0))
        failed = np.flatnonzero(
            np.any(np.abs(change - integral) > CHANGE_ERROR * largest + rounding, axis=1)
        )
        if len(failed) > max(FAILED_STEPS * len(change), 5):
            _warn(
                f"the {name} of {label} is not the time derivative of its {below}, first at {times[failed[0]]:.3g} s. "
                "Control laws use it as feedforward"
            )
    return checked


def _stacked(tables: list[Array]) -> tuple[Array, Array]:
    """Tables of different lengths as one array, padded with their last rows, and the index of each
    last row."""
    ends = np.array([len(table) - 1 for table in tables], np.int64)
    return np.stack(
        [
            np.pad(table, ((0, ends.max() - end), (0, 0)), "edge")
            for table, end in zip(tables, ends, strict=True)
        ]
    ), ends
