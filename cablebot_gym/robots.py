"""Robots as data: geometry, inertia, motors and transmission. Each value of the paper's robots
cites its table.

Define a custom robot as a :class:`Robot`, or in a TOML file, see :func:`load_robot`. An error is
raised if the robot is not physically possible. All values are in SI units and radians, motor speeds
in rad/s.
"""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from cablebot_gym.kinematics import (
    Array,
    cable_lengths,
    cable_vectors,
    structure_jacobian,
)
from cablebot_gym.utils.checks import choice, mapping, number, numbers, record, unknown_name_error
from cablebot_gym.utils.files import check_not_a_file, read_text

RPM = 2 * math.pi / 60
"""One revolution per minute in rad/s."""

GRAVITY = 9.81
"""Gravitational acceleration along +z [m/s²], the value of the paper and of most robots here."""

LARGEST_SIZE = 3000.0
"""Largest ratio of the width of the base to a pulley radius. It is 20 for the paper's robots and
220 for CoGiRo."""

LARGEST_PULLEY = 5.0
"""Largest radius of a pulley [m]."""

LARGEST_REACH = 50.0
"""Largest ratio of the platform anchors' distance from the centre of mass to the radius of
gyration, which is near one for a rigid body with anchors at its surface."""

PerMotor = float | tuple[float, ...]

Cable = Literal["unilateral", "bilateral"]
"""``unilateral`` cables can only pull. ``bilateral`` cables can push too, as in the paper's
equations."""

Kind = Literal["planar", "planar-platform", "point", "spatial"]
"""Kinds of platforms: a point mass in a plane with the pose (x, y), a platform in a plane (x, y,
φ), a point mass in space (x, y, z), and a platform in space (x, y, z, ψ, θ, φ)."""

Plane = Literal["horizontal", "vertical"]
"""Plane in which a planar robot moves. In the vertical plane, y points down and gravity acts along
+y."""


@dataclass(frozen=True, kw_only=True)
class Motors:
    """Torque-speed lines ``U± = ±τ_s − (τ_s/ω_n)·speed`` (Eq. 37), and the lag of the requested
    torque."""

    stall_torque: PerMotor
    """Stall torque τ_s [N·m], one value for all motors or one per motor; > 0."""
    free_speed: PerMotor
    """Free-running speed ω_n [rad/s], one value or one per motor; > 0. Multiply a value in rpm by
    :data:`RPM`."""
    lag: PerMotor = 0.0
    """Time constant of the first-order lag of the requested torque [s], one value or one per motor;
    ≥ 0.

    The torque-speed line limits the torque after the lag. The paper has no lag.
    """

    def __post_init__(self) -> None:
        _set_per_motor(self, positive=("stall_torque", "free_speed"))

    def replace(self, **changes: Any) -> Motors:
        """A copy with the fields in ``changes`` replaced."""
        return dataclasses.replace(self, **changes)


