"""Checks the limits of episodes and records the first violations. Reads ``info``, which holds the true state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.task import ErrorBounds, find_error_bounds
from cablebot_gym.utils.checks import choice

Criterion = Literal["task", "paper"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)

ViolationKind = Literal["torque", "slack", "position", "rotation", "terminated"]
KINDS: tuple[ViolationKind, ...] = get_args(ViolationKind)
"""Kinds of violations by code, in the order in which the judge checks them."""

_ROUNDING = 1e-12
"""Tolerance of |a| ≤ 1 for rounding errors."""


def find_criterion(criterion: str) -> Criterion:
    """The criterion with a name.

    Raises:
        ValueError: if the name is unknown.
    """
    return CRITERIA[CRITERIA.index(choice("criterion", criterion, CRITERIA))]


@dataclass(frozen=True, kw_only=True)
class Violation:
    """The first violated limit of an episode. ``str(violation)`` is a sentence."""

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
    bound: float | None = None
    """Exceeded error bound [m or rad]; None for the other kinds."""

    def __str__(self) -> str:
        unit = {"position": "mm", "rotation": "mrad"}
        bound = "" if self.bound is None else f" of {1e3 * self.bound:g} {unit[self.kind]}"
        texts = {
            "torque": f"motor {self.index} reaches its torque limit",
            "slack": f"cable {self.index} is slack",
            "terminated": f"terminated ({self.reason.replace('_', ' ')})",
        }
        text = texts.get(self.kind, f"{self.kind} error reaches its bound{bound}")
        return text if self.time is None else f"{text} at t = {self.time:.3f} s"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Outcome of an episode up to the last observed step.

    An episode is unfinished if it is neither carried nor has a violation.
    """

    carried: bool
    """Whether the full motion was observed without a violation."""
    violation: Violation | None
    """The first violation; None without a violation."""
    payload: float
    """True payload [kg]."""
    peak_action: tuple[float, ...]
    """Largest |a| of each motor. This extreme and the following ones end with the step of the violation."""
    position_peak: float
    """Largest position error at any physics step [m]."""
    rotation_peak: float
    """Largest rotation error at any physics step [rad]."""
    least_tension: float
    """Least tension of any cable at a control instant [N]; 0 before the first step."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        return asdict(self)


class Judge:
    """Checks N episodes step by step. Keeps the first violations and the extremes, no time series.

    The checks of a step are, in this order: torque (paper criterion), slack, position error, rotation error (task
    criterion), termination. They stop at the first violation and at the end of the motion.

    Args:
        criterion: ``task``: position, rotation, slack and termination; ``paper``: |a| ≤ 1, position, slack and
            termination.
        cables: number of cables m.
        count: number of episodes N.
    """

    def __init__(self, criterion: Criterion, cables: int, count: int) -> None:
        self.criterion = criterion
        self.failed = np.zeros(count, np.bool_)
        """Mask of the episodes with a violation, (N,)."""
        self.kind = np.zeros(count, np.int64)
        """Code of the violation, an index of :data:`KINDS`, (N,); valid if the episode has failed, as all below."""
        self.time, self.excess = np.zeros(count), np.zeros(count)
        """Time [s] and excess [N·m, m or rad] of the violation, (N,); the excess is NaN for other kinds."""
        self._index, self._reason = np.zeros(count, np.int64), np.full(count, "", "<U16")
        self._position_bound, self._rotation_bound = np.zeros(count), np.zeros(count)
        self._step = np.zeros(count, np.int64)
        self.steps = np.zeros(count, np.int64)
        """Number of control steps of the motion, (N,)."""
        self._payload, self._position_peak, self._rotation_peak = np.zeros((3, count))
        self._peak_action, self._least_tension = np.zeros((count, cables)), np.zeros(count)

    @property
    def carried(self) -> NDArray[np.bool_]:
        """Mask of the episodes whose full motion was observed without a violation, (N,)."""
        return ~self.failed & self.finished

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Mask of the episodes whose full motion was observed, (N,)."""
        return self._step >= self.steps

    def reset(
        self,
        info: Mapping[str, Array],
        error_bounds: ErrorBounds,
        steps: int,
        mask: NDArray[np.bool_] | None = None,
        *,
        check_start: bool = True,
    ) -> None:
        """Starts episodes.

        Args:
            info: info of the environment's reset, arrays (N, …).
            error_bounds: bounds of the tracking errors in these episodes.
            steps: number of control steps of their motion.
            mask: mask of the episodes to start, (N,); None for all.
            check_start: whether the errors at t = 0 count.
        """
        mask = np.ones(len(self.failed), np.bool_) if mask is None else mask
        self._position_bound[mask] = error_bounds.position
        self._rotation_bound[mask] = error_bounds.rotation if self.criterion == "task" else np.inf
        self._step[mask], self.steps[mask] = 0, steps
        self._payload[mask] = info["payload"][mask]
        self._position_peak[mask], self._rotation_peak[mask] = 0.0, 0.0
        self._peak_action[mask], self._least_tension[mask] = 0.0, np.inf
        self.failed[mask] = False
        if check_start:
            self._check_errors(info, mask)

    def observe(self, info: Mapping[str, Array], terminated: NDArray[np.bool_]) -> None:
        """Checks one step of all episodes.

        Args:
            info: info of the environment's step, arrays (N, …).
            terminated: whether the environment terminated the episode, (N,).
        """
        running = ~self.failed & ~self.finished
        self._step += 1
        action, time = np.abs(info["commanded_action"]), info["time"]
        np.maximum(self._peak_action, action, out=self._peak_action, where=running[:, None])
        np.minimum(self._least_tension, info["tensions"].min(axis=1), out=self._least_tension, where=running)
        if self.criterion == "paper" and (saturated := running & (action.max(axis=1) > 1 + _ROUNDING)).any():
            motor = action.argmax(axis=1)
            excess = -np.take_along_axis(info["torque_margin"], motor[:, None], 1)[:, 0]
            self._fail("torque", saturated, info["action_time"], index=motor + 1, excess=excess)
        if (slack := running & info["slack"].any(axis=1)).any():
            self._fail("slack", slack, time, index=info["slack"].argmax(axis=1) + 1)
        self._check_errors(info, running)
        if (ended := running & terminated).any():
            self._fail("terminated", ended, time, reason=info["termination_reason"])

    def _check_errors(self, info: Mapping[str, Array], running: NDArray[np.bool_]) -> None:
        position, rotation = info["tracking_error_peak"], info["rotation_error_peak"]
        np.maximum(self._position_peak, position, out=self._position_peak, where=running)
        np.maximum(self._rotation_peak, rotation, out=self._rotation_peak, where=running)
        if (beyond := running & (position > self._position_bound)).any():
            self._fail("position", beyond, info["time"], excess=position - self._position_bound)
        if (beyond := running & (rotation > self._rotation_bound)).any():
            self._fail("rotation", beyond, info["time"], excess=rotation - self._rotation_bound)

    def _fail(
        self,
        kind: ViolationKind,
        mask: NDArray[np.bool_],
        time: Array,
        *,
        index: ArrayLike = 0,
        excess: ArrayLike = np.nan,
        reason: ArrayLike = "",
    ) -> None:
        """Records a violation of the episodes in ``mask`` that have none."""
        fresh = mask & ~self.failed
        self.failed |= fresh
        self.kind[fresh] = KINDS.index(kind)
        np.copyto(self.time, time, where=fresh)
        np.copyto(self.excess, excess, where=fresh)
        np.copyto(self._index, index, where=fresh)
        np.copyto(self._reason, np.asarray(reason), where=fresh)

    def violation(self, env_index: int) -> Violation | None:
        """The first violation of one episode; None without a violation."""
        if not self.failed[env_index]:
            return None
        kind, index, excess = KINDS[self.kind[env_index]], int(self._index[env_index]), float(self.excess[env_index])
        bounds = {"position": self._position_bound, "rotation": self._rotation_bound}
        return Violation(
            kind=kind,
            index=index or None,
            time=float(self.time[env_index]),
            excess=None if np.isnan(excess) else excess,
            reason=str(self._reason[env_index]),
            bound=float(bounds[kind][env_index]) if kind in bounds else None,
        )

    def verdict(self, env_index: int) -> Verdict:
        """Outcome of one episode up to the present step."""
        tension = float(self._least_tension[env_index])
        return Verdict(
            carried=bool(self.carried[env_index]),
            violation=self.violation(env_index),
            payload=float(self._payload[env_index]),
            peak_action=tuple(self._peak_action[env_index].tolist()),
            position_peak=float(self._position_peak[env_index]),
            rotation_peak=float(self._rotation_peak[env_index]),
            least_tension=tension if np.isfinite(tension) else 0.0,
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
        AttributeError: if the environment is not from this package.
    """

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        criterion: str = "task",
        error_bounds: ErrorBounds | dict[str, float] | None = None,
    ) -> None:
        super().__init__(env)
        self._error_bounds = None if error_bounds is None else find_error_bounds(error_bounds)
        self._judge = Judge(find_criterion(criterion), env.get_wrapper_attr("task").robot.cables, 1)
        self._started = False

    @property
    def verdict(self) -> Verdict:
        """Outcome of the current episode up to the current step.

        Raises:
            ResetNeeded: before the first reset.
        """
        if not self._started:
            raise gym.error.ResetNeeded("call reset() before verdict: no episode has started")
        return self._judge.verdict(0)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode and checks its initial state."""
        observation, info = self.env.reset(seed=seed, options=options)
        task = self.env.get_wrapper_attr("task")
        self._judge.reset(_batched(info), self._error_bounds or task.error_bounds, task.steps)
        self._started = True
        return observation, info | {"dlcc_carried": False}

    def step(self, action: ArrayLike) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Steps the environment and checks the limits until the end of the motion."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._judge.observe(_batched(info), np.array([terminated]))
        return observation, reward, terminated, truncated, info | {"dlcc_carried": bool(self._judge.carried[0])}


def _batched(info: Mapping[str, Any]) -> dict[str, Array]:
    return {name: np.asarray(value)[None] for name, value in info.items()}
