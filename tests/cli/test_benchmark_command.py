"""``cablebot benchmark``: files, resume, interrupts and failing policies. Bad input is in
test_commands."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.cells import PolicyCell, compute
from cablebot_gym.benchmark.suites import Block, Suite
from cablebot_gym.cli import app as cli
from cablebot_gym.isolation import IsolatedPolicy

PLANAR = "CableBot-Planar-v0"
CHANGES = {"payload_max": 4.0}
BLOCKS = (Block(conditions={"payload_known": [True, False], **CHANGES}),)
TINY = Suite(name="tiny", summary="circle", env_ids=(PLANAR,), blocks=BLOCKS)
TIMED = replace(TINY, name="timed", blocks=(Block(conditions=CHANGES),), timing=True)
HIDDEN = Suite(
    name="hidden",
    summary="hidden motions",
    env_ids=(PLANAR,),
    blocks=(
        Block(motion="hidden", motions=2, conditions=CHANGES),
        Block(
            conditions={
                "payload_known": False,
                "uncertainty": "sensors",
                "draws": 64,
                **CHANGES,
            }
        ),
    ),
)


@pytest.fixture
def best(monkeypatch):
    """Stands for the search, which has tests of its own; counts how often it is asked."""
    searches = []

    def find_best_known(env_id, *, robot, trajectory, error_bounds, control_frequency):
        searches.append(trajectory)
        best_known = {
            "payload": 2.4,
            "total_mass": 3.4,
            "verified": True,
            "upper": {"payload": 3.3, "total_mass": 4.3},
        }
        return SimpleNamespace(to_dict=lambda: best_known)

    monkeypatch.setitem(
        sys.modules,
        "cablebot_gym.bounds.best_known",
        SimpleNamespace(find_best_known=find_best_known),
    )
    return searches


@pytest.fixture
def isolated_benchmark(monkeypatch, cablebot, tmp_path):
    """Runs the command in this process on a tiny suite, with one worker: this process. Policies are
    isolated."""
    monkeypatch.setattr(
        suites, "SUITES", {entry.name: entry for entry in (TINY, TIMED, HIDDEN)} | suites.SUITES
    )

    def run(*arguments, policies="fl", workers=1, suite="tiny"):
        options = (
            "--suite",
            suite,
            "--policies",
            policies,
            "--out",
            tmp_path / "out",
            "--workers",
            workers,
        )
        ended = cablebot("benchmark", *options, *arguments)
        return SimpleNamespace(
            status=ended.status, out=ended.out, err=ended.err, folder=tmp_path / "out"
        )

    return run


@pytest.fixture
def benchmark(isolated_benchmark, inline):
    """The same with policies in this process."""
    return isolated_benchmark


def scores(ended):
    cells = json.loads((ended.folder / "results.json").read_text(encoding="utf-8"))["cells"]
    return {
        (cell["cell"]["policy"], cell["cell"].get("payload_known")): cell["score"]
        for cell in cells
        if "score" in cell
    }


def test_files_table_and_json_have_the_same_numbers(benchmark, best, tmp_path):
    ended = benchmark("--page", tmp_path / "LEADERBOARD.md")
    assert not (ended.folder / "leaderboard.md").exists()
    assert ended.status == 0
    known = scores(ended)[("fl", True)]
    unknown = scores(ended)[("fl", False)]
    assert known == pytest.approx(1.91 / 2.4, abs=0.03)
    for text in (ended.out, (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8")):
        assert f"{2.4 * known:.2f}, {known:.0%}" in text
        assert f"{2.4 * unknown:.2f}, {unknown:.0%}" in text
    assert len(best) == 1
    assert benchmark("--json").out == (ended.folder / "results.json").read_text(encoding="utf-8")


def test_second_run_computes_nothing_and_gives_the_same_bytes(benchmark, best, monkeypatch):
    computed = benchmark()
    before = {
        name: (computed.folder / name).read_bytes() for name in ("results.json", "leaderboard.md")
    }
    monkeypatch.setattr("cablebot_gym.benchmark.cells.evaluate_dlcc", None)
    again = benchmark()
    assert again.status == 0
    assert again.out == computed.out
    assert len(best) == 1
    assert {name: (computed.folder / name).read_bytes() for name in before} == before


CAUSES = {
    "ends": "its process ended with exit status 0",
    "killed": "its process was ended by SIGKILL",
    "hangs": "it did not answer within 5 s",
}
"""Why each toy policy whose process ends or hangs fails."""


def check_failures(ended, toys, causes):
    """Each of the policies loses its own cells, and ``fl`` none."""
    assert ended.status == 1
    score_of = scores(ended)
    for name, cause in causes.items():
        assert score_of[(toys(name), True)] == 0.0
        assert score_of[(toys(name), False)] == 0.0
        assert cause in ended.out
    assert score_of[("fl", True)] > 0.5
    assert "failed" in ended.out


def test_policy_that_fails_costs_its_own_cells_only(benchmark, best, toys):
    causes = {"raises": "it raised RuntimeError", "exits": "it raised SystemExit: 0"}
    check_failures(benchmark(policies=",".join([*map(toys, causes), "fl"])), toys, causes)


@pytest.mark.slow
def test_policy_whose_process_fails_costs_its_own_cells_only(
    isolated_benchmark, best, toys, monkeypatch
):
    monkeypatch.setitem(IsolatedPolicy.__init__.__kwdefaults__, "deadline", 5.0)
    check_failures(isolated_benchmark(policies=",".join([*map(toys, CAUSES), "fl"])), toys, CAUSES)


def test_failed_timing_is_a_note_and_costs_no_exit_status(benchmark, best, monkeypatch):
    def fails(*arguments, **keywords):
        raise ValueError("no time")

    monkeypatch.setattr("cablebot_gym.benchmark.cells.time_actions", fails)
    ended = benchmark(suite="timed")
    assert ended.status == 0
    assert "fl failed on CableBot-Planar-v0: no time" in ended.out


def test_interrupt_keeps_finished_cells_and_says_how_to_resume(benchmark, best, monkeypatch):
    def interrupted(cell):
        if isinstance(cell, PolicyCell) and not cell.payload_known:
            raise KeyboardInterrupt
        return compute(cell)

    monkeypatch.setattr("cablebot_gym.benchmark.engine.compute", interrupted)
    ended = benchmark()
    assert ended.status == cli.INTERRUPTED
    assert "2 of 3 cells are finished and stored in" in ended.err
    assert (
        f"Resume with: cablebot benchmark --suite tiny --policies fl --out {ended.folder}"
        in ended.err
    )
    assert not (ended.folder / "results.json").exists()
    assert len(list(ended.folder.glob("cells/*"))) == 2


def test_folder_in_place_of_a_file_is_found_before_the_work(benchmark, best, tmp_path):
    (tmp_path / "out" / "results.json").mkdir(parents=True)
    refused = benchmark()
    assert refused.status == 2
    assert best == []
    assert "it is a folder" in refused.err


def test_hidden_suite_needs_a_commitment(benchmark, best):
    without = benchmark(suite="hidden")
    assert without.status == 2
    assert best == []
    assert "--commit VERSION" in without.err
    committed = benchmark("--commit", "2026-1", suite="hidden")
    secret = json.loads((committed.folder / "secret.json").read_text(encoding="utf-8"))
    assert committed.status == 0
    assert best == []
    assert secret["secret"] not in committed.out + (committed.folder / "board.json").read_text(
        encoding="utf-8"
    )
    refused = benchmark(suite="hidden", policies="fl,adaptive")
    assert refused.status == 2
    assert best == []
    assert "committed without the present adaptive" in refused.err
    for option in (("--seed", 1), ("--any-source",)):
        assert "accepts neither --seed nor --any-source" in benchmark(*option, suite="hidden").err


@pytest.mark.slow
def test_board_is_run_published_and_verified(benchmark, best, cablebot):
    secret = json.loads(
        (benchmark("--commit", "1", suite="hidden").folder / "secret.json").read_text(
            encoding="utf-8"
        )
    )
    ended = benchmark(suite="hidden")
    assert ended.status == 0
    page = (ended.folder / "leaderboard.md").read_text(encoding="utf-8")
    assert "## Board 1" in page
    assert secret["secret"] in page
    verify = ("benchmark", "--verify", ended.folder, "--draws", 64, "--workers", 1)
    good = cablebot(*verify)
    assert good.status == 0
    assert good.out.count("promised") == 1
    assert "the secret matches the commitment" in good.out
    path = ended.folder / "results.json"
    results = json.loads(path.read_text(encoding="utf-8"))
    (drawn,) = (cell for cell in results["cells"] if cell["cell"].get("uncertainty"))
    drawn["result"]["payload"] += 1.0
    path.write_text(json.dumps(results), encoding="utf-8")
    bad = cablebot(*verify)
    assert bad.status == 1
    assert "0 of 1 payloads keep their promise" in bad.out
    results["board"]["secret"] = "0" * 32
    path.write_text(json.dumps(results), encoding="utf-8")
    assert "does not match its commitment" in cablebot(*verify).message(2)
