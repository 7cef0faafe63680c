"""``cablebot reproduce``."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_gym.utils.console import command_line, notes_console, progress
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.texts import OPTIONS


def reproduce(
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            help="Parts to run, for example fig10,interpretations,scan; all parts if not given.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Output folder for results.json, the page and the figures.")
    ] = Path("reproduction"),
    workers: Annotated[
        int | None, typer.Option(help="Number of processes; one per core if not given.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON.")] = False,
    **choices: Any,
) -> None:
    """Reproduce the tables, figures and claims of the paper and compare them with the published
    values.

    Writes one PNG and SVG per figure, results.json and the page (Markdown and HTML). The choices
    that the paper leaves open are options of this command.

    Examples:

    cablebot reproduce --out reproduction

    cablebot reproduce --only fig10,fig11 --payload total --line flat --out flat
    """
    from cablebot_reproduction.engine import missing
    from cablebot_reproduction.engine import reproduce as run

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
                progress=step,
                say=say,
            )
    except KeyboardInterrupt:
        remaining = ",".join(missing(out, names))
        command = command_line(
            "reproduce", only=remaining, out=out, workers=workers, **interpretation.changed()
        )
        say(f"finished parts are in {out}; continue with: {command}")
        raise
    if as_json:
        print(json.dumps(results["rows"], indent=2, ensure_ascii=False))
    else:
        _print_summary(interpretation, results, out)


def _print_summary(interpretation: Interpretation, results: dict[str, Any], out: Path) -> None:
    from cablebot_reproduction.engine import HTML, MARKDOWN, RESULTS
    from cablebot_reproduction.page import tally

    for kind in ("result", "claim", "input"):
        rows = [row for row in results["rows"] if row["kind"] == kind]
        print(f"{kind}s of the paper: {tally(rows)}")
    print(f"interpretation: {interpretation.text()}")
    if results["missing"]:
        print(f"not run: {', '.join(results['missing'])}")
    print(f"wrote {out / HTML}, {out / MARKDOWN}, {out / RESULTS} and the figures")


def _option(name: str) -> inspect.Parameter:
    """Command-line option of one choice."""
    default = getattr(Interpretation, name)
    entry = OPTIONS[name]
    kind: Any = type(default)
    annotation = Annotated[
        kind, typer.Option(help=entry["help"].format(choices=", ".join(entry["texts"])))
    ]
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )


_only, _out, _workers, _json, _ = inspect.signature(reproduce, eval_str=True).parameters.values()
reproduce.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
    [
        _only,
        _out,
        _workers,
        *map(_option, OPTIONS),
        _json.replace(kind=inspect.Parameter.KEYWORD_ONLY),
    ]
)
