"""``cablebot benchmark``: files, resume, interrupts and failing policies. Bad input is in test_commands."""

from __future__ import annotations

import json
import os
import sys
from types import SimpleNamespace

import pytest

from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.suites import Block, Suite
from cablebot_gym.cli import app as cli

PLANAR = "CableBot-Planar-v0"
TINY = Suite(name="tiny", summary="circle", env_ids=(PLANAR,), blocks=(Block(),))


@pytest.fixture
def best(monkeypatch):
    """Stands for the search, which has tests of its own; counts how often it is asked."""
    asked = []

    def find_best_known(env_id, *, trajectory, error_bounds, control_frequency):
        asked.append(trajectory)
        found = {"payload": 2.4, "total_mass": 3.4, "verified": True, "upper": {"payload": 3.3, "total_mass": 4.3}}
        return SimpleNamespace(to_dict=lambda: found)

    monkeypatch.setitem(sys.modules, "cablebot_gym.bounds.best_known", SimpleNamespace(find_best_known=find_best_known))
    return asked


@pytest.fixture
def benchmark(monkeypatch, cablebot, tmp_path):
    """Runs the command in this process on a tiny suite, with one worker: this process."""
    monkeypatch.setattr(suites, "SUITES", {"tiny": TINY, **suites.SUITES})

    def run(*arguments, policies="fl", workers=1):
        options = ("--suite", "tiny", "--policies", policies, "--out", tmp_path / "out", "--workers", workers)
        ended = cablebot("benchmark", *options, *arguments)
        return SimpleNamespace(status=ended.status, out=ended.out, err=ended.err, folder=tmp_path / "out")

    return run


def scores(ended):
    cells = json.loads((ended.folder / "results.json").read_text(encoding="utf-8"))["cells"]
    return {
        (cell["cell"]["policy"], cell["cell"].get("payload_known")): cell["score"] for cell in cells if "score" in cell
    }


def test_files_table_and_json_have_the_same_numbers(benchmark, best, tmp_path):
    ended = benchmark("--page", tmp_path / "LEADERBOARD.md")
    assert not (ended.folder / "leaderboard.md").exists()
    assert ended.status == 0
    known, unknown = scores(ended)[("fl", True)], scores(ended)[("fl", False)]
    assert known == pytest.approx(1.92 / 2.4, abs=2e-3)
    for text in (ended.out, (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8")):
        assert f"1.92, {known:.0%}" in text
        assert f"0.66, {unknown:.0%}" in text
    assert len((ended.folder / "results.csv").read_text(encoding="utf-8").splitlines()) == 3
    assert len(best) == 1
    assert benchmark("--json").out == (ended.folder / "results.json").read_text(encoding="utf-8")


def test_second_run_computes_nothing_and_gives_the_same_bytes(benchmark, best, monkeypatch):
    first = benchmark()
    before = {name: (first.folder / name).read_bytes() for name in ("results.json", "results.csv", "leaderboard.md")}
    monkeypatch.setattr("cablebot_gym.benchmark.cells.evaluate_dlcc", None)
    again = benchmark()
    assert (again.status, again.out) == (0, first.out)
    assert len(best) == 1
    assert {name: (first.folder / name).read_bytes() for name in before} == before


def test_policy_that_raises_costs_its_own_cells_only(benchmark, best, toys):
    ended = benchmark(policies="cli_toys:raises,fl")
    assert ended.status == 1
    assert scores(ended)[("cli_toys:raises", True)] is None
    assert scores(ended)[("fl", True)] > 0.5
    assert "raised RuntimeError" in ended.out
    assert "failed" in ended.out


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_keeps_finished_cells_and_says_how_to_resume(benchmark, best, toys):
    ended = benchmark(policies="cli_toys:interrupted_second")
    assert ended.status == cli.INTERRUPTED
    assert "2 of 3 cells are finished and stored in" in ended.err
    assert (
        f"Resume with: cablebot benchmark --suite tiny --policies cli_toys:interrupted_second --out {ended.folder}"
        in ended.err
    )
    assert not (ended.folder / "results.json").exists()
    assert len(list(ended.folder.glob("cells/*"))) == 2


def test_folder_in_place_of_a_file_is_found_before_the_work(benchmark, best, tmp_path):
    (tmp_path / "out" / "results.csv").mkdir(parents=True)
    refused = benchmark()
    assert (refused.status, best) == (2, [])
    assert "it is a folder" in refused.err
