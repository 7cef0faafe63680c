"""The page docs/learned.md, made from the cards."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from cablebot_baselines.learned.shipped import SHIPPED, short_id
from cablebot_gym.task import payload_model_text
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED
from cards.card import Card, SeedRun, Summary, has_loops, summarize
from cards.statistics import CONFIDENCE, RESAMPLES, scores

_HEAD = """# Learned policies

The folder `baselines/cablebot_baselines/learned/weights/` contains the shipped learned policies. Their names work with
`cablebot dlcc --policy NAME` and `cablebot benchmark`. The files contain plain arrays; loading them needs neither torch
nor unpickling. `python scripts/train_shipped.py` trains and evaluates the policies and writes the weights, the cards
and this page.

A learned policy steers a classical law, the base law: its network shifts the law's reference, or plans the acceleration
that the law realises. Each policy was trained with several seeds, and the table includes all of them. The shipped seed
is the one with the median payload in training, so that it is typical and not the luckiest.

* Payloads are dynamic load carrying capacities (DLCC) in kg on the circle between dwells by the task criterion, as on
  the [leaderboard](../LEADERBOARD.md). A policy that fails unloaded counts as 0.
* IQM is the interquartile mean over the training seeds. The brackets contain its {confidence:.0%} interval from
  {resamples} resamples of a bootstrap.
* "base alone" is the base law without the network. "law" is one of the laws in
  `baselines/cablebot_baselines/classical/`.
* The best known payload is that of the leaderboard. It is a lower bound of the largest possible payload.
* Held-out motions have seeds from {held_out} on. They were not used in training or to select a seed or a round. The
  first column counts the motions on which the policy has a larger DLCC than the law, both under the first condition.
  The second column is the median fraction of the best known payload, and the number of motions with one. For policies
  trained on random loops, all training seeds are evaluated and the median is given. Policies trained on the circle
  alone are not made for other motions, and only the shipped seed is evaluated.
* "in training", for policies trained on random loops, is the mean payload on the validation loops. They select the best
  policy of each run and are not used to train the network.
