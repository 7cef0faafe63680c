"""``cablebot best-known``: what it prints where, its exit status, its cache, and Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cablebot_gym.bounds import best_known
from cablebot_gym.cli import app as cli

pytest.importorskip("casadi")

PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"
LINE = ("--trajectory", '{"name": "line-planar", "duration": 0.4}')


@pytest.fixture(autouse=True)
def quick(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of the test's own; two meshes and no certificate."""
    monkeypatch.setattr(best_known, "MESH_TOLERANCE", 1.0)
    upper = {"payload": 98.5, "total_mass": 99.5, "conditions": "none"}
    monkeypatch.setattr(best_known, "planar_certificate", lambda *_: SimpleNamespace(to_dict=lambda: upper))


@pytest.fixture
def bound(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Any:
    """Runs the command in this process, and hears what the solver's own code prints too."""

    def run(*arguments: Any) -> SimpleNamespace:
        monkeypatch.setattr(sys, "argv", ["cablebot", "best-known", *map(str, arguments)])
        status: Any = 0
        try:
            cli.main()
        except SystemExit as ended:
            status = ended.code or 0
        out, err = capfd.readouterr()
        return SimpleNamespace(status=status, out=out, err=err)

    return run


def one_line(ended: SimpleNamespace, status: int) -> str:
    """The sentence on standard error; asserts that there is nothing else."""
    lines = [line for line in ended.err.splitlines() if line.strip()]
    assert len(lines) == 1, ended.err
    assert lines[0].startswith("cablebot: ")
    assert (ended.out, ended.status) == ("", status)
    return str(lines[0])


def test_json_does_not_come_with_anything_else_and_is_not_found_twice(
    bound: Any, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = (PLANAR, *LINE, "--position-bound", "0.02", "--control-frequency", "250", "--json")
    first = bound(*options)
    assert (first.status, first.err) == (0, "")
    data = json.loads(first.out, parse_constant=pytest.fail)
    assert {"payload", "total_mass", "error_bounds", "verified"} <= set(data)
    assert data["verified"] is True
    assert data["total_mass"] == data["payload"] + 1.0
    assert data["error_bounds"] == {"position": 0.02, "rotation": None}
    assert data["environment"]["control_frequency"] == 250.0
    assert data["environment"]["trajectory"]["duration"] == 0.4
    assert len(list(cache.iterdir())) == 1
    monkeypatch.setattr(best_known._Case, "solve", lambda *_: pytest.fail("searched again"))
    assert bound(*options).out == first.out


def test_text_for_people_does_not_lack_what_the_number_is(bound: Any, cache: Path) -> None:
    ended = bound(PLANAR, *LINE, "--no-cache")
    assert (ended.status, ended.err) == (0, "")
    for words in ("best known payload", "kg", "10 mm", "verified by replay", "a lower bound", "98.500 kg"):
        assert words in ended.out
    assert not cache.exists()


def test_rotation_bound_is_not_read_and_forgotten(bound: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def find_best_known(*arguments: Any, **keywords: Any) -> Any:
        asked.append((arguments, keywords))
        raise ValueError("enough")

    monkeypatch.setattr(best_known, "find_best_known", find_best_known)
    assert one_line(bound(SPATIAL, "--rotation-bound", "0.03", "--no-cache"), 2) == "cablebot: enough"
    ((arguments, keywords),) = asked
    assert arguments == (SPATIAL,)
    assert keywords["error_bounds"] == {"position": 0.01, "rotation": 0.03}
    assert keywords["cache"] is False


def test_what_no_replay_carries_does_not_end_with_status_0(bound: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(best_known, "replay", lambda *_: SimpleNamespace(carried=False))
    ended = bound(PLANAR, *LINE, "--json")
    assert ended.status == 1
    assert json.loads(ended.out)["verified"] is False


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((PLANAR, "--position-bound", "0"), "--position-bound must be a number greater than 0"),
        ((PLANAR, "--rotation-bound", "nan"), "--rotation-bound must be a number greater than 0"),
        ((PLANAR, "--trajectory", '{"name": "circle-planar", "radius": 0.7}'), "leaves the workspace"),
        ((PLANAR, "--trajectory", "paper-spatial"), "is not for 2 coordinates"),
        ((PLANAR, "--trajectory", "nowhere"), "unknown trajectory 'nowhere'"),
        ((PLANAR, "--trajectory", '{"name": "paper-planar", "duration": 0.5}'), "infeasible even unloaded"),
        ((PLANAR, "--trajectory", "dwell-planar"), "nothing limits the payload"),
        ((PLANAR, "--control-frequency", "0"), "--control-frequency must give at least one step"),
        (("CableBot-Cubic-v0",), "CableBot-Planar-v0"),
    ],
)
@pytest.mark.parametrize("more", [(), ("--json",)], ids=["text", "json"])
def test_bad_input_does_not_end_otherwise_than_with_a_sentence(
    bound: Any, arguments: tuple[str, ...], said: str, more: tuple[str, ...]
) -> None:
    assert said in one_line(bound(*arguments, *more), 2)


def test_missing_casadi_does_not_end_without_the_command_that_installs_it(
    bound: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    assert "pip install 'cablebot-gym[optimal]'" in one_line(bound(PLANAR), 2)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_is_not_lost_in_the_solver(bound: Any, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(best_known, "INTERVALS_PER_SECOND", 150.0)  # so that the first program takes seconds
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(1.5, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        ended = bound(SPATIAL)
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)
    assert "interrupted" in one_line(ended, 130)
    assert not cache.exists()
