"""The page docs/learned.md, made from the cards."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np

from cablebot_baselines.learned.shipped import SHIPPED, short_id
from cablebot_gym.benchmark.scores import Column
from cablebot_gym.benchmark.tables import heading
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED
from cards.card import Card, Condition, SeedRun, Summary, has_loops, summarize
from cards.statistics import CONFIDENCE, RESAMPLES, iqm, iqm_interval, scores

_HEAD = """# Learned policies

The folder `baselines/cablebot_baselines/learned/weights/` contains the shipped learned policies. Their names work with
`cablebot dlcc --policy NAME` and `cablebot benchmark`. The files contain plain arrays; loading them needs neither torch
nor unpickling. `python scripts/train_shipped.py` trains and evaluates the policies and writes the weights, the cards
and this page. APG means analytic policy gradient: training by gradients through the inverse dynamics.

A learned policy steers a classical law, the base law: its network shifts the law's reference, or adds to the law's
actions. Each policy was trained with several seeds, and the table includes all of them. The shipped seed is the one
with the median payload in training, so that it is typical and not the luckiest.

* Payloads are dynamic load carrying capacities (DLCC) in kg on the circle between dwells by the task criterion, as on
  the [leaderboard](../LEADERBOARD.md){drawn}.
  A policy that fails unloaded counts as 0.
* IQM is the interquartile mean over the training seeds. The brackets contain its {confidence:.0%} interval from
  {resamples} resamples of a stratified bootstrap; the strata are the environments.
* "base alone" is the base law without the network. "law" is one of the laws in
  `baselines/cablebot_baselines/classical/`.
* The best known payload is that of the leaderboard without uncertainty. It is a lower bound of the largest possible
  payload.
* Held-out motions have seeds from {held_out} on. They were not used in training or to select a seed or a round. The
  first column counts the motions on which the policy has a larger DLCC than the law, both under the first condition.
  The second column is the median fraction of the best known payload, and the number of motions with one. For policies
  trained on random loops, all training seeds are evaluated and the median is given. Policies trained on the circle
  alone are not made for other motions, and only the shipped seed is evaluated.
* "in training", for policies trained on random loops, is the mean payload on the validation loops. They select the best
  policy of each run and are not used to train the network.
* "training" is the median wall time of one seed.

