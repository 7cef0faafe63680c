"""Motions between dwells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.motions.base import RATES, Reference, Trajectory, checked_times, is_trajectory
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
