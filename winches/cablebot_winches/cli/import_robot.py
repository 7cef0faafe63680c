"""``cablebot robot import``."""

from __future__ import annotations

from pathlib import Path

from cablebot_gym.cli.options import counted
from cablebot_gym.utils.console import say


def import_file(path: Path, out: Path | None, cable_set: str | None) -> None:
    """Imports a robot, prints where each value comes from, and writes the robot as a TOML file.

    Raises:
        ValueError: if the robot cannot be imported, or ``out`` is missing, exists or has another
            suffix.
    """
    from cablebot_winches.importers import import_robot
    from cablebot_gym.robots import KIND_TEXTS
    from cablebot_gym.utils.files import atomic_write_text, check_new_file

    if out is None or out.suffix.lower() != ".toml":
        raise ValueError(
            f"give a file for the robot that ends in .toml: --out {path.stem.lower()}.toml"
        )
    check_new_file(out)
    imported = import_robot(path, cable_set=cable_set)
    robot = imported.robot
    print(f"robot      {robot.name}: {KIND_TEXTS[robot.kind]}, {counted(robot.cables, 'cable')}")
    for label, assumed in (("from file", False), ("assumed", True)):
        for name, text in imported.sources.items():
            if text.startswith("assumed") == assumed:
                print(f"{label:<11}{name}: {text.removeprefix('assumed: ')}")
    for note in imported.notes:
        print(f"note       {note}")
    atomic_write_text(out, imported.to_toml())
    say(f"wrote {out}. Change what is assumed there, then run: cablebot robot check {out}")
