"""What an observer knows of the robots that it meets, and its state between two control steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.filtering import Dynamics
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import Measurement
from cablebot_gym.robots import Robot


class Columns:
    """Columns of the state of N episodes. What is not estimated has an empty slice.

    Args:
        robot: expected robot, with joint springs in place of elastic cables.
        expectation: expected errors. Those that are not expected have no columns.
        measurement: the sensors.
    """

    def __init__(self, robot: Robot, expectation: Expectation, measurement: Measurement) -> None:
        n = robot.coordinates
        m = robot.cables
        has_soft_springs = robot.flexible and expectation.stiffness_spread > 0
        winches = measurement.winches
        self.total = 0
        self.pose = self._next(n)
        """Pose X."""
        self.velocity = self._next(n)
        """Velocity Ẋ."""
        self.mass = self._next(1).start
        """Mass of platform and payload [kg]."""
        self.strength = self._next(m)
        """Strength of each motor as a fraction of the expected one."""
        self.delay = self._next(1).start
        """Time between the request of an action and its torque [s]."""
        self.wrench = self._next(n)
        """Wrench on the platform [N, N·m]."""
        self.zero = self._next(m * (robot.flexible or winches))
        """Zero errors of the motor angles [rad]."""
        self.compliance = self._next(m * (winches and has_soft_springs))
        """Relative errors of the compliances of the springs."""
        self.anchor = self._next(robot.base.size * (winches and expectation.anchor_spread > 0))
        """Errors of the base anchors against those of the platform [m], cable by cable."""
        self.cell = self._next(m * measurement.tensions)
        """Biases of the load cells [N]."""
        self.orientation = self._next(3 * measurement.imu)
        """Biases of the orientation [rad]."""

    def _next(self, size: int) -> slice:
        start = self.total
        self.total += size
        return slice(start, self.total)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotEstimate:
    """What the observer knows of N robots."""

    mass: Array
    """Mass of platform and payload, (N,) [kg]."""
    strength: Array
    """Strength of each motor as a fraction of the expected one, (N, m)."""
    delay: Array
    """Time between the request of an action and its torque, (N,) [s]."""
    wrench: Array
    """Wrench on the platform, (N, n) [N, N·m]."""

    def of(self, rows: Any) -> RobotEstimate:
        """The estimates of some of the robots: indices, marks or a slice."""
        return RobotEstimate(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverState:
    """State of the filter for N episodes."""

    mean: Array
    """Mean of the :class:`Columns`, (N, size)."""
    covariance: Array
    """Covariance of ``mean``, (N, size, size)."""
    steps: Array
    """Control steps since the start, (N,)."""
    holding: Array
    """Torque per mass that holds the robot at the start, (N, m) [N·m/kg], and that without mass."""
    motor_angle: Array
    """Last motor angles, (N, m) [rad]; zero if they are not measured."""
    motor_speed: Array
    """Last motor speeds, (N, m) [rad/s]; zero if they are not measured."""
    tensions: Array
    """Predicted tensions in the last control period where cells measure them, (N, m) [N]; else
    zero."""
    dynamics: Dynamics
    """Motion with the estimates, at the pose half a control period later."""
