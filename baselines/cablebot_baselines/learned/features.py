"""What a network reads: blocks of an observation, and numbers made from them and from what has been done so far."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.linalg import block_diag

from cablebot_baselines.classical.law import Array
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import Robot

CLOCK = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Time constants of a clock's numbers exp(−t/τ) [s]."""

BELLS = 60
"""Bells of ``bells``, over the first second."""


def _clock(time: Array) -> Array:
    return np.exp(-time / np.array(CLOCK))


def _bells(time: Array) -> Array:
    centres = np.linspace(0.0, 1.0, BELLS)
    return np.exp(-0.5 * ((time - centres) * (BELLS - 1)) ** 2)


_MADE: dict[str, Callable[[Mapping[str, Array], Mapping[str, Array]], Array]] = {
    "shift": lambda part, made: made["shift"],
    "shift_velocity": lambda part, made: made["shift_velocity"],
    "actions": lambda part, made: made["actions"],
    "error": lambda part, made: made["error"],
    "elapsed": lambda part, made: _clock(made["elapsed"]),
    "bells": lambda part, made: _bells(made["elapsed"]),
    "ending": lambda part, made: _clock(part["time_left"]),
}
"""Features that are not blocks of the observation. ``shift`` and ``shift_velocity`` are of the shifted reference, in
units of its bounds and of these by hold; ``actions`` the last ones that count; ``error`` that of the shifted reference
[m, rad]; ``elapsed`` and ``ending`` :data:`CLOCK` numbers of the time since the start and until the end; ``bells``
bells over the first second."""

OF_SHIFTS = ("shift", "shift_velocity")
"""Features that only a shifted reference has."""

PREVIEWED = (
    "reference_velocity",
    "reference_acceleration",
    *("preview_20ms", "preview_50ms", "preview_100ms", "preview_200ms"),
    "reference_pose",
    "elapsed",
    "ending",
)
"""What there is to know of the motion ahead; neither the payload nor the platform's own errors."""


def check_features(names: Sequence[str], robot: Robot) -> tuple[str, ...]:
    """The names of features.

    Raises:
        ValueError: if there are none, or one is unknown for this robot; the message lists those there are.
    """
    known = [*observation_layout(robot).slices(), *_MADE]
    if not isinstance(names, Sequence) or isinstance(names, str) or not names:
        raise ValueError(f"features must be several names out of {', '.join(known)}, not {names!r}")
    for name in names:
        if name not in known:
            raise ValueError(f"unknown feature {name!r}; choose out of {', '.join(known)}")
    return tuple(names)


def feature_values(names: Sequence[str], part: Mapping[str, Array], made: Mapping[str, Array]) -> Array:
    """The features one after the other, (..., count).

    Args:
        names: of the features.
        part: blocks of the observation, each (..., size).
        made: ``elapsed`` (..., 1) [s], ``error`` and ``actions``; with a shift ``shift`` and ``shift_velocity``.
    """
    values = [_MADE[name](part, made) if name in _MADE else part[name] for name in names]
    return np.concatenate(values, axis=-1)


def feature_symmetry(names: Sequence[str], robot: Robot, move: Array) -> Array:
    """What a turn or mirror image of the plane does to features of the motion ahead: a matrix (count, count).

    Args:
        names: of the features.
        robot: planar.
        move: (2, 2), orthogonal.

    Raises:
        ValueError: if a feature is neither a vector of the reference nor a time.
    """
    times = {"time_left": 1, "elapsed": len(CLOCK), "ending": len(CLOCK), "bells": BELLS}
    vectors = [name for name in observation_layout(robot).slices() if name.startswith(("reference_", "preview_"))]
    if other := [name for name in names if name not in times and name not in vectors]:
        raise ValueError(f"it is not known how feature {other[0]!r} turns: leave it out, or leave symmetric out")
    return block_diag(*(move if name in vectors else np.eye(times[name]) for name in names))
