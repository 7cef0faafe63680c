"""Content of a picture: the state of an episode at one instant."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import torque_limits
from cablebot_gym.robots import Robot

HANG = 0.3
"""Distance below a spatial platform at which the payload is drawn [m]. In the model it is at the
centre of mass."""

_STEEL = 7850.0
"""Density of the ball that represents the payload [kg/m³]."""


def ball_radius(payload: float) -> float:
    """Radius [m] of the ball that represents a payload [kg]."""
    return float((3 * payload / (4 * math.pi * _STEEL)) ** (1 / 3))


def full_tension(robot: Robot) -> float:
    """Tension that the strongest motor holds at standstill [N]: the end of the tension scale."""
    return float(np.max(robot.stall_torque / robot.pulley_radius))


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """True state of an episode at one instant.

    Pose and errors are those at ``time``. Torques, torque limits, actions and tensions are those at
    the start of the last control period, and 0 before the first period.
    """

    time: float
    """Time since the start of the episode [s]."""
    payload: float
    """True payload [kg]."""
    pose: Array
    """Pose X [m, rad], (n,)."""
    tensions: Array
    """Cable tensions T [N], (m,)."""
    torques: Array
    """Applied torques τ [N·m], (m,)."""
    torque_limits: Array
    """Torque limits U⁻ and U⁺ at the present motor speeds [N·m], (2, m) (Eq. 37)."""
    commanded_action: Array
    """Actions a, (m,). If |a| > 1, the applied torque saturates at U±."""
    slack: NDArray[np.bool_]
    """Whether each cable is slack, (m,)."""
    position_error: float
    """Distance from the reference position [m]."""
    rotation_error: float
    """Largest difference of an angle from the reference [rad]; 0 for a point mass."""

    @classmethod
    def from_info(
        cls, robot: Robot, stall_torque: Array, pose: Array, info: Mapping[str, Any]
    ) -> Moment:
        """The moment after a control step.

        Args:
            robot: nominal robot.
            stall_torque: true stall torques [N·m], (m,).
            pose: true pose X, (n,).
            info: ``info`` of the step.
        """
        # Uncertain motor strength scales the torque-speed line: the free speed stays nominal.
        strength = stall_torque / robot.stall_torque
        return cls(
            time=float(info["time"]),
            payload=float(info["payload"]),
            pose=pose,
            tensions=info["tensions"],
            torques=info["torques"],
            torque_limits=strength * np.array(torque_limits(robot, info["motor_speeds"])),
            commanded_action=info["commanded_action"],
            slack=info["slack"],
            position_error=float(info["tracking_error"]),
            rotation_error=float(info["rotation_error"]),
        )
