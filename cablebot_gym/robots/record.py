"""The record of a robot: its fields, what follows from them, and the checks that it passes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from cablebot_gym.kinematics import Array, cable_lengths, cable_vectors, structure_jacobian
from cablebot_gym.robots import checks
from cablebot_gym.robots.parts import (
    COORDINATE_NAMES,
    GRAVITY,
    KIND_TEXTS,
    Defaults,
    Kind,
    Motors,
    PerMotor,
    Plane,
    Transmission,
    as_tuples,
)
from cablebot_gym.utils.checks import choice, number, numbers, record


class HomePoseError(ValueError):
    """The cables cannot hold the home pose of a robot."""


def _per_motor(field: str, part: str = "transmission") -> cached_property[Array]:
    """Property of a :class:`Robot` with a value of its motors or its transmission, shape (m,)."""

    def values(robot: Robot) -> Array:
        value = getattr(getattr(robot, part), field)
        if value is None or (field == "motor_damping" and not robot.jointed):
            springs = "elastic cables" if field == "axial_stiffness" else "joint springs"
            raise ValueError(
                f"{robot.name} has a transmission without {field}; choose a robot with {springs}"
            )
        return robot.per_motor(value)

    return cached_property(values)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """One cable robot with m cables. The columns of ``base_anchors`` and the presence of
    ``platform_anchors`` determine its kind, and with it the number n of its coordinates:

    * 2 columns, no platform anchors: ``planar``, a point mass in a plane, n = 2.
    * 2 columns and platform anchors: ``planar-platform``, a platform that also turns in the plane,
      n = 3.
    * 3 columns, no platform anchors: ``point``, a suspended point mass, n = 3.
    * 3 columns and platform anchors: ``spatial``, a suspended platform, n = 6.

    Gravity acts on all of them except in a horizontal plane. With gravity m ≥ n cables can hold the
    platform, without it m > n. With gravity and m < n it hangs and swings, see :attr:`hanging`.

    Raises:
        ValueError: if a value is not physical, two cables coincide, or no positive tensions hold
            ``home_pose``.
    """

    name: str
    """Name shown in tables and error messages."""
    base_anchors: tuple[tuple[float, ...], ...]
    """Base anchors A_i in the base frame [m], shape (m, 2) or (m, 3); z points down."""
    mass: float
    """Platform mass without payload [kg]; > 0."""
    motors: Motors
    """Torque-speed lines of the motors."""
    transmission: Transmission
    """Transmission from motors to cables."""
    home_pose: tuple[float, ...]
    """Home pose X₀ [m, rad], shape (n,), at which all pulley angles β are zero."""
    platform_anchors: tuple[tuple[float, ...], ...] = ()
    """Platform anchors b_i in the platform frame [m], shape (m, 2) or (m, 3); empty for a point
    mass."""
    inertia: tuple[Any, ...] = ()
    """Inertia about the centre of mass along the platform axes [kg·m²]: in space the moments (I_xx,
    I_yy, I_zz) or the tensor with three rows, in a plane (I_zz,); empty for a point mass. Entries
    off the diagonal are I_xy = −∫xy dm: products of inertia change their sign."""
    center_of_mass: tuple[float, ...] = ()
    """Centre of mass in the platform frame [m], shape (2,) or (3,); empty for the origin, as for a
    point mass. The payload is there, too. The pose is that of the origin."""
    plane: Plane = "horizontal"
    """Plane in which a planar robot moves."""
    swivel_radius: PerMotor = 0.0
    """Radius ρ of the swivel pulleys of a robot in space [m], one value or one per cable; ≥ 0.

    Each cable runs along the swivel axis through its base anchor to the pulley, which turns about
    that axis towards the platform anchor. With 0 the cables end in points. A planar robot only
    accepts 0.
    """
    swivel_axes: tuple[tuple[float, ...], ...] = ()
    """Direction in which each cable runs along its swivel axis to the pulley, one (x, y, z) per
    cable; empty for vertical axes. The textbook knows all axes, the simulation vertical ones."""
    cable_density: PerMotor = 0.0
    """Mass of a cable per length [kg/m], one value or one per cable; ≥ 0. Only the check of the sag
    uses it."""
    gravity: float = GRAVITY
    """Gravitational acceleration along +z, or along +y in a vertical plane [m/s²]. A robot in a
    horizontal plane only accepts the default."""
    minimum_tension: float = 1.0
    """Tension T_min that the task criterion requires of every cable at every physics step [N]; ≥ 0.

    Below it, cables are not straight as the model assumes. At 1 N, 0.6 m of a steel cable of 1 mm
    (0.04 N/m) sag by 2 mm and lengthen by about 0.01 mm; at 0.1 N they lengthen by more than 1 mm.
    """
    maximum_tension: float = math.inf
    """Tension that the task criterion allows in every cable at every physics step [N]; >
    ``minimum_tension``. Infinite by default: the torques alone limit the tensions.

    It is the strength of cables, fittings or frame with its safety factor, or a limit of the drives'
    software, where that is less than the tension of the stall torque.
    """
    workspace: tuple[tuple[float, float], ...] = ()
    """(low, high) of each coordinate [m, rad]. Empty: the bounding box of the base anchors, and
    angles within ± 1 rad. If the home pose is below all anchors, the box begins at the lowest one.
    It ends at z = 0, the floor, if the home pose is above it; otherwise its depth is its diagonal
    in plan, and at least twice that of the home pose."""
    defaults: Defaults = dataclasses.field(default=Defaults(), compare=False, repr=False)
    """Default motion, error bounds and payload range. Robots that differ only in these are
    equal."""
    sources: Mapping[str, str] = dataclasses.field(default_factory=dict, compare=False, repr=False)
    """Source of the values by name of the field, such as ``base_anchors`` or
    ``motors.stall_torque``. The source of an assumed value starts with ``assumed``."""
    ranges: Mapping[str, tuple[float, float]] = dataclasses.field(
        default_factory=dict, compare=False, repr=False
    )
    """(low, high) between which a value that is not known exactly is expected, by name of the
    field. The checks of a robot compute the payload over them, see
    :func:`~cablebot_gym.bounds.robot_check.payload_range`."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            object.__setattr__(self, field.name, as_tuples(value))  # a robot is hashable
        for name, kind in _RECORDS.items():
            object.__setattr__(self, name, record(name, kind, getattr(self, name)))
        _check_fields(self)
        _check_body(self)
        _check_home(self)

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: a copy makes its own read-only arrays, where NumPy would make copies
        that are writable."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @property
    def cables(self) -> int:
        """Number of cables m."""
        return len(self.base_anchors)

    @property
    def planar(self) -> bool:
        """Whether the robot moves in a plane."""
        return len(self.base_anchors[0]) == 2

    @property
    def point_mass(self) -> bool:
        """Whether the platform is a point mass, which does not turn."""
        return not self.platform_anchors

    @property
    def kind(self) -> Kind:
        """Kind of the platform."""
        return _KINDS[self.planar, self.point_mass]

    @property
    def dimensions(self) -> int:
        """Number d of coordinates of the position, the first of the pose: 2 or 3. The others are
        angles."""
        return len(self.base_anchors[0])

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose: 2, 3 or 6, by :attr:`kind`."""
        return len(COORDINATE_NAMES[self.kind])

    @property
    def weightless(self) -> bool:
        """Whether no gravity acts along the coordinates, as in a horizontal plane."""
        return (self.planar and self.plane == "horizontal") or self.gravity == 0

    @property
    def hanging(self) -> bool:
        """Whether the cables are fewer than the coordinates: the platform swings. The textbook
        knows such a robot, the simulation does not."""
        return self.cables < self.coordinates

    @cached_property
    def gravity_vector(self) -> Array:
        """Gravitational acceleration, shape (d,) [m/s²]."""
        vector = np.zeros(self.dimensions)
        if not self.weightless:
            vector[-1] = self.gravity
        return _frozen(vector)

    @cached_property
    def base(self) -> Array:
        """Base anchors as an array, shape (m, 2) or (m, 3)."""
        return _frozen(self.base_anchors)

    @cached_property
    def platform(self) -> Array:
        """Platform anchors as an array, shape (m, 2) or (m, 3); zeros for a point mass."""
        return _frozen(self.platform_anchors or np.zeros((self.cables, self.dimensions)))

    @cached_property
    def inertia_tensor(self) -> Array:
        """Inertia tensor about the centre of mass, shape (3, 3) [kg·m²]; I_zz alone in a plane, 0
        for a point mass."""
        inertia = np.asarray(self.inertia, float)
        if inertia.ndim == 1:
            inertia = np.diag(np.pad(inertia, (3 - inertia.size, 0)))
        return _frozen(inertia)

    @cached_property
    def moments(self) -> Array:
        """Moments of inertia, the diagonal of the tensor, shape (3,), or (1,) in a plane, or (0,)
        [kg·m²]."""
        return _frozen(np.diag(self.inertia_tensor)[3 - (self.coordinates - self.dimensions) :])

    @cached_property
    def mass_center(self) -> Array:
        """Centre of mass in the platform frame, shape (d,) [m]."""
        return _frozen(self.center_of_mass or np.zeros(self.dimensions))

    @cached_property
    def home(self) -> Array:
        """Home pose X₀ as an array, shape (n,)."""
        return _frozen(self.home_pose)

    @cached_property
    def pose_bounds(self) -> Array:
        """Workspace as an array of the lowest and the highest pose, shape (2, n)."""
        if self.workspace:
            return _frozen(np.transpose(self.workspace))
        low, high = self.base.min(axis=0), self.base.max(axis=0)
        # A suspended platform hangs below its anchors, which then bound its workspace from above.
        has_depth = not (self.planar and self.weightless)
        home = self.home_pose[self.dimensions - 1]
        if has_depth and home >= high[-1]:
            depth = float(np.linalg.norm((high - low)[:-1]))
            low[-1] = high[-1]
            high[-1] += max(depth, 2 * (home - high[-1]))
            if home < 0:  # the origin is on the floor
                high[-1] = 0.0
        angles = np.ones(self.coordinates - self.dimensions)
        return _frozen([np.concatenate([low, -angles]), np.concatenate([high, angles])])

    def per_motor(self, value: PerMotor) -> Array:
        """A value of the motors or the transmission as an array, shape (m,)."""
        return _frozen(np.broadcast_to(np.asarray(value, float), (self.cables,)))

    pulley_radius = _per_motor("pulley_radius")
    """Pulley radius r, shape (m,) [m]."""
    pulley_inertia = _per_motor("pulley_inertia")
    """Pulley inertia J, shape (m,) [kg·m²]."""
    damping = _per_motor("damping")
    """Pulley damping c, shape (m,) [N·m·s/rad]."""
    stiffness = _per_motor("stiffness")
    """Joint stiffness K of a flexible robot, shape (m,) [N·m/rad]."""
    motor_inertia = _per_motor("motor_inertia")
    """Motor inertia J′ of a flexible robot, shape (m,) [kg·m²]."""
    motor_damping = _per_motor("motor_damping")
    """Motor damping c′ of a flexible robot, shape (m,) [N·m·s/rad]."""
    coulomb_friction = _per_motor("coulomb_friction")
    """Coulomb friction τ_c, shape (m,) [N·m]."""
    load_friction = _per_motor("load_friction")
    """Friction per load μ, shape (m,)."""
    axial_stiffness = _per_motor("axial_stiffness")
    """Axial stiffness EA of elastic cables, shape (m,) [N]."""
    axial_damping = _per_motor("axial_damping")
    """Axial damping ηA of elastic cables, shape (m,) [N·s]."""
    extra_length = _per_motor("extra_length")
    """Length of the elastic cables between pulley and base anchor, shape (m,) [m]."""
    motor_lag = _per_motor("lag", "motors")
    """Time constants of the lag of the requested torque, shape (m,) [s]."""
    stall_torque = _per_motor("stall_torque", "motors")
    """Stall torque τ_s, shape (m,) [N·m]."""

    @cached_property
    def speed_slope(self) -> Array:
        """Slope τ_s/ω_n of the torque-speed line, k₂ of Eq. 37, shape (m,) [N·m·s/rad]."""
        return _frozen(self.stall_torque / self.per_motor(self.motors.free_speed))

    @cached_property
    def swivel(self) -> Array | None:
        """Swivel pulleys [m], see :func:`~cablebot_gym.kinematics.cable_lengths`: signed radii ± ρ
        of vertical axes, shape (m,), or vectors, shape (m, 3); None if all radii are zero.

        Along a vertical axis, a cable reaches a pulley that is above its platform anchor at the
        home pose from below, else from above.
        """
        if not np.any(self.swivel_radius):
            return None
        if self.swivel_axes:
            axes = np.asarray(self.swivel_axes)
            directions = axes / np.linalg.norm(axes, axis=1, keepdims=True)
            return _frozen(-self.per_motor(self.swivel_radius)[:, None] * directions)
        below = cable_vectors(self.base, self.platform, self.home)[:, 2] >= 0
        return _frozen(np.where(below, 1.0, -1.0) * self.swivel_radius)

    @property
    def jointed(self) -> bool:
        """Whether there are springs between motors and pulleys."""
        return self.transmission.stiffness is not None

    @property
    def elastic(self) -> bool:
        """Whether the cables stretch."""
        return self.transmission.axial_stiffness is not None

    @property
    def flexible(self) -> bool:
        """Whether the motors can turn while the platform rests: with joint springs or elastic
        cables."""
        return self.jointed or self.elastic

    @property
    def springs(self) -> str:
        """What is elastic, as text."""
        if self.jointed:
            return "joint springs"
        return "elastic cables" if self.elastic else "rigid"

    @property
    def joints(self) -> Literal["rigid", "flexible"]:
        """``rigid`` or ``flexible``; used as a key in tables of settings."""
        return "flexible" if self.flexible else "rigid"

    def replace(self, **changes: Any) -> Robot:
        """A copy with the fields in ``changes`` replaced. The copy is checked again."""
        return dataclasses.replace(self, **changes)

    def with_rigid_cables(self) -> Robot:
        """A copy whose cables do not stretch."""
        rigid = self.transmission.replace(axial_stiffness=None, axial_damping=0.0, extra_length=0.0)
        return self.replace(transmission=rigid)

    def to_dict(self) -> dict[str, Any]:
        """The robot as JSON-able data, which :meth:`from_dict` reads, without sources, ranges and
        unused options."""
        data = dataclasses.asdict(self)
        del data["sources"]
        del data["ranges"]
        _drop_unused(data, Robot, _OPTIONAL)
        _drop_unused(data["transmission"], Transmission, _OPTIONAL_OF_TRANSMISSION)
        if self.defaults == Defaults():
            del data["defaults"]
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Robot:
        """A robot from the data of :meth:`to_dict`. Lists may replace tuples.

        Raises:
            ValueError: if a key is unknown or missing, or the robot is not physical.
        """
        return record("robot", cls, data)


_OPTIONAL = (
    "center_of_mass",
    "plane",
    "swivel_radius",
    "swivel_axes",
    "cable_density",
    "maximum_tension",
)
_OPTIONAL_OF_TRANSMISSION = (
    "load_friction",
    "friction_speed",
    "axial_stiffness",
    "axial_damping",
    "extra_length",
)
"""Fields that :meth:`Robot.to_dict` leaves out where they have no effect."""


_RECORDS: dict[str, type] = {"motors": Motors, "transmission": Transmission, "defaults": Defaults}
"""Fields that may be given as a mapping."""

_KINDS: dict[tuple[bool, bool], Kind] = {
    (True, True): "planar",
    (True, False): "planar-platform",
    (False, True): "point",
    (False, False): "spatial",
}
"""Kinds by whether the robot moves in a plane and whether it is a point mass."""


def _drop_unused(data: dict[str, Any], record: type, names: tuple[str, ...]) -> None:
    """Removes fields with the default value of their record."""
    for name in names:
        if data[name] == getattr(record, name):
            del data[name]


def _frozen(values: Any) -> Array:
    """Read-only array in immutable memory, which no flag makes writable."""
    array = np.asarray(values, dtype=float)
    return np.frombuffer(array.tobytes()).reshape(array.shape)


def _check_fields(robot: Robot) -> None:
    """Checks the shape and the bounds of each field."""
    _check_shapes(robot)
    number("mass", robot.mass, above=0, unit="kg")
    number("gravity", robot.gravity, least=0, unit="m/s²")
    choice("plane", robot.plane, get_args(Plane))
    if not robot.planar and robot.plane != "horizontal":
        raise ValueError("plane is for planar robots, with base_anchors (x, y): remove it")
    if robot.planar and robot.plane == "horizontal" and robot.gravity != GRAVITY:
        raise ValueError(
            'gravity does not act in a horizontal plane: remove it, or set plane = "vertical"'
        )
    number("minimum_tension", robot.minimum_tension, least=0, unit="N")
    if robot.maximum_tension != math.inf:
        number("maximum_tension", robot.maximum_tension)
        if robot.maximum_tension <= robot.minimum_tension:
            raise ValueError(
                f"maximum_tension of {robot.maximum_tension:g} N must exceed minimum_tension, "
                f"{robot.minimum_tension:g} N; remove it if only the motors limit the tensions"
            )
    _check_cable_values(robot)
    if not isinstance(robot.sources, Mapping):
        raise ValueError(
            f"sources must be a table of texts by the name of the field, not {robot.sources!r}"
        )
    # the fields that have one number, or one per motor, by name as in ``ranges``
    values = {
        name: getattr(robot, name)
        for name in ("mass", "gravity", "minimum_tension", "maximum_tension")
    }
    for part in (robot.motors, robot.transmission):
        prefix = type(part).__name__.lower()
        values |= {f"{prefix}.{field}": value for field, value in vars(part).items()}
    checks.check_ranges(robot.ranges, values)
    if robot.weightless and robot.cables <= robot.coordinates:
        raise ValueError(
            f"base_anchors: {KIND_TEXTS[robot.kind]} without gravity needs at least {robot.coordinates + 1} cables, "
            f"not {robot.cables}: add cables"
        )


def _check_shapes(robot: Robot) -> None:
    """Checks anchors, inertia, poses and centre of mass."""

    def check(name: str, *shapes: tuple[int, ...], form: str, above: float = -math.inf) -> None:
        numbers(name, getattr(robot, name), shapes=shapes, form=form, above=above)

    m = len(robot.base_anchors) if isinstance(robot.base_anchors, tuple) else 0
    check("base_anchors", (m, 2), (m, 3), form="one (x, y) or one (x, y, z) per cable")
    d, n = robot.dimensions, robot.coordinates
    axes = "(x, y)" if robot.planar else "(x, y, z)"
    form = f"one {axes} per cable, or empty for a point mass"
    check("platform_anchors", (0,), (m, d), form=form)
    if robot.point_mass:
        check("inertia", (0,), form="empty for a point mass")
    elif robot.planar:
        check("inertia", (1,), form="(I_zz,)", above=0)
    else:
        check("inertia", (3,), (3, 3), form="(I_xx, I_yy, I_zz), or three rows of the tensor")
    check("home_pose", (n,), form=f"{n} coordinates")
    check("swivel_axes", (0,), (m, 3), form="one (x, y, z) per cable, or empty for vertical axes")
    if robot.swivel_axes and not np.linalg.norm(robot.swivel_axes, axis=1).all():
        raise ValueError("swivel_axes: a direction must not be (0, 0, 0)")
    check("workspace", (0,), (n, 2), form=f"{n} pairs (low, high), or empty")
    if robot.point_mass:
        check("center_of_mass", (0,), form="empty for a point mass")
    else:
        check("center_of_mass", (0,), (d,), form=f"{axes}, or empty")


def _check_cable_values(robot: Robot) -> None:
    """Checks the values with one number per cable or motor."""
    shapes = [(), (robot.cables,)]
    for name in ("swivel_radius", "cable_density"):
        form = "one number or one per cable"
        numbers(name, getattr(robot, name), shapes=shapes, form=form, least=0)
    if robot.planar and np.any(robot.swivel_radius):
        raise ValueError(
            "swivel_radius is for robots in space: remove it, and use the point where the cable leaves"
        )
    for data in (robot.motors, robot.transmission):
        for field in dataclasses.fields(data):
            if np.shape(getattr(data, field.name)) not in shapes:
                raise ValueError(
                    f"{field.name} must be one number or one for each of the {robot.cables} motors"
                )


def _check_body(robot: Robot) -> None:
    """Checks that a body and cables of this size and form exist."""
    checks.check_widths(robot.base, robot.pulley_radius, robot.swivel_radius)
    if not robot.point_mass:
        reach = float(np.max(np.linalg.norm(robot.platform - robot.mass_center, axis=1)))
        moment = float(np.linalg.eigvalsh(robot.inertia_tensor).max())
        checks.check_reach(reach, math.sqrt(max(moment, 0.0) / robot.mass))
    if robot.kind == "spatial":
        checks.check_inertia(robot.inertia, robot.inertia_tensor)
    heights = cable_vectors(robot.base, robot.platform, robot.home)[:, -1]
    if not robot.weightless and heights.max() < 0:
        raise HomePoseError(
            f"all base anchors are below the platform at home_pose; {vertical_remedy(robot)}"
        )
    low, high = robot.pose_bounds
    if np.any(low >= high):
        if robot.workspace:
            raise ValueError("workspace must have low < high")
        raise ValueError(
            f"the base anchors of the {robot.cables} cables span no workspace: add cables, or give a workspace"
        )
    if robot.kind == "spatial" and max(abs(low[4]), abs(high[4])) >= math.pi / 2:
        raise ValueError(
            "workspace: θ must stay within ± π/2 rad, where the Euler angles are singular"
        )
    checks.check_cables_differ(robot.base, robot.platform)


def _check_home(robot: Robot) -> None:
    """Checks that the cables hold the home pose."""
    low, high = robot.pose_bounds
    if np.any(robot.home < low) or np.any(robot.home > high):
        raise HomePoseError(
            f"home_pose {robot.home_pose} lies outside the workspace {low.tolist()} to {high.tolist()}; without "
            "`workspace`, it is the box of the base anchors"
        )
    with np.errstate(invalid="ignore"):  # inside a swivel pulley
        lengths = cable_lengths(robot.base, robot.platform, robot.home, robot.swivel)
    if not np.all(lengths >= 1e-6):  # NaN counts as too short
        raise HomePoseError(
            "a cable has zero length at home_pose; move the pose away from its base anchor"
        )
    jacobian = structure_jacobian(robot.base, robot.platform, robot.home, robot.swivel)
    # The rows of S begin with unit vectors, so the tolerance needs no scale.
    rank = np.linalg.matrix_rank(jacobian, tol=1e-9)
    if rank < min(robot.cables, robot.coordinates):
        free = checks.free_coordinate(robot.kind, jacobian)
        raise HomePoseError(
            f"{robot.name}: at home_pose {robot.home_pose} the cables act in {rank} of {robot.coordinates} directions, "
            f"and {free} is free; move the pose or the anchors"
        )
    if not robot.hanging and not _in_equilibrium(robot, jacobian):
        problem = "no positive tensions hold"
        if robot.kind == "planar" and robot.weightless:
            problem = "the cables do not surround"
        remedy = "move the pose or the anchors"
        if _holds_upside_down(robot):
            remedy = f"upside down they would. {vertical_remedy(robot)}"
        raise HomePoseError(f"{robot.name}: {problem} home_pose {robot.home_pose}; {remedy}")


def vertical_remedy(robot: Robot) -> str:
    """Direction of the vertical axis in words, and how to convert a frame in which it points up."""
    if robot.planar:
        return (
            "y points down here. If it points up in your frame, change the signs of y and of the angle in "
            "anchors, center_of_mass, home_pose, workspace and motion"
        )
    return (
        "z points down here. If it points up in your frame, turn the frame about x. This changes the signs of y and z "
        "in anchors, center_of_mass, home_pose, workspace and motion"
    )


def _holds_upside_down(robot: Robot) -> bool:
    """Whether positive tensions would hold the home pose if gravity acted upwards: a frame may have
    been turned."""
    jacobian = structure_jacobian(robot.base, robot.platform, robot.home, robot.swivel)
    return not robot.weightless and _in_equilibrium(robot, jacobian, upside_down=True)


def _in_equilibrium(robot: Robot, jacobian: Array, *, upside_down: bool = False) -> bool:
    """Whether positive tensions balance gravity at rest for this S: ``−Sᵀ T = (0, …, −m g, …,
    0)``."""
    if robot.kind == "planar" and robot.weightless:
        return checks.is_surrounded(jacobian)
    # A cable from 1 m above the centre of mass has the direction of the weight, and its row of S
    # has the lever.
    center = robot.mass_center[None]
    above = cable_vectors(np.zeros_like(center), center, robot.home)
    above[:, -1] -= 1.0
    weight = robot.mass * float(robot.gravity_vector[-1])
    if upside_down:
        weight = -weight
    return checks.is_balanced(jacobian, weight * structure_jacobian(above, center, robot.home)[0])
