"""``cablebot robot``."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli.importing import import_file
from cablebot_gym.cli.options import Json, Payload, counted, episode_options, note_waypoints
from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.console import notes_console

if TYPE_CHECKING:
    from cablebot_gym.bounds.robot_check import RobotCheck
    from cablebot_gym.robots import Robot


@episode_options("trajectory")
def robot(
    task: Annotated[str, typer.Argument(metavar="TASK", help="The task: check or import.")],
    name: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT",
            help="To check: TOML or JSON file, or name of a robot; `cablebot list` shows the names. To import: "
            "NAME_bodies.xml or NAME_cables.xml of CASPR, or a .wcrfx file of WireX.",
        ),
    ],
    episode: dict[str, Any],
    payload: Payload = None,
    out: Annotated[
        Path | None,
        typer.Option(help="File to write: the drawing of a check (.svg, .png, .pdf), or the imported robot (.toml)."),
    ] = None,
    cable_set: Annotated[str | None, typer.Option(help="Cable set of a CASPR file. The default is its own.")] = None,
    as_json: Json = False,
) -> None:
    """Check a robot and its motion, or import a robot from a file of CASPR or WireX.

    The check prints payload, workspace, modes, physics step, sag, and doubtful values. Nothing is simulated. The exit
    status is 1 if the robot is refused or does not carry the payload along its motion.

    Examples:

    cablebot robot check my.toml --out my.svg

    cablebot robot check cogiro --payload 300

    cablebot robot import SEGESTA_bodies.xml --out segesta.toml
    """
    from cablebot_gym.bounds.robot_check import check_model

    if choice("task", task, ["check", "import"]) == "import":
        if payload is not None or episode["trajectory"] is not None or as_json:
            raise ValueError("--payload, --trajectory and --json are for `cablebot robot check`: remove them")
        return import_file(Path(name), out, cable_set)
    if cable_set is not None:
        raise ValueError("--cable-set is for `cablebot robot import`: remove it")
    if out is not None and out.suffix not in (".svg", ".png", ".pdf"):
        raise ValueError(f"--out must end in .svg, .png or .pdf, not {out.name!r}")
    model = _loaded(name)
    if model is None:
        raise typer.Exit(1)
    check = check_model(model, payload=payload, trajectory=episode["trajectory"])
    note_waypoints(check.robot, check.trajectory)
    if out is not None:
        _draw(check, out)
    if as_json:
        print(json.dumps(check.to_dict(), indent=2))
    else:
        print("\n".join(report(check)))
    if out is not None:
        notes_console().print(f"wrote {out}")
    if not check.held:
        raise typer.Exit(1)


def _loaded(name: str) -> Robot | None:
    """The robot, or None with a message if the data of a file are refused.

    Raises:
        ValueError: if the file cannot be read, or there is no robot with this name.
    """
    from cablebot_gym.robots import find_robot

    try:
        return find_robot(name)
    except ValueError as error:
        if not Path(name).is_file():
            raise
        notes_console().print(f"refused: {error}", style="red")
        return None


def _draw(check: RobotCheck, out: Path) -> None:
    from cablebot_gym.plotting.figures import DPI
    from cablebot_gym.plotting.robots import draw_robot
    from cablebot_gym.utils.files import atomic_write

    atomic_write(out, partial(draw_robot(check).savefig, dpi=DPI, format=out.suffix[1:]))


def report(check: RobotCheck) -> list[str]:
    """Lines of the result in words."""
    from cablebot_gym.robots import KIND_TEXTS

    robot, limit = check.robot, check.limit
    place = f"at t = {limit.time:.2f} s, pose ({', '.join(f'{round(value, 6) + 0.0:.4g}' for value in limit.pose)})"
    lines = [f"robot      {robot.name}: {KIND_TEXTS[robot.kind]}, {counted(robot.cables, 'cable')}, {robot.springs}"]
    if limit.largest < limit.least:
        lines += [f"motion     {check.trajectory.name}: no payload can be held", f"           {place}:"]
    else:
        held = "carries" if check.held else "does not carry"
        lines.append(
            f"motion     {check.trajectory.name}, {check.trajectory.duration:g} s: {held} {check.payload:g} kg"
        )
        lines.append(f"           exact tracking from {limit.least:.4g} to {limit.largest:.4g} kg")
        lines.append(f"           limit {place}:")
    lines.append(f"           {limit.reason}")
    lines.append(f"workspace  {check.payload:g} kg at rest in {check.workspace:.0%} of it, at the home orientation")
    for locked, text in ((True, "motors locked"), (False, "motors free")):
        own = [f"{mode.frequency:.3g} Hz ({mode.direction})" for mode in check.modes if mode.locked == locked]
        if own:
            lines.append(f"modes      {text}: softest {own[0]}, stiffest {own[1]}")
    if not check.modes:
        lines.append("modes      none: the transmission is rigid and the cables do not stretch")
    step = f"{1e3 * check.physics_step:.3g} ms"
    lines.append(f"step       {counted(check.substeps, 'physics step')} of {step} in a control period")
    lines += _sag_lines(check)
    lines += [f"question   {question}" for question in check.questions] or ["questions  none"]
    return lines


def _sag_lines(check: RobotCheck) -> list[str]:
    """Lines of the sag at the least tensions of the motion, and of its effect at home."""
    if not check.cables:
        why = "the motion is not held" if any(_densities(check)) else "the cables have no mass; set cable_density"
        return [f"sag        not checked: {why}"]
    lines = []
    for number, cable in enumerate(check.cables, 1):
        factor = "" if cable.stiffness_factor is None else f", stiffness × {cable.stiffness_factor:.2f}"
        text = f"sag {1e3 * cable.sag:.4g} mm, {1e3 * cable.extra_length:.3g} mm longer{factor}"
        start = "sag        " if number == 1 else " " * 11
        lines.append(f"{start}cable {number}, {cable.length:.3g} m, at {cable.tension:.4g} N or more: {text}")
    if check.settled is None or check.settled_tension is None:
        return [*lines, "           the sag lets the platform fall too far for a linear estimate"]
    d = check.robot.dimensions
    moved = [f"{1e3 * math.hypot(*check.settled[:d]):.2f} mm"]
    if check.settled[d:]:
        moved.append(f"{1e3 * max(map(abs, check.settled[d:])):.2f} mrad")
    text = f"sag and weight move the home pose by {' and '.join(moved)}"
    return [*lines, f"           {text}, tensions by up to {check.settled_tension:.0%}"]


def _densities(check: RobotCheck) -> list[float]:
    return [float(value) for value in check.robot.per_motor(check.robot.cable_density)]
