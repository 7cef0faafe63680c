"""Robots as data: geometry, inertia, motors and transmission. Each value of the paper's robots cites its table.

Define a custom robot as a :class:`Robot`. Its constructor raises an error if the robot is not physically possible.
All values are in SI units and radians, motor speeds in rad/s.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np

from cablebot_gym.kinematics import SPATIAL_COORDINATES, Array, cable_lengths, structure_jacobian
from cablebot_gym.utils.checks import unknown_name_error

RPM = 2 * math.pi / 60
"""One revolution per minute in rad/s."""

STANDARD_GRAVITY = 9.81
"""Gravitational acceleration along +z [m/s²]."""

PerMotor = float | tuple[float, ...]

Cable = Literal["unilateral", "bilateral"]
"""``unilateral`` cables can only pull. ``bilateral`` cables can push too, as in the paper's equations."""


@dataclass(frozen=True, kw_only=True)
class Motors:
    """Torque-speed lines ``U± = ±τ_s − (τ_s/ω_n)·speed`` (Eq. 37)."""

    stall_torque: PerMotor
    """Stall torque τ_s [N·m], one value for all motors or one per motor; > 0."""
    free_speed: PerMotor
    """Free-running speed ω_n [rad/s], one value or one per motor; > 0. Multiply a value in rpm by :data:`RPM`."""

    def __post_init__(self) -> None:
        _freeze_fields(self)

    def replace(self, **changes: Any) -> Motors:
        """A copy with the fields in ``changes`` replaced."""
        return dataclasses.replace(self, **changes)


@dataclass(frozen=True, kw_only=True)
class Transmission:
    """Transmission from motor to cable.

    Rigid (``stiffness`` is None): ``τ = r T + J β̈ + c β̇`` (Eq. 1). Flexible, with a spring between motor and pulley
    (Eq. 4): ``J′ β̈′ + c′ β̇′ + K (β′ − β) = τ`` and ``K (β′ − β) = r T + J β̈ + c β̇``.
    """

    pulley_radius: PerMotor
    """Pulley radius r [m], one value or one per motor; > 0."""
    pulley_inertia: PerMotor
    """Inertia J of pulley and, if rigid, motor [kg·m²], one value or one per motor; ≥ 0."""
    damping: PerMotor = 0.0
    """Viscous damping c at the pulley [N·m·s/rad], one value or one per motor; ≥ 0."""
    stiffness: PerMotor | None = None
    """Stiffness K of the joint springs [N·m/rad], one value or one per motor; > 0. None for a rigid transmission."""
    motor_inertia: PerMotor | None = None
    """Motor inertia J′ of a flexible robot [kg·m²], one value or one per motor; > 0. None if rigid."""
    motor_damping: PerMotor = 0.0
    """Viscous damping c′ at the motor of a flexible robot [N·m·s/rad], one value or one per motor; ≥ 0. 0 if rigid."""

    def __post_init__(self) -> None:
        _freeze_fields(self)

    def replace(self, **changes: Any) -> Transmission:
        """A copy with the fields in ``changes`` replaced."""
        return dataclasses.replace(self, **changes)


