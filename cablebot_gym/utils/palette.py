"""Colours of figures and pictures: greys and the palette of Okabe and Ito, which is safe for
colour-blind readers."""

from __future__ import annotations

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, DEEP_SKY, YELLOW, BLACK = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000"),
)
SKY, GREY, SHADE = "#CFE8F7", "#767676", "#E8E8E8"
