"""Sphinx extension that generates pages, tables and pictures in ``docs/generated/``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from generate import docstrings, environments, figures, mathml, modules, policies, report, tables
from generate.folder import Folder


def setup(app: Sphinx) -> dict[str, Any]:
    """Registers the extension; Sphinx calls this function."""
    mathml.setup(app)
    app.connect("builder-inited", write_all)
    app.connect("source-read", rewrite_links)
    app.connect("builder-inited", report.write)
    docstrings.setup(app)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_all(app: Sphinx) -> None:
    """Writes all generated files and deletes files of earlier builds that this build does not write."""
    with Folder(Path(app.srcdir) / "generated") as folder:
        for module in (environments, policies, modules, tables, figures):
            module.write(folder)


def rewrite_links(app: Sphinx, name: str, source: list[str]) -> None:
    """Replaces links to files at the top of the repository by links to pages of the site."""
    source[0] = source[0].replace("](../LEADERBOARD.md)", "](/leaderboard.md)")
