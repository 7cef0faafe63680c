"""The robots as data: geometry, inertia, motors, transmission. Every value of the paper's robots names its table.

A robot of your own is another :class:`Robot`; what is not physical is refused when the object is made.
SI units and radians; motor speeds in rad/s.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np

from cablebot_gym.kinematics import SPATIAL_COORDINATES, Array, cable_lengths, structure_jacobian
from cablebot_gym.utils.suggestions import no_such

RPM = 2 * math.pi / 60
"""One revolution per minute in rad/s."""

STANDARD_GRAVITY = 9.81
"""Gravitational acceleration along +z [m/s²]."""

PerMotor = float | tuple[float, ...]

Cable = Literal["unilateral", "bilateral"]
"""Whether cables can only pull, or push too, as the paper's equations let them."""


@dataclass(frozen=True, kw_only=True)
class Motors:
    """Torque-speed lines ``U± = ±τ_s − (τ_s/ω_n)·speed`` (Eq. 37)."""

    stall_torque: PerMotor
    """τ_s [N·m], one value for all motors or one per motor; > 0."""
    free_speed: PerMotor
    """ω_n, free running speed [rad/s], one value or one per motor; > 0. Tables in rpm: multiply by :data:`RPM`."""

    def __post_init__(self) -> None:
        _freeze_fields(self)

    def replace(self, **changes: Any) -> Motors:
        """A copy with some fields changed, as ``changes`` say."""
        return dataclasses.replace(self, **changes)


@dataclass(frozen=True, kw_only=True)
class Transmission:
    """From motor to cable. Rigid: ``τ = r T + J β̈ + c β̇`` (Eq. 1). With a ``stiffness``, a spring between motor and
    pulley (Eq. 4): ``J′ β̈′ + c′ β̇′ + K (β′ − β) = τ`` and ``K (β′ − β) = r T + J β̈ + c β̇``."""

    pulley_radius: PerMotor
    """r [m], one value or one per motor; > 0."""
    pulley_inertia: PerMotor
    """J, pulley and motor together [kg·m²], one value or one per motor; ≥ 0."""
    damping: PerMotor = 0.0
    """c, viscous, at the pulley [N·m·s/rad], one value or one per motor; ≥ 0."""
    stiffness: PerMotor | None = None
    """K of the joint springs [N·m/rad], one value or one per motor; > 0. None: rigid, motor and pulley are one."""
    motor_inertia: PerMotor | None = None
    """J′ of the motor behind its spring [kg·m²], one value or one per motor; > 0. None where rigid."""
    motor_damping: PerMotor = 0.0
    """c′, viscous, at the motor behind its spring [N·m·s/rad], one value or one per motor; ≥ 0. 0 where rigid."""

    def __post_init__(self) -> None:
        _freeze_fields(self)

    def replace(self, **changes: Any) -> Transmission:
        """A copy with some fields changed, as ``changes`` say."""
        return dataclasses.replace(self, **changes)


