"""All parts of the page in their order."""

from cablebot_baselines.paper.part import Part
from cablebot_baselines.paper.parts import (
    drawings,
    flexible_saturation,
    interpretations,
    laws,
    maps,
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
    *interpretations.PARTS,
    *scan.PARTS,
    *maps.PARTS,
)
"""All parts: figures of the paper, its laws and claims, its interpretations, and maps beyond the paper."""
