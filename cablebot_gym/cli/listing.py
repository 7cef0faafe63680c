"""``cablebot list``."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from importlib.resources import files
from itertools import pairwise
from typing import Any

from cablebot_gym.utils.console import print_table

_UNITS: dict[str, str] = tomllib.loads(
    (files("cablebot_gym.cli") / "units.toml").read_text(encoding="utf-8")
)
"""Unit of each field of trajectories that has one."""


def list_() -> None:
    """List environments, robots, trajectories, uncertainties and installed policies.

    The tables of trajectories and uncertainties show fields of `--trajectory` and `--uncertainty`
    as JSON.

    Example: cablebot list
    """
    for _, title, rows in tables():
        print_table(title, rows, right=False)


def _trajectory_fields(trajectory: Any) -> dict[str, dict[str, Any]]:
    """Default and unit of each JSON field of a trajectory, the duration first."""
    from cablebot_gym.motions import BetweenDwells
    from cablebot_gym.task import to_jsonable

    if isinstance(trajectory, BetweenDwells):
        dwell = {"default": trajectory.dwell, "unit": _UNITS["dwell"]}
        return _trajectory_fields(trajectory.motion) | {"dwell": dwell}
    if not is_dataclass(trajectory):
        return {}
    is_plane_or_point = getattr(trajectory, "name", "").endswith(("-planar", "-point"))
    entries = {}
    for field in sorted(fields(trajectory), key=lambda field: field.name != "duration"):
        if field.name == "name":
            continue
        unit = _UNITS.get(field.name, "")
        if is_plane_or_point:
            unit = unit.partition(",")[0]  # no angles
        default = None
        if field.default is not None:  # otherwise the value follows from the other fields
            default = to_jsonable(getattr(trajectory, field.name))
        entries[field.name] = {"default": default, "unit": unit}
    return entries


def _set_values(uncertainty: Any) -> Iterator[tuple[str, Any]]:
    """Path in JSON and value of each field that an uncertainty sets. Default values are left out."""
    for name, distribution in uncertainty.parameters.items():
        yield f"parameters.{name}", dict(_changed(distribution))
    for group in ("wrench", "sensors", "sensor_bias"):
        record = getattr(uncertainty, group)
        if record is not None:
            for name, value in _changed(record):
                yield f"{group}.{name}", value
    if uncertainty.delay:
        yield "delay", uncertainty.delay


def _changed(record: Any) -> Iterator[tuple[str, Any]]:
    """Name and value of each field that is not at its default."""
    for field in fields(record):
        value = getattr(record, field.name)
        if value != field.default:
            yield field.name, value


def tables() -> Iterator[tuple[str, str, list[list[str]]]]:
    """Name, title, and header and rows of each table."""
    from cablebot_gym.envs import ENV_IDS
    from cablebot_gym.robots import robot_names

    yield "ids", "Environments", _robot_rows("id", "name", ENV_IDS)
    yield "robots", "Robots", _robot_rows("name", "kind", robot_names())
    yield "trajectories", 'Trajectories: {"name": NAME, FIELD: VALUE}', _trajectory_rows()
    yield "uncertainties", "Uncertainties, without fields at their defaults", _uncertainty_rows()
    yield "parameters", "Uncertain parameters", _parameter_rows()
    yield "installed-policies", "Policies", _policy_rows()


def _robot_rows(head: str, field: str, names: Iterable[str]) -> list[list[str]]:
    """A row for each robot: its name or the id of its environment, a field, cables and springs."""
    from cablebot_gym.robots import find_robot

    rows = [[head, field.replace("name", "robot"), "cables", "transmission"]]
    for name in names:
        robot = find_robot(name)
        rows.append([name, getattr(robot, field), str(robot.cables), robot.springs])
    return rows


def _trajectory_rows() -> list[list[str]]:
    from cablebot_gym.motions import TRAJECTORIES

    rows = [["name", "field", "default", "unit"]]
    for name, make in TRAJECTORIES.items():
        trajectory = make()
        for field, entry in _trajectory_fields(trajectory).items():
            default = _json_text(entry["default"])
            if entry["default"] is None:
                motion = getattr(trajectory, "motion", trajectory)
                default += f" ({_json_text(getattr(motion, field))} with these fields)"
            rows.append([name, field, default, entry["unit"]])
    return _without_repeats(rows)


def _uncertainty_rows() -> list[list[str]]:
    from cablebot_gym.envs import ENV_IDS
    from cablebot_gym.robots import find_robot
    from cablebot_gym.uncertainty import UNCERTAINTIES, find_uncertainty

    rows = [["name", "field", "value"]]
    for name in UNCERTAINTIES:
        env_ids_of: dict[tuple[str, str], list[str]] = {}
        for env_id in ENV_IDS:
            for path, value in _set_values(find_uncertainty(name, find_robot(env_id))):
                env_ids_of.setdefault((path, _json_text(value)), []).append(env_id)
        for (path, text), env_ids in sorted(env_ids_of.items()):
            if len(env_ids) < len(ENV_IDS):
                text += f" ({_short_ids(env_ids)} only)"
            rows.append([name, path, text])
        if not env_ids_of:
            rows.append([name, "–", "no uncertainty"])
    return _without_repeats(rows)


def _parameter_rows() -> list[list[str]]:
    from cablebot_gym.uncertainty import PARAMETERS

    rows = [["name", "unit", "robots"]]
    for name, parameter in PARAMETERS.items():
        robots = "all"
        for owners, condition in reversed(_PARAMETER_OWNERS.items()):
            if getattr(parameter, condition):
                robots = owners
        rows.append([name, parameter.unit, robots])
    return rows


def _policy_rows() -> list[list[str]]:
    from cablebot_gym.envs import ENV_IDS
    from cablebot_gym.policies import policy_entries

    rows = [["name", "kind", "environments", "summary"]]
    for policy in sorted(policy_entries().values(), key=lambda policy: (policy.kind, policy.name)):
        ids = _short_ids(policy.env_ids)
        if set(policy.env_ids) >= set(ENV_IDS):
            ids = "all"
        kind: str = policy.kind
        if policy.known_robot:
            kind += ", known robot"
        rows.append([policy.name, kind, ids, policy.summary])
    return rows


_PARAMETER_OWNERS = {
    "with joint springs": "jointed",
    "with elastic cables": "elastic",
    "with load friction": "per_load",
    "with turning platforms": "turns",
}


def _without_repeats(rows: list[list[str]]) -> list[list[str]]:
    """The rows with an empty first cell where it repeats the cell above."""
    shown = [rows[0]]
    for above, row in pairwise(rows):
        is_repeated = row[0] == above[0]
        shown.append(["" if is_repeated else row[0], *row[1:]])
    return shown


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
