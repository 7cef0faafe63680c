"""Renderer of equations as MathML. Browsers show MathML without scripts and without network
access."""

from __future__ import annotations

import re
from unicodedata import normalize

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

_DOTTED = re.compile(r'<mover accent="true">\s*<mi[^>]*>(.)</mi>\s*<mo[^>]*>([˙¨])</mo>\s*</mover>')

_COMBINING = {"˙": "\N{COMBINING DOT ABOVE}", "¨": "\N{COMBINING DIAERESIS}"}


def setup(app: Sphinx) -> None:
    """Registers the renderer ``mathml``."""
    app.add_html_math_renderer(
        "mathml", inline_renderers=(inline, None), block_renderers=(block, None)
    )


def inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Renders an inline equation."""
    translator.body.append(_readable(tex2mathml(node.astext())))
    raise nodes.SkipNode


def block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Renders a display equation."""
    equation = _readable(tex2mathml(node.astext(), as_block=True))
    translator.body.append(
        f'<div class="math" style="margin: 0.8em 0; overflow-x: auto">{equation}</div>\n'
    )
    raise nodes.SkipNode


def _readable(mathml: str) -> str:
    """MathML with dots merged into their letters; dots as accents vanish if no mathematical font is
    installed."""

    def letter(match: re.Match[str]) -> str:
        dotted = normalize("NFC", match[1] + _COMBINING[match[2]])
        return f'<mi style="font-style: italic">{dotted}</mi>'

    return _DOTTED.sub(letter, mathml).replace("<mo>'</mo>", "<mo>′</mo>")
