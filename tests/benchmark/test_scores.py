"""Scores, tables and the page against numbers worked out by hand."""

from __future__ import annotations

import csv
import io
import json

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, Record
from cablebot_gym.benchmark.leaderboard import markdown, read_results, results_json
from cablebot_gym.benchmark.maps import AXES
from cablebot_gym.benchmark.scores import best_known_payloads, leaderboards, payload_maps, scores
from cablebot_gym.benchmark.tables import csv_text, print_benchmark

PLANAR = "CableBot-Planar-v0"
CIRCLE = {"name": "paper-planar"}
LOOPS = [{"name": "loop-planar", "seed": 10_000 + number} for number in range(3)]


def record(cell, **result):
    return Record(cell=cell, source="a" * 16, versions={"python": "3.11"}, result=result, seconds=1.0)


def best(payload, motion=CIRCLE, **more):
    cell = BestKnownCell(env_id=PLANAR, trajectory=motion)
    return record(cell, payload=payload, total_mass=payload + 1.0, verified=True, **more)


def carries(policy, payload, motion=CIRCLE, more=None, **conditions):
    cell = PolicyCell(env_id=PLANAR, trajectory=motion, policy=policy, **conditions)
    return record(cell, payload=payload, total_mass=None if payload is None else payload + 1.0, **(more or {}))


def fails(policy, why="it raised"):
    return record(PolicyCell(env_id=PLANAR, trajectory=CIRCLE, policy=policy), error=why)


def test_score_is_the_fraction_of_the_best_known_payload_of_the_same_motion_and_limits():
    wide = {"position": 0.02, "rotation": 0.01}
    some = [best(2.0), best(8.0, LOOPS[0]), carries("fl", 1.0), carries("fl", 2.0, LOOPS[0])]
    some += [carries("fl", None, payload_known=False), carries("fl", 3.0, error_bounds=wide)]
    assert [one.score for one in scores(some)] == [0.5, 0.25, 0.0, None]
    assert [one.best_known for one in scores(some)] == [2.0, 8.0, 2.0, None]


@pytest.mark.parametrize(
    ("model", "text"),
    [
        ({}, "payload known"),
        ({"payload_known": False}, "payload unknown"),
        ({"model_payload_factor": 1.1}, "payload model × 1.1"),
    ],
)
def test_best_known_payload_is_raised_to_a_policy_that_carries_more(model, text):
    some = [best(2.0), carries("fl", 1.0), carries("trajopt", 2.5, **model)]
    (raised,) = best_known_payloads(some).values()
    assert (raised.payload, raised.raised_by) == (2.5, f"trajopt, {text}")
    fl, trajopt = scores(some)
    assert (fl.score, fl.raised) == (0.4, False)
    assert (trajopt.score, trajopt.raised) == (1.0, True)


def test_best_known_payload_is_not_raised_by_what_is_no_motion_inside_the_limits():
    some = [best(2.0), carries("fl", 3.0, criterion="paper"), carries("fl", 4.0, uncertainty="table6", draws=8)]
    assert next(iter(best_known_payloads(some).values())).payload == 2.0
    paper, drawn = scores(some)
    assert (paper.score, drawn.score) == (None, 2.0)


@pytest.mark.parametrize(
    "none", [{"error": "pip install 'cablebot-gym[optimal]'"}, {"payload": 2.0, "verified": False}]
)
def test_without_a_best_known_payload_there_is_no_score(none):
    some = [record(BestKnownCell(env_id=PLANAR, trajectory=CIRCLE), **none), carries("fl", 1.0)]
    (one,) = scores(some)
    assert (one.best_known, one.score, one.payload) == (None, None, 1.0)


def test_policy_that_fails_has_no_score_and_zero_is_one():
    some = [best(2.0), fails("bad"), carries("limp", None)]
    assert [one.score for one in scores(some)] == [None, 0.0]


def test_payload_that_nothing_stopped_is_said_to_be_at_least_that():
    free = carries("fl", 10.0, more={"violation": None, "scan_ended": True})
    page = markdown("smoke", "c", [best(20.0), free, carries("trajopt", None)])
    assert (row(page, "fl"), row(page, "trajopt")) == (["≥ 10.00, 50%"], ["fails unloaded, 0%"])


FAMILY = [best(2.0, motion) for motion in LOOPS]
FAMILY += [carries("fl", payload, motion) for payload, motion in zip((1.0, 1.5, 0.2), LOOPS, strict=True)]
FAMILY += [carries("robust", payload, motion) for payload, motion in zip((1.6, 1.2, None), LOOPS, strict=True)]


def test_family_is_judged_by_its_median_and_its_worst():
    (leaderboard,) = leaderboards(FAMILY)
    assert leaderboard.motions == 3
    assert leaderboard.policies == ("robust", "fl")
    fl, robust = (leaderboard.fraction(policy, leaderboard.columns[0]) for policy in ("fl", "robust"))
    assert (fl.median, fl.worst) == (0.5, 0.1)
    assert (robust.median, robust.worst) == (0.6, 0.0)


def test_family_without_a_best_known_payload_is_judged_in_kilograms():
    assert row(markdown("smoke", "c", FAMILY[3:]), "robust") == ["1.20 kg, 0.00 kg"]


def test_family_in_which_a_best_known_payload_was_raised_is_marked():
    more = carries("trajopt", 99.0, LOOPS[0])
    assert row(markdown("smoke", "c", [*FAMILY, more]), "trajopt") == ["100%, 100%\\*"]


