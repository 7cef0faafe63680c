"""Compiled second half of an environment step: observation, reward, termination and info from the
plant's record.

This module reads the record of :mod:`cablebot_gym.physics.kernel` and integrates nothing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import TERMINATION_REASONS, limits
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.compiling import entry_point, inline
from cablebot_gym.physics.kernel import rows

_TRACKING_ERROR, _SLACK, _WORKSPACE, _NON_FINITE, _VIOLATION = range(1, len(TERMINATION_REASONS))

REWARD_TERMS = ("inside", "position", "rotation", "saturation", "violation")
"""Names of the reward terms, in the order of the weights; defined in the manual of the single
environment."""

INFO_SCALARS = (
    "time",
    "action_time",
    "payload",
    "tracking_error",
    "rotation_error",
    "tracking_error_peak",
    "rotation_error_peak",
    *(f"reward_{name}" for name in REWARD_TERMS),
    "violated",
    "cost",
)
"""Names of the columns of the scalars of info."""

INFO_CABLES = (
    "tensions",
    "torques",
    "motor_speeds",
    "commanded_action",
    "torque_margin",
    "least_tensions",
    "largest_tensions",
    "slack",
)
"""Names of the quantities of info with one value per cable."""

(
    _TIME,
    _ACTION_TIME,
    _PAYLOAD,
    _POSITION,
    _ROTATION,
    _POSITION_PEAK,
    _ROTATION_PEAK,
    _FIRST_TERM,
    *_,
    _VIOLATED,
    _COST,
) = range(len(INFO_SCALARS))
_INSIDE_TERM, _POSITION_TERM, _ROTATION_TERM, _SATURATION_TERM, _VIOLATION_TERM = range(
    len(REWARD_TERMS)
)
_TENSION, _TORQUE, _SPEED, _COMMANDED, _MARGIN, _LEAST_TENSION, _LARGEST_TENSION, _SLACK_CABLE = (
    range(len(INFO_CABLES))
)
_BOOLEAN_THRESHOLD = 0.5  # columns of booleans hold 0 and 1

# Columns of the episode settings.
TRUE_PAYLOAD, MODEL_PAYLOAD, KNOWN, POSITION_BOUND, ROTATION_BOUND, STARTS_AT_REST = range(6)
SETTING_COLUMNS = 6

LARGEST = 1e6
"""Largest magnitude in ``info``: larger and non-finite values become ±1e6. Actions must be
smaller."""


class Constants(NamedTuple):
    """Constants of a batch of environments."""

    flexible: bool
    dimensions: int
    """Number of coordinates of the position; those that follow are angles."""
    lanes: int
    """Number of environments per tile of the record."""
    workspace: Array
    """Lower and upper bounds of the pose, (2, n)."""
    bounds: Array
    """Lower and upper bounds of the observation, (2, size)."""
    encoder_resolution: float
    """Smallest step of the motor angles [rad], the first block of the readings; 0 for exact
    angles."""
    normalised: bool
    """Whether the observation is normalised."""
    centre: Array
    """Centres of the normalised observation, (size,)."""
    per_scale: Array
    """Reciprocal scales of the normalised observation, (size,)."""
    weights: Array
    """Weights of the reward terms, (5,)."""
    period: float
    """Control period [s]."""
    minimum_tension: float
    """Least valid tension at a physics step [N]; −∞ for bilateral cables, which have no minimum
    tension."""
    maximum_tension: float
    """Largest valid tension at a physics step [N]; ∞ without a maximum."""
    termination_radius: float
    terminate_on_violation: bool


class Episodes(NamedTuple):
    """State and settings of the present episodes; ``slack_for`` and ``violated`` are updated."""

    record: Array
    """The plant's record, (tiles, rows · lanes)."""
    step: NDArray[np.int64]
    """Control steps since the reset, (width,)."""
    motion_steps: NDArray[np.int64]
    """Control steps of the motion, (N,)."""
    trajectory_index: NDArray[np.int64]
    """Index of the reference table, (width,)."""
    references: Array
    """Reference blocks of the observation, (trajectories, rows, columns)."""
    last_rows: NDArray[np.int64]
    """Index of the last row of each reference table, (trajectories,)."""
    settings: Array
    """Episode settings, (N, columns)."""
    stall: Array
    """True stall torques [N·m], (N, m)."""
    readings: Array
    """Exact readings of the sensors of winches and platform, (N, components); (N, 0) if pose and
    velocity are measured."""
    noise: Array
    """Noise of the measured blocks, (N, components); (N, 0) without noise."""
    sent: Array
    """Actions that were sent last, before delay, (N, m)."""
    slack_for: Array
    """Time for which some cable has been slack [s], (N,)."""
    violated: NDArray[np.bool_]
    """Whether a limit has been violated in the episode, (N,)."""