class RobotArrays(Protocol):
    """The values of a :class:`Robot` that the equations use. For N robots they have a leading axis N."""

    @property
    def planar(self) -> bool:
        """Whether the robot moves in the horizontal plane."""

    @property
    def flexible(self) -> bool:
        """Whether there are springs between motors and pulleys."""

    @property
    def cables(self) -> int:
        """Number of cables m."""

    @property
    def coordinates(self) -> int:
        """Number of coordinates n."""

    @property
    def home(self) -> Array:
        """Home pose X₀, shape (n,) [m, rad]."""

    @property
    def gravity(self) -> float:
        """Gravitational acceleration along +z [m/s²]."""

    @property
    def mass(self) -> float | Array:
        """Platform mass [kg]."""

    @property
    def inertia(self) -> tuple[float, ...] | Array:
        """Principal moments of inertia, shape (3,) [kg·m²]."""

    @property
    def base(self) -> Array:
        """Base anchors, shape (m, 2) or (m, 3) [m]."""

    @property
    def platform(self) -> Array:
        """Platform anchors, shape (m, 2) or (m, 3) [m]."""

    @property
    def pulley_radius(self) -> Array:
        """Pulley radius r, shape (m,) [m]."""

    @property
    def pulley_inertia(self) -> Array:
        """Pulley inertia J, shape (m,) [kg·m²]."""

    @property
    def damping(self) -> Array:
        """Pulley damping c, shape (m,) [N·m·s/rad]."""

    @property
    def stiffness(self) -> Array:
        """Joint stiffness K, shape (m,) [N·m/rad]."""

    @property
    def motor_inertia(self) -> Array:
        """Motor inertia J′, shape (m,) [kg·m²]."""

    @property
    def motor_damping(self) -> Array:
        """Motor damping c′, shape (m,) [N·m·s/rad]."""

    @property
    def stall_torque(self) -> Array:
        """Stall torque τ_s, shape (m,) [N·m]."""

    @property
    def speed_slope(self) -> Array:
        """Slope τ_s/ω_n of the torque-speed line, shape (m,) [N·m·s/rad]."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """One cable robot. The number of columns of ``base_anchors`` determines its kind.

    * 2 columns: planar, a point mass in the horizontal plane without gravity (n = 2 coordinates, m ≥ 3 cables).
    * 3 columns: spatial, a suspended rigid platform (n = 6 coordinates, m = 6 cables).

    Raises:
        ValueError: if a value is not physical, two cables coincide, or no positive tensions hold ``home_pose``.
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
    """Platform anchors b_i in the platform frame [m], shape (m, 3); empty for a planar robot (point mass)."""
    inertia: tuple[float, ...] = ()
    """Principal moments of inertia (I_xx, I_yy, I_zz) about the platform axes [kg·m²]; empty for a planar robot."""
    gravity: float = STANDARD_GRAVITY
    """Gravitational acceleration along +z [m/s²]; has no effect on a planar robot."""
    workspace: tuple[tuple[float, float], ...] = ()
    """(low, high) of each coordinate [m, rad]. Empty: the bounding box of the base anchors; for a spatial robot, also a
    depth up to the diagonal of that box and angles within ± 1 rad."""

    def __post_init__(self) -> None:
        for name in ("base_anchors", "platform_anchors", "inertia", "home_pose", "workspace"):
            object.__setattr__(self, name, _as_tuples(getattr(self, name)))  # accept lists and arrays
        for name, kind in (("motors", Motors), ("transmission", Transmission)):
            if not isinstance(getattr(self, name), kind):
                raise ValueError(f"{name} must be a {kind.__name__}, such as robot.{name}.replace(…)")
        _check_shapes(self)
        _check_values(self)
        _check_home(self)

    @property
    def cables(self) -> int:
        """Number of cables m."""
        return len(self.base_anchors)

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose: 2 planar, 6 spatial."""
        return 2 if self.planar else SPATIAL_COORDINATES

    @property
    def planar(self) -> bool:
        """Whether the robot moves in the horizontal plane."""
        return len(self.base_anchors[0]) == 2

    @cached_property
    def base(self) -> Array:
        """Base anchors as an array, shape (m, 2) or (m, 3)."""
        return _frozen(self.base_anchors)

    @cached_property
    def platform(self) -> Array:
        """Platform anchors as an array, shape (m, 2) (zeros) or (m, 3)."""
        return _frozen(np.zeros((self.cables, 2)) if self.planar else self.platform_anchors)

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
        if self.planar:
            return _frozen([low, high])
        depth = float(np.linalg.norm(high[:2] - low[:2]))
        return _frozen([[*low[:2], high[2], -1.0, -1.0, -1.0], [*high[:2], high[2] + depth, 1.0, 1.0, 1.0]])

    def per_motor(self, value: PerMotor) -> Array:
        """A value of the motors or the transmission as an array, shape (m,)."""
        return np.broadcast_to(np.asarray(value, float), (self.cables,))

    @cached_property
    def pulley_radius(self) -> Array:
        """Pulley radius r, shape (m,) [m]."""
        return self.per_motor(self.transmission.pulley_radius)

    @cached_property
    def pulley_inertia(self) -> Array:
        """Pulley inertia J, shape (m,) [kg·m²]."""
        return self.per_motor(self.transmission.pulley_inertia)

    @cached_property
    def damping(self) -> Array:
        """Pulley damping c, shape (m,) [N·m·s/rad]."""
        return self.per_motor(self.transmission.damping)

    @property
    def flexible(self) -> bool:
        """Whether there are springs between motors and pulleys."""
        return self.transmission.stiffness is not None

    @property
    def joints(self) -> Literal["rigid", "flexible"]:
        """``rigid`` or ``flexible``; used as a key in tables of settings."""
        return "flexible" if self.flexible else "rigid"

    @cached_property
    def stiffness(self) -> Array:
        """Joint stiffness K of a flexible robot, shape (m,) [N·m/rad]."""
        return self.per_motor(self._flexible("stiffness"))

    @cached_property
    def motor_inertia(self) -> Array:
        """Motor inertia J′ of a flexible robot, shape (m,) [kg·m²]."""
        return self.per_motor(self._flexible("motor_inertia"))

    @cached_property
    def motor_damping(self) -> Array:
        """Motor damping c′ of a flexible robot, shape (m,) [N·m·s/rad]."""
        return self.per_motor(self._flexible("motor_damping"))

    def _flexible(self, field: str) -> PerMotor:
        if not self.flexible:
            raise ValueError(f"{self.name} has a rigid transmission without {field}; choose a flexible robot")
        value: PerMotor = getattr(self.transmission, field)
        return value

    @cached_property
    def stall_torque(self) -> Array:
        """Stall torque τ_s, shape (m,) [N·m]."""
        return self.per_motor(self.motors.stall_torque)

    @cached_property
    def speed_slope(self) -> Array:
        """Slope τ_s/ω_n of the torque-speed line, k₂ of Eq. 37, shape (m,) [N·m·s/rad]."""
        return self.stall_torque / self.per_motor(self.motors.free_speed)

    def replace(self, **changes: Any) -> Robot:
        """A copy with the fields in ``changes`` replaced. The copy is checked again."""
        return dataclasses.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """The robot as JSON-able data, which :meth:`from_dict` reads."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Robot:
        """A robot from the data of :meth:`to_dict`. Lists may replace tuples.

        Raises:
            ValueError: if a key is unknown or missing, or the robot is not physical.
        """
        fields = dataclasses.fields(cls)
        known = {field.name for field in fields}
        if unknown := set(data) - known:
            raise ValueError(f"unknown robot field {sorted(unknown)[0]!r}; the fields are {', '.join(sorted(known))}")
        needed = [field.name for field in fields if field.default is field.default_factory is dataclasses.MISSING]
        if missing := [name for name in needed if name not in data]:
            raise ValueError(f"a robot needs the field {missing[0]!r}; see Robot.to_dict() for the format")
        try:
            values = {key: _as_tuples(value) for key, value in data.items()}
            values["motors"] = Motors(**{key: _as_tuples(value) for key, value in data["motors"].items()})
            transmission = {key: _as_tuples(value) for key, value in data["transmission"].items()}
            values["transmission"] = Transmission(**transmission)
            return cls(**values)
        except (TypeError, AttributeError) as error:
            raise ValueError(f"invalid robot data: {error}; see Robot.to_dict() for the format") from error


