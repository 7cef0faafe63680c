"""Reference motions tabulated on the grids on which the compiled steps read them."""

from __future__ import annotations

import warnings
from dataclasses import fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.observation import PREVIEWS, observed_reference, preview_name
from cablebot_gym.kinematics import Array
from cablebot_gym.trajectories import Reference, Trajectory

LONGEST_MOTION = 1000.0
"""Longest motion that is tabulated [s]; the observation's clock ends there too."""

MOST_STEPS = 1_000_000
"""Of a motion, at the control frequency: beyond, tables would take gigabytes."""

ORDERS = tuple(field.name for field in fields(Reference))
"""Of a motion: its position and the derivatives of it."""

CHANGE_ERROR = 0.05
"""A derivative is doubted where its integral over a physics step is further than this from the change of what it is
the derivative of, as a share of the largest change."""

STANDING = 1e-9
"""After its duration a motion moves less than this, m/s or m and rad/s or rad."""

DOUBTED_STEPS = 0.1
"""Share of the steps from which on a doubt is told: a jump concerns single ones."""


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
        physics_times = np.arange(steps * self._substeps + 1) / rate
        checked = _checked(trajectory, physics_times, ORDERS if self._to_snap else ORDERS[:3])
        blocks = observed_reference(trajectory, times, to_snap=self._to_snap)
        control = np.concatenate(list(blocks.values()), axis=1)
        if not np.all(np.isfinite(control)):
            raise ValueError(
                f"trajectory {trajectory.name!r} is not finite after its duration: hold its last pose there, at rest"
            )
        after = [blocks["reference_velocity"][-1], *(blocks[preview_name(ahead)][-1] for ahead in PREVIEWS)]
        if np.max(np.abs(after)) > STANDING:
            warnings.warn(
                f"trajectory {trajectory.name!r} moves on after its duration of {trajectory.duration:g} s: hold its "
                "last pose there, at rest",
                stacklevel=2,
            )
        return np.ascontiguousarray(checked[0]), control


def _checked(trajectory: Trajectory, times: Array, orders: tuple[str, ...]) -> list[Array]:
    """A motion's ``orders`` at each time, (K, n) each; warns of a derivative that is none.

    Raises:
        ValueError: if one is not finite numbers of the right shape.
    """
    who = f"trajectory {trajectory.name!r}"
    motion = trajectory(times)
    if not isinstance(motion, Reference):
        raise ValueError(f"{who} must return a Reference, not {type(motion).__name__}")
    shape = (len(times), trajectory.coordinates)
    checked = [np.asarray(getattr(motion, name)) for name in orders]
    for name, values in zip(orders, checked, strict=True):
        if values.shape != shape:
            raise ValueError(
                f"{who} must give each {name} as (..., {shape[1]}): at {shape[0]} times {shape}, not {values.shape}"
            )
        if not np.all(np.isfinite(values)):
            late = times[np.flatnonzero(~np.all(np.isfinite(values), axis=1))[0]]
            raise ValueError(f"{who} must give finite numbers, and its {name} at {late:g} s is not")
    for (below, before), (name, values) in pairwise(zip(orders, checked, strict=True)):
        change = np.diff(before, axis=0)
        integral = np.diff(times)[:, None] * (values[1:] + values[:-1]) / 2
        largest = np.max(np.maximum(np.abs(change), np.abs(integral)), axis=0)
        rounding = 1e-12 * (1 + np.max(np.abs(before), axis=0))
        doubted = np.any(np.abs(change - integral) > CHANGE_ERROR * largest + rounding, axis=1)
        if np.count_nonzero(doubted) > max(DOUBTED_STEPS * len(doubted), 5):
            place = np.flatnonzero(doubted)[0]
            warnings.warn(
                f"the {name} of {who} is not the time derivative of its {below}, first at {times[place]:.3g} s: laws "
                "feed it forward",
                stacklevel=2,
            )
    return checked


def _stacked(tables: list[Array]) -> tuple[Array, Array]:
    """Tables of different lengths as one array, the rest filled with their last line, and where that line stands."""
    ends = np.array([len(table) - 1 for table in tables], np.int64)
    stack = np.zeros((len(tables), ends.max() + 1, tables[0].shape[1]))
    for place, table in enumerate(tables):
        stack[place, : len(table)] = table
        stack[place, len(table) :] = table[-1]
    return stack, ends