def test_family_with_a_failure_is_not_judged_by_the_rest():
    broken = record(PolicyCell(env_id=PLANAR, trajectory=LOOPS[0], policy="fl"), error="it raised")
    some = [*FAMILY[:3], broken, *FAMILY[4:]]
    (leaderboard,) = leaderboards(some)
    assert leaderboard.fraction("fl", leaderboard.columns[0]) is None
    assert "| error |" in markdown("smoke", "c", some)


def on_axis(name, value, payload, policy="fl"):
    axis = AXES[name]
    return [
        record(axis.with_value(cell, value), payload=one, total_mass=None, verified=True)
        for cell, one in (
            (BestKnownCell(env_id=PLANAR, trajectory=CIRCLE), 2 * payload),
            (PolicyCell(env_id=PLANAR, trajectory=CIRCLE, policy=policy), payload),
        )
    ]


def test_map_has_the_usual_task_among_its_values_and_the_leaderboard_has_nothing_else():
    some = [*on_axis("position", 0.02, 1.5), best(2.0), carries("fl", 1.0), *on_axis("duration", 2.0, 3.0)]
    by_bound, by_duration = payload_maps(some)
    assert (by_bound.values, by_bound.best_known) == ((0.01, 0.02), (2.0, 3.0))
    assert [one.payload for one in by_bound.policies["fl"]] == [1.0, 1.5]
    assert (by_duration.values, by_duration.best_known) == ((1.0, 2.0), (2.0, 6.0))
    (leaderboard,) = leaderboards(some)
    assert [one.payload for one in leaderboard.entries["fl", leaderboard.columns[0]]] == [1.0]
    page = markdown("smoke", "c", some)
    assert "| fl | 1.00, 50% | 1.50, 50% |" in page
    assert "position error ≤ 10 mm" in page


def test_policy_that_a_map_did_not_ask_is_no_row_of_it():
    some = [*on_axis("position", 0.02, 1.5), best(2.0), carries("fl", 1.0), carries("trajopt", 1.9)]
    assert list(payload_maps(some)[0].policies) == ["fl"]


ALL = [
    best(2.0, upper={"payload": 3.25}),
    *FAMILY,
    carries("fl", 1.0, more={"fallbacks": None, "violation": {"kind": "torque", "index": 2}}),
    carries("trajopt", 2.5, more={"fallbacks": 0.5}),
    carries("limp", None),
    fails("bad", "policy 'bad' raised | and * more"),
    carries("fl", 1.06, criterion="paper"),
    carries("trajopt", None, criterion="paper", more={"applicable": False}),
    carries("fl", 0.25, payload_known=False, uncertainty="table6", draws=32, more={"assured_payload": 0.2}),
]


def row(text, policy):
    return [cell.strip() for cell in next(line for line in text.splitlines() if f"`{policy}`" in line).split("|")[2:-1]]


def test_page_does_not_say_anything_but_the_results():
    page = markdown("smoke", "cablebot benchmark --suite smoke", ALL)
    circle = page[page.index("The paper's circle:") :]
    assert row(circle, "trajopt") == ["2.50\\*, 100%", "n/a", "–"]
    assert row(circle, "fl") == ["1.00, 40%", "1.06", "0.25, 10%"]
    assert row(circle, "limp") == ["fails unloaded, 0%", "–", "–"]
    assert row(circle, "bad") == ["error", "–", "–"]
    heads = next(line for line in circle.splitlines() if line.startswith("| policy"))
    assert heads == "| policy | payload known | payload known, paper criterion [kg] | payload unknown, table6 |"
    family = page[page.index("3 held-out motions") :]
    assert row(family, "robust") == ["60%, 0%"]
    for text in (
        "| 2.000 | 3.000 | 3.250 | raised to 2.500 kg, the DLCC of trajopt, payload known\\*",
        "* bad failed on CableBot-Planar-v0: policy 'bad' raised | and * more",
        "* trajopt on CableBot-Planar-v0 used its fallback up to 0.5 times per episode, in 1 of 1 cells",
        "95% of 32 sampled episodes",
        "computed by `cablebot benchmark --suite smoke` with python 3.11.",
    ):
        assert text in page


def test_page_is_the_same_from_the_results_that_were_written():
    text = results_json("smoke", "a command", ALL)
    suite, command, again = read_results(text)
    assert (suite, command) == ("smoke", "a command")
    assert markdown(suite, command, again) == markdown("smoke", "a command", ALL)
    assert results_json(suite, command, again) == text
    scores = {cell["cell"]["policy"]: cell["score"] for cell in json.loads(text)["cells"] if "score" in cell}
    assert (scores["limp"], scores["bad"]) == (0.0, None)


def test_csv_has_the_same_numbers():
    rows = list(csv.DictReader(io.StringIO(csv_text(ALL))))
    assert len(rows) == len(scores(ALL))
    fl = next(one for one in rows if one["policy"] == "fl" and one["trajectory"] == json.dumps(CIRCLE))
    assert (fl["payload"], fl["best_known"], fl["score"], fl["violation"]) == ("1.0", "2.5", "0.4", "torque 2")
    assert next(one for one in rows if one["policy"] == "bad")["error"] == "policy 'bad' raised | and * more"
    drawn = next(one for one in rows if one["uncertainty"] == "table6")
    assert (drawn["draws"], drawn["assured_payload"], drawn["score"]) == ("32", "0.2", "0.1")


def test_terminal_does_not_lack_a_table_or_a_failure(capsys):
    print_benchmark(ALL)
    out = capsys.readouterr().out
    for text in (
        "the paper's circle",
        "3 held-out motions",
        "2.50*, 100%",
        "60%, 0%",
        "bad failed on",
        "raised to 2.500",
    ):
        assert text in out
