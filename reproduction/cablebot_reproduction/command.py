"""``cablebot reproduce``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.utils.console import progress


def reproduce(
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Parts to run, for example fig10,scan; all if not given."),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Output folder for results.json, the page and the figures.")
    ] = Path("reproduced"),
) -> None:
    """Reproduce the figures, numbers and claims of the paper and compare them with the published
    values.

    Writes one SVG per figure, results.json and a page in Markdown.

    Examples:

    cablebot reproduce --out reproduced

    cablebot reproduce --only fig10,fig11
    """
    from cablebot_reproduction.page import tally
    from cablebot_reproduction.run import PAGE, run

    names = [name.strip() for text in only or [] for name in text.split(",")]
    with progress("computing", "parts") as step:
        results = run(out, names, progress=step)
    for kind in ("result", "claim"):
        rows = [row for row in results["rows"] if row["kind"] == kind]
        if rows:
            print(f"{kind}s of the paper: {tally(rows)}")
    print(f"wrote {out / PAGE}, results.json and the figures")
