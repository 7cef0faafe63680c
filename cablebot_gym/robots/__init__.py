"""Robots as data: geometry, inertia, motors and transmission. Each value of the paper's robots
cites its table.

Define a custom robot as a :class:`~cablebot_gym.robots.record.Robot`, or in a TOML file, see
:func:`~cablebot_gym.robots.names.load_robot`. An error is raised if the robot is not physically
possible. All values are in SI units and radians, motor speeds in rad/s.

* ``parts``: motors, transmission, defaults, and kinds of robots.
* ``checks``: sizes, inertia and equilibrium that are physically possible.
* ``record``: the robot.
* ``paper``: the paper's robots.
* ``names``: robots by name and from files.
"""

from cablebot_gym.robots.names import (
    ELASTIC,
    find_robot,
    library,
    load_robot,
    private_robot,
    robot_names,
)
from cablebot_gym.robots.paper import (
    FLEX_PLANAR,
    FLEX_SPATIAL,
    PAPER_PAYLOAD_MAX,
    PLANAR,
    ROBOTS,
    SPATIAL,
    has_paper_capacity,
    has_paper_geometry,
)
from cablebot_gym.robots.parts import (
    COORDINATE_NAMES,
    GRAVITY,
    KIND_TEXTS,
    RPM,
    Cable,
    Defaults,
    Kind,
    Motors,
    Plane,
    Transmission,
)
from cablebot_gym.robots.record import Robot

__all__ = [
    "COORDINATE_NAMES",
    "ELASTIC",
    "FLEX_PLANAR",
    "FLEX_SPATIAL",
    "GRAVITY",
    "KIND_TEXTS",
    "PAPER_PAYLOAD_MAX",
    "PLANAR",
    "ROBOTS",
    "RPM",
    "SPATIAL",
    "Cable",
    "Defaults",
    "Kind",
    "Motors",
    "Plane",
    "Robot",
    "Transmission",
    "find_robot",
    "has_paper_capacity",
    "has_paper_geometry",
    "library",
    "load_robot",
    "private_robot",
    "robot_names",
]
