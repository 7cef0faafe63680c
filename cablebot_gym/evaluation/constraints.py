"""Checks the limits of an episode and records the first violation. Reads ``info``, which holds the true state."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.task import ErrorBounds, find_error_bounds
from cablebot_gym.utils.checks import unknown_name_error

Criterion = Literal["task", "paper"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)

ViolationKind = Literal["torque", "position", "rotation", "slack", "terminated"]

_ROUNDING = 1e-12
"""Tolerance of |a| ≤ 1 for rounding errors."""


def find_criterion(criterion: str) -> Criterion:
    """The criterion with a name.

    Raises:
        ValueError: if the name is unknown.
    """
    for known in CRITERIA:
        if criterion == known:
            return known
    raise unknown_name_error("criterion", criterion, CRITERIA)


@dataclass(frozen=True, kw_only=True)
class Violation:
    """The first violated limit of an episode."""

    kind: ViolationKind
    """Kind of limit. ``torque``: |a| > 1. ``position``, ``rotation``: a tracking error exceeds its bound. ``slack``: a
    cable is slack. ``terminated``: the environment terminated the episode."""
    index: int | None
    """Number of the motor or cable from 1, as in the paper; None for the other kinds."""
    time: float | None
    """Time of the violation [s]: the control instant for torque, else the end of the control period."""
    excess: float | None
    """Excess: torque beyond U± [N·m], or error beyond its bound [m or rad]; None for the other kinds."""
    reason: str = ""
    """``termination_reason`` of the environment if ``kind`` is ``terminated``, else empty."""

    def __str__(self) -> str:
        where = {"torque": f"motor {self.index}", "slack": f"cable {self.index} slack"}
        unit = {"torque": ("N·m", 1.0), "position": ("mm", 1e3), "rotation": ("mrad", 1e3)}
        text = where.get(self.kind, self.kind)
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
    """Outcome of an episode."""

    carried: bool
    """Whether the full motion was observed without a violation."""
    complete: bool
    """Whether the full motion was observed."""
    violation: Violation | None
    """The first violation; None without a violation."""
    payload: float
    """True payload [kg]."""
    peak_action: tuple[float, ...]
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
    """Checks N episodes through their ``info`` and records the first violation of each episode.

    Args:
        criterion: ``task``: position, rotation, slack and termination; ``paper``: |a| ≤ 1, position, slack and
            termination.
        error_bounds: bounds of the tracking errors.
        cables: number of cables m.
        count: number of episodes N.
    """

    def __init__(self, criterion: Criterion, error_bounds: ErrorBounds, cables: int, count: int) -> None:
        self.criterion, self.error_bounds = criterion, error_bounds
        self.failed = np.zeros(count, np.bool_)
        """Mask of the episodes with a violation, (N,)."""
        self._violations: list[Violation | None] = [None] * count
        self.peak_action = np.zeros((count, cables))
        self.position_peak, self.rotation_peak = np.zeros(count), np.zeros(count)
        self.least_tension = np.full(count, np.inf)
        self.payload = np.zeros(count)

    def reset(self, info: dict[str, Any]) -> None:
        """Checks the info of a reset, arrays with a leading axis N. The errors at t = 0 count."""
        self.payload = info["payload"].copy()
        self._check_errors(info, np.ones(len(self.failed), np.bool_))

    def observe(self, info: dict[str, Any], terminated: NDArray[np.bool_]) -> None:
        """Checks the info of one step, arrays with a leading axis N, and the terminated environments (N,)."""
        running = ~self.failed
        action = np.abs(info["commanded_action"])
        np.maximum(self.peak_action, action, out=self.peak_action, where=running[:, None])
        tension = info["tensions"].min(axis=1)
        np.minimum(self.least_tension, tension, out=self.least_tension, where=running)
        if self.criterion == "paper":
            for env_index in _env_indices(running & (action.max(axis=1) > 1 + _ROUNDING)):
                motor = int(np.argmax(action[env_index]))
                excess = -float(info["torque_margin"][env_index, motor])
                self._fail(env_index, "torque", motor + 1, info["action_time"][env_index], excess)
        for env_index in _env_indices(~self.failed & info["slack"].any(axis=1)):
            self._fail(env_index, "slack", int(np.argmax(info["slack"][env_index])) + 1, info["time"][env_index], None)
        self._check_errors(info, running)
        for env_index in _env_indices(~self.failed & terminated):
            self._fail(
                env_index, "terminated", None, info["time"][env_index], None, str(info["termination_reason"][env_index])
            )

    def _check_errors(self, info: dict[str, Any], running: NDArray[np.bool_]) -> None:
        position, rotation = info["tracking_error_peak"], info["rotation_error_peak"]
        np.maximum(self.position_peak, position, out=self.position_peak, where=running)
        np.maximum(self.rotation_peak, rotation, out=self.rotation_peak, where=running)
        for env_index in _env_indices(~self.failed & (position > self.error_bounds.position)):
            self._fail(
                env_index,
                "position",
                None,
                info["time"][env_index],
                float(position[env_index] - self.error_bounds.position),
            )
        if self.criterion == "task":
            for env_index in _env_indices(~self.failed & (rotation > self.error_bounds.rotation)):
                self._fail(
                    env_index,
                    "rotation",
                    None,
                    info["time"][env_index],
                    float(rotation[env_index] - self.error_bounds.rotation),
                )

    def _fail(
        self,
        env_index: int,
        kind: ViolationKind,
        index: int | None,
        time: float,
        excess: float | None,
        reason: str = "",
    ) -> None:
        self.failed[env_index] = True
        self._violations[env_index] = Violation(kind=kind, index=index, time=float(time), excess=excess, reason=reason)

    def verdict(self, env_index: int, *, complete: bool) -> Verdict:
        """Outcome of one episode. Only a complete episode, over the full motion, counts as carried."""
        tension = self.least_tension[env_index]
        return Verdict(
            carried=complete and not self.failed[env_index],
            complete=complete,
            violation=self._violations[env_index],
            payload=float(self.payload[env_index]),
            peak_action=tuple(self.peak_action[env_index].tolist()),
            position_peak=float(self.position_peak[env_index]),
            rotation_peak=float(self.rotation_peak[env_index]),
            least_tension=float(tension) if np.isfinite(tension) else 0.0,
        )


class DLCCMonitor(gym.Wrapper[Array, ArrayLike, Array, ArrayLike]):
    """Wrapper that checks every episode of a single environment of this package.

    ``monitor.verdict`` is the :class:`Verdict` up to the current step. ``info["dlcc_carried"]`` is True when the motion
    is finished without a violation.

    Args:
        env: a single environment made by ``gym.make``.
        criterion: ``task`` or ``paper``.
        error_bounds: bounds of the tracking errors; None for those of the episode.

    Raises:
        ValueError: if the criterion is unknown or a bound is invalid.
        TypeError: if the environment is not from this package.
    """

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        criterion: str = "task",
        error_bounds: ErrorBounds | dict[str, float] | None = None,
    ) -> None:
        super().__init__(env)
        if not hasattr(env.unwrapped, "task"):
            raise TypeError(
                f"DLCCMonitor needs an environment of cablebot_gym; {env.unwrapped} has no attribute 'task'"
            )
        self._criterion = find_criterion(criterion)
        self._error_bounds = None if error_bounds is None else find_error_bounds(error_bounds)
        self._judge: Judge | None = None
        self._steps = self._motion_steps = 0

    @property
    def verdict(self) -> Verdict:
        """Outcome of the current episode up to the current step.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._judge is None:
            raise gym.error.ResetNeeded("call reset() before verdict: no episode has started")
        return self._judge.verdict(0, complete=self._steps >= self._motion_steps)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode and checks its initial state."""
        observation, info = self.env.reset(seed=seed, options=options)
        task = self.env.get_wrapper_attr("task")
        error_bounds = task.error_bounds if self._error_bounds is None else self._error_bounds
        self._judge = Judge(self._criterion, error_bounds, task.robot.cables, 1)
        self._steps, self._motion_steps = 0, task.steps
        self._judge.reset(_batched(info))
        return observation, info | {"dlcc_carried": False}

    def step(self, action: ArrayLike) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Steps the environment and checks the limits until the end of the motion."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._judge is not None and self._steps < self._motion_steps:
            self._judge.observe(_batched(info), np.array([terminated]))
            self._steps += 1
        return observation, reward, terminated, truncated, info | {"dlcc_carried": self.verdict.carried}


def _env_indices(mask: NDArray[np.bool_]) -> list[int]:
    """Indices of the True entries of a mask."""
    env_indices: list[int] = np.flatnonzero(mask).tolist()
    return env_indices


def _batched(info: dict[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value)[None] for name, value in info.items()}