@dataclass(frozen=True, kw_only=True)
class Transmission:
    """Transmission from motor to cable.

    Rigid (``stiffness`` is None): ``τ = r T + J β̈ + c β̇`` (Eq. 1). Flexible, with a spring
    between motor and pulley (Eq. 4): ``J′ β̈′ + c′ β̇′ + K (β′ − β) = τ`` and ``K (β′ − β) = r T +
    J β̈ + c β̇``.

    Elastic cables (``axial_stiffness``) are slack until they are stretched. Then T depends on their
    strain, see :func:`~cablebot_gym.physics.textbook.cable_springs`. Without joint springs, J
    includes the motor and τ acts on it: ``J β̈ + c β̇ = τ − r T``. With joint springs, J is the
    inertia between the two springs.
    """

    pulley_radius: PerMotor
    """Pulley radius r [m], one value or one per motor; > 0."""
    pulley_inertia: PerMotor
    """Inertia J of pulley and, if rigid, motor [kg·m²], one value or one per motor; ≥ 0."""
    damping: PerMotor = 0.0
    """Viscous damping c at the pulley [N·m·s/rad], one value or one per motor; ≥ 0."""
    coulomb_friction: PerMotor = 0.0
    """Coulomb friction τ_c on the motor's shaft [N·m], one value or one per motor; ≥ 0.

    A rigid transmission has one shaft with motor and pulley. The torque is smooth at standstill,
    see :func:`~cablebot_gym.physics.textbook.coulomb_torque`. The paper has no Coulomb friction.
    """
    stiffness: PerMotor | None = None
    """Stiffness K of the joint springs [N·m/rad], one value or one per motor; > 0. None for a rigid
    transmission."""
    motor_inertia: PerMotor | None = None
    """Motor inertia J′ of a flexible robot [kg·m²], one value or one per motor; > 0. None if
    rigid."""
    motor_damping: PerMotor = 0.0
    """Viscous damping c′ at the motor of a flexible robot [N·m·s/rad], one value or one per motor;
    ≥ 0. 0 if rigid."""
    axial_stiffness: PerMotor | None = None
    """Axial stiffness EA of elastic cables [N], one value or one per cable; > 0. None if the cables
    do not stretch."""
    axial_damping: PerMotor = 0.0
    """Axial damping ηA of elastic cables [N·s], one value or one per cable; ≥ 0. 0 if the cables do
    not stretch."""
    extra_length: PerMotor = 0.0
    """Length of each elastic cable between its pulley and its base anchor, which stretches too [m];
    ≥ 0."""

    def __post_init__(self) -> None:
        _set_per_motor(
            self, positive=("pulley_radius", "stiffness", "motor_inertia", "axial_stiffness")
        )
        if (self.stiffness is None) != (self.motor_inertia is None):
            raise ValueError(
                "a flexible transmission needs stiffness and motor_inertia; a rigid one has neither"
            )
        if self.stiffness is None and np.any(self.motor_damping):
            raise ValueError("a rigid transmission has no motor_damping; use damping")
        if self.axial_stiffness is None and (
            np.any(self.axial_damping) or np.any(self.extra_length)
        ):
            raise ValueError(
                "axial_damping and extra_length are for elastic cables: set axial_stiffness, or remove them"
            )
        if self.axial_stiffness is not None and np.min(self.pulley_inertia) <= 0:
            raise ValueError(
                "pulley_inertia must be greater than 0 with elastic cables: include the motor's inertia"
            )

    def replace(self, **changes: Any) -> Transmission:
        """A copy with the fields in ``changes`` replaced."""
        return dataclasses.replace(self, **changes)


def _set_per_motor(data: Motors | Transmission, positive: tuple[str, ...]) -> None:
    """Checks all fields and converts lists and arrays to tuples, which keep a robot hashable."""
    for field in dataclasses.fields(data):
        value = _as_tuples(getattr(data, field.name))
        if value is not None or field.default is not None:
            above = 0.0 if field.name in positive else -math.inf
            numbers(field.name, value, form="one number or one per motor", above=above, least=0.0)
        object.__setattr__(data, field.name, value)


def _as_tuples(value: Any) -> Any:
    value = value.tolist() if isinstance(value, np.ndarray) else value
    return tuple(_as_tuples(item) for item in value) if isinstance(value, (list, tuple)) else value


def _per_motor(part: Literal["motors", "transmission"], field: str) -> cached_property[Array]:
    """Property of a :class:`Robot` with a value of its motors or its transmission, shape (m,)."""

    def values(robot: Robot) -> Array:
        value = getattr(getattr(robot, part), field)
        if value is None or (field == "motor_damping" and not robot.jointed):
            other = "elastic cables" if field == "axial_stiffness" else "joint springs"
            raise ValueError(
                f"{robot.name} has a transmission without {field}; choose a robot with {other}"
            )
        return robot.per_motor(value)

    return cached_property(values)


