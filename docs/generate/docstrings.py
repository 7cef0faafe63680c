"""Docstrings are written to be read in Python: what Sphinx would take for something else is put right here."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

from cablebot_gym.envs.single import CableBotEnv
from generate.environments import manual

LONGEST_VALUE = 200
"""Of a constant, to be shown [characters]."""

_BAR = re.compile(r"(``.*?``)|\|")

_NDARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[~?(?:\w+\.)?(\w+)\]\]"
)

_ARRAY_LIKE = re.compile(
    r"~?[\w.]*_Buffer \| ~?[\w.]*_SupportsArray.*?\| ~?[\w.]*_NestedSequence\[complex \| bytes \| str\]"
)


def setup(app: Sphinx) -> None:
    """Connects the functions below."""
    app.connect("autodoc-process-docstring", docstring, priority=400)  # before napoleon reads it, at 500
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-process-bases", bases)
    app.connect("doctree-read", shorter)


def docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Changes the lines in place."""
    if obj is CableBotEnv:  # its docstring is Markdown
        lines[:] = [manual()[0], "", "The manual is on the page of each environment, and in ``help(env.unwrapped)``."]
    # Bars are of absolute values; reStructuredText takes them for substitutions.
    lines[:] = _BAR.sub(lambda found: found[1] or r"\|", "\n".join(lines)).split("\n")
    if what in ("attribute", "data", "property"):  # napoleon takes words before the first line's colon for a type
        lines.insert(0, r"\ ")


def signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Types by the names that the code has for them."""
    return arguments and _named(arguments), returns and _named(returns)


def bases(app: Sphinx, name: str, obj: Any, options: Any, classes: list[Any]) -> None:
    """Base classes without their type arguments, in place."""
    classes[:] = [getattr(one, "__origin__", one) for one in classes]


def shorter(app: Sphinx, doctree: nodes.document) -> None:
    """Types so in the annotations of attributes, which have no signature; values that fill half a page are left out."""
    for node in list(doctree.findall(addnodes.desc_annotation)):
        text = node.astext()
        if len(text) > LONGEST_VALUE:
            node.parent.remove(node)
        elif _named(text) != text:
            node.children = []
            node += nodes.Text(_named(text))


def _named(text: str) -> str:
    def array(found: re.Match[str]) -> str:
        return "Array" if found[1] in ("Any", "float64") else f"NDArray[{found[1]}]"

    return _ARRAY_LIKE.sub("ArrayLike", _NDARRAY.sub(array, text))
