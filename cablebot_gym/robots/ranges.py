"""Robots with other values of fields that are not known exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from cablebot_gym.robots.record import Robot


def with_values(robot: Robot, values: Mapping[str, float]) -> Robot:
    """A copy of a robot with other values, by name of the field as in its ``ranges``."""
    changes: dict[str, Any] = {}
    for name, value in values.items():
        part, _, field = name.rpartition(".")
        if part:
            record = changes.get(part, getattr(robot, part))
            changes[part] = replace(record, **{field: value})
        else:
            changes[field] = value
    return robot.replace(**changes)
