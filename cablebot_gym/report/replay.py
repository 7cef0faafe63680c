"""Compressed episodes of a cell for the report page: one at the DLCC and one at a slightly larger payload."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell
from cablebot_gym.bounds.best_known import cached_best_known
from cablebot_gym.evaluation.batch import draw_seeds
from cablebot_gym.evaluation.constraints import DLCCMonitor
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.kinematics import Array, rotation_matrix
from cablebot_gym.policies import load_policy
from cablebot_gym.rendering.moment import Moment, ball_radius
from cablebot_gym.robots import Robot

RATE = 100
"""Frame rate of a replay [Hz]."""

EXCESS_FACTOR = 1.05
"""Ratio of the payload of the second episode to the DLCC; large enough to show the limiting violation."""

MIN_EXCESS = 0.1
"""Minimum difference between the two payloads [kg]."""

LEVELS = 32000
"""Quantisation steps between the minimum and the maximum of a component; they fit into 16 bits."""


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
    end: float
    """Time of the last frame [s]. All other frames are 1/:data:`RATE` apart, starting at 0."""
    frames: int
    """Number of frames."""
    channels: Mapping[str, int]
    """Number of components by channel. Values at the time of the frame: ``position`` of the platform and its
    ``anchors`` [m]. Values over the interval since the previous frame: ``tension`` (minimum) [N], ``action`` (value of
    the largest magnitude), ``position_error`` (maximum) [m] and ``rotation_error`` (maximum) [rad]."""
    low: tuple[float, ...]
    """Minimum of each component."""
    high: tuple[float, ...]
    """Maximum of each component."""
    data: str
    """Samples of one component after the other. Each component is quantised to 16 bits between ``low`` and ``high`` and
    stored as differences of successive frames: little-endian, compressed with zlib, base64-encoded."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        return asdict(self)


def unpack_channels(replay: Replay) -> dict[str, Array]:
    """The channels of a replay as arrays (frames, components)."""
    steps = np.frombuffer(zlib.decompress(base64.b64decode(replay.data)), "<i2").reshape(-1, replay.frames)
    levels = np.cumsum(steps.astype(np.int64), axis=1).T
    low, high = np.array(replay.low), np.array(replay.high)
    values = low + levels / LEVELS * (high - low)
    ends = np.cumsum(list(replay.channels.values()))[:-1]
    return dict(zip(replay.channels, np.split(values, ends, axis=1), strict=True))


def platform_points(robot: Robot) -> tuple[Array, list[int]]:
    """The distinct anchor points of the platform (k, 2 or 3) [m], and the index of each cable's anchor point."""
    anchors = np.zeros_like(robot.base) if robot.planar else robot.platform
    points, indices = np.unique(np.round(anchors, 12), axis=0, return_inverse=True)
    return points, [int(index) for index in np.ravel(indices)]


def replays(cell: PolicyCell, payload: float | None) -> list[Replay]:
    """The episode of a cell at its DLCC and one at a larger payload; one unloaded episode without a DLCC.

    For a cell with several draws, the episodes are those of the first draw.

    Args:
        cell: policy and conditions.
        payload: DLCC of the cell [kg]; None if the policy fails unloaded.

    Raises:
        ValueError: if the policy cannot be loaded or does not support the robot.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises an exception or returns an invalid action.
    """
    seed = draw_seeds(cell.seed, cell.draws)[0]
    policy = load_policy(cell.policy, cell.robot)
    payloads = [0.0] if payload is None else [payload, max(EXCESS_FACTOR * payload, payload + MIN_EXCESS)]
    options = cell.env_options()
    return [_replay(policy, cell, value, seed=seed, options=options) for value in payloads]


