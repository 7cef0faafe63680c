"""Cards of the shipped learned policies: DLCC of every training seed, intervals, and the training itself.

Each policy is trained with several seeds. Their DLCCs are summarised by the interquartile mean and a stratified
bootstrap interval, as in rliable (Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical
Precipice*, 2021). The shipped seed is the one with the median payload. Making a card needs torch; reading and rendering
one does not.
"""

from cards.card import DRAWS, HELD_OUT, LEAST_SEEDS, Card, has_loops, read_cards
from cards.figure import draw_curves
from cards.making import Evaluate, base_text, make_card, read_best_known, with_best_known, with_search_results
from cards.page import card_markdown
from cards.statistics import iqm, iqm_interval, median_seed

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
    "median_seed",
    "read_best_known",
    "read_cards",
    "with_best_known",
    "with_search_results",
]
