"""The compiled second half of an environment step: observation, reward, termination and info from the plant's record.

Everything that :mod:`cablebot_gym.physics.kernel` measured is read here and nothing is integrated. Where things stand
in the kernel's record comes in as ``rows``, :data:`cablebot_gym.physics.kernel.RECORD_ROWS`: a constant from another
file would not renew numba's cache when it changes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TERMINATION_REASONS = ("", "tracking_error", "slack", "workspace", "non_finite")
"""``info["termination_reason"]`` by code; the first is "not terminated"."""

REWARD_TERMS = ("position", "rotation", "saturation", "slack", "failure")
"""Names of the reward's terms, in the order of the weights."""

# Columns of the info array: scalars, reward terms, then one group of m columns for each cable quantity.
INFO_SCALARS = (
    "time",
    "command_time",
    "payload",
    "tracking_error",
    "rotation_error",
    "tracking_error_peak",
    "rotation_error_peak",
)
INFO_CABLES = ("tensions", "torques", "motor_speeds", "drive_demand", "torque_margin", "slack")
INFO_NAMES = (*INFO_SCALARS, *(f"reward_{name}" for name in REWARD_TERMS))
SLACK_MARK = 0.5
FIRST_TERM = len(INFO_SCALARS)
FIRST_CABLE_INFO = FIRST_TERM + len(REWARD_TERMS)

# Columns of the per-lane settings.
PAYLOAD, TOLD, KNOWN, POSITION_BOUND, ROTATION_BOUND = 0, 1, 2, 3, 4
LANE_SETTINGS = 5

LARGEST = 1e6
"""What stands in info for an error that is not finite."""

_inline = njit(forceinline=True, error_model="numpy")


@_inline
def _finite(value):
    return value if abs(value) < LARGEST else (LARGEST if value > 0 or value != value else -LARGEST)


@_inline
def _saturated(value, low, high):
    """Within the bounds; the lower one for NaN."""
    return min(max(value, low), high) if value == value else low


