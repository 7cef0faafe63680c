"""Tunes the gains of a law by the largest unknown payload that it carries.

Run it: python examples/tune_gains.py
"""

import math

from cablebot_gym import evaluate_dlcc

best = 0.0, 0.0
for stiffness in (25.0, 900.0, 10_000.0, 1e6):
    damping = 2 * math.sqrt(stiffness)
    result = evaluate_dlcc(
        f"fl:gains={stiffness}/{damping}",
        "CableBot-Planar-v0",
        payload_known=False,
        search="bisection",  # quick, but unranked
    )
    # The payload of gains that fail unloaded is None, which has no order; their score is 0.
    print(f"K_P = {stiffness:g}: score {result.score:.2f} kg, payload {result.payload}")
    best = max(best, (result.score, stiffness))
print(f"best: K_P = {best[1]:g}, {best[0]:.2f} kg")