class RobotArrays(Protocol):
    """What the equations read of a :class:`Robot`, or of N robots at once, whose values then have a leading axis N."""

    @property
    def planar(self) -> bool:
        """Whether it moves in the horizontal plane."""

    @property
    def flexible(self) -> bool:
        """Whether springs stand between motors and pulleys."""

    @property
    def cables(self) -> int:
        """m."""

    @property
    def coordinates(self) -> int:
        """n."""

    @property
    def home(self) -> Array:
        """X₀ (n,)."""

    @property
    def gravity(self) -> float:
        """Along +z [m/s²]."""

    @property
    def mass(self) -> float | Array:
        """Platform [kg]."""

    @property
    def inertia(self) -> tuple[float, ...] | Array:
        """Principal moments (3,) [kg·m²]."""

    @property
    def base(self) -> Array:
        """Base anchors (m, 2 or 3) [m]."""

    @property
    def platform(self) -> Array:
        """Platform anchors (m, 2 or 3) [m]."""

    @property
    def pulley_radius(self) -> Array:
        """r (m,)."""

    @property
    def pulley_inertia(self) -> Array:
        """J (m,)."""

    @property
    def damping(self) -> Array:
        """c (m,)."""

    @property
    def stiffness(self) -> Array:
        """K (m,)."""

    @property
    def motor_inertia(self) -> Array:
        """J′ (m,)."""

    @property
    def motor_damping(self) -> Array:
        """c′ (m,)."""

    @property
    def stall_torque(self) -> Array:
        """τ_s (m,)."""

    @property
    def speed_slope(self) -> Array:
        """τ_s/ω_n (m,)."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """One cable robot. Planar: a point mass in the horizontal plane, no gravity; spatial: a hanging rigid platform.

    The number of columns of ``base_anchors`` decides: 2 planar (n = 2 coordinates, m ≥ 3 cables), 3 spatial (n = 6,
    m = 6).

    Raises:
        ValueError: if a value is not physical, two cables coincide, or no positive tensions hold ``home_pose``.
    """

    name: str
    """Shown in tables and error messages."""
    base_anchors: tuple[tuple[float, ...], ...]
    """A_i in the base frame [m], shape (m, 2) or (m, 3); z points down."""
    mass: float
    """Platform mass without payload [kg]; > 0."""
    motors: Motors
    """Torque-speed lines."""
    transmission: Transmission
    """Pulleys."""
    home_pose: tuple[float, ...]
    """X₀ (n,), where all pulley angles β are zero."""
    platform_anchors: tuple[tuple[float, ...], ...] = ()
    """b_i in the platform frame [m], shape (m, 3); empty for a planar robot, whose cables meet in one point."""
    inertia: tuple[float, ...] = ()
    """Principal moments (I_xx, I_yy, I_zz) about the platform's axes [kg·m²]; empty for a planar robot."""
    gravity: float = STANDARD_GRAVITY
    """Along +z [m/s²]; has no effect on a planar robot."""
    workspace: tuple[tuple[float, float], ...] = ()
    """(low, high) for each coordinate; empty: the box of the base anchors, depth up to its diagonal, angles ± 1 rad."""

    def __post_init__(self) -> None:
        for name in ("base_anchors", "platform_anchors", "inertia", "home_pose", "workspace"):
            object.__setattr__(self, name, _as_tuples(getattr(self, name)))  # lists and arrays will do
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
        """Home pose as an array, shape (n,)."""
        return _frozen(self.home_pose)

    @cached_property
    def pose_bounds(self) -> Array:
        """Workspace as an array, shape (2, n): lowest and highest pose."""
        if self.workspace:
            return _frozen(np.transpose(self.workspace))
        low, high = self.base.min(axis=0), self.base.max(axis=0)
        if self.planar:
            return _frozen([low, high])
        depth = float(np.linalg.norm(high[:2] - low[:2]))
        return _frozen([[*low[:2], high[2], -1.0, -1.0, -1.0], [*high[:2], high[2] + depth, 1.0, 1.0, 1.0]])

    def per_motor(self, value: PerMotor) -> Array:
        """A motor or transmission value as an array, shape (m,)."""
        return np.broadcast_to(np.asarray(value, float), (self.cables,))

    @cached_property
    def pulley_radius(self) -> Array:
        """r, shape (m,)."""
        return self.per_motor(self.transmission.pulley_radius)

    @cached_property
    def pulley_inertia(self) -> Array:
        """J, shape (m,)."""
        return self.per_motor(self.transmission.pulley_inertia)

    @cached_property
    def damping(self) -> Array:
        """c, shape (m,)."""
        return self.per_motor(self.transmission.damping)

    @property
    def flexible(self) -> bool:
        """Whether springs stand between motors and pulleys."""
        return self.transmission.stiffness is not None

    @property
    def joints(self) -> Literal["rigid", "flexible"]:
        """The same as a word, which tables of settings have for a key."""
        return "flexible" if self.flexible else "rigid"

    @cached_property
    def stiffness(self) -> Array:
        """K of a flexible robot, shape (m,)."""
        return self.per_motor(self._flexible("stiffness"))

    @cached_property
    def motor_inertia(self) -> Array:
        """J′ of a flexible robot, shape (m,)."""
        return self.per_motor(self._flexible("motor_inertia"))

    @cached_property
    def motor_damping(self) -> Array:
        """c′ of a flexible robot, shape (m,)."""
        return self.per_motor(self._flexible("motor_damping"))

    def _flexible(self, field: str) -> PerMotor:
        if not self.flexible:
            raise ValueError(f"{self.name} has a rigid transmission and no {field}")
        value: PerMotor = getattr(self.transmission, field)
        return value

    @cached_property
    def stall_torque(self) -> Array:
        """τ_s, shape (m,)."""
        return self.per_motor(self.motors.stall_torque)

    @cached_property
    def speed_slope(self) -> Array:
        """τ_s/ω_n, the paper's k₂ (Eq. 37), shape (m,) [N·m·s/rad]."""
        return self.stall_torque / self.per_motor(self.motors.free_speed)

    def replace(self, **changes: Any) -> Robot:
        """A copy with some fields changed, as ``changes`` say, checked anew."""
        return dataclasses.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON-able data; :meth:`from_dict` reads it."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Robot:
        """A robot from :meth:`to_dict`'s data, lists in place of tuples allowed.

        Raises:
            ValueError: if a key is unknown or missing, or the robot is not physical.
        """
        fields = dataclasses.fields(cls)
        known = {field.name for field in fields}
        if unknown := set(data) - known:
            raise ValueError(f"unknown robot field {sorted(unknown)[0]!r}; the fields are {', '.join(sorted(known))}")
        needed = [field.name for field in fields if field.default is field.default_factory is dataclasses.MISSING]
        if missing := [name for name in needed if name not in data]:
            raise ValueError(f"a robot needs the field {missing[0]!r}; see Robot.to_dict() for the form")
        try:
            values = {key: _as_tuples(value) for key, value in data.items()}
            values["motors"] = Motors(**{key: _as_tuples(value) for key, value in data["motors"].items()})
            transmission = {key: _as_tuples(value) for key, value in data["transmission"].items()}
            values["transmission"] = Transmission(**transmission)
            return cls(**values)
        except (TypeError, AttributeError) as error:
            raise ValueError(f"this is no robot: {error}; see Robot.to_dict() for the form") from error


