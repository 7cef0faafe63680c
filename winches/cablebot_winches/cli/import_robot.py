"""``cablebot robot import``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.cli.options import counted
from cablebot_gym.utils.console import say


def import_file(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="NAME_bodies.xml or NAME_cables.xml of CASPR, or a .wcrfx file of WireX.",
        ),
    ],
    out: Annotated[Path, "File of the robot to write (.toml)."],
    cable_set: Annotated[str | None, "Cable set of a CASPR file. The default is its own."] = None,
) -> None:
    """Import a robot from a file of CASPR or WireX.

    The command prints where each value comes from. A file has no complete winches, so parts of them
    are assumed.

    Example: cablebot robot import SEGESTA_bodies.xml --out segesta.toml
    """
    from cablebot_gym.robots import KIND_TEXTS
    from cablebot_gym.utils.files import atomic_write_text, check_new_file
    from cablebot_winches.importers import import_robot

    if out.suffix.lower() != ".toml":
        raise ValueError(f"--out must end in .toml, not {out.name!r}")
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
    if imported.question:
        print(f"question   {imported.question}")
    atomic_write_text(out, imported.to_toml())
    say(f"wrote {out}. Change what is assumed there, then run: cablebot robot check {out}")
