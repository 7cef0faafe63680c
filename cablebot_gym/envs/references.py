"""Reference motions tabulated on the grids on which the compiled steps read them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.observation import PREVIEWS, preview_name
from cablebot_gym.kinematics import Array
from cablebot_gym.trajectories import Reference, Trajectory

LONGEST_MOTION = 1000.0
"""Longest motion that is tabulated [s]; the observation's clock ends there too."""

MOST_STEPS = 1_000_000
"""Of a motion, at the control frequency: beyond, tables would take gigabytes."""


def observed_reference(trajectory: Trajectory, times: Array, *, to_snap: bool) -> dict[str, Array]:
    """What an observation says of the reference at each time (K,): its blocks by name, each (K, size), in order.

    Args:
        trajectory: the reference.
        times: since the episode's start [s].
        to_snap: whether the robot is flexible.
    """
    now = trajectory(times)
    derivatives = {"pose": now.position, "velocity": now.velocity, "acceleration": now.acceleration}
    if to_snap:
        derivatives |= {"jerk": now.jerk, "snap": now.snap}
    return {
        "time_left": np.maximum(trajectory.duration - times, 0.0)[:, None],
        **{f"reference_{name}": values for name, values in derivatives.items()},
        **{preview_name(ahead): trajectory(times + ahead).position - now.position for ahead in PREVIEWS},
    }


class ReferenceTables:
    """The motions that some lane of a batch follows now, tabulated once each, to snap if ``to_snap``.

    ``physics``: poses at every physics step, ``substeps`` a control period, (trajectories, lines, n); ``control``: the
    observation's reference part at every control instant, (trajectories, lines, columns). The last line of each, at
    ``physics_ends`` and ``control_ends``, is the motion's last pose at rest and holds for ever.
    """

    def __init__(self, control_frequency: float, substeps: int, *, to_snap: bool) -> None:
        self._frequency, self._substeps, self._to_snap = control_frequency, substeps, to_snap
        self._tables: list[tuple[Trajectory, Array, Array]] = []
        self._followed: dict[int, Trajectory] = {}
        self.physics = self.control = np.zeros((0, 0, 0))
        self.physics_ends = self.control_ends = np.zeros(0, np.int64)

    def prepare(self, trajectory: Trajectory) -> None:
        """Tabulates a motion, if it is new, for the next :meth:`follow`.

        Raises:
            ValueError: if the motion is too long, has too many steps, or is not finite numbers of the right shape;
                nothing has changed then.
        """
        if not any(table[0] is trajectory for table in self._tables):
            self._tables = [*self._tables, (trajectory, *self._tabulate(trajectory))]

    def follow(self, lanes: NDArray[np.int64], trajectory: Trajectory, which: NDArray[np.int64]) -> None:
        """Lets ``lanes`` follow a prepared motion; ``which`` (width,) is brought up to date, fill lanes included."""
        if all(self._followed.get(lane) is trajectory for lane in lanes.tolist()):
            return
        self._followed.update(dict.fromkeys(lanes.tolist(), trajectory))
        wanted = {id(motion): motion for motion in self._followed.values()}
        self._tables = [table for table in self._tables if id(table[0]) in wanted]
        self.physics, self.physics_ends = _stacked([table[1] for table in self._tables])
        self.control, self.control_ends = _stacked([table[2] for table in self._tables])
        places = {id(table[0]): place for place, table in enumerate(self._tables)}
        for lane, motion in self._followed.items():
            which[lane] = places[id(motion)]
        which[len(self._followed) :] = which[len(self._followed) - 1]

    def _tabulate(self, trajectory: Trajectory) -> tuple[Array, Array]:
        if not 0 < trajectory.duration <= LONGEST_MOTION:
            raise ValueError(f"a motion lasts up to {LONGEST_MOTION:g} s here, not {trajectory.duration} s")
        steps = int(np.ceil(trajectory.duration * self._frequency - 1e-9)) + 1
        if steps > MOST_STEPS:
            raise ValueError(
                f"a motion has up to {MOST_STEPS:,} control steps here, not {steps:,} ({trajectory.duration:g} s at "
                f"{self._frequency:g} Hz): choose a lower control_frequency"
            )
        rate = self._frequency * self._substeps
        times = np.arange(steps + 1) / self._frequency
        now = trajectory(times)
        if not isinstance(now, Reference):
            raise ValueError(f"trajectory {trajectory.name!r} must return a Reference, not {type(now).__name__}")
        physics = trajectory(np.arange(steps * self._substeps + 1) / rate).position
        blocks = observed_reference(trajectory, times, to_snap=self._to_snap)
        control = np.concatenate(list(blocks.values()), axis=1)
        if physics.shape != (steps * self._substeps + 1, trajectory.coordinates) or not np.all(np.isfinite(physics)):
            raise ValueError(f"trajectory {trajectory.name!r} must give finite poses (..., {trajectory.coordinates})")
        if not np.all(np.isfinite(control)):
            raise ValueError(f"trajectory {trajectory.name!r} must give finite velocities and accelerations")
        return np.ascontiguousarray(physics), control


def _stacked(tables: list[Array]) -> tuple[Array, Array]:
    """Tables of different lengths as one array, the rest filled with their last line, and where that line stands."""
    ends = np.array([len(table) - 1 for table in tables], np.int64)
    stack = np.zeros((len(tables), ends.max() + 1, tables[0].shape[1]))
    for place, table in enumerate(tables):
        stack[place, : len(table)] = table
        stack[place, len(table) :] = table[-1]
    return stack, ends
