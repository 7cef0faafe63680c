"""Layout of the flat observation: names, slices, units, bounds and scales of its blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import POSE, Measurement
from cablebot_gym.robots import GRAVITY, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Trajectory

PREVIEWS = (0.02, 0.05, 0.1, 0.2)
"""Preview times: how far ahead the observation shows the reference [s]."""

LAST_ACTIONS = 3
"""Number of past actions in the observation. An action that arrives up to so many periods late is still in it."""

SLACK_SCALE = 0.1
"""Scale of the block ``slack_time``: the default time after which a slack cable terminates the episode [s]."""


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
    scale: tuple[float, ...]
    """Unit of the normalised observation, (size,)."""
    centre: tuple[float, ...]
    """Value at which the normalised observation is zero, (size,); not used with ``relative_to``."""
    relative_to: str = ""
    """Name of the block that the normalised observation subtracts, of the same size; empty for ``centre``."""

    @property
    def slice(self) -> slice:
        """Slice of the block in the observation."""
        return slice(self.start, self.start + self.size)


@dataclass(frozen=True, kw_only=True)
class ObservationLayout:
    """Named blocks of the observation of one robot. Methods accept one observation (size,) or a batch (N, size)."""

    robot_name: str
    """Name of the robot in error messages."""
    blocks: tuple[Block, ...]
    """Blocks in the order of the observation."""

    @property
    def size(self) -> int:
        """Number of components."""
        return self.blocks[-1].start + self.blocks[-1].size

    def slices(self) -> dict[str, slice]:
        """Slice of each block by name."""
        return {block.name: block.slice for block in self.blocks}

    def split(self, observation: ArrayLike) -> dict[str, Array]:
        """The blocks by name, each (..., size of the block); views if the observation is an array of floats.

        Raises:
            ValueError: if the observation is not that of this robot.
        """
        array = self._checked(observation)
        return {block.name: array[..., block.slice] for block in self.blocks}

    def normalise(self, observation: ArrayLike) -> Array:
        """The observation in units of order one, as the environments return it with ``normalised_observation``.

        Each component is (value − centre)/scale of its block. The pose and the velocity become tracking errors.

        Raises:
            ValueError: if the observation is not that of this robot.
        """
        array = self._checked(observation)
        normalised = np.array(array)
        for own, reference in self._relative:
            normalised[..., own] -= array[..., reference]
        return (normalised - self.centre) * self.per_scale

    @cached_property
    def centre(self) -> Array:
        """Centres of the normalised observation, (size,); 0 for blocks that are relative to another block."""
        return _constant(np.concatenate([np.zeros(b.size) if b.relative_to else b.centre for b in self.blocks]))

    @cached_property
    def per_scale(self) -> Array:
        """Reciprocal scales of the normalised observation, (size,)."""
        return _constant(1 / np.concatenate([block.scale for block in self.blocks]))

    @cached_property
    def _relative(self) -> list[tuple[slice, slice]]:
        """Blocks that the normalised observation gives relative to another block, and that block."""
        slices = self.slices()
        return [(block.slice, slices[block.relative_to]) for block in self.blocks if block.relative_to]

    def _checked(self, observation: ArrayLike) -> Array:
        array = np.asarray(observation, float)
        if array.shape[-1:] != (self.size,):
            raise ValueError(
                f"the observation of robot {self.robot_name!r} has {self.size} components, not shape {array.shape}: "
                "use the layout, or the policy, of the environment's robot and measurement"
            )
        return array

    def space(self, *, normalised: bool = False, dtype: str = "float64") -> Box:
        """The bounded observation space. Components saturate at the bounds; useful motions do not reach them.

        Args:
            normalised: whether the space is that of the normalised observation.
            dtype: number type of the space, ``float64`` or ``float32``.
        """
        low = np.concatenate([block.low for block in self.blocks])
        high = np.concatenate([block.high for block in self.blocks])
        if normalised:
            raw = low.copy(), high.copy()
            for own, reference in self._relative:
                low[own] -= raw[1][reference]
                high[own] -= raw[0][reference]
            low, high = ((bound - self.centre) * self.per_scale for bound in (low, high))
        number = np.dtype(dtype).type
        return Box(low.astype(number), high.astype(number), dtype=number)

    def table(self) -> str:
        """Markdown table of the blocks."""
        lines = ["| components | name | unit | low | high | scale | meaning |", "|---|---|---|---|---|---|---|"]
        for block in self.blocks:
            components = str(block.start) if block.size == 1 else f"{block.start}–{block.start + block.size - 1}"
            low, high, scale = (
                ", ".join(dict.fromkeys(f"{value:.3g}" for value in values))
                for values in (block.low, block.high, block.scale)
            )
            row = (components, f"`{block.name}`", block.unit, low, high, scale, block.meaning)
            lines.append(f"| {' | '.join(row)} |")
        return "\n".join(lines)


def _constant(values: Array) -> Array:
    """A read-only array: layouts are shared."""
    return np.frombuffer(values.tobytes())


def preview_name(ahead: float) -> str:
    """Name of the block that previews the reference ``ahead`` seconds ahead."""
    return f"preview_{round(ahead * 1e3)}ms"


@lru_cache(maxsize=64)
def observation_layout(robot: Robot, measurement: Measurement = POSE) -> ObservationLayout:
    """Layout for a robot and a measurement, whose blocks come first.

    The bounds of poses are the workspace, enlarged by a factor of 1.5 about its centre. That of the payload is 1000 kg,
    or the mass whose weight is the pull of all motors together at stall, if that is more. The scales follow from the
    robot alone. Its length L is half of the largest width of the workspace, its angle half of the largest range of an
    angle, its speed v = r ω_n that of a cable at a motor's free speed, and its time L/v.

    * poses: L and the angle from the centre of the workspace; their k-th derivatives: divided by the k-th power of L/v;
    * previews: the scale of the velocity times the preview time, at most that of the pose;
    * errors of pose and velocity: the default error bounds, and these over L/v;
    * motor angles L/r and motor speeds ω_n; tensions τ_s/r;
    * orientation, angular rate and specific force: the angle, its derivative, and the gravitational acceleration;
    * payload: the mass that the stall torque of a motor accelerates at v²/L by its cable;
    * time to go: 1 s; slack time: :data:`SLACK_SCALE`; actions: 1.
    """
    n, m = robot.coordinates, robot.cables
    low, high = robot.pose_bounds
    centre, reach = (low + high) / 2, 0.75 * (high - low)
    bounds: dict[int, tuple[Array, Array]] = {0: (centre - reach, centre + reach)}
    angles = np.arange(n) >= robot.dimensions
    for order, length, angle in ((1, 20.0, 100.0), (2, 1e3, 1e4), (3, 1e5, 1e6), (4, 1e7, 1e8)):
        bounds[order] = -np.where(angles, angle, length), np.where(angles, angle, length)
    ahead_bounds = -np.where(angles, 4.0, 2.0), np.where(angles, 4.0, 2.0)
    units = ("m", "m/s", "m/s²") if robot.point_mass else ("m, rad", "m/s, rad/s", "m/s², rad/s²")
    third, fourth = (units[2].replace("²", power) for power in "³⁴")

    half, radius = (high - low) / 2, float(np.mean(robot.pulley_radius))
    length = np.where(angles, np.max(half[angles], initial=0.0), np.max(half[~angles]))
    free_speed = float(np.mean(robot.per_motor(robot.motors.free_speed)))
    time = length[0] / (radius * free_speed)
    scales = {order: length / time**order for order in range(5)}
    error = np.where(angles, ErrorBounds().rotation, ErrorBounds().position)
    pull = float(np.mean(robot.stall_torque)) / radius
    payload = pull / scales[2][0]

    motor, last = (-1e3, 1e3), "over the last action period"
    spring = "motor angle β′; β′ minus the pulley angle β is the spring deflection"
    angle, rate = (float(np.max(scales[order], initial=0.0, where=angles)) or 1.0 for order in (0, 1))
    readings: dict[str, tuple[Any, ArrayLike, str, str]] = {
        "pose": (bounds[0], error, units[0], "measured pose X, exact without sensor noise"),
        "velocity": (bounds[1], error / time, units[1], "measured velocity Ẋ, exact without sensor noise"),
        "motor_angle": (motor, length[0] / radius, "rad", spring if robot.flexible else "motor angle β"),
        "motor_speed": (motor, free_speed, "rad/s", "motor speed β̇′" if robot.flexible else "motor speed β̇"),
        "tensions": (
            (-1e6, 1e6),
            pull,
            "N",
            f"tensions at the load cells at the start of {last.removeprefix('over ')}",
        ),
        "orientation": ((-10.0, 10.0), angle, "rad", "roll ψ, pitch θ and yaw φ of the IMU"),
        "angular_rate": ((-100.0, 100.0), rate, "rad/s", "angular rate of the platform in its own frame"),
        "specific_force": (
            (-1e3, 1e3),
            GRAVITY,
            "m/s²",
            f"mean acceleration minus gravity {last}, same frame",
        ),
    }
    higher: list[_Row] = [
        ("reference_jerk", bounds[3], scales[3], n, third, "third derivative of X_d"),
        ("reference_snap", bounds[4], scales[4], n, fourth, "fourth derivative of X_d"),
    ]
    previews: list[_Row] = [
        (preview_name(ahead), ahead_bounds, np.minimum(scales[1] * ahead, scales[0]), n, units[0], meaning)
        for ahead, meaning in ((ahead, f"X_d in {ahead:g} s minus X_d now") for ahead in PREVIEWS)
    ]
    sent = f"the last {LAST_ACTIONS} actions, latest first, clipped to ±1; 0 before the first"
    model = "payload of the controller's model; 0 if the payload is unknown"
    rows: list[_Row] = [
        *((name, *readings[name][:2], size, *readings[name][2:]) for name, size in measurement.sizes(robot).items()),
        ("time_to_go", (0.0, 1e3), 1.0, 1, "s", "time until the reference motion ends; 0 afterwards"),
        ("reference_pose", bounds[0], scales[0], n, units[0], "reference pose X_d at the present control instant"),
        ("reference_velocity", bounds[1], scales[1], n, units[1], "first derivative of X_d"),
        ("reference_acceleration", bounds[2], scales[2], n, units[2], "second derivative of X_d"),
        *(higher if robot.flexible else []),
        *previews,
        ("model_payload", (0.0, max(1e3, m * pull / GRAVITY)), payload, 1, "kg", model),
        ("payload_known", (0.0, 1.0), 1.0, 1, "–", "1 if the payload is known, else 0"),
        ("last_actions", (-1.0, 1.0), 1.0, LAST_ACTIONS * m, "–", sent),
        ("slack_time", (0.0, 1e3), SLACK_SCALE, 1, "s", "time for which some cable has been slack without a pause"),
    ]
    blocks, start = [], 0
    for name, (lowest, highest), scale, size, unit, meaning in rows:
        block = Block(
            name=name,
            start=start,
            size=size,
            low=_filled(lowest, size),
            high=_filled(highest, size),
            unit=unit,
            meaning=meaning,
            scale=_filled(scale, size),
            centre=_filled(centre if name == "reference_pose" else 0.0, size),
            relative_to=_RELATIVE.get(name, ""),
        )
        blocks.append(block)
        start += size
    return ObservationLayout(robot_name=robot.name, blocks=tuple(blocks))


_Row = tuple[str, tuple[ArrayLike, ArrayLike], ArrayLike, int, str, str]
"""Name, bounds, scale, size, unit and meaning of a block."""

_RELATIVE = {"pose": "reference_pose", "velocity": "reference_velocity"}


def _filled(value: ArrayLike, size: int) -> tuple[float, ...]:
    return tuple(np.broadcast_to(np.asarray(value, float), (size,)).tolist())


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
