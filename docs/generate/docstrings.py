"""Sphinx event handlers that adapt docstrings, signatures and annotations for the API pages.

The docstrings are written for Python's ``help()``; Sphinx would misread some of their characters.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

from cablebot_gym.envs.single import CableBotEnv
from generate.environments import manual

LONGEST_VALUE = 200
"""Maximum length of the shown value of a constant [characters]."""

_BAR = re.compile(r"(``.*?``)|\|")

_NDARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[~?(?:\w+\.)?(\w+)\]\]"
)

_ARRAY_LIKE = re.compile(
    r"~?[\w.]*_Buffer \| ~?[\w.]*_SupportsArray.*?\| ~?[\w.]*_NestedSequence\[complex \| bytes \| str\]"
)


def setup(app: Sphinx) -> None:
    """Connects the event handlers of this module."""
    app.connect("autodoc-process-docstring", docstring, priority=400)  # before napoleon reads it, at 500
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-process-bases", bases)
    app.connect("doctree-read", shorten_annotations)


def docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escapes the lines of a docstring for reStructuredText, in place."""
    if obj is CableBotEnv:  # its docstring is Markdown
        lines[:] = [manual()[0], "", "The manual is on the page of each environment, and in ``help(env.unwrapped)``."]
    # Bars mark absolute values; reStructuredText would read them as substitutions.
    lines[:] = _BAR.sub(lambda match: match[1] or r"\|", "\n".join(lines)).split("\n")
    if what in ("attribute", "data", "property"):  # napoleon reads words before a colon in the first line as a type
        lines.insert(0, r"\ ")


def signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Signature with the type names of the code instead of their expansions."""
    return arguments and _simplify_types(arguments), returns and _simplify_types(returns)


def bases(app: Sphinx, name: str, obj: Any, options: Any, classes: list[Any]) -> None:
    """Removes the type arguments of base classes, in place."""
    classes[:] = [getattr(base, "__origin__", base) for base in classes]


def shorten_annotations(app: Sphinx, doctree: nodes.document) -> None:
    """Simplifies the types in annotations of attributes and removes values longer than ``LONGEST_VALUE``."""
    for node in list(doctree.findall(addnodes.desc_annotation)):
        text = node.astext()
        if len(text) > LONGEST_VALUE:
            node.parent.remove(node)
        elif _simplify_types(text) != text:
            node.children = []
            node += nodes.Text(_simplify_types(text))


def _simplify_types(text: str) -> str:
    def array(match: re.Match[str]) -> str:
        return "Array" if match[1] in ("Any", "float64") else f"NDArray[{match[1]}]"

    return _ARRAY_LIKE.sub("ArrayLike", _NDARRAY.sub(array, text))
