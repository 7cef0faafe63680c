"""Draws the paper's Fig. 10: torques of all motors with their limits U±, and the path. Extra plot.

Run it: python examples/paper_figure.py [FILE.png]
"""

import sys
from pathlib import Path

from cablebot_gym import evaluate_dlcc
from cablebot_gym.plotting import draw_result

if __name__ == "__main__":
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "fig10").with_suffix(".png")
    result = evaluate_dlcc("fl", "CableBot-Planar-v0", criterion="paper", trajectory="paper-planar")
    draw_result(result).savefig(path, dpi=150)
    print(f"{result}\nwrote {path}")
