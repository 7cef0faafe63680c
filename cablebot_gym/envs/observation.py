"""Layout of the flat observation: names, slices, units, bounds and scales of its blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from cablebot_gym.envs.limits import SLACK_TIME
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import POSE, Measurement, find_measurement
from cablebot_gym.motions import Trajectory
from cablebot_gym.robots import GRAVITY, Robot, find_robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.results import Printed

PREVIEWS = (0.02, 0.05, 0.1, 0.2)
"""Preview times: how far ahead the observation shows the reference [s]."""

LAST_ACTIONS = 3
"""Number of past actions in the observation. An action that arrives up to so many periods late is
still in it."""

Blocks = dict[str, Array]
"""Blocks of an observation by name, each (..., size)."""


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
    """Name of the block that the normalised observation subtracts, of the same size; empty for
    ``centre``."""

    @property
    def slice(self) -> slice:
        """Slice of the block in the observation."""
        return slice(self.start, self.start + self.size)


@dataclass(frozen=True, kw_only=True, repr=False)
class ObservationLayout(Printed):
    """Named blocks of the observation of one robot. Methods accept one observation (size,) or a
    batch (N, size)."""

    robot_name: str
    """Name of the robot in error messages."""
    blocks: tuple[Block, ...]
    """Blocks in the order of the observation."""

    @property
    def size(self) -> int:
        """Number of components."""
        return self.blocks[-1].start + self.blocks[-1].size

    def __str__(self) -> str:
        names = ", ".join(self.slices())
        return f"observation of robot {self.robot_name!r}, {self.size} components: {names}"

    def slices(self) -> dict[str, slice]:
        """Slice of each block by name."""
        return {block.name: block.slice for block in self.blocks}

    def split(self, observation: ArrayLike) -> Blocks:
        """The blocks by name, each (..., size of the block); views if the observation is an array
        of floats.

        Raises:
            ValueError: if the observation is not that of this robot.
        """
        array = self._checked(observation)
        return {block.name: array[..., block.slice] for block in self.blocks}

    def normalise(self, observation: ArrayLike) -> Array:
        """The observation in units of order one, as the environments return it with
        ``normalised_observation``.

        Each component is (value − centre)/scale of its block. The pose and the velocity become
        tracking errors.

        Raises:
            ValueError: if the observation is not that of this robot.
        """
        array = self._checked(observation)
        normalised = np.array(array)
        for block, reference in self._relative:
            normalised[..., block] -= array[..., reference]
        return (normalised - self.centre) * self.per_scale

    @cached_property
    def centre(self) -> Array:
        """Centres of the normalised observation, (size,); 0 for blocks that are relative to another
        block."""
        centres: list[float] = []
        for block in self.blocks:
            centres += block.centre
        centre = np.array(centres)
        for relative, _ in self._relative:
            centre[relative] = 0.0
        return _constant(centre)

    @cached_property
    def per_scale(self) -> Array:
        """Reciprocal scales of the normalised observation, (size,)."""
        return _constant(1 / np.concatenate([block.scale for block in self.blocks]))

    @cached_property
    def _relative(self) -> list[tuple[slice, slice]]:
        """Blocks that the normalised observation gives relative to another block, and that
        block."""
        slices = self.slices()
        return [
            (block.slice, slices[block.relative_to]) for block in self.blocks if block.relative_to
        ]

    def _checked(self, observation: ArrayLike) -> Array:
        array = np.asarray(observation, float)
        if array.shape[-1:] != (self.size,):
            raise ValueError(
                f"the observation of robot {self.robot_name!r} has {self.size} components, not shape {array.shape}: "
                "use the layout, or the policy, of the environment's robot and measurement"
            )
        return array

    def space(self, *, normalised: bool = False, dtype: str = "float64") -> Box:
        """The bounded observation space. Components saturate at the bounds; useful motions do not
        reach them.

        Args:
            normalised: whether the space is that of the normalised observation.
            dtype: number type of the space, ``float64`` or ``float32``.
        """
        low = np.concatenate([block.low for block in self.blocks])
        high = np.concatenate([block.high for block in self.blocks])
        if normalised:
            # A reference is never relative itself: its bounds have not changed.
            for block, reference in self._relative:
                low[block] -= high[reference]
                high[block] -= low[reference]
            low = (low - self.centre) * self.per_scale
            high = (high - self.centre) * self.per_scale
        number = np.dtype(dtype).type
        return Box(low.astype(number), high.astype(number), dtype=number)

    def table(self) -> str:
        """Markdown table of the blocks."""
        lines = [
            "| components | name | unit | low | high | scale | meaning |",
            "|---|---|---|---|---|---|---|",
        ]
        for block in self.blocks:
            components = str(block.start)
            if block.size > 1:
                components += f"–{block.start + block.size - 1}"
            numbers = []
            for values in (block.low, block.high, block.scale):
                distinct = dict.fromkeys(f"{value:.3g}" for value in values)
                numbers.append(", ".join(distinct))
            row = (components, f"`{block.name}`", block.unit, *numbers, block.meaning)
            lines.append(f"| {' | '.join(row)} |")
        return "\n".join(lines)


def _constant(values: Array) -> Array:
    """A read-only array: layouts are shared."""
    return np.frombuffer(values.tobytes())


def preview_name(ahead: float) -> str:
    """Name of the block that previews the reference ``ahead`` seconds ahead."""
    return f"preview_{round(ahead * 1e3)}ms"


def observation_layout(
    robot: Robot | str, measurement: Measurement | str = POSE
) -> ObservationLayout:
    """Layout for a robot, as for :func:`~cablebot_gym.robots.names.find_robot`, and a measurement,
    whose blocks come first.

    The bounds of poses are the workspace, enlarged by a factor of 1.5 about its centre. That of the
    payload is 1000 kg, or the mass whose weight is the pull of all motors together at stall, if
    that is more. The scales follow from the robot alone. Its length L is half of the largest width
    of the workspace, its angle half of the largest range of an angle, its speed v = r ω_n that of a
    cable at a motor's free speed, and its time L/v.

    * poses: L and the angle from the centre of the workspace; their k-th derivatives: divided by
      the k-th power of L/v;
    * previews: the scale of the velocity times the preview time, at most that of the pose;
    * errors of pose and velocity: the default error bounds, and these over L/v;
    * motor angles L/r and motor speeds ω_n; tensions τ_s/r;
    * orientation, angular rate and specific force: the angle, its derivative, and the gravitational
      acceleration;
    * payload: the mass that the stall torque of a motor accelerates at v²/L by its cable;
    * time to go: 1 s; slack time: the 0.1 s after which a slack cable terminates the episode;
      actions: 1.
    """
    robot = find_robot(robot)
    return _layout(robot, find_measurement(measurement, robot))


@lru_cache(maxsize=64)
def _layout(robot: Robot, measurement: Measurement) -> ObservationLayout:
    sizes = _sizes(robot)
    readings = _readings(robot, sizes)
    blocks = [readings[name] for name in measurement.sizes(robot)]
    blocks += _reference_blocks(robot, sizes)
    blocks += _controller_blocks(robot, sizes)
    start = 0
    for index, block in enumerate(blocks):
        blocks[index] = replace(block, start=start)
        start += block.size
    return ObservationLayout(robot_name=robot.name, blocks=tuple(blocks))


@dataclass(frozen=True, kw_only=True)
class _Sizes:
    """Sizes of a robot's motion, from which the bounds and scales of its blocks follow."""

    is_angle: Array
    """Whether a coordinate is an angle, (n,)."""
    units: tuple[str, ...]
    """Units of the pose and of its first four derivatives."""
    centre: Array
    """Centre of the workspace, (n,)."""
    bounds: tuple[tuple[Array, Array], ...]
    """Bounds of the pose and of its first four derivatives, each (n,)."""
    scales: tuple[Array, ...]
    """Scales of the pose and of its first four derivatives, each (n,)."""
    time: float
    """Time L/v [s]."""
    radius: float
    """Mean radius of the pulleys [m]."""
    free_speed: float
    """Mean free speed of the motors [rad/s]."""
    pull: float
    """Cable tension of a stalled motor [N]."""


