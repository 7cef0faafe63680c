"""Starts of episodes in a batch, for policies with a memory."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

_State = TypeVar("_State")


def first_steps(state: Any, episode_start: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Marks the observations of a batch that start an episode. Without a state, all do.

    Args:
        state: state of the previous step, or None.
        episode_start: one boolean, also in an array of any shape, or one boolean for each
            observation; None for False.
        shape: shape of the batch.

    Raises:
        ValueError: if the shape of ``episode_start`` is invalid.
    """
    if episode_start is None:
        episode_start = False
    start = np.asarray(episode_start, np.bool_)
    if start.size == 1:  # Stable-Baselines3 passes an array of one element for a single observation
        start = start.reshape(())
    elif start.shape != shape:
        raise ValueError(
            f"episode_start must be one boolean or have shape {shape}, not shape {start.shape}"
        )
    if state is None:
        start = np.array(True)
    return np.broadcast_to(start, shape)


def merged(starts: NDArray[np.bool_], initial: _State, following: _State) -> _State:
    """The initial state of the episodes that start, and the following state of the others.

    Args:
        starts: which of the N episodes start, (N,).
        initial: record of arrays, or named tuples of arrays, with N rows each.
        following: record of the same class.
    """

    def either(old: Any, new: Any) -> Any:
        if isinstance(new, tuple):
            return type(new)(*map(either, old, new))
        further_axes = (1,) * (new.ndim - 1)
        return np.where(starts.reshape(-1, *further_axes), old, new)

    values = {name: either(getattr(initial, name), new) for name, new in vars(following).items()}
    kind: Any = type(following)
    state: _State = kind(**values)
    return state
