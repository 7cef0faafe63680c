"""Evaluates the paper's law on your own motion: along y and back, faster each time.

Run it: python examples/your_trajectory.py
"""

import numpy as np

from cablebot_gym import evaluate_dlcc
from cablebot_gym.motions import Reference

HOP = 0.2 * np.polynomial.Polynomial.fromroots([0] * 5 + [1] * 5) * -(2**10)  # [m]; 0.2 at its middle


class Hop:
    """Rest-to-rest polynomial with five roots at either end: smooth up to snap, at rest
    afterwards."""

    def __init__(self, duration):
        self.name = "hop"
        self.coordinates = 2
        self.duration = duration

    def __call__(self, times):
        fraction = np.clip(np.asarray(times, float) / self.duration, 0, 1)
        y = [HOP.deriv(order)(fraction) / self.duration**order for order in range(5)]
        names = ("position", "velocity", "acceleration", "jerk", "snap")
        return Reference(**{k: np.stack([0 * v, v], axis=-1) for k, v in zip(names, y, strict=True)})


if __name__ == "__main__":
    for duration in (0.7, 0.6, 0.5):
        print(evaluate_dlcc("fl", "CableBot-Planar-v0", trajectory=Hop(duration)))