def _freeze_fields(data: Motors | Transmission) -> None:
    """Converts lists and arrays to tuples, which keep a robot hashable."""
    for field in dataclasses.fields(data):
        object.__setattr__(data, field.name, _as_tuples(getattr(data, field.name)))


def _as_tuples(value: Any) -> Any:
    value = value.tolist() if isinstance(value, np.ndarray) else value
    return tuple(_as_tuples(item) for item in value) if isinstance(value, (list, tuple)) else value


def _frozen(values: Any) -> Array:
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


def _check_shapes(robot: Robot) -> None:
    points = robot.base_anchors
    if not isinstance(points, tuple) or {len(a) if isinstance(a, tuple) else 0 for a in points} not in ({2}, {3}):
        raise ValueError(
            "base_anchors must hold one (x, y) per cable for a planar robot or one (x, y, z) for a spatial robot"
        )
    m, n = robot.cables, robot.coordinates
    if robot.planar and (robot.platform_anchors or robot.inertia):
        raise ValueError("a planar robot is a point mass; leave platform_anchors and inertia empty")
    if robot.planar and m < n:
        raise ValueError(f"a planar robot needs at least {n} cables, not {m}; add base_anchors")
    if not robot.planar:
        if m != SPATIAL_COORDINATES:
            raise ValueError(f"a spatial robot must have six cables, not {m}; give six base_anchors")
        if len(robot.platform_anchors) != m or any(len(anchor) != 3 for anchor in robot.platform_anchors):
            raise ValueError(f"platform_anchors must hold one (x, y, z) for each of the {m} cables")
        if len(robot.inertia) != 3:
            raise ValueError("inertia must hold the three principal moments (I_xx, I_yy, I_zz) in kg·m²")
    if len(robot.home_pose) != n:
        raise ValueError(f"home_pose must hold {n} coordinates, not {len(robot.home_pose)}")
    if robot.workspace and (len(robot.workspace) != n or any(len(pair) != 2 for pair in robot.workspace)):
        raise ValueError(f"workspace must hold one (low, high) for each of the {n} coordinates, or be empty")


