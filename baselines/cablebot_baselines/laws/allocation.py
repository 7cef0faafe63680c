"""Torque allocation: actions within ±1 that come closest to a requested platform acceleration.

If one motor saturates alone, the other motors still apply the torque for the unsaturated
acceleration, and the platform leaves its direction of motion. Allocation adjusts all motors
together.
"""

from __future__ import annotations

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import times_vector

_JOINT_ITERATIONS = 6
"""Number of iterations that change all wrong constraints at once. They nearly always suffice.

Later iterations change only the first wrong constraint of each problem (Murty's rule), which cannot
cycle.
"""

_MAX_ITERATIONS = 1000
"""Maximum number of iterations."""


def allocate(action: Array, slope: Array) -> Array:
    """Actions within ±1 that minimise ‖Ẍ − v‖, where v is the acceleration that ``action`` would
    produce.

    Metres and radians have equal weight.

    Because Ẍ − v = G⁻¹(a − a*), this is a strictly convex quadratic problem with Hessian G⁻ᵀG⁻¹ and
    box constraints. A primal-dual active-set method solves it for all problems of the batch at
    once. An action stays at its bound as long as the descent direction points beyond the bound.

    Args:
        action: unsaturated action a*, (..., m).
        slope: G = ∂a/∂Ẍ, (..., m, m).
    """
    inverse = np.linalg.inv(slope)
    hessian = np.swapaxes(inverse, -1, -2) @ inverse
    # The active bound of each action, −1 or 1; 0 for a free action.
    bound = np.where(np.abs(action) > 1, np.sign(action), 0.0)
    for iteration in range(_MAX_ITERATIONS):
        is_active = bound != 0
        step = np.where(is_active, bound - action, 0.0)
        # Minimum over the free actions, with the active actions at their bounds.
        are_free = ~is_active[..., :, None] & ~is_active[..., None, :]
        reduced = np.where(are_free, hessian, np.eye(action.shape[-1]))
        descent = np.where(is_active, 0.0, -times_vector(hessian, step))
        step = step + np.linalg.solve(reduced, descent[..., None])[..., 0]
        candidate = action + step
        # Release a bound if the descent points inwards; add a bound if the candidate exceeds it.
        descent = -times_vector(hessian, step)
        kept_bound = np.where(descent * bound > 0, bound, 0.0)
        violated_bound = np.where(np.abs(candidate) > 1, np.sign(candidate), 0.0)
        new_bound = np.where(is_active, kept_bound, violated_bound)
        is_wrong = new_bound != bound
        if not np.any(is_wrong):
            break
        if iteration >= _JOINT_ITERATIONS:
            is_wrong &= np.cumsum(is_wrong, axis=-1) == 1
        bound = np.where(is_wrong, new_bound, bound)
    closest: Array = np.clip(action + step, -1.0, 1.0)
    return closest
