"""Scores, ranks, tables and the page against numbers worked out by hand."""

import numpy as np
import pytest
from benchmark.made_rows import (
    PLANAR,
    answered,
    asked,
    carries,
    drawn,
    fails,
    optimum,
    verified,
)

from cablebot_gym.benchmark.leaderboard import markdown
from cablebot_gym.benchmark.ranking import RANKED_MOTIONS
from cablebot_gym.benchmark.scores import leaderboards, scores
from cablebot_gym.benchmark.store import Results

LOOPS = [{"name": "loop-planar", "seed": 10_000 + number} for number in range(RANKED_MOTIONS)]


def page_of(records):
    return markdown(
        Results(suite="smoke", command="cablebot benchmark --suite smoke", rows=records)
    )


def row(text, policy):
    """Cells of a policy's row, without its name."""
    for line in text.splitlines():
        if f"`{policy}`" in line:
            return [cell.strip() for cell in line.split("|")[2:-1]]
    raise AssertionError(f"no row of {policy}")


def score_values(records):
    return [score.score for score in scores(records)]


def test_score_is_the_fraction_of_the_optimum():
    records = [
        optimum(2.0),
        optimum(8.0, LOOPS[0]),
        carries("fl", 1.0),
        carries("fl", 2.0, LOOPS[0]),
        carries("fl", None, payload_known=False),
        carries("fl", 3.0, error_bounds={"position": 0.02, "rotation": 0.01}),
        carries("trajopt", 2.5),
        carries("robust", 3.0, criterion="paper"),
        carries("robust", 1.0, uncertainty="table6", draws=512),
    ]
    assert score_values(records) == [0.5, 0.25, 0.0, None, 1.25, None, None]


def test_error_of_a_policy_counts_as_zero():
    assert score_values([optimum(2.0), fails("bad"), fails("lost", "no memory", final=False)]) == [
        0.0,
        None,
    ]


def test_score_needs_an_optimum():
    assert score_values([optimum(None), verified(2.0), carries("fl", 1.0)]) == [None]


# --- several motions --------------------------------------------------------------------------------------------------


def family(policies, count=RANKED_MOTIONS):
    """Optima of 1 kg and payloads of policies on motions, given as arrays."""
    records = [optimum(1.0, motion) for motion in LOOPS[:count]]
    for policy, values in policies.items():
        for motion, payload in zip(LOOPS, values, strict=False):
            records.append(carries(policy, payload, motion))
    return records


def test_rank_counts_the_policies_better_with_confidence():
    """The motions differ more than the policies: only differences on the same motions tell c from a
    and b."""
    random = np.random.default_rng(0)
    hard = random.uniform(-0.3, 0.3, RANKED_MOTIONS)
    noise = random.normal(0, 0.01, RANKED_MOTIONS)
    fractions = {"a": 0.55 + hard, "b": 0.551 + hard + noise, "c": 0.5 + hard, "d": 0.3 + 0 * hard}
    records = family(fractions)
    (board,) = leaderboards([*reversed(records)])  # the order of the records does not matter
    assert board.policies[2:] == ("c", "d")
    assert board.ranks == {"a": 1, "b": 1, "c": 3, "d": 4}
    assert row(page_of(records), "d")[1] == "30.0% [25.8%, 30.0%], worst 30%"


def test_ranks_need_enough_motions():
    values = np.full(RANKED_MOTIONS, 0.5)
    assert leaderboards(family({"a": values[:-1], "b": values[:-1]}))[0].ranks == {}
    some = family({"a": values, "b": values[:-1] - 0.1})
    assert leaderboards(some)[0].ranks == {"a": 1, "b": 2}  # compared on the motions of both


def test_motion_counts_only_with_an_optimum():
    """One failed search once removed all ranks."""
    values = np.full(RANKED_MOTIONS, 0.5)
    values[0] = 0.9
    records = family({"a": values, "b": 1 - values})
    records[0] = optimum(None, LOOPS[0])
    (board,) = leaderboards(records)
    assert board.ranks == {"a": 1, "b": 1}
    assert board.fraction("a", board.columns[0]).mean == pytest.approx(0.5)
    assert f"{LOOPS[0]['seed']} counts for no policy on {PLANAR}" in page_of(records)


def surveyed(policy, payloads, **conditions):
    """The rows of a policy on the motions :data:`LOOPS`."""
    return [
        carries(policy, payload, motion, seed=index, **conditions)
        for index, (payload, motion) in enumerate(zip(payloads, LOOPS, strict=True))
    ]


