"""Scores, tables, maps and the page against numbers worked out by hand."""

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


def fails(policy, message="it raised", motion=CIRCLE):
    return record(PolicyCell(env_id=PLANAR, trajectory=motion, policy=policy), error=message)


def row(text, policy):
    return [cell.strip() for cell in next(line for line in text.splitlines() if f"`{policy}`" in line).split("|")[2:-1]]


def test_score_is_the_fraction_of_the_best_known_payload_of_the_same_motion_and_bounds():
    wide = {"position": 0.02, "rotation": 0.01}
    some = [best(2.0), best(8.0, LOOPS[0]), carries("fl", 1.0), carries("fl", 2.0, LOOPS[0])]
    some += [carries("fl", None, payload_known=False), carries("fl", 3.0, error_bounds=wide), fails("bad")]
    assert [one.score for one in scores(some)] == [0.5, 0.25, 0.0, None, None]
    assert [one.best_known for one in scores(some)] == [2.0, 8.0, 2.0, None, 2.0]


@pytest.mark.parametrize(
    ("model", "text"),
    [
        ({}, "payload known"),
        ({"payload_known": False}, "payload unknown"),
        ({"model_payload_factor": 1.1}, "payload model × 1.1"),
    ],
)
def test_larger_payload_of_a_policy_raises_the_best_known_payload(model, text):
    some = [best(2.0), carries("fl", 1.0), carries("trajopt", 2.5, **model)]
    (raised,) = best_known_payloads(some).values()
    assert (raised.payload, raised.raised_by) == (2.5, f"trajopt, {text}")
    fl, trajopt = scores(some)
    assert (fl.score, fl.raised) == (0.4, False)
    assert (trajopt.score, trajopt.raised) == (1.0, True)


def test_paper_criterion_and_uncertainty_do_not_raise_the_best_known_payload():
    some = [best(2.0), carries("fl", 3.0, criterion="paper"), carries("fl", 4.0, uncertainty="table6", draws=8)]
    assert next(iter(best_known_payloads(some).values())).payload == 2.0
    paper, drawn = scores(some)
    assert (paper.score, drawn.score) == (None, 2.0)


@pytest.mark.parametrize("none", [{"error": "no solver"}, {"payload": 2.0, "verified": False}])
def test_without_best_known_payload_there_is_no_score(none):
    (one,) = scores([record(BestKnownCell(env_id=PLANAR, trajectory=CIRCLE), **none), carries("fl", 1.0)])
    assert (one.best_known, one.score, one.payload) == (None, None, 1.0)


def test_end_of_the_scan_is_marked_as_a_lower_bound():
    free = carries("fl", 10.0, more={"violation": None, "scan_ended": True})
    page = markdown("smoke", "c", [best(20.0), free, carries("trajopt", None)])
    assert (row(page, "fl"), row(page, "trajopt")) == (["≥ 10.00, 50%"], ["fails unloaded, 0%"])


FAMILY = [best(2.0, motion) for motion in LOOPS]
FAMILY += [carries("fl", payload, motion) for payload, motion in zip((1.0, 1.5, 0.2), LOOPS, strict=True)]
FAMILY += [carries("robust", payload, motion) for payload, motion in zip((1.6, 1.2, None), LOOPS, strict=True)]


def test_family_of_motions_is_ranked_by_its_median_fraction():
    (leaderboard,) = leaderboards(FAMILY)
    assert leaderboard.motions == 3
    assert leaderboard.policies == ("robust", "fl")
    fl, robust = (leaderboard.fraction(policy, leaderboard.columns[0]) for policy in ("fl", "robust"))
    assert (fl.median, fl.worst) == (0.5, 0.1)
    assert (robust.median, robust.worst) == (0.6, 0.0)
    assert row(markdown("smoke", "c", FAMILY[3:]), "robust") == ["1.20 kg, 0.00 kg"]
    raised = [*FAMILY, carries("trajopt", 99.0, LOOPS[0])]
    assert row(markdown("smoke", "c", raised), "trajopt") == ["100%, 100%\\*"]


