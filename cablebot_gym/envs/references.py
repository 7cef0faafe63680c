"""Tables of reference motions on the time grids that the compiled steps read."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.observation import PREVIEWS, observed_reference, preview_name
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import ORDERS, Trajectory, sampled

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
    """Tables of the motions that the environments of a batch follow, one table per motion.

    ``physics`` (tables, rows, n): poses at every physics step, ``substeps`` per control period.
    ``control`` (tables, rows, columns): reference blocks of the observation at every control
    instant, with jerk and snap if ``to_snap``. ``physics_ends`` and ``control_ends`` are the
    indices of the last rows: the final pose at rest, which is held from then on. A new motion takes
    the place of one that no environment follows any more.
    """

    def __init__(self, control_frequency: float, substeps: int, *, to_snap: bool) -> None:
        self._frequency = control_frequency
        self._substeps = substeps
        self._to_snap = to_snap
        self._prepared: tuple[Trajectory, Array, Array] | None = None
        self._motions: list[Trajectory] = []
        self._table_of_env: dict[int, int] = {}
        self.physics = self.control = np.zeros((0, 0, 0))
        self.physics_ends = self.control_ends = np.zeros(0, np.int64)

    def prepare(self, trajectory: Trajectory) -> None:
        """Tabulates a motion for the next :meth:`follow`, if it has no table yet.

        Raises:
            ValueError: if the motion is too long, has too many steps, or returns values that are
                not finite or not of the right shape. The tables are unchanged then.
        """
        if self._find(trajectory) is None:
            self._prepared = (trajectory, *self._tabulate(trajectory))

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
        table = self._find(trajectory)
        for env_index in env_indices.tolist():
            self._table_of_env.pop(env_index, None)
        if table is None:
            table = self._store()
        self._table_of_env.update(dict.fromkeys(env_indices.tolist(), table))
        trajectory_index[env_indices] = table
        followed = len(self._table_of_env)
        trajectory_index[followed:] = trajectory_index[followed - 1]

    def _find(self, trajectory: Trajectory) -> int | None:
        """Index of the table of a motion; None if it has none."""
        for table, motion in enumerate(self._motions):
            if motion is trajectory:
                return table
        return None

    def _store(self) -> int:
        """Stores the prepared motion and returns the index of its table."""
        assert self._prepared is not None
        trajectory, physics, control = self._prepared
        unused = set(range(len(self._motions))) - set(self._table_of_env.values())
        table = min(unused, default=len(self._motions))
        self._motions[table : table + 1] = [trajectory]
        self.physics, self.physics_ends = _with_table(
            self.physics, self.physics_ends, table, physics
        )
        self.control, self.control_ends = _with_table(
            self.control, self.control_ends, table, control
        )
        self._prepared = None
        return table

    def _tabulate(self, trajectory: Trajectory) -> tuple[Array, Array]:
        label = f"trajectory {trajectory.name!r}"
        duration = trajectory.duration
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


def _with_table(
    tables: Array, ends: NDArray[np.int64], index: int, rows: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Tables (tables, rows, columns) and the index of each last row, with other rows at ``index``,
    which may be one past the end. The rows after the last one of a table are never read."""
    count = len(tables)
    if index == count:
        count = max(1, 2 * count)  # copied rarely
    longest = max(len(rows), *tables.shape[1:2])
    if (count, longest) != tables.shape[:2]:
        larger = np.zeros((count, longest, rows.shape[1]))
        larger[: len(tables), : tables.shape[1], : tables.shape[2]] = tables
        tables = larger
        ends = np.append(ends, np.zeros(count - len(ends), np.int64))
    tables[index, : len(rows)] = rows
    ends[index] = len(rows) - 1
    return tables, ends
