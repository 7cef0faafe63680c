"""``cablebot reproduce``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_baselines.paper.readings import Readings, choices_of
from cablebot_gym.utils.console import counting, notes_console

_CHOICES = {name: ", ".join(choices) for name, choices in choices_of().items()}


def reproduce(
    only: Annotated[
        list[str] | None, typer.Option("--only", help="Parts, such as fig10,readings,map-stiffness.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for results.json, the page and the figures.")] = Path(
        "reproduction"
    ),
    workers: Annotated[int | None, typer.Option(help="Processes; one per core if not given.")] = None,
    payload: Annotated[str, typer.Option(help=f"What a load counts: {_CHOICES['payload']}.")] = Readings.payload,
    line: Annotated[str, typer.Option(help=f"q̇ of Eq. 37: {_CHOICES['line']}.")] = Readings.line,
    platform_mass: Annotated[
        str, typer.Option(help=f"Spatial platform [kg]: {_CHOICES['platform_mass']}.")
    ] = Readings.platform_mass,
    triangles: Annotated[
        str, typer.Option(help=f"Platform's triangle against the base's: {_CHOICES['triangles']}.")
    ] = Readings.triangles,
    sides: Annotated[str, typer.Option(help=f"What a and b are: {_CHOICES['sides']}.")] = Readings.sides,
    pulleys: Annotated[
        str, typer.Option(help=f"J and c of the rigid spatial robot: {_CHOICES['pulleys']}.")
    ] = Readings.pulleys,
    planar_apex: Annotated[
        str, typer.Option(help=f"Third motor of the planar robot: {_CHOICES['planar_apex']}.")
    ] = Readings.planar_apex,
    stiffness: Annotated[str, typer.Option(help=f"K [N·m/rad]: {_CHOICES['stiffness']}.")] = Readings.stiffness,
    minimum_tension: Annotated[float, typer.Option(help="T_min of the planar cables [N].")] = Readings.minimum_tension,
    alpha: Annotated[str, typer.Option(help=f"α of Eq. 11: {_CHOICES['alpha']}.")] = Readings.alpha,
    eq24: Annotated[str, typer.Option(help=f"Divisor of Eqs. 24 and 25: {_CHOICES['eq24']}.")] = Readings.eq24,
    eq37: Annotated[str, typer.Option(help=f"Form of Eqs. 37–39: {_CHOICES['eq37']}.")] = Readings.eq37,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON.")] = False,
) -> None:
    """The paper's tables, figures and claims, made again: what agrees, what does not, and why.

    Writes one PNG and SVG per figure, results.json and the page (Markdown and HTML). What the paper leaves open is an
    option.

    Examples:

    cablebot reproduce --out reproduction

    cablebot reproduce --only fig10,fig11 --payload total --line flat --out flat
    """
    from cablebot_baselines.paper.engine import HTML, MARKDOWN, RESULTS, missing
    from cablebot_baselines.paper.engine import reproduce as run
    from cablebot_baselines.paper.page import tally

    chosen: dict[str, Any] = {
        "payload": payload,
        "line": line,
        "platform_mass": platform_mass,
        "triangles": triangles,
        "sides": sides,
        "pulleys": pulleys,
        "planar_apex": planar_apex,
        "stiffness": stiffness,
        "minimum_tension": minimum_tension,
        "alpha": alpha,
        "eq24": eq24,
        "eq37": eq37,
    }
    readings = Readings(**chosen)  # which refuses what is no choice
    names = [name.strip() for text in only or [] for name in text.split(",")]
    errors = notes_console()
    with counting(errors, "computations") as bar:
        task = bar.add_task("starting", total=1)

        def step(last: str, done: int, expected: int) -> None:
            bar.update(task, description=last, completed=done, total=expected)

        say = errors.print
        try:
            results = run(readings, out, only=names, workers=workers, progress=step, say=say)
        except KeyboardInterrupt:
            rest = ",".join(missing(out, names))
            say(f"what is done is in {out}; go on with --out {out} --only {rest}")
            raise
    if as_json:
        print(json.dumps(results["rows"], indent=2, ensure_ascii=False))
        return
    for kind in ("result", "claim", "input"):
        print(f"{kind}s of the paper: {tally([row for row in results['rows'] if row['kind'] == kind])}")
    print(f"readings: {readings.words()}")
    if results["missing"]:
        print(f"not made: {', '.join(results['missing'])}")
    print("wrote " + ", ".join(str(out / name) for name in (HTML, MARKDOWN, RESULTS)) + " and the figures")
