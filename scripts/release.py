"""Checks that the tree is ready to be published and that its stored results are those of this code,
and makes the README's links absolute for its page on PyPI.

python scripts/release.py [v0.1.0] [--absolute-links]
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from pathlib import Path

import tested

from cablebot_gym import __version__

ROOT = Path(__file__).resolve().parents[1]
URLS = ("Repository", "Documentation", "Issues", "Changelog")
"""Addresses in ``[project.urls]`` that a release must have."""


def problems(tag: str, version: str, changelog: str, urls: dict[str, str]) -> list[str]:
    """What keeps a version from being published, each with its cure; empty if nothing does."""
    faults = []
    if tag != f"v{version}":
        faults.append(
            f"the tag is {tag!r}, the version {version!r}: set __version__ in cablebot_gym/__init__.py"
        )
    section = re.search(
        rf"^## \[{re.escape(version)}\](.*)\n((?:(?!## ).*\n?)*)", changelog, re.MULTILINE
    )
    if section is None or not section[2].strip():
        faults.append(
            f"CHANGELOG.md has no section for this version: write '## [{version}] - YYYY-MM-DD' and its lines"
        )
    elif not re.fullmatch(r" - \d{4}-\d\d-\d\d", section[1]):
        faults.append(
            f"the section of CHANGELOG.md has no date: write '## [{version}] - YYYY-MM-DD'"
        )
    missing = [name for name in URLS if not urls.get(name, "").startswith("https://")]
    if missing:
        faults.append(
            f'[project.urls] in pyproject.toml lacks {", ".join(missing)}: write {missing[0]} = "https://…"'
        )
    return faults


def absolute_links(readme: str, repository: str, tag: str) -> str:
    """The README for PyPI, which has no files beside it: relative links and pictures lead to the
    tag's files."""

    def link(match: re.Match[str]) -> str:
        folder = "blob"
        if match["picture"]:
            folder = "raw"
        return f"{match['picture']}{match['text']}({repository}/{folder}/{tag}/"

    return re.sub(r"(?P<picture>!?)(?P<text>\[[^\]]*\])\((?!https?:|#)", link, readme)


def main() -> None:
    """Exits with a list of problems, if there are any."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument(
        "tag", nargs="?", default=f"v{__version__}", help="the tag that is published"
    )
    parser.add_argument(
        "--absolute-links",
        action="store_true",
        help="rewrite README.md, only where it is published",
    )
    arguments = parser.parse_args()
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"].get(
        "urls", {}
    )
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    faults = problems(arguments.tag, __version__, changelog, urls)
    if tested.changed(["evidence"]) and not tested.run("evidence"):
        faults.append("the stored results are not those of this code: compute them anew")
    if faults:
        sys.exit("\n* ".join(["Not ready to be published:", *faults]))
    if arguments.absolute_links:
        readme = ROOT / "README.md"
        text = absolute_links(readme.read_text(encoding="utf-8"), urls["Repository"], arguments.tag)
        readme.write_text(text, encoding="utf-8")
    print(f"{arguments.tag} is ready to be published")


if __name__ == "__main__":
    main()