@njit(cache=True, nogil=True, error_model="numpy")
def outcome(
    fresh,
    flexible,
    index,
    lanes,
    rows,
    record,
    control,
    control_ends,
    which,
    step,
    settings,
    stall,
    workspace,
    bounds,
    weights,
    period,
    termination_radius,
    slack_time,
    slack_for,
    noise,
    observation,
    reward,
    reason,
    info,
):
    """Fills observation (N, size), reward (N,), reason (N,) and info (N, columns) for the lanes in ``index``.

    ``fresh``: the lanes have just been reset, so that nothing is rewarded or ended. ``slack_for`` (N,) counts how long
    some cable has been slack [s]. ``noise`` (N, measured components), or (N, 0) for none, is added to the measured part
    of the observation; everything else is judged on the true state.
    """
    m, n = stall.shape[1], workspace.shape[1]
    pose, velocity, peak_position, peak_rotation, first_cable, cable_rows = (
        rows[0],
        rows[1],
        rows[2],
        rows[3],
        rows[4],
        rows[5],
    )
    demand_row, torque_row, tension_row, speed_row, slack_row = rows[6], rows[7], rows[8], rows[9], rows[10]
    motor_angle, motor_speed = rows[11], rows[12]
    spatial = n > 2
    for place in range(index.shape[0]):
        lane = index[place]
        r, at = record[lane // lanes], lane % lanes
        line = control[which[lane], min(step[lane], control_ends[which[lane]])]

        # Observation: pose, velocity, motors behind springs, the reference part as tabulated, what is told.
        out = observation[lane]
        for j in range(n):
            out[j] = r[(pose + j) * lanes + at]
            out[n + j] = r[(velocity + j) * lanes + at]
        place_of_line = 2 * n
        if flexible:
            place_of_line = 2 * n + 2 * m
            for i in range(m):
                at_cable = (first_cable + cable_rows * i) * lanes + at
                out[2 * n + i] = r[motor_angle * lanes + at_cable]
                out[2 * n + m + i] = r[motor_speed * lanes + at_cable]
        for j in range(line.shape[0]):
            out[place_of_line + j] = line[j]
        out[place_of_line + line.shape[0]] = settings[lane, TOLD]
        out[place_of_line + line.shape[0] + 1] = settings[lane, KNOWN]
        finite = True
        for j in range(place_of_line):
            finite &= math.isfinite(out[j])
        inside = True
        for j in range(n):
            inside &= (out[j] >= workspace[0, j]) & (out[j] <= workspace[1, j])

        # Errors at this instant; the reference pose stands after the clock.
        square, rotation = 0.0, 0.0
        for j in range(n):
            difference = out[j] - line[1 + j]
            if j < 3:
                square += difference * difference
            else:
                rotation = max(rotation, abs(difference))
        position = math.sqrt(square)
        position_peak = max(position, r[peak_position * lanes + at])
        rotation_peak = max(rotation, r[peak_rotation * lanes + at])
        if not finite:  # a comparison with NaN would hide it
            position = position_peak = LARGEST
            rotation = rotation_peak = LARGEST if spatial else 0.0
        for j in range(noise.shape[1]):
            out[j] += noise[lane, j]
        for j in range(out.shape[0]):
            out[j] = _saturated(out[j], bounds[0, j], bounds[1, j])

        row = info[lane]
        row[0] = step[lane] * period
        row[1] = max(step[lane] - 1, 0) * period
        row[2] = settings[lane, PAYLOAD]
        row[3] = _finite(position)
        row[4] = _finite(rotation)
        row[5] = _finite(position_peak)
        row[6] = _finite(rotation_peak)
        slack_cables, excess = 0.0, 0.0
        for i in range(m):
            at_cable = (first_cable + cable_rows * i) * lanes + at
            demand = r[demand_row * lanes + at_cable]
            slack = 1.0 if r[slack_row * lanes + at_cable] > 0.0 else 0.0
            first = FIRST_CABLE_INFO + i
            row[first] = _finite(r[tension_row * lanes + at_cable])
            row[first + m] = _finite(r[torque_row * lanes + at_cable])
            row[first + 2 * m] = _finite(r[speed_row * lanes + at_cable])
            row[first + 3 * m] = demand
            row[first + 4 * m] = stall[lane, i] * (1.0 - abs(demand))
            row[first + 5 * m] = slack
            slack_cables += slack
            excess += max(0.0, abs(demand) - 1.0)

        why = 0
        if fresh:
            slack_for[lane] = 0.0
        else:
            slack_for[lane] = slack_for[lane] + period if slack_cables > 0.0 else 0.0
            if not finite:
                why = 4
            elif not inside:
                why = 3
            elif not position <= termination_radius:
                why = 1
            elif slack_for[lane] > slack_time + 1e-9:
                why = 2
        reason[lane] = why
        for j in range(5):
            row[FIRST_TERM + j] = 0.0
        if not fresh:
            row[FIRST_TERM] = 1.0 / (1.0 + row[3] / settings[lane, POSITION_BOUND])
            if spatial:
                row[FIRST_TERM + 1] = 1.0 / (1.0 + row[4] / settings[lane, ROTATION_BOUND])
            row[FIRST_TERM + 2] = -excess / m
            row[FIRST_TERM + 3] = -slack_cables / m
            row[FIRST_TERM + 4] = -1.0 if why > 0 else 0.0
        total = 0.0
        for j in range(5):
            row[FIRST_TERM + j] *= weights[j]
            total += row[FIRST_TERM + j]
        reward[lane] = total


def info_columns(cables: int) -> int:
    """Columns of the info array."""
    return FIRST_CABLE_INFO + len(INFO_CABLES) * cables


def cable_columns(cables: int) -> dict[str, slice]:
    """Columns of each cable quantity by name; ``slack`` holds 0 or 1, to be compared with :data:`SLACK_MARK`."""
    firsts = {name: FIRST_CABLE_INFO + place * cables for place, name in enumerate(INFO_CABLES)}
    return {name: slice(first, first + cables) for name, first in firsts.items()}


def info_dict(rows: np.ndarray, cables: int) -> dict[str, np.ndarray]:
    """Info arrays by name, views of ``rows`` (N, columns)."""
    named = {name: rows[:, place] for place, name in enumerate(INFO_NAMES)}
    named |= {name: rows[:, columns] for name, columns in cable_columns(cables).items()}
    named["slack"] = named["slack"] > SLACK_MARK
    return named
