"""Inputs of a network: blocks of an observation, and features derived from them and from past
actions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablebot_baselines.laws.law import Array
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import choice

TIME_CONSTANTS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Time constants τ of the decays exp(−t/τ) [s]."""

_DERIVED = ("actions", "error", "time_since_start", "time_to_go_decays")
"""Features that are not blocks of the observation.

* ``actions``: past actions that still affect the spline.
* ``error``: shifted reference minus pose [m, rad].
* ``time_since_start``, ``time_to_go_decays``: :func:`decays` of the time since the start of the
  episode and of the time to go.
"""


def decays(time: Array) -> Array:
    """exp(−t/τ) for each of :data:`TIME_CONSTANTS`, (..., 6), of times t (..., 1) [s]."""
    return np.exp(-time / np.array(TIME_CONSTANTS))


def check_features(names: Sequence[str], robot: Robot) -> tuple[str, ...]:
    """Checks names of features for a robot and returns them.

    Raises:
        ValueError: if there is none, or one is unknown for this robot; the message lists the known
            ones.
    """
    if not isinstance(names, Sequence) or isinstance(names, str) or not names:
        raise ValueError(f"features must be a list of names, not {names!r}")
    known = (*observation_layout(robot).slices(), *_DERIVED)
    return tuple(choice("feature", name, known) for name in names)
