"""Judging an episode: which limit gave way first, when, and by how much. Reads ``info``, which tells the true state."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.task import Limits, find_limits
from cablebot_gym.utils.suggestions import no_such

Criterion = Literal["task", "paper"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)

LimitKind = Literal["torque", "position", "rotation", "slack", "terminated", "scan_end"]

_ROUNDING = 1e-12
"""How far |a| may exceed 1 by rounding."""


def find_criterion(criterion: str) -> Criterion:
    """The criterion of that name.

    Raises:
        ValueError: if there is none.
    """
    for known in CRITERIA:
        if criterion == known:
            return known
    raise ValueError(no_such("criterion", criterion, CRITERIA))


@dataclass(frozen=True, kw_only=True)
class Limit:
    """What gave way first."""

    kind: LimitKind
    """``torque``: |a| > 1; ``position``, ``rotation``: an error beyond its bound; ``slack``: a slack cable;
    ``terminated``: the environment ended the episode; ``scan_end``: nothing did, up to the largest payload tried."""
    index: int | None
    """Motor or cable, counted from 1 as the paper does; None where there is none."""
    time: float | None
    """When [s]: the control instant for torque, the end of the control period otherwise."""
    excess: float | None
    """By how much: torque beyond U± [N·m], error beyond its bound [m or rad]; None where it has no size."""
    reason: str = ""
    """``termination_reason`` of the environment where ``kind`` is ``terminated``, else empty."""

    def __str__(self) -> str:
        where = {"torque": f"motor {self.index}", "slack": f"cable {self.index} slack"}
        unit = {"torque": ("N·m", 1.0), "position": ("mm", 1e3), "rotation": ("mrad", 1e3)}
        text = where.get(self.kind, self.kind.replace("scan_end", "nothing, up to the largest payload tried"))
        if self.reason:
            text += f" ({self.reason})"
        if self.time is not None:
            text += f" at t = {self.time:.3f} s"
        if self.excess is not None:
            name, scale = unit[self.kind]
            text += f", {self.excess * scale:.3g} {name} beyond"
        return text


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How an episode went."""

    carried: bool
    """The whole motion was seen and no limit gave way."""
    complete: bool
    """The whole motion was seen."""
    limit: Limit | None
    """What gave way first; None while nothing has."""
    payload: float
    """True payload [kg]."""
    peak_demand: tuple[float, ...]
    """Largest |a| of each motor."""
    position_peak: float
    """Largest position error at any physics step [m]."""
    rotation_peak: float
    """Largest rotation error at any physics step [rad]."""
    least_tension: float
    """Least tension of any cable at a control instant [N]."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        return asdict(self)


class Judge:
    """Watches N episodes through their ``info`` and keeps, for each, the first limit that gave way.

    Args:
        criterion: ``task``: position, rotation, slack and termination; ``paper``: |a| ≤ 1, position, slack and
            termination.
        limits: bounds of the errors.
        cables: m.
        count: N.
    """

    def __init__(self, criterion: Criterion, limits: Limits, cables: int, count: int) -> None:
        self.criterion, self.limits = criterion, limits
        self.failed = np.zeros(count, np.bool_)
        """Which episodes have broken a limit, (N,)."""
        self._failures: list[Limit | None] = [None] * count
        self.peak_demand = np.zeros((count, cables))
        self.position_peak, self.rotation_peak = np.zeros(count), np.zeros(count)
        self.least_tension = np.full(count, np.inf)
        self.payload = np.zeros(count)

    def begin(self, info: dict[str, Any]) -> None:
        """Looks at the reset's info, arrays with a leading axis N: the errors at t = 0 count."""
        self.payload = info["payload"].copy()
        self._errors(info, np.ones(len(self.failed), np.bool_))

    def observe(self, info: dict[str, Any], terminated: NDArray[np.bool_]) -> None:
        """Looks at the info of one step, arrays with a leading axis N, and at which lanes have terminated (N,)."""
        watched = ~self.failed
        demand = np.abs(info["drive_demand"])
        np.maximum(self.peak_demand, demand, out=self.peak_demand, where=watched[:, None])
        tension = info["tensions"].min(axis=1)
        np.minimum(self.least_tension, tension, out=self.least_tension, where=watched)
        if self.criterion == "paper":
            for lane in _lanes(watched & (demand.max(axis=1) > 1 + _ROUNDING)):
                motor = int(np.argmax(demand[lane]))
                excess = -float(info["torque_margin"][lane, motor])
                self._fail(lane, "torque", motor + 1, info["command_time"][lane], excess)
        for lane in _lanes(~self.failed & info["slack"].any(axis=1)):
            self._fail(lane, "slack", int(np.argmax(info["slack"][lane])) + 1, info["time"][lane], None)
        self._errors(info, watched)
        for lane in _lanes(~self.failed & terminated):
            self._fail(lane, "terminated", None, info["time"][lane], None, str(info["termination_reason"][lane]))

    def _errors(self, info: dict[str, Any], watched: NDArray[np.bool_]) -> None:
        position, rotation = info["tracking_error_peak"], info["rotation_error_peak"]
        np.maximum(self.position_peak, position, out=self.position_peak, where=watched)
        np.maximum(self.rotation_peak, rotation, out=self.rotation_peak, where=watched)
        for lane in _lanes(~self.failed & (position > self.limits.position)):
            self._fail(lane, "position", None, info["time"][lane], float(position[lane] - self.limits.position))
        if self.criterion == "task":
            for lane in _lanes(~self.failed & (rotation > self.limits.rotation)):
                self._fail(lane, "rotation", None, info["time"][lane], float(rotation[lane] - self.limits.rotation))

    def _fail(
        self, lane: int, kind: LimitKind, index: int | None, time: float, excess: float | None, reason: str = ""
    ) -> None:
        self.failed[lane] = True
        self._failures[lane] = Limit(kind=kind, index=index, time=float(time), excess=excess, reason=reason)

    def verdict(self, lane: int, *, complete: bool) -> Verdict:
        """How the episode of one lane went; only a complete one, of the whole motion, is carried."""
        tension = self.least_tension[lane]
        return Verdict(
            carried=complete and not self.failed[lane],
            complete=complete,
            limit=self._failures[lane],
            payload=float(self.payload[lane]),
            peak_demand=tuple(self.peak_demand[lane].tolist()),
            position_peak=float(self.position_peak[lane]),
            rotation_peak=float(self.rotation_peak[lane]),
            least_tension=float(tension) if np.isfinite(tension) else 0.0,
        )


