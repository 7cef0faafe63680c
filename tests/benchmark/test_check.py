"""Check of stored results: rows that are missing, of chosen motions, or with another payload."""

from dataclasses import replace
from functools import partial

import pytest

from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell
from cablebot_gym.benchmark.check import compare_rows, recompute
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.records import Record
from cablebot_gym.benchmark.seeds import evaluation_seed
from cablebot_gym.benchmark.suites import Block, Suite, suite_cells

PLANAR = "CableBot-Planar-v0"
TEXT = "A headline of 4 January 2027"
SUITE = Suite(
    name="tiny", summary="", env_ids=(PLANAR,), blocks=(Block(motion="hidden", motions=3),)
)


def record(cell, payload=1.0):
    result = {"payload": payload, "resolution": 0.01}
    return Record(cell=cell, source="a", versions={}, result=result, seconds=0.0)


@pytest.fixture
def honest(monkeypatch):
    """Results of two policies with all rows of their suite."""
    monkeypatch.setattr(suites, "SUITES", {"tiny": SUITE} | suites.SUITES)
    cells = suite_cells(
        SUITE, {PLANAR: ("fl", "robust")}, seed=evaluation_seed(TEXT), seed_text=TEXT
    )
    records = [record(cell) for cell in cells.values()]
    return Results(suite="tiny", command="", records=records, seed_text=TEXT)


def chosen_motion(records):
    """Another motion for a policy and for its denominator."""
    changed = []
    for original in records:
        trajectory = dict(original.cell.trajectory)
        if trajectory == records[0].cell.trajectory:
            trajectory["seed"] = 12345
        changed.append(replace(original, cell=replace(original.cell, trajectory=trajectory)))
    return changed


def last_with(records, **changes):
    *others, last = records
    return [*others, replace(last, cell=replace(last.cell, **changes))]


@pytest.mark.parametrize(
    ("change", "missing", "unexpected"),
    [
        (lambda records: records, 0, 0),
        (lambda records: records[1:], 1, 0),  # the first best known payload
        (lambda records: records[:-1], 1, 0),  # the last motion of a policy
        (chosen_motion, 3, 3),
        (partial(last_with, seed=1), 1, 1),
        (partial(last_with, robot_name="flex-planar"), 1, 1),
    ],
)
def test_rows_of_results_are_those_of_their_suite(honest, change, missing, unexpected):
    rows = compare_rows(replace(honest, records=change(honest.records)))
    assert (len(rows.missing), len(rows.unexpected)) == (missing, unexpected)


def test_rows_of_an_uninstalled_policy_are_named_and_pass_the_check(honest):
    bygone = [replace(row, cell=replace(row.cell, policy="bygone")) for row in honest.records[-3:]]
    rows = compare_rows(replace(honest, records=[*honest.records, *bygone]))
    assert rows.not_installed == ("bygone",)
    assert rows.missing == rows.unexpected == ()


def computing(payload):
    """A backend that computes the same payload for every row."""

    def backend(jobs, say, returned):
        for key, job in jobs.items():
            (cell,) = job.args
            yield key, record(cell, payload)

    return backend


def test_random_rows_have_best_known_payloads_among_them(honest):
    rows = list(recompute(honest.records, 5, computing(1.0), say=print))
    assert len(rows) == 5
    kinds = [type(row.cell) for row in rows]
    assert kinds.count(BestKnownCell) == 1
    assert kinds.count(PolicyCell) == 4
    assert all(row.is_equal for row in rows)


@pytest.mark.parametrize(("payload", "is_equal"), [(1.009, True), (1.02, False), (None, False)])
def test_payload_may_differ_by_its_resolution(honest, payload, is_equal):
    policies = [row for row in honest.records if isinstance(row.cell, PolicyCell)]
    rows = list(recompute(policies, 2, computing(payload), say=print))
    assert [row.is_equal for row in rows] == [is_equal] * 2
    assert str(rows[0]).startswith("equal" if is_equal else "DIFFERENT")