* "training" is the median wall time of one seed.
{earlier}
"""

_PLANNER_INPUTS = "expected state, estimates of the observer and preview of the reference"

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
    text = _HEAD.format(
        confidence=CONFIDENCE,
        resamples=RESAMPLES,
        held_out=FIRST_HELD_OUT_SEED,
        earlier=_earlier_loops(cards),
    )
    rows: list[Sequence[str]] = [_COLUMNS]
    for card in cards:
        rows += _rows(card)
    text += _table(rows, left_columns=3)
    for name in dict.fromkeys(card.policy for card in cards):
        text += _section([card for card in cards if card.policy == name])
    return text


def _earlier_loops(cards: Sequence[Card]) -> str:
    """A line that names the policies whose random loops are of an earlier family."""
    earlier: dict[str, list[str]] = {}
    for card in cards:
        if not card.has_present_loops:
            earlier.setdefault(f"`{card.policy}`", []).append(short_id(card.env_id))
    if not earlier:
        return ""
    policies = ", ".join(f"{name} ({', '.join(ids)})" for name, ids in earlier.items())
    text = "* The same seeds give other random loops today. The loops of these policies, in training and\n"
    text += f"  held out, are of an earlier family, slower and all smooth: {policies}.\n"
    return text


def _rows(card: Card) -> list[list[str]]:
    """Rows of a card: conditions, number of seeds, payloads. The first row names the card."""
    count = str(len(card.seeds))
    rows = []
    if has_loops(card.motions):
        summary = summarize(scores([run.in_training for run in card.seeds]))
        base = _kg(card.base_in_training)
        rows.append(["payload known, in training", count, *_iqm_cells(summary), base, "–", "–"])
    for index, condition in enumerate(card.conditions):
        summary = card.summary(index)
        rows.append(
            [
                payload_model_text(condition.payload_known),
                count,
                *_iqm_cells(summary),
                _kg(card.base_payloads[index]),
                f"`{card.law}` {_kg(card.law_payloads[index])}",
                _of_best_known(card, summary),
            ]
        )
    time = _time(median(run.wall_s for run in card.seeds))
    named = [f"`{card.policy}`", short_id(card.env_id), *rows[0], *_held_out_cells(card), time]
    return [named, *(["", "", *row, "", "", ""] for row in rows[1:])]


def _of_best_known(card: Card, summary: Summary) -> str:
    if not card.best_known:
        return "–"
    return f"{summary.iqm / card.best_known:.0%} of {card.best_known:.2f}"


def _iqm_cells(summary: Summary) -> tuple[str, str]:
    return f"{summary.iqm:.2f} [{summary.low:.2f}, {summary.high:.2f}]", f"{summary.median:.2f}"


def _held_out_cells(card: Card) -> tuple[str, str]:
    fractions = [card.fractions(run) for run in card.evaluated_runs]
    text = "–"
    if fractions[0]:
        text = f"{median(map(median, fractions)):.0%} on {len(fractions[0])}"
    return _above(card, *card.evaluated_runs), text


def _above(card: Card, *runs: SeedRun) -> str:
    return f"{median(map(card.above_law, runs)):g} of {len(card.held_out)}"


def _held_out(card: Card, run: SeedRun) -> str:
    if run not in card.evaluated_runs:
        return "–"
    text = _above(card, run)
    if fractions := card.fractions(run):
        text += f", {median(fractions):.0%}"
    return text


def _section(cards: Sequence[Card]) -> str:
    name = cards[0].policy
    text = f"\n## `{name}`\n\n{_sentence(SHIPPED[name].summary)}.\n\n```sh\n"
    text += "".join(f"{card.command}\n" for card in cards) + "```\n"
    return text + "".join(map(_details, cards))


def _details(card: Card) -> str:
    versions = {}  # in the order of the seeds, without repetitions
    for run in card.seeds:
        text = ", ".join(f"{name} {number}" for name, number in run.versions.items())
        versions[text] = None
    planner = "The training used no planner."
    if card.planner_output_used:
        planner = "The training used a planner's output."
    text = f"\n### {short_id(card.env_id)}\n\n"
    text += f"* Base law: {card.base_text}.\n"
    text += f"* Action mapping: {_steering(card.steering)}. Network: {card.parameters} parameters; inputs "
    text += f"{', '.join(card.features) or _PLANNER_INPUTS}.\n"
    text += f"* Training motions: {_trained_on(card)}, with dwells of at least {card.dwell:g} s. "
    text += f"{planner}\n"
    text += f"* Shipped seed {card.shipped_seed}: `{card.shipped.command}`\n"
    if card.sb3:
        text += f"* `{card.stem}-sb3.zip` contains the same actor as a model of Stable-Baselines3, for further "
        text += "training. Its inputs are the features, normalised with the bundle's `mean` and `scale` and clipped at "
        text += "±10.\n"
    text += f"* Versions: {'; '.join(versions)}\n\n"
    conditions = [payload_model_text(condition.payload_known) for condition in card.conditions]
    rows = [["seed", "steps", "wall time", "in training", *conditions, "held-out", ""]]
    for run in card.seeds:
        numbers = [_kg(run.in_training), *map(_kg, run.payloads), _held_out(card, run)]
        ships = "ships" if run is card.shipped else ""
        rows.append([str(run.seed), str(run.timesteps), _time(run.wall_s), *numbers, ships])
    return text + _table(rows, left_columns=0)


def _steering(action_mapping: Mapping[str, Any]) -> str:
    units = {"action_period": " s"}
    words = [action_mapping["kind"]]
    for name, value in action_mapping.items():
        if name != "kind":
            numbers = value if isinstance(value, (list, tuple)) else [value]
            text = " and ".join(f"{number:g}" for number in numbers)
            words.append(f"{name} {text}{units.get(name, '')}")
    return ", ".join(words)


def _trained_on(card: Card) -> str:
    words = []
    if has_loops(card.motions):
        loops = "random loops"
        if not card.has_present_loops:
            loops += " of an earlier family"
        words.append(f"{loops}, training seeds 0 to {card.motions['loops'] - 1}")
    for motion in card.motions.get("named", []):
        if not isinstance(motion, str):
            motion = json.dumps(motion)
        words.append(f"`{motion}`")
    return ", ".join(words)


def _kg(payload: float | None) -> str:
    if payload is None:
        return "fails unloaded"
    return f"{payload:.2f}"


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def _table(rows: Sequence[Sequence[str]], *, left_columns: int) -> str:
    """A Markdown table; the first columns are left-aligned, the others right-aligned."""
    head, *body = rows
    rule = ["---"] * left_columns + ["---:"] * (len(head) - left_columns)
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, rule, *body))