_DERIVATIVE_BOUNDS = ((20.0, 100.0), (1e3, 1e4), (1e5, 1e6), (1e7, 1e8))
"""Bounds of the first four derivatives: of positions in m and of angles in rad, per power of a
second."""


def _sizes(robot: Robot) -> _Sizes:
    low, high = robot.pose_bounds
    centre = (low + high) / 2
    half = (high - low) / 2
    is_angle = np.arange(robot.coordinates) >= robot.dimensions
    reach = 0.75 * (high - low)
    bounds = [(centre - reach, centre + reach)]
    for position, angle in _DERIVATIVE_BOUNDS:
        bound = np.where(is_angle, angle, position)
        bounds.append((-bound, bound))

    radius = float(np.mean(robot.pulley_radius))
    free_speed = float(np.mean(robot.per_motor(robot.motors.free_speed)))
    length = np.where(is_angle, np.max(half[is_angle], initial=0.0), np.max(half[~is_angle]))
    time = length[0] / (radius * free_speed)
    units = ["m", "m/s", "m/s²", "m/s³", "m/s⁴"]
    if not robot.point_mass:
        units = [f"{unit}, {unit.replace('m', 'rad')}" for unit in units]
    return _Sizes(
        is_angle=is_angle,
        units=tuple(units),
        centre=centre,
        bounds=tuple(bounds),
        scales=tuple(length / time**order for order in range(5)),
        time=time,
        radius=radius,
        free_speed=free_speed,
        pull=float(np.mean(robot.stall_torque)) / radius,
    )


