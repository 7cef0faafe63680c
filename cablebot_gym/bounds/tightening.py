"""Margins over time of a planned motion, from the limits that its replays exceed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.planning import MarginProfile, Margins
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds

_SMALLEST_FRACTION = 5e-4
"""Smallest margins to the error bounds, as a fraction of them."""

_SMALLEST = Margins(action=1e-4, tension=0.01)
"""Smallest margins of action and tension. They cover errors of solver and sampling."""

_REACTION = 1.1
"""Growth of a margin for an excess of 1. A little more than the excess, because the motion changes
with the margins."""

_LEAST_GROWTH = 0.2
"""Least growth of a margin whose limit is exceeded, as a fraction of its smallest margin."""


_RELATIVE_GROWTH = 0.5
"""Least growth of a margin to tension or error bounds, as a fraction of the present margin: a plan
that is farther from the limit than its margin changes only after the margin has grown."""

_SMALL_EXCESS = 0.002
"""Largest excess of the requested actions with which margins to the error bounds still grow."""


@dataclass(frozen=True, kw_only=True)
class Tightening:
    """Rule for the margins of a motion whose inputs are replayed."""

    robot: Robot
    """Robot of the replays."""
    error_bounds: ErrorBounds
    """Bounds of the tracking errors."""
    times: Array
    """Control instants of an episode, shape (steps,) [s]."""

    @property
    def least_margins(self) -> Margins:
        """Margins that every replayed motion keeps at all times."""
        bounds = self.error_bounds
        return Margins(
            position=_SMALLEST_FRACTION * bounds.position,
            rotation=_SMALLEST_FRACTION * bounds.rotation,
            action=_SMALLEST.action,
            tension=_SMALLEST.tension,
        )

    def no_profile(self) -> MarginProfile:
        """No additional margins at any control instant."""
        return MarginProfile.zeros(self.times, self.robot.cables)

    def grown(
        self, profile: MarginProfile, replays: Sequence[Rollout], action_excess: Array
    ) -> MarginProfile:
        """A profile with larger margins at the times at which replays exceed limits.

        Args:
            profile: margins of the replayed motion.
            replays: episodes under the same inputs.
            action_excess: requested actions of the controller beyond ± 1, shape (steps, m).
        """
        excess = [self._excess(replay, action_excess) for replay in replays]
        grown = {}
        for name, least_margin in vars(self.least_margins).items():
            margin = getattr(profile, name).copy()
            largest = np.zeros_like(margin)
            for episode in excess:
                if name not in episode:
                    continue
                values = episode[name]
                part = largest[: len(values)]  # a terminated episode is shorter
                np.maximum(part, values, out=part)
            growth = _REACTION * largest + _LEAST_GROWTH * least_margin
            if name != "action":
                growth = np.maximum(growth, _RELATIVE_GROWTH * margin)
            grown[name] = margin + np.where(largest > 0, growth, 0.0)
        return replace(profile, **grown)

    def _excess(self, replay: Rollout, action_excess: Array) -> dict[str, Array]:
        """Excess over each limit at every step; not positive where the limit is kept."""
        arrays = replay.arrays
        missing_tension = self.robot.minimum_tension - arrays["least_tensions"].min(axis=1)
        overload = arrays["largest_tensions"].max(axis=1) - self.robot.maximum_tension
        excess = {"tension": np.maximum(missing_tension, overload)}
        # Errors after saturated actions follow from them, so they do not change the error margins.
        if np.any(action_excess > _SMALL_EXCESS):
            return excess | {"action": action_excess}
        excess["position"] = arrays["tracking_error_peak"] - self.error_bounds.position
        if not self.robot.point_mass:
            excess["rotation"] = arrays["rotation_error_peak"] - self.error_bounds.rotation
        return excess
