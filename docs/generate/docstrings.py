"""Sphinx event handlers that adapt docstrings, which are written for Python's ``help()``, to
reStructuredText."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

from cablebot_gym.envs.single import CableBotEnv
from generate.environments import manual

_BAR = re.compile(r"(``.*?``)|\|")


def setup(app: Sphinx) -> None:
    """Connects the event handlers of this module."""
    # before napoleon reads it, at 500
    app.connect("autodoc-process-docstring", docstring, priority=400)
    app.connect("autodoc-process-bases", bases)


def docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escapes the lines of a docstring for reStructuredText, in place."""
    if obj is CableBotEnv:  # its docstring is Markdown
        lines[:] = [
            manual()[0],
            "",
            "The manual is on the page of each environment, and in ``help(env.unwrapped)``.",
        ]
    # Bars mark absolute values; reStructuredText would read them as substitutions.
    lines[:] = _BAR.sub(lambda match: match[1] or r"\|", "\n".join(lines)).split("\n")
    # napoleon reads words before a colon in the first line as a type
    if what in ("attribute", "data", "property"):
        lines.insert(0, r"\ ")


def bases(app: Sphinx, name: str, obj: Any, options: Any, classes: list[Any]) -> None:
    """Removes the type arguments of base classes, in place."""
    classes[:] = [getattr(base, "__origin__", base) for base in classes]