class Outputs(NamedTuple):
    """Results of a step, which are overwritten."""

    observation: Array
    """(N, size). The last observation is read too: it holds the actions that were sent before."""
    reward: Array
    """(N,)."""
    reason: NDArray[np.int64]
    """Index of the termination reason, (N,)."""
    complete: NDArray[np.bool_]
    """Whether the motion is complete, (N,)."""
    info: Array
    """Scalars of info, (N, columns)."""
    cables: Array
    """Quantities of info with one value per cable, (quantities, more than N, m)."""


@inline
def _finite(value):
    return value if abs(value) < LARGEST else (LARGEST if value > 0 or value != value else -LARGEST)


@inline
def _saturated(value, low, high):
    """Value clipped to the bounds; the lower bound for NaN."""
    return min(max(value, low), high) if value == value else low


class _Lane(NamedTuple):
    """One environment in a tile of the plant's record."""

    record: Array
    """The flat tile: row r of the environment is ``record[r * lanes + at]``."""
    lanes: int
    at: int


class _Cables(NamedTuple):
    """What the limits and the reward need to know of all cables and motors together."""

    slack: bool
    """Whether a cable was slack in the control period."""
    taut: bool
    """Whether all cables have the minimum tension."""
    within_maximum: bool
    """Whether no cable exceeds the maximum tension."""
    held: bool
    """Whether all motors have the torque of the start."""
    motors: int
    excess: float
    """Sum over the motors of the excess of their actions, each at most 1."""


_within_bound = inline(limits.within_bound)
_is_taut = inline(limits.is_taut)
_is_held = inline(limits.is_held)


@inline
def _row(lane, row):
    return lane.record[row * lane.lanes + lane.at]


@inline
def _cable_row(lane, cable, row):
    first_row = rows.FIRST_CABLE_RECORD + rows.CABLE_RECORDS * cable
    return lane.record[(first_row + row) * lane.lanes + lane.at]


@entry_point(seconds=lambda fresh, env_indices, *_: 1.2e-4 * len(env_indices))
def outcome(fresh, env_indices, constants, episodes, outputs):
    """Fills the outputs of the environments ``env_indices``. Errors, reward and termination use the
    true state.

    Args:
        fresh: whether the environments have just been reset: then there is no reward and no
            termination.
        env_indices: environments, (k,).
        constants: :class:`Constants`, as a plain tuple, whose type numba finds several times
            faster.
        episodes: :class:`Episodes`, as a plain tuple.
        outputs: :class:`Outputs`, as a plain tuple.
    """
    for k in range(env_indices.shape[0]):
        _update(
            fresh, env_indices[k], Constants(*constants), Episodes(*episodes), Outputs(*outputs)
        )


