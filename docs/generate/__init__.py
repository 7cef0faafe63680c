"""Sphinx extension that generates pages, tables and pictures in ``docs/generated/``."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from generate import docstrings, environments, figures, mathml, policies, report, tables
from generate.pages import Pages


def setup(app: Sphinx) -> dict[str, Any]:
    """Registers the extension; Sphinx calls this function."""
    mathml.setup(app)
    docstrings.setup(app)
    app.connect("builder-inited", write_all)
    app.connect("source-read", rewrite_links)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_all(app: Sphinx) -> None:
    """Writes all generated files anew. Autodoc comes later, because Gymnasium sees its objects for default values."""
    folder = Path(app.srcdir) / "generated"
    shutil.rmtree(folder, ignore_errors=True)
    for module in (environments, policies, tables, figures):
        module.write(Pages(folder))
    if app.builder.format == "html":
        report.write(Path(app.outdir))


def rewrite_links(app: Sphinx, name: str, source: list[str]) -> None:
    """Replaces links to files at the top of the repository by links to pages of the site."""
    source[0] = source[0].replace("](../LEADERBOARD.md)", "](/leaderboard.md)")
