"""docs/learned.md, from the cards."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np

from cablebot_baselines.learned.shipped import SHIPPED, Condition, short_id
from cablebot_gym.benchmark.scores import Column
from cablebot_gym.benchmark.tables import heading
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED
from cards.card import Card, SeedRun, Summary, has_loops, summed_up
from cards.statistics import CONFIDENCE, RESAMPLES, iqm, iqm_interval, scores

_HEAD = """# Learned policies

What ships in `baselines/cablebot_baselines/learned/weights/`, each under a name for `cablebot dlcc --policy NAME` and for
`cablebot benchmark`: plain arrays, which run without torch and are never unpickled. `python scripts/train_shipped.py`
trains, judges and writes all of it, this page too.

A learned policy steers a classical law: its network shifts the law's reference, or adds to its commands. Each was
trained with several seeds, all of which count here. The one that ships has the median payload in training: it
is typical, not the luckiest.

* Payloads in kg, the largest that is carried on the paper's circle by the task criterion, as on the
  [leaderboard](../LEADERBOARD.md){drawn}. None, where not even zero is carried, counts as 0.
* IQM: interquartile mean over the training seeds; in brackets its {confidence:.0%} interval from {resamples} resamples
  of a stratified bootstrap, whose strata are environments.
* base alone: the law underneath, while the network says zero. law: one of the laws of `baselines/cablebot_baselines/classical/`.
* best found: the leaderboard's, without uncertainty; a lower bound of what is possible.
* held-out: motions with seeds from {held_out} on, which no training and no choice of a seed or a round has seen. On how
  many the policy carries more than the law, both under the first condition; and its median share of the best found, on
  as many of them as it was searched for. What was trained on random loops is judged with every training seed, and the
  median counts; what was trained on the circle alone is not made for them, and only what ships is judged.
* in training: for what was trained on random loops, the mean payload on loops that chose the best of each run, and that
  no network was trained on.
* training: wall time of one seed, the median.

