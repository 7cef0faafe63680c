"""All parts of the page in their order."""

from typing import Any

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
from cablebot_baselines.paper.published import load_text

_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "fig1": (drawings.no_jobs, drawings.planar_outcome, drawings.draw_planar),
    "fig2": (drawings.spatial_jobs, drawings.spatial_outcome, drawings.draw_spatial),
    "fig3": (drawings.spatial_jobs, drawings.joint_outcome, drawings.draw_joint),
    "fig5": (tracking.planar_jobs, tracking.loop_outcome, tracking.draw_planar),
    "fig6": (tracking.spatial_jobs, tracking.loop_outcome, tracking.draw_spatial),
    "fig7": (tracking.flexible_jobs, tracking.flexible_outcome, tracking.draw_flexible),
    "fig8": (robust.term_jobs, robust.term_outcome, robust.draw_term),
    "fig9": (robust.tracking_jobs, robust.tracking_outcome, robust.draw_tracking),
    "fig10": (saturation.PLANAR.jobs, saturation.PLANAR.torques, saturation.PLANAR.draw_torques),
    "fig11": (saturation.PLANAR.jobs, saturation.PLANAR.path, saturation.PLANAR.draw_path),
    "fig12": (saturation.SPATIAL.jobs, saturation.SPATIAL.torques, saturation.SPATIAL.draw_torques),
    "fig13": (saturation.SPATIAL.jobs, saturation.SPATIAL.path, saturation.SPATIAL.draw_path),
    "fig14": (flexible_saturation.path_jobs, flexible_saturation.path_outcome, flexible_saturation.draw_path),
    "fig15": (flexible_saturation.torque_jobs, flexible_saturation.torque_outcome, flexible_saturation.draw_torques),
    "eq37": (laws.eq37_jobs, laws.eq37_outcome, laws.draw_eq37),
    "eq22": (laws.eq22_jobs, laws.eq22_outcome, laws.draw_eq22),
    "claims": (laws.claims_jobs, laws.claims_outcome, None),
    "interpretations": (interpretations.jobs, interpretations.outcome, None),
    "scan": (scan.jobs, scan.outcome, scan.draw),
    "map-circle": (maps.jobs, maps.outcome, maps.draw),
}
"""Jobs, outcome and figure of each part."""


def _texts() -> dict[str, tuple[str, str]]:
    """Title and description of each part from parts.md."""
    _, *sections = load_text("parts.md").split("\n## ")
    heads = (section.partition("\n") for section in sections)
    return {head.partition(": ")[0]: (head.partition(": ")[2], text.strip()) for head, _, text in heads}


PARTS: tuple[Part, ...] = tuple(
    Part(name=name, title=title, text=text, jobs=jobs, outcome=outcome, draw=draw)
    for name, (title, text) in _texts().items()
    for jobs, outcome, draw in (_FUNCTIONS[name],)
)
"""All parts: figures of the paper, its laws and claims, its interpretations, and a map beyond the paper."""
