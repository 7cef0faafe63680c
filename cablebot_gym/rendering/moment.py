"""What there is to see of a robot: of an episode, and at one instant."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits
from cablebot_gym.trajectories import Trajectory

HANG = 0.3
"""How far below a spatial platform the payload is drawn [m]; in the model it is at the platform's centre of mass."""

_STEEL = 7850.0
"""The payload is drawn as a ball of this density [kg/m³]."""


def ball_radius(payload: float) -> float:
    """Of the ball that stands for a payload [kg], in m."""
    return float((3 * payload / (4 * math.pi * _STEEL)) ** (1 / 3))


def full_tension(robot: Robot) -> float:
    """What the strongest motor holds at standstill [N]: the end of the scale of tensions."""
    return float(np.max(robot.stall_torque / robot.pulley_radius))


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What stays the same throughout an episode."""

    robot: Robot
    """The one that policies are told of: its geometry is drawn."""
    trajectory: Trajectory
    """Reference motion."""
    limits: Limits
    """Bounds of the tracking error."""
    title: str = ""
    """Words above the picture."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """One instant of an episode, as it truly is. SI units and radians.

    Pose and errors are those at ``time``; torques, limits, demands and tensions those at the start of the control
    period just passed, zeros where none has.
    """

    time: float
    payload: float
    """[kg]"""
    pose: Array
    """X, (n,)."""
    tensions: Array
    """T, (m,)."""
    torques: Array
    """τ, (m,)."""
    torque_limits: Array
    """U⁻ and U⁺ at the motors' speeds, (2, m) (Eq. 37)."""
    drive_demand: Array
    """a, (m,): beyond ±1 a motor gives U± and no more."""
    slack: NDArray[np.bool_]
    """(m,)"""
    position_error: float
    """Distance from the reference."""
    rotation_error: float
    """Angle from the reference; 0 if planar."""
