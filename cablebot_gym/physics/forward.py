"""Forward kinematics by the compiled kernel: poses from the lengths of all cables, by Gauss-Newton
from a guess."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array, cable_lengths
from cablebot_gym.physics import kernel
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.plant import form_of, pack_parameters
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import all_finite

TOLERANCE = 1e-12
"""Size of a step after which the iteration ends: sum over the coordinates [m, rad]; with cables
above 1 m, times the length of the longest one at the home pose."""

_DAMPING = 1e-12  # of the normal equations, so that a singular pose gives a finite step; per cable


@lru_cache(maxsize=64)
def _prepared(robot: Robot) -> tuple[kernel.Form, Array, float]:
    """Form and parameters for ``entry_points.Compiled.locate``, and the tolerance. Springs need no code
    of their own."""
    form = form_of(robot)._replace(jointed=False, elastic=False, load_friction=False)
    parameters = pack_parameters(robot)
    m = robot.cables
    parameters[rows.MASS] = _DAMPING * m
    parameters[rows.GRAVITY] = 0.0
    parameters[rows.INERTIA : rows.INERTIA + 3] = _DAMPING * max(np.sum(robot.platform**2), 1e-6)
    if form.lopsided:
        first = rows.body_parameter(m) + rows.PRODUCTS
        parameters[first : first + 3] = 0.0
    first = rows.FIRST_CABLE_PARAMETER + rows.INERTIA_PER_RADIUS2
    parameters[first : rows.body_parameter(m) : rows.CABLE_PARAMETERS] = 1.0
    home = cable_lengths(robot.base, robot.platform, robot.home, robot.swivel)
    return form, parameters, TOLERANCE * max(1.0, float(home.max()))


def forward_kinematics(robot: Robot, lengths: ArrayLike, guess: ArrayLike) -> Array:
    """The poses X (..., n) whose cable lengths are nearest to the given ones, near a guess.

    Six cables admit several poses. The iteration converges to that of the guess, for example the
    last pose of a moving platform. A step that increases the length errors is halved.

    Args:
        robot: nominal robot.
        lengths: cable lengths, (..., m) with m ≥ n [m].
        guess: initial poses, (..., n) or (n,).

    Raises:
        ValueError: if the shapes do not match the robot or each other, or a number is not finite.
    """
    all_finite("lengths", lengths)
    all_finite("guess", guess)
    lengths = np.asarray(lengths, float)
    m = robot.cables
    n = robot.coordinates
    shape = lengths.shape[:-1]
    if lengths.shape[-1:] != (m,) or np.shape(guess)[-1:] != (n,):
        raise ValueError(
            f"lengths {lengths.shape} and guess {np.shape(guess)} do not match {robot.name}: use (..., {m}), (..., {n})"
        )
    pose = np.empty((*shape, n))
    count = int(np.prod(shape, dtype=int))
    pose[...] = guess
    found = pose.reshape(-1, n)
    form, parameters, tolerance = _prepared(robot)
    lanes = 1 if count == 1 else rows.LANES
    memory = np.empty(len(parameters) * lanes), np.empty(rows.scratch_rows(form) * lanes)
    wanted = np.ascontiguousarray(lengths).reshape(-1, m)
    locate = kernel.compiled(form, lanes).locate
    locate(parameters, tolerance, *memory, wanted, found)
    return pose