def _numbers(field: str, value: Any) -> Array:
    values = np.asarray(value)
    if values.dtype.kind not in "iuf":
        raise ValueError(f"{field} must be a number, not {value!r}")
    return values.astype(float)


def _check_values(robot: Robot) -> None:
    positive = {
        "mass": robot.mass,
        "inertia": robot.inertia,
        "motors.stall_torque": robot.motors.stall_torque,
        "motors.free_speed": robot.motors.free_speed,
        "transmission.pulley_radius": robot.transmission.pulley_radius,
    }
    not_negative = {
        "transmission.pulley_inertia": robot.transmission.pulley_inertia,
        "transmission.damping": robot.transmission.damping,
        "gravity": robot.gravity,
    }
    spring = {
        "transmission.stiffness": robot.transmission.stiffness,
        "transmission.motor_inertia": robot.transmission.motor_inertia,
    }
    given = {field: value for field, value in spring.items() if value is not None}
    not_negative["transmission.motor_damping"] = robot.transmission.motor_damping
    if len(given) == 1:
        raise ValueError("a flexible transmission needs both stiffness and motor_inertia; a rigid one needs neither")
    if not given and np.any(np.asarray(robot.transmission.motor_damping) != 0):
        raise ValueError("transmission.motor_damping requires a flexible transmission; use damping for a rigid one")
    positive |= given
    for field, value in (positive | not_negative).items():
        values = _numbers(field, value)
        if field in ("mass", "gravity") and values.shape != ():
            raise ValueError(f"{field} must be one number, not {value!r}")
        if field.startswith(("motors", "transmission")) and values.shape not in ((), (robot.cables,)):
            raise ValueError(f"{field} must be one number or one for each of the {robot.cables} motors")
        strict = field in positive
        if not np.all(np.isfinite(values)) or np.any(values <= 0 if strict else values < 0):
            raise ValueError(f"{field} must be {'greater than' if strict else 'at least'} 0 and finite, not {value}")
    if not np.all(np.isfinite(robot.speed_slope)):
        raise ValueError(f"motors.free_speed {robot.motors.free_speed} is too small: τ_s/ω_n is not finite")
    if not robot.planar:
        moments = sorted(robot.inertia)
        if moments[0] + moments[1] < moments[2] * (1 - 1e-9):
            raise ValueError(f"inertia {robot.inertia}: no principal moment may exceed the sum of the other two")
    for field, points in (
        ("base_anchors", robot.base),
        ("platform_anchors", robot.platform),
        ("home_pose", robot.home),
    ):
        if not np.all(np.isfinite(points)):
            raise ValueError(f"{field} must be finite")
    low, high = robot.pose_bounds
    if not robot.workspace and np.any(low[:2] >= high[:2]):
        raise ValueError("base_anchors must not lie on a line along an axis: no cable could pull across that line")
    if not np.all(np.isfinite(robot.pose_bounds)) or np.any(low >= high):
        raise ValueError("workspace must be finite and have low < high for each coordinate")
    if not robot.planar and max(abs(low[4]), abs(high[4])) >= math.pi / 2:
        raise ValueError("workspace: θ must stay within ± π/2, where the Euler angles are singular")
    ends = np.concatenate([robot.base, robot.platform], axis=1)
    for i in range(robot.cables):
        for j in range(i):
            if np.allclose(ends[i], ends[j], rtol=0, atol=1e-9):
                raise ValueError(f"cables {j + 1} and {i + 1} coincide; give them different anchors")


