"""The stored reproduction in reproduction/docs against a new one, its rows and its page."""

import json
import math
import re
from itertools import chain
from pathlib import Path

import pytest

from cablebot_reproduction.contents import PARTS
from cablebot_reproduction.engine import MARKDOWN, RESULTS, reproduce
from cablebot_reproduction.findings import rows
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.page import markdown

FOLDER = Path(__file__).parents[1] / "docs"
AGAIN = "refresh it: cablebot reproduce --out reproduction/docs"

TOLERANCES = {
    # an unstable loop amplifies rounding
    r"^(fig14|fig15|fig9|fig7)\.(eq22|closed_loop)_": (1e-3, 0.05),
    # geometries on the border of what counts
    r"^scan\.(with_equilibrium|with_positive_payload|hits)": (2.0, 0.005),
    r"_kg$": (1.1e-3, 1e-6),  # the resolution of a search
    r"": (1e-6, 1e-3),
}
"""Absolute and relative difference between machines, by the name of a number."""


@pytest.fixture(scope="module")
def stored():
    return json.loads((FOLDER / RESULTS).read_text())


@pytest.fixture(scope="session")
def new(tmp_path_factory):
    """The whole reproduction, computed once, by worker processes."""
    return reproduce(Interpretation(), tmp_path_factory.mktemp("reproduction"))


def is_close(name, stored, new):
    absolute, relative = next(
        bounds for pattern, bounds in TOLERANCES.items() if re.search(pattern, name)
    )
    if absolute > 1.5 or (isinstance(stored, float) and isinstance(new, float)):
        return math.isclose(stored, new, abs_tol=absolute, rel_tol=relative)
    return stored == new


def test_rows_and_page_follow_the_stored_numbers(stored):
    assert rows(Interpretation(), stored["numbers"]) == stored["rows"], AGAIN
    assert all(row["ours"] and row["verdict"] and row["evidence"] for row in stored["rows"])
    assert (FOLDER / MARKDOWN).read_text() == markdown(stored), AGAIN


def test_stored_reproduction_is_complete(stored):
    assert [part["name"] for part in stored["parts"]] == [part.name for part in PARTS]
    assert stored["missing"] == []
    figures = {part["figure"] for part in stored["parts"]}
    assert figures - {None} == {path.stem for path in FOLDER.glob("*.svg")}


@pytest.mark.slow
def test_new_numbers_and_verdicts_are_the_stored_ones(stored, new):
    assert list(stored["numbers"]) == list(new["numbers"]), AGAIN
    for name, value in stored["numbers"].items():
        assert is_close(name, value, new["numbers"][name]), (name, AGAIN)
    for before, now in zip(stored["rows"], new["rows"], strict=True):
        for field in ("key", "printed", "interpretation", "verdict", "command"):
            assert before[field] == now[field], AGAIN


@pytest.mark.slow
def test_new_parts_are_the_stored_ones(stored, new):
    for before, now in zip(stored["parts"], new["parts"], strict=True):
        for field in ("name", "title", "text", "figure"):
            assert before[field] == now[field], AGAIN
        for old_table, new_table in zip(before["tables"], now["tables"], strict=True):
            assert old_table["title"] == new_table["title"], AGAIN
            assert old_table["header"] == new_table["header"], AGAIN
            old_cells = list(chain.from_iterable(old_table["rows"]))
            new_cells = list(chain.from_iterable(new_table["rows"]))
            for old_cell, new_cell in zip(old_cells, new_cells, strict=True):
                assert isinstance(old_cell, str) or is_close("_kg", old_cell, new_cell), (
                    before["name"],
                    old_cell,
                )
