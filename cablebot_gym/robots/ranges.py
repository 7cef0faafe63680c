"""Ranges of values that are not known exactly, as a robot's table ``ranges`` has them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cablebot_gym.utils.checks import numbers

if TYPE_CHECKING:
    from cablebot_gym.robots.record import Robot

_PARTS = ("motors", "transmission")


def with_values(robot: Robot, values: Mapping[str, float]) -> Robot:
    """A copy of a robot with other values, by name of the field as in ``ranges``."""
    changes: dict[str, Any] = {}
    for name, value in values.items():
        part, _, field = name.rpartition(".")
        if part:
            record = changes.get(part, getattr(robot, part))
            changes[part] = replace(record, **{field: value})
        else:
            changes[field] = value
    return robot.replace(**changes)


def check_ranges(robot: Robot) -> None:
    """Checks the table of ranges.

    Raises:
        ValueError: if it is no table, a name is not that of a field with one number, or a range is
            not (low, high).
    """
    if not isinstance(robot.ranges, Mapping):
        raise ValueError(
            f"ranges must be a table of [low, high] by the name of the field, not {robot.ranges!r}"
        )
    for name, values in robot.ranges.items():
        if not _has_number(robot, name):
            raise ValueError(
                f"ranges: {name!r} is not a field with one number; such fields are 'mass' and "
                "'motors.stall_torque'"
            )
        low, high = numbers(f"ranges: {name}", values, shapes=[(2,)], form="[low, high]")
        if low > high:
            raise ValueError(f"ranges: {name}: {low:g} is above {high:g}; write [low, high]")


def _has_number(robot: Robot, name: str) -> bool:
    """Whether a field has one number, or one per motor."""
    part, _, field = str(name).rpartition(".")
    if not part:
        return isinstance(vars(robot).get(field), int | float)
    if part not in _PARTS:
        return False
    return isinstance(vars(getattr(robot, part)).get(field), int | float | tuple)