def _check_home(robot: Robot) -> None:
    low, high = robot.pose_bounds
    if np.any(robot.home < low) or np.any(robot.home > high):
        raise ValueError(f"home_pose {robot.home_pose} lies outside the workspace {low.tolist()} to {high.tolist()}")
    if np.any(cable_lengths(robot.base, robot.platform, robot.home) < 1e-6):
        raise ValueError("a cable has zero length at home_pose; move the pose away from its base anchor")
    jacobian = structure_jacobian(robot.base, robot.platform, robot.home)
    if np.linalg.matrix_rank(jacobian, tol=1e-9) < robot.coordinates or not _in_equilibrium(robot, jacobian):
        problem = "the cables do not surround" if robot.planar else "no positive tensions hold"
        raise ValueError(f"{robot.name}: {problem} home_pose {robot.home_pose}; move the pose or the anchors")


def _in_equilibrium(robot: Robot, jacobian: Array) -> bool:
    """Whether positive tensions balance gravity at rest for this S: ``−Sᵀ T = (0, 0, −m g, 0, 0, 0)``."""
    if robot.planar:  # no open half plane is free of cables
        angles = np.sort(np.arctan2(jacobian[:, 1], jacobian[:, 0]))
        gaps = np.diff(np.append(angles, angles[0] + 2 * math.pi))
        return bool(gaps.max() < math.pi - 1e-9)
    weight = np.zeros(SPATIAL_COORDINATES)
    weight[2] = robot.mass * robot.gravity
    return bool(np.linalg.solve(jacobian.T, weight).min() > 1e-9)


def _planar_paper() -> Robot:
    radius = 1 / math.sqrt(3)
    """Circumradius of the equilateral triangle of side 1 m (Table 2)."""
    return Robot(
        name="planar",
        base_anchors=tuple(
            (radius * math.cos(math.radians(angle)), radius * math.sin(math.radians(angle))) for angle in (210, 330, 90)
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
    a1, a2, a3 = (-a, -a / root, 0.0), (a, -a / root, 0.0), (0.0, 2 * a / root, 0.0)
    p1, p2, p3 = (0.0, -2 * b / root, 0.0), (-b, b / root, 0.0), (b, b / root, 0.0)
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
"""The planar robot with the joint springs of the spatial one; the paper has no flexible planar robot."""

FLEX_SPATIAL = _flexible_paper(SPATIAL)
"""The paper's spatial robot with joint springs (Tables 5 and 9)."""

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL)}
"""The paper's robots by name."""


def find_robot(robot: str | dict[str, Any] | Robot) -> Robot:
    """A robot from a name, from :meth:`Robot.to_dict` data, or from a :class:`Robot`.

    Raises:
        ValueError: if the name is unknown or the data do not describe a physical robot.
    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, dict):
        return Robot.from_dict(robot)
    if not isinstance(robot, str) or robot not in ROBOTS:
        raise unknown_name_error("robot", robot, ROBOTS, ", or pass a Robot")
    return ROBOTS[robot]