@dataclass(frozen=True, kw_only=True)
class Defaults:
    """Defaults of the environments and evaluations of a robot. None and omitted keys stand for the
    usual defaults."""

    trajectory: str | Mapping[str, Any] | None = None
    """Reference motion, as for :func:`~cablebot_gym.trajectories.find_trajectory`."""
    error_bounds: Mapping[str, float] | None = None
    """Bounds of the tracking error: ``position`` [m] and ``rotation`` [rad]."""
    payload_range: tuple[float, float] | None = None
    """(low, high), the payloads that the robot is used with [kg]; ≥ 0. Scans end at ``high``. The
    commands that run an episode with one payload use ``low`` if none is given."""

    def __post_init__(self) -> None:
        mapping("error_bounds", self.error_bounds or {}, ("position", "rotation"))
        if self.payload_range is not None:
            form = "(low, high)"
            low, high = numbers(
                "payload_range", self.payload_range, shapes=[(2,)], form=form, least=0
            ).tolist()
            object.__setattr__(
                self, "payload_range", (low, number("payload_range", high, above=low, unit="kg"))
            )

    def payload(self, usual: float) -> float:
        """Payload of an episode [kg]; ``usual`` without a range."""
        return usual if self.payload_range is None else self.payload_range[0]


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
    platform, without it m > n.

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
    I_yy, I_zz) or the tensor with three rows, in a plane (I_zz,); empty for a point mass."""
    center_of_mass: tuple[float, ...] = ()
    """Centre of mass in the platform frame [m], shape (2,) or (3,); empty for the origin, as for a
    point mass. The payload is there, too. The pose is that of the origin."""
    plane: Plane = "horizontal"
    """Plane in which a planar robot moves."""
    swivel_radius: PerMotor = 0.0
    """Radius ρ of the swivel pulleys of a robot in space [m], one value or one per cable; ≥ 0.

    Each cable runs along the vertical swivel axis through its base anchor to the pulley, which
    turns about that axis towards the platform anchor. With 0 the cables end in points. A planar
    robot only accepts 0.
    """
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
    workspace: tuple[tuple[float, float], ...] = ()
    """(low, high) of each coordinate [m, rad]. Empty: the bounding box of the base anchors, and
    angles within ± 1 rad. If the home pose is below all anchors, the box begins at the lowest one;
    its depth is its diagonal in plan."""
    defaults: Defaults = dataclasses.field(default=Defaults(), compare=False, repr=False)
    """Default motion, error bounds and payload range. Robots that differ only in these are
    equal."""
    sources: Mapping[str, str] = dataclasses.field(default_factory=dict, compare=False, repr=False)
    """Source of the values by name of the field, such as ``base_anchors`` or
    ``motors.stall_torque``. The source of an assumed value starts with ``assumed``."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, (list, tuple, np.ndarray)):  # a robot is hashable
                object.__setattr__(self, field.name, _as_tuples(value))
        object.__setattr__(self, "motors", record("motors", Motors, self.motors))
        object.__setattr__(
            self, "transmission", record("transmission", Transmission, self.transmission)
        )
        object.__setattr__(self, "defaults", record("defaults", Defaults, self.defaults))
        _check_fields(self)
        _check_units(self)
        _check_geometry(self)

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
        if self.planar:
            return "planar" if self.point_mass else "planar-platform"
        return "point" if self.point_mass else "spatial"

    @property
    def dimensions(self) -> int:
        """Number d of coordinates of the position, the first of the pose: 2 or 3. The others are
        angles."""
        return 2 if self.planar else 3

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose: 2, 3 or 6, by :attr:`kind`."""
        return self.dimensions + (0 if self.point_mass else 1 if self.planar else 3)

    @property
    def weightless(self) -> bool:
        """Whether no gravity acts along the coordinates, as in a horizontal plane."""
        return (self.planar and self.plane == "horizontal") or self.gravity == 0

    @cached_property
    def gravity_vector(self) -> Array:
        """Gravitational acceleration, shape (d,) [m/s²]."""
        return _frozen([0.0] * (self.dimensions - 1) + [0.0 if self.weightless else self.gravity])

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
        given = np.asarray(self.inertia, float)
        if given.shape == (3, 3):
            return _frozen(given)
        return _frozen(np.diag([0.0] * (3 - given.size) + given.tolist()))

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
        if (not self.weightless or not self.planar) and self.home_pose[self.dimensions - 1] >= high[
            -1
        ]:
            depth = float(np.linalg.norm((high - low)[:-1]))
            low = np.append(low[:-1], high[-1])
            high = np.append(high[:-1], high[-1] + depth)
        angles = np.ones(self.coordinates - self.dimensions)
        return _frozen([np.concatenate([low, -angles]), np.concatenate([high, angles])])

    def per_motor(self, value: PerMotor) -> Array:
        """A value of the motors or the transmission as an array, shape (m,)."""
        return _frozen(np.broadcast_to(np.asarray(value, float), (self.cables,)))

    pulley_radius = _per_motor("transmission", "pulley_radius")
    """Pulley radius r, shape (m,) [m]."""
    pulley_inertia = _per_motor("transmission", "pulley_inertia")
    """Pulley inertia J, shape (m,) [kg·m²]."""
    damping = _per_motor("transmission", "damping")
    """Pulley damping c, shape (m,) [N·m·s/rad]."""
    stiffness = _per_motor("transmission", "stiffness")
    """Joint stiffness K of a flexible robot, shape (m,) [N·m/rad]."""
    motor_inertia = _per_motor("transmission", "motor_inertia")
    """Motor inertia J′ of a flexible robot, shape (m,) [kg·m²]."""
    motor_damping = _per_motor("transmission", "motor_damping")
    """Motor damping c′ of a flexible robot, shape (m,) [N·m·s/rad]."""
    coulomb_friction = _per_motor("transmission", "coulomb_friction")
    """Coulomb friction τ_c, shape (m,) [N·m]."""
    axial_stiffness = _per_motor("transmission", "axial_stiffness")
    """Axial stiffness EA of elastic cables, shape (m,) [N]."""
    axial_damping = _per_motor("transmission", "axial_damping")
    """Axial damping ηA of elastic cables, shape (m,) [N·s]."""
    extra_length = _per_motor("transmission", "extra_length")
    """Length of the elastic cables between pulley and base anchor, shape (m,) [m]."""
    motor_lag = _per_motor("motors", "lag")
    """Time constants of the lag of the requested torque, shape (m,) [s]."""
    stall_torque = _per_motor("motors", "stall_torque")
    """Stall torque τ_s, shape (m,) [N·m]."""

    @cached_property
    def speed_slope(self) -> Array:
        """Slope τ_s/ω_n of the torque-speed line, k₂ of Eq. 37, shape (m,) [N·m·s/rad]."""
        return _frozen(self.stall_torque / self.per_motor(self.motors.free_speed))

    @cached_property
    def swivel(self) -> Array | None:
        """Signed radii ± ρ of the swivel pulleys, shape (m,) [m], see
        :func:`~cablebot_gym.kinematics.cable_lengths`; None if all are zero.

        A cable reaches a pulley that is above its platform anchor at the home pose from below, else
        from above.
        """
        if not np.any(self.swivel_radius):
            return None
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
        """What is elastic, as text: ``rigid``, ``joint springs``, ``elastic cables``, or the last
        two."""
        springs = []
        if self.jointed:
            springs.append("joint springs")
        if self.elastic:
            springs.append("elastic cables")
        return " and ".join(springs) or "rigid"

    @property
    def joints(self) -> Literal["rigid", "flexible"]:
        """``rigid`` or ``flexible``; used as a key in tables of settings."""
        return "flexible" if self.flexible else "rigid"

    def replace(self, **changes: Any) -> Robot:
        """A copy with the fields in ``changes`` replaced. The copy is checked again."""
        return dataclasses.replace(self, **changes)

    def with_rigid_cables(self) -> Robot:
        """A copy whose cables do not stretch."""
        rigid = {
            name: Transmission.__dataclass_fields__[name].default
            for name in _OPTIONAL_OF_TRANSMISSION
        }
        return self.replace(transmission=self.transmission.replace(**rigid))

    def to_dict(self) -> dict[str, Any]:
        """The robot as JSON-able data, which :meth:`from_dict` reads, without sources and without
        unused options."""
        data = dataclasses.asdict(self)
        del data["sources"]
        for part, names in ((data, _OPTIONAL), (data["transmission"], _OPTIONAL_OF_TRANSMISSION)):
            for name in names:
                if part[name] in ((), 0.0, None, "horizontal"):
                    del part[name]
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


_OPTIONAL = ("center_of_mass", "plane", "swivel_radius", "cable_density")
_OPTIONAL_OF_TRANSMISSION = ("axial_stiffness", "axial_damping", "extra_length")
"""Fields that :meth:`Robot.to_dict` leaves out where they have no effect."""


def _frozen(values: Any) -> Array:
    """Read-only array in immutable memory, which no flag makes writable."""
    array = np.asarray(values, dtype=float)
    return np.frombuffer(array.tobytes()).reshape(array.shape)


KIND_TEXTS: dict[Kind, str] = {
    "planar": "a point mass in a plane",
    "planar-platform": "a platform in a plane",
    "point": "a point mass in space",
    "spatial": "a platform in space",
}
"""Kinds as text."""


def _check_fields(robot: Robot) -> None:
    """Checks the shape and the bounds of each field."""
    given = robot.base_anchors
    m = len(given) if isinstance(given, tuple) else 0
    numbers(
        "base_anchors", given, shapes=[(m, 2), (m, 3)], form="one (x, y) or one (x, y, z) per cable"
    )
    d, planar = robot.dimensions, robot.planar
    axes = "(x, y)" if planar else "(x, y, z)"
    numbers(
        "platform_anchors",
        robot.platform_anchors,
        shapes=[(0,), (m, d)],
        form=f"one {axes} per cable, or empty for a point mass",
    )
    n, point = robot.coordinates, robot.point_mass
    if planar or point:
        form = "empty for a point mass" if point else "(I_zz,)"
        numbers("inertia", robot.inertia, shapes=[(0,) if point else (1,)], form=form, above=0)
    else:
        form = "(I_xx, I_yy, I_zz), or three rows of the tensor"
        numbers("inertia", robot.inertia, shapes=[(3,), (3, 3)], form=form)
    numbers("home_pose", robot.home_pose, shapes=[(n,)], form=f"{n} coordinates")
    numbers(
        "workspace", robot.workspace, shapes=[(0,), (n, 2)], form=f"{n} pairs (low, high), or empty"
    )
    form = "empty for a point mass" if point else f"{axes}, or empty"
    numbers(
        "center_of_mass", robot.center_of_mass, shapes=[(0,)] if point else [(0,), (d,)], form=form
    )
    number("mass", robot.mass, above=0, unit="kg")
    number("gravity", robot.gravity, least=0, unit="m/s²")
    choice("plane", robot.plane, get_args(Plane))
    if not planar and robot.plane != "horizontal":
        raise ValueError("plane is for planar robots, with base_anchors (x, y): remove it")
    if planar and robot.plane == "horizontal" and robot.gravity != GRAVITY:
        raise ValueError(
            'gravity does not act in a horizontal plane: remove it, or set plane = "vertical"'
        )
    number("minimum_tension", robot.minimum_tension, least=0, unit="N")
    for name in ("swivel_radius", "cable_density"):
        numbers(
            name,
            getattr(robot, name),
            shapes=[(), (m,)],
            form="one number or one per cable",
            least=0,
        )
    if planar and np.any(robot.swivel_radius):
        raise ValueError(
            "swivel_radius is for robots in space: remove it, and use the point where the cable leaves"
        )
    for part in (robot.motors, robot.transmission):
        for field in dataclasses.fields(part):
            if np.shape(getattr(part, field.name)) not in ((), (m,)):
                raise ValueError(
                    f"{field.name} must be one number or one for each of the {m} motors"
                )
    if not isinstance(robot.sources, Mapping):
        raise ValueError(
            f"sources must be a table of texts by the name of the field, not {robot.sources!r}"
        )
    fewest = n + robot.weightless
    if m < fewest:
        without = " without gravity" if robot.weightless else ""
        raise ValueError(
            f"base_anchors: {KIND_TEXTS[robot.kind]}{without} needs at least {fewest} cables, not {m}. With fewer, "
            f"the {n} coordinates of the pose are not all held, and the platform swings. Add cables"
        )


def _check_units(robot: Robot) -> None:
    """Checks that no length is in millimetres: the limits are far beyond every cable robot that was
    built."""
    size = float(np.max(np.ptp(robot.base, axis=0)))
    radius = float(robot.pulley_radius.min())
    remedy = "lengths are in metres: divide millimetres by 1000"
    if size > LARGEST_SIZE * radius:
        raise ValueError(
            f"base_anchors are {size:g} m wide and pulley_radius is {radius:g} m; {remedy}"
        )
    for name, pulleys in (
        ("pulley_radius", robot.pulley_radius),
        ("swivel_radius", np.asarray(robot.swivel_radius)),
    ):
        if pulleys.max() > LARGEST_PULLEY:
            raise ValueError(f"{name} is {pulleys.max():g} m; {remedy}")
    if not robot.point_mass:
        reach, gyration = reach_and_gyration(robot)
        if reach > LARGEST_REACH * gyration:
            raise ValueError(
                f"platform_anchors reach {reach:g} m from the centre of mass, and the radius of gyration is "
                f"{gyration:.3g} m; {remedy}"
            )


def reach_and_gyration(robot: Robot) -> tuple[float, float]:
    """Largest distance of a platform anchor from the centre of mass, and largest radius of gyration
    [m]."""
    reach = float(np.max(np.linalg.norm(robot.platform - robot.mass_center, axis=1)))
    return reach, math.sqrt(
        max(float(np.linalg.eigvalsh(robot.inertia_tensor).max()), 0.0) / robot.mass
    )


def _check_geometry(robot: Robot) -> None:
    """Checks that a body and cables of this form exist and that the cables hold the home pose."""
    tensor = robot.inertia_tensor
    if robot.kind == "spatial":
        if not np.allclose(tensor, tensor.T, rtol=1e-9, atol=0):
            raise ValueError("inertia: the tensor must be symmetric")
        moments = np.linalg.eigvalsh(tensor)
        if moments.min() <= 0:
            raise ValueError(
                f"inertia {robot.inertia}: all principal moments must be greater than 0"
            )
        if 2 * moments.max() > moments.sum() + 1e-9 * moments.max():
            raise ValueError(
                f"inertia {robot.inertia}: no principal moment may exceed the sum of the other two; products of "
                "inertia have the sign of the tensor, I_xy = −∫xy dm"
            )
    if (
        not robot.weightless
        and cable_vectors(robot.base, robot.platform, robot.home)[:, -1].max() < 0
    ):
        raise ValueError(
            f"all base anchors are below the platform at home_pose; {vertical_remedy(robot)}"
        )
    low, high = robot.pose_bounds
    if np.any(low >= high):
        raise ValueError(
            "workspace must have low < high; give one if the base anchors lie on a line along an axis"
        )
    if robot.kind == "spatial" and max(abs(low[4]), abs(high[4])) >= math.pi / 2:
        raise ValueError(
            "workspace: θ must stay within ± π/2 rad, where the Euler angles are singular"
        )
    ends = np.concatenate([robot.base, robot.platform], axis=1)
    for i, j in combinations(range(robot.cables), 2):
        if np.allclose(ends[i], ends[j], rtol=0, atol=1e-9):
            raise ValueError(f"cables {i + 1} and {j + 1} coincide; give them different anchors")
    if np.any(robot.home < low) or np.any(robot.home > high):
        raise ValueError(
            f"home_pose {robot.home_pose} lies outside the workspace {low.tolist()} to {high.tolist()}"
        )
    with np.errstate(invalid="ignore"):  # inside a swivel pulley
        lengths = cable_lengths(robot.base, robot.platform, robot.home, robot.swivel)
    if not np.all(lengths >= 1e-6):
        raise ValueError(
            "a cable has zero length at home_pose; move the pose away from its base anchor"
        )
    jacobian = structure_jacobian(robot.base, robot.platform, robot.home, robot.swivel)
    rank = np.linalg.matrix_rank(jacobian, tol=1e-9)
    if rank < robot.coordinates:
        raise ValueError(
            f"{robot.name}: at home_pose {robot.home_pose} the cables act in {rank} of {robot.coordinates} directions, "
            f"and {_free_direction(robot, jacobian)} is free; move the pose or the anchors"
        )
    if not _in_equilibrium(robot, jacobian):
        problem = (
            "the cables do not surround"
            if robot.kind == "planar" and robot.weightless
            else "no positive tensions hold"
        )
        remedy = "move the pose or the anchors"
        if holds_upside_down(robot):
            remedy = f"upside down they would. {vertical_remedy(robot)}"
        raise ValueError(f"{robot.name}: {problem} home_pose {robot.home_pose}; {remedy}")


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


COORDINATE_NAMES: dict[Kind, str] = {
    "planar": "xy",
    "planar-platform": "xyφ",
    "point": "xyz",
    "spatial": "xyzψθφ",
}
"""Symbols of the coordinates of a pose by kind."""


def _free_direction(robot: Robot, jacobian: Array) -> str:
    """Coordinate with the largest part in the direction that no cable resists."""
    direction = np.linalg.svd(jacobian)[2][-1]
    return COORDINATE_NAMES[robot.kind][int(np.argmax(np.abs(direction)))]


def holds_upside_down(robot: Robot) -> bool:
    """Whether positive tensions would hold the home pose if gravity acted upwards: a frame may have
    been turned."""
    jacobian = structure_jacobian(robot.base, robot.platform, robot.home, robot.swivel)
    return not robot.weightless and _in_equilibrium(robot, jacobian, upside_down=True)


def _in_equilibrium(robot: Robot, jacobian: Array, *, upside_down: bool = False) -> bool:
    """Whether positive tensions balance gravity at rest for this S: ``−Sᵀ T = (0, …, −m g, …,
    0)``."""
    if robot.kind == "planar" and robot.weightless:  # no open half plane is free of cables
        angles = np.sort(np.arctan2(jacobian[:, 1], jacobian[:, 0]))
        gaps = np.diff(np.append(angles, angles[0] + 2 * math.pi))
        return bool(gaps.max() < math.pi - 1e-9)
    # A cable from 1 m above the centre of mass has the direction of the weight, and its row of S
    # has the lever.
    center = robot.mass_center[None]
    above = cable_vectors(np.zeros_like(center), center, robot.home)
    above[:, -1] -= 1.0
    weight = robot.mass * (0.0 if robot.weightless else robot.gravity)
    if upside_down:
        weight = -weight
    pulls = weight * structure_jacobian(above, center, robot.home)[0]
    if robot.cables == robot.coordinates:
        return bool(np.linalg.solve(jacobian.T, pulls).min() > 1e-9)
    from scipy.optimize import linprog  # slow to import

    # The largest t ≤ 1 with T_i ≥ t: positive if and only if positive tensions balance the weight.
    scale = max(float(np.abs(pulls).max()), 1.0)
    solution = linprog(
        [0.0] * robot.cables + [-1.0],
        A_ub=np.column_stack([-np.eye(robot.cables), np.ones(robot.cables)]),
        b_ub=np.zeros(robot.cables),
        A_eq=np.column_stack([jacobian.T, np.zeros(robot.coordinates)]),
        b_eq=pulls / scale,
        bounds=[(0, None)] * robot.cables + [(None, 1.0)],
    )
    return bool(solution.success) and -float(solution.fun or 0.0) > 1e-9


def _planar_paper() -> Robot:
    radius = 1 / math.sqrt(3)
    """Circumradius of the equilateral triangle of side 1 m (Table 2)."""
    return Robot(
        name="planar",
        base_anchors=tuple(
            (radius * math.cos(math.radians(angle)), radius * math.sin(math.radians(angle)))
            for angle in (210, 330, 90)
        ),
        mass=1.0,  # Tables 2 and 7
        motors=Motors(stall_torque=5.0, free_speed=1000 * RPM),  # Table 7
        transmission=Transmission(
            pulley_radius=0.05,  # Table 2
            pulley_inertia=8e-4,  # Table 2
            damping=0.0,  # the paper gives none for the planar robot
        ),
        home_pose=(0.0, 0.0),
    )


def _spatial_paper() -> Robot:
    a, b = 0.47, 0.148  # half sides of the base and platform triangles, Table 4
    root = math.sqrt(3)
    a1 = (-a, -a / root, 0.0)
    a2 = (a, -a / root, 0.0)
    a3 = (0.0, 2 * a / root, 0.0)
    p1 = (0.0, -2 * b / root, 0.0)
    p2 = (-b, b / root, 0.0)
    p3 = (b, b / root, 0.0)
    return Robot(
        name="spatial",
        base_anchors=(a1, a2, a2, a3, a3, a1),
        platform_anchors=(p1, p1, p3, p3, p2, p2),
        mass=10.0,  # Table 8 (Table 4: 11 with a load of 1 kg)
        inertia=(0.58, 0.58, 1.16),  # Table 4
        motors=Motors(stall_torque=10.0, free_speed=1000 * RPM),  # Table 8
        transmission=Transmission(
            pulley_radius=0.05,  # Table 4
            pulley_inertia=8e-4,  # Table 4
            damping=0.01,  # Table 4; the unit must be N·m·s/rad
        ),
        home_pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
    )


def _flexible_paper(rigid: Robot) -> Robot:
    transmission = Transmission(
        pulley_radius=rigid.transmission.pulley_radius,  # Table 5
        pulley_inertia=4e-4,  # Table 5
        stiffness=3.0,  # §5.2.3 (Table 5: 2); not in the paper for the planar robot
        motor_inertia=4e-4,  # Table 5
    )  # Eq. 4 has no damping
    return rigid.replace(name=f"flex-{rigid.name}", transmission=transmission)


PLANAR = _planar_paper()
"""The paper's planar robot with three cables and a point mass (Tables 2 and 7)."""

