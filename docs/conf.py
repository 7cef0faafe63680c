"""Sphinx configuration. Build with ``sphinx-build -W --keep-going -q -b html docs FOLDER`` (extra
``docs``).

The extension ``generate/`` in this folder generates the pages of environments, policies and modules
from the installed package.
"""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

ROOT = Path(__file__).parents[1]
PUBLIC_MODULES = (ROOT / "docs" / "public_modules.txt").read_text(encoding="utf-8").split()
"""Modules with a page, from which other packages may import."""


def internal_modules() -> dict[str, str]:
    """The modules of cablebot_gym without a page, and the path of each, relative to this folder.

    A package has a page if a module in it has one.
    """
    public = [f"{module}." for module in PUBLIC_MODULES]
    internal = {}
    for path in sorted((ROOT / "cablebot_gym").rglob("*.py")):
        file = path.relative_to(ROOT)
        module = ".".join(file.with_suffix("").parts).removesuffix(".__init__")
        if not any(name.startswith(f"{module}.") for name in public):
            internal[module] = f"../{file}"
    return internal


INTERNAL = internal_modules()

project = "cablebot_gym"
author = "The cablebot_gym authors"
version = release = version_of("cablebot-gym")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "generate",
    "sphinx.ext.apidoc",
]
exclude_patterns = ["leaderboard"]

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

# Sphinx mocks packages that are not installed, so that a missing extra removes no page.
autodoc_mock_imports = [
    name for name in ("torch", "stable_baselines3", "casadi") if find_spec(name) is None
]
# Sphinx checks all references except classes of other packages, short type names, type variables
# and private names.
nitpicky = True
nitpick_ignore_regex = [
    (r"py:(class|exc)", r"(?!cablebot_gym|cablebot_baselines).*"),
    (r"py:.*", r"(.*\.)?(_.*|AnyCell)"),
    (r"py:.*", rf"({'|'.join(INTERNAL)})(\..*)?"),  # docstrings of public modules may mention them
    (r"py:obj", r"cablebot_gym\.commands"),  # a group of entry points
    (r"py:obj", r"typing\.Annotated\[.*"),  # types of options, cut at their texts
]

# A page for each public module. The extension "generate" empties the folder first.
apidoc_separate_modules = True
apidoc_module_first = True
apidoc_automodule_options = {"members", "show-inheritance"}
apidoc_modules = [
    {
        "path": "../cablebot_gym",
        "destination": "generated/api/gym",
        "exclude_patterns": list(INTERNAL.values()),
    },
    {
        "path": "../baselines/cablebot_baselines",
        "destination": "generated/api/baselines",
    },
]

autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
autodoc_member_order = "bysource"
# a package does not repeat what its modules document
autodoc_default_options = {"ignore-module-all": True}
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
napoleon_numpy_docstring = False

html_theme = "furo"
html_math_renderer = "mathml"
html_title = f"cablebot_gym {release}"
html_show_copyright = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_search_scorer = str(Path(__file__).parent / "generate" / "scorer.js")
html_theme_options = {
    "light_css_variables": {"figure-filter": "none"},
    # White becomes the background of the dark theme.
    "dark_css_variables": {"figure-filter": "invert(0.92) hue-rotate(180deg)"},
}
