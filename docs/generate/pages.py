"""Generated files, and the results that they show."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from cablebot_gym.benchmark.scores import Leaderboard, leaderboards
from cablebot_gym.benchmark.store import Results, read


class Pages:
    """The folder of the generated files."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def path(self, name: str) -> Path:
        """Path of a file to write, in an existing folder."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def write(self, name: str, text: str) -> None:
        """Writes a page, or a fragment (suffix ``.inc``) that another page includes."""
        self.path(name).write_text(text, encoding="utf-8")


@cache
def ranked() -> Results:
    """The results of the leaderboard."""
    return read(Path(__file__).parents[1] / "results" / "ranked.jsonl")


@cache
def all_leaderboards() -> tuple[Leaderboard, ...]:
    """The tables of the leaderboard."""
    return tuple(leaderboards(ranked().rows))
