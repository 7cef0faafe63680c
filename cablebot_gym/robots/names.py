"""Robots by name, from files and from data."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Mapping
from copy import deepcopy
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cablebot_gym.env_ids import ENV_ROBOTS
from cablebot_gym.robots.paper import ROBOTS
from cablebot_gym.robots.parts import Defaults
from cablebot_gym.robots.record import Robot
from cablebot_gym.utils.checks import unknown_name_error
from cablebot_gym.utils.files import check_not_a_file, read_text
from cablebot_gym.utils.foreign import foreign_json, foreign_toml

ELASTIC = "flex-"
"""Prefix of the name of a robot of the library for the variant with elastic cables."""


@cache
def library() -> Mapping[str, Path]:
    """Files of the real robots by name, ``cablebot_gym/library/*.toml``."""
    folder = Path(str(files("cablebot_gym") / "library"))
    # Read-only: a policy in this process could otherwise exchange a file of the robots.
    return MappingProxyType({path.stem: path for path in sorted(folder.glob("*.toml"))})


def robot_names() -> list[str]:
    """All names that :func:`find_robot` accepts: the paper's robots, then those of the library and
    their variants."""
    return [*ROBOTS, *library(), *(ELASTIC + name for name in library())]


_PAPER_ROBOTS = {name: pickle.dumps(robot) for name, robot in ROBOTS.items()}
"""The paper's robots as they were before any policy was loaded."""


def _read_library_robot(name: str) -> Robot:
    robot = load_robot(library()[name.removeprefix(ELASTIC)])
    if name.startswith(ELASTIC):
        return robot.replace(name=name)
    return robot.with_rigid_cables()


_library_robot = cache(_read_library_robot)


def private_robot(robot: str | Path | Mapping[str, Any] | Robot) -> Robot:
    """A robot as from :func:`find_robot`, which shares nothing with other robots of the process.

    A robot with a name is made anew: code that runs in the process, such as that of a policy, can
    change the object that :func:`find_robot` returns for the name.

    Raises:
        ValueError: as :func:`find_robot`.
    """
    if isinstance(robot, str):
        robot = ENV_ROBOTS.get(robot, robot)
    if isinstance(robot, str) and robot in _PAPER_ROBOTS:
        paper_robot: Robot = pickle.loads(_PAPER_ROBOTS[robot])
        return paper_robot
    shared = find_robot(robot)
    if isinstance(robot, str) and robot.removeprefix(ELASTIC) in library():
        return _read_library_robot(robot)
    return deepcopy(shared)


def load_robot(path: str | Path) -> Robot:
    """A robot from a TOML file with the fields of :class:`~cablebot_gym.robots.record.Robot`, and
    with the optional table :class:`~cablebot_gym.robots.parts.Defaults`.

    A ``.json`` file has the data of :meth:`~cablebot_gym.robots.record.Robot.to_dict`. A default
    motion ``file.py:name`` or ``file.csv`` is relative to the folder of the file.

    Raises:
        ValueError: if the file cannot be read or does not describe a physical robot. The message
            names the file.
    """
    path = Path(path)
    try:
        text = read_text(path)
        parse = foreign_json if path.suffix.lower() == ".json" else foreign_toml
        data = parse(text)
        robot = Robot.from_dict(data)
    except OSError as error:
        raise ValueError(f"cannot read robot file {str(path)!r}: {error.strerror}") from error
    except ValueError as error:  # of the TOML, too
        raise ValueError(f"robot file {str(path)!r}: {error}") from error
    return robot.replace(defaults=_with_motion_beside(robot.defaults, path.absolute().parent))


def _with_motion_beside(defaults: Defaults, folder: Path) -> Defaults:
    """Defaults whose motion, if it is that of a file, is in the folder of the robot's file."""
    motion = defaults.trajectory
    name = motion
    if isinstance(motion, Mapping):
        name = motion.get("name")
    if not isinstance(name, str) or not (".py:" in name or name.lower().endswith((".py", ".csv"))):
        return defaults
    beside = str(folder / name)
    if isinstance(motion, Mapping):
        return dataclasses.replace(defaults, trajectory={**motion, "name": beside})
    return dataclasses.replace(defaults, trajectory=beside)


def find_robot(robot: str | Path | Mapping[str, Any] | Robot) -> Robot:
    """A robot from a name or an environment id, from a TOML or JSON file, from the data of
    :meth:`~cablebot_gym.robots.record.Robot.to_dict`, or from a
    :class:`~cablebot_gym.robots.record.Robot`.

    Names are those of :func:`robot_names`. ``cogiro`` is the robot of the library with rigid
    cables, ``flex-cogiro`` the same robot with elastic cables, as its file describes it.

    Raises:
        ValueError: if the name is unknown or the data do not describe a physical robot.
    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, Mapping):
        return Robot.from_dict(robot)
    if isinstance(robot, (str, Path)) and Path(robot).suffix.lower() in (".toml", ".json"):
        return load_robot(robot)
    name = ENV_ROBOTS.get(str(robot), str(robot))
    if name in ROBOTS:
        return ROBOTS[name]
    if name.removeprefix(ELASTIC) not in library():
        forms = "a .toml or .json file"
        check_not_a_file(
            "robot",
            robot,
            f"{forms}; `cablebot robot import` of cablebot-winches makes one from CASPR and WireX files",
        )
        raise unknown_name_error(
            "robot", robot, [*robot_names(), *ENV_ROBOTS], f", {forms}, or pass a Robot"
        )
    return _library_robot(name)
