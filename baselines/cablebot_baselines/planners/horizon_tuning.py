"""Tuning of the receding-horizon controller, by robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cablebot_gym.planning import Margins


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Discretisation and objective weights of a plan. Errors are in units of their bounds, actions
    in units of ±1."""

    intervals: int
    """Number of spline intervals."""
    instants: int
    """Number of instants of each interval at which the constraints apply."""
    margins: Margins
    """Margins to the constraints, which the tracking law uses to correct errors."""
    action_exponent: float
    """p ≥ 2 of the objective, the mean of aᵖ over motors and instants. A larger p penalises peaks
    more."""
    error_weight: float
    """Weight of the mean square error."""
    end_error_weight: float
    """Weight of the squared error at the end of the horizon; the reference after it is unknown."""
    end_velocity_weight: float
    """Weight of the squared velocity error at the end of the horizon, in bounds per time scale."""
    smoothness_weight: float = 1e-6
    """Weight of the sum of squared acceleration steps between instants, in bounds per squared time
    scale. Springs swing after large ones."""


_SPATIAL = Tuning(
    intervals=7,
    instants=3,
    margins=Margins(position=5e-4, rotation=1.2e-3, action=0.002, tension=9.0),
    action_exponent=3.0,
    error_weight=0.3,
    end_error_weight=0.3,
    end_velocity_weight=3.0,
)

_PLANAR = Tuning(
    intervals=10,
    instants=2,
    margins=Margins(position=7e-4, action=0.005, tension=3.5),
    action_exponent=4.0,
    error_weight=0.1,
    end_error_weight=0.0,
    end_velocity_weight=1.0,
)

_PLATFORM = replace(
    _SPATIAL,
    margins=Margins(position=8e-4, rotation=5e-3, action=0.03, tension=3.0),
    action_exponent=6.0,
)

_SPRINGS = 1e-3
"""Smoothness weight of the plans of flexible robots."""

TUNING = {
    "rigid": {"planar": _PLANAR, "spatial": _SPATIAL, "planar-platform": _PLATFORM},
    "flexible": {
        "planar": replace(
            _PLANAR,
            margins=Margins(position=1e-3, action=0.02, tension=7.0),
            end_error_weight=0.3,
            end_velocity_weight=3.0,
            smoothness_weight=_SPRINGS,
        ),
        "spatial": replace(
            _SPATIAL,
            margins=Margins(position=1.2e-3, rotation=1.5e-3, action=0.03, tension=3.0),
            smoothness_weight=_SPRINGS,
        ),
    },
}
"""Tuning by joints and kind of the robot, found on random loops for training."""