SPATIAL = _spatial_paper()
"""The paper's spatial robot with six cables and a triangular platform (Tables 4 and 8)."""

FLEX_PLANAR = _flexible_paper(PLANAR)
"""The planar robot with the joint springs of the spatial one; the paper has no flexible planar
robot."""

FLEX_SPATIAL = _flexible_paper(SPATIAL)
"""The paper's spatial robot with joint springs (Tables 5 and 9)."""

PAPER_PAYLOAD_MAX = {"planar": 10.0, "spatial": 20.0}
"""End of the scans for the paper's robots by kind [kg]. :func:`has_paper_capacity` tells for which
robots."""


def has_paper_geometry(robot: Robot) -> bool:
    """Whether anchors and home pose are those of the paper's robots, so that the paper's circles
    fit."""
    return _is_paper_robot_in(robot, "base", "platform", "home")


def has_paper_capacity(robot: Robot) -> bool:
    """Whether anchors, mass and motors are those of the paper's robots. Springs, inertias and
    friction may differ."""
    return _is_paper_robot_in(
        robot, "base", "platform", "home", "mass", "stall_torque", "speed_slope", "pulley_radius"
    )


def _is_paper_robot_in(robot: Robot, *attributes: str) -> bool:
    return any(
        all(np.array_equal(getattr(robot, name), getattr(paper, name)) for name in attributes)
        for paper in (PLANAR, SPATIAL)
    )


