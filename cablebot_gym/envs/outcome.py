"""Compiled second half of an environment step: observation, reward, termination and info from the plant's record.

This module reads the record of :mod:`cablebot_gym.physics.kernel` and integrates nothing. The row numbers of the record
are passed as the argument ``rows`` (:data:`cablebot_gym.physics.kernel.RECORD_ROWS`), because a change of a constant
in another file would not invalidate numba's cache.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TERMINATION_REASONS = ("", "tracking_error", "slack", "workspace", "non_finite")
"""Value of ``info["termination_reason"]`` by code. Code 0, the empty string, means "not terminated"."""

REWARD_TERMS = ("position", "rotation", "saturation", "slack", "failure")
"""Names of the reward terms, in the order of the weights."""

# Columns of the info array: scalars, reward terms, then one group of m columns per cable quantity.
INFO_SCALARS = (
    "time",
    "action_time",
    "payload",
    "tracking_error",
    "rotation_error",
    "tracking_error_peak",
    "rotation_error_peak",
)
INFO_CABLES = ("tensions", "torques", "motor_speeds", "commanded_action", "torque_margin", "slack")
INFO_NAMES = (*INFO_SCALARS, *(f"reward_{name}" for name in REWARD_TERMS))
SLACK_MARK = 0.5
FIRST_TERM = len(INFO_SCALARS)
FIRST_CABLE_INFO = FIRST_TERM + len(REWARD_TERMS)

# Columns of the episode settings, one row per environment.
PAYLOAD, MODEL_PAYLOAD, KNOWN, POSITION_BOUND, ROTATION_BOUND = 0, 1, 2, 3, 4
EPISODE_SETTINGS = 5

LARGEST = 1e6
"""Largest magnitude in ``info``: larger and non-finite values become ±1e6. Actions must be smaller."""

_inline = njit(forceinline=True, error_model="numpy")


@_inline
def _finite(value):
    return value if abs(value) < LARGEST else (LARGEST if value > 0 or value != value else -LARGEST)


@_inline
def _saturated(value, low, high):
    """Value clipped to the bounds; the lower bound for NaN."""
    return min(max(value, low), high) if value == value else low


@njit(cache=True, nogil=True, error_model="numpy")
def outcome(
    fresh,
    flexible,
    env_indices,
    lanes,
    rows,
    record,
    control,
    control_ends,
    trajectory_index,
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
    """Fills observation (N, size), reward (N,), reason (N,) and info (N, columns) for the environments ``env_indices``.

    ``fresh``: the environments have just been reset, so there is no reward and no termination. ``lanes``: number of
    environments per tile of the record. ``slack_for`` (N,): time for which some cable has been slack [s]. ``noise``
    (N, measured components), or (N, 0) without noise, is added to the measured blocks of the observation. Errors,
    reward and termination use the true state.
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
    action_row, torque_row, tension_row, speed_row, slack_row = rows[6], rows[7], rows[8], rows[9], rows[10]
    motor_angle, motor_speed = rows[11], rows[12]
    spatial = n > 2
    for k in range(env_indices.shape[0]):
        env_index = env_indices[k]
        r, at = record[env_index // lanes], env_index % lanes
        reference = control[
            trajectory_index[env_index], min(step[env_index], control_ends[trajectory_index[env_index]])
        ]

        # Observation: pose, velocity, motors of flexible robots, tabulated reference blocks, payload of the model.
        out = observation[env_index]
        for j in range(n):
            out[j] = r[(pose + j) * lanes + at]
            out[n + j] = r[(velocity + j) * lanes + at]
        first_reference = 2 * n
        if flexible:
            first_reference = 2 * n + 2 * m
            for i in range(m):
                at_cable = (first_cable + cable_rows * i) * lanes + at
                out[2 * n + i] = r[motor_angle * lanes + at_cable]
                out[2 * n + m + i] = r[motor_speed * lanes + at_cable]
        for j in range(reference.shape[0]):
            out[first_reference + j] = reference[j]
        out[first_reference + reference.shape[0]] = settings[env_index, MODEL_PAYLOAD]
        out[first_reference + reference.shape[0] + 1] = settings[env_index, KNOWN]
        finite = True
        for j in range(first_reference):
            finite &= math.isfinite(out[j])
        inside = True
        for j in range(n):
            inside &= (out[j] >= workspace[0, j]) & (out[j] <= workspace[1, j])

        # Errors at this instant. Column 0 of the reference is the time to go; the reference pose follows.
        square, rotation = 0.0, 0.0
        for j in range(n):
            difference = out[j] - reference[1 + j]
            if j < 3:
                square += difference * difference
            else:
                rotation = max(rotation, abs(difference))
        position = math.sqrt(square)
        position_peak = max(position, r[peak_position * lanes + at])
        rotation_peak = max(rotation, r[peak_rotation * lanes + at])
        if not finite:  # comparisons with NaN are false and would hide it
            position = position_peak = LARGEST
            rotation = rotation_peak = LARGEST if spatial else 0.0
        for j in range(noise.shape[1]):
            out[j] += noise[env_index, j]
        for j in range(out.shape[0]):
            out[j] = _saturated(out[j], bounds[0, j], bounds[1, j])

        row = info[env_index]
        row[0] = step[env_index] * period
        row[1] = max(step[env_index] - 1, 0) * period
        row[2] = settings[env_index, PAYLOAD]
        row[3] = _finite(position)
        row[4] = _finite(rotation)
        row[5] = _finite(position_peak)
        row[6] = _finite(rotation_peak)
        slack_cables, excess = 0.0, 0.0
        for i in range(m):
            at_cable = (first_cable + cable_rows * i) * lanes + at
            action = r[action_row * lanes + at_cable]
            slack = 1.0 if r[slack_row * lanes + at_cable] > 0.0 else 0.0
            first = FIRST_CABLE_INFO + i
            row[first] = _finite(r[tension_row * lanes + at_cable])
            row[first + m] = _finite(r[torque_row * lanes + at_cable])
            row[first + 2 * m] = _finite(r[speed_row * lanes + at_cable])
            row[first + 3 * m] = action
            row[first + 4 * m] = stall[env_index, i] * (1.0 - abs(action))
            row[first + 5 * m] = slack
            slack_cables += slack
            excess += max(0.0, abs(action) - 1.0)

        code = 0
        if fresh:
            slack_for[env_index] = 0.0
        else:
            slack_for[env_index] = slack_for[env_index] + period if slack_cables > 0.0 else 0.0
            if not finite:
                code = 4
            elif not inside:
                code = 3
            elif not position <= termination_radius:
                code = 1
            elif slack_for[env_index] > slack_time + 1e-9:
                code = 2
        reason[env_index] = code
        for j in range(5):
            row[FIRST_TERM + j] = 0.0
        if not fresh:
            row[FIRST_TERM] = 1.0 / (1.0 + row[3] / settings[env_index, POSITION_BOUND])
            if spatial:
                row[FIRST_TERM + 1] = 1.0 / (1.0 + row[4] / settings[env_index, ROTATION_BOUND])
            row[FIRST_TERM + 2] = -excess / m
            row[FIRST_TERM + 3] = -slack_cables / m
            row[FIRST_TERM + 4] = -1.0 if code > 0 else 0.0
        total = 0.0
        for j in range(5):
            row[FIRST_TERM + j] *= weights[j]
            total += row[FIRST_TERM + j]
        reward[env_index] = total


def info_columns(cables: int) -> int:
    """Number of columns of the info array."""
    return FIRST_CABLE_INFO + len(INFO_CABLES) * cables


def cable_columns(cables: int) -> dict[str, slice]:
    """Columns of each cable quantity by name. ``slack`` is 0 or 1; compare it with :data:`SLACK_MARK`."""
    firsts = {name: FIRST_CABLE_INFO + index * cables for index, name in enumerate(INFO_CABLES)}
    return {name: slice(first, first + cables) for name, first in firsts.items()}


def info_dict(rows: np.ndarray, cables: int) -> dict[str, np.ndarray]:
    """Info arrays by name, each a view of ``rows`` (N, columns), except ``slack``, which is a new boolean array."""
    named = {name: rows[:, column] for column, name in enumerate(INFO_NAMES)}
    named |= {name: rows[:, columns] for name, columns in cable_columns(cables).items()}
    named["slack"] = named["slack"] > SLACK_MARK
    return named
