"""Torque allocation: actions within ±1 that come closest to a requested platform acceleration.

If one motor saturates alone, the other motors still apply the torque for the unsaturated acceleration, and the platform
leaves its direction of motion. Allocation adjusts all motors together.
"""

from __future__ import annotations

import numpy as np

from cablebot_gym.kinematics import Array

_JOINT_ITERATIONS, _MAX_ITERATIONS = 6, 1000
"""Iterations that change all wrong constraints at once, which nearly always suffices, and maximum number of iterations.

After the joint iterations only the first wrong constraint of each problem changes (Murty's rule), which cannot cycle.
"""


def allocate(action: Array, slope: Array) -> Array:
    """Actions within ±1 that minimise ‖Ẍ − v‖, where v is the acceleration that ``action`` would produce.

    Metres and radians have equal weight.

    With Ẍ − v = G⁻¹(a − a*) this is a strictly convex problem with box constraints. A primal-dual active-set method
    solves it for the whole batch at once. An action stays at its bound as long as the gradient points beyond the bound.

    Args:
        action: unsaturated action a*, (..., m).
        slope: G = ∂a/∂Ẍ, (..., m, m).
    """
    matrix = np.linalg.inv(slope)
    hessian = np.swapaxes(matrix, -1, -2) @ matrix
    bound = np.where(np.abs(action) > 1, np.sign(action), 0.0)
    for iteration in range(_MAX_ITERATIONS):
        active, step = bound != 0, np.where(bound != 0, bound - action, 0.0)
        both_free = ~active[..., :, None] & ~active[..., None, :]
        reduced = np.where(both_free, hessian, np.eye(action.shape[-1]))
        free_step = np.linalg.solve(reduced, np.where(active, 0.0, -_times(hessian, step))[..., None])[..., 0]
        step = step + free_step
        candidate, descent = action + step, -_times(hessian, step)
        violated = np.where(np.abs(candidate) > 1, np.sign(candidate), 0.0)
        new_bound = np.where(active, np.where(descent * bound > 0, bound, 0.0), violated)
        wrong = new_bound != bound
        if not np.any(wrong):
            break
        if iteration >= _JOINT_ITERATIONS:
            wrong &= np.cumsum(wrong, axis=-1) == 1
        bound = np.where(wrong, new_bound, bound)
    closest: Array = np.clip(action + step, -1.0, 1.0)
    return closest


def _times(matrix: Array, vector: Array) -> Array:
    product: Array = (matrix @ vector[..., None])[..., 0]
    return product
