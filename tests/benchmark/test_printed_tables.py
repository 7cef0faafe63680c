"""The benchmark in the terminal: what the page says is printed too."""

from __future__ import annotations

from pathlib import Path

import pytest

from cablebot_gym.benchmark.leaderboard import markdown, read_results
from cablebot_gym.benchmark.tables import print_benchmark

FOLDER = Path(__file__).parents[2] / "docs" / "maps"


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.replace("┃", "│").replace("|", "│").split("│")[1:-1]]


@pytest.fixture(scope="module")
def results():
    return read_results((FOLDER / "results.json").read_text(encoding="utf-8"))


def test_maps_in_the_terminal_lack_no_row_of_the_page(results, capsys):
    suite, command, records = results
    print_benchmark(records)
    printed = capsys.readouterr().out
    page = markdown(suite, command, records).split("\n## ")[1:]
    maps = [section for section in page if "payload by" in section.splitlines()[0]]
    assert len(maps) == 10  # tube and duration of four ids, springs of two
    for section in maps:
        title, *lines = section.splitlines()
        assert title in printed
        for line in lines:
            if line.startswith("|") and "---" not in line:
                assert cells(line) in [cells(other) for other in printed.splitlines()]
