"""Figures of evaluation results, comparisons and robots. Needs the extra ``plot``."""

from cablebot_gym.plotting.comparison import (
    draw_comparison,
    draw_payload_comparison,
    save_comparison,
)
from cablebot_gym.plotting.figures import (
    draw_path,
    draw_result,
    draw_springs,
    draw_success,
    draw_torques,
    save_figures,
)
from cablebot_gym.plotting.robots import draw_robot

__all__ = [
    "draw_comparison",
    "draw_path",
    "draw_payload_comparison",
    "draw_result",
    "draw_robot",
    "draw_springs",
    "draw_success",
    "draw_torques",
    "save_comparison",
    "save_figures",
]
