"""What a cell's robot did, small enough for a page: one episode at the payload carried, and one just beyond."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cablebot_gym.benchmark.cells import BestCell, PolicyCell
from cablebot_gym.bounds.best_known import known_best
from cablebot_gym.evaluation.batch import draw_seeds
from cablebot_gym.evaluation.constraints import DLCCMonitor
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.kinematics import Array, rotation_matrix
from cablebot_gym.policies import load_policy
from cablebot_gym.rendering.moment import Moment, ball_radius
from cablebot_gym.robots import Robot

RATE = 100
"""Frames a second."""

BEYOND = 1.05
"""Payload of the second episode, as a share of the first's: enough to see what gives way."""

LEAST = 0.1
"""Least payload beyond none [kg]."""

LEVELS = 32000
"""Steps between the least and the largest value of a channel: 16 bits."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """One episode, frame by frame. SI units and radians."""

    payload: float
    """True payload [kg]."""
    radius: float
    """Of the ball that stands for it [m]."""
    carried: bool
    """By the task criterion, in this episode."""
    limit: str
    """What gave way first; empty if nothing did."""
    end: float
    """Time of the last frame [s]; the frames before are 1/:data:`RATE` apart, the first at 0."""
    frames: int
    """How many there are."""
    channels: Mapping[str, int]
    """Names and their numbers of components. Of the instant: ``position`` of the platform, ``anchors`` on it; since the
    frame before: ``tension`` (least), ``demand`` (that of the largest magnitude), ``position_error`` and
    ``rotation_error`` (largest)."""
    low: tuple[float, ...]
    """Least value of each component."""
    high: tuple[float, ...]
    """Largest value of each component."""
    data: str
    """Components one after the other, each the differences of 16-bit numbers between ``low`` and ``high``, little
    endian, compressed by zlib, in base 64."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        return asdict(self)


def unpacked(replay: Replay) -> dict[str, Array]:
    """What a replay's data say, by channel: arrays (frames, components)."""
    steps = np.frombuffer(zlib.decompress(base64.b64decode(replay.data)), "<i2").reshape(-1, replay.frames)
    levels = np.cumsum(steps.astype(np.int64), axis=1).T
    low, high = np.array(replay.low), np.array(replay.high)
    values = low + levels / LEVELS * (high - low)
    ends = np.cumsum(list(replay.channels.values()))[:-1]
    return dict(zip(replay.channels, np.split(values, ends, axis=1), strict=True))


def platform_points(robot: Robot) -> tuple[Array, list[int]]:
    """The different points of the platform where cables end (k, 2 or 3), and each cable's place among them."""
    anchors = np.zeros_like(robot.base) if robot.planar else robot.platform
    points, places = np.unique(np.round(anchors, 12), axis=0, return_inverse=True)
    return points, [int(place) for place in np.ravel(places)]


def replays(cell: PolicyCell, payload: float | None) -> list[Replay]:
    """The episode at the payload that a cell's policy carries (at zero if it carries none), and one beyond it.

    Over draws they are those of the first draw.

    Args:
        cell: says which policy, and under which conditions.
        payload: true payload carried [kg]; None for none.

    Raises:
        ValueError: if the policy is not to be had, or not made for the robot.
        cablebot_gym.policies.PolicyError: if the policy raises or returns anything but finite drive commands.
    """
    share, seed = cell.told_share, draw_seeds(cell.seed, cell.draws)[0]
    policy = load_policy(cell.policy, cell.robot)
    asked = [0.0] if payload is None else [payload, max(BEYOND * payload, payload + LEAST)]
    conditions = cell.conditions()
    return [_replay(policy, cell, true, told=share * true, seed=seed, conditions=conditions) for true in asked]