"""

_COLUMNS = (
    *("policy", "id", "condition", "seeds", "IQM", "median", "base alone", "law", "IQM of best found"),
    *("held-out: above law", "held-out: of best found", "training"),
)


def card_markdown(cards: Sequence[Card]) -> str:
    """The page: one table of all, then each policy's command, base law, versions and seeds.

    Args:
        cards: in the order of the page, at least one.
    """
    draws = sorted({card.draws for card in cards if any(one.uncertainty for one in card.conditions)})
    drawn = ""
    if draws:
        several = " or ".join(map(str, draws))
        drawn = f"; `table6` and `sensors` with {several} draws, {cards[0].probability:.0%} of which have to carry"
    text = _HEAD.format(drawn=drawn, confidence=CONFIDENCE, resamples=RESAMPLES, held_out=FIRST_HELD_OUT_SEED)
    text += _table([_COLUMNS, *(row for card in cards for row in _rows(card))], left=3)
    text += "\n![Payload against wall time while training](learned.png)\n"
    for name in dict.fromkeys(card.policy for card in cards):
        text += _section([card for card in cards if card.policy == name])
    return text


def _rows(card: Card) -> list[list[str]]:
    seeds, rows = str(len(card.seeds)), []
    if has_loops(card.motions):
        summary = summed_up(scores([run.in_training for run in card.seeds]))
        rows.append(["told, in training", seeds, *_spread(summary), _kg(card.base_in_training), "–", "–"])
    for place, condition in enumerate(card.conditions):
        summary = card.summary(place)
        rows.append(
            [
                _title(condition),
                seeds,
                *_spread(summary),
                _kg(card.base_payloads[place]),
                f"`{card.law}` {_kg(card.law_payloads[place])}",
                "–" if not card.best_found else f"{summary.iqm / card.best_found:.0%} of {card.best_found:.2f}",
            ]
        )
    time = _time(median(run.wall_s for run in card.seeds))
    first = [f"`{card.policy}`", short_id(card.env_id), *rows[0], *_held_out_cells(card), time]
    return [first, *(["", "", *row, "", "", ""] for row in rows[1:])]


def _spread(summary: Summary) -> tuple[str, str]:
    return f"{summary.iqm:.2f} [{summary.low:.2f}, {summary.high:.2f}]", f"{summary.median:.2f}"


def _held_out_cells(card: Card) -> tuple[str, str]:
    shares = [card.shares(run) for run in card.judged]
    share = f"{median(map(median, shares)):.0%} on {len(shares[0])}" if shares[0] else "–"
    return _above(card, *card.judged), share


def _above(card: Card, *runs: SeedRun) -> str:
    return f"{median(map(card.above_law, runs)):g} of {len(card.held_out)}"


def _held_out(card: Card, run: SeedRun) -> str:
    if run not in card.judged:
        return "–"
    shares = card.shares(run)
    return _above(card, run) + (f", {median(shares):.0%}" if shares else "")


def _section(cards: Sequence[Card]) -> str:
    first = cards[0]
    text = f"\n## `{first.policy}`\n\n{_sentence(SHIPPED[first.policy].summary)}.\n\n```sh\n"
    text += "".join(f"{card.command}\n" for card in cards) + "```\n"
    known = [(card, card.best_found) for card in cards if card.best_found]
    if len(known) > 1 and len(known) == len(cards):
        shares = [np.array(card.carried(0)) / best for card, best in known]
        low, high = iqm_interval(shares)
        mean = float(iqm(np.concatenate(shares)))
        condition = _title(first.conditions[0])
        text += f"\nOver its {len(cards)} environments, {condition}, the IQM of the shares of the best found is "
        text += f"{mean:.1%} [{low:.1%}, {high:.1%}].\n"
    return text + "".join(_details(card) for card in cards)


def _details(card: Card) -> str:
    versions = "; ".join(
        dict.fromkeys(", ".join(f"{name} {number}" for name, number in run.versions.items()) for run in card.seeds)
    )
    planner = "A planner's output was used in training." if card.planner_output_used else "No planner was used."
    text = f"\n### {short_id(card.env_id)}\n\n"
    text += f"* Base: {card.base_text}.\n"
    text += f"* Steering: {_steering(card.steering)}. Network: {card.parameters} parameters, reads "
    text += f"{', '.join(card.features)}.\n"
    text += f"* Trained on {_trained_on(card.motions)}. {planner}\n"
    text += f"* What ships, seed {card.shipped_seed}: `{card.shipped.command}`\n"
    if card.sb3:
        text += (
            f"* `{card.stem}-sb3.zip` is the same actor as a model of Stable-Baselines3, to go on training with. It "
        )
        text += "reads the features as the bundle's `mean` and `scale` normalise them, cut at ±10.\n"
    text += f"* {versions}\n\n"
    rows = [["seed", "steps", "wall time", "in training", *map(_title, card.conditions), "held-out", ""]]
    for run in card.seeds:
        numbers = [_kg(run.in_training), *map(_kg, run.payloads), _held_out(card, run)]
        ships = "ships" if run.seed == card.shipped_seed else ""
        rows.append([str(run.seed), str(run.timesteps), _time(run.wall_s), *numbers, ships])
    return text + _table(rows, left=0)


def _steering(way: Mapping[str, Any]) -> str:
    numbers = {name: value for name, value in way.items() if name != "kind" and (value or name != "lead")}
    units = {"hold": " s", "lead": " s"}
    return f"{way['kind']}, " + ", ".join(f"{name} {value:g}{units.get(name, '')}" for name, value in numbers.items())


def _trained_on(motions: Any) -> str:
    if motions == "paper":
        return "the paper's circle"
    if has_loops(motions):
        named = [one if isinstance(one, str) else json.dumps(one) for one in motions.get("named", [])]
        return ", ".join([f"random loops, training seeds 0 to {motions['loops'] - 1}", *(f"`{one}`" for one in named)])
    return f"`{json.dumps(motions)}`"


def _title(condition: Condition) -> str:
    information = "told" if condition.told else "untold"
    return heading(
        Column(information=information, uncertainty=condition.uncertainty, criterion="task", draws=1),
    )


def _kg(payload: float | None) -> str:
    return "none" if payload is None else f"{payload:.2f}"


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def _table(rows: Sequence[Sequence[str]], *, left: int) -> str:
    """Markdown; the first ``left`` columns begin at the left, the others end at the right."""
    rule = ["---" if place < left else "---:" for place in range(len(rows[0]))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (rows[0], rule, *rows[1:]))
