"""``cablebot list``."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from importlib.resources import files
from typing import Any

from cablebot_gym.cli.options import Json
from cablebot_gym.utils.console import print_table

_WIDTH = 110
"""Largest width of the tables [columns]."""

_UNITS: dict[str, dict[str, str]] = tomllib.loads(
    (files("cablebot_gym.cli") / "units.toml").read_text(encoding="utf-8")
)
"""Unit of each field of trajectories and uncertainties that has one."""


def list_(as_json: Json = False) -> None:
    """List environments, robots, trajectories, uncertainties and installed policies.

    The tables of trajectories and uncertainties show the fields and default values of
    `--trajectory` and `--uncertainty` as JSON.

    Example: cablebot list --json
    """
    if as_json:
        print(json.dumps(_data(), indent=2))
        return
    from rich import box

    for _, title, rows in tables():
        print_table(
            title,
            rows,
            right=False,
            width=_WIDTH,
            box=box.SIMPLE_HEAD,
            show_edge=False,
            pad_edge=False,
        )
        print()


def _data() -> dict[str, Any]:
    """The lists as JSON-able data."""
    from cablebot_gym.envs import ENV_IDS
    from cablebot_gym.policies import policy_entries
    from cablebot_gym.robots import robot_names
    from cablebot_gym.trajectories import TRAJECTORIES, trajectory_names
    from cablebot_gym.uncertainty import PARAMETERS, UNCERTAINTIES

    return {
        "env_ids": list(ENV_IDS),
        "robots": [_robot_entry(name) for name in robot_names()],
        "trajectories": trajectory_names(),
        "trajectory_fields": {
            name: _trajectory_fields(make()) for name, make in TRAJECTORIES.items()
        },
        "uncertainties": list(UNCERTAINTIES),
        "uncertainty_fields": {name: _uncertainty_fields(name) for name in UNCERTAINTIES},
        "uncertain_parameters": list(PARAMETERS),
        "uncertain_parameter_units": {
            name: parameter.unit for name, parameter in PARAMETERS.items()
        },
        "policies": [
            {"name": item.name, "kind": item.kind, "env_ids": list(item.env_ids)}
            for item in policy_entries().values()
        ],
    }


def _robot_entry(name: str) -> dict[str, Any]:
    """A robot as JSON-able data. The values of the paper's robots cite its tables in the code."""
    from cablebot_gym.robots import find_robot

    robot = find_robot(name)
    assumed = [field for field, source in robot.sources.items() if source.startswith("assumed")]
    return {
        "name": name,
        "kind": robot.kind,
        "cables": robot.cables,
        "coordinates": robot.coordinates,
        "transmission": robot.springs,
        "origin": "library" if robot.sources else "paper",
        "documented": len(robot.sources) - len(assumed),
        "assumed": assumed,
        "sources": dict(robot.sources),
    }


def _trajectory_fields(trajectory: Any) -> dict[str, dict[str, Any]]:
    """Default and unit of each JSON field of a trajectory, the duration first."""
    from cablebot_gym.task import to_jsonable
    from cablebot_gym.trajectories import BetweenDwells

    if isinstance(trajectory, BetweenDwells):
        dwell = {"default": trajectory.dwell, "unit": _UNITS["trajectory"]["dwell"]}
        return _trajectory_fields(trajectory.motion) | {"dwell": dwell}
    if not is_dataclass(trajectory):
        return {}
    found = {}
    for field in sorted(fields(trajectory), key=lambda field: field.name != "duration"):
        if field.name != "name":
            unit = _UNITS["trajectory"].get(field.name, "")
            unit = (
                unit.partition(",")[0]
                if getattr(trajectory, "name", "").endswith(("-planar", "-point"))
                else unit
            )
            # A field whose default is None gets its value from the other fields.
            default = (
                None if field.default is None else to_jsonable(getattr(trajectory, field.name))
            )
            found[field.name] = {"default": default, "unit": unit}
    return found


def _uncertainty_fields(name: str) -> list[dict[str, Any]]:
    """Path, value, unit and environments of each field that a named uncertainty sets.

    A field whose value depends on the robot has one entry for each value.
    """
    from cablebot_gym.envs import ENV_IDS, env_robot
    from cablebot_gym.robots import find_robot
    from cablebot_gym.uncertainty import find_uncertainty

    found: list[dict[str, Any]] = []
    for env_id in ENV_IDS:
        uncertainty = find_uncertainty(name, find_robot(env_robot(env_id)))
        for path, (value, unit) in _set_values(uncertainty).items():
            same = [entry for entry in found if (entry["field"], entry["value"]) == (path, value)]
            if not same:
                found.append({"field": path, "value": value, "unit": unit, "env_ids": []})
            (same or found)[-1]["env_ids"].append(env_id)
    groups = ("parameters", "wrench", "sensors", "sensor_bias", "delay")
    return sorted(found, key=lambda entry: groups.index(entry["field"].partition(".")[0]))