@inline
def _update(fresh, env_index, batch, now, out):
    """The outcome of one environment."""
    tile = now.record[env_index // batch.lanes]
    lane = _Lane(tile, batch.lanes, env_index % batch.lanes)
    step = now.step[env_index]
    motion_steps = now.motion_steps[env_index]
    trajectory = now.trajectory_index[env_index]
    reference = now.references[trajectory, min(step, now.last_rows[trajectory])]
    settings = now.settings[env_index]
    info = out.info[env_index]
    info[_TIME] = step * batch.period
    info[_ACTION_TIME] = max(step - 1, 0) * batch.period
    info[_PAYLOAD] = settings[TRUE_PAYLOAD]
    finite, inside = _check_state(lane, batch, now.stall.shape[1])
    _state_info(lane, batch, finite, reference, info)
    cables = _cable_info(fresh, lane, batch, now.stall[env_index], out.cables[:, env_index])

    slack_for = 0.0
    if cables.slack and not fresh:
        slack_for = now.slack_for[env_index] + batch.period
    reason = 0
    if not fresh:
        reason = _termination(batch, finite, inside, info[_POSITION], slack_for)
    violates = reason > 0 or not _keeps_limits(fresh, settings, cables, info)
    # A violation at the start counts in the first step.
    violates |= step == 1 and now.violated[env_index]
    violated_before = step > 1 and now.violated[env_index]
    if (violates or violated_before) and not fresh and reason == 0 and batch.terminate_on_violation:
        reason = _VIOLATION
    now.slack_for[env_index] = slack_for
    now.violated[env_index] = violates or violated_before
    out.reason[env_index] = reason
    out.complete[env_index] = step >= motion_steps
    info[_VIOLATED] = violates or violated_before
    info[_COST] = violates
    _observation(fresh, env_index, lane, batch, now, reference, out.observation[env_index])
    penalty = 0
    if violates and not violated_before:
        penalty = motion_steps
    out.reward[env_index] = _reward(fresh, batch, settings, penalty, cables, info)


@inline
def _observation(fresh, env_index, lane, batch, now, reference, observation):
    """Fills the observation: the measured blocks, the tabulated reference, the payload of the
    model, the last actions and the slack time."""
    sent = now.sent[env_index]
    settings = now.settings[env_index]
    readings = now.readings[env_index]
    m = sent.shape[0]
    first_reference = _measure(lane, batch, readings, m, observation)
    after_reference = first_reference + reference.shape[0]
    # Without a sum in its index, the loop vectorises.
    block = observation[first_reference:after_reference]
    for j in range(reference.shape[0]):
        block[j] = reference[j]
    observation[after_reference] = settings[MODEL_PAYLOAD]
    observation[after_reference + 1] = settings[KNOWN]
    first_action = after_reference + 2
    slack_column = observation.shape[0] - 1
    if fresh:
        for j in range(first_action, slack_column):
            observation[j] = 0.0
    else:  # the last observation holds the actions that were sent before
        for j in range(slack_column - 1, first_action + m - 1, -1):
            observation[j] = observation[j - m]
        for i in range(m):
            observation[first_action + i] = min(max(sent[i], -1.0), 1.0)
    observation[slack_column] = min(now.slack_for[env_index], batch.bounds[1, slack_column])

    noise = now.noise[env_index]
    for j in range(noise.shape[0]):
        observation[j] += noise[j]
    if batch.encoder_resolution > 0.0:
        for j in range(m):
            increments = np.floor(observation[j] / batch.encoder_resolution + 0.5)
            observation[j] = batch.encoder_resolution * increments
    for j in range(first_action):
        observation[j] = _saturated(observation[j], batch.bounds[0, j], batch.bounds[1, j])
    if batch.normalised:
        relative = batch.workspace.shape[1]
        if readings.shape[0] > 0:  # winches measure neither pose nor velocity
            relative = 0
        _normalise(first_reference, relative, batch.centre, batch.per_scale, observation)


@inline
def _measure(lane, batch, readings, m, observation):
    """Exact measured blocks: pose and velocity, and motors of flexible robots, or the readings of
    winches. Returns the first column after them."""
    if readings.shape[0] > 0:
        for j in range(readings.shape[0]):
            observation[j] = readings[j]
        return readings.shape[0]
    n = batch.workspace.shape[1]
    for j in range(n):
        observation[j] = _row(lane, rows.POSE + j)
        observation[n + j] = _row(lane, rows.VELOCITY + j)
    if not batch.flexible:
        return 2 * n
    for i in range(m):
        observation[2 * n + i] = _cable_row(lane, i, rows.MOTOR_ANGLE)
        observation[2 * n + m + i] = _cable_row(lane, i, rows.MOTOR_SPEED)
    return 2 * n + 2 * m


@inline
def _normalise(first_reference, relative, centre, per_scale, observation):
    """Subtracts the reference from ``relative`` components of pose and velocity, and scales all
    components."""
    # The time to go precedes the reference pose, and the reference velocity follows it.
    for j in range(relative):
        observation[j] -= observation[first_reference + 1 + j]
        observation[relative + j] -= observation[first_reference + 1 + relative + j]
    for j in range(observation.shape[0]):  # the scale of actions is 1
        observation[j] = (observation[j] - centre[j]) * per_scale[j]


@inline
def _check_state(lane, batch, cables):
    """Whether the state is finite, and whether the pose is inside the workspace."""
    finite, inside = True, True
    for j in range(batch.workspace.shape[1]):
        coordinate = _row(lane, rows.POSE + j)
        finite &= math.isfinite(coordinate) and math.isfinite(_row(lane, rows.VELOCITY + j))
        inside &= (coordinate >= batch.workspace[0, j]) & (coordinate <= batch.workspace[1, j])
    if batch.flexible:
        for i in range(cables):
            finite &= math.isfinite(_cable_row(lane, i, rows.MOTOR_ANGLE))
            finite &= math.isfinite(_cable_row(lane, i, rows.MOTOR_SPEED))
    return finite, inside


@inline
def _state_info(lane, batch, finite, reference, info):
    """Errors at this instant and their peaks. Column 0 of the reference is the time to go; the pose
    follows."""
    coordinates = batch.workspace.shape[1]
    square, rotation = 0.0, 0.0
    for j in range(coordinates):
        difference = _row(lane, rows.POSE + j) - reference[1 + j]
        if j < batch.dimensions:
            square += difference * difference
        else:
            rotation = max(rotation, abs(difference))
    position = math.sqrt(square)
    position_peak = max(position, _row(lane, rows.POSITION_PEAK))
    rotation_peak = max(rotation, _row(lane, rows.ROTATION_PEAK))
    if not finite:  # comparisons with NaN are false and would hide it
        position = position_peak = LARGEST
        if coordinates > batch.dimensions:
            rotation = rotation_peak = LARGEST
    info[_POSITION] = _finite(position)
    info[_ROTATION] = _finite(rotation)
    info[_POSITION_PEAK] = _finite(position_peak)
    info[_ROTATION_PEAK] = _finite(rotation_peak)


@inline
def _cable_info(fresh, lane, batch, stall, cables):
    """Fills the quantities of the cables and returns :class:`_Cables`."""
    any_slack, taut, within_maximum, held, excess = False, True, True, True, 0.0
    for i in range(stall.shape[0]):
        action = _cable_row(lane, i, rows.DEMAND)
        torque = _cable_row(lane, i, rows.TORQUE)
        least_tension = _cable_row(lane, i, rows.LEAST_TENSION)
        largest_tension = _cable_row(lane, i, rows.LARGEST_TENSION)
        slack = _cable_row(lane, i, rows.SLACK) > 0.0
        margin = stall[i] - abs(torque) if fresh else stall[i] * (1.0 - abs(action))
        cables[_TENSION, i] = _finite(_cable_row(lane, i, rows.TENSION))
        cables[_TORQUE, i] = _finite(torque)
        cables[_SPEED, i] = _finite(_cable_row(lane, i, rows.SPEED))
        cables[_COMMANDED, i] = action
        cables[_MARGIN, i] = margin
        cables[_LEAST_TENSION, i] = _finite(least_tension)
        cables[_LARGEST_TENSION, i] = _finite(largest_tension)
        cables[_SLACK_CABLE, i] = slack
        any_slack |= slack
        taut &= _is_taut(least_tension, batch.minimum_tension)
        within_maximum &= _within_bound(largest_tension, batch.maximum_tension)
        held &= _is_held(margin)
        excess += min(max(0.0, abs(action) - 1.0), 1.0)
    return _Cables(any_slack, taut, within_maximum, held, stall.shape[0], excess)


@inline
def _keeps_limits(fresh, settings, cables, info):
    """Whether errors and tensions keep their limits; at the start, errors and the torques that hold
    the robot at rest."""
    if fresh:
        kept = cables.held or settings[STARTS_AT_REST] <= 0.0
    else:
        kept = cables.taut and cables.within_maximum and not cables.slack
    kept &= _within_bound(info[_POSITION_PEAK], settings[POSITION_BOUND])
    return kept & _within_bound(info[_ROTATION_PEAK], settings[ROTATION_BOUND])


@inline
def _termination(batch, finite, inside, position_error, slack_for):
    """The termination reason, 0 for none."""
    if not finite:
        return _NON_FINITE
    if not inside:
        return _WORKSPACE
    if position_error > batch.termination_radius:
        return _TRACKING_ERROR
    if slack_for > limits.SLACK_TIME + 1e-9:  # rounding of the sum of periods
        return _SLACK
    return 0


@inline
def _reward(fresh, batch, settings, penalty, cables, info):
    """Fills the reward terms and returns their sum."""
    inside = 0.0
    position = 0.0
    rotation = 0.0
    saturation = 0.0
    violation = 0.0
    weights = batch.weights
    if not fresh:
        if info[_VIOLATED] == 0.0:
            inside = weights[_INSIDE_TERM]
        position = weights[_POSITION_TERM] / (1.0 + info[_POSITION] / settings[POSITION_BOUND])
        if batch.workspace.shape[1] > batch.dimensions:
            rotation = weights[_ROTATION_TERM] / (1.0 + info[_ROTATION] / settings[ROTATION_BOUND])
        saturation = -weights[_SATURATION_TERM] * cables.excess / cables.motors
        if penalty > 0:
            violation = -weights[_VIOLATION_TERM] * penalty
    info[_FIRST_TERM + _INSIDE_TERM] = inside
    info[_FIRST_TERM + _POSITION_TERM] = position
    info[_FIRST_TERM + _ROTATION_TERM] = rotation
    info[_FIRST_TERM + _SATURATION_TERM] = saturation
    info[_FIRST_TERM + _VIOLATION_TERM] = violation
    return inside + position + rotation + saturation + violation


def info_dict(scalars: Array, cables: Array) -> dict[str, Any]:
    """Values by name: Python floats and (m,) of one environment, (N,) and (N, m) of several.

    The arrays are copies without gaps: JAX takes no others. ``slack`` and ``violated`` are boolean.

    Args:
        scalars: columns of the scalars, (columns,) or (N, columns).
        cables: quantities with one value per cable, (quantities, m) or (quantities, N, m).
    """
    single = scalars.ndim == 1
    # tolist() converts all scalars at once
    columns = scalars.tolist() if single else scalars.T.copy()
    named: dict[str, Any] = dict(zip(INFO_SCALARS, columns, strict=True))
    named.update(zip(INFO_CABLES, cables.copy(), strict=True))
    named["violated"] = named["violated"] > _BOOLEAN_THRESHOLD
    named["slack"] = named["slack"] > _BOOLEAN_THRESHOLD
    return named
