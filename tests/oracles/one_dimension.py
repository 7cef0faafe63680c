"""A motion in one dimension, whose largest payload follows by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from cablebot_gym.motions import Reference
from cablebot_gym.robots import Motors, Robot, Transmission

BOUND = 0.05
"""Position error bound [m]."""

TENSION = 3.0
"""Minimum tension of all cables [N]."""


@dataclass(frozen=True, kw_only=True)
class Accelerating:
    """From rest at the origin along x with a constant acceleration."""

    rate: float = 2.0
    duration: float = 1.0
    name: str = "accelerating"
    coordinates: int = 2

    def __call__(self, times):
        t = np.clip(np.asarray(times, float), 0.0, self.duration)[..., None]
        x = np.array([1.0, 0.0])
        zero = 0 * t * x
        return Reference(
            position=self.rate / 2 * t**2 * x,
            velocity=self.rate * t * x,
            acceleration=self.rate * x + zero,
            jerk=zero,
            snap=zero,
        )


def line_robot(*, inertia, free_speed, damping):
    """Two cables along x and two against it, so long that they stay parallel."""
    return Robot(
        name="line",
        base_anchors=((10.0, 0.01), (10.0, -0.01), (-10.0, 0.01), (-10.0, -0.01)),
        mass=1.0,
        motors=Motors(stall_torque=5.0, free_speed=free_speed),
        transmission=Transmission(pulley_radius=0.05, pulley_inertia=inertia, damping=damping),
        home_pose=(0.0, 0.0),
        minimum_tension=TENSION,
    )


def largest_mass(*, inertia, free_speed, damping):
    """At full torque of two cables and least tension T₀ of the other two, (M + 2μ) ẍ + 2k ẋ = 2(s −
    T₀) must reach x_d(T) − R."""
    radius = 0.05
    motion = Accelerating()
    pull = 5.0 / radius
    mu = inertia / radius**2
    k = (5.0 / free_speed + damping) / radius**2
    end = motion.duration

    def surplus(mass):
        rate = 2 * k / (mass + 2 * mu)
        acceleration = 2 * (pull - TENSION) / (mass + 2 * mu)
        distance = (
            end**2 / 2 if rate * end < 1e-4 else end / rate - (1 - math.exp(-rate * end)) / rate**2
        )
        return acceleration * distance - (motion.rate * end**2 / 2 - BOUND)

    return float(brentq(surplus, 1.0, 1e4))