def test_fractions_of_the_main_table_need_the_yardstick():
    """A fraction of the nominal payload would look like one of what can be hoped for."""
    unknown = {"payload_known": False, "uncertainty": "hardware", "draws": 19}
    survey = surveyed("a", [0.5] * RANKED_MOTIONS, **unknown)
    (board,) = leaderboards([*family({}), *survey])
    assert board.fraction("a", board.columns[0]) is None
    (board,) = leaderboards([*family({}), *survey, drawn(LOOPS[0], None)])
    assert board.fraction("a", board.columns[0]) is None


def test_survey_under_uncertainty_ranks():
    unknown = {"payload_known": False, "uncertainty": "hardware", "draws": 19}
    records = [
        *family({}),
        verified(0.99, LOOPS[0]),
        *[drawn(motion, 0.8) for motion in LOOPS],
        *surveyed("a", [0.5, *[0.7] * 19], **unknown),
        *surveyed("b", [None, *[0.1] * 19], **unknown),
        *surveyed("b", [0.9] * 20),
        *surveyed("c", [0.6] * 20),
        *surveyed("d", [0.8] * 20),
    ]
    (board,) = leaderboards(records)
    main, exact = board.columns
    assert board.ranks == {"a": 1, "b": 2}
    assert board.policies == ("a", "b", "d", "c")  # those without rank by the next column
    assert board.fraction("a", main).mean == pytest.approx(0.69 / 0.8)
    assert board.fraction("b", main).worst == 0.0
    assert board.fraction("b", exact).mean == pytest.approx(0.9)
    page = page_of(records)
    assert "that 19 random robots carry (`hardware`)" in page
    assert f"| {PLANAR} | 20 | 80.0% [0.0%, 80.0%] | 80.0% | 0 | 99.0% |" in page
    read = Results.from_text(Results(suite="smoke", command="", rows=records).to_text())
    assert page_of(read.rows) == page


def test_error_on_one_motion_counts_as_zero_and_is_named():
    some = [
        *family({"a": [0.5, 0.5]}, 2),
        *family({"b": [0.5]}, 0),
        fails("b", "it hangs", LOOPS[1]),
    ]
    text = row(page_of(some), "b")[0]
    assert text.startswith("25.0%")
    assert text.endswith("worst 0%; errors: 1")


# --- page -----------------------------------------------------------------------------------------------

TIMING = {
    "median": 1e-4,
    "p99": 5e-3,
    "missed": 0.25,
    "start": 0.25,
    "period": 2e-3,
    "exchange": False,
}
ALL = [
    optimum(2.0),
    carries("fl", 1.0, more={"fallbacks": None, "violation": {"kind": "torque", "index": 2}}),
    carries("trajopt", 2.5, more={"fallbacks": 0.5}),
    carries("limp", None),
    carries("free", 10.0, more={"violation": None, "scan_ended": True}),
    carries("random", 0.5, more={"stochastic": True, "draws": 99}),
    fails("bad", "policy 'bad' raised <b> | and * more"),
    carries("fl", 1.06, {"name": "paper-planar"}, criterion="paper"),
    carries("toy", 1.5, {"name": "paper-planar"}, criterion="paper", more={"declared": True}),
    carries(
        "trajopt", None, {"name": "paper-planar"}, criterion="paper", more={"applicable": False}
    ),
    carries(
        "fl", 0.25, payload_known=False, uncertainty="table6", draws=512, more={"assured": True}
    ),
    answered(asked("time", "fl"), **TIMING, processor="some processor"),
]


def test_page_has_all_results_and_notes():
    page = page_of(ALL)
    assert row(page, "trajopt") == ["2.50, 125%", "n/a", "–", "–"]
    assert row(page, "fl") == ["1.00, 50%", "1.06", "0.25", "0.1, 5, 25%, 0.25"]
    assert row(page, "random") == ["0.50, stochastic (99 draws), 25%", "–", "–", "–"]
    assert row(page, "free") == ["≥ 10.00, 500%", "–", "–", "–"]
    assert row(page, "limp") == ["fails unloaded, 0%", "–", "–", "–"]
    assert row(page, "toy") == ["–", "1.50, declared", "–", "–"]
    assert row(page, "bad") == ["error", "–", "–", "–"]
    for text in (
        "the paper's circle: payload known, paper criterion [kg]",
        "* bad failed on CableBot-Planar-v0: policy 'bad' raised \\<b\\> \\| and \\* more",
        "Measured on: some processor.",
    ):
        assert text in page