def _set_values(uncertainty: Any) -> dict[str, tuple[Any, str]]:
    """Value and unit of each field that an uncertainty sets, by its path in JSON. A parameter omits
    default values."""
    from cablebot_gym.uncertainty import PARAMETERS

    found: dict[str, tuple[Any, str]] = {}
    for name, distribution in uncertainty.parameters.items():
        values = {
            field.name: (getattr(distribution, field.name), field.default)
            for field in fields(distribution)
        }
        changed = {field: value for field, (value, default) in values.items() if value != default}
        found[f"parameters.{name}"] = (
            changed,
            "" if distribution.relative else PARAMETERS[name].unit,
        )
    for group in ("wrench", "sensors", "sensor_bias"):
        part = getattr(uncertainty, group)
        for field in () if part is None else fields(part):
            found[f"{group}.{field.name}"] = (
                getattr(part, field.name),
                _UNITS["uncertainty"].get(field.name, ""),
            )
    if uncertainty.delay:
        found["delay"] = (uncertainty.delay, _UNITS["uncertainty"]["delay"])
    return found


def tables() -> Iterator[tuple[str, str, list[list[str]]]]:
    """Name, title, and header and rows of each table."""
    from cablebot_gym.envs import ENV_IDS, env_robot
    from cablebot_gym.policies import policy_entries
    from cablebot_gym.robots import find_robot, robot_names
    from cablebot_gym.trajectories import TRAJECTORIES
    from cablebot_gym.uncertainty import (
        PARAMETERS,
        UNCERTAINTIES,
        ExternalWrench,
        ParameterDistribution,
        SensorNoise,
    )

    rows = [["id", "robot", "cables", "coordinates", "transmission"]]
    for env_id in ENV_IDS:
        robot = find_robot(env_robot(env_id))
        rows.append([env_id, robot.name, str(robot.cables), str(robot.coordinates), robot.springs])
    yield "ids", "Environments", rows

    rows = [["name", "kind", "cables", "transmission", "values with a source"]]
    for entry in map(_robot_entry, robot_names()):
        values = (
            "the paper"
            if not entry["sources"]
            else f"{entry['documented']} of {len(entry['sources'])}"
        )
        rows.append(
            [entry["name"], entry["kind"], str(entry["cables"]), entry["transmission"], values]
        )
    yield "robots", "Robots", rows

    rows = [["name", "field", "default", "unit"]]
    for name, make in TRAJECTORIES.items():
        trajectory = make()
        for field, entry in _trajectory_fields(trajectory).items():
            default = _json_text(entry["default"])
            if entry["default"] is None:
                motion = getattr(trajectory, "motion", trajectory)
                default += f" ({_json_text(getattr(motion, field))} with these fields)"
            rows.append([name, field, default, entry["unit"]])
    yield "trajectories", 'Trajectories: {"name": NAME, FIELD: VALUE}', _without_repeats(rows)

    rows = [["name", "field", "value"]]
    for name in UNCERTAINTIES:
        entries = _uncertainty_fields(name)
        for entry in entries:
            only = (
                ""
                if len(entry["env_ids"]) == len(ENV_IDS)
                else f" ({_short_ids(entry['env_ids'])} only)"
            )
            rows.append(
                [
                    name,
                    entry["field"],
                    f"{_json_text(entry['value'])} {entry['unit']}".strip() + only,
                ]
            )
        if not entries:
            rows.append([name, "–", "no uncertainty"])
    yield "uncertainties", "Uncertainties", _without_repeats(rows)

    rows = [["group", "field", "default", "unit"]]
    groups = {"parameters.NAME": ParameterDistribution, "wrench": ExternalWrench}
    groups |= {"sensors": SensorNoise, "sensor_bias": SensorNoise}
    for group, kind in groups.items():
        for item in fields(kind):
            default = "required" if item.default is MISSING else _json_text(item.default)
            rows.append([group, item.name, default, _UNITS["uncertainty"].get(item.name, "")])
    rows.append(["delay", "–", "0", _UNITS["uncertainty"]["delay"]])
    note = 'Fractions refer to the nominal value; with "relative": false, the unit is that of the parameter.'
    yield "uncertainty-fields", f"Fields of an uncertainty in JSON\n{note}", _without_repeats(rows)

    rows = [["name", "unit", "robots"]]
    for name, parameter in PARAMETERS.items():
        owners = [name for name, only in _PARAMETER_OWNERS.items() if getattr(parameter, only)]
        rows.append([name, parameter.unit, owners[0] if owners else "all"])
    yield "parameters", "Uncertain parameters", rows

    rows = [["name", "kind", "environments", "summary"]]
    for policy in sorted(policy_entries().values(), key=lambda policy: (policy.kind, policy.name)):
        ids = "all" if set(policy.env_ids) >= set(ENV_IDS) else _short_ids(policy.env_ids)
        rows.append([policy.name, policy.kind, ids, policy.summary])
    yield "installed-policies", "Policies", rows


_PARAMETER_OWNERS = {
    "with joint springs": "jointed",
    "with elastic cables": "elastic",
    "with turning platforms": "turns",
}


def _without_repeats(rows: list[list[str]]) -> list[list[str]]:
    """The rows with an empty first cell where it repeats the cell above."""
    above = [["", ""], *rows[:-1]]
    return [
        ["" if row[0] == before[0] else row[0], *row[1:]]
        for row, before in zip(rows, above, strict=True)
    ]


def _json_text(value: Any) -> str:
    """A value as short JSON: numbers with six significant digits, whole numbers without a point."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_json_text, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)}: {_json_text(item)}' for key, item in value.items())}}}"
    return json.dumps(value)


def _short_ids(env_ids: Any) -> str:
    """Environment ids without their common prefix and suffix, such as ``Planar, FlexSpatial``."""
    return ", ".join(env_id.removeprefix("CableBot-").removesuffix("-v0") for env_id in env_ids)
