"""Figure of the payloads during training, from the cards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cablebot_baselines.learned.shipped import short_id
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cards.card import Card, Condition, SeedRun, has_loops
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
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for card, axes in zip(cards, panels, strict=False):
        _curves(axes, card)
    for axes in panels[len(cards) :]:
        axes.set_axis_off()
    # The panel of a circle has all labels.
    complete = [bool(card.best_known) and not has_loops(card.motions) for card in cards]
    add_legend(figure, figure.axes[complete.index(True) if True in complete else 0])
    set_title(
        figure, "Payload during training, on the motions that select the best policy of a run"
    )
    return figure


def _curves(axes: Axes, card: Card) -> None:
    label = "other seeds"
    for run in card.seeds:
        if run.seed != card.shipped_seed:
            _curve(axes, run, color=BLUE, linewidth=1.0, label=label)
            label = "_"  # one entry of the legend for all
    _curve(axes, card.shipped, color=VERMILLION, linewidth=1.8, label="shipped seed")
    motion = "circle"
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
        condition = Condition(payload_known=known, uncertainty=uncertainty)
        if condition in card.conditions:
            (law,) = scores([card.law_payloads[card.conditions.index(condition)]])
            axes.axhline(law, color=GREY, linestyle="-.", linewidth=1.0, label="classical law")
    else:
        motion = "loops, mean"
    (base,) = scores([card.base_in_training])
    axes.axhline(base, color=GREY, linestyle=":", linewidth=1.0, label="base law alone")
    axes.set_title(f"{card.policy}, {short_id(card.env_id)}: {motion}", fontsize=10)
    axes.margins(y=0.08)
    axes.set_ylim(bottom=0)
    axes.set_xlim(left=0)
    axes.set(xlabel="wall time [s]", ylabel="payload [kg]")


def _curve(axes: Axes, run: SeedRun, **style: Any) -> None:
    times = [row["wall_s"] for row in run.curve]
    payloads = scores([row["payload_kg"] for row in run.curve])
    axes.plot(times, payloads, marker=".", **style)
