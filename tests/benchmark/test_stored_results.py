"""Results in docs: the pages follow from the stored results, the cells are those of the suites, and samples still hold.

The last line of each page is the command that computes it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, compute
from cablebot_gym.benchmark.leaderboard import markdown, read_results, results_json
from cablebot_gym.benchmark.suites import find_policies, find_suite, suite_cells
from cablebot_gym.benchmark.tables import csv_text, print_benchmark

ROOT = Path(__file__).parents[2]
PAGES = {
    "leaderboard": ROOT / "LEADERBOARD.md",
    "maps": ROOT / "docs" / "maps" / "leaderboard.md",
    "paper-maps": ROOT / "docs" / "paper-maps" / "leaderboard.md",
}


@pytest.fixture(scope="module")
def results():
    def read(name):
        return read_results((ROOT / "docs" / name / "results.json").read_text(encoding="utf-8"))

    return {name: read(name) for name in PAGES}


@pytest.mark.parametrize("name", PAGES)
def test_page_and_table_follow_from_the_results(results, name):
    folder, again = ROOT / "docs" / name, f"run {results[name][1]}"
    assert PAGES[name].read_text(encoding="utf-8") == markdown(*results[name]), again
    assert (folder / "results.csv").read_text(encoding="utf-8") == csv_text(results[name][2]), again
    assert (folder / "results.json").read_text(encoding="utf-8") == results_json(*results[name]), again


@pytest.mark.parametrize(("name", "suite"), [("leaderboard", "standard"), ("paper-maps", "paper-maps")])
def test_results_have_the_cells_of_the_suite_without_errors(results, name, suite):
    suite = find_suite(suite)
    cells = suite_cells(suite, find_policies([], suite.env_ids))
    assert results[name][0] == suite.name
    assert [record.cell.key for record in results[name][2]] == list(cells)
    assert [record.error for record in results[name][2] if record.error] == []
    known = [record.result for record in results[name][2] if isinstance(record.cell, BestKnownCell)]
    assert all(result["verified"] for result in known)


def of_policies(records, *conditions):
    def matches(cell):
        return (cell.env_id, cell.policy, cell.payload_model, cell.criterion, cell.uncertainty) in conditions

    return [record for record in records if isinstance(record.cell, PolicyCell) and matches(record.cell)]


CHEAP = (
    ("CableBot-Planar-v0", "fl", "payload known", "task", None),
    ("CableBot-Spatial-v0", "fl", "payload known", "paper", None),
    ("CableBot-FlexSpatial-v0", "composite", "payload model × 0.9", "task", None),
)
SLOW = (
    ("CableBot-Planar-v0", "trajopt", "payload unknown", "task", None),
    ("CableBot-Spatial-v0", "robust-tuned", "payload unknown", "task", None),
)


def assert_reproduced(records):
    for record in records:
        made = compute(record.cell).result
        expected = (
            None
            if record.result["payload"] is None
            else pytest.approx(record.result["payload"], abs=2 * made["resolution"])
        )
        assert made["payload"] == expected, f"compute the results again: {record.cell}"


def on_circle(records):
    return [record for record in records if str(record.cell.trajectory["name"]).startswith("paper-")]


@pytest.mark.parametrize("conditions", [*CHEAP, *(pytest.param(one, marks=pytest.mark.slow) for one in SLOW)])
def test_payload_of_the_leaderboard_is_reproduced(results, conditions):
    (record,) = on_circle(of_policies(results["leaderboard"][2], conditions))
    assert_reproduced([record])


@pytest.mark.slow
def test_payloads_of_the_paper_maps_are_reproduced(results):
    records = results["paper-maps"][2]
    assert_reproduced(records[::10])


@pytest.mark.slow
def test_best_known_payload_is_reproduced(results):
    (record,) = (
        record
        for record in results["leaderboard"][2]
        if isinstance(record.cell, BestKnownCell) and record.cell.trajectory["name"] == "paper-planar"
        if record.cell.env_id == "CableBot-Planar-v0"
    )
    assert compute(record.cell).result["payload"] == pytest.approx(record.result["payload"], rel=2e-3)


def test_terminal_has_every_map(results, capsys):
    suite, command, records = results["maps"]
    print_benchmark(records)
    printed = capsys.readouterr().out
    sections = [text.splitlines()[0] for text in markdown(suite, command, records).split("\n## ")[1:]]
    maps = [title for title in sections if "payload by" in title]
    assert len(maps) == 10  # error bound and duration for four ids, stiffness for two
    assert all(title in printed for title in maps)
