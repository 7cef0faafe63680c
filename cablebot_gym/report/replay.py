"""Compressed episodes of a row for the report page: one at the DLCC and one at a slightly larger
payload."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablebot_gym.benchmark.rows import Row, policy_process
from cablebot_gym.evaluation import batch as batches
from cablebot_gym.evaluation.rollout import Rollout, record
from cablebot_gym.kinematics import Array
from cablebot_gym.rendering.moment import ball_radius
from cablebot_gym.rendering.projection import attached_points
from cablebot_gym.robots import Robot

RATE = 100
"""Frame rate of a replay [Hz]."""

EXCESS_FACTOR = 1.05
"""Ratio of the payload of the second episode to the DLCC; large enough to show the limiting
violation."""

MIN_EXCESS = 0.1
"""Minimum difference between the two payloads [kg]."""

LEVELS = 32000
"""Quantisation steps between the minimum and the maximum of a component; they fit into 16 bits."""


_RECORDED = (
    "time",
    "true_pose",
    "tensions",
    "commanded_action",
    "tracking_error",
    "rotation_error",
    "tracking_error_peak",
    "rotation_error_peak",
)
"""Recorded arrays of an episode."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """One episode as frames at :data:`RATE`. SI units and radians."""

    payload: float
    """True payload [kg]."""
    radius: float
    """Radius of the ball that represents the payload [m]."""
    carried: bool
    """Whether the policy carries the payload in this episode, by the task criterion."""
    violation: str
    """First violation; empty if there is none."""
    violation_time: float | None
    """Time of the first violation [s]; None if there is none."""
    end: float
    """Time of the last frame [s]. All other frames are 1/:data:`RATE` apart, starting at 0."""
    frames: int
    """Number of frames."""
    channels: Mapping[str, int]
    """Number of components by channel. Values at the time of the frame: ``position`` of the
    platform and its ``anchors`` [m]. Values over the interval since the previous frame: ``tension``
    (minimum) [N], ``action`` (value of the largest magnitude), ``position_error`` (maximum) [m] and
    ``rotation_error`` (maximum) [rad]."""
    low: list[float]
    """Minimum of each component."""
    high: list[float]
    """Maximum of each component."""
    data: str
    """Samples of one component after the other. Each component is quantised to 16 bits between
    ``low`` and ``high`` and stored as differences of successive frames: little-endian, compressed
    with zlib, base64-encoded."""


def platform_points(robot: Robot) -> tuple[Array, list[int]]:
    """The distinct anchor points of the platform (k, 2 or 3) [m], and the index of each cable's
    anchor point."""
    points, indices = np.unique(np.round(robot.platform, 12), axis=0, return_inverse=True)
    return points, np.ravel(indices).tolist()


def record_row(row: Row) -> list[Replay] | str:
    """The episodes of a row. An exception becomes an error message; it does not stop the report."""
    try:
        return replays(row)
    except Exception as error:
        return f"No episode: {' '.join(str(error).split())}"


def replays(row: Row) -> list[Replay]:
    """The episodes of a row: one at its DLCC and one at a larger payload, or one unloaded without a
    DLCC. With several draws, they are those of the first draw.

    Raises:
        ValueError: if the policy cannot be loaded or does not support the robot.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises an exception or returns an
            invalid action.
    """
    given = row.conditions
    seed = batches.draw_seeds(given.seed, given.draws or 1)[0]
    episodes = [
        batches.EpisodeSpec(payload, seed) for payload in _payloads(row.result.get("payload"))
    ]
    with policy_process(row) as policy:
        batch = batches.Batch(policy, replace(given, draws=1, seed=0))
        rollouts = record(batch, episodes, _RECORDED)
    return [compress(rollout) for rollout in rollouts]


def _payloads(dlcc: float | None) -> list[float]:
    if dlcc is None:
        return [0.0]
    return [dlcc, max(EXCESS_FACTOR * dlcc, dlcc + MIN_EXCESS)]


def compress(rollout: Rollout) -> Replay:
    """A recorded episode as a replay."""
    channels = _channels(rollout, max(1, round(rollout.task.control_frequency / RATE)))
    table = np.concatenate(list(channels.values()), axis=1)
    low = table.min(axis=0)
    high = table.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    levels = np.rint((table - low) / span * LEVELS).astype(np.int64)
    steps = np.diff(levels, axis=0, prepend=0).T.astype("<i2")
    packed = zlib.compress(steps.tobytes(), 9)
    violation = rollout.verdict.violation
    violation_text = ""
    violation_time = None
    if violation is not None:
        violation_text = str(violation)
        violation_time = violation.time
    return Replay(
        payload=rollout.payload,
        radius=ball_radius(rollout.payload),
        carried=rollout.verdict.carried,
        violation=violation_text,
        violation_time=violation_time,
        end=float(rollout.arrays["time"][-1]),
        frames=len(table),
        channels={name: values.shape[1] for name, values in channels.items()},
        low=low.tolist(),
        high=high.tolist(),
        data=base64.b64encode(packed).decode("ascii"),
    )


def _channels(rollout: Rollout, every: int) -> dict[str, Array]:
    """Frames of every channel: at the start, after every ``every`` control steps, and at the
    end."""
    robot = rollout.task.robot
    arrays = rollout.arrays
    steps = len(rollout) - 1
    starts = range(0, steps, every)
    ends = [*starts[1:], steps]
    poses = np.vstack([rollout.start["true_pose"], arrays["true_pose"][np.array(ends) - 1]])
    points, _ = platform_points(robot)
    tensions = np.minimum.reduceat(arrays["tensions"], starts)
    actions = []
    for start, end in zip(starts, ends, strict=True):
        action = arrays["commanded_action"][start:end]
        actions.append(action[np.abs(action).argmax(axis=0), np.arange(robot.cables)])
    channels = {
        "position": poses[:, : robot.dimensions],
        "anchors": attached_points(poses, points).reshape(len(poses), -1),
        # No interval precedes the initial frame: it repeats the values of the next one.
        "tension": np.vstack([tensions[:1], tensions]),
        "action": np.vstack([actions[:1], actions]),
        "position_error": _peaks(rollout, "tracking_error", starts),
    }
    if not robot.point_mass:
        channels["rotation_error"] = _peaks(rollout, "rotation_error", starts)
    return channels


def _peaks(rollout: Rollout, name: str, starts: Sequence[int]) -> Array:
    """An error at the start, and its largest values between successive frames, as a column."""
    peaks = np.maximum.reduceat(rollout.arrays[f"{name}_peak"], starts)
    return np.append(rollout.start[name], peaks)[:, None]
