"""Forward kinematics: poses from the lengths of all cables, by Gauss-Newton from a guess."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot

Array = NDArray[Any]

ITERATIONS = 50
"""Largest number of Gauss-Newton steps."""

TOLERANCE = 1e-12
"""Size of a step below which the iteration ends, per coordinate [m, rad]."""

_DAMPING = 1e-12
"""Relative damping of the normal equations, which keeps a singular pose from raising an error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForwardKinematics:
    """Poses from cable lengths."""

    pose: Array
    """Poses X, (..., n)."""
    residual: Array
    """Root mean square of the length errors at the pose [m], (...). Zero if there are as many cables as coordinates;
    with more cables it shows wrong lengths."""
    converged: NDArray[np.bool_]
    """Whether the last step was below :data:`TOLERANCE`, (...)."""


def forward_kinematics(
    robot: Robot, lengths: ArrayLike, guess: ArrayLike, *, iterations: int = ITERATIONS
) -> ForwardKinematics:
    """The poses whose cable lengths are nearest to the given ones, near a guess.

    Six cables admit several poses. The iteration converges to that of the guess, for example the last pose of a moving
    platform. A step that increases the length errors is halved.

    Args:
        robot: nominal robot.
        lengths: cable lengths, (..., m) with m ≥ n [m].
        guess: initial poses, (..., n) or (n,).
        iterations: largest number of steps.
    """
    lengths = np.asarray(lengths, float)
    guess = np.asarray(guess, float)
    n, shape = guess.shape[-1], lengths.shape[:-1]
    wanted = lengths.reshape(-1, lengths.shape[-1])
    pose = np.array(np.broadcast_to(guess, (*shape, n))).reshape(-1, n)
    error = wanted - textbook.cable_lengths(robot, pose)
    step_size = np.full(len(pose), np.inf)
    active = np.arange(len(pose))
    for _ in range(iterations):
        structure = textbook.jacobian(robot, pose[active])
        back = np.swapaxes(structure, -1, -2)
        normal = back @ structure
        damping = _DAMPING * np.trace(normal, axis1=-2, axis2=-1)[:, None, None] * np.eye(n)
        step = np.linalg.solve(normal + damping, back @ error[active, :, None])[..., 0]
        fraction = np.ones((len(active), 1))
        before = np.sum(error[active] ** 2, axis=-1)
        for _ in range(6):
            new = wanted[active] - textbook.cable_lengths(robot, pose[active] + fraction * step)
            worse = np.sum(new**2, axis=-1) > before + 1e-24
            if not worse.any():
                break
            fraction[worse] /= 2
        pose[active] += fraction * step
        error[active], step_size[active] = new, np.max(np.abs(fraction * step), axis=-1)
        active = np.flatnonzero(step_size > TOLERANCE)
        if active.size == 0:
            break
    residual = np.sqrt(np.mean(error**2, axis=-1))
    return ForwardKinematics(
        pose=pose.reshape(*shape, n),
        residual=residual.reshape(shape),
        converged=(step_size <= TOLERANCE).reshape(shape),
    )
