"""Compiled second half of an environment step: observation, reward, termination and info from the
plant's record.

This module reads the record of :mod:`cablebot_gym.physics.kernel` and integrates nothing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import kernel
from cablebot_gym.physics.inlining import entry_point, inline

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
    "slack",
)
"""Names of the quantities of info with one value per cable."""

_TIME, _ACTION_TIME, _PAYLOAD = (
    INFO_SCALARS.index(name) for name in ("time", "action_time", "payload")
)
_POSITION = INFO_SCALARS.index("tracking_error")
_ROTATION = INFO_SCALARS.index("rotation_error")
_POSITION_PEAK = INFO_SCALARS.index("tracking_error_peak")
_ROTATION_PEAK = INFO_SCALARS.index("rotation_error_peak")
_FIRST_TERM, _VIOLATED, _COST = (
    INFO_SCALARS.index(name) for name in ("reward_inside", "violated", "cost")
)
_TENSION, _TORQUE, _SPEED, _COMMANDED, _MARGIN, _LEAST_TENSION, _SLACK_CABLE = range(
    len(INFO_CABLES)
)
_TRUE = 0.5  # true is 1 in the columns of ``violated`` and ``slack``, false is 0

# Columns of the episode settings.
PAYLOAD, MODEL_PAYLOAD, KNOWN, POSITION_BOUND, ROTATION_BOUND, STARTS_AT_REST = range(6)
EPISODE_SETTINGS = 6

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
    """Least valid tension at a physics step [N]; −∞ for bilateral cables, which only have to
    pull."""
    termination_radius: float
    slack_time: float
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
    """Quantities of info with one value per cable, (quantities, N, m)."""


@inline
def _finite(value):
    return value if abs(value) < LARGEST else (LARGEST if value > 0 or value != value else -LARGEST)


@inline
def _saturated(value, low, high):
    """Value clipped to the bounds; the lower bound for NaN."""
    return min(max(value, low), high) if value == value else low


@entry_point
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
        _judge(fresh, env_indices[k], Constants(*constants), Episodes(*episodes), Outputs(*outputs))


@inline
def _judge(fresh, env_index, batch, now, out):
    """The outcome of one environment."""
    at = env_index % batch.lanes
    lanes = batch.lanes
    record = now.record[env_index // batch.lanes]
    step = now.step[env_index]
    trajectory = now.trajectory_index[env_index]
    coordinates = batch.workspace.shape[1]
    reference = now.references[trajectory, min(step, now.last_rows[trajectory])]
    stall = now.stall[env_index]
    settings = now.settings[env_index]
    readings = now.readings[env_index]
    info = out.info[env_index]
    observation = out.observation[env_index]
    cables = out.cables[:, env_index]
    info[_TIME] = step * batch.period
    info[_ACTION_TIME] = max(step - 1, 0) * batch.period
    info[_PAYLOAD] = settings[PAYLOAD]
    first_reference = _observe(
        fresh,
        record,
        at,
        lanes,
        batch.flexible,
        readings,
        reference,
        settings,
        now.sent[env_index],
        coordinates,
        observation,
    )
    finite, inside = _check_state(
        record, at, lanes, batch.workspace, batch.flexible, stall.shape[0]
    )
    _measure_errors(finite, reference, record, at, lanes, batch.dimensions, coordinates, info)
    slack_cables, excess, taut, held = _report_cables(
        fresh, record, at, lanes, stall, batch.minimum_tension, cables
    )
    reason = 0
    if fresh:
        now.slack_for[env_index] = 0.0
        violates = settings[STARTS_AT_REST] > 0.0 and not held
    else:
        slack_for = now.slack_for[env_index] + batch.period if slack_cables > 0.0 else 0.0
        now.slack_for[env_index] = slack_for
        near = info[_POSITION] <= batch.termination_radius
        slack = slack_for > batch.slack_time + 1e-9
        reason = _terminate(finite, inside, near, slack)
        violates = reason > 0 or slack_cables > 0.0 or not taut
        if step == 1:  # a violation at the start counts in the first step
            violates = violates or now.violated[env_index]
    # Comparisons with NaN are false, so they are written to be true if all is well.
    position_kept = info[_POSITION_PEAK] <= settings[POSITION_BOUND]
    rotation_kept = info[_ROTATION_PEAK] <= settings[ROTATION_BOUND]
    violates = violates or not (position_kept and rotation_kept)
    violated = violates or (not fresh and now.violated[env_index])
    first_violation = violated and (step == 1 or not now.violated[env_index])
    now.violated[env_index] = violated
    if violated and not fresh and reason == 0 and batch.terminate_on_violation:
        reason = _VIOLATION
    out.reason[env_index], out.complete[env_index] = reason, step >= now.motion_steps[env_index]
    info[_VIOLATED] = 1.0 if violated else 0.0
    info[_COST] = 1.0 if violates else 0.0

    slack_column = observation.shape[0] - 1
    observation[slack_column] = min(now.slack_for[env_index], batch.bounds[1, slack_column])
    encoders = stall.shape[0] if batch.encoder_resolution > 0.0 else 0
    model_end = first_reference + reference.shape[0] + 2
    _spoil(
        now.noise[env_index],
        encoders,
        batch.encoder_resolution,
        model_end,
        batch.bounds,
        observation,
    )
    if batch.normalised:
        relative = coordinates if readings.shape[0] == 0 else 0
        _normalise(first_reference, relative, batch.centre, batch.per_scale, observation)
    penalty = now.motion_steps[env_index] if first_violation else 0
    turns = coordinates > batch.dimensions
    out.reward[env_index] = _reward(
        fresh, violated, penalty, excess, stall.shape[0], turns, settings, batch.weights, info
    )


@inline
def _observe(
    fresh, record, at, lanes, flexible, readings, reference, settings, sent, n, observation
):
    """Exact blocks: pose and velocity, motors of flexible robots, or readings of winches; the
    tabulated reference, the payload of the model, and the last actions. Returns the first column of
    the reference."""
    m, measured = sent.shape[0], readings.shape[0]
    first_reference = 2 * n
    if measured > 0:
        first_reference = measured
        for j in range(measured):
            observation[j] = readings[j]
    else:
        for j in range(n):
            observation[j] = record[(kernel.POSE + j) * lanes + at]
            observation[n + j] = record[(kernel.VELOCITY + j) * lanes + at]
        if flexible:
            first_reference = 2 * n + 2 * m
            for i in range(m):
                at_cable = (kernel.FIRST_CABLE_RECORD + kernel.CABLE_RECORDS * i) * lanes + at
                observation[2 * n + i] = record[kernel.MOTOR_ANGLE * lanes + at_cable]
                observation[2 * n + m + i] = record[kernel.MOTOR_SPEED * lanes + at_cable]
    after_reference = first_reference + reference.shape[0]
    block = observation[
        first_reference:after_reference
    ]  # without a sum in its index, the loop vectorises
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
    return first_reference


@inline
def _check_state(record, at, lanes, workspace, flexible, cables):
    """Whether the state is finite, and whether the pose is inside the workspace."""
    finite, inside = True, True
    for j in range(workspace.shape[1]):
        coordinate = record[(kernel.POSE + j) * lanes + at]
        finite &= math.isfinite(coordinate) and math.isfinite(
            record[(kernel.VELOCITY + j) * lanes + at]
        )
        inside &= (coordinate >= workspace[0, j]) & (coordinate <= workspace[1, j])
    if flexible:
        for i in range(cables):
            at_cable = (kernel.FIRST_CABLE_RECORD + kernel.CABLE_RECORDS * i) * lanes + at
            finite &= math.isfinite(record[kernel.MOTOR_ANGLE * lanes + at_cable])
            finite &= math.isfinite(record[kernel.MOTOR_SPEED * lanes + at_cable])
    return finite, inside


@inline
def _measure_errors(finite, reference, record, at, lanes, dimensions, coordinates, info):
    """Errors at this instant and their peaks. Column 0 of the reference is the time to go; the pose
    follows."""
    square, rotation = 0.0, 0.0
    for j in range(coordinates):
        difference = record[(kernel.POSE + j) * lanes + at] - reference[1 + j]
        if j < dimensions:
            square += difference * difference
        else:
            rotation = max(rotation, abs(difference))
    position = math.sqrt(square)
    position_peak = max(position, record[kernel.POSITION_PEAK * lanes + at])
    rotation_peak = max(rotation, record[kernel.ROTATION_PEAK * lanes + at])
    if not finite:  # comparisons with NaN are false and would hide it
        position = position_peak = LARGEST
        rotation = rotation_peak = LARGEST if coordinates > dimensions else 0.0
    info[_POSITION] = _finite(position)
    info[_ROTATION] = _finite(rotation)
    info[_POSITION_PEAK] = _finite(position_peak)
    info[_ROTATION_PEAK] = _finite(rotation_peak)


@inline
def _report_cables(fresh, record, at, lanes, stall, minimum_tension, cables):
    """Fills the quantities of the cables. Returns the number of slack cables, the sum of the excess
    of the actions, and whether all cables have the minimum tension and all motors their torque."""
    slack_cables, excess, taut, held = 0.0, 0.0, True, True
    for i in range(stall.shape[0]):
        at_cable = (kernel.FIRST_CABLE_RECORD + kernel.CABLE_RECORDS * i) * lanes + at
        action = record[kernel.DEMAND * lanes + at_cable]
        torque = record[kernel.TORQUE * lanes + at_cable]
        least_tension = record[kernel.LEAST_TENSION * lanes + at_cable]
        slack = 1.0 if record[kernel.SLACK * lanes + at_cable] > 0.0 else 0.0
        margin = stall[i] - abs(torque) if fresh else stall[i] * (1.0 - abs(action))
        cables[_TENSION, i] = _finite(record[kernel.TENSION * lanes + at_cable])
        cables[_TORQUE, i] = _finite(torque)
        cables[_SPEED, i] = _finite(record[kernel.SPEED * lanes + at_cable])
        cables[_COMMANDED, i] = action
        cables[_MARGIN, i] = margin
        cables[_LEAST_TENSION, i] = _finite(least_tension)
        cables[_SLACK_CABLE, i] = slack
        slack_cables += slack
        excess += min(max(0.0, abs(action) - 1.0), 1.0)
        taut &= least_tension >= minimum_tension
        held &= margin >= 0.0
    return slack_cables, excess, taut, held


@inline
def _terminate(finite, inside, near, slack):
    """The termination reason, 0 for none."""
    if not finite:
        return _NON_FINITE
    if not inside:
        return _WORKSPACE
    if not near:
        return _TRACKING_ERROR
    return _SLACK if slack else 0


@inline
def _spoil(noise, encoders, resolution, count, bounds, observation):
    """Adds noise, rounds the first ``encoders`` components, and saturates the first ``count`` ones
    at their bounds."""
    for j in range(noise.shape[0]):
        observation[j] += noise[j]
    for j in range(encoders):
        observation[j] = resolution * math.floor(observation[j] / resolution + 0.5)
    for j in range(count):
        observation[j] = _saturated(observation[j], bounds[0, j], bounds[1, j])


@inline
def _normalise(first_reference, relative, centre, per_scale, observation):
    """Subtracts the reference from ``relative`` components of pose and velocity, and scales all
    components."""
    for j in range(
        relative
    ):  # the time to go precedes the reference pose, and the reference velocity follows it
        observation[j] -= observation[first_reference + 1 + j]
        observation[relative + j] -= observation[first_reference + 1 + relative + j]
    for j in range(observation.shape[0]):  # the scale of actions is 1
        observation[j] = (observation[j] - centre[j]) * per_scale[j]


@inline
def _reward(fresh, violated, penalty, excess, cables, turns, settings, weights, info):
    """Fills the reward terms and returns their sum."""
    inside = 0.0
    position = 0.0
    rotation = 0.0
    saturation = 0.0
    violation = 0.0
    if not fresh:
        inside = 0.0 if violated else weights[0]
        position = weights[1] / (1.0 + info[_POSITION] / settings[POSITION_BOUND])
        if turns:
            rotation = weights[2] / (1.0 + info[_ROTATION] / settings[ROTATION_BOUND])
        saturation = -weights[3] * excess / cables
        if penalty > 0:
            violation = -weights[4] * penalty
    info[_FIRST_TERM], info[_FIRST_TERM + 1], info[_FIRST_TERM + 2] = inside, position, rotation
    info[_FIRST_TERM + 3], info[_FIRST_TERM + 4] = saturation, violation
    return inside + position + rotation + saturation + violation


def info_dict(scalars: Array, cables: Array) -> dict[str, Any]:
    """Values by name: Python floats and (m,) of one environment, (N,) and (N, m) of several.

    The arrays are copies without gaps: JAX takes no others. ``slack`` and ``violated`` are boolean.

    Args:
        scalars: columns of the scalars, (columns,) or (N, columns).
        cables: quantities with one value per cable, (quantities, m) or (quantities, N, m).
    """
    single = scalars.ndim == 1
    columns = (
        scalars.tolist() if single else scalars.T.copy()
    )  # tolist() converts all scalars at once
    named: dict[str, Any] = dict(zip(INFO_SCALARS, columns, strict=True))
    named.update(zip(INFO_CABLES, cables.copy(), strict=True))
    named["violated"] = named["violated"] > _TRUE
    named["slack"] = named["slack"] > _TRUE
    return named
