"""Tables that hand-written pages include."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from cablebot_gym.cli.app import add_commands, app, command_points
from cablebot_gym.robots import FLEX_SPATIAL
from cablebot_gym.task import to_jsonable
from cablebot_gym.trajectories import KINDS, TRAJECTORIES
from cablebot_gym.uncertainty import PARAMETERS, UNCERTAINTIES
from generate.folder import Folder, number, table

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def write(folder: Folder) -> None:
    """Writes all tables."""
    folder.write("trajectories.inc", trajectories())
    folder.write("uncertainties.inc", uncertainties())
    folder.write("parameters.inc", parameters())
    folder.write("requirements.inc", requirements())
    folder.write("commands.inc", commands())


def trajectories() -> str:
    """The named motions with their duration and peak speeds and accelerations."""
    rows = [["name", "robots", "class", "fields", "duration [s]", "largest speed [m/s]", "largest acceleration [m/s²]"]]
    for name, make in TRAJECTORIES.items():
        motion = make()
        reference = motion(np.linspace(0, motion.duration, 2001))
        line = slice(0, min(3, motion.coordinates))
        peaks = (
            np.linalg.norm(values[:, line], axis=1).max() for values in (reference.velocity, reference.acceleration)
        )
        kind, peak = type(motion).__name__, [f"{value:.3g}" for value in peaks]
        made = f"{{py:class}}`~{type(motion).__module__}.{kind}`"
        own = ", ".join(f"`{field}`" for field in to_jsonable(motion) if field != "name")
        rows.append([f"`{name}`", KINDS[motion.coordinates], made, own, number(motion.duration), *peak])
    return table(rows)


def uncertainties() -> str:
    """The named uncertainties as data, for the spatial robot with joint springs, which has every parameter."""
    text = ""
    for name, make in UNCERTAINTIES.items():
        data = json.dumps(_changed(make(FLEX_SPATIAL)), indent=2)
        text += f"\n`{name}`:\n\n```json\n{data}\n```\n"
    return text


def _changed(value: Any) -> Any:
    """A value as data, without the fields that have their default."""
    if isinstance(value, Mapping):
        return {name: _changed(item) for name, item in value.items()}
    if not is_dataclass(value):
        return round(value, 4) if isinstance(value, float) else value
    own = {field.name: (getattr(value, field.name), field.default) for field in fields(value)}
    return {name: _changed(item) for name, (item, usual) in own.items() if item != usual and item != {}}


def parameters() -> str:
    """The uncertain parameters."""
    rows = [["parameter", "unit", "attribute of the robot", "robots"]]
    for name, one in PARAMETERS.items():
        robots = [*(["with joint springs"] if one.flexible else []), *(["spatial"] if one.spatial else [])]
        rows.append([f"`{name}`", one.unit, f"`{one.attribute}`", ", ".join(robots) or "all"])
    return table(rows)


def requirements() -> str:
    """Requirements of the package and its extras, from pyproject.toml."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    extras = {"": project["dependencies"], **project["optional-dependencies"]}
    rows = [["extra", "needs"], ["Python", f"`{project['requires-python']}`"]]
    for extra, needed in extras.items():
        rows.append([f"`{extra}`" if extra else "the package itself", ", ".join(f"`{one}`" for one in needed)])
    return table(rows)


def commands() -> str:
    """The help of every command, those of the baselines included."""
    points = command_points()
    add_commands(points)
    text, runner = "", CliRunner(env={"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"})
    for name in points:
        shown = runner.invoke(app, [name, "--help"], prog_name="cablebot", catch_exceptions=False).output
        text += f"\n## cablebot {name}\n\n```text\n{shown.strip()}\n```\n"
    return text
