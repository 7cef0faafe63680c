"""The folder of generated files, and functions that format Markdown tables and numbers."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path


class Folder:
    """Context manager of a folder; an exit without an error deletes all files that the block did not write.

    A file with unchanged text is not rewritten, so that Sphinx does not read it again.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._written: set[Path] = set()

    def __enter__(self) -> Folder:
        self.root.mkdir(exist_ok=True)
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None:
            return
        for path in self.root.rglob("*"):
            if path.is_file() and path not in self._written:
                path.unlink()
        for path in sorted(self.root.iterdir()):
            if path.is_dir() and not any(item.is_file() for item in path.rglob("*")):
                shutil.rmtree(path)

    def path(self, name: str) -> Path:
        """Path of a file to write, such as a picture. Creates its parent folders and keeps the file on exit."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        self._written.add(path)
        return path

    def write(self, name: str, text: str) -> None:
        """Writes a page, or a fragment (suffix ``.inc``) that another page includes."""
        path = self.path(name)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def table(rows: Iterable[Sequence[str]]) -> str:
    """Markdown table; the first row is the header."""
    head, *body = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    lines = [head, ["---"] * len(head), *body]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def number(value: float) -> str:
    """Number with six significant digits and a typographic minus sign."""
    return f"{value:.6g}".replace("-", "−")


def numbers(values: Iterable[float]) -> str:
    """Vector in parentheses, rounded to six decimals."""
    return f"({', '.join(number(round(value, 6) + 0.0) for value in values)})"
