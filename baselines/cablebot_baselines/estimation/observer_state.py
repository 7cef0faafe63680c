"""What an observer knows of the robots that it meets, and its state between two control steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.estimation.filtering import Dynamics
from cablebot_gym.kinematics import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotEstimate:
    """What the observer knows of N robots."""

    pose: Array
    """Pose X, (N, n) [m, rad]."""
    velocity: Array
    """Velocity Ẋ, (N, n) [m/s, rad/s]."""
    mass: Array
    """Mass of platform and payload, (N,) [kg]."""
    strength: Array
    """Strength of each motor as a fraction of the expected one, (N, m)."""
    delay: Array
    """Time between the request of an action and its torque, (N,) [s]."""
    wrench: Array
    """Wrench on the platform, (N, n) [N, N·m]."""
    zero: Array
    """Zero error of the deflection of each spring, (N, m) [rad]; zero for a rigid robot."""

    def of(self, rows: NDArray[np.intp]) -> RobotEstimate:
        """The estimates of some of the robots."""
        return RobotEstimate(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverState:
    """State of the filter for N episodes."""

    mean: Array
    """Pose, velocity, mass, strengths, delay, wrench and, of a flexible robot, zeros of the springs,
    (N, size)."""
    covariance: Array
    """Covariance of ``mean``, (N, size, size)."""
    steps: Array
    """Control steps since the start, (N,)."""
    holding: Array
    """Torque per mass that holds the robot at the start, (N, m) [N·m/kg], and that without mass."""
    motor_angle: Array
    """Last motor angles of a flexible robot, (N, m) [rad]; zero for a rigid robot."""
    motor_speed: Array
    """Last motor speeds of a flexible robot, (N, m) [rad/s]; zero for a rigid robot."""
    dynamics: Dynamics
    """Motion with the estimates, at the pose half a control period later."""
