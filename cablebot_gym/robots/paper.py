"""The paper's robots, with the table of each value."""

from __future__ import annotations

import math
from copy import deepcopy

import numpy as np

from cablebot_gym.robots.parts import RPM, Motors, Transmission
from cablebot_gym.robots.record import Robot


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
    # Eq. 4 has no damping
    transmission = Transmission(
        pulley_radius=rigid.transmission.pulley_radius,  # Table 5
        pulley_inertia=4e-4,  # Table 5
        stiffness=3.0,  # §5.2.3 (Table 5: 2); not in the paper for the planar robot
        motor_inertia=4e-4,  # Table 5
    )
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


_UNCHANGED = deepcopy((PLANAR, SPATIAL))
"""Copies that no policy in the process reaches by a public name."""


def _is_paper_robot_in(robot: Robot, *attributes: str) -> bool:
    return any(
        all(np.array_equal(getattr(robot, name), getattr(paper, name)) for name in attributes)
        for paper in _UNCHANGED
    )


ROBOTS: dict[str, Robot] = {
    robot.name: robot for robot in (PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL)
}
"""The paper's robots by name."""
