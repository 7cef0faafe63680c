"""What the paper leaves open, as parameters: each is a way to read it, and every figure and number follows from them.

The defaults are the readings that this project holds for right, not those that come closest to a published number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args, get_type_hints

import numpy as np

from cablebot_baselines.paper.published import published_value
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL, Robot

Source = Literal["control", "payload"]
"""Which section's values hold where sections differ: ``control`` §4 (Tables 2, 4 and 5), ``payload`` §5.2 (Tables 7 to
9 and the text of §5.2.3)."""

AS_PRINTED: dict[str, dict[Source, float]] = {
    "platform_mass": {"control": published_value("table4.m"), "payload": published_value("table8.m")},
    "stiffness": {"control": published_value("table5.K"), "payload": published_value("5.2.3.K")},
}
"""What "as printed" is where sections differ."""

_HALF_SIDE_OF_CIRCUMRADIUS = math.sqrt(3) / 2
_ALIGNED_RING = (0, 0, 1, 1, 2, 2)
_FLAT = 1e9
"""Free speed that makes a torque-speed line flat [rad/s]; it must be finite."""


class NoRobot(ValueError):
    """No positive tensions hold the robot as it was read."""


@dataclass(frozen=True, kw_only=True)
class Readings:
    """One way to read the paper.

    Raises:
        ValueError: if a value is not one of its choices.
    """

    payload: Literal["added", "total"] = "added"
    """What "load capacity" counts: kilograms added to the platform, or platform and load together."""
    line: Literal["physical", "pulley", "flat", "cable", "reversed"] = "physical"
    """q̇ of U± = ±k₁ − k₂ q̇ (Eq. 37): the motor's own speed in rad/s (``physical``); with joint springs that of the
    ``pulley``; none (``flat``); the rate of the cable's length in m/s (``cable``), which is what q is elsewhere in the
    paper; or the motor's speed counted positive when unwinding (``reversed``)."""
    platform_mass: Literal["as-printed", "10", "11"] = "as-printed"
    """[kg]. As printed it is 11 in Tables 4 and 5 and 10 in Table 8."""
    triangles: Literal["inverted", "turned", "aligned"] = "inverted"
    """The platform's triangle points away from the base's, whose third corner is on +y (``inverted``); the same with
    both turned by half a turn about z (``turned``); or both point the same way (``aligned``)."""
    sides: Literal["half-side", "circumradius"] = "half-side"
    """What a and b of Table 4, "half of the triangle", measure."""
    pulleys: Literal["table4", "table5"] = "table4"
    """J and c of the rigid spatial robot: those of Table 4, or those of the robot with joint springs, whose pulleys
    alone have half the inertia and no damping (Table 5)."""
    planar_apex: Literal["up", "left", "down", "right"] = "up"
    """Where the third motor of the planar robot stands; the path starts on the right and goes up."""
    stiffness: Literal["as-printed", "2", "3"] = "as-printed"
    """K [N·m/rad]. As printed it is 2 in Table 5 and 3 in §5.2.3."""
    minimum_tension: float = textbook.MINIMUM_TENSION
    """T_min that the planar cables keep [N]; the paper asks for "positive"."""
    alpha: Literal["least", "constant"] = "least"
    """α of Eq. 11: at each instant the least that keeps T_min, or the least constant that keeps it all the way."""
    eq24: Literal["corrected", "verbatim"] = "corrected"
    """Divisor of Eqs. 24 and 25, by which §3.3 moves the motors behind their springs: J′, which the units ask for, or
    "1 + J′" as printed. Neither goes with Eq. 22 on a robot."""
    eq37: Literal["corrected", "literal"] = "corrected"
    """The load coefficient of Eqs. 37–39."""

    def __post_init__(self) -> None:
        for name, choices in choices_of().items():
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} must be one of {', '.join(choices)}, not {getattr(self, name)!r}")
        if not 0 <= self.minimum_tension < math.inf:
            raise ValueError(f"minimum_tension must be at least 0 N, not {self.minimum_tension}")

    def replace(self, **changes: Any) -> Readings:
        """A copy with some readings changed."""
        return Readings(**{field.name: getattr(self, field.name) for field in fields(self)} | changes)

    def words(self) -> str:
        """The readings that are not the default, ``name = value``, or "default"."""
        default = Readings()
        changed = [field.name for field in fields(self) if getattr(self, field.name) != getattr(default, field.name)]
        return ", ".join(f"{name} = {getattr(self, name)}" for name in changed) or "default"

    @property
    def planar(self) -> Robot:
        """The planar robot (Tables 2 and 7)."""
        quarters = ("up", "left", "down", "right").index(self.planar_apex)
        base = PLANAR.base
        for _ in range(quarters):
            base = np.stack([-base[:, 1], base[:, 0]], axis=1)
        return PLANAR if quarters == 0 else PLANAR.replace(base_anchors=base)

    def spatial(self, source: Source) -> Robot:
        """The rigid spatial robot (Tables 4 and 8).

        Raises:
            NoRobot: if no positive tensions hold it in its home pose.
        """
        robot = self._read(SPATIAL, source)
        if self.pulleys == "table4":
            return robot
        pulleys = FLEX_SPATIAL.transmission
        changed = robot.transmission.replace(pulley_inertia=pulleys.pulley_inertia, damping=pulleys.damping)
        return robot.replace(transmission=changed)

    def flexible(self, source: Source) -> Robot:
        """The spatial robot with joint springs (Tables 5 and 9).

        Raises:
            NoRobot: if no positive tensions hold it in its home pose.
        """
        robot = self._read(FLEX_SPATIAL, source)
        stiffness = self._value("stiffness", source)
        return robot.replace(transmission=robot.transmission.replace(stiffness=stiffness))

    def _read(self, robot: Robot, source: Source) -> Robot:
        scale = _HALF_SIDE_OF_CIRCUMRADIUS if self.sides == "circumradius" else 1.0
        base, platform = robot.base, robot.platform
        if self.triangles == "turned":
            base, platform = -base, -platform
        if self.triangles == "aligned":  # the same ring of six about corners that lie below those of the base
            platform = -np.roll(platform[::2], 1, axis=0)[list(_ALIGNED_RING)]
        try:
            return robot.replace(
                mass=self._value("platform_mass", source),
                base_anchors=scale * base,
                platform_anchors=scale * platform,
            )
        except ValueError as error:
            raise NoRobot(
                f"no positive tensions hold the robot with triangles {self.triangles}: choose inverted or turned"
            ) from error

    def _value(self, name: str, source: Source) -> float:
        choice = getattr(self, name)
        return AS_PRINTED[name][source] if choice == "as-printed" else float(choice)

    def line_speed(self, robot: Robot) -> Array:
        """What the torque-speed line takes for the speed, as a multiple of the pulley's β̇, (m,)."""
        scale = {"physical": 1.0, "pulley": 1.0, "flat": 0.0, "reversed": -1.0}
        return -robot.pulley_radius if self.line == "cable" else np.full(robot.cables, scale[self.line])

    @property
    def plays(self) -> bool:
        """Whether motors of a rigid robot can have this torque-speed line, so that closed loops can be run with it."""
        return self.springs_play or self.line == "pulley"  # which turns as its motor does

    @property
    def springs_play(self) -> bool:
        """The same with joint springs."""
        return self.line in ("physical", "flat")

    def motors(self, robot: Robot) -> Robot:
        """The robot with this reading's torque-speed line in its motors.

        Raises:
            ValueError: if no motor has such a line.
        """
        if not (self.springs_play if robot.flexible else self.plays):
            raise ValueError(
                f"no motor has the line {self.line!r}, so that no loop can be run with it: choose flat or physical"
            )
        return robot.replace(motors=robot.motors.replace(free_speed=_FLAT)) if self.line == "flat" else robot

    def moved(self, robot: Robot) -> Robot:
        """The robot of a closed loop: with this torque-speed line if motors can have it, else as it is."""
        return self.motors(robot) if (self.springs_play if robot.flexible else self.plays) else robot

    def counted(self, robot: Robot, added: float) -> float:
        """A payload [kg] as this reading counts it."""
        return added + (robot.mass if self.payload == "total" else 0.0)


def choices_of() -> dict[str, tuple[str, ...]]:
    """The readings that have choices, and these."""
    hints = get_type_hints(Readings)
    return {name: get_args(hint) for name, hint in hints.items() if get_args(hint)}
