"""A motion of your own: out along y and back, ever quicker, and what the paper's law still carries on it.

Run it: python examples/your_trajectory.py
"""

import numpy as np

from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.trajectories import Reference

HOP = 0.2 * np.polynomial.Polynomial.fromroots([0] * 5 + [1] * 5) * -(2**10)  # [m]; 0.2 at its middle


class Hop:
    """From rest to rest by a polynomial with five roots at either end: smooth to snap, and at rest ever after."""

    def __init__(self, duration):
        self.name, self.coordinates, self.duration = "hop", 2, duration

    def __call__(self, times):
        share = np.clip(np.asarray(times, float) / self.duration, 0, 1)
        y = [HOP.deriv(order)(share) / self.duration**order for order in range(5)]
        names = ("position", "velocity", "acceleration", "jerk", "snap")
        return Reference(**{name: np.stack([0 * value, value], axis=-1) for name, value in zip(names, y, strict=True)})


if __name__ == "__main__":
    for duration in (0.7, 0.6, 0.5):
        print(evaluate_dlcc("fl", "CableBot-Planar-v0", trajectory=Hop(duration)))
