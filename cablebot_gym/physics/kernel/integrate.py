"""RK4 steps of a tile and the record of each control period.

``p``: parameters of the tile; ``w``: scratch memory; ``record`` or ``r``: record; ``at``: lane;
``row``, ``rec``: first row of a cable in the scratch memory and in the record; ``half``: 0 for
positions, 1 for velocities, which are 6 rows further on; h: physics step [s].
"""

from __future__ import annotations

import math

from cablebot_gym.physics.compiling import inline
from cablebot_gym.physics.kernel.motors import (
    drive_motors,
    request_torques,
    subtract_friction,
)
from cablebot_gym.physics.kernel.rows import (
    CABLE_RECORDS,
    CABLE_ROWS,
    DRIVE,
    FIRST_CABLE,
    FIRST_CABLE_RECORD,
    FREE_TENSION,
    GAP,
    LAGGED,
    LARGEST_TENSION,
    LEAST_TENSION,
    MOTOR_ANGLE,
    MOTOR_RATE,
    MOTOR_STAGE,
    MOTOR_START,
    MOTOR_SUM,
    MOTOR_TORQUE,
    POSE,
    POSITION_PEAK,
    REQUEST,
    ROTATION_PEAK,
    SLACK,
    STAGE,
    START,
    SUM,
    TAUT,
    TENSION,
    TORQUE,
    VELOCITY,
)
from cablebot_gym.physics.kernel.stage import acceleration_row, stage_dynamics, stage_kinematics


@inline
def _note_tensions(form, period_starts, unilateral, w, record, lanes):
    """Counts slack cables and updates the least and largest tensions at the start of a physics
    step.

    Stores the tensions at the start of the control period.
    """
    for i in range(form.cables):
        row = FIRST_CABLE + CABLE_ROWS * i
        rec = FIRST_CABLE_RECORD + CABLE_RECORDS * i
        for at in range(lanes):
            tension = w[(row + FREE_TENSION) * lanes + at]
            if unilateral:
                slack = 1.0 - w[(row + TAUT) * lanes + at]
                tension = max(tension, 0.0)
            else:
                slack = 0.0 if tension > 0.0 else 1.0  # a select, as in :func:`sincos`
            if period_starts:
                record[(rec + TENSION) * lanes + at] = tension
                record[(rec + LEAST_TENSION) * lanes + at] = tension
                record[(rec + LARGEST_TENSION) * lanes + at] = tension
                record[(rec + SLACK) * lanes + at] = slack
            else:
                least_tension = record[(rec + LEAST_TENSION) * lanes + at]
                record[(rec + LEAST_TENSION) * lanes + at] = min(tension, least_tension)
                largest_tension = record[(rec + LARGEST_TENSION) * lanes + at]
                record[(rec + LARGEST_TENSION) * lanes + at] = max(tension, largest_tension)
                record[(rec + SLACK) * lanes + at] += slack


@inline
def _blend(stage, h, w, at, lanes, start, total, value, rate_row):
    """RK4 update of one row: the value of the next stage or, after the last stage, the new
    state."""
    ahead, weight = 0.5 * h, 1.0
    if stage == 2:
        ahead = h
    if stage in (1, 2):
        weight = 2.0
    rate = w[rate_row * lanes + at]
    begin = w[start * lanes + at]
    previous_rates = 0.0
    if stage > 0:
        previous_rates = w[total * lanes + at]
    weighted_rates = weight * rate + previous_rates
    if stage < 3:
        w[total * lanes + at] = weighted_rates
        w[value * lanes + at] = begin + ahead * rate
    else:
        end = begin + h / 6.0 * weighted_rates
        w[start * lanes + at] = end
        w[value * lanes + at] = end


@inline
def _rk4(form, lags, rubs, period_starts, unilateral, h, p, w, record, lanes):
    """One physics step of a tile; START becomes the new state."""
    for stage in range(4):
        stage_kinematics(form, form.flexible, p, w, lanes)
        if stage == 0 and period_starts:
            request_torques(form, lags, h, p, w, record, lanes)
        drive_motors(form, lags, stage, p, w, lanes)
        if stage == 0 and period_starts:
            for i in range(form.cables):
                row = FIRST_CABLE + CABLE_ROWS * i
                rec = FIRST_CABLE_RECORD + CABLE_RECORDS * i
                for at in range(lanes):
                    record[(rec + TORQUE) * lanes + at] = w[
                        (row + (MOTOR_TORQUE if form.flexible else DRIVE)) * lanes + at
                    ]
        if rubs:
            subtract_friction(form, p, w, lanes)
        stage_dynamics(form, unilateral, p, w, lanes)
        if stage == 0:
            _note_tensions(form, period_starts, unilateral, w, record, lanes)
        # Positions first: their rate is the velocity of the stage, which changes next.
        # A conditional expression and sums of rows within the calls: a batch was slower with
        # statements in their place.
        for half in range(2):
            rate_row = STAGE + 6 if half == 0 else acceleration_row(form)
            for j in range(form.coordinates):
                value = 6 * half + j
                for at in range(lanes):
                    _blend(
                        stage,
                        h,
                        w,
                        at,
                        lanes,
                        START + value,
                        SUM + value,
                        STAGE + value,
                        rate_row + j,
                    )
        if form.flexible:
            for half in range(2):
                rate_row = MOTOR_STAGE + 1 if half == 0 else MOTOR_RATE
                for i in range(form.cables):
                    row = FIRST_CABLE + CABLE_ROWS * i
                    start = row + MOTOR_START + half
                    total = row + MOTOR_SUM + half
                    value = row + MOTOR_STAGE + half
                    for at in range(lanes):
                        _blend(stage, h, w, at, lanes, start, total, value, row + rate_row)