def best_replays(cell: BestKnownCell) -> list[Replay]:
    """The episode of a best known payload: an open-loop replay of its actions.

    Raises:
        ValueError: if the cache does not contain the actions.
        ImportError: if CasADi is missing.
    """
    options = cell.options()
    result = cached_best_known(cell.env_id, **options)
    if result is None:
        raise ValueError(
            "the actions of this best known payload are not in the cache of this machine, or they were computed by "
            "different code. Run the code under 'How this number is computed' (minutes), then cablebot report again"
        )
    options = options | {"robot": cell.robot}
    return [_replay(_OpenLoop(result.actions), cell, result.payload, seed=0, options=options)]


class _OpenLoop:
    """An open-loop policy: it returns the rows of ``actions`` (steps, m) one after the other."""

    def __init__(self, actions: Array) -> None:
        self._actions = actions

    def predict(
        self, observation: Array, state: int | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Array, int]:
        step = state or 0
        return self._actions[None, step], step + 1


def _replay(
    policy: Any,
    cell: PolicyCell | BestKnownCell,
    payload: float,
    *,
    seed: int,
    options: Mapping[str, Any],
) -> Replay:
    moments: list[Moment] = []

    def record_moment(env: DLCCMonitor) -> None:
        moments.append(env.get_wrapper_attr("moment"))

    recorded = record_rollout(policy, cell.env_id, payload=payload, seed=seed, on_step=record_moment, **options)
    channels = _channels(cell.robot, moments, recorded.arrays, max(1, round(cell.control_frequency / RATE)))
    table = np.concatenate(list(channels.values()), axis=1)
    low, high, data = _pack(table)
    violation = recorded.verdict.violation
    return Replay(
        payload=moments[0].payload,
        radius=ball_radius(moments[0].payload),
        carried=recorded.verdict.carried,
        violation="" if violation is None else str(violation),
        end=moments[-1].time,
        frames=len(table),
        channels={name: values.shape[1] for name, values in channels.items()},
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        data=data,
    )


def _channels(robot: Robot, moments: list[Moment], arrays: Mapping[str, Array], every: int) -> dict[str, Array]:
    """Frames of every channel: at the start, after every ``every`` control steps, and at the end."""
    steps = len(moments) - 1
    ends = [*range(every, steps, every), steps]
    windows = [slice(end - every if end % every == 0 else end - end % every, end) for end in ends]
    poses = np.array([moments[index].pose for index in (0, *ends)])
    position = poses[:, : robot.base.shape[1]]
    points, _ = platform_points(robot)
    anchors = position[:, None] + points
    if not robot.planar:
        anchors = position[:, None] + points @ np.swapaxes(rotation_matrix(poses[:, 3:]), -1, -2)
    action = arrays["commanded_action"]
    peaks = [np.take_along_axis(rows, np.abs(rows).argmax(0)[None], 0)[0] for rows in (action[w] for w in windows)]
    channels = {
        "position": position,
        "anchors": anchors.reshape(len(poses), -1),
        "tension": _repeat_first([arrays["tensions"][w].min(0) for w in windows]),
        "action": _repeat_first(peaks),
        "position_error": _prepend(
            moments[0].position_error, [arrays["tracking_error_peak"][w].max() for w in windows]
        ),
        "rotation_error": _prepend(
            moments[0].rotation_error, [arrays["rotation_error_peak"][w].max() for w in windows]
        ),
    }
    if robot.planar:
        del channels["rotation_error"]
    return channels


def _repeat_first(rows: list[Array]) -> Array:
    """Rows with the first one repeated, because no interval precedes the initial frame."""
    return np.array([rows[0], *rows])


def _prepend(first: float, values: list[float]) -> Array:
    return np.array([first, *values])[:, None]


def _pack(table: Array) -> tuple[Array, Array, str]:
    low, high = table.min(axis=0), table.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    levels = np.rint((table - low) / span * LEVELS).astype(np.int64)
    steps = np.diff(levels, axis=0, prepend=0).T.astype("<i2")
    return low, high, base64.b64encode(zlib.compress(np.ascontiguousarray(steps).tobytes(), 9)).decode("ascii")


def frame_times(replay: Replay) -> Array:
    """Time of each frame (frames,) [s]."""
    return np.minimum(np.arange(replay.frames) / RATE, replay.end)