def _readings(robot: Robot, sizes: _Sizes) -> dict[str, Block]:
    """Blocks of all sensors by name; a measurement has some of them."""
    n = robot.coordinates
    m = robot.cables
    axes = robot.dimensions
    bounds = sizes.bounds
    units = sizes.units
    error = np.where(sizes.is_angle, ErrorBounds().rotation, ErrorBounds().position)
    motor = (-1e3, 1e3)
    motor_angle = "motor angle β"
    motor_speed = "motor speed β̇"
    if robot.flexible:
        motor_angle = "motor angle β′; β′ minus the pulley angle β is the spring deflection"
        motor_speed = "motor speed β̇′"
    angle = rate = 1.0  # without angles there is no IMU
    if sizes.is_angle.any():
        angle, rate = (float(scale[-1]) for scale in sizes.scales[:2])
    pose = "measured pose X, exact without sensor noise"
    velocity = "measured velocity Ẋ, exact without sensor noise"
    tensions = "tensions at the load cells at the start of the last action period"
    angular_rate = "angular rate of the platform in its own frame"
    force = "mean acceleration minus gravity over the last action period, same frame"
    blocks = (
        _block("pose", n, bounds[0], error, units[0], pose, relative_to="reference_pose"),
        _block(
            "velocity",
            n,
            bounds[1],
            error / sizes.time,
            units[1],
            velocity,
            relative_to="reference_velocity",
        ),
        _block("motor_angle", m, motor, sizes.scales[0][0] / sizes.radius, "rad", motor_angle),
        _block("motor_speed", m, motor, sizes.free_speed, "rad/s", motor_speed),
        _block("tensions", m, (-1e6, 1e6), sizes.pull, "N", tensions),
        _block(
            "orientation",
            n - axes,
            (-10.0, 10.0),
            angle,
            "rad",
            "roll ψ, pitch θ and yaw φ of the IMU",
        ),
        _block("angular_rate", n - axes, (-100.0, 100.0), rate, "rad/s", angular_rate),
        _block("specific_force", axes, (-1e3, 1e3), GRAVITY, "m/s²", force),
    )
    return {block.name: block for block in blocks}


_REFERENCES = (
    ("reference_pose", "reference pose X_d at the present control instant"),
    ("reference_velocity", "first derivative of X_d"),
    ("reference_acceleration", "second derivative of X_d"),
    ("reference_jerk", "third derivative of X_d"),
    ("reference_snap", "fourth derivative of X_d"),
)
"""Names and meanings of the reference and its derivatives."""


