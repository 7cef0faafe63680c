"""The table of contents: every part of the page, in its order."""

from cablebot_baselines.paper.part import Part
from cablebot_baselines.paper.parts import (
    drawings,
    flexible_saturation,
    laws,
    maps,
    readings,
    robust,
    saturation,
    scan,
    tracking,
)

PARTS: tuple[Part, ...] = (
    *drawings.PARTS,
    *tracking.PARTS,
    *robust.PARTS,
    *saturation.PARTS,
    *flexible_saturation.PARTS,
    *laws.PARTS,
    *readings.PARTS,
    *scan.PARTS,
    *maps.PARTS,
)
"""Figures of the paper, its laws and claims, its readings, and the maps beyond it."""
