"""A Sphinx extension that writes what can be computed into ``docs/generated/``: pages, tables and pictures."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from cablebot_gym.envs.single import CableBotEnv
from generate import environments, figures, modules, policies, tables
from generate.folder import Folder


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("builder-inited", write_all)
    app.connect("source-read", point_inside)
    app.connect("autodoc-process-docstring", readable, priority=400)  # before napoleon reads them, at 500
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def readable(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are written to be read in Python; here what Sphinx would take for something else is put right."""
    if obj is CableBotEnv:  # its docstring is Markdown, the manual
        lines[:] = [environments.manual()[0], "", "The manual is on the page of each environment, and in ``help``."]
    bar = re.compile(r"(``.*?``)|\|")  # of an absolute value, and no substitution of reStructuredText's
    lines[:] = bar.sub(lambda found: found[1] or r"\|", "\n".join(lines)).split("\n")
    if what in ("attribute", "data", "property"):  # napoleon takes words before a first line's colon for a type
        lines.insert(0, "")


def write_all(app: Sphinx) -> None:
    """Everything that pages in ``docs/`` refer to; what an earlier build left and this one does not make is removed."""
    with Folder(Path(app.srcdir) / "generated") as folder:
        for part in (environments, policies, modules, tables, figures):
            part.write(folder)


def point_inside(app: Sphinx, name: str, source: list[str]) -> None:
    """Pages link to what stands at the top of the repository; here these are pages of the site."""
    source[0] = source[0].replace("](../LEADERBOARD.md)", "](/leaderboard.md)")
