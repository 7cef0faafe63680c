"""The layout of the flat observation: named slices, units and bounds, in one place for envs, policies and documents."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Trajectory

PREVIEWS = (0.02, 0.05, 0.1, 0.2)
"""How far ahead the reference is previewed [s]."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """One named part of the observation."""

    name: str
    """Key of :meth:`ObservationLayout.slices`."""
    start: int
    """First component."""
    size: int
    """Number of components."""
    low: tuple[float, ...]
    """Lower bounds, (size,)."""
    high: tuple[float, ...]
    """Upper bounds, (size,)."""
    unit: str
    """Units: positions, then angles."""
    meaning: str
    """One line."""

    @property
    def slice(self) -> slice:
        """Where the block stands."""
        return slice(self.start, self.start + self.size)


@dataclass(frozen=True, kw_only=True)
class ObservationLayout:
    """Named blocks of the observation of one robot. Works on one observation (size,) and on a batch (N, size)."""

    blocks: tuple[Block, ...]
    """In the order of the observation."""

    @property
    def size(self) -> int:
        """Number of components."""
        return self.blocks[-1].start + self.blocks[-1].size

    def slices(self) -> dict[str, slice]:
        """Slice of each block by name."""
        return {block.name: block.slice for block in self.blocks}

    def checked(self, observation: ArrayLike, robot_name: str) -> Array:
        """The observation as an array (..., size); ``robot_name`` is for the error alone.

        Raises:
            ValueError: if it has another size: it belongs to another robot.
        """
        array = np.asarray(observation, float)
        if array.shape[-1:] != (self.size,):
            raise ValueError(
                f"a policy for robot {robot_name!r} reads {self.size} components, not {array.shape[-1:]}: "
                "build it for the environment's robot"
            )
        return array

    def split(self, observation: Array) -> dict[str, Array]:
        """Views of the blocks by name, each (..., size of the block)."""
        return {block.name: observation[..., block.slice] for block in self.blocks}

    def space(self) -> Box:
        """The bounded Box; an observation saturates at its bounds, which no useful motion reaches."""
        low = np.concatenate([block.low for block in self.blocks])
        high = np.concatenate([block.high for block in self.blocks])
        return Box(low, high, dtype=np.float64)

    def table(self) -> str:
        """The observation as a Markdown table."""
        lines = ["| components | name | unit | low | high | meaning |", "|---|---|---|---|---|---|"]
        for block in self.blocks:
            place = str(block.start) if block.size == 1 else f"{block.start}–{block.start + block.size - 1}"
            low, high = (_bounds_text(bounds) for bounds in (block.low, block.high))
            lines.append(f"| {place} | `{block.name}` | {block.unit} | {low} | {high} | {block.meaning} |")
        return "\n".join(lines)


def _bounds_text(bounds: tuple[float, ...]) -> str:
    values = list(dict.fromkeys(f"{bound:.3g}" for bound in bounds))
    return ", ".join(values)


def preview_name(ahead: float) -> str:
    """Name of the block that previews the reference so far ahead [s]."""
    return f"preview_{round(ahead * 1e3)}ms"


@lru_cache(maxsize=64)
def observation_layout(robot: Robot) -> ObservationLayout:
    """The layout for a robot. Bounds follow from its workspace: half as much again on each side."""
    n = robot.coordinates
    low, high = robot.pose_bounds
    middle, reach = (low + high) / 2, 0.75 * (high - low)
    pose = (tuple(middle - reach), tuple(middle + reach))
    angles = np.arange(n) >= 3
    units = ("m", "m/s", "m/s²") if robot.planar else ("m, rad", "m/s, rad/s", "m/s², rad/s²")
    symmetric = {
        order: (tuple(-np.where(angles, turn, line)), tuple(np.where(angles, turn, line)))
        for order, line, turn in ((0, 2.0, 4.0), (1, 20.0, 100.0), (2, 1e3, 1e4), (3, 1e5, 1e6), (4, 1e7, 1e8))
    }
    wide = [((-bound,) * robot.cables, (bound,) * robot.cables) for bound in (1e3, 1e3)]
    motors = [
        ("motor_angle", robot.cables, wide[0], "rad", "β′; less the pulley's angle, the wind-up of the springs"),
        ("motor_speed", robot.cables, wide[1], "rad/s", "β̇′"),
    ]
    higher = [
        ("reference_jerk", n, symmetric[3], units[2].replace("²", "³"), "third derivative of X_d"),
        ("reference_snap", n, symmetric[4], units[2].replace("²", "⁴"), "fourth derivative of X_d"),
    ]
    parts = [
        ("pose", n, pose, units[0], "X, measured: exact unless sensors are noisy"),
        ("velocity", n, symmetric[1], units[1], "Ẋ"),
        *(motors if robot.flexible else []),
        ("time_left", 1, ((0.0,), (1e3,)), "s", "until the reference motion ends; 0 afterwards"),
        ("reference_pose", n, pose, units[0], "X_d at the present control instant"),
        ("reference_velocity", n, symmetric[1], units[1], "first derivative of X_d"),
        ("reference_acceleration", n, symmetric[2], units[2], "second derivative of X_d"),
        *(higher if robot.flexible else []),
        *(
            (preview_name(ahead), n, symmetric[0], units[0], f"X_d {ahead:g} s ahead, less X_d now")
            for ahead in PREVIEWS
        ),
        ("told_payload", 1, ((0.0,), (1e3,)), "kg", "payload as told; 0 if it is not known"),
        ("payload_known", 1, ((0.0,), (1.0,)), "–", "1 if the payload is told, else 0"),
    ]
    blocks, start = [], 0
    for name, size, (lows, highs), unit, meaning in parts:
        lows, highs = tuple(map(float, lows)), tuple(map(float, highs))
        blocks.append(Block(name=name, start=start, size=size, low=lows, high=highs, unit=unit, meaning=meaning))
        start += size
    return ObservationLayout(blocks=tuple(blocks))


def observed_reference(trajectory: Trajectory, times: Array, *, to_snap: bool) -> dict[str, Array]:
    """What an observation says of the reference at each time (K,): its blocks by name, each (K, size), in order.

    Args:
        trajectory: the reference.
        times: since the episode's start [s].
        to_snap: whether the robot is flexible.
    """
    now = trajectory(times)
    derivatives = {"pose": now.position, "velocity": now.velocity, "acceleration": now.acceleration}
    if to_snap:
        derivatives |= {"jerk": now.jerk, "snap": now.snap}
    return {
        "time_left": np.maximum(trajectory.duration - times, 0.0)[:, None],
        **{f"reference_{name}": values for name, values in derivatives.items()},
        **{preview_name(ahead): trajectory(times + ahead).position - now.position for ahead in PREVIEWS},
    }
