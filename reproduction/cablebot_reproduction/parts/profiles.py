"""Common code of the saturation figures: payload summaries, torque profiles with limits, first
saturation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.evaluation import DLCCResult, Violation
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import Mark, TorqueProfile, TravelledPath, torque_panels
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.palette import BLUE
from cablebot_reproduction.exact import LargestPayload, Profile
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.part import Number, Table

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase

_SATURATED = 0.999
"""Smallest |a| of a saturated motor. Payloads are accurate to 1 g and torques to a few 1e-4."""

_POINTS = 250
"""Number of instants in a figure, limited to keep the SVG small."""


@dataclass(frozen=True, kw_only=True)
class PayloadSummary:
    """A largest payload, simulated or computed, and its limiting violation."""

    payload: float | None
    """Mass added to the platform [kg]; None if the robot fails unloaded or no limit exists."""
    motor: int | None
    """Motor that saturates, counted from 1; None if the limiting violation is not a motor
    torque."""
    time: float | None
    """Time of the limiting violation [s]; None if it is unknown for zero payload."""
    violation: str
    """Limiting violation as text."""

    @classmethod
    def simulated(cls, result: DLCCResult) -> PayloadSummary:
        """Summary of a simulated evaluation."""
        violation = result.violation
        time = None
        if violation is not None:
            time = violation.time
        return cls(
            payload=result.payload,
            motor=saturated_motor(result),
            time=time,
            violation=_violation_kind(violation),
        )

    @classmethod
    def computed(cls, largest: LargestPayload) -> PayloadSummary:
        """Summary of exact tracking or of the state space."""
        violation = "none"
        if largest.motor is not None:
            violation = f"motor {largest.motor}"
        if not 0 <= largest.payload < math.inf:
            # The time belongs to a negative payload, not to zero payload.
            return cls(payload=None, motor=largest.motor, time=None, violation=violation)
        return cls(
            payload=largest.payload, motor=largest.motor, time=largest.time, violation=violation
        )

    def total_mass(self, robot: Robot) -> float | None:
        """Mass of platform and payload [kg]."""
        if self.payload is None:
            return None
        return robot.mass + self.payload

    def numbers(
        self, interpretation: Interpretation, robot: Robot, prefix: str = ""
    ) -> dict[str, Number]:
        """Numbers for results.json."""
        counted = None
        if self.payload is not None:
            counted = interpretation.counted(robot, self.payload)
        return {
            f"{prefix}payload_kg": self.payload,
            f"{prefix}counted_kg": counted,
            f"{prefix}total_mass_kg": self.total_mass(robot),
            f"{prefix}motor": self.motor,
            f"{prefix}time_s": self.time,
            f"{prefix}violation": self.violation,
        }

    def sentence(self, robot: Robot) -> str:
        """Sentence for a title."""
        violation = self.violation
        if self.time is not None:
            violation = f"{violation} at t = {self.time:.3f} s"
        if self.payload is None:
            return f"fails unloaded (figure: zero payload): {violation}"
        text = f"payload {self.payload:.3f} kg, total mass {robot.mass + self.payload:.3f} kg"
        return f"{text}; limiting violation: {violation}"


def payload_table(title: str, rows: Mapping[str, tuple[Robot, PayloadSummary]]) -> Table:
    """Table of the largest payloads of several methods."""
    header = ("method", "added payload [kg]", "total mass [kg]", "limiting violation", "time [s]")
    cells = []
    for method, (robot, summary) in rows.items():
        cells.append(
            (method, summary.payload, summary.total_mass(robot), summary.violation, summary.time)
        )
    return Table(title=title, header=header, rows=tuple(cells))


@dataclass(frozen=True, kw_only=True)
class Shown:
    """The drawn episode: at the largest payload, or the whole unloaded one if the robot fails
    unloaded."""

    result: DLCCResult
    """The evaluation."""
    empty: Rollout
    """The unloaded episode."""

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Arrays of the episode."""
        if self.result.payload is None:
            return self.empty.arrays
        return self.result.rollout.arrays

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest position error over all physics steps [m] and largest rotation error [rad]."""
        position = float(self.arrays["tracking_error_peak"].max())
        if self.result.payload is not None:
            position = float((1 - self.result.details.margins["position"]) * self._bound)
        return position, float(self.arrays["rotation_error"].max())

    @property
    def _bound(self) -> float:
        return self.result.details.error_bounds["position"] or 0.0

    @property
    def end_reason(self) -> list[str]:
        """Title line with the time and the reason of an early end; empty without an early end."""
        if self.result.payload is not None or not self.empty.reason:
            return []
        return [f"the episode ends at t = {self.arrays['time'][-1]:.3f} s: {self.empty.reason}"]

    @property
    def within(self) -> bool:
        """Whether the episode is complete and within the position error bound."""
        position, _ = self.peaks
        return not self.end_reason and position <= self._bound


NO_PATH: dict[str, Number] = {
    "peak_error_mm": None,
    "bound_mm": 1e3 * ErrorBounds().position,
    "within": None,
}
"""Numbers of a path without closed loop."""


def path_numbers(shown: Shown) -> dict[str, Number]:
    """Numbers of the path of a closed loop."""
    position, _ = shown.peaks
    return {
        "payload_kg": shown.result.payload,
        "peak_error_mm": 1e3 * position,
        "bound_mm": NO_PATH["bound_mm"],
        "within": shown.within,
    }


def travelled(run: Mapping[str, Array], *, name: str, color: str = BLUE) -> TravelledPath:
    """Motion of an episode for the path panels."""
    return TravelledPath(
        times=run["action_time"] + run["action_time"][1],
        pose=run["pose"],
        position_error=run["tracking_error"],
        rotation_error=_rotation(run["pose"], run["rotation_error"]),
        name=name,
        color=color,
    )


def on_reference(trajectory: Trajectory, *, name: str) -> TravelledPath:
    """Motion without error for exact tracking, without simulation."""
    times = np.linspace(0.0, trajectory.duration, _POINTS)
    pose = trajectory(times).position
    zero = np.zeros(len(times))
    return TravelledPath(
        times=times, pose=pose, position_error=zero, rotation_error=_rotation(pose, zero), name=name
    )


def _rotation(pose: Array, error: Array) -> Array | None:
    """The rotation error; None for a robot without rotation."""
    if pose.shape[1] <= 2:
        return None
    return error


def simulated_profile(robot: Robot, run: Mapping[str, Array]) -> TorqueProfile:
    """Torques of an episode; ``robot`` has the motors of the episode."""
    lower, upper = textbook.torque_limits(robot, run["motor_speeds"])
    times, action = run["action_time"], run["commanded_action"]
    requested = None
    if np.abs(action).max() > 1:
        requested = (upper + lower) / 2 + (upper - lower) / 2 * action
    end = float(times[-1] + times[1])
    return TorqueProfile(
        times=times, torques=run["torques"], lower=lower, upper=upper, requested=requested, end=end
    )


def computed_profile(profile: Profile) -> TorqueProfile:
    """Torques without simulation."""
    return TorqueProfile(
        **vars(profile), end=round(float(profile.times[-1]), 2), name="required torque"
    )


def first_saturation(profile: TorqueProfile, summary: PayloadSummary) -> Mark:
    """Instant to mark in the figure.

    This is the instant of ``summary`` if the figure shows its payload. Otherwise it is the first
    instant with |a| ≥ 1 at zero payload, or the instant of the largest |a|.
    """
    torques = profile.torques
    if profile.requested is not None:
        torques = profile.requested
    action = np.abs(2 * torques - profile.upper - profile.lower) / (profile.upper - profile.lower)
    if summary.payload is not None and summary.motor is not None and summary.time is not None:
        # The acceleration of the circle has two values at half time; use the value with the larger
        # |a|.
        distance = np.abs(profile.times - summary.time)
        motor = summary.motor - 1
        near = np.flatnonzero(distance <= distance.min() + 1e-6)
        step = int(near[np.argmax(action[near, motor])])
    else:
        step = int(np.argmax(np.minimum(action.max(axis=1), 1.0)))
        motor = int(np.argmax(action[step]))
    if action[step, motor] >= _SATURATED:
        return Mark(step=step, motor=motor, name="first saturation", note="first saturation")
    margin = f"{1 - action[step, motor]:.1%} margin"
    return Mark(step=step, motor=motor, name="largest |a|", note=margin)


def draw_panels(figure: FigureBase, profile: TorqueProfile, mark: Mark) -> None:
    """Draws the torque panels with fewer instants; keeps the marked instant and its neighbours."""
    end = len(profile.times) - 1
    thinned = np.arange(0, end + 1, math.ceil(len(profile.times) / _POINTS))
    around_mark = np.clip(mark.step + np.arange(-2, 3), 0, end)
    drawn = np.unique(np.concatenate([thinned, [end], around_mark]))
    profile = replace(
        profile,
        times=profile.times[drawn],
        torques=profile.torques[drawn],
        lower=profile.lower[drawn],
        upper=profile.upper[drawn],
        requested=None if profile.requested is None else profile.requested[drawn],
    )
    torque_panels(figure, profile, replace(mark, step=int(np.searchsorted(drawn, mark.step))))


def saturated_motor(result: DLCCResult) -> int | None:
    """Motor whose torque limits the payload, counted from 1."""
    violation = result.violation
    if violation is None or violation.kind != "torque":
        return None
    return violation.index


def violation_text(violation: Violation | None) -> str:
    """Limiting violation and its time, rounded to milliseconds."""
    text = _violation_kind(violation)
    if violation is None or violation.time is None:
        return text
    return f"{text} at {violation.time:.3f} s"


def _violation_kind(violation: Violation | None) -> str:
    if violation is None:
        return "none"
    if violation.kind == "torque":
        return f"motor {violation.index}"
    if violation.kind == "slack":
        return f"cable {violation.index} slack"
    return violation.reason or violation.kind
