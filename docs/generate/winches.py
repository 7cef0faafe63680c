"""The pages of cablebot-winches. Their links lead to files as a forge shows them."""

from __future__ import annotations

import re
from os.path import relpath
from pathlib import Path

from generate.pages import Pages

FOLDER = Path(__file__).parents[2] / "winches" / "docs"

_FILE = re.compile(r"(?<=\]\()([^)#:]+)(?=[)#])")


def write(pages: Pages) -> None:
    """Writes each page with links that lead to the same files from its new place."""
    for page in FOLDER.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        pages.write(f"winches/{page.name}", _FILE.sub(lambda file: _moved(file[1], pages), text))


def _moved(file: str, pages: Pages) -> str:
    """A link to a file from the folder of the generated pages."""
    if file.endswith(".md") and "/" not in file:
        return file
    return Path(relpath(FOLDER / file, pages.root / "winches")).as_posix()
