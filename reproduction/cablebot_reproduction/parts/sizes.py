"""Figs. 1 to 3: sizes of the robots on the paths of the paper, and the joint springs."""

from __future__ import annotations

import numpy as np

from cablebot_gym.kinematics import Array, cable_lengths
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, Robot
from cablebot_reproduction.outcome import Numbers, Outcome, PaperTable
from cablebot_reproduction.robots import FLEXIBLE_OF_4, RIGID_OF_4, paper_circle

PLATFORM_CORNERS = ("P1", "P1", "P3", "P3", "P2", "P2")
BASE_CORNERS = ("A1", "A2", "A2", "A3", "A3", "A1")
"""Corners at which cables 1 to 6 end (ring of Fig. 2)."""


def _poses(robot: Robot) -> Array:
    return paper_circle(robot)(np.linspace(0.0, 1.0, 201)).position


def sizes() -> Outcome:
    """Cable lengths on the paths, static twist of the springs, and highest mode of the motors."""
    numbers: Numbers = {}
    for name, robot in (("planar", PLANAR), ("spatial", RIGID_OF_4)):
        lengths = cable_lengths(robot.base, robot.platform, _poses(robot))
        numbers[f"{name}_shortest_cable_m"] = lengths.min()
        numbers[f"{name}_longest_cable_m"] = lengths.max()
    springs = FLEXIBLE_OF_4
    twists = textbook.static_torque(springs, springs.mass, _poses(springs)) / springs.stiffness
    numbers["wind_up_max_rad"] = twists[0].max()
    numbers["wind_up_path_max_rad"] = twists.max()
    numbers["mode_high_Hz"] = textbook.highest_frequency(springs) / (2 * np.pi)
    rows = zip(
        range(1, 7),
        BASE_CORNERS,
        PLATFORM_CORNERS,
        lengths.min(axis=0).tolist(),
        lengths.max(axis=0).tolist(),
        strict=True,
    )
    table = PaperTable(
        title="Ends of the cables of the spatial robot and their lengths on the path",
        header=("cable", "base corner", "platform corner", "minimum [m]", "maximum [m]"),
        rows=list(rows),
    )
    return Outcome(numbers=numbers, tables=(table,))
