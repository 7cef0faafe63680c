"""The paper's robots, and the choices that the paper leaves open about them.

The defaults are the choices that this project considers correct. They are not fitted to the
published numbers.
"""

from __future__ import annotations

import math

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory, find_trajectory
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL, Robot

TRIANGLES = ("inverted", "turned", "aligned")
"""Platform triangle against the base triangle: opposite, opposite and both turned by 180°, or
alike. The last one has no equilibrium with positive tensions."""

SIDES = {"half-side": 1.0, "circumradius": math.sqrt(3) / 2}
"""Meaning of a and b in Table 4, "half of the triangle", and the size that follows from it."""

PULLEYS = ("table4", "table5")
"""Table with J and c of the rigid spatial robot. Table 5 has half the inertia and no damping."""

APEXES = ("up", "left", "down", "right")
"""Position of the third motor of the planar robot."""

LINES = {"physical": 1.0, "pulley": 1.0, "flat": 0.0, "cable": -1.0, "reversed": -1.0}
"""q̇ of U± = ±k₁ − k₂ q̇ (Eq. 37), with the sign of its effect: motor speed, speed of the pulley (which differs
with joint springs), no effect of speed, rate of the cable length in m/s, motor speed when unwinding."""

_ALIGNED_CORNERS = [0, 0, 1, 1, 2, 2]
_NO_SPEED_LIMIT = 1e9
"""Free speed of a motor whose torque limits do not depend on speed [rad/s]; it must be finite."""


def spatial_robot(
    *,
    triangles: str = "inverted",
    sides: str = "half-side",
    pulleys: str = "table4",
    mass: float = 10.0,
) -> Robot:
    """The rigid spatial robot; 11 kg in Table 4, 10 kg in Table 8.

    Raises:
        ValueError: if the home pose has no equilibrium with positive tensions.
    """
    base, platform = SPATIAL.base, SPATIAL.platform
    if triangles == "turned":
        base, platform = -base, -platform
    if triangles == "aligned":
        # The cables keep their order; the corners of the platform are below those of the base.
        platform = -np.roll(platform[::2], 1, axis=0)[_ALIGNED_CORNERS]
    transmission = SPATIAL.transmission
    if pulleys == "table5":
        lighter = FLEX_SPATIAL.transmission
        transmission = transmission.replace(
            pulley_inertia=lighter.pulley_inertia, damping=lighter.damping
        )
    return SPATIAL.replace(
        mass=mass,
        base_anchors=SIDES[sides] * base,
        platform_anchors=SIDES[sides] * platform,
        transmission=transmission,
    )


def planar_robot(apex: str = "up") -> Robot:
    """The planar robot (Tables 2 and 7)."""
    base = PLANAR.base
    for _ in range(APEXES.index(apex)):
        base = np.stack([-base[:, 1], base[:, 0]], axis=1)  # a rotation by 90°
    return PLANAR.replace(base_anchors=base)


def flexible_robot(
    *, mass: float = 10.0, stiffness: float = 3.0, motor_damping: float = 0.0
) -> Robot:
    """The spatial robot with joint springs; 11 kg and K = 2 in Table 5, 10 kg and K = 3 N·m/rad in
    §5.2.3."""
    springs = FLEX_SPATIAL.transmission.replace(stiffness=stiffness, motor_damping=motor_damping)
    return FLEX_SPATIAL.replace(mass=mass, transmission=springs)


RIGID_OF_4 = spatial_robot(mass=11.0)
FLEXIBLE_OF_4 = flexible_robot(mass=11.0, stiffness=2.0)
"""Robots of §4; those of §5.2 are :func:`spatial_robot` and :func:`flexible_robot`."""


def paper_circle(robot: Robot) -> Trajectory:
    """Circle of the paper for a robot (Tables 1 and 3), without dwells."""
    name = "paper-spatial"
    if robot.planar:
        name = "paper-planar"
    return find_trajectory(name, robot.coordinates)


def line_speed(line: str, robot: Robot) -> Array:
    """Factor of the pulley speed β̇ in the torque-speed line, shape (m,)."""
    factor = LINES[line]
    if line == "cable":
        return factor * robot.pulley_radius
    return np.full(robot.cables, factor)


def without_speed_limit(robot: Robot) -> Robot:
    """The robot with torque limits that do not depend on speed."""
    return robot.replace(motors=robot.motors.replace(free_speed=_NO_SPEED_LIMIT))