def _references(*, to_snap: bool) -> tuple[tuple[str, str], ...]:
    """The references that an observation has: all of robots with springs, three of others."""
    if to_snap:
        return _REFERENCES
    return _REFERENCES[:3]


def _reference_blocks(robot: Robot, sizes: _Sizes) -> list[Block]:
    """Blocks that :func:`observed_reference` fills, in the same order."""
    n = robot.coordinates
    blocks = [
        _block(
            "time_to_go",
            1,
            (0.0, 1e3),
            1.0,
            "s",
            "time until the reference motion ends; 0 afterwards",
        )
    ]
    for order, (name, meaning) in enumerate(_references(to_snap=robot.flexible)):
        centre = sizes.centre if order == 0 else 0.0
        bounds = sizes.bounds[order]
        scale = sizes.scales[order]
        unit = sizes.units[order]
        blocks.append(_block(name, n, bounds, scale, unit, meaning, centre=centre))
    ahead_bound = np.where(sizes.is_angle, 4.0, 2.0)
    for ahead in PREVIEWS:
        scale = np.minimum(sizes.scales[1] * ahead, sizes.scales[0])
        meaning = f"X_d in {ahead:g} s minus X_d now"
        blocks.append(
            _block(
                preview_name(ahead), n, (-ahead_bound, ahead_bound), scale, sizes.units[0], meaning
            )
        )
    return blocks


def _controller_blocks(robot: Robot, sizes: _Sizes) -> list[Block]:
    """Blocks of the payload, the last actions and the slack cables."""
    m = robot.cables
    heaviest = max(1e3, m * sizes.pull / GRAVITY)
    payload = sizes.pull / sizes.scales[2][0]
    model = "payload of the controller's model; 0 if the payload is unknown"
    sent = f"the last {LAST_ACTIONS} actions, latest first, clipped to ±1; 0 before the first"
    slack = "time for which some cable has been slack without a pause"
    return [
        _block("model_payload", 1, (0.0, heaviest), payload, "kg", model),
        _block("payload_known", 1, (0.0, 1.0), 1.0, "–", "1 if the payload is known, else 0"),
        _block("last_actions", LAST_ACTIONS * m, (-1.0, 1.0), 1.0, "–", sent),
        _block("slack_time", 1, (0.0, 1e3), SLACK_TIME, "s", slack),
    ]


def _block(
    name: str,
    size: int,
    bounds: tuple[ArrayLike, ArrayLike],
    scale: ArrayLike,
    unit: str,
    meaning: str,
    *,
    centre: ArrayLike = 0.0,
    relative_to: str = "",
) -> Block:
    """A block that has no place yet. A single bound, scale or centre is that of each component."""

    def components(value: ArrayLike) -> tuple[float, ...]:
        return tuple(np.broadcast_to(np.asarray(value, float), (size,)).tolist())

    low, high = bounds
    return Block(
        name=name,
        start=0,
        size=size,
        low=components(low),
        high=components(high),
        unit=unit,
        meaning=meaning,
        scale=components(scale),
        centre=components(centre),
        relative_to=relative_to,
    )


def observed_reference(trajectory: Trajectory, times: Array, *, to_snap: bool) -> dict[str, Array]:
    """Blocks of the observation that describe the reference, by name and in order, each (K, size).

    Args:
        trajectory: the reference motion.
        times: times since the start of the episode [s], (K,).
        to_snap: whether to include jerk and snap, which observations of flexible robots have.
    """
    now = trajectory(times)
    values = (now.position, now.velocity, now.acceleration, now.jerk, now.snap)
    blocks = {"time_to_go": np.maximum(trajectory.duration - times, 0.0)[:, None]}
    for (name, _), value in zip(_references(to_snap=to_snap), values, strict=False):
        blocks[name] = value
    for ahead in PREVIEWS:
        blocks[preview_name(ahead)] = trajectory(times + ahead).position - now.position
    return blocks
