"""Cards of the learned policies that ship: what every training seed carries, with intervals, and how it was trained.

A policy is trained with several seeds. What they carry is summed up by the interquartile mean and a stratified
bootstrap interval, as rliable has them (Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical
Precipice*, 2021). The seed with the median payload ships. Making a card needs torch; reading and rendering does not.
"""

from cards.card import DRAWS, HELD_OUT, LEAST_SEEDS, Card, has_loops, read_cards
from cards.figure import draw_curves
from cards.making import Evaluate, base_text, make_card, read_bests, with_bests, with_searched
from cards.page import card_markdown
from cards.statistics import iqm, iqm_interval, typical

__all__ = [
    "DRAWS",
    "HELD_OUT",
    "LEAST_SEEDS",
    "Card",
    "Evaluate",
    "base_text",
    "card_markdown",
    "draw_curves",
    "has_loops",
    "iqm",
    "iqm_interval",
    "make_card",
    "read_bests",
    "read_cards",
    "typical",
    "with_bests",
    "with_searched",
]
