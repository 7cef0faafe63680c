"""What the figures of saturation share: what is carried, torques against limits, the instant of first saturation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cablebot_baselines.paper.exact import Heaviest, Profile
from cablebot_baselines.paper.part import Number, Table
from cablebot_baselines.paper.readings import Readings
from cablebot_gym.evaluation import DLCCResult, Limit
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import Mark, TorqueProfile, Travelled, entitle, torque_panels
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.palette import BLUE

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase

_SATURATED = 0.999
"""|a| from which a motor is called saturated: payloads are found to a gram, torques to some tenths of a thousandth."""

_POINTS = 250
"""Instants that a figure draws, not to fill its SVG."""


@dataclass(frozen=True, kw_only=True)
class Carried:
    """A largest payload, simulated or not, and what ends it."""

    payload: float | None
    """Added to the platform [kg]; None if not even zero is carried, or nothing ends it."""
    motor: int | None
    """The motor that saturates, counted from 1; None if something else gives way."""
    time: float | None
    """When it does [s]; None if that is not known of zero payload."""
    gives_way: str
    """What does."""

    @classmethod
    def simulated(cls, result: DLCCResult) -> Carried:
        """From an evaluation."""
        limit = result.limit
        motor = limit.index if limit.kind == "torque" else None
        return cls(payload=result.payload, motor=motor, time=limit.time, gives_way=_gives_way(limit))

    @classmethod
    def computed(cls, heaviest: Heaviest) -> Carried:
        """From exact tracking or the state space."""
        some = 0 <= heaviest.payload < math.inf
        gives_way = "nothing" if heaviest.motor is None else f"motor {heaviest.motor}"
        # Without a payload the time is that of a negative one, and not the first at zero.
        payload, time = (heaviest.payload, heaviest.time) if some else (None, None)
        return cls(payload=payload, motor=heaviest.motor, time=time, gives_way=gives_way)

    def numbers(self, readings: Readings, robot: Robot, prefix: str = "") -> dict[str, Number]:
        """For results.json."""
        payload = self.payload
        return {
            f"{prefix}payload_kg": payload,
            f"{prefix}counted_kg": None if payload is None else readings.counted(robot, payload),
            f"{prefix}total_mass_kg": None if payload is None else robot.mass + payload,
            f"{prefix}motor": self.motor,
            f"{prefix}time_s": self.time,
            f"{prefix}gives_way": self.gives_way,
        }

    def sentence(self, robot: Robot) -> str:
        """For a title."""
        when = "" if self.time is None else f" at t = {self.time:.3f} s"
        if self.payload is None:
            return f"not even zero payload is carried (drawn: zero payload): {self.gives_way}{when}"
        found = f"payload {self.payload:.3f} kg, total mass {robot.mass + self.payload:.3f} kg"
        return f"{found}; first limit above it: {self.gives_way}{when}"


def payload_table(title: str, rows: Mapping[str, tuple[Robot, Carried]]) -> Table:
    """A table of what is carried in several ways."""
    header = ("how", "payload added [kg]", "total mass [kg]", "gives way first", "at [s]")
    return Table(
        title=title,
        header=header,
        rows=tuple(
            (how, one.payload, None if one.payload is None else robot.mass + one.payload, one.gives_way, one.time)
            for how, (robot, one) in rows.items()
        ),
    )


def run_of(result: DLCCResult, empty: Rollout) -> Mapping[str, Array]:
    """The episode to draw, by name: at the payload, or at zero, and then the whole of it, if none is carried."""
    return empty.arrays if result.payload is None else result.history


def peaks(result: DLCCResult, empty: Rollout) -> tuple[float, float]:
    """Largest position [m] and rotation error [rad] of :func:`run_of`; that of position at any physics step."""
    run = run_of(result, empty)
    if result.payload is None:
        position = float(run["tracking_error_peak"].max())
    else:
        position = float((1 - result.margins["position"]) * (result.limits["position"] or 0.0))
    return position, float(run["rotation_error"].max())


def stays_within(result: DLCCResult, empty: Rollout) -> bool:
    """Whether the whole of :func:`run_of` is within the bound of position; what ended early is not."""
    whole = result.payload is not None or empty.verdict.complete
    return whole and peaks(result, empty)[0] <= (result.limits["position"] or 0.0)


def early_end(result: DLCCResult, empty: Rollout) -> list[str]:
    """For a title: when and why :func:`run_of` ended before the motion did."""
    if result.payload is not None or empty.verdict.complete:
        return []
    return [f"the episode ends at t = {empty.arrays['time'][-1]:.3f} s: {empty.reason}"]


def travelled(run: Mapping[str, Array], *, name: str, color: str = BLUE, style: str = "-") -> Travelled:
    """An episode's motion, for the panels of its path."""
    times, pose = run["command_time"] + run["command_time"][1], run["pose"]
    return Travelled(
        times=times,
        pose=pose,
        position_error=run["tracking_error"],
        rotation_error=run["rotation_error"] if pose.shape[1] > 2 else None,
        name=name,
        color=color,
        style=style,
    )


