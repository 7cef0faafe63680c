"""All parts of the page in their order, and their verdicts."""

from collections.abc import Iterator
from typing import Any

from cablebot_reproduction.judgement import VERDICTS
from cablebot_reproduction.part import Part
from cablebot_reproduction.parts import (
    algorithm,
    claims,
    drawings,
    eq22,
    flexible_saturation,
    interpretations,
    maps,
    robust,
    saturation,
    scan,
    tracking,
)
from cablebot_reproduction.published import load_text

__all__ = ["PARTS", "VERDICTS"]

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
    "fig14": (
        flexible_saturation.path_jobs,
        flexible_saturation.path_outcome,
        flexible_saturation.draw_path,
    ),
    "fig15": (
        flexible_saturation.torque_jobs,
        flexible_saturation.torque_outcome,
        flexible_saturation.draw_torques,
    ),
    "eq37": (algorithm.jobs, algorithm.outcome, algorithm.draw),
    "eq22": (eq22.jobs, eq22.outcome, eq22.draw),
    "claims": (claims.jobs, claims.outcome, None),
    "interpretations": (interpretations.jobs, interpretations.outcome, None),
    "scan": (scan.jobs, scan.outcome, scan.draw),
    "map-circle": (maps.jobs, maps.outcome, maps.draw),
}
"""Jobs, outcome and figure of each part."""


def _parts() -> Iterator[Part]:
    """The parts in the order of parts.md, which has their titles and descriptions."""
    _, *sections = load_text("parts.md").split("\n## ")
    for section in sections:
        heading, _, text = section.partition("\n")
        name, _, title = heading.partition(": ")
        jobs, outcome, draw = _FUNCTIONS[name]
        yield Part(name=name, title=title, text=text.strip(), jobs=jobs, outcome=outcome, draw=draw)


PARTS: tuple[Part, ...] = tuple(_parts())
"""All parts: figures of the paper, its laws and claims, its interpretations, and a map beyond the
paper."""
