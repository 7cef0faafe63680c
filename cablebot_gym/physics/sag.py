"""Sag of heavy cables, which the straight cables of the model leave out.

A cable hangs in a parabola. T is the component of the tension along the chord between its ends, L
the length of the chord, w the weight per length [N/m], and θ the inclination of the chord: only the
component ``w cos θ`` bends the cable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import all_finite


@dataclass(frozen=True, kw_only=True, eq=False)
class Sag:
    """Sag of cables; each array has the shape of the tensions."""

    length: Array
    """Length L of the chord [m]."""
    sag: Array
    """Largest distance between cable and chord, w cos θ L²/(8 T) [m]; infinite without tension."""
    extra_length: Array
    """Length of the cable minus that of the chord, (w cos θ)² L³/(24 T²) [m]."""
    stiffness_factor: Array
    """Stiffness of the cable over that of a straight one, 1/(1 + λ²/12) with Irvine's λ² = (w cos θ
    L/T)² EA/T; 1 if the cable does not stretch."""


def sag(robot: Robot, pose: ArrayLike, tensions: ArrayLike) -> Sag:
    """Sag of a robot's cables at poses (..., n) with tensions T (..., m); without the radius of
    swivel pulleys."""
    all_finite("tensions", tensions)
    tensions = np.asarray(tensions, float)
    vectors = kinematics.cable_vectors(robot.base, robot.platform, pose)
    length = np.linalg.norm(vectors, axis=-1)
    across = np.linalg.norm(vectors[..., :-1], axis=-1)  # horizontal distance of the ends
    if robot.planar and robot.plane == "horizontal":
        across = length
    weight = robot.gravity * robot.per_motor(robot.cable_density)
    softening = np.zeros_like(tensions)
    with np.errstate(divide="ignore", invalid="ignore"):  # cables without tension
        bending = np.where(weight > 0, weight * across / tensions, 0.0)  # w cos θ L/T
        if robot.elastic:
            irvine = bending**2 * robot.axial_stiffness / tensions
            softening = np.where(bending > 0, irvine / 12, 0.0)
    return Sag(
        length=length,
        sag=bending * length / 8,
        extra_length=bending**2 * length / 24,
        stiffness_factor=1 / (1 + softening),
    )
