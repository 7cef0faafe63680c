"""``cablebot benchmark``: files, resume, interrupts and failing policies. Bad input is in
test_commands."""

import json
import re
import sys
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.scores import scores as find_scores
from cablebot_gym.benchmark.store import read
from cablebot_gym.benchmark.suites import Override, Suite

PLANAR = "CableBot-Planar-v0"
SLOW = {"control_frequency": 250.0}
CIRCLE = Override(motion="circle", conditions=SLOW)
UNKNOWN = replace(CIRCLE, conditions=SLOW | {"payload_known": False})
TINY = Suite(name="tiny", summary="circle", env_ids=(PLANAR,), overrides=(CIRCLE, UNKNOWN))
HIDDEN = replace(TINY, name="hidden", overrides=(Override(motion="hidden", motions=2),))


@pytest.fixture
def best(monkeypatch):
    """Stands for the searches, which have tests of their own; counts how often one is asked."""
    optimum = SimpleNamespace(payload=2.4, meshes=[(20, 2.4)])
    optima = SimpleNamespace(find_optimum=lambda *_, **__: optimum)
    monkeypatch.setitem(sys.modules, "cablebot_gym.bounds.optimum", optima)
    best_known = {"payload": 2.4, "total_mass": 3.4, "verified": True, "replays": []}
    search = Mock(return_value=Mock(to_dict=lambda: best_known))
    module = SimpleNamespace(find_best_known=search)
    monkeypatch.setitem(sys.modules, "cablebot_gym.bounds.best_known", module)
    return search


@pytest.fixture
def benchmark(monkeypatch, cablebot, tmp_path, inline):
    """Runs the command in this process on a tiny suite, with one worker and policies in this process
    too."""
    known = {suite.name: suite for suite in (TINY, HIDDEN)}
    monkeypatch.setattr(suites, "SUITES", known | suites.SUITES)
    out = tmp_path / "out"

    def run(*arguments, policies="fl", suite="tiny"):
        line = f"benchmark --suite {suite} --policies {policies} --out {out} --workers 1"
        ended = cablebot(line, *arguments)
        return SimpleNamespace(status=ended.status, out=ended.out, err=ended.err, folder=out)

    return run


def scores(ended):
    """Scores by policy, and whether the payload is known."""
    values = {}
    for score in find_scores(read(ended.folder / "tiny.jsonl").rows):
        values[score.row.policy, score.conditions.payload_known] = score.score
    return values


@pytest.mark.landing
def test_files_and_table_have_the_same_numbers(benchmark, best):
    ended = benchmark()
    assert ended.status == 0
    fractions = [scores(ended)["fl", known] for known in (True, False)]
    assert fractions[0] == pytest.approx(1.91 / 2.4, abs=0.03)
    for text in (ended.out, (ended.folder / "tiny.md").read_text()):
        for fraction in fractions:
            assert f"{2.4 * fraction:.2f}, {fraction:.0%}" in text
    best.assert_called_once()


@pytest.mark.landing
def test_check_finds_a_changed_payload_and_a_missing_row(benchmark, best, cablebot, cache):
    benchmark()
    path = benchmark().folder / "tiny.jsonl"
    *others, _, last = path.read_text().splitlines()
    row = json.loads(last)
    row["result"]["payload"] += 0.1
    path.write_text("\n".join([*others, json.dumps(row)]))
    checked = cablebot(f"benchmark --check 3 --out {path.parent} --workers 1")
    assert checked.status == 1
    assert checked.out.count("equal: ") == 2
    message = "1 row missing, 0 not in the suite, 1 with another payload"
    assert message in " ".join(checked.err.split())


@pytest.mark.landing
def test_policy_that_fails_costs_its_own_rows_only(benchmark, best, toys):
    causes = {"raises": "it raised RuntimeError", "exits": "it raised SystemExit: 0"}
    ended = benchmark(policies=",".join([*map(toys, causes), "fl"]))
    assert ended.status == 1
    score_of = scores(ended)
    for name, cause in causes.items():
        assert score_of[toys(name), True] == score_of[toys(name), False] == 0.0
        assert cause in ended.out
    assert score_of["fl", True] > 0.5
    assert "failed" in ended.out


@pytest.mark.landing
def test_due_rows_alone_are_computed_again(benchmark, best, cablebot):
    folder = benchmark().folder
    path = folder / "tiny.jsonl"
    *others, last = path.read_text().splitlines()
    others = [line.replace('"seconds": ', '"seconds": 7') for line in others]
    due = re.sub(r'"code": "\w+"', '"code": "other"', last)
    path.write_text("\n".join([*others, due]) + "\n")
    assert cablebot(f"benchmark --due --out {folder} --workers 1").status == 0
    *others_again, again = path.read_text().splitlines()
    assert others_again == others
    assert json.loads(again)["code"] == json.loads(last)["code"]
    assert json.loads(again)["result"] == json.loads(last)["result"]


@pytest.mark.landing
def test_seed_text_is_stored_and_shown(benchmark, best):
    ended = benchmark("--seed-text", "a headline", suite="hidden")
    assert ended.status == 0
    assert read(ended.folder / "hidden.jsonl").seed_text == "a headline"
    page = (ended.folder / "hidden.md").read_text()
    assert '`"a headline"`' in page
    assert "--seed-text 'a headline'" in page
