"""``cablebot reproduce``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_baselines.paper.interpretation import Interpretation, choices_of
from cablebot_gym.utils.console import notes_console, progress

_CHOICES = {name: ", ".join(choices) for name, choices in choices_of().items()}


def reproduce(
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Parts to run, for example fig10,interpretations,scan; all parts if not given."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Output folder for results.json, the page and the figures.")] = Path(
        "reproduction"
    ),
    workers: Annotated[int | None, typer.Option(help="Number of processes; one per core if not given.")] = None,
    payload: Annotated[
        str, typer.Option(help=f"Definition of the payload: {_CHOICES['payload']}.")
    ] = Interpretation.payload,
    line: Annotated[str, typer.Option(help=f"Speed q̇ in Eq. 37: {_CHOICES['line']}.")] = Interpretation.line,
    platform_mass: Annotated[
        str, typer.Option(help=f"Platform mass of the spatial robot [kg]: {_CHOICES['platform_mass']}.")
    ] = Interpretation.platform_mass,
    triangles: Annotated[
        str, typer.Option(help=f"Orientation of the platform triangle relative to the base: {_CHOICES['triangles']}.")
    ] = Interpretation.triangles,
    sides: Annotated[str, typer.Option(help=f"Meaning of a and b: {_CHOICES['sides']}.")] = Interpretation.sides,
    pulleys: Annotated[
        str, typer.Option(help=f"Source of J and c of the rigid spatial robot: {_CHOICES['pulleys']}.")
    ] = Interpretation.pulleys,
    planar_apex: Annotated[
        str, typer.Option(help=f"Position of the third motor of the planar robot: {_CHOICES['planar_apex']}.")
    ] = Interpretation.planar_apex,
    stiffness: Annotated[
        str, typer.Option(help=f"Joint stiffness K [N·m/rad]: {_CHOICES['stiffness']}.")
    ] = Interpretation.stiffness,
    minimum_tension: Annotated[
        float, typer.Option(help="Lower tension bound T_min of the planar robot [N].")
    ] = Interpretation.minimum_tension,
    alpha: Annotated[str, typer.Option(help=f"α of Eq. 11: {_CHOICES['alpha']}.")] = Interpretation.alpha,
    eq24: Annotated[str, typer.Option(help=f"Divisor of Eqs. 24 and 25: {_CHOICES['eq24']}.")] = Interpretation.eq24,
    eq37: Annotated[str, typer.Option(help=f"Form of Eqs. 37–39: {_CHOICES['eq37']}.")] = Interpretation.eq37,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON.")] = False,
) -> None:
    """Reproduce the tables, figures and claims of the paper and compare them with the published values.

    Writes one PNG and SVG per figure, results.json and the page (Markdown and HTML). The choices that the paper leaves
    open are options of this command.

    Examples:

    cablebot reproduce --out reproduction

    cablebot reproduce --only fig10,fig11 --payload total --line flat --out flat
    """
    from cablebot_baselines.paper.engine import HTML, MARKDOWN, RESULTS, missing
    from cablebot_baselines.paper.engine import reproduce as run
    from cablebot_baselines.paper.page import tally

    choices: dict[str, Any] = {
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
    interpretation = Interpretation(**choices)  # raises ValueError if a choice is invalid
    names = [name.strip() for text in only or [] for name in text.split(",")]
    say = notes_console().print
    try:
        with progress("computing", "computations") as step:
            results = run(
                interpretation,
                out,
                only=names,
                workers=workers,
                progress=lambda activity, done, expected: step(done, expected, activity),
                say=say,
            )
    except KeyboardInterrupt:
        rest = ",".join(missing(out, names))
        say(f"finished parts are in {out}; continue with --out {out} --only {rest}")
        raise
    if as_json:
        print(json.dumps(results["rows"], indent=2, ensure_ascii=False))
        return
    for kind in ("result", "claim", "input"):
        print(f"{kind}s of the paper: {tally([row for row in results['rows'] if row['kind'] == kind])}")
    print(f"interpretation: {interpretation.text()}")
    if results["missing"]:
        print(f"not run: {', '.join(results['missing'])}")
    print("wrote " + ", ".join(str(out / name) for name in (HTML, MARKDOWN, RESULTS)) + " and the figures")
