"""Sphinx extension that generates pages, tables and pictures in ``docs/generated/``."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from generate import (
    clients,
    docstrings,
    environments,
    mathml,
    policies,
    report,
    robots,
    sources,
    tables,
    training,
    winches,
)
from generate.pages import Pages


def setup(app: Sphinx) -> dict[str, Any]:
    """Registers the extension; Sphinx calls this function."""
    mathml.setup(app)
    docstrings.setup(app)
    sources.setup(app)
    app.connect("builder-inited", write_all)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_all(app: Sphinx) -> None:
    """Writes all generated files anew. Autodoc comes later, because Gymnasium sees its objects for
    default values."""
    folder = Path(app.srcdir) / "generated"
    shutil.rmtree(folder, ignore_errors=True)
    for module in (clients, environments, policies, robots, tables, training, winches):
        module.write(Pages(folder))
    if app.builder.format == "html":
        report.write(Path(app.outdir))