def _freeze_fields(data: Motors | Transmission) -> None:
    """Lists and arrays will do, and a robot stays hashable."""
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
            "base_anchors must hold one (x, y) per cable for a planar robot or one (x, y, z) for a spatial"
        )
    m, n = robot.cables, robot.coordinates
    if robot.planar and (robot.platform_anchors or robot.inertia):
        raise ValueError("a planar robot is a point mass: leave platform_anchors and inertia empty")
    if robot.planar and m < n:
        raise ValueError(f"a planar robot needs at least {n} cables, not {m}: add base_anchors")
    if not robot.planar:
        if m != SPATIAL_COORDINATES:
            raise ValueError(f"a spatial robot has six cables here, not {m}: give six base_anchors")
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
        raise ValueError("a flexible transmission needs both stiffness and motor_inertia; a rigid one has neither")
    if not given and np.any(np.asarray(robot.transmission.motor_damping) != 0):
        raise ValueError("transmission.motor_damping belongs to a flexible transmission: a rigid one has damping")
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
            raise ValueError(f"inertia {robot.inertia}: no body has one principal moment above the sum of the others")
    for field, points in (
        ("base_anchors", robot.base),
        ("platform_anchors", robot.platform),
        ("home_pose", robot.home),
    ):
        if not np.all(np.isfinite(points)):
            raise ValueError(f"{field} must be finite")
    low, high = robot.pose_bounds
    if not robot.workspace and np.any(low[:2] >= high[:2]):
        raise ValueError("base_anchors must not stand on one line along an axis: no motor pulls across it")
    if not np.all(np.isfinite(robot.pose_bounds)) or np.any(low >= high):
        raise ValueError("workspace must have low < high and be finite for each coordinate")
    if not robot.planar and max(abs(low[4]), abs(high[4])) >= math.pi / 2:
        raise ValueError("workspace: θ must stay within ± π/2, where the Euler angles are singular")
    ends = np.concatenate([robot.base, robot.platform], axis=1)
    for i in range(robot.cables):
        for j in range(i):
            if np.allclose(ends[i], ends[j], rtol=0, atol=1e-9):
                raise ValueError(f"cables {j + 1} and {i + 1} coincide: give them different anchors")


