"""Figure of the payloads during training, from the cards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from cablebot_baselines.learned.shipped import short_id
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cards.card import Card, Condition, has_loops
from cards.statistics import scores

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_curves(cards: Sequence[Card]) -> Figure:
    """Draws payload versus wall time during training for all seeds, one panel for each policy and
    environment.

    Args:
        cards: cards in the order of the panels, at least one.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    columns = min(3, len(cards))
    rows = -(-len(cards) // columns)
    figure = new_figure(1.2 + 2.6 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for card, axes in zip(cards, panels, strict=False):
        _curves(axes, card)
    for axes in list(panels)[len(cards) :]:
        axes.set_axis_off()
    shown = next(
        (
            index
            for index, card in enumerate(cards)
            if not has_loops(card.motions) and card.best_known
        ),
        0,
    )
    add_legend(figure, figure.axes[shown])
    set_title(
        figure, "Payload during training, on the motions that select the best policy of a run"
    )
    return figure


def _curves(axes: Axes, card: Card) -> None:
    others = [run for run in card.seeds if run.seed != card.shipped_seed]
    for index, run in enumerate([*others, card.shipped]):  # the shipped run is drawn on top
        ships = run.seed == card.shipped_seed
        axes.plot(
            [row["wall_s"] for row in run.curve],
            scores([row["payload_kg"] for row in run.curve]),
            marker=".",
            color=VERMILLION if ships else BLUE,
            linewidth=1.8 if ships else 1.0,
            label="shipped seed" if ships else "_" if index else "other seeds",
        )
    where = "circle"
    if not has_loops(card.motions):
        if card.best_known:
            axes.axhline(
                card.best_known,
                color="black",
                linestyle="--",
                linewidth=1.0,
                label="best known payload",
            )
        known = card.evaluation.get("payload_known", True)
        uncertainty = card.evaluation.get("uncertainty")
        if (same := Condition(payload_known=known, uncertainty=uncertainty)) in card.conditions:
            (law,) = scores([card.law_payloads[card.conditions.index(same)]])
            axes.axhline(law, color=GREY, linestyle="-.", linewidth=1.0, label="classical law")
    else:
        where = "loops, mean"
    (base,) = scores([card.base_in_training])
    axes.axhline(base, color=GREY, linestyle=":", linewidth=1.0, label="base law alone")
    axes.set_title(f"{card.policy}, {short_id(card.env_id)}: {where}", fontsize=10)
    axes.margins(y=0.08)
    axes.set_ylim(bottom=0)
    axes.set_xlim(left=0)
    axes.set(xlabel="wall time [s]", ylabel="payload [kg]")
