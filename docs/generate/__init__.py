"""A Sphinx extension that writes what can be computed into ``docs/generated/``: pages, tables and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from generate import docstrings, environments, figures, mathml, modules, policies, report, tables
from generate.folder import Folder


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    mathml.setup(app)
    app.connect("builder-inited", write_all)
    app.connect("source-read", point_inside)
    app.connect("builder-inited", report.write)
    docstrings.setup(app)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_all(app: Sphinx) -> None:
    """Everything that pages in ``docs/`` refer to; what an earlier build left and this one does not make is removed."""
    with Folder(Path(app.srcdir) / "generated") as folder:
        for part in (environments, policies, modules, tables, figures):
            part.write(folder)


def point_inside(app: Sphinx, name: str, source: list[str]) -> None:
    """Pages link to what stands at the top of the repository; here these are pages of the site."""
    source[0] = source[0].replace("](../LEADERBOARD.md)", "](/leaderboard.md)")