def on_reference(trajectory: Trajectory, *, name: str) -> Travelled:
    """A motion without error, where it is an assumption and nothing was simulated."""
    times = np.linspace(0.0, trajectory.duration, _POINTS)
    none = np.zeros(len(times))
    pose = trajectory(times).position
    rotation = none if pose.shape[1] > 2 else None
    return Travelled(times=times, pose=pose, position_error=none, rotation_error=rotation, name=name)


def simulated_profile(robot: Robot, run: Mapping[str, Array]) -> TorqueProfile:
    """An episode's torques; ``robot`` with the motors that it had."""
    lower, upper = textbook.torque_limits(robot, run["motor_speeds"])
    middle, half = (upper + lower) / 2, (upper - lower) / 2
    times, demand = run["command_time"], run["drive_demand"]
    return TorqueProfile(
        times=times,
        torques=run["torques"],
        lower=lower,
        upper=upper,
        demanded=middle + half * demand if np.abs(demand).max() > 1 else None,
        end=float(times[-1] + times[1]),
    )


def computed_profile(profile: Profile) -> TorqueProfile:
    """Torques that were not simulated."""
    return TorqueProfile(
        times=profile.times,
        torques=profile.torques,
        lower=profile.lower,
        upper=profile.upper,
        end=round(float(profile.times[-1]), 2),
        name="required torque",
    )


def first_saturation(profile: TorqueProfile, carried: Carried) -> Mark:
    """The instant to mark: that of ``carried`` if its payload is drawn, the first with |a| ≥ 1 of the zero payload
    otherwise, and if there is none, the tightest."""
    share = _demand(profile)
    if carried.payload is not None and carried.motor is not None and carried.time is not None:
        # The circle's acceleration has two values at half time; the tighter side is meant.
        near = np.flatnonzero(np.abs(profile.times - carried.time) <= np.abs(profile.times - carried.time).min() + 1e-6)
        place = int(near[np.argmax(share[near, carried.motor - 1])]), carried.motor - 1
    elif share.max() >= 1:
        step = int(np.argmax(share.max(axis=1) >= 1))
        place = step, int(np.argmax(share[step]))
    else:
        tightest = np.unravel_index(np.argmax(share), share.shape)
        place = int(tightest[0]), int(tightest[1])
    reached = share[place] >= _SATURATED
    note = "first saturation" if reached else f"{1 - share[place]:.1%} left"
    name = "first saturation" if reached else "tightest instant"
    return Mark(step=place[0], motor=place[1], name=name, note=note)


def draw_panels(figure: FigureBase, profile: TorqueProfile, mark: Mark) -> None:
    """Panels of torques with fewer instants, the marked one and its neighbours among them."""
    count = len(profile.times)
    some, around = np.arange(0, count, math.ceil(count / _POINTS)), mark.step + np.arange(-2, 3)
    kept = np.unique(np.concatenate([some, [count - 1], np.clip(around, 0, count - 1)]))
    thinner = dataclasses.replace(
        profile,
        times=profile.times[kept],
        torques=profile.torques[kept],
        lower=profile.lower[kept],
        upper=profile.upper[kept],
        demanded=None if profile.demanded is None else profile.demanded[kept],
    )
    torque_panels(figure, thinner, dataclasses.replace(mark, step=int(np.searchsorted(kept, mark.step))))


def head(figure: FigureBase, readings: Readings, *lines: str) -> None:
    """A title, and the reading where it is not the default."""
    words = readings.words()
    entitle(figure, *lines, *([] if words == "default" else [f"reading: {words}"]))


def _demand(profile: TorqueProfile) -> Array:
    """|a|, (K, m)."""
    torques = profile.torques if profile.demanded is None else profile.demanded
    share: Array = np.abs(2 * torques - profile.upper - profile.lower) / (profile.upper - profile.lower)
    return share


def first_limit(limit: Limit) -> str:
    """What gives way first, and when, without the last digits of the search for it."""
    return _gives_way(limit) + ("" if limit.time is None else f" at {limit.time:.3f} s")


def _gives_way(limit: Limit) -> str:
    where = {"torque": f"motor {limit.index}", "slack": f"cable {limit.index} slack", "scan_end": "nothing"}
    return where.get(limit.kind, limit.reason or limit.kind)
