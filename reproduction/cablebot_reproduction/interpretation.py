"""Interpretation of the paper: the choices that the paper leaves open. All figures and numbers
depend on them.

The defaults are the choices that this project considers correct. They are not fitted to the
published numbers.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args, get_type_hints

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL, Robot
from cablebot_gym.utils import checks
from cablebot_reproduction.published import published_value

Source = Literal["control", "payload"]
"""Section that supplies a value if the sections differ: ``control`` is §4 (Tables 2, 4 and 5),
``payload`` is §5.2 (Tables 7 to 9 and the text of §5.2.3)."""

AS_PRINTED: dict[str, dict[Source, float]] = {
    "platform_mass": {
        "control": published_value("table4.m"),
        "payload": published_value("table8.m"),
    },
    "stiffness": {"control": published_value("table5.K"), "payload": published_value("5.2.3.K")},
}
"""Values of "as-printed" by section."""

_HALF_SIDE_OF_CIRCUMRADIUS = math.sqrt(3) / 2
_ALIGNED_RING = (0, 0, 1, 1, 2, 2)
_FLAT = 1e9
"""Free speed of a flat torque-speed line [rad/s]; the value must be finite."""


class NoEquilibriumError(ValueError):
    """The robot of the interpretation has no equilibrium with positive tensions."""


@dataclass(frozen=True, kw_only=True)
class Interpretation:
    """A set of choices for all points that the paper leaves open.

    Raises:
        ValueError: if a value is not among its choices.
    """

    payload: Literal["added", "total"] = "added"
    """Meaning of "load capacity": the mass added to the platform, or the total mass of platform and
    load."""
    line: Literal["physical", "pulley", "flat", "cable", "reversed"] = "physical"
    """q̇ of U± = ±k₁ − k₂ q̇ (Eq. 37).

    * ``physical``: motor speed in rad/s.
    * ``pulley``: pulley speed in rad/s, which differs from the motor speed with joint springs.
    * ``flat``: no dependence on speed.
    * ``cable``: rate of the cable length in m/s, the meaning of q elsewhere in the paper.
    * ``reversed``: motor speed in rad/s, positive when unwinding.
    """
    platform_mass: Literal["as-printed", "10", "11"] = "as-printed"
    """Platform mass of the spatial robot [kg]. The paper prints 11 in Tables 4 and 5 and 10 in
    Table 8."""
    triangles: Literal["inverted", "turned", "aligned"] = "inverted"
    """Orientation of the platform triangle and the base triangle.

    * ``inverted``: the third corner of the base is on +y, and the platform triangle points in the
      opposite direction.
    * ``turned``: the same with both triangles rotated by 180° about z.
    * ``aligned``: both triangles point in the same direction.
    """
    sides: Literal["half-side", "circumradius"] = "half-side"
    """Meaning of a and b in Table 4, "half of the triangle"."""
    pulleys: Literal["table4", "table5"] = "table4"
    """Source of J and c of the rigid spatial robot. The pulleys of Table 5 (robot with joint
    springs) have half the inertia and no damping."""
    planar_apex: Literal["up", "left", "down", "right"] = "up"
    """Position of the third motor of the planar robot. The path starts on the right and goes up."""
    stiffness: Literal["as-printed", "2", "3"] = "as-printed"
    """Joint stiffness K [N·m/rad]. The paper prints 2 in Table 5 and 3 in §5.2.3."""
    minimum_tension: float = textbook.MINIMUM_TENSION
    """Lower tension bound T_min of the planar robot [N]. The paper only requires positive
    tensions."""
    alpha: Literal["least", "constant"] = "least"
    """α of Eq. 11: the smallest value at each instant that keeps T_min (``least``), or the smallest
    constant that keeps T_min at all instants (``constant``)."""
    eq24: Literal["corrected", "verbatim"] = "corrected"
    """Divisor of Eqs. 24 and 25 for the motion of the motors behind their springs: J′, as the units
    require, or "1 + J′" as printed. On a physical robot neither form is consistent with Eq. 22."""
    eq37: Literal["corrected", "literal"] = "corrected"
    """Form of the load coefficient in Eqs. 37–39."""

    def __post_init__(self) -> None:
        for name, choices in choices_of().items():
            checks.choice(name.replace("_", " "), getattr(self, name), choices)
        checks.number("minimum_tension", self.minimum_tension, least=0.0, unit="N")

    def replace(self, **changes: Any) -> Interpretation:
        """A copy with changed choices."""
        return replace(self, **changes)

    def changed(self) -> dict[str, Any]:
        """Choices that differ from the default, by option name."""
        default = asdict(Interpretation())
        return {name: value for name, value in asdict(self).items() if value != default[name]}

    def text(self) -> str:
        """Choices that differ from the default as ``name = value``, or "default"."""
        return ", ".join(f"{name} = {value}" for name, value in self.changed().items()) or "default"

    @property
    def planar(self) -> Robot:
        """The planar robot (Tables 2 and 7)."""
        if self.planar_apex == "up":
            return PLANAR
        base = PLANAR.base
        for _ in range(("up", "left", "down", "right").index(self.planar_apex)):
            base = np.stack([-base[:, 1], base[:, 0]], axis=1)  # rotation by 90°
        return PLANAR.replace(base_anchors=base)

    def spatial(self, source: Source) -> Robot:
        """The rigid spatial robot (Tables 4 and 8).

        Raises:
            NoEquilibriumError: if the home pose has no equilibrium with positive tensions.
        """
        robot = self._read(SPATIAL, source)
        if self.pulleys == "table4":
            return robot
        pulleys = FLEX_SPATIAL.transmission
        transmission = robot.transmission.replace(
            pulley_inertia=pulleys.pulley_inertia, damping=pulleys.damping
        )
        return robot.replace(transmission=transmission)

    def flexible(self, source: Source) -> Robot:
        """The spatial robot with joint springs (Tables 5 and 9).

        Raises:
            NoEquilibriumError: if the home pose has no equilibrium with positive tensions.
        """
        robot = self._read(FLEX_SPATIAL, source)
        stiffness = self._value("stiffness", source)
        return robot.replace(transmission=robot.transmission.replace(stiffness=stiffness))

    def _read(self, robot: Robot, source: Source) -> Robot:
        scale = 1.0
        if self.sides == "circumradius":
            scale = _HALF_SIDE_OF_CIRCUMRADIUS
        base, platform = robot.base, robot.platform
        if self.triangles == "turned":
            base, platform = -base, -platform
        if self.triangles == "aligned":
            # Same cable order; the platform corners are below those of the base.
            platform = -np.roll(platform[::2], 1, axis=0)[list(_ALIGNED_RING)]
        try:
            return robot.replace(
                mass=self._value("platform_mass", source),
                base_anchors=scale * base,
                platform_anchors=scale * platform,
            )
        except ValueError as error:
            raise NoEquilibriumError(
                f"the robot with triangles {self.triangles} has no equilibrium with positive tensions; "
                "use inverted or turned"
            ) from error

    def _value(self, name: str, source: Source) -> float:
        choice = getattr(self, name)
        if choice == "as-printed":
            return AS_PRINTED[name][source]
        return float(choice)

    def line_speed(self, robot: Robot) -> Array:
        """Factor of the pulley speed β̇ in the torque-speed line, shape (m,)."""
        if self.line == "cable":
            return -robot.pulley_radius
        factors = {"physical": 1.0, "pulley": 1.0, "flat": 0.0, "reversed": -1.0}
        return np.full(robot.cables, factors[self.line])

    @property
    def closed_loop_possible(self) -> bool:
        """Whether a motor of a rigid robot can have this torque-speed line. Closed loops require
        such a motor."""
        # The pulley of a rigid robot turns with its motor.
        return self.flexible_loop_possible or self.line == "pulley"

    @property
    def flexible_loop_possible(self) -> bool:
        """Whether a motor of a robot with joint springs can have this torque-speed line."""
        return self.line in ("physical", "flat")

    def closed_loop_robot(self, robot: Robot) -> Robot:
        """Robot for closed loops: with this torque-speed line if a motor can have it, otherwise
        unchanged."""
        if self.line == "flat":
            return robot.replace(motors=robot.motors.replace(free_speed=_FLAT))
        return robot

    def counted(self, robot: Robot, added: float) -> float:
        """Payload by the definition of this interpretation [kg]."""
        if self.payload == "total":
            return added + robot.mass
        return added


def choices_of() -> dict[str, tuple[str, ...]]:
    """Valid choices by option name, for all options with a fixed set of choices."""
    hints = get_type_hints(Interpretation)
    return {name: get_args(hint) for name, hint in hints.items() if get_args(hint)}