"""

_COLUMNS = (
    *(
        "policy",
        "id",
        "condition",
        "seeds",
        "IQM",
        "median",
        "base alone",
        "law",
        "IQM of best known payload",
    ),
    *("held-out: above law", "held-out: of best known payload", "training"),
)


def card_markdown(cards: Sequence[Card]) -> str:
    """The page: one table of all policies, then each policy's command, base law, versions and
    seeds.

    Args:
        cards: cards in the order of the page, at least one.
    """
    drawn = ""
    for card in cards:
        if names := list(
            dict.fromkeys(one.uncertainty for one in card.conditions if one.uncertainty)
        ):
            drawn = f".\n  Under {', '.join(f'`{name}`' for name in names)} they are lower tolerance bounds: with 95% "
            drawn += f"confidence,\n  {card.probability:.0%} of the episodes succeed, by {card.draws} fresh draws"
    text = _HEAD.format(
        drawn=drawn, confidence=CONFIDENCE, resamples=RESAMPLES, held_out=FIRST_HELD_OUT_SEED
    )
    text += _table([_COLUMNS, *(row for card in cards for row in _rows(card))], left=3)
    text += "\n![Payload versus wall time during training](learned.png)\n"
    for name in dict.fromkeys(card.policy for card in cards):
        text += _section([card for card in cards if card.policy == name])
    return text


def _rows(card: Card) -> list[list[str]]:
    seeds, rows = str(len(card.seeds)), []
    if has_loops(card.motions):
        summary = summarize(scores([run.in_training for run in card.seeds]))
        rows.append(
            [
                "payload known, in training",
                seeds,
                *_iqm_cells(summary),
                _kg(card.base_in_training),
                "–",
                "–",
            ]
        )
    for index, condition in enumerate(card.conditions):
        summary = card.summary(index)
        rows.append(
            [
                _title(card, condition),
                seeds,
                *_iqm_cells(summary),
                _kg(card.base_payloads[index]),
                f"`{card.law}` {_kg(card.law_payloads[index])}",
                _of_best_known(card, condition, summary),
            ]
        )
    time = _time(median(run.wall_s for run in card.seeds))
    first = [f"`{card.policy}`", short_id(card.env_id), *rows[0], *_held_out_cells(card), time]
    return [first, *(["", "", *row, "", "", ""] for row in rows[1:])]


def _of_best_known(card: Card, condition: Condition, summary: Summary) -> str:
    """No fraction under uncertainty: the best known payload is that of the nominal robot."""
    if condition.uncertainty or not card.best_known:
        return "–"
    return f"{summary.iqm / card.best_known:.0%} of {card.best_known:.2f}"


def _iqm_cells(summary: Summary) -> tuple[str, str]:
    return f"{summary.iqm:.2f} [{summary.low:.2f}, {summary.high:.2f}]", f"{summary.median:.2f}"


def _held_out_cells(card: Card) -> tuple[str, str]:
    fractions = [card.fractions(run) for run in card.evaluated_runs]
    fraction = (
        f"{median(map(median, fractions)):.0%} on {len(fractions[0])}" if fractions[0] else "–"
    )
    return _above(card, *card.evaluated_runs), fraction


def _above(card: Card, *runs: SeedRun) -> str:
    return f"{median(map(card.above_law, runs)):g} of {len(card.held_out)}"


def _held_out(card: Card, run: SeedRun) -> str:
    if run not in card.evaluated_runs:
        return "–"
    fractions = card.fractions(run)
    return _above(card, run) + (f", {median(fractions):.0%}" if fractions else "")


def _section(cards: Sequence[Card]) -> str:
    first = cards[0]
    text = f"\n## `{first.policy}`\n\n{_sentence(SHIPPED[first.policy].summary)}.\n\n```sh\n"
    text += "".join(f"{card.command}\n" for card in cards) + "```\n"
    known = [(card, card.best_known) for card in cards if card.best_known]
    if len(known) > 1 and len(known) == len(cards):
        fractions = [np.array(card.payloads(0)) / best for card, best in known]
        low, high = iqm_interval(fractions)
        mean = float(iqm(np.concatenate(fractions)))
        condition = _title(first, first.conditions[0])
        text += f"\nOver its {len(cards)} environments ({condition}), "
        text += "the IQM of the fraction of the best known payload "
        text += f"is {mean:.1%} [{low:.1%}, {high:.1%}].\n"
    return text + "".join(_details(card) for card in cards)


def _details(card: Card) -> str:
    versions = "; ".join(
        dict.fromkeys(
            ", ".join(f"{name} {number}" for name, number in run.versions.items())
            for run in card.seeds
        )
    )
    planner = (
        "The training used a planner's output."
        if card.planner_output_used
        else "The training used no planner."
    )
    text = f"\n### {short_id(card.env_id)}\n\n"
    text += f"* Base law: {card.base_text}.\n"
    text += f"* Action mapping: {_steering(card.steering)}. Network: {card.parameters} parameters; inputs "
    text += f"{', '.join(card.features)}.\n"
    text += f"* Training motions: {_trained_on(card.motions)}, with dwells of at least {card.dwell:g} s. "
    text += f"{planner}\n"
    text += f"* Shipped seed {card.shipped_seed}: `{card.shipped.command}`\n"
    if card.sb3:
        text += f"* `{card.stem}-sb3.zip` contains the same actor as a model of Stable-Baselines3, for further "
        text += "training. Its inputs are the features, normalised with the bundle's `mean` and `scale` and clipped at "
        text += "±10.\n"
    text += f"* Versions: {versions}\n\n"
    conditions = [_title(card, condition) for condition in card.conditions]
    rows = [["seed", "steps", "wall time", "in training", *conditions, "held-out", ""]]
    for run in card.seeds:
        numbers = [_kg(run.in_training), *map(_kg, run.payloads), _held_out(card, run)]
        ships = "ships" if run.seed == card.shipped_seed else ""
        rows.append([str(run.seed), str(run.timesteps), _time(run.wall_s), *numbers, ships])
    return text + _table(rows, left=0)


def _steering(action_mapping: Mapping[str, Any]) -> str:
    numbers = {
        name: value
        for name, value in action_mapping.items()
        if name != "kind" and (value or name != "preview")
    }
    units = {"action_period": " s", "preview": " s"}
    return f"{action_mapping['kind']}, " + ", ".join(
        f"{name} {value:g}{units.get(name, '')}" for name, value in numbers.items()
    )


def _trained_on(motions: Mapping[str, Any]) -> str:
    loops = (
        [f"random loops, training seeds 0 to {motions['loops'] - 1}"] if has_loops(motions) else []
    )
    named = [one if isinstance(one, str) else json.dumps(one) for one in motions.get("named", [])]
    return ", ".join([*loops, *(f"`{one}`" for one in named)])


def _title(card: Card, condition: Condition) -> str:
    return heading(
        Column(
            motion="",
            payload_known=condition.payload_known,
            model_payload_factor=1.0,
            uncertainty=condition.uncertainty,
            criterion="task",
            draws=card.draws if condition.uncertainty else 1,
        ),
    )


def _kg(payload: float | None) -> str:
    return "fails unloaded" if payload is None else f"{payload:.2f}"


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def _table(rows: Sequence[Sequence[str]], *, left: int) -> str:
    """A Markdown table; the first ``left`` columns are left-aligned, the others right-aligned."""
    rule = ["---" if index < left else "---:" for index in range(len(rows[0]))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (rows[0], rule, *rows[1:]))
