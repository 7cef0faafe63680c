"""Compiled second half of an environment step: observation, reward, termination and info from the plant's record.

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
"""Names of the reward terms, in the order of the weights; defined in the manual of the single environment."""

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

INFO_CABLES = ("tensions", "torques", "motor_speeds", "commanded_action", "torque_margin", "least_tensions", "slack")
"""Names of the quantities of info with one value per cable."""

_TIME, _ACTION_TIME, _PAYLOAD, _POSITION, _ROTATION, _POSITION_PEAK, _ROTATION_PEAK, _FIRST_TERM = range(8)
_TERMS = len(REWARD_TERMS)
_INSIDE, _POSITION_TERM, _ROTATION_TERM, _SATURATION, _VIOLATION_TERM = range(_FIRST_TERM, _FIRST_TERM + _TERMS)
_VIOLATED = _FIRST_TERM + _TERMS
_COST = _VIOLATED + 1
_TENSION, _TORQUE, _SPEED, _COMMANDED, _MARGIN, _LEAST_TENSION, _SLACK_CABLE = range(len(INFO_CABLES))
_TRUE = 0.5  # true is 1 in the columns of ``violated`` and ``slack``, false is 0

# Columns of the episode settings.
PAYLOAD, MODEL_PAYLOAD, KNOWN, POSITION_BOUND, ROTATION_BOUND, STARTS_AT_REST = range(6)
EPISODE_SETTINGS = 6

LARGEST = 1e6
"""Largest magnitude in ``info``: larger and non-finite values become ±1e6. Actions must be smaller."""


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
    """Smallest step of the motor angles [rad], the first block of the readings; 0 for exact angles."""
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
    """Least valid tension at a physics step [N]; −∞ for bilateral cables, which only have to pull."""
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
    """Exact readings of the sensors of winches and platform, (N, components); (N, 0) if pose and velocity are
    measured."""
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
    """Fills the outputs of the environments ``env_indices``. Errors, reward and termination use the true state.

    Args:
        fresh: whether the environments have just been reset: then there is no reward and no termination.
        env_indices: environments, (k,).
        constants: :class:`Constants`, as a plain tuple, whose type numba finds several times faster.
        episodes: :class:`Episodes`, as a plain tuple.
        outputs: :class:`Outputs`, as a plain tuple.
    """
    batch, now, out = Constants(*constants), Episodes(*episodes), Outputs(*outputs)
    lanes, m, n = batch.lanes, now.stall.shape[1], batch.workspace.shape[1]
    workspace, bounds, weights, turns = batch.workspace, batch.bounds, batch.weights, n > batch.dimensions
    # Arrays as local variables: in the loop, each access to an array of a record counts a reference.
    records, settings, stall, noise, slack_for = now.record, now.settings, now.stall, now.noise, now.slack_for
    sent, violations, motion_steps, readings = now.sent, now.violated, now.motion_steps, now.readings
    measured, resolution = readings.shape[1], batch.encoder_resolution
    centre, per_scale = batch.centre, batch.per_scale
    steps, trajectories, references, last_rows = now.step, now.trajectory_index, now.references, now.last_rows
    observations, infos, cables, rewards = out.observation, out.info, out.cables, out.reward
    reasons, completes = out.reason, out.complete
    for k in range(env_indices.shape[0]):
        env_index = env_indices[k]
        tile, at = env_index // lanes, env_index % lanes  # a view of the tile would count a reference
        step, trajectory = steps[env_index], trajectories[env_index]
        reference = references[trajectory, min(step, last_rows[trajectory])]

        # Observation: pose, velocity, motors of flexible robots, or readings of winches; tabulated reference blocks,
        # payload of the model, last actions, slack time.
        observation = observations[env_index]
        finite, inside = True, True
        for j in range(n):
            coordinate = records[tile, (kernel.POSE + j) * lanes + at]
            rate = records[tile, (kernel.VELOCITY + j) * lanes + at]
            finite &= math.isfinite(coordinate) and math.isfinite(rate)
            inside &= (coordinate >= workspace[0, j]) & (coordinate <= workspace[1, j])
            if measured == 0:
                observation[j] = coordinate
                observation[n + j] = rate
        first_reference = 2 * n
        if batch.flexible:
            first_reference = 2 * n + 2 * m
            for i in range(m):
                at_cable = (kernel.FIRST_CABLE_RECORD + kernel.CABLE_RECORDS * i) * lanes + at
                angle = records[tile, kernel.MOTOR_ANGLE * lanes + at_cable]
                motor_speed = records[tile, kernel.MOTOR_SPEED * lanes + at_cable]
                finite &= math.isfinite(angle) and math.isfinite(motor_speed)
                if measured == 0:
                    observation[2 * n + i] = angle
                    observation[2 * n + m + i] = motor_speed
        if measured > 0:
            first_reference = measured
            for j in range(measured):
                observation[j] = readings[env_index, j]
        after_reference = first_reference + reference.shape[0]
        block = observation[first_reference:after_reference]  # without a sum in its index, the loop vectorises
        for j in range(reference.shape[0]):
            block[j] = reference[j]
        observation[after_reference] = settings[env_index, MODEL_PAYLOAD]
        observation[after_reference + 1] = settings[env_index, KNOWN]
        first_action, slack_column = after_reference + 2, observation.shape[0] - 1
        if fresh:
            for j in range(first_action, slack_column):
                observation[j] = 0.0
        else:  # the last observation holds the actions that were sent before
            for j in range(slack_column - 1, first_action + m - 1, -1):
                observation[j] = observation[j - m]
            for i in range(m):
                observation[first_action + i] = min(max(sent[env_index, i], -1.0), 1.0)

        # Errors at this instant. Column 0 of the reference is the time to go; the reference pose follows.
        square, rotation = 0.0, 0.0
        for j in range(n):
            difference = records[tile, (kernel.POSE + j) * lanes + at] - reference[1 + j]
            if j < batch.dimensions:
                square += difference * difference
            else:
                rotation = max(rotation, abs(difference))
        position = math.sqrt(square)
        position_peak = max(position, records[tile, kernel.POSITION_PEAK * lanes + at])
        rotation_peak = max(rotation, records[tile, kernel.ROTATION_PEAK * lanes + at])
        if not finite:  # comparisons with NaN are false and would hide it
            position = position_peak = LARGEST
            rotation = rotation_peak = LARGEST if turns else 0.0

        info = infos[env_index]
        info[_TIME] = step * batch.period
        info[_ACTION_TIME] = max(step - 1, 0) * batch.period
        info[_PAYLOAD] = settings[env_index, PAYLOAD]
        info[_POSITION] = _finite(position)
        info[_ROTATION] = _finite(rotation)
        info[_POSITION_PEAK] = _finite(position_peak)
        info[_ROTATION_PEAK] = _finite(rotation_peak)
        slack_cables, excess, taut, held = 0.0, 0.0, True, True
        for i in range(m):
            at_cable = (kernel.FIRST_CABLE_RECORD + kernel.CABLE_RECORDS * i) * lanes + at
            action = records[tile, kernel.DEMAND * lanes + at_cable]
            torque = records[tile, kernel.TORQUE * lanes + at_cable]
            least_tension = records[tile, kernel.LEAST_TENSION * lanes + at_cable]
            slack = 1.0 if records[tile, kernel.SLACK * lanes + at_cable] > 0.0 else 0.0
            margin = stall[env_index, i] - abs(torque) if fresh else stall[env_index, i] * (1.0 - abs(action))
            cables[_TENSION, env_index, i] = _finite(records[tile, kernel.TENSION * lanes + at_cable])
            cables[_TORQUE, env_index, i] = _finite(torque)
            cables[_SPEED, env_index, i] = _finite(records[tile, kernel.SPEED * lanes + at_cable])
            cables[_COMMANDED, env_index, i] = action
            cables[_MARGIN, env_index, i] = margin
            cables[_LEAST_TENSION, env_index, i] = _finite(least_tension)
            cables[_SLACK_CABLE, env_index, i] = slack
            slack_cables += slack
            excess += min(max(0.0, abs(action) - 1.0), 1.0)
            taut &= least_tension >= batch.minimum_tension
            held &= margin >= 0.0

        # Termination and violation. Comparisons with NaN are false, so they are written to be true if all is well.
        reason = 0
        if fresh:
            slack_for[env_index] = 0.0
            violates = settings[env_index, STARTS_AT_REST] > 0.0 and not held
        else:
            slack_for[env_index] = slack_for[env_index] + batch.period if slack_cables > 0.0 else 0.0
            if not finite:
                reason = _NON_FINITE
            elif not inside:
                reason = _WORKSPACE
            elif not position <= batch.termination_radius:
                reason = _TRACKING_ERROR
            elif slack_for[env_index] > batch.slack_time + 1e-9:
                reason = _SLACK
            violates = reason > 0 or slack_cables > 0.0 or not taut
            if step == 1:  # a violation at the start counts in the first step
                violates = violates or violations[env_index]
        if not (
            position_peak <= settings[env_index, POSITION_BOUND]
            and rotation_peak <= settings[env_index, ROTATION_BOUND]
        ):
            violates = True
        violated = violates or (not fresh and violations[env_index])
        first_violation = violated and (step == 1 or not violations[env_index])
        violations[env_index] = violated
        if violated and not fresh and reason == 0 and batch.terminate_on_violation:
            reason = _VIOLATION
        reasons[env_index], completes[env_index] = reason, step >= motion_steps[env_index]
        info[_VIOLATED] = 1.0 if violated else 0.0
        info[_COST] = 1.0 if violates else 0.0

        # The observation is complete: noise, resolution of the encoders, saturation at the bounds, scales.
        observation[slack_column] = min(slack_for[env_index], bounds[1, slack_column])
        for j in range(noise.shape[1]):
            observation[j] += noise[env_index, j]
        if resolution > 0.0:
            for j in range(m):
                observation[j] = resolution * math.floor(observation[j] / resolution + 0.5)
        for j in range(first_action):
            observation[j] = _saturated(observation[j], bounds[0, j], bounds[1, j])
        if batch.normalised:
            for j in range(
                n if measured == 0 else 0
            ):  # the time to go precedes the reference pose, and the reference velocity follows it
                observation[j] -= observation[first_reference + 1 + j]
                observation[n + j] -= observation[first_reference + 1 + n + j]
            for j in range(observation.shape[0]):  # the scale of actions is 1
                observation[j] = (observation[j] - centre[j]) * per_scale[j]

        inside_term, position_term, rotation_term, saturation_term, violation_term = 0.0, 0.0, 0.0, 0.0, 0.0
        if not fresh:
            inside_term = 0.0 if violated else weights[0]
            position_term = weights[1] / (1.0 + info[_POSITION] / settings[env_index, POSITION_BOUND])
            if turns:
                rotation_term = weights[2] / (1.0 + info[_ROTATION] / settings[env_index, ROTATION_BOUND])
            saturation_term = -weights[3] * excess / m
            violation_term = -weights[4] * motion_steps[env_index] if first_violation else 0.0
        info[_INSIDE], info[_POSITION_TERM], info[_ROTATION_TERM] = inside_term, position_term, rotation_term
        info[_SATURATION], info[_VIOLATION_TERM] = saturation_term, violation_term
        rewards[env_index] = inside_term + position_term + rotation_term + saturation_term + violation_term


def info_dict(scalars: Array, cables: Array) -> dict[str, Any]:
    """Values by name: Python floats and (m,) of one environment, (N,) and (N, m) of several.

    The arrays are copies without gaps: JAX takes no others. ``slack`` and ``violated`` are boolean.

    Args:
        scalars: columns of the scalars, (columns,) or (N, columns).
        cables: quantities with one value per cable, (quantities, m) or (quantities, N, m).
    """
    single = scalars.ndim == 1
    columns = scalars.tolist() if single else scalars.T.copy()  # tolist() converts all scalars at once
    named: dict[str, Any] = dict(zip(INFO_SCALARS, columns, strict=True))
    named.update(zip(INFO_CABLES, cables.copy(), strict=True))
    named["violated"] = named["violated"] > _TRUE
    named["slack"] = named["slack"] > _TRUE
    return named
