"""``cablebot validate``."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.cli.options import Json
from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.console import print_table, say


def validate(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Study: ttk4900, gch-klaus, irma or innopolis.")
    ],
    logs: Annotated[
        Path | None,
        "Folder with the files of the logs, such as a copy of their repository. The default "
        "downloads them into the cache.",
    ] = None,
    out: Annotated[Path | None, "Figure to write (.svg, .png, .pdf)."] = None,
    as_json: Json = False,
) -> None:
    """Compare the model with public logs of a real robot.

    ttk4900: friction of the winches, from motor currents. gch-klaus: cable lengths, against motion
    capture. irma: natural frequencies of a platform on two, three and four cables. innopolis: sag
    under three loads. The files are checked by their SHA-256. They are not part of this project.

    Examples:

    cablebot validate ttk4900

    cablebot validate gch-klaus --logs cable-robot --out klaus.svg
    """
    from cablebot_gym.plotting.figures import DPI, import_matplotlib
    from cablebot_gym.utils.files import atomic_write, check_writable_file
    from cablebot_winches.reality import STUDIES
    from cablebot_winches.reality.comparison import table
    from cablebot_winches.reality.sources import SOURCES, read_logs

    study = STUDIES[choice("study", name, STUDIES)]
    if out is not None:
        if out.suffix not in (".svg", ".png", ".pdf"):
            raise ValueError(f"--out must end in .svg, .png or .pdf, not {out.name!r}")
        check_writable_file(out)
        import_matplotlib()
    if logs is not None and not logs.is_dir():
        raise ValueError(f"--logs {str(logs)!r} is no folder: name the folder with the files")
    source = SOURCES[name]
    result = study(read_logs(source, logs))
    if as_json:
        print(json.dumps(result.to_dict(name, source), indent=2, ensure_ascii=False))
    else:
        title = f"{name}: model and robot, github.com/{source.repository} at {source.commit[:7]}"
        print_table(title, table(result.comparisons))
        print("\n".join(result.notes))
    if out is not None:
        figure = result.draw()
        atomic_write(out, partial(figure.savefig, dpi=DPI, format=out.suffix[1:]))
        say(f"wrote {out}")
