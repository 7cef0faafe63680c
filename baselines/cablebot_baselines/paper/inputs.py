"""Inputs of the reproduction, read from the robots, motions, uncertainties and laws that use them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from cablebot_baselines.classical.outer_loop import PAPER_GAINS, RobustPD
from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_gym.kinematics import Array
from cablebot_gym.robots import ROBOTS, RPM, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.uncertainty import UNCERTAINTIES


def read(path: str, interpretation: Interpretation) -> Any:
    """Value of a path such as ``planar.mass`` or ``gains.spatial.0``: a source, then keys, indices or attributes."""
    name, *rest = path.split(".")
    value = SOURCES[name](interpretation)
    for name in rest:
        if isinstance(value, Mapping):
            value = value[name]
        else:
            value = value[int(name)] if name.isdigit() else getattr(value, name)
    return value


def _circle(robot: Robot) -> dict[str, Any]:
    """Quantities of Tables 1 and 3, measured on the motion."""
    circle = paper_circle(robot)

    def angle(time: float) -> float:
        x, y = circle(time).position[:2]
        return float(np.arctan2(y, x))

    start = circle(0.0).position
    times = np.linspace(0.0, circle.duration, 2001)
    changes = np.linalg.norm(np.diff(circle(times).acceleration, axis=0), axis=1)
    jump = times[np.argmax(changes)]
    return {
        "start": start,
        "radius": np.linalg.norm(start[:2]),
        "angle": angle(0.2) / (np.pi * 0.2**2),
        "exponent": np.log2(angle(0.4) / angle(0.2)),
        "jump": jump,
        "middle": jump / circle.duration,
        "duration": circle.duration,
    }


def _size(interpretation: Interpretation, robot: Robot) -> dict[str, float]:
    """a and b of the triangles under the interpretation [m]."""
    divisor = 2.0 if interpretation.sides == "half-side" else np.sqrt(3)
    triangles = {"base": robot.base, "platform": robot.platform}
    return {
        name: np.linalg.norm(anchors[:, None] - anchors[None], axis=-1).max() / divisor
        for name, anchors in triangles.items()
    }


def _table6(interpretation: Interpretation) -> dict[str, Any]:
    """Half-widths of the distributions, and mean and variance of the disturbance."""
    uncertainty = UNCERTAINTIES["table6"](interpretation.flexible("control"))
    widths = {
        name: np.abs([uncertainty.parameters[parameter].low, uncertainty.parameters[parameter].high])
        for name, parameter in (("mass", "platform_mass"), ("stiffness", "stiffness"))
    }
    wrench = uncertainty.wrench
    assert wrench is not None  # Table 6 prints a disturbance
    return widths | {
        "force_mean": wrench.force_mean,
        "force_variance": np.square(wrench.force_std),
        "factor": np.abs(np.subtract(wrench.factor, 1)),
    }


def _speed(interpretation: Interpretation, robot: Robot) -> Array:
    """Free speed under the torque-speed line of the interpretation, if a motor can have this line [rpm]."""
    return np.divide(interpretation.closed_loop_robot(robot).motors.free_speed, RPM)


def _slowest_pole() -> float:
    """Largest real part of the poles of both sets of gains [1/s]."""
    return float(max(np.roots([1.0, damping, stiffness]).real.max() for stiffness, damping in PAPER_GAINS.values()))


SOURCES: dict[str, Callable[[Interpretation], Any]] = {
    "rigid_robots": lambda chosen: sum(not robot.flexible for robot in ROBOTS.values()),
    "planar": lambda chosen: chosen.planar,
    "spatial": lambda chosen: chosen.spatial("control"),
    "flexible": lambda chosen: chosen.flexible("control"),
    "loaded_spatial": lambda chosen: chosen.spatial("payload"),
    "loaded_flexible": lambda chosen: chosen.flexible("payload"),
    "flexible_freedom": lambda chosen: chosen.flexible("control").coordinates + chosen.flexible("control").cables,
    "planar_sides": lambda chosen: np.linalg.norm(chosen.planar.base - np.roll(chosen.planar.base, 1, axis=0), axis=1),
    "spatial_size": lambda chosen: _size(chosen, chosen.spatial("control")),
    "flexible_size": lambda chosen: _size(chosen, chosen.flexible("control")),
    "sides": lambda chosen: chosen.sides,
    "planar_circle": lambda chosen: _circle(chosen.planar),
    "spatial_circle": lambda chosen: _circle(chosen.spatial("control")),
    "flexible_circle": lambda chosen: _circle(chosen.flexible("control")),
    "planar_speed": lambda chosen: _speed(chosen, chosen.planar),
    "loaded_spatial_speed": lambda chosen: _speed(chosen, chosen.spatial("payload")),
    "loaded_flexible_speed": lambda chosen: _speed(chosen, chosen.flexible("payload")),
    "gains": lambda chosen: PAPER_GAINS,
    "slowest_pole": lambda chosen: _slowest_pole(),
    "law": lambda chosen: RobustPD,
    "law_bounds": lambda chosen: sum(field.name in ("zeta", "phi") for field in fields(RobustPD)),
    "bounds": lambda chosen: ErrorBounds(),
    "table6": _table6,
}
"""Objects of the reproduction under an interpretation, by the first name of a path. ``loaded_`` marks the robots of
Tables 8 and 9; the others are those of Tables 2, 4 and 5."""
