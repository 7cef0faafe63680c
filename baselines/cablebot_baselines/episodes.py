"""Starts of episodes in a batch, for policies with a memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


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
