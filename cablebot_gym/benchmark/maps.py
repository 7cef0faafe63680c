"""Payload maps: the DLCC as a function of one parameter of the task, all others at their
defaults."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, PolicyCell, canonical, merged
from cablebot_gym.task import to_jsonable
from cablebot_gym.trajectories import find_trajectory

AnyCell = TypeVar("AnyCell", PolicyCell, BestKnownCell)

_LABELS: dict[str, tuple[str, float]] = {
    "error_bounds.position": ("position error bound R [mm]", 1e3),
    "error_bounds.rotation": ("rotation error bound [mrad]", 1e3),
    "trajectory.duration": ("motion duration [s]", 1.0),
    "trajectory.radius": ("radius of the circle [m]", 1.0),
    "trajectory.center.2": ("depth z [m]", 1.0),
    "robot_changes.transmission.stiffness": ("joint stiffness K [N·m/rad]", 1.0),
    "robot_changes.transmission.damping": ("pulley friction c [N·m·s/rad]", 1.0),
    "resolution": ("payload resolution [g]", 1e3),
}
"""Fields of a cell that suites vary, with their labels and their factors from SI to the unit of the
label."""

_CONSTANT = {"trajectory.center.2", "resolution"}
"""Fields that are varied between maps but constant in a map."""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A parameter of the task that a map varies."""

    name: str
    """Key of :data:`AXES`."""
    fields: tuple[str, ...]
    """Fields of a cell that have the value, such as ``error_bounds.position``."""

    @property
    def label(self) -> str:
        """Axis label with the unit."""
        return " = ".join(_LABELS[name][0] for name in self.fields)

    @property
    def scale(self) -> float:
        """Factor from SI to the unit of the label."""
        return _LABELS[self.fields[0]][1]

    def value(self, cell: Cell) -> Any:
        """Value of the parameter in a cell, SI; None if the robot or the motion does not have
        it."""
        return _values(cell)[self.fields[0]]

    def with_value(self, cell: AnyCell, value: float) -> AnyCell:
        """The cell with the parameter set to ``value``, SI; the unchanged cell if ``value`` is the
        default."""
        default = _default_values(cell)
        for name in self.fields:
            if value != default[name]:
                group, *path = name.split(".")
                change: Any = value
                for step in reversed(path):
                    change = {step: change}
                changes: dict[str, Any] = {group: merged(getattr(cell, group), change)}
                cell = replace(cell, **changes)
        return cell

    def varies(self, cell: Cell) -> bool:
        """Whether the parameter of a cell is not at its default."""
        return not set(self.fields).isdisjoint(varied_fields(cell))

    def constants(self, cell: Cell) -> tuple[str, ...] | None:
        """Other varied parameters, constant in a map, with their values; None if no map of this
        axis has the cell."""
        constants = [name for name in varied_fields(cell) if name not in self.fields]
        is_equal = len({_values(cell)[name] for name in self.fields}) == 1
        if not is_equal or not set(constants) <= _CONSTANT:
            return None
        return tuple(_text(cell, name) for name in constants)


_AXES = (
    Axis(name="position", fields=("error_bounds.position",)),
    Axis(name="bounds", fields=("error_bounds.position", "error_bounds.rotation")),
    Axis(name="duration", fields=("trajectory.duration",)),
    Axis(name="stiffness", fields=("robot_changes.transmission.stiffness",)),
    Axis(name="damping", fields=("robot_changes.transmission.damping",)),
    Axis(name="radius", fields=("trajectory.radius",)),
)

AXES: Mapping[str, Axis] = MappingProxyType({axis.name: axis for axis in _AXES})
"""Axes by name."""


def varied_fields(cell: Cell) -> tuple[str, ...]:
    """Fields whose value in a cell is not the default: none for most cells, at least one for a cell
    of a map."""
    values = _values(cell)
    default = _default_values(cell)
    return tuple(name for name in _LABELS if values[name] != default[name])


def varied_texts(cell: Cell) -> list[str]:
    """Labels and values of the parameters of a cell that are not at their defaults."""
    return [_text(cell, name) for name in varied_fields(cell)]


def _text(cell: Cell, name: str) -> str:
    label, scale = _LABELS[name]
    return f"{label} {_values(cell)[name] * scale:g}"


def _values(cell: Cell) -> dict[str, Any]:
    groups = {name.partition(".")[0] for name in _LABELS}
    data = {name: value for name, value in cell.to_dict().items() if name in groups}
    return _values_of(cell.env_id, canonical(data))


def _default_values(cell: Cell) -> dict[str, Any]:
    """Values of all fields in a cell of the same motion with defaults otherwise. No field of a cell
    with a robot of its own is varied: its motion and error bounds are those of the robot."""
    if cell.robot_name is not None:
        return _values(cell)
    motion = {name: value for name, value in cell.trajectory.items() if name in ("name", "seed")}
    return _values_of(cell.env_id, canonical({"trajectory": motion}))


@cache
def _values_of(env_id: str, conditions: str) -> dict[str, Any]:
    """Value of each field; None if the robot, the motion or the cell does not have it."""
    fields = json.loads(conditions)
    resolution = fields.pop("resolution", None)
    cell = BestKnownCell(env_id=env_id, **fields)
    robot = cell.robot
    data: dict[str, Any] = {
        "error_bounds": dict(cell.error_bounds),
        "robot_changes": robot.to_dict(),
        "trajectory": to_jsonable(find_trajectory(dict(cell.trajectory), robot.kind)),
        "resolution": resolution,
    }
    return {name: _value_at(data, name.split(".")) for name in _LABELS}


def _value_at(data: Any, path: list[str]) -> Any:
    """The value at a path in nested data; None if there is none."""
    for step in path:
        if isinstance(data, list):
            data = data[int(step)] if int(step) < len(data) else None
        else:
            data = (data or {}).get(step)
    return data
