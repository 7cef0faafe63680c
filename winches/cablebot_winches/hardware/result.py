"""What a drive gives back, and its log."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cablebot_gym.kinematics import Array
from cablebot_gym.utils.files import atomic_write
from cablebot_winches.hardware.limits import Stop


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveResult:
    """A drive over a motion, or until it stopped."""

    robot: str
    """Name of the robot."""
    policy: str
    """Name of the policy."""
    motion: str
    """Name of the motion."""
    armed: bool
    """Whether torques were commanded."""
    periods: int
    """Number of control periods."""
    stop: Stop | None
    """Why the drive stopped early; None if the motion is complete."""
    tracking_error: float
    """Largest distance of the position from the reference, by forward kinematics [m]."""
    torque_fraction: float
    """Largest torque as a fraction of what the motor has at its speed."""
    lost: tuple[int, ...]
    """Number of lost replies of each winch. An angle is extrapolated then."""
    late: int
    """Number of control periods that ended too late."""
    computing_time: float
    """Longest time from the last reply to the commands of a control period [s]."""
    log: Mapping[str, Array]
    """Columns of the log by name, each (periods,): those that ``cablebot identify`` reads.
    Readings are NaN where a reply is lost, and torques where none is commanded."""

    def save(self, path: str | Path) -> None:
        """Writes the log as a CSV file. Empty cells stand for NaN."""
        atomic_write(path, self._write)

    def _write(self, path: Path) -> None:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(self.log)
            for row in zip(*(values.tolist() for values in self.log.values()), strict=True):
                writer.writerow("" if value != value else value for value in row)
