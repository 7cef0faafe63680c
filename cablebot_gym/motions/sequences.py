"""Motions one after the other: between dwells, and chains."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.motions.base import (
    COORDINATES,
    ORDERS,
    RATES,
    Reference,
    Trajectory,
    checked_times,
    is_trajectory,
)
from cablebot_gym.motions.curves import Dwell
from cablebot_gym.utils.checks import number

DWELL = 0.3
"""Default length of each dwell of :class:`BetweenDwells` [s]."""


@dataclass(frozen=True, kw_only=True)
class BetweenDwells:
    """A motion between two dwells: the robot rests at the first pose, moves, and rests at the last
    pose.

    A robot that leaves its last pose soon after the motion fails in the second dwell. A robot that
    no motor can hold at rest fails in the first one. The dwells do not change the motion: if it
    starts with a jump of acceleration, as
    :class:`~cablebot_gym.motions.curves.PaperCircle` does, the jump occurs at time
    ``dwell``.

    Raises:
        ValueError: if ``motion`` is not a :class:`~cablebot_gym.motions.base.Trajectory` or
            has dwells already, or if ``dwell`` is negative.
    """

    motion: Trajectory
    """The motion between the dwells."""
    dwell: float = DWELL
    """Length of each dwell [s]; ≥ 0."""

    def __post_init__(self) -> None:
        if not is_trajectory(self.motion):
            raise ValueError(f"motion must be a Trajectory, not {self.motion!r}")
        if isinstance(self.motion, BetweenDwells):
            raise ValueError(
                "motion has dwells already: change their length with dataclasses.replace(motion, dwell=…)"
            )
        number("dwell", self.dwell, least=0, unit="s")

    @property
    def name(self) -> str:
        """Name of the motion."""
        return self.motion.name

    @property
    def duration(self) -> float:
        """Duration of the motion and both dwells [s]."""
        return self.motion.duration + 2 * self.dwell

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return self.motion.coordinates

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], see :class:`~cablebot_gym.motions.base.Trajectory`."""
        since = checked_times(times) - self.dwell
        reference = self.motion(np.clip(since, 0.0, self.motion.duration))
        # Both ends belong to the motion: a jump of acceleration there is part of the reference.
        moves = ((since >= 0) & (since <= self.motion.duration))[..., None]
        rates = {order: np.where(moves, getattr(reference, order), 0.0) for order in RATES}
        return Reference(position=reference.position, **rates)


MEETING_TOLERANCE = 1e-9
"""Largest distance between the end of a part of :class:`Chain` and the start of the next part [m,
rad]."""

REST_TOLERANCE = 1e-6
"""Largest rate of a part of :class:`Chain` at its ends, up to snap [m, rad, and per sᵏ]; rounding
leaves less."""


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Motions one after the other, such as to pick, dwell and place. Each starts and ends at rest,
    so the chain is C⁴.

    Raises:
        ValueError: if there is no motion, a part is not a
            :class:`~cablebot_gym.motions.base.Trajectory`, moves at one of its ends, or does
            not start where the part before it ends.
    """

    motions: tuple[Trajectory, ...]
    """The parts in their order. A number among them is a dwell of this length [s] at the pose where
    the robot is."""
    name: str = "chain"
    """Name shown in tables and error messages."""

    def __post_init__(self) -> None:
        motions = self.motions
        if not isinstance(motions, (list, tuple)) or not motions or isinstance(motions[0], Real):
            raise ValueError(f"motions must be a list that starts with a motion, not {motions!r}")
        chained: list[Trajectory] = []
        for index, motion in enumerate(motions, 1):
            if isinstance(motion, Real):
                length = number(f"motions: dwell {index}", motion, above=0, unit="s")
                motion = _dwell_after(chained, length)
            if not is_trajectory(motion):
                raise ValueError(
                    f"motions: part {index} must be a Trajectory or the length of a dwell, not {motion!r}"
                )
            label = f"motions: part {index}, {motion.name!r},"
            _check_rest(label, motion)
            if chained:
                _check_meeting(label, motion, chained[-1])
            chained.append(motion)
        object.__setattr__(self, "motions", tuple(chained))

    @property
    def duration(self) -> float:
        """Duration of all parts [s]."""
        return float(self._starts[-1])

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return self.motions[0].coordinates

    @cached_property
    def _starts(self) -> Array:
        """Start time of each part, then the end of the last one [s]."""
        return np.cumsum([0.0, *(motion.duration for motion in self.motions)])

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], see :class:`~cablebot_gym.motions.base.Trajectory`."""
        times = checked_times(times)
        # A time at which two motions meet belongs to the later one; both are at rest there.
        index = np.searchsorted(self._starts, times, side="right") - 1
        index = np.clip(index, 0, len(self.motions) - 1)
        shape = (*times.shape, self.coordinates)
        reference = Reference(**{order: np.zeros(shape) for order in ORDERS})
        for position, motion in enumerate(self.motions):
            runs = index == position
            moved = motion(times[runs] - self._starts[position])
            for order in ORDERS:
                getattr(reference, order)[runs] = getattr(moved, order)
        return reference


def _dwell_after(motions: list[Trajectory], length: float) -> Dwell:
    """A dwell at the end of the last motion, with the kind that the name of the first one has."""
    end = motions[-1](motions[-1].duration).position
    kinds = [kind for kind, coordinates in COORDINATES.items() if coordinates == len(end)]
    name = f"dwell-{kinds[0]}"
    for kind in kinds:
        if motions[0].name.endswith(f"-{kind}"):
            name = f"dwell-{kind}"
            break
    return Dwell(name=name, pose=tuple(end.tolist()), duration=length)


def _check_rest(label: str, motion: Trajectory) -> None:
    """Checks that a motion starts and ends at rest."""
    remedy = "put it in BetweenDwells"
    if isinstance(motion, BetweenDwells):
        remedy = 'give it "dwell": 0.3'
    for time, verb in ((0.0, "starts"), (motion.duration, "ends")):
        reference = motion(time)
        for order in RATES:
            rate = float(np.max(np.abs(getattr(reference, order))))
            if rate > REST_TOLERANCE:
                raise ValueError(
                    f"{label} {verb} with a nonzero {order} ({rate:.3g}): use a motion from rest to rest, or {remedy}"
                )


def _check_meeting(label: str, motion: Trajectory, before: Trajectory) -> None:
    """Checks that a motion starts where the motion before it ends."""
    if motion.coordinates != before.coordinates:
        raise ValueError(
            f"{label} has {motion.coordinates} coordinates and the part before it {before.coordinates}"
        )
    start = motion(0.0).position
    end = before(before.duration).position
    if np.max(np.abs(start - end)) > MEETING_TOLERANCE:
        raise ValueError(
            f"{label} starts at {start.tolist()}, but {before.name!r} before it ends at {end.tolist()}: change one "
            "of the poses, or add a line between them"
        )