@inline
def _note_errors(form, period_starts, w, record, at, lanes, paths, path, line):
    """Updates the largest position and rotation error after a physics step, against a line of a
    path."""
    # Indexed in full: numba would count a reference for a view of the line.
    dx = w[START * lanes + at] - paths[path, line, 0]
    dy = w[(START + 1) * lanes + at] - paths[path, line, 1]
    square = dx * dx + dy * dy
    rotation = 0.0
    if form.dimensions == 3:
        dz = w[(START + 2) * lanes + at] - paths[path, line, 2]
        square += dz * dz
    for j in range(form.dimensions, form.coordinates):
        rotation = max(rotation, abs(w[(START + j) * lanes + at] - paths[path, line, j]))
    position = math.sqrt(square)
    if not period_starts:
        position = max(position, record[POSITION_PEAK * lanes + at])
        rotation = max(rotation, record[ROTATION_PEAK * lanes + at])
    record[POSITION_PEAK * lanes + at] = position
    record[ROTATION_PEAK * lanes + at] = rotation


@inline
def _load_tile(form, record, w, lanes):
    """Copies the state to the scratch memory. The search for the taut cables starts from those that
    were slack in the last control period."""
    for j in range(form.coordinates):
        for at in range(lanes):
            w[(START + j) * lanes + at] = record[(POSE + j) * lanes + at]
            w[(STAGE + j) * lanes + at] = record[(POSE + j) * lanes + at]
            w[(START + 6 + j) * lanes + at] = record[(VELOCITY + j) * lanes + at]
            w[(STAGE + 6 + j) * lanes + at] = record[(VELOCITY + j) * lanes + at]
    for i in range(form.cables):
        for at in range(lanes):
            slack = record[(FIRST_CABLE_RECORD + CABLE_RECORDS * i + SLACK) * lanes + at]
            w[(FIRST_CABLE + CABLE_ROWS * i + TAUT) * lanes + at] = 0.0 if slack > 0.0 else 1.0
    if form.flexible:
        for i in range(form.cables):
            row = FIRST_CABLE + CABLE_ROWS * i
            rec = FIRST_CABLE_RECORD + CABLE_RECORDS * i
            for at in range(lanes):
                for half in range(2):
                    value = record[(rec + MOTOR_ANGLE + half) * lanes + at]
                    w[(row + MOTOR_START + half) * lanes + at] = value
                    w[(row + MOTOR_STAGE + half) * lanes + at] = value


@inline
def _store_tile(form, lags, record, w, lanes):
    """Copies the state at the end of a control period to the record."""
    for j in range(form.coordinates):
        for at in range(lanes):
            record[(POSE + j) * lanes + at] = w[(START + j) * lanes + at]
            record[(VELOCITY + j) * lanes + at] = w[(START + 6 + j) * lanes + at]
    for i in range(form.cables):
        row = FIRST_CABLE + CABLE_ROWS * i
        rec = FIRST_CABLE_RECORD + CABLE_RECORDS * i
        if form.flexible:
            for half in range(2):
                for at in range(lanes):
                    value = w[(row + MOTOR_START + half) * lanes + at]
                    record[(rec + MOTOR_ANGLE + half) * lanes + at] = value
        if lags:
            for at in range(lanes):
                lagged = w[(row + REQUEST) * lanes + at] + w[(row + GAP) * lanes + at]
                record[(rec + LAGGED) * lanes + at] = lagged


@inline
def advance_tiles(
    form, lanes, unilateral, lags, rubs, parameters, record, w, paths, ends, path, step, substeps, h
):
    """One control period of all tiles, see :class:`entry_points.Compiled`."""
    for tile in range(record.shape[0]):
        p = parameters[tile]
        r = record[tile]
        _load_tile(form, r, w, lanes)
        if not unilateral:
            for i in range(form.cables):
                for at in range(lanes):
                    w[(FIRST_CABLE + CABLE_ROWS * i + TAUT) * lanes + at] = 1.0
        for substep in range(substeps):
            _rk4(form, lags, rubs, substep == 0, unilateral, h, p, w, r, lanes)
            for at in range(lanes):
                lane = tile * lanes + at
                line = min(step[lane] * substeps + substep + 1, ends[path[lane]])
                _note_errors(form, substep == 0, w, r, at, lanes, paths, path[lane], line)
        for at in range(lanes):
            step[tile * lanes + at] += 1
        _store_tile(form, lags, r, w, lanes)
