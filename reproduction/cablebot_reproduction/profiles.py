"""Largest payloads as numbers and rows of a table, and the figures of torques and paths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cablebot_gym.evaluation import DLCCResult, Violation
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import Mark, TorqueProfile, TravelledPath, torque_panels
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import BLUE
from cablebot_reproduction.exact import LargestPayload
from cablebot_reproduction.outcome import Numbers, PaperTable

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase

_POINTS = 250
"""Number of instants in a figure, limited to keep the SVG small."""


class PayloadSummary(NamedTuple):
    """A largest payload, simulated or computed, and its limiting violation."""

    payload_kg: float | None
    """Mass added to the platform; None if the robot fails unloaded."""
    total_mass_kg: float | None
    """Mass of platform and payload."""
    violation: str
    """Limiting violation as text."""
    time_s: float | None
    """Time of the limiting violation."""
    motor: int | None
    """Motor that saturates, counted from 1; None if the limiting violation is not a motor
    torque."""

    @classmethod
    def simulated(cls, result: DLCCResult) -> PayloadSummary:
        """Summary of an evaluation."""
        violation = limiting_violation(result)
        text = violation_kind(violation)
        motor = saturated_motor(violation)
        return cls(result.payload, result.total_mass, text, violation.time, motor)

    @classmethod
    def computed(cls, robot: Robot, largest: LargestPayload) -> PayloadSummary:
        """Summary of exact tracking or of the state space."""
        total_mass = robot.mass + largest.payload
        text = f"motor {largest.motor}"
        return cls(largest.payload, total_mass, text, largest.time, largest.motor)

    def numbers(self, prefix: str = "") -> Numbers:
        """Numbers for results.json."""
        return {f"{prefix}{name}": value for name, value in self._asdict().items()}

    def sentence(self) -> str:
        """Sentence for a title."""
        return (
            f"payload {self.payload_kg:.3f} kg, total mass {self.total_mass_kg:.3f} kg; "
            f"limiting violation: {self.violation} at t = {self.time_s:.3f} s"
        )


def payload_table(title: str, rows: Mapping[str, PayloadSummary]) -> PaperTable:
    """Table of the largest payloads of several methods."""
    header = ("method", "added payload [kg]", "total mass [kg]", "limiting violation", "time [s]")
    cells = [(method, *found[:4]) for method, found in rows.items()]
    return PaperTable(title=title, header=header, rows=cells)


def limiting_violation(result: DLCCResult) -> Violation:
    """The limiting violation of an evaluation; every payload of the page has one."""
    assert result.violation is not None
    return result.violation


def saturated_motor(violation: Violation) -> int | None:
    """Motor whose torque limits the payload, counted from 1."""
    if violation.kind == "torque":
        return violation.index
    return None


def violation_kind(violation: Violation) -> str:
    """Text of a limiting violation without its time."""
    texts = {"torque": f"motor {violation.index}", "slack": f"cable {violation.index} slack"}
    return texts.get(violation.kind, violation.kind)


def violation_text(violation: Violation) -> str:
    """Limiting violation and its time, rounded to milliseconds."""
    return f"{violation_kind(violation)} at {violation.time:.3f} s"


def path_numbers(result: DLCCResult) -> Numbers:
    """Numbers of the path at the largest payload."""
    bound = ErrorBounds().position
    error = (1 - result.details.margins["position"]) * bound
    numbers: Numbers = {
        "payload_kg": result.payload,
        "peak_error_mm": 1e3 * error,
        "bound_mm": 1e3 * bound,
        "within": error <= bound,
    }
    if not result.conditions.nominal_robot.planar:
        numbers["peak_rotation_mrad"] = 1e3 * result.rollout.arrays["rotation_error_peak"].max()
    return numbers


def travelled(run: Mapping[str, Array], *, name: str, color: str = BLUE) -> TravelledPath:
    """Motion of an episode for the path panels."""
    rotation_error = None
    if run["pose"].shape[1] > 2:
        rotation_error = run["rotation_error"]
    return TravelledPath(
        times=run["action_time"] + run["action_time"][1],
        pose=run["pose"],
        position_error=run["tracking_error"],
        rotation_error=rotation_error,
        name=name,
        color=color,
    )


def simulated_profile(robot: Robot, run: Mapping[str, Array]) -> TorqueProfile:
    """Torques of an episode; ``robot`` has the motors of the episode."""
    lower, upper = textbook.torque_limits(robot, run["motor_speeds"])
    return TorqueProfile(
        times=run["action_time"],
        torques=run["torques"],
        lower=lower,
        upper=upper,
        end=float(run["time"][-1]),
    )


def first_saturation(profile: TorqueProfile, found: PayloadSummary) -> Mark:
    """The instant of the limiting violation in a figure that shows the largest payload."""
    assert found.motor is not None
    motor = found.motor - 1
    centre = (profile.upper + profile.lower) / 2
    action = np.abs(profile.torques - centre) / (profile.upper - centre)
    # The acceleration of the circle has two values at half time; use the value with the larger |a|.
    distance = np.abs(profile.times - found.time_s)
    near = np.flatnonzero(distance <= distance.min() + 1e-6)
    step = int(near[np.argmax(action[near, motor])])
    return Mark(step=step, motor=motor, name="first saturation", note="first saturation")


def draw_torques(figure: FigureBase, profile: TorqueProfile, mark: Mark | None = None) -> None:
    """Draws the torque panels with fewer instants; keeps the marked instant and its neighbours."""
    end = len(profile.times) - 1
    drawn = np.arange(0, end + 1, math.ceil(len(profile.times) / _POINTS))
    drawn = np.union1d(drawn, end)
    if mark is not None:
        around = np.clip(mark.step + np.arange(-2, 3), 0, end)
        drawn = np.union1d(drawn, around)
        mark = replace(mark, step=int(np.searchsorted(drawn, mark.step)))
    profile = replace(
        profile,
        times=profile.times[drawn],
        torques=profile.torques[drawn],
        lower=profile.lower[drawn],
        upper=profile.upper[drawn],
    )
    torque_panels(figure, profile, mark)