def _check_home(robot: Robot) -> None:
    low, high = robot.pose_bounds
    if np.any(robot.home < low) or np.any(robot.home > high):
        raise ValueError(f"home_pose {robot.home_pose} lies outside the workspace {low.tolist()} to {high.tolist()}")
    if np.any(cable_lengths(robot.base, robot.platform, robot.home) < 1e-6):
        raise ValueError("a cable has no length at home_pose: move the pose off its base anchor")
    jacobian = structure_jacobian(robot.base, robot.platform, robot.home)
    if np.linalg.matrix_rank(jacobian, tol=1e-9) < robot.coordinates or not _positively_held(robot, jacobian):
        why = "the cables do not surround" if robot.planar else "no positive tensions hold"
        raise ValueError(f"{robot.name}: {why} home_pose {robot.home_pose}; move it or the anchors")


def _positively_held(robot: Robot, jacobian: Array) -> bool:
    """Whether positive tensions balance gravity at rest with this S: ``−Sᵀ T = (0, 0, −m g, 0, 0, 0)``."""
    if robot.planar:  # the cables' directions leave no half plane free
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
            damping=0.0,  # not given for the planar robot
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
        mass=10.0,  # Table 8 (Table 4 has 11, with 1 kg of load)
        inertia=(0.58, 0.58, 1.16),  # Table 4
        motors=Motors(stall_torque=10.0, free_speed=1000 * RPM),  # Table 8
        transmission=Transmission(
            pulley_radius=0.05,  # Table 4
            pulley_inertia=8e-4,  # Table 4
            damping=0.01,  # Table 4, whose unit has to be N·m·s/rad
        ),
        home_pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
    )


def _flexible_paper(rigid: Robot) -> Robot:
    transmission = Transmission(
        pulley_radius=rigid.transmission.pulley_radius,  # Table 5
        pulley_inertia=4e-4,  # Table 5
        stiffness=3.0,  # §5.2.3 (Table 5 has 2); ours for the planar robot
        motor_inertia=4e-4,  # Table 5
    )  # Eq. 4 has no damping
    return rigid.replace(name=f"flex-{rigid.name}", transmission=transmission)


PLANAR = _planar_paper()
"""The paper's planar robot: three cables, point mass (Tables 2 and 7)."""

SPATIAL = _spatial_paper()
"""The paper's spatial robot: six cables, triangular platform (Tables 4 and 8)."""

FLEX_PLANAR = _flexible_paper(PLANAR)
"""The planar robot with joint springs; the paper has none, the springs are those of its spatial robot."""

FLEX_SPATIAL = _flexible_paper(SPATIAL)
"""The paper's spatial robot with joint springs (Tables 5 and 9)."""

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL)}
"""The paper's robots by name."""


def find_robot(robot: str | dict[str, Any] | Robot) -> Robot:
    """A robot from its name, its :meth:`Robot.to_dict` data or itself.

    Raises:
        ValueError: if the name is unknown or the data are not a physical robot.
    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, dict):
        return Robot.from_dict(robot)
    if not isinstance(robot, str) or robot not in ROBOTS:
        raise ValueError(no_such("robot", robot, ROBOTS, ", or pass a Robot"))
    return ROBOTS[robot]
