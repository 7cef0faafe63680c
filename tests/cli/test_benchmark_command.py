"""``cablebot benchmark``: files, resume, interrupts, third parties, bad input."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.suites import Block, Suite
from cablebot_gym.cli import app as cli

PLANAR = "CableBot-Planar-v0"
TINY = Suite(name="tiny", summary="circle", env_ids=(PLANAR,), blocks=(Block(),))

TOYS = """
import os, signal
from cablebot_baselines.classical import FL, FeedbackLinearization

def raises(robot):
    class Raises(FeedbackLinearization):
        def _control(self, part, mass, state, episode_start):
            raise RuntimeError("lost")
    return Raises(robot)

def deadly(robot):
    class Deadly(FeedbackLinearization):
        def reset(self, tasks):
            os.kill(os.getpid(), signal.SIGKILL)
    return Deadly(robot)

def interrupted(robot):
    class Interrupted(FeedbackLinearization):
        def reset(self, tasks):
            if not tasks[0].payload_known:
                os.kill(os.getpid(), signal.SIGINT)
    return Interrupted(robot)
"""


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
def benchmark(monkeypatch, capsys, tmp_path):
    """Runs the command in this process on a tiny suite, with one worker: this process."""
    monkeypatch.setattr(suites, "SUITES", {"tiny": TINY, **suites.SUITES})
    (tmp_path / "toy_command.py").write_text(TOYS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)

    def run(*arguments, policies="fl", out=tmp_path / "out", workers=1):
        options = ["--suite", "tiny", "--policies", policies, "--out", out, "--workers", workers, *arguments]
        monkeypatch.setattr(sys, "argv", ["cablebot", "benchmark", *map(str, options)])
        status = 0
        try:
            cli.main()
        except SystemExit as ended:
            status = ended.code or 0
        stdout, stderr = capsys.readouterr()
        return SimpleNamespace(status=status, out=stdout, err=stderr, folder=out)

    yield run
    sys.modules.pop("toy_command", None)


def is_alive(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def scores(ended):
    cells = json.loads((ended.folder / "results.json").read_text(encoding="utf-8"))["cells"]
    return {
        (cell["cell"]["policy"], cell["cell"].get("payload_known")): cell["score"] for cell in cells if "score" in cell
    }


def test_files_and_table_have_the_same_numbers(benchmark, best):
    ended = benchmark()
    assert ended.status == 0
    known, unknown = scores(ended)[("fl", True)], scores(ended)[("fl", False)]
    assert known == pytest.approx(1.92 / 2.4, abs=2e-3)
    for text in (ended.out, (ended.folder / "leaderboard.md").read_text(encoding="utf-8")):
        assert f"1.92, {known:.0%}" in text
        assert f"0.66, {unknown:.0%}" in text
    assert len((ended.folder / "results.csv").read_text(encoding="utf-8").splitlines()) == 3
    assert len(best) == 1


def test_json_is_not_mixed_with_anything_else(benchmark, best):
    ended = benchmark("--json")
    assert ended.out == (ended.folder / "results.json").read_text(encoding="utf-8")
    assert json.loads(ended.out)["suite"] == "tiny"


def test_second_run_computes_nothing_and_gives_the_same_bytes(benchmark, best, monkeypatch):
    first = benchmark()
    before = {name: (first.folder / name).read_bytes() for name in ("results.json", "results.csv", "leaderboard.md")}
    monkeypatch.setattr("cablebot_gym.benchmark.cells.evaluate_dlcc", None)
    again = benchmark()
    assert (again.status, again.out) == (0, first.out)
    assert len(best) == 1
    assert {name: (first.folder / name).read_bytes() for name in before} == before


def test_broken_cell_is_reported_and_computed_again(benchmark, best):
    first = benchmark()
    path = next(first.folder.glob("cells/*-fl-payload-known-*"))
    path.write_text("{")
    again = benchmark()
    assert (again.status, again.out) == (0, first.out)
    assert str(path) in again.err.replace("\n", "")
    assert len(best) == 1


def test_other_code_is_said_and_can_be_taken(benchmark, best):
    first = benchmark()
    for path in first.folder.glob("cells/*-fl-*"):
        path.rename(path.with_name(path.name[: -len("0123456789abcdef.json")] + "0" * 16 + ".json"))
    again = benchmark()
    assert "2 cells exist only with results of different code: they are computed again" in again.err
    assert len(list(first.folder.glob("cells/*"))) == 5
    assert len(best) == 1


def test_policy_of_a_third_party_that_fails_costs_its_cells_alone(benchmark, best):
    ended = benchmark(policies="toy_command:raises,fl")
    assert ended.status == 1
    assert scores(ended)[("toy_command:raises", True)] is None
    assert scores(ended)[("fl", True)] > 0.5
    assert "raised RuntimeError" in ended.out
    assert "failed" in ended.out


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_policy_of_a_third_party_that_kills_its_process_costs_its_cells_alone(benchmark):
    ended = benchmark(policies="toy_command:deadly,fl", workers=2)
    assert ended.status == 1
    assert "its process died 2 times" in ended.out
    assert "1.92" in ended.out
    assert len(list(ended.folder.glob("cells/*fl-*known*"))) == 2


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_keeps_what_is_done_and_says_how_to_go_on(benchmark, best):
    ended = benchmark(policies="toy_command:interrupted")
    assert ended.status == cli.INTERRUPTED
    assert "2 of 3 cells are finished and stored in" in ended.err
    assert (
        f"Resume with: cablebot benchmark --suite tiny --policies toy_command:interrupted --out {ended.folder}"
        in ended.err
    )
    assert not (ended.folder / "results.json").exists()
    assert len(list(ended.folder.glob("cells/*"))) == 2


def test_interrupt_before_anything_is_done_does_not_name_a_folder_that_is_not_there(benchmark, monkeypatch):
    def stopped(cell):
        raise KeyboardInterrupt

    monkeypatch.setattr("cablebot_gym.benchmark.engine.compute", stopped)
    ended = benchmark()
    assert ended.status == cli.INTERRUPTED
    assert "No cell is finished yet. Start again with: cablebot benchmark --suite tiny" in ended.err
    assert not ended.folder.exists()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_of_a_run_with_workers_leaves_no_process(tmp_path):
    start = (
        f"import signal, cablebot_gym.cli.app as c; signal.signal({int(signal.SIGINT)}, signal.default_int_handler); "
    )
    arguments = ("benchmark", "--suite", "standard", "--ids", PLANAR, "--policies", "fl", "--workers", "2")
    process = subprocess.Popen(
        [sys.executable, "-c", start + "c.main()", *arguments, "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while not any(tmp_path.glob("cells/*-fl-*")) and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, err = process.communicate(timeout=60)
    assert process.returncode == cli.INTERRUPTED, err
    assert "Traceback" not in err
    assert "Resume with: cablebot benchmark --suite standard" in err
    while is_alive(process.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not is_alive(process.pid)


def test_page_goes_where_it_is_asked_for(benchmark, best, tmp_path):
    ended = benchmark("--page", tmp_path / "LEADERBOARD.md")
    assert (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8").startswith("# Leaderboard")
    assert not (ended.folder / "leaderboard.md").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--suite", "huge"), "unknown suite 'huge'; choose one of tiny, smoke, standard, full"),
        (("--policies", "nobody"), "unknown policy 'nobody'"),
        (("--policies", "nowhere.to:find"), "cannot import 'nowhere.to'"),
        (("--ids", "CableBot-Round-v0"), "unknown environment"),
        (("--workers", "0"), "workers must be at least 1, not 0"),
        (("--ray", "auto"), "--workers and --ray exclude each other"),
        (("--out", "/dev/null/out"), "cannot write to folder"),
    ],
)
def test_bad_input_is_one_sentence_before_any_work(benchmark, best, arguments, message):
    ended = benchmark(*arguments)
    assert (ended.status, ended.out) == (2, "")
    assert message in ended.err
    assert len(ended.err.splitlines()) == 1
    assert best == []
    assert not ended.folder.exists()


def test_folder_in_the_place_of_a_file_is_refused_before_any_work(benchmark, best):
    ended = benchmark()
    for name in ("results.json", "results.csv", "leaderboard.md"):
        (ended.folder / name).unlink()
        (ended.folder / name).mkdir()
        refused = benchmark()
        assert refused.status == 2
        assert "it is a folder" in refused.err
        (ended.folder / name).rmdir()
