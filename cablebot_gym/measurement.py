"""What a controller measures: pose and velocity of the platform, or the sensors of winches and
platform."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import choice, number, record
from cablebot_gym.utils.files import JSON_FORM, check_not_a_file

KINDS = ("pose", "winches")
"""Kinds of measurement."""


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Sensors whose readings are in the observation. Their errors are part of the uncertainty.

    Raises:
        ValueError: if a value is invalid, or if sensors of ``winches`` are combined with another
            kind.
    """

    kind: str = "pose"
    """``pose``: pose and velocity of the platform. ``winches``: angles and speeds of the motors in
    their place."""
    encoder_resolution: float = 0.0
    """Smallest step of a measured motor angle [rad]; 0 for exact angles."""
    tensions: bool = False
    """Whether a load cell measures the tension of each cable."""
    imu: bool = False
    """Whether an inertial unit measures orientation, angular rate and specific force of the
    platform."""

    def __post_init__(self) -> None:
        choice("measurement", self.kind, KINDS)
        resolution = number(
            "measurement.encoder_resolution", self.encoder_resolution, least=0, unit="rad"
        )
        object.__setattr__(self, "encoder_resolution", resolution)
        for name in SENSORS:
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise ValueError(
                    f"measurement.{name} must be True or False, not {getattr(self, name)!r}"
                )
            object.__setattr__(self, name, bool(getattr(self, name)))
        if not self.winches and (resolution or self.tensions or self.imu):
            raise ValueError(
                "measurement: encoders, load cells and an IMU belong to the kind 'winches'"
            )

    @property
    def winches(self) -> bool:
        """Whether the motor angles and speeds are measured in place of pose and velocity."""
        return self.kind == "winches"

    @property
    def name(self) -> str:
        """Kind and sensors, such as ``winches+tensions``."""
        return "+".join([self.kind, *(name for name in SENSORS if getattr(self, name))])

    def sizes(self, robot: Robot) -> dict[str, int]:
        """Number of components of each measured block, in the order of the observation."""
        n = robot.coordinates
        m = robot.cables
        axes = robot.dimensions
        motors = {"motor_angle": m, "motor_speed": m}
        if not self.winches:
            return {"pose": n, "velocity": n} | (motors if robot.flexible else {})
        imu = {"orientation": n - axes, "angular_rate": n - axes, "specific_force": axes}
        return motors | ({"tensions": m} if self.tensions else {}) | (imu if self.imu else {})

    def check(self, robot: Robot) -> None:
        """Checks that a robot can have the sensors.

        Raises:
            ValueError: if there is an IMU, and the robot has no platform with three angles.
        """
        if self.imu and robot.kind != "spatial":
            raise ValueError(
                f"robot {robot.name!r} has no platform with three angles for an IMU: remove 'imu'"
            )


SENSORS = ("tensions", "imu")
"""Sensors that winches may have in addition to encoders."""

POSE = Measurement()
"""Pose and velocity, the default."""


def find_measurement(
    measurement: str | Mapping[str, Any] | Measurement | None, robot: Robot
) -> Measurement:
    """A measurement for a robot from a name, JSON-able data or a :class:`Measurement`.

    Args:
        measurement: such as ``"winches"``, ``"winches+tensions+imu"`` or ``{"kind": "winches",
            "encoder_resolution": 1e-3, "tensions": True}``. None for pose and velocity.
        robot: nominal robot.

    Raises:
        ValueError: if a name or a field is unknown, or the robot cannot have a sensor.
    """
    if isinstance(measurement, str):
        kind, *sensors = measurement.split("+")
        if kind not in KINDS:
            check_not_a_file("measurement", measurement, JSON_FORM)
        otherwise = f", and join it with {' or '.join(SENSORS)} by '+'"
        chosen = choice("measurement", kind, KINDS, otherwise)
        measurement = {"kind": chosen} | {choice("sensor", name, SENSORS): True for name in sensors}
    found = POSE if measurement is None else record("measurement", Measurement, measurement)
    found.check(robot)
    return found
