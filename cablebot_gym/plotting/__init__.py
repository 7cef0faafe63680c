"""Figures of evaluation results, comparisons and robots. Needs the extra ``plot``."""

from io import BytesIO
from typing import Any

from cablebot_gym.plotting.comparison import draw_comparison, draw_payload_comparison
from cablebot_gym.plotting.figures import (
    draw_result,
    draw_rollout,
    draw_torques,
    save_result,
)
from cablebot_gym.plotting.robots import draw_robot

__all__ = [
    "draw_comparison",
    "draw_payload_comparison",
    "draw_result",
    "draw_robot",
    "draw_rollout",
    "draw_torques",
    "figure_png",
    "save_result",
]

_DRAWINGS: dict[str, Any] = {
    "DLCCResult": draw_result,
    "Rollout": draw_rollout,
    "Comparison": draw_comparison,
    "PayloadComparison": draw_payload_comparison,
    "RobotCheck": draw_robot,
}
"""Drawing function by the type of the result."""


def figure_png(result: Any) -> bytes | None:
    """Figure of a result as PNG; None without matplotlib, or if the result has no figure."""
    draw = _DRAWINGS.get(type(result).__name__)
    if draw is None:
        return None
    picture = BytesIO()
    try:
        draw(result).savefig(picture, format="png")
    except ImportError:
        return None
    return picture.getvalue()