def best_replays(cell: BestCell) -> list[Replay]:
    """The episode of a best found: its inputs, replayed without feedback.

    Raises:
        ValueError: if they are not kept; the message says what finds them anew.
        ImportError: if CasADi is missing.
    """
    question = cell.question()
    found = known_best(cell.env_id, **question)
    if found is None:
        raise ValueError(
            "the inputs of this best found are not kept on this machine, or other code found them; the lines under "
            "'How this number was made' find them anew, in minutes, and then cablebot report shows them"
        )
    conditions = question | {"robot": cell.robot}
    return [_replay(_Inputs(found.commands), cell, found.payload, told=found.payload, seed=0, conditions=conditions)]


class _Inputs:
    """A policy that gives commands (steps, m) one after the other, whatever happens."""

    def __init__(self, commands: Array) -> None:
        self._commands = commands

    def predict(
        self, observation: Array, state: int | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Array, int]:
        step = state or 0
        return self._commands[None, step], step + 1


def _replay(
    policy: Any, cell: PolicyCell | BestCell, payload: float, *, told: float, seed: int, conditions: Mapping[str, Any]
) -> Replay:
    moments: list[Moment] = []

    def look(env: DLCCMonitor) -> None:
        moments.append(env.get_wrapper_attr("moment"))

    recorded = record_rollout(policy, cell.env_id, payload=told, seed=seed, look=look, **conditions)
    channels = _channels(cell.robot, moments, recorded.arrays, max(1, round(cell.control_frequency / RATE)))
    table = np.concatenate(list(channels.values()), axis=1)
    low, high, data = _packed(table)
    limit = recorded.verdict.limit
    return Replay(
        payload=moments[0].payload,
        radius=ball_radius(moments[0].payload),
        carried=recorded.verdict.carried,
        limit="" if limit is None else str(limit),
        end=moments[-1].time,
        frames=len(table),
        channels={name: values.shape[1] for name, values in channels.items()},
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        data=data,
    )


def _channels(robot: Robot, moments: list[Moment], arrays: Mapping[str, Array], every: int) -> dict[str, Array]:
    """Frames of every channel: at the start, then after each ``every`` control steps and at the end."""
    steps = len(moments) - 1
    ends = [*range(every, steps, every), steps]
    windows = [slice(end - every if end % every == 0 else end - end % every, end) for end in ends]
    poses = np.array([moments[place].pose for place in (0, *ends)])
    position = poses[:, : robot.base.shape[1]]
    points, _ = platform_points(robot)
    anchors = position[:, None] + points
    if not robot.planar:
        anchors = position[:, None] + points @ np.swapaxes(rotation_matrix(poses[:, 3:]), -1, -2)
    demand = arrays["drive_demand"]
    loudest = [np.take_along_axis(part, np.abs(part).argmax(0)[None], 0)[0] for part in (demand[w] for w in windows)]
    channels = {
        "position": position,
        "anchors": anchors.reshape(len(poses), -1),
        "tension": _held([arrays["tensions"][w].min(0) for w in windows]),
        "demand": _held(loudest),
        "position_error": _led(moments[0].position_error, [arrays["tracking_error_peak"][w].max() for w in windows]),
        "rotation_error": _led(moments[0].rotation_error, [arrays["rotation_error_peak"][w].max() for w in windows]),
    }
    if robot.planar:
        del channels["rotation_error"]
    return channels


def _held(rows: list[Array]) -> Array:
    """No control period has passed at the start: its frame is that of the first."""
    return np.array([rows[0], *rows])


def _led(first: float, values: list[float]) -> Array:
    return np.array([first, *values])[:, None]


def _packed(table: Array) -> tuple[Array, Array, str]:
    low, high = table.min(axis=0), table.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    levels = np.rint((table - low) / span * LEVELS).astype(np.int64)
    steps = np.diff(levels, axis=0, prepend=0).T.astype("<i2")
    return low, high, base64.b64encode(zlib.compress(np.ascontiguousarray(steps).tobytes(), 9)).decode("ascii")


def frame_times(replay: Replay) -> Array:
    """Of each frame (frames,) [s]."""
    return np.minimum(np.arange(replay.frames) / RATE, replay.end)
