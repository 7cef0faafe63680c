"""Colours of figures and pictures: greys and the palette of Okabe and Ito, which is safe for
colour-blind readers."""

BLUE = "#0072B2"
VERMILLION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
ORANGE = "#E69F00"
DEEP_SKY = "#56B4E9"
YELLOW = "#F0E442"
BLACK = "#000000"
SKY = "#CFE8F7"
GREY = "#767676"
SHADE = "#E8E8E8"
