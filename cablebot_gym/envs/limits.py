"""The limits of an episode: when a value keeps its limit.

Compiled code calls these functions with numbers, the evaluation with arrays of N episodes. Each
comparison is false for NaN: a limit counts as kept only if that is certain.
"""

from __future__ import annotations

import math
from typing import Any

from cablebot_gym.robots import Cable, Robot

SLACK_TIME = 0.1
"""Longest time for which a cable may be slack before the environment terminates the episode [s]."""

ACTION_ROUNDING = 1e-12
"""Tolerance of |a| ≤ 1 for rounding errors."""


def minimum_tension(robot: Robot, cable: Cable) -> float:
    """Least valid tension at a physics step [N]; −∞ for bilateral cables, which have no minimum
    tension."""
    if cable == "unilateral":
        return robot.minimum_tension
    return -math.inf


def within_bound(value: Any, bound: Any) -> Any:
    """Whether a tracking error or a tension is at most its upper bound."""
    return value <= bound


def is_taut(tension: Any, minimum: Any) -> Any:
    """Whether a cable has the minimum tension."""
    return tension >= minimum


def is_held(torque_margin: Any) -> Any:
    """Whether a motor has the torque that holds the robot at rest."""
    return torque_margin >= 0.0


def is_unsaturated(action: Any) -> Any:
    """Whether an action is within ±1."""
    return abs(action) <= 1.0 + ACTION_ROUNDING
