"""Where generated files go, and what they are made of."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path


class Folder:
    """A folder that holds, once left without an error, what was written meanwhile and nothing else.

    A text that has not changed keeps its file, so that Sphinx does not read it again.
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
        """Where to write a file of this name, such as a picture."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        self._written.add(path)
        return path

    def write(self, name: str, text: str) -> None:
        """Writes a page, or a part of one (suffix ``.inc``) for another to include."""
        path = self.path(name)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def table(rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first row is its head."""
    head, *body = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    lines = [head, ["---"] * len(head), *body]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def number(value: float) -> str:
    """As a page says it."""
    return f"{value:.6g}".replace("-", "−")


def numbers(values: Iterable[float]) -> str:
    """A vector as a page says it."""
    return f"({', '.join(number(round(value, 6) + 0.0) for value in values)})"