class DLCCMonitor(gym.Wrapper[Array, ArrayLike, Array, ArrayLike]):
    """Judges every episode of anybody's loop over a single environment of this package.

    ``monitor.verdict`` is the :class:`Verdict` so far, and ``info["dlcc_carried"]`` whether the payload has been
    carried: the motion is over and no limit gave way.

    Args:
        env: a single environment made by ``gym.make``.
        criterion: ``task`` or ``paper``.
        limits: bounds; None for those of the episode.

    Raises:
        ValueError: if the criterion is unknown or a limit is not valid.
        TypeError: if the environment is none of this package's.
    """

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        criterion: str = "task",
        limits: Limits | dict[str, float] | None = None,
    ) -> None:
        super().__init__(env)
        if not hasattr(env.unwrapped, "task"):
            raise TypeError(f"DLCCMonitor judges this package's environments; {env.unwrapped} tells no task")
        self._criterion = find_criterion(criterion)
        self._limits = None if limits is None else find_limits(limits)
        self._judge: Judge | None = None
        self._steps = self._needed = 0

    @property
    def verdict(self) -> Verdict:
        """How the present episode has gone so far.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._judge is None:
            raise gym.error.ResetNeeded("call reset() first: there is no episode to judge yet")
        return self._judge.verdict(0, complete=self._steps >= self._needed)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode and judges its start."""
        observation, info = self.env.reset(seed=seed, options=options)
        task = self.env.get_wrapper_attr("task")
        limits = task.limits if self._limits is None else self._limits
        self._judge = Judge(self._criterion, limits, task.robot.cables, 1)
        self._steps, self._needed = 0, task.steps
        self._judge.begin(_batched(info))
        return observation, info | {"dlcc_carried": False}

    def step(self, action: ArrayLike) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """One control period, judged while the motion lasts."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._judge is not None and self._steps < self._needed:
            self._judge.observe(_batched(info), np.array([terminated]))
            self._steps += 1
        return observation, reward, terminated, truncated, info | {"dlcc_carried": self.verdict.carried}


def _lanes(mask: NDArray[np.bool_]) -> list[int]:
    """Where a mask holds."""
    lanes: list[int] = np.flatnonzero(mask).tolist()
    return lanes


def _batched(info: dict[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value)[None] for name, value in info.items()}
