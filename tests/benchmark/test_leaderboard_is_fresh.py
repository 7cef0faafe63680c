"""The leaderboard in the repository: made of the results beside it, of the standard suite, and of numbers that hold.

``cablebot benchmark --suite standard --out docs/leaderboard --page LEADERBOARD.md`` makes it anew.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, compute
from cablebot_gym.benchmark.leaderboard import markdown, read_results, results_json
from cablebot_gym.benchmark.suites import find_policies, find_suite, suite_cells
from cablebot_gym.benchmark.tables import csv_text

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "leaderboard"
AGAIN = "make it anew: cablebot benchmark --suite standard --out docs/leaderboard --page LEADERBOARD.md"

CHEAP = (
    ("CableBot-Planar-v0", "fl", "payload known", "task"),
    ("CableBot-Planar-v0", "trajopt", "payload unknown", "task"),
    ("CableBot-Spatial-v0", "robust-tuned", "payload unknown", "task"),
    ("CableBot-Spatial-v0", "fl", "payload known", "paper"),
    ("CableBot-FlexSpatial-v0", "composite", "payload model × 0.9", "task"),
)


@pytest.fixture(scope="module")
def results():
    return read_results((FOLDER / "results.json").read_text(encoding="utf-8"))


def test_page_and_table_are_those_of_the_results(results):
    assert (ROOT / "LEADERBOARD.md").read_text(encoding="utf-8") == markdown(*results), AGAIN
    assert (FOLDER / "results.csv").read_text(encoding="utf-8") == csv_text(results[2]), AGAIN
    assert (FOLDER / "results.json").read_text(encoding="utf-8") == results_json(*results), AGAIN


def test_page_and_table_of_the_maps_are_those_of_their_results():
    folder = ROOT / "docs" / "maps"
    made = read_results((folder / "results.json").read_text(encoding="utf-8"))
    again = f"make it anew: {made[1]}"
    assert (folder / "leaderboard.md").read_text(encoding="utf-8") == markdown(*made), again
    assert (folder / "results.csv").read_text(encoding="utf-8") == csv_text(made[2]), again
    assert (folder / "results.json").read_text(encoding="utf-8") == results_json(*made), again


def test_results_are_those_of_the_standard_suite_and_of_every_installed_policy(results):
    suite = find_suite("standard")
    cells = suite_cells(suite, find_policies([], suite.env_ids))
    assert results[0] == "standard"
    assert [record.cell.key for record in results[2]] == list(cells), AGAIN


def test_every_best_known_payload_is_there_and_verified_and_no_policy_failed(results):
    assert [record.error for record in results[2] if record.error] == []
    assert all(record.result["verified"] for record in results[2] if not isinstance(record.cell, PolicyCell))


@pytest.mark.parametrize("asked", CHEAP, ids="-".join)
def test_payload_is_still_what_the_code_carries(results, asked):
    def conditions(cell):
        return cell.env_id, cell.policy, cell.payload_model, cell.criterion

    (golden,) = (
        record
        for record in results[2]
        if isinstance(record.cell, PolicyCell)
        and conditions(record.cell) == asked
        and record.cell.uncertainty is None
        and str(record.cell.trajectory["name"]).startswith("paper-")
    )
    made = compute(golden.cell)
    assert made.result["payload"] == pytest.approx(golden.result["payload"], abs=2 * made.result["resolution"]), AGAIN


def test_best_known_payload_is_still_what_the_code_finds(results):
    (golden,) = (
        record
        for record in results[2]
        if isinstance(record.cell, BestKnownCell)
        and record.cell.trajectory["name"] == "paper-planar"
        and record.cell.env_id == "CableBot-Planar-v0"
    )
    assert compute(golden.cell).result["payload"] == pytest.approx(golden.result["payload"], rel=2e-3), AGAIN
