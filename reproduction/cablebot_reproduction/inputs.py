"""Inputs of the reproduction, read from the robots, motions, uncertainties and laws that use
them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cablebot_baselines.classical.outer_loop import PAPER_GAINS, RobustPD
from cablebot_gym.robots import ROBOTS, RPM, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.uncertainty import UNCERTAINTIES
from cablebot_reproduction.exact import paper_circle
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.published import Input
from cablebot_reproduction.texts import as_text


def judge_input(item: Input, interpretation: Interpretation) -> tuple[float | None, str, str]:
    """Our value as a number and as text, and the verdict on an input.

    Raises:
        NoEquilibriumError: if the robot with this input does not exist under the interpretation.
    """
    values = [read(path, interpretation) for path in item.sources] or [item.value]
    if item.value is None:
        return None, str(values[0]), item.verdict
    flat = np.concatenate([np.ravel(value) for value in values]).astype(float)
    numbers = np.unique(flat.round(12))
    expected = item.value
    if item.corrected is not None:
        expected = item.corrected
    is_used = np.allclose(numbers, expected, rtol=1e-9, atol=0)
    if item.is_upper_bound:
        is_used = bool(numbers.max() < item.value)
    verdict: str = item.verdict
    if not is_used and verdict != "contradicted":
        verdict = "replaced"
    text = ", ".join(map(as_text, numbers.tolist()))
    value = None
    if len(numbers) == 1:
        value = float(numbers[0])
    return value, f"{text} {item.unit}".strip(), verdict


def read(path: str, interpretation: Interpretation) -> Any:
    """Value of a path such as ``planar.mass``, ``planar_circle.radius`` or ``gains.spatial.0``.

    The path consists of a robot, a quantity of a robot or another object, and of keys, indices or
    attributes.
    """
    source, *keys = path.split(".")
    value = _source(source, interpretation)
    for key in keys:
        if isinstance(value, Mapping):
            value = value[key]
        elif key.isdigit():
            value = value[int(key)]
        else:
            value = getattr(value, key)
    return value


def _source(name: str, interpretation: Interpretation) -> Any:
    if name in _ROBOTS:
        return _ROBOTS[name](interpretation)
    if name in _OBJECTS:
        return _OBJECTS[name](interpretation)
    robot_name, _, quantity = name.rpartition("_")
    robot = _ROBOTS[robot_name](interpretation)
    return _QUANTITIES[quantity](interpretation, robot)


_ROBOTS: dict[str, Callable[[Interpretation], Robot]] = {
    "planar": lambda interpretation: interpretation.planar,
    "spatial": lambda interpretation: interpretation.spatial("control"),
    "flexible": lambda interpretation: interpretation.flexible("control"),
    "loaded_spatial": lambda interpretation: interpretation.spatial("payload"),
    "loaded_flexible": lambda interpretation: interpretation.flexible("payload"),
}
"""Robots of Tables 2, 4 and 5; ``loaded_`` marks those of Tables 8 and 9."""


def _table6(interpretation: Interpretation) -> dict[str, Any]:
    """Half-widths of the distributions, and mean and variance of the disturbance."""
    uncertainty = UNCERTAINTIES["table6"](interpretation.flexible("control"))
    mass = uncertainty.parameters["platform_mass"]
    stiffness = uncertainty.parameters["stiffness"]
    wrench = uncertainty.wrench
    assert wrench is not None  # Table 6 prints a disturbance
    return {
        "mass": np.abs([mass.low, mass.high]),
        "stiffness": np.abs([stiffness.low, stiffness.high]),
        "force_mean": wrench.force_mean,
        "force_variance": np.square(wrench.force_std),
        "factor": np.abs(np.subtract(wrench.factor, 1)),
    }


_OBJECTS: dict[str, Callable[[Interpretation], Any]] = {
    "sides": lambda interpretation: interpretation.sides,
    "table6": _table6,
    "bounds": lambda _: ErrorBounds(),
    "gains": lambda _: PAPER_GAINS,
    "law": lambda _: RobustPD,
    "law_bounds": lambda _: len({"zeta", "phi"} & RobustPD.__dataclass_fields__.keys()),
    "rigid_robots": lambda _: sum(not robot.flexible for robot in ROBOTS.values()),
}
"""Objects besides the robots."""


def _circle(_: Interpretation, robot: Robot) -> dict[str, Any]:
    """Quantities of Tables 1 and 3, measured on the motion."""
    circle = paper_circle(robot)

    def angle(time: float) -> float:
        x, y = circle(time).position[:2]
        return float(np.arctan2(y, x))

    start = circle(0.0).position
    times = np.linspace(0.0, circle.duration, 2001)
    changes = np.diff(circle(times).acceleration, axis=0)
    sizes = np.linalg.norm(changes, axis=1)
    jump = times[np.argmax(sizes)]
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
    divisor = np.sqrt(3)
    if interpretation.sides == "half-side":
        divisor = 2
    sizes = {}
    for name, anchors in (("base", robot.base), ("platform", robot.platform)):
        distances = np.linalg.norm(anchors[:, None] - anchors[None], axis=-1)
        sizes[name] = distances.max() / divisor
    return sizes


def _sides(_: Interpretation, robot: Robot) -> Any:
    """Distances of neighbouring base anchors [m]."""
    neighbours = np.roll(robot.base, 1, axis=0)
    return np.linalg.norm(robot.base - neighbours, axis=1)


def _speed(interpretation: Interpretation, robot: Robot) -> Any:
    """Free speed under the torque-speed line of the interpretation, if a motor can have this line
    [rpm]."""
    motors = interpretation.closed_loop_robot(robot).motors
    return np.divide(motors.free_speed, RPM)


_QUANTITIES: dict[str, Callable[[Interpretation, Robot], Any]] = {
    "circle": _circle,
    "size": _size,
    "sides": _sides,
    "freedom": lambda _, robot: robot.coordinates + robot.cables,
    "states": lambda _, robot: {"platform": 2 * robot.coordinates, "motors": 2 * robot.cables},
    "speed": _speed,
}
"""Quantities of a robot."""
