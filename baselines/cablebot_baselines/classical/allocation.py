"""Drive commands within ±1 that come closest to the acceleration asked for.

A motor that clips on its own pulls the platform askew: the others still give what the unclipped acceleration needs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_TOGETHER, _ROUNDS = 6, 1000
"""Rounds in which all wrong sides change at once, nearly always enough, and most rounds: after these only each lane's
first wrong side changes (Murty's rule), which cannot cycle."""


def attainable(command: Array, slope: Array) -> Array:
    """The commands within ±1 that minimise ‖Ẍ − v‖, v the acceleration that ``command`` would give.

    Metres and radians weigh alike.

    Ẍ − v = G⁻¹(a − a*), a strictly convex problem in a box, solved by a primal-dual active set for all lanes at once:
    commands on their bound stay there while the rest would pull them beyond it.

    Args:
        command: a*, (..., m).
        slope: G = ∂a/∂Ẍ, (..., m, m).
    """
    matrix = np.linalg.inv(slope)
    hessian = np.swapaxes(matrix, -1, -2) @ matrix
    side = np.where(np.abs(command) > 1, np.sign(command), 0.0)
    for turn in range(_ROUNDS):
        held, step = side != 0, np.where(side != 0, side - command, 0.0)
        both_free = ~held[..., :, None] & ~held[..., None, :]
        reduced = np.where(both_free, hessian, np.eye(command.shape[-1]))
        follow = np.linalg.solve(reduced, np.where(held, 0.0, -_times(hessian, step))[..., None])[..., 0]
        step = step + follow
        beyond, pull = command + step, -_times(hessian, step)
        now = np.where(held, np.where(pull * side > 0, side, 0.0), np.where(np.abs(beyond) > 1, np.sign(beyond), 0.0))
        wrong = now != side
        if not np.any(wrong):
            break
        if turn >= _TOGETHER:
            wrong &= np.cumsum(wrong, axis=-1) == 1
        side = np.where(wrong, now, side)
    nearest: Array = np.clip(command + step, -1.0, 1.0)
    return nearest


def _times(matrix: Array, vector: Array) -> Array:
    product: Array = (matrix @ vector[..., None])[..., 0]
    return product
