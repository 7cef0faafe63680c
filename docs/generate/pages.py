"""Generated files, and a function that formats Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import Leaderboard, leaderboards

RESULTS = Path(__file__).parents[1] / "leaderboard" / "results.json"


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


def table(rows: Iterable[Sequence[str]]) -> str:
    """Markdown table; the first row is the header."""
    head, *body = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    lines = [head, ["---"] * len(head), *body]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


@cache
def all_leaderboards() -> tuple[Leaderboard, ...]:
    """The tables of the stored leaderboard."""
    results = Results.from_json(RESULTS.read_text(encoding="utf-8"))
    return tuple(leaderboards(results.records))
