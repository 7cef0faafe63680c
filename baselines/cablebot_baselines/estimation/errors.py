"""Errors that the extended Kalman filter expects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import (
    ExternalWrench,
    ParameterDistribution,
    SensorNoise,
    Uncertainty,
)

DATA_SHEET = SensorNoise(
    motor_angle=1e-4, motor_speed=1e-2, tension=0.4, angular_rate=4e-3, specific_force=2e-2
)
"""White noise of a servo drive, a load cell and the IMU MTi-300. The resolution of the encoders is
added."""

ZERO_ERROR = 0.3e-3
"""Zero error of a calibrated cable length [m]."""

CELL_BIAS = 0.01
"""Bias of a load cell as a fraction of the tension at the stall torque."""

START_ERROR = (1.5e-4, 3.5e-4)
"""Error of a start pose that motion capture finds [m, rad], as in the uncertainty ``hardware``."""

NO_WRENCH = ExternalWrench()
"""No external wrench."""

_QUANTILES = (np.arange(1000) + 0.5) / 1000


@dataclass(frozen=True, kw_only=True)
class FilterErrors:
    """Standard deviations of the errors of sensors, start pose, robot and forces."""

    noise: SensorNoise = DATA_SHEET
    """White noise of the readings."""
    bias: SensorNoise
    """Constant errors of the readings."""
    start: tuple[float, float] | None = None
    """Error of the start pose [m, rad], at which the robot rests; None if the pose is unknown."""
    disturbance: float = 3.0
    """Growth of the disturbance d in one second [m/s²]; of angles, divided by the platform's
    size."""
    initial_disturbance: float = 0.3
    """Disturbance d at the start [m/s²]; of angles, divided by the platform's size."""
    wrench: ExternalWrench = NO_WRENCH
    """External wrench. Its mean is known."""
    torque: float = 0.01
    """Error of the torque on the pulleys, as a fraction of the stall torque."""
    strength: float = 0.0
    """Error of the torque of a motor, as a fraction of this torque."""
    rotor: float = 0.0
    """Error of the motor inertia of a flexible robot, as a fraction."""
    lag: float = 0.0
    """Lag of the motor torque [s]."""
    mass: float = 0.0
    """Error of the platform's mass, as a fraction."""
    payload: float = 0.0
    """Error of the model payload, as a fraction."""
    compliance: ParameterDistribution | None = None
    """Error of the stiffness of the joints; None if it is exact."""
    anchors: tuple[float, float] = (0.0, 0.0)
    """Error of each coordinate of base and platform anchors [m]."""

    @classmethod
    def usual(cls, robot: Robot, *, homing: bool = False) -> FilterErrors:
        """Errors of data sheets for a robot whose other errors are unknown.

        With homing the start pose is found by motion capture, and the zeros of motor angles and load
        cells are unknown.
        """
        disturbance = usual_disturbance(robot)
        if homing:
            bias = SensorNoise(motor_angle=1.0, tension=full_scale(robot), tilt=3.5e-3, yaw=17.5e-3)
            return cls(bias=bias, start=START_ERROR, disturbance=disturbance)
        bias = SensorNoise(
            motor_angle=ZERO_ERROR / float(robot.pulley_radius.min()),
            tension=CELL_BIAS * full_scale(robot),
            tilt=3.5e-3,
            yaw=17.5e-3,
        )
        return cls(bias=bias, disturbance=disturbance)

    @classmethod
    def of(
        cls, uncertainty: Uncertainty, robot: Robot, *, start: tuple[float, float] | None = None
    ) -> FilterErrors:
        """The standard deviations of an uncertainty, whose draws the filter does not know.

        Args:
            uncertainty: uncertainty of the episodes. The disturbance takes up what is left out:
                errors of the inertias, and a model that is only nearly exact.
            robot: nominal robot.
            start: standard deviation of the start pose [m, rad]; None if the pose is unknown.
        """
        parameters = uncertainty.parameters

        def size(name: str) -> float:
            """Root mean square of the deviation."""
            if name not in parameters:
                return 0.0
            deviations = parameters[name].deviation(_QUANTILES)
            return float(np.sqrt(np.mean(deviations**2)))

        stall = float(robot.stall_torque.min())
        # friction of dampers at half of the free speed
        speed = 0.5 * float(np.min(robot.stall_torque / robot.speed_slope))
        viscous = speed * np.hypot(size("damping"), size("motor_damping"))
        friction = np.hypot(size("coulomb_friction"), viscous)
        return cls(
            noise=uncertainty.sensors or SensorNoise(),
            bias=uncertainty.sensor_bias or SensorNoise(),
            start=start,
            disturbance=usual_disturbance(robot),
            wrench=uncertainty.wrench or NO_WRENCH,
            torque=float(friction) / stall,
            strength=size("motor_strength"),
            rotor=size("motor_inertia"),
            lag=size("motor_lag"),
            mass=size("platform_mass"),
            payload=size("payload"),
            compliance=parameters.get("stiffness"),
            anchors=(size("base_anchors"), size("platform_anchors")),
        )

    def compliance_covariance(self, count: int) -> Any:
        """Covariance of the relative errors of ``count`` compliances."""
        if self.compliance is None:
            return np.zeros((count, count))
        variance = np.mean(self.compliance.deviation(_QUANTILES) ** 2)
        if self.compliance.each:
            return variance * np.eye(count)
        return np.full((count, count), variance)


def usual_disturbance(robot: Robot) -> float:
    """Growth of the disturbance that every model of a robot leaves [m/s²].

    That of a flexible robot grows slowly: its pose follows from the small difference of two angles,
    and a law that damps the springs amplifies the noise of a faster filter.
    """
    if robot.flexible:
        return 0.3
    return 3.0


def full_scale(robot: Robot) -> float:
    """Tension at the stall torque [N]."""
    return float(robot.stall_torque.min() / robot.pulley_radius.max())
