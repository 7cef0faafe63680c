"""Layout of the flat observation: names, slices, units and bounds of its blocks."""

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
"""Preview times: how far ahead the observation shows the reference [s]."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """One named block of the observation."""

    name: str
    """Name of the block, a key of :meth:`ObservationLayout.slices`."""
    start: int
    """Index of the first component."""
    size: int
    """Number of components."""
    low: tuple[float, ...]
    """Lower bounds, (size,)."""
    high: tuple[float, ...]
    """Upper bounds, (size,)."""
    unit: str
    """Units of the components: of positions, then of angles."""
    meaning: str
    """Meaning in one line."""

    @property
    def slice(self) -> slice:
        """Slice of the block in the observation."""
        return slice(self.start, self.start + self.size)


@dataclass(frozen=True, kw_only=True)
class ObservationLayout:
    """Named blocks of the observation of one robot. Methods accept one observation (size,) or a batch (N, size)."""

    blocks: tuple[Block, ...]
    """Blocks in the order of the observation."""

    @property
    def size(self) -> int:
        """Number of components."""
        return self.blocks[-1].start + self.blocks[-1].size

    def slices(self) -> dict[str, slice]:
        """Slice of each block by name."""
        return {block.name: block.slice for block in self.blocks}

    def checked(self, observation: ArrayLike, robot_name: str) -> Array:
        """The observation as a float array (..., size). ``robot_name`` is used in the error message.

        Raises:
            ValueError: if the last axis has another size, as the observation of another robot has.
        """
        array = np.asarray(observation, float)
        if array.shape[-1:] != (self.size,):
            raise ValueError(
                f"a policy for robot {robot_name!r} reads observations of {self.size} components, not of shape "
                f"{array.shape}: build it for the environment's robot"
            )
        return array

    def split(self, observation: Array) -> dict[str, Array]:
        """Views of the blocks by name, each (..., size of the block)."""
        return {block.name: observation[..., block.slice] for block in self.blocks}

    def space(self) -> Box:
        """The bounded observation space. Components saturate at the bounds; useful motions do not reach them."""
        low = np.concatenate([block.low for block in self.blocks])
        high = np.concatenate([block.high for block in self.blocks])
        return Box(low, high, dtype=np.float64)

    def table(self) -> str:
        """Markdown table of the blocks."""
        lines = ["| components | name | unit | low | high | meaning |", "|---|---|---|---|---|---|"]
        for block in self.blocks:
            components = str(block.start) if block.size == 1 else f"{block.start}–{block.start + block.size - 1}"
            low, high = (
                ", ".join(dict.fromkeys(f"{bound:.3g}" for bound in bounds)) for bounds in (block.low, block.high)
            )
            lines.append(f"| {components} | `{block.name}` | {block.unit} | {low} | {high} | {block.meaning} |")
        return "\n".join(lines)


def preview_name(ahead: float) -> str:
    """Name of the block that previews the reference ``ahead`` seconds ahead."""
    return f"preview_{round(ahead * 1e3)}ms"


@lru_cache(maxsize=64)
def observation_layout(robot: Robot) -> ObservationLayout:
    """Layout for a robot. The bounds of poses are the workspace, enlarged by a factor of 1.5 about its centre."""
    n = robot.coordinates
    low, high = robot.pose_bounds
    centre, reach = (low + high) / 2, 0.75 * (high - low)
    pose = (tuple(centre - reach), tuple(centre + reach))
    angles = np.arange(n) >= 3
    units = ("m", "m/s", "m/s²") if robot.planar else ("m, rad", "m/s, rad/s", "m/s², rad/s²")
    symmetric = {
        order: (tuple(-np.where(angles, angle, length)), tuple(np.where(angles, angle, length)))
        for order, length, angle in ((0, 2.0, 4.0), (1, 20.0, 100.0), (2, 1e3, 1e4), (3, 1e5, 1e6), (4, 1e7, 1e8))
    }
    motor = ((-1e3,) * robot.cables, (1e3,) * robot.cables)
    third, fourth = (units[2].replace("²", power) for power in "³⁴")
    spring = "motor angle β′; β′ minus the pulley angle β is the spring deflection"
    motors = [("motor_angle", motor, "rad", spring), ("motor_speed", motor, "rad/s", "motor speed β̇′")]
    higher = [
        ("reference_jerk", symmetric[3], third, "third derivative of X_d"),
        ("reference_snap", symmetric[4], fourth, "fourth derivative of X_d"),
    ]
    rows = [
        ("pose", pose, units[0], "measured pose X, exact without sensor noise"),
        ("velocity", symmetric[1], units[1], "measured velocity Ẋ, exact without sensor noise"),
        *(motors if robot.flexible else []),
        ("time_to_go", ((0.0,), (1e3,)), "s", "time until the reference motion ends; 0 afterwards"),
        ("reference_pose", pose, units[0], "reference pose X_d at the present control instant"),
        ("reference_velocity", symmetric[1], units[1], "first derivative of X_d"),
        ("reference_acceleration", symmetric[2], units[2], "second derivative of X_d"),
        *(higher if robot.flexible else []),
        *((preview_name(ahead), symmetric[0], units[0], f"X_d in {ahead:g} s minus X_d now") for ahead in PREVIEWS),
        ("model_payload", ((0.0,), (1e3,)), "kg", "payload of the controller's model; 0 if the payload is unknown"),
        ("payload_known", ((0.0,), (1.0,)), "–", "1 if the payload is known, else 0"),
    ]
    blocks, start = [], 0
    for name, bounds, unit, meaning in rows:
        low, high = (tuple(map(float, bound)) for bound in bounds)
        blocks.append(Block(name=name, start=start, size=len(low), low=low, high=high, unit=unit, meaning=meaning))
        start += len(low)
    return ObservationLayout(blocks=tuple(blocks))


def observed_reference(trajectory: Trajectory, times: Array, *, to_snap: bool) -> dict[str, Array]:
    """Blocks of the observation that describe the reference, by name and in order, each (K, size).

    Args:
        trajectory: the reference motion.
        times: times since the start of the episode [s], (K,).
        to_snap: whether to include jerk and snap, which observations of flexible robots have.
    """
    now = trajectory(times)
    derivatives = {"pose": now.position, "velocity": now.velocity, "acceleration": now.acceleration}
    if to_snap:
        derivatives |= {"jerk": now.jerk, "snap": now.snap}
    return {
        "time_to_go": np.maximum(trajectory.duration - times, 0.0)[:, None],
        **{f"reference_{name}": values for name, values in derivatives.items()},
        **{preview_name(ahead): trajectory(times + ahead).position - now.position for ahead in PREVIEWS},
    }
