"""Parts of a robot: motors, transmission and defaults; kinds of robots."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cablebot_gym.utils.checks import mapping, number, numbers

RPM = 2 * math.pi / 60
"""One revolution per minute in rad/s."""

GRAVITY = 9.81
"""Gravitational acceleration along +z [m/s²], the value of the paper and of most robots here."""
FREQUENCY = 500.0
"""Usual number of actions per second [Hz]."""

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


KIND_TEXTS: dict[Kind, str] = {
    "planar": "a point mass in a plane",
    "planar-platform": "a platform in a plane",
    "point": "a point mass in space",
    "spatial": "a platform in space",
}
"""Kinds as text."""

COORDINATE_NAMES: dict[Kind, str] = {
    "planar": "xy",
    "planar-platform": "xyφ",
    "point": "xyz",
    "spatial": "xyzψθφ",
}
"""Symbols of the coordinates of a pose by kind."""


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
    strain, see :func:`~cablebot_gym.physics.textbook.drives.cable_springs`. J includes the motor and
    τ acts on it: ``J β̈ + c β̇ = τ − r T``. A joint spring in series with such a cable is
    ``extra_length`` of it, EA r²/K.
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
    see :func:`~cablebot_gym.physics.textbook.drives.coulomb_torque`. The paper has no Coulomb friction.
    """
    load_friction: PerMotor = 0.0
    """Friction per load μ at the motors, one value or one per motor; ≥ 0 and below 1: bearings, and
    pulleys that guide the cables.

    Beside τ_c, it takes μ times the load from the motor: r T of a rigid transmission, else the
    torque of the spring. The paper has none.
    """
    friction_speed: float = 0.5
    """Motor speed ω₀ below which both frictions are smoothed [rad/s]; > 0. They have 99 % of their
    size above 7 ω₀: choose a value that is small against the speeds of the motions. Smaller values
    need shorter physics steps."""
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
        number("friction_speed", self.friction_speed, above=0, unit="rad/s")
        if np.max(self.load_friction) >= 1:
            raise ValueError(
                "load_friction must be below 1: it is the fraction of the load that friction takes"
            )
        if (self.stiffness is None) != (self.motor_inertia is None):
            raise ValueError(
                "a flexible transmission needs stiffness and motor_inertia; a rigid one has neither"
            )
        if self.stiffness is None and np.any(self.motor_damping):
            raise ValueError("a rigid transmission has no motor_damping; use damping")
        if self.axial_stiffness is None:
            if np.any(self.axial_damping) or np.any(self.extra_length):
                raise ValueError(
                    "axial_damping and extra_length are for elastic cables: set axial_stiffness, or remove them"
                )
        elif self.stiffness is not None:
            raise ValueError(
                "joint springs and elastic cables exclude each other: remove stiffness and motor_inertia, and add "
                "axial_stiffness × pulley_radius² / stiffness to extra_length"
            )
        elif np.min(self.pulley_inertia) <= 0:
            raise ValueError(
                "pulley_inertia must be greater than 0 with elastic cables: include the motor's inertia"
            )

    def replace(self, **changes: Any) -> Transmission:
        """A copy with the fields in ``changes`` replaced."""
        return dataclasses.replace(self, **changes)


def _set_per_motor(data: Motors | Transmission, positive: tuple[str, ...]) -> None:
    """Checks all fields and converts lists and arrays to tuples, which keep a robot hashable."""
    for field in dataclasses.fields(data):
        value = as_tuples(getattr(data, field.name))
        if value is not None or field.default is not None:
            above = 0.0 if field.name in positive else -math.inf
            numbers(field.name, value, form="one number or one per motor", above=above, least=0.0)
        object.__setattr__(data, field.name, value)


def as_tuples(value: Any) -> Any:
    """Lists and arrays as tuples, at any depth; other values unchanged."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return tuple(map(as_tuples, value))
    return value


@dataclass(frozen=True, kw_only=True)
class Defaults:
    """Defaults of the environments and evaluations of a robot. None and omitted keys stand for the
    usual defaults."""

    control_frequency: float = FREQUENCY
    """Actions per second [Hz]; > 0."""

    trajectory: str | Mapping[str, Any] | None = None
    """Reference motion, as for :func:`~cablebot_gym.motions.names.find_trajectory`."""
    error_bounds: Mapping[str, float] | None = None
    """Bounds of the tracking error: ``position`` [m] and ``rotation`` [rad]."""
    payload_range: tuple[float, float] | None = None
    """(low, high), the payloads that the robot is used with [kg]; ≥ 0. Scans end at ``high``. The
    commands that run an episode with one payload use ``low`` if none is given."""

    def __post_init__(self) -> None:
        number("control_frequency", self.control_frequency, above=0, unit="Hz")
        mapping("error_bounds", self.error_bounds or {}, ("position", "rotation"))
        if self.payload_range is not None:
            payloads = numbers(
                "payload_range", self.payload_range, shapes=[(2,)], form="(low, high)", least=0
            )
            low, high = payloads.tolist()
            number("payload_range", high, above=low, unit="kg")
            object.__setattr__(self, "payload_range", (low, high))

    def payload(self, payload: float | None = None) -> float:
        """Payload of an episode [kg]; without one the least of the range, and without a range 0."""
        if payload is not None:
            return payload
        return (self.payload_range or (0.0,))[0]
