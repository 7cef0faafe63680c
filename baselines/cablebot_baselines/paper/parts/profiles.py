"""Common code of the saturation figures: payload summaries, torque profiles with limits, first saturation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.paper.exact import LargestPayload, Profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Number, Table
from cablebot_gym.evaluation import DLCCResult, Violation
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import Mark, TorqueProfile, TravelledPath, set_title, torque_panels
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.palette import BLUE

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
    """Motor that saturates, counted from 1; None if the limiting violation is not a motor torque."""
    time: float | None
    """Time of the limiting violation [s]; None if it is unknown for zero payload."""
    violation: str
    """Limiting violation as text."""

    @classmethod
    def simulated(cls, result: DLCCResult) -> PayloadSummary:
        """Summary of a simulated evaluation."""
        violation = result.violation
        motor = violation.index if violation is not None and violation.kind == "torque" else None
        return cls(
            payload=result.payload,
            motor=motor,
            time=None if violation is None else violation.time,
            violation=_violation_kind(violation),
        )

    @classmethod
    def computed(cls, largest: LargestPayload) -> PayloadSummary:
        """Summary of exact tracking or of the state space."""
        exists = 0 <= largest.payload < math.inf
        violation = "none" if largest.motor is None else f"motor {largest.motor}"
        # Without a feasible payload the time belongs to a negative payload, not to zero payload.
        payload, time = (largest.payload, largest.time) if exists else (None, None)
        return cls(payload=payload, motor=largest.motor, time=time, violation=violation)

    def numbers(self, interpretation: Interpretation, robot: Robot, prefix: str = "") -> dict[str, Number]:
        """Numbers for results.json."""
        payload = self.payload
        return {
            f"{prefix}payload_kg": payload,
            f"{prefix}counted_kg": None if payload is None else interpretation.counted(robot, payload),
            f"{prefix}total_mass_kg": None if payload is None else robot.mass + payload,
            f"{prefix}motor": self.motor,
            f"{prefix}time_s": self.time,
            f"{prefix}violation": self.violation,
        }

    def sentence(self, robot: Robot) -> str:
        """Sentence for a title."""
        when = "" if self.time is None else f" at t = {self.time:.3f} s"
        if self.payload is None:
            return f"fails unloaded (figure: zero payload): {self.violation}{when}"
        text = f"payload {self.payload:.3f} kg, total mass {robot.mass + self.payload:.3f} kg"
        return f"{text}; limiting violation: {self.violation}{when}"


def payload_table(title: str, rows: Mapping[str, tuple[Robot, PayloadSummary]]) -> Table:
    """Table of the largest payloads of several methods."""
    header = ("method", "added payload [kg]", "total mass [kg]", "limiting violation", "time [s]")
    return Table(
        title=title,
        header=header,
        rows=tuple(
            (method, one.payload, None if one.payload is None else robot.mass + one.payload, one.violation, one.time)
            for method, (robot, one) in rows.items()
        ),
    )


def drawn_run(result: DLCCResult, empty: Rollout) -> Mapping[str, Array]:
    """Arrays of the episode at the largest payload, or of the whole unloaded episode if the robot fails unloaded."""
    return empty.arrays if result.payload is None else result.history


def peaks(result: DLCCResult, empty: Rollout) -> tuple[float, float]:
    """Largest position error over all physics steps [m] and largest rotation error [rad] of :func:`drawn_run`."""
    run = drawn_run(result, empty)
    if result.payload is None:
        position = float(run["tracking_error_peak"].max())
    else:
        position = float((1 - result.margins["position"]) * (result.error_bounds["position"] or 0.0))
    return position, float(run["rotation_error"].max())


def stays_within(result: DLCCResult, empty: Rollout) -> bool:
    """Whether :func:`drawn_run` is complete and within the position error bound."""
    whole = result.payload is not None or empty.verdict.complete
    return whole and peaks(result, empty)[0] <= (result.error_bounds["position"] or 0.0)


def early_end(result: DLCCResult, empty: Rollout) -> list[str]:
    """Title line with the time and the reason of an early end of :func:`drawn_run`; empty without an early end."""
    if result.payload is not None or empty.verdict.complete:
        return []
    return [f"the episode ends at t = {empty.arrays['time'][-1]:.3f} s: {empty.reason}"]


def travelled(run: Mapping[str, Array], *, name: str, color: str = BLUE, style: str = "-") -> TravelledPath:
    """Motion of an episode for the path panels."""
    times, pose = run["action_time"] + run["action_time"][1], run["pose"]
    return TravelledPath(
        times=times,
        pose=pose,
        position_error=run["tracking_error"],
        rotation_error=run["rotation_error"] if pose.shape[1] > 2 else None,
        name=name,
        color=color,
        style=style,
    )


def on_reference(trajectory: Trajectory, *, name: str) -> TravelledPath:
    """Motion without error for exact tracking, without simulation."""
    times = np.linspace(0.0, trajectory.duration, _POINTS)
    none = np.zeros(len(times))
    pose = trajectory(times).position
    rotation = none if pose.shape[1] > 2 else None
    return TravelledPath(times=times, pose=pose, position_error=none, rotation_error=rotation, name=name)


def simulated_profile(robot: Robot, run: Mapping[str, Array]) -> TorqueProfile:
    """Torques of an episode; ``robot`` has the motors of the episode."""
    lower, upper = textbook.torque_limits(robot, run["motor_speeds"])
    middle, half = (upper + lower) / 2, (upper - lower) / 2
    times, action = run["action_time"], run["commanded_action"]
    return TorqueProfile(
        times=times,
        torques=run["torques"],
        lower=lower,
        upper=upper,
        requested=middle + half * action if np.abs(action).max() > 1 else None,
        end=float(times[-1] + times[1]),
    )


def computed_profile(profile: Profile) -> TorqueProfile:
    """Torques without simulation."""
    return TorqueProfile(
        times=profile.times,
        torques=profile.torques,
        lower=profile.lower,
        upper=profile.upper,
        end=round(float(profile.times[-1]), 2),
        name="required torque",
    )


def first_saturation(profile: TorqueProfile, summary: PayloadSummary) -> Mark:
    """Instant to mark in the figure.

    This is the instant of ``summary`` if the figure shows its payload. Otherwise it is the first instant with |a| ≥ 1
    at zero payload, or the instant of the largest |a|.
    """
    action = _action(profile)
    if summary.payload is not None and summary.motor is not None and summary.time is not None:
        # The acceleration of the circle has two values at half time; use the value with the larger |a|.
        near = np.flatnonzero(np.abs(profile.times - summary.time) <= np.abs(profile.times - summary.time).min() + 1e-6)
        position = int(near[np.argmax(action[near, summary.motor - 1])]), summary.motor - 1
    elif action.max() >= 1:
        step = int(np.argmax(action.max(axis=1) >= 1))
        position = step, int(np.argmax(action[step]))
    else:
        tightest = np.unravel_index(np.argmax(action), action.shape)
        position = int(tightest[0]), int(tightest[1])
    reached = action[position] >= _SATURATED
    note = "first saturation" if reached else f"{1 - action[position]:.1%} margin"
    name = "first saturation" if reached else "largest |a|"
    return Mark(step=position[0], motor=position[1], name=name, note=note)


def draw_panels(figure: FigureBase, profile: TorqueProfile, mark: Mark) -> None:
    """Draws the torque panels with fewer instants; keeps the marked instant and its neighbours."""
    count = len(profile.times)
    thinned, around = np.arange(0, count, math.ceil(count / _POINTS)), mark.step + np.arange(-2, 3)
    kept = np.unique(np.concatenate([thinned, [count - 1], np.clip(around, 0, count - 1)]))
    thinner = dataclasses.replace(
        profile,
        times=profile.times[kept],
        torques=profile.torques[kept],
        lower=profile.lower[kept],
        upper=profile.upper[kept],
        requested=None if profile.requested is None else profile.requested[kept],
    )
    torque_panels(figure, thinner, dataclasses.replace(mark, step=int(np.searchsorted(kept, mark.step))))


def add_title(figure: FigureBase, interpretation: Interpretation, *lines: str) -> None:
    """Adds a title, with the interpretation if it differs from the default."""
    text = interpretation.text()
    set_title(figure, *lines, *([] if text == "default" else [f"interpretation: {text}"]))


def _action(profile: TorqueProfile) -> Array:
    """|a|, shape (K, m)."""
    torques = profile.torques if profile.requested is None else profile.requested
    action: Array = np.abs(2 * torques - profile.upper - profile.lower) / (profile.upper - profile.lower)
    return action


def violation_text(violation: Violation | None) -> str:
    """Limiting violation and its time, rounded to milliseconds."""
    return _violation_kind(violation) + (
        "" if violation is None or violation.time is None else f" at {violation.time:.3f} s"
    )


def _violation_kind(violation: Violation | None) -> str:
    if violation is None:
        return "none"
    where = {"torque": f"motor {violation.index}", "slack": f"cable {violation.index} slack"}
    return where.get(violation.kind, violation.reason or violation.kind)
