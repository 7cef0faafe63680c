"""Check of stored results: rows that are missing, of chosen motions, or with another payload."""

from dataclasses import replace

import pytest
from benchmark.made_rows import PLANAR, answered

from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.check import compare_rows, recompute
from cablebot_gym.benchmark.seeds import evaluation_seed
from cablebot_gym.benchmark.store import Results
from cablebot_gym.benchmark.suites import Override, Suite, suite_rows

TEXT = "A headline of 4 January 2027"
OVERRIDES = (Override(motion="hidden", motions=3),)
SUITE = Suite(name="tiny", summary="", env_ids=(PLANAR,), overrides=OVERRIDES)


def answer(row, payload=1.0):
    return answered(row, payload=payload, resolution=0.01)


@pytest.fixture
def honest(monkeypatch):
    """Results of two policies with all rows of their suite."""
    monkeypatch.setattr(suites, "SUITES", {"tiny": SUITE} | suites.SUITES)
    policies = {PLANAR: ("fl", "robust")}
    asked = suite_rows(SUITE, policies, seed=evaluation_seed(TEXT), seed_text=TEXT)
    return Results(suite="tiny", command="", rows=list(map(answer, asked)), seed_text=TEXT)


def changed(row, **conditions):
    return replace(row, conditions=replace(row.conditions, **conditions))


def chosen_motion(rows):
    """Another motion for a policy and for its denominator."""
    first = rows[0].conditions.trajectory
    chosen = first | {"seed": 12345}
    return [
        changed(row, trajectory=chosen) if row.conditions.trajectory == first else row
        for row in rows
    ]


@pytest.mark.parametrize(
    ("change", "missing", "unexpected"),
    [
        (lambda rows: rows, 0, 0),
        (lambda rows: rows[1:], 1, 0),  # the first optimum
        (lambda rows: rows[:-1], 1, 0),  # the last motion of a policy
        (chosen_motion, 4, 4),
        (lambda rows: [*rows[:-1], changed(rows[-1], robot="flex-planar")], 1, 1),
    ],
)
def test_rows_of_results_are_those_of_their_suite(honest, change, missing, unexpected):
    rows = compare_rows(replace(honest, rows=change(honest.rows)))
    assert (len(rows.missing), len(rows.unexpected)) == (missing, unexpected)


def test_rows_of_an_uninstalled_policy_are_named_and_pass_the_check(honest):
    bygone = [replace(row, policy="bygone") for row in honest.rows[-3:]]
    rows = compare_rows(replace(honest, rows=[*honest.rows, *bygone]))
    assert rows.not_installed == ("bygone",)
    assert rows.missing == rows.unexpected == ()


def computing(payload):
    """A backend that computes the same payload for every row."""

    def backend(jobs):
        for key, job in jobs.items():
            ((row,),) = job.args
            yield key, [answer(row, payload)]

    return backend


def test_random_rows_have_optima_among_them(honest):
    rows = list(recompute(honest.rows, 5, computing(1.0)))
    measures = [row.stored.measure for row in rows]
    assert measures.count("optimum") == 1
    assert len(measures) == 5
    assert all(row.is_equal for row in rows)


@pytest.mark.parametrize(("payload", "is_equal"), [(1.009, True), (1.02, False), (None, False)])
def test_payload_may_differ_by_its_resolution(honest, payload, is_equal):
    policies = [row for row in honest.rows if row.policy]
    rows = list(recompute(policies, 2, computing(payload)))
    assert [row.is_equal for row in rows] == [is_equal] * 2
    assert str(rows[0]).startswith("equal" if is_equal else "DIFFERENT")