def test_error_on_one_motion_of_a_family_is_the_entry_of_the_family():
    some = [*FAMILY[:3], fails("fl", motion=LOOPS[0]), *FAMILY[4:]]
    (leaderboard,) = leaderboards(some)
    assert leaderboard.fraction("fl", leaderboard.columns[0]) is None
    assert row(markdown("smoke", "c", some), "fl") == ["error"]


def on_axis(name, value, payload, policy="fl"):
    cells = (
        BestKnownCell(env_id=PLANAR, trajectory=CIRCLE),
        PolicyCell(env_id=PLANAR, trajectory=CIRCLE, policy=policy),
    )
    known, carried = (AXES[name].with_value(cell, value) for cell in cells)
    return [record(known, payload=2 * payload, verified=True), record(carried, payload=payload)]


def test_map_contains_the_default_cell_and_the_leaderboard_no_other_cell():
    some = [*on_axis("position", 0.02, 1.5), best(2.0), carries("fl", 1.0), carries("trajopt", 1.9)]
    by_bound, by_bounds, by_duration = payload_maps(
        [*some, *on_axis("bounds", 0.02, 1.75), *on_axis("duration", 2.0, 3.0)]
    )
    assert [one.payload for one in by_bounds.policies["fl"]] == [1.0, 1.75]
    assert (by_bound.values, by_bound.best_known) == ((0.01, 0.02), (2.0, 3.0))
    assert {name: [one.payload for one in entry] for name, entry in by_bound.policies.items()} == {"fl": [1.0, 1.5]}
    assert (by_duration.values, by_duration.best_known) == ((1.0, 2.0), (2.0, 6.0))
    (leaderboard,) = leaderboards(some)
    assert [one.payload for one in leaderboard.entries["fl", leaderboard.columns[0]]] == [1.0]
    page = markdown("smoke", "c", some)
    assert "| fl | 1.00, 50% | 1.50, 50% |" in page
    assert "position error ≤ 10 mm" in page


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


def test_page_has_all_results_and_notes():
    page = markdown("smoke", "cablebot benchmark --suite smoke", ALL)
    circle = page[page.index("The paper's circle:") :]
    assert row(circle, "trajopt") == ["2.50\\*, 100%", "n/a", "–"]
    assert row(circle, "fl") == ["1.00, 40%", "1.06", "0.25, 10%"]
    assert row(circle, "limp") == ["fails unloaded, 0%", "–", "–"]
    assert row(circle, "bad") == ["error", "–", "–"]
    heads = next(line for line in circle.splitlines() if line.startswith("| policy"))
    assert heads == "| policy | payload known | payload known, paper criterion [kg] | payload unknown, table6 |"
    for text in (
        "| 2.000 | 3.000 | 3.250 | raised to 2.500 kg, the DLCC of trajopt, payload known\\*",
        "* bad failed on CableBot-Planar-v0: policy 'bad' raised | and * more",
    ):
        assert text in page


def test_page_csv_and_terminal_have_the_numbers_of_the_json_file(capsys):
    text = results_json("smoke", "a command", ALL)
    suite, command, again = read_results(text)
    assert (suite, command) == ("smoke", "a command")
    assert markdown(suite, command, again) == markdown("smoke", "a command", ALL)
    assert results_json(suite, command, again) == text
    by_policy = {cell["cell"]["policy"]: cell["score"] for cell in json.loads(text)["cells"] if "score" in cell}
    assert (by_policy["limp"], by_policy["bad"]) == (0.0, None)
    rows = list(csv.DictReader(io.StringIO(csv_text(ALL))))
    assert len(rows) == len(scores(ALL))
    fl = next(one for one in rows if one["policy"] == "fl" and one["trajectory"] == json.dumps(CIRCLE))
    assert (fl["payload"], fl["best_known"], fl["score"], fl["violation"]) == ("1.0", "2.5", "0.4", "torque 2")
    assert next(one for one in rows if one["policy"] == "bad")["error"] == "policy 'bad' raised | and * more"
    drawn = next(one for one in rows if one["uncertainty"] == "table6")
    assert (drawn["draws"], drawn["assured_payload"], drawn["score"]) == ("32", "0.2", "0.1")
    print_benchmark(ALL)
    assert "2.50*, 100%" in capsys.readouterr().out
