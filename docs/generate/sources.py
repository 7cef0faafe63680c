"""Adapts the hand-written pages, which are plain Markdown that a forge shows too, to the site:
contents and links."""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

from cablebot_gym import ENV_IDS
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import ELASTIC, library

DOCS = Path(__file__).parents[1]

REPORT = (
    '<p><a href="report.html">The leaderboard as a page to sort and filter</a>, with recorded '
    "episodes.</p>\n\n"
)

HOME = {
    "LEADERBOARD.md": "/leaderboard.md",
    "CHANGELOG.md": "/project.md#changelog",
    "CONTRIBUTING.md": "/project.md#contributing",
    "winches/README.md": "/winches.md",
}
"""Files that the README links to, and their pages."""

GENERATED = {
    "environments": "environments",
    "policies": "policies",
    "robots": "robots",
    "training": "clients",
    "winches": "winches",
}
"""Pages, and the folder of the generated pages below each."""

PAPER = {
    "reproduction.md": "#results-of-the-reproduction",
    "errata.md": "#errata-of-the-paper",
}
"""Files of the page about the paper, and the headings over them."""

_FILE = re.compile(r"^\[.*\]\((\.\./[\w/]+\.md)\)\.?$", re.MULTILINE)
_HEADING = re.compile(r"^#+(?= )", re.MULTILINE)
_PAPER = re.compile(r"\]\((?:docs/)?(reproduction\.md|errata\.md)\)")
_FIGURE = re.compile(r"\]\((\w+\.svg)\)")
_CELL = re.compile(r"(?<=\| )`[\w-]+`(?:, `[\w-]+`)*(?= \|)")
_CODE = re.compile(r"`([\w-]+)`")
_LINK = re.compile(r"(?<=\]\()(?!https?:)([^)#]+)")
_OBJECT = re.compile(r"(?<![}`\w])`(cablebot_(?:gym|baselines)(?:\.\w+)+)`(?!`)")


def setup(app: Sphinx) -> None:
    """Connects the event handler of this module."""
    app.connect("source-read", adapt)


def adapt(app: Sphinx, name: str, source: list[str]) -> None:
    """Adapts the text of a Markdown page, in place.

    * A paragraph that is only a link to a file outside of this folder is replaced by that file. Its
      headings are below the heading over the link.
    * Names of environments, policies and real robots in the cells of tables link to their pages.
    * Full names of objects of this project, such as ``cablebot_gym.task.Task``, link to the API
      reference.
    * The home page is the README, with the contents of the site; the pages of :data:`GENERATED` get
      the list of their generated pages.
    """
    if not str(app.env.doc2path(name)).endswith(".md"):
        return

    def file(match: re.Match[str]) -> str:
        path = DOCS / match[1]
        app.env.note_dependency(path, docname=name)
        _, _, text = path.read_text(encoding="utf-8").partition("\n")  # the page has its own title
        if name == "index":
            return _LINK.sub(lambda link: _from_home(link[1]), text)
        above = _HEADING.findall(match.string[: match.start()])[-1]
        text = _HEADING.sub(lambda heading: above + heading[0][1:], text)
        folder, _, _ = match[1].rpartition("/")
        text = _FIGURE.sub(rf"]({folder}/\1)", text)
        text = _PAPER.sub(lambda link: f"]({PAPER[link[1]]})", text)
        if path.parent.name == "winches":
            text = text.replace("](../README.md)", "](index.md)")
            return text.replace("](docs/", "](generated/winches/")
        return text.replace("](docs/", "](")

    text = _FILE.sub(file, source[0]).replace("](../LEADERBOARD.md)", "](/leaderboard.md)")
    text = _CELL.sub(lambda cell: _CODE.sub(_linked, cell[0]), text)
    if name != "project":  # the changelog has names that are gone
        text = _OBJECT.sub(r"{py:obj}`~\1`", text)
    if name == "index":
        text += "\n" + (DOCS / "contents.inc").read_text(encoding="utf-8")
    if name in GENERATED:
        text += f"\n```{{toctree}}\n:hidden:\n:glob:\n\ngenerated/{GENERATED[name]}/*\n```\n"
    if name == "leaderboard":
        title, _, body = text.partition("\n")
        text = f"{title}\n\n{REPORT}{body}"
    source[0] = text


def _from_home(link: str) -> str:
    """A link of the README as one of the home page."""
    return HOME.get(link) or (f"../{link}").replace("../docs/", "")


def _linked(code: re.Match[str]) -> str:
    """The name of an environment, policy or real robot with a link to its page; other code as it
    stands."""
    for folder, names in (
        ("environments", ENV_IDS),
        ("policies", policy_entries()),
        ("robots", library()),
    ):
        name = code[1]
        if folder == "robots":
            name = name.removeprefix(ELASTIC)
        if name in names:
            return f"[{code[0]}](/generated/{folder}/{name}.md)"
    return code[0]