ROBOTS: dict[str, Robot] = {
    robot.name: robot for robot in (PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL)
}
"""The paper's robots by name."""

ELASTIC = "flex-"
"""Prefix of the name of a robot of the library for the variant with elastic cables."""


@cache
def library() -> dict[str, Path]:
    """Files of the real robots by name, ``cablebot_gym/library/*.toml``."""
    folder = Path(str(files("cablebot_gym") / "library"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def robot_names() -> list[str]:
    """All names that :func:`find_robot` accepts: the paper's robots, then those of the library and
    their variants."""
    return [*ROBOTS, *library(), *(ELASTIC + name for name in library())]


@cache
def _library_robot(name: str) -> Robot:
    robot = load_robot(library()[name.removeprefix(ELASTIC)])
    return robot.replace(name=name) if name.startswith(ELASTIC) else robot.with_rigid_cables()


def load_robot(path: str | Path) -> Robot:
    """A robot from a TOML file with the fields of :class:`Robot`, and with the optional table
    :class:`Defaults`.

    A ``.json`` file has the data of :meth:`Robot.to_dict`. A default motion ``file.py:name`` or
    ``file.csv`` is relative to the folder of the file.

    Raises:
        ValueError: if the file cannot be read or does not describe a physical robot. The message
            names the file.
    """
    path = Path(path)
    try:
        text = read_text(path)
        data = json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
        robot = Robot.from_dict(data)
    except OSError as error:
        raise ValueError(f"cannot read robot file {str(path)!r}: {error.strerror}") from error
    except ValueError as error:  # of the TOML, too
        raise ValueError(f"robot file {str(path)!r}: {error}") from error
    return robot.replace(defaults=_with_motion_beside(robot.defaults, path.absolute().parent))


def _with_motion_beside(defaults: Defaults, folder: Path) -> Defaults:
    """Defaults whose motion, if it is that of a file, is in the folder of the robot's file."""
    motion = defaults.trajectory
    name = motion.get("name") if isinstance(motion, Mapping) else motion
    if not isinstance(name, str) or not (".py:" in name or name.lower().endswith((".py", ".csv"))):
        return defaults
    beside = str(folder / name)
    return dataclasses.replace(
        defaults, trajectory=dict(motion, name=beside) if isinstance(motion, Mapping) else beside
    )


def find_robot(robot: str | Path | Mapping[str, Any] | Robot) -> Robot:
    """A robot from a name, from a TOML or JSON file, from :meth:`Robot.to_dict` data, or from a
    :class:`Robot`.

    Names are those of :func:`robot_names`. ``cogiro`` is the robot of the library with rigid
    cables, ``flex-cogiro`` the same robot with elastic cables, as its file describes it.

    Raises:
        ValueError: if the name is unknown or the data do not describe a physical robot.
    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, Mapping):
        return Robot.from_dict(robot)
    if isinstance(robot, (str, Path)) and Path(robot).suffix.lower() in (".toml", ".json"):
        return load_robot(robot)
    if str(robot) in ROBOTS:
        return ROBOTS[str(robot)]
    if str(robot).removeprefix(ELASTIC) not in library():
        forms = "a .toml or .json file"
        check_not_a_file(
            "robot", robot, f"{forms}; `cablebot robot import` makes one from CASPR and WireX files"
        )
        raise unknown_name_error("robot", robot, robot_names(), f", {forms}, or pass a Robot")
    return _library_robot(str(robot))
