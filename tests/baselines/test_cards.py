"""Cards of the learned policies that ship: statistics, how a card comes about, page and figure."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cards import (
    Card,
    base_text,
    card_markdown,
    draw_curves,
    iqm,
    iqm_interval,
    make_card,
    median_seed,
    read_best_known,
    read_cards,
    with_best_known,
    with_search_results,
)
from scipy.stats import trim_mean
from shipping import CURVE, PLANAR_ID, SPATIAL_ID, save_run, script, ship

from cablebot_baselines.learned.base import find_base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.runs import BEST
from cablebot_baselines.learned.shipped import SHIPPED
from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.cells import BestKnownCell, Record

# ---------------------------------------------------------------------------------------------------------- statistics


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([4.0], 4.0),
        ([1.0, 2.0, 9.0], 4.0),
        ([100.0, 2.0, 1.0, 3.0], 2.5),
        ([3.0, -50.0, 1.0, 2.0, 100.0], 2.0),
        ([0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 9.0, 9.0], 2.5),
    ],
)
def test_a_quarter_of_the_values_is_left_out_at_either_end(values, expected):
    assert iqm(values) == pytest.approx(expected)
    assert trim_mean(values, 0.25) == pytest.approx(expected)


def test_many_means_at_once_are_those_one_by_one():
    values = np.random.default_rng(3).normal(size=(4, 3, 11))
    assert iqm(values) == pytest.approx(trim_mean(values, 0.25, axis=-1))


def test_interval_is_that_of_all_resamples_there_are():
    values = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    every = np.sort([iqm(values[list(places)]) for places in itertools.product(range(5), repeat=5)])
    for confidence in (0.5, 0.8, 0.95):
        low, high = iqm_interval([values], confidence=confidence)
        for end, fraction in ((low, (1 - confidence) / 2), (high, (1 + confidence) / 2)):
            # As exact as so many resamples are: four of their standard deviations in the fraction.
            near = [fraction - 4 * 0.5 / 100, fraction + 4 * 0.5 / 100]
            assert np.quantile(every, max(near[0], 0)) <= end <= np.quantile(every, min(near[1], 1))


def test_two_seeds_by_hand():
    """Resamples of (0, 1): mean 0 in a quarter of them, 1/2 in a half, 1 in a quarter."""
    assert iqm_interval([[0.0, 1.0]], confidence=0.95) == (0.0, 1.0)
    assert iqm_interval([[0.0, 1.0]], confidence=0.4) == (0.5, 0.5)


def test_resamples_stay_within_their_strata():
    """Each stratum is constant, so that nothing can differ; without strata it would."""
    strata = [[0.0] * 5, [1.0] * 5, [7.0] * 5]
    assert iqm_interval(strata) == (iqm(np.concatenate(strata)),) * 2
    assert np.ptp(iqm_interval([np.concatenate(strata)])) > 1


def test_strata_are_drawn_independently_and_may_differ_in_size():
    """(0, 1) twice: were the draws the same, the mean 1/2 would come up half of the time, not 3/8 of it."""
    twice = [[0.0, 1.0], [0.0, 1.0]]
    # 4 values, the middle two: 0, 1/2 or 1, with 5/16, 6/16 and 5/16.
    assert iqm_interval(twice, confidence=0.30) == (0.5, 0.5)
    assert iqm_interval(twice, confidence=0.44) == (0.0, 1.0)
    assert iqm_interval([[1.0, 1.0], [1.0]]) == (1.0, 1.0)


def test_interval_is_the_same_each_time_and_another_with_another_seed():
    values = [np.random.default_rng(1).normal(size=7)]
    assert iqm_interval(values) == iqm_interval(values)
    assert iqm_interval(values, resamples=200, seed=1) != iqm_interval(values, resamples=200, seed=2)


@pytest.mark.parametrize(
    ("payloads", "expected"),
    [
        ({0: 1.0, 1: 5.0, 2: 3.0, 3: 2.0, 4: 4.0}, 2),
        ({0: 4.0, 1: 1.0, 2: 3.0, 3: 2.0}, 3),
        ({0: None, 1: 0.0, 2: 0.5}, 1),
        ({3: 1.0, 1: 1.0, 2: 1.0}, 2),
        ({7: None}, 7),
    ],
)
def test_typical_seed_has_the_median_payload(payloads, expected):
    assert median_seed(payloads) == expected


# -------------------------------------------------------------------------------------------------- how a card is made


def test_card_says_what_every_seed_carries_and_the_typical_one_ships(runs, computed, tmp_path):
    weights = tmp_path / "weights"
    card = ship(runs, weights)
    assert [run.payloads for run in card.seeds] == [
        (2.0, 1.0),
        (None, None),
        (2.8, 2.8 - 1.0),
        (2.4, 1.4),
        (2.6, 1.6),
    ]
    assert [run.in_training for run in card.seeds] == [2.0, None, 2.9, 2.7, 2.5]
    assert card.shipped_seed == 4
    assert (weights / "apg-circle-planar.zip").read_bytes() == (runs / "apg-circle-planar-4" / BEST).read_bytes()
    assert card.sha256 == hashlib.sha256((weights / "apg-circle-planar.zip").read_bytes()).hexdigest()
    assert (card.base_payloads, card.law, card.law_payloads) == ((1.5, 0.5), "fl", (1.9, 1.9 - 1.0))
    assert card.base_in_training == 1.4
    summary = card.summary(0)
    assert summary.iqm == pytest.approx((2.0 + 2.4 + 2.6) / 3)  # none counts as 0, and is the smallest
    assert summary.median == 2.4
    assert summary.low < summary.iqm < summary.high
    assert card.best_known == pytest.approx(2.875, abs=2e-3)
    assert [(one.seed, one.law_payload) for one in card.held_out] == [(10_000 + place, 2.0) for place in range(4)]
    assert [run.held_out for run in card.seeds] == [(), (), (), (), (1.6, 3.6, 1.6, 3.6)]
    assert card.held_out[0].best_known == pytest.approx(4.486, abs=2e-3)
    assert [one.best_known is None for one in card.held_out] == [False, False, False, True]
    assert [(run.seed, run.wall_s, run.timesteps) for run in card.seeds][4] == (4, 64.0, 704)
    assert not card.planner_output_used
    assert card.base["gains"] == [2500.0, 100.0]
    assert card.base_text.startswith("`fl` with K_P = 2500 1/s², K_D = 100 1/s, minimum tension 2 N")
    base = Bundle.load(runs / "apg-circle-planar-base.zip").network
    assert not any(np.any(array) for array in (*base.weights, *base.biases))


def judged(best):
    """An evaluation in which `fl` carries 3 kg, seeds 0, 2 and 3 carry 4 kg and other policies 1 kg.

    ``best`` is what a search for the best known payload says.
    """
    cells = []

    def payload(policy):
        return 3.0 if policy == "fl" else 4.0 if re.search(r"-[023]$", Path(policy).parent.name) else 1.0

    def evaluate(asked):
        cells.extend(asked.values())
        results = [
            best(cell) if isinstance(cell, BestKnownCell) else {"payload": payload(cell.policy)}
            for cell in asked.values()
        ]
        return [
            Record(cell=cell, source="", versions={}, result=result, seconds=0.0, final="found" in result)
            for cell, result in zip(asked.values(), results, strict=True)
        ]

    return evaluate, cells


def test_of_what_was_trained_on_loops_the_best_found_is_searched_for_on_every_held_out_motion(runs):
    folders = [save_run(runs / f"loops-{seed}", seed, config={"motions": {"loops": 2}}) for seed in range(5)]
    bests = read_best_known(script.RESULTS)
    found = {10_003: (2.0, True), 10_004: (5.0, True), 10_005: (6.0, False)}

    def best(cell):
        payload, verified = found[cell.trajectory["seed"]]
        return {"payload": payload, "verified": verified, "found": True}

    evaluate, cells = judged(best)
    card, _ = make_card(CURVE, PLANAR_ID, folders, evaluate=evaluate, best_known=bests, command="", held_out=6)
    assert [cell.trajectory["seed"] for cell in cells if isinstance(cell, BestKnownCell)] == [10_003, 10_004, 10_005]
    assert [one.best_known for one in card.held_out[3:]] == [4.0, 5.0, None]  # seeds carry 4 kg: that is possible
    assert card.held_out[0].best_known == pytest.approx(4.486, abs=2e-3)
    assert with_best_known(card, bests) == card
    assert card.shipped_seed == 4
    page = card_markdown([card])
    assert "| 6 of 6 | 80% on 5 |" in page  # the median seed, not the one that ships
    assert "| 1.00 | 0 of 6, 20% | ships |" in page

    evaluate, cells = judged(best)
    few, _ = make_card(
        CURVE, PLANAR_ID, folders, evaluate=evaluate, best_known=bests, command="", held_out=6, searched=4
    )
    assert [cell.trajectory["seed"] for cell in cells if isinstance(cell, BestKnownCell)] == [10_003]
    assert few.held_out[4].best_known is None

    evaluate, cells = judged(best)
    assert with_search_results(few, evaluate, bests) == card
    assert [cell.trajectory["seed"] for cell in cells] == [10_004, 10_005], "what is known is not searched for again"

    evaluate, _ = judged(lambda cell: {"error": "no casadi"})
    with pytest.raises(RuntimeError, match="search for the best known payload on CableBot-Planar-v0 failed: no casadi"):
        make_card(CURVE, PLANAR_ID, folders, evaluate=evaluate, best_known=bests, command="", held_out=6)


def test_cards_are_read_as_they_were_written(runs, computed, tmp_path):
    card = ship(runs, tmp_path / "weights")
    text = (tmp_path / "weights" / "apg-circle-planar.json").read_text(encoding="utf-8")
    assert Card.from_json(text).to_json() == text == card.to_json()
    assert json.loads(text)["summaries"][0]["median"] == 2.4


@pytest.mark.parametrize("text", ["{}", "[]", "no JSON", '{"seeds": [], "conditions": [], "held_out": []}'])
def test_broken_card_is_named(tmp_path, text):
    (tmp_path / "apg-loops-planar.json").write_text(text, encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"apg-loops-planar.json' cannot be read .*train_shipped.py --policy apg-loops"
    ):
        read_cards(tmp_path)


def test_runs_of_different_policies_make_no_card(runs):
    folders = [save_run(runs / "a", 0), save_run(runs / "b", 0)]

    def make(policy, env_id):
        return make_card(policy, env_id, folders, evaluate=lambda cells: [], best_known={}, command="")

    with pytest.raises(ValueError, match="different seeds"):
        make(CURVE, PLANAR_ID)
    save_run(runs / "b", 1, config={})
    with pytest.raises(ValueError, match="different configurations"):
        make(CURVE, PLANAR_ID)
    with pytest.raises(
        ValueError, match="is a training on CableBot-Planar-v0 by gradient, not on CableBot-Spatial-v0 by ppo"
    ):
        make(SHIPPED["ppo-circle"], SPATIAL_ID)


@pytest.mark.parametrize(
    ("env_id", "base", "words"),
    [
        (SPATIAL_ID, {}, "`fl` with K_P = 30 1/s², K_D = 20 1/s"),
        (
            SPATIAL_ID,
            {"estimates_payload": True, "allocates": True},
            "payload estimator with prior weight 0.01 s, allocation",
        ),
        (ENV_IDS[3], {"law": "motor-pd"}, "`motor-pd` with ω = 200 rad/s, ζ = 0.7"),
        (ENV_IDS[2], {"law": "motor-pd", "frequency": 90}, "ω = 90 rad/s, ζ = 0.7, minimum tension 5 N"),
        (ENV_IDS[3], {"law": "fl4"}, "`fl4` with poles -15, -15, -60, -60 1/s"),
        (ENV_IDS[3], {"law": "composite"}, "K_P = 30 1/s², K_D = 20 1/s, K_v ≤ 1 √(K J′)"),
    ],
)
def test_base_laws_gains_are_in_words(env_id, base, words):
    assert words in base_text(find_base({"law": "fl", **base}), env_id)


# --------------------------------------------------------------------------------------------- the page and the figure


def test_page_holds_the_numbers(runs, computed, tmp_path):
    card = ship(runs, tmp_path / "weights")
    other = replace(card, env_id=ENV_IDS[2], law="composite-tuned", sb3=True)
    page = card_markdown([card, other])
    row = next(line for line in page.splitlines() if line.startswith("| `apg-circle` | Planar"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    low, high = card.summary(0).low, card.summary(0).high
    assert cells[2:4] == ["payload known", "5"]
    assert cells[4:8] == [f"2.33 [{low:.2f}, {high:.2f}]", "2.40", "1.50", "`fl` 1.90"]
    assert cells[8:] == ["81% of 2.87", "2 of 4", f"{1.6 / 4.4857:.0%} on 3", "62 s"]
    assert "| 1 | 701 | 61 s | fails unloaded | fails unloaded | fails unloaded | – |  |" in page
    assert f"| 4 | 704 | 64 s | 2.50 | 2.60 | 1.60 | 2 of 4, {1.6 / 4.4857:.0%} | ships |" in page
    assert "`cablebot train CableBot-Planar-v0 --algo gradient --config gradient --seed 4 --threads 1`" in page
    assert "python 3.11, torch 2" in page
    assert "The training used no planner." in page
    assert "python scripts/train_shipped.py --policy apg-circle --id CableBot-Planar-v0 --seeds 5 --draws 256" in page
    fractions = [np.array([2.0, 0.0, 2.8, 2.4, 2.6]) / card.best_known] * 2
    low, high = iqm_interval(fractions)
    interval = f"{iqm(np.concatenate(fractions)):.1%} [{low:.1%}, {high:.1%}]"
    assert (
        f"Over its 2 environments (payload known), the IQM of the fraction of the best known payload is {interval}."
        in page
    )
    assert page.count("apg-circle-flexplanar-sb3.zip") == 1
    assert "apg-circle-planar-sb3.zip" not in page
    first, second, *_ = card_markdown([replace(card, motions={"loops": 9})]).split("| --- ")[-1].splitlines()[1:]
    assert first.startswith("| `apg-circle` | Planar | payload known, in training | 5 | 2.40 [")
    assert first.split("|")[6:10] == [" 2.50 ", " 1.40 ", " – ", " – "]
    assert second.startswith("|  |  | payload known | 5 | 2.33 [")


def test_figure_has_a_panel_for_each_card_and_lines_of_every_seed(runs, computed, tmp_path):
    card = ship(runs, tmp_path / "weights")
    loops = replace(card, policy="apg-loops", motions={"loops": 9})
    circle, other, *empty = draw_curves([card, loops, card, card]).axes[:6]
    assert len(empty) == 4
    assert len(circle.lines) == 5 + 3
    assert len(other.lines) == 5 + 1  # what is carried on the circle says nothing of loops
    assert list(circle.lines[0].get_xdata()) == [30.0, 60.0]
    assert list(circle.lines[0].get_ydata()) == [0.0, 2.0]
    assert other.get_title() == "apg-loops, Planar: loops, mean"
