"""Forward kinematics of a tile: poses from the lengths of all cables."""

from __future__ import annotations

import numpy as np

from cablebot_gym.physics.compiling import inline
from cablebot_gym.physics.kernel.rows import (
    CABLE_ROWS,
    ENDED,
    FIRST_CABLE,
    KNOWN,
    LENGTH,
    REQUEST,
    SQUARES,
    STAGE,
    START,
    SUM,
    TAUT,
    TRIAL,
)
from cablebot_gym.physics.kernel.stage import (
    acceleration_row,
    copy_parameters,
    stage_accelerations,
    stage_kinematics,
)
from cablebot_gym.physics.kernel.taut import solve_lane

_ITERATIONS = 50  # largest number of poses that are tried


@inline
def locate_tiles(form, lanes, parameters, tolerance, p, w, lengths, pose):
    """Poses of given cable lengths: damped Gauss-Newton steps of all lanes in tiles.

    The dynamics at rest solve ``(m I₃, I) y = −Σ row_i (t_i + μ_i row_i·y)``. If t_i is the excess
    length of cable i, μ_i = 1, and the parameters have the damping in place of mass and inertia,
    then y is the step. A step that increases the sum of the squares is halved. A lane ends after a
    step below the tolerance.

    ``lengths`` has shape (N, m) [m]. ``pose``, (N, n) [m, rad], has the first guesses, which the
    results replace.
    """
    count = lengths.shape[0]
    copy_parameters(parameters, p, lanes)
    for start in range(0, count, lanes):
        # START: best pose; STAGE: pose to try; SUM: step between them, none at first.
        for at in range(lanes):
            lane = min(start + at, count - 1)
            for j in range(form.coordinates):
                w[(START + j) * lanes + at] = pose[lane, j]
                w[(STAGE + j) * lanes + at] = pose[lane, j]
                w[(STAGE + 6 + j) * lanes + at] = 0.0
                w[(SUM + j) * lanes + at] = np.nan
            for i in range(form.cables):
                row = FIRST_CABLE + CABLE_ROWS * i
                w[(row + REQUEST) * lanes + at] = lengths[lane, i]
                w[(row + TAUT) * lanes + at] = 1.0
            w[SQUARES * lanes + at] = np.inf
            w[ENDED * lanes + at] = 0.0
        for _ in range(_ITERATIONS):
            stage_kinematics(form, True, p, w, lanes)
            for at in range(lanes):
                w[TRIAL * lanes + at] = 0.0
            for i in range(form.cables):
                row = FIRST_CABLE + CABLE_ROWS * i
                for at in range(lanes):
                    excess = w[(row + LENGTH) * lanes + at] - w[(row + REQUEST) * lanes + at]
                    w[(row + KNOWN) * lanes + at] = excess
                    w[TRIAL * lanes + at] += excess * excess
            for at in range(lanes):
                solve_lane(form, p, w, at, lanes)
            stage_accelerations(form, p, w, lanes)
            finished = 1.0
            for at in range(lanes):
                finished *= _take_step(form, tolerance, w, at, lanes)
            if finished == 1.0:
                break
        for at in range(min(lanes, count - start)):
            for j in range(form.coordinates):
                pose[start + at, j] = w[(START + j) * lanes + at]


@inline
def _take_step(form, tolerance, w, at, lanes):
    """Accepts the pose of the stage or halves the step to it; returns 1.0 if the lane had ended
    before, else 0.0."""
    ended_before = w[ENDED * lanes + at]
    # False for NaN; 1e-24 m² is rounding.
    smaller = w[TRIAL * lanes + at] <= w[SQUARES * lanes + at] + 1e-24
    accepted = smaller | (ended_before == 1.0)
    if accepted:
        w[SQUARES * lanes + at] = w[TRIAL * lanes + at]
    size = 0.0
    for j in range(form.coordinates):
        if accepted:
            start = w[(STAGE + j) * lanes + at]
            step = w[(acceleration_row(form) + j) * lanes + at]
        else:
            start = w[(START + j) * lanes + at]
            step = w[(SUM + j) * lanes + at] / 2
        if ended_before == 1.0:
            step = 0.0
        size += abs(step)
        w[(START + j) * lanes + at] = start
        w[(SUM + j) * lanes + at] = step
        w[(STAGE + j) * lanes + at] = start + step
    w[ENDED * lanes + at] = 1.0 if size <= tolerance else 0.0
    return ended_before
