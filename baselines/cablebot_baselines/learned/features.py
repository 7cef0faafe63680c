"""Inputs of a network: blocks of an observation, and features derived from them and from past
actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cablebot_baselines.classical.law import Array
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import choice

TIME_CONSTANTS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Time constants τ of the decays exp(−t/τ) [s]."""

RBF_COUNT = 96
"""Number of Gaussian radial basis functions (RBF) of ``rbf_progress``, over the motion."""


def _decays(time: Array) -> Array:
    return np.exp(-time / np.array(TIME_CONSTANTS))


def _rbf_progress(time: Array, time_to_go: Array) -> Array:
    """Gaussian radial basis functions over [0, 1]; their standard deviation is the distance of
    their centres."""
    progress = time / np.maximum(time + time_to_go, np.finfo(float).tiny)
    return np.exp(-0.5 * (progress * (RBF_COUNT - 1) - np.arange(RBF_COUNT)) ** 2)


_COMPUTED: dict[str, Callable[[Mapping[str, Array]], Array]] = {
    "time_since_start": lambda values: _decays(values["time_since_start"]),
    "time_to_go_decays": lambda values: _decays(values["time_to_go"]),
    "rbf_progress": lambda values: _rbf_progress(values["time_since_start"], values["time_to_go"]),
}
"""Features that are functions of times."""

_DERIVED = ("shift", "shift_velocity", "actions", "error", *_COMPUTED)
"""Features that are not blocks of the observation.

* ``shift``, ``shift_velocity``: shift of the reference, in units of its bounds and of its bounds
  per action period.
* ``actions``: past actions that still affect the spline.
* ``error``: shifted reference minus pose [m, rad].
* ``time_since_start``, ``time_to_go_decays``: decays with :data:`TIME_CONSTANTS` of the time since
  the start of the episode and of the time to go.
* ``rbf_progress``: Gaussian radial basis functions of the fraction of the motion's duration that
  has passed.
"""

_TIME_SIZES = {
    "time_to_go": 1,
    "time_since_start": len(TIME_CONSTANTS),
    "time_to_go_decays": len(TIME_CONSTANTS),
    "rbf_progress": RBF_COUNT,
}
"""Sizes of the features that are functions of time."""


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


def feature_values(
    names: Sequence[str], blocks: Mapping[str, Array], derived: Mapping[str, Array]
) -> Array:
    """Concatenates the features, (..., count).

    Args:
        names: names of the features.
        blocks: blocks of the observation, each (..., size).
        derived: ``time_since_start`` (..., 1) [s], ``error`` and ``actions``; with a shift also
            ``shift`` and ``shift_velocity``.
    """
    values = {**blocks, **derived}
    features = []
    for name in names:
        if name in _COMPUTED:
            features.append(_COMPUTED[name](values))
        else:
            features.append(values[name])
    return np.concatenate(features, axis=-1)


def is_planned(name: str) -> bool:
    """Whether a feature is known before an episode: a time, or a vector of the reference."""
    return name in _TIME_SIZES or name.startswith(("reference_", "preview_"))
