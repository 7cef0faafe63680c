"""Robots as TOML files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from cablebot_gym.robots.record import Robot


def to_toml(robot: Robot) -> str:
    """A robot with its sources as a TOML file for :func:`~cablebot_gym.robots.names.load_robot`."""
    data = robot.to_dict()
    motors = data.pop("motors")
    transmission = data.pop("transmission")
    defaults = data.pop("defaults", {})
    lines = ["# SI units and radians; z points down. Check it with `cablebot robot check`."]
    # A 0 in the table of the robot has an effect, for example as minimum_tension. In the tables
    # of motors and transmission it is a default and means no effect, for example no friction.
    unused: tuple[Any, ...] = (None, (), {})
    unused_parts = (*unused, 0.0)
    lines += _lines(data, unused)
    lines += ["", "[motors]", *_lines(motors, unused_parts)]
    lines += ["", "[transmission]", *_lines(transmission, unused_parts)]
    if defaults:
        lines += ["", "[defaults]", *_lines(defaults, unused)]
    lines += ["", "[sources]"]
    lines += _named(robot.sources)
    if robot.ranges:
        lines += ["", "[ranges]", *_named(robot.ranges)]
    return "\n".join(lines) + "\n"


def _lines(values: Mapping[str, Any], unused: tuple[Any, ...]) -> Iterator[str]:
    """Lines with name and value, except for the values in ``unused``. A table of numbers gets one
    line per row."""
    for name, value in values.items():
        if value in unused:
            continue
        if isinstance(value, tuple) and isinstance(value[0], tuple):
            rows = "".join(f"  {_text(row)},\n" for row in value)
            yield f"{name} = [\n{rows}]"
        else:
            yield f"{name} = {_text(value)}"


def _named(values: Mapping[str, Any]) -> Iterator[str]:
    """Lines with the name of a field and a value."""
    for name, value in values.items():
        yield f"{json.dumps(name)} = {_text(value)}"


def _text(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {_text(item)}' for key, item in value.items())}}}"
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (bool, int)):
        return json.dumps(value)
    return repr(float(value) + 0.0)  # + 0.0 turns −0.0 into 0.0
