"""Checks the limits of episodes and records the first violations. The judge reads ``info``, which
holds the true state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.envs.limits import is_held, is_taut, is_unsaturated, minimum_tension, within_bound
from cablebot_gym.kinematics import Array
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import choice

CRITERIA = ("task", "paper")
"""Names of the criteria: ``task`` (saturated motors; position, rotation, tension) and ``paper``
(|a| ≤ 1, position, slack)."""

ViolationKind = Literal["torque", "slack", "overload", "position", "rotation", "terminated"]
"""Kinds of violations in the order in which the judge checks them."""

LIMIT_NAMES: Mapping[str, str] = {
    "torque": "torque limit",
    "slack": "least tension",
    "overload": "largest tension",
    "position": "position error",
    "rotation": "rotation error",
    "terminated": "termination",
}
"""Name of the violated limit for each kind of violation, for tables. A cable below its least
tension need not be slack."""

_REASONS = np.array(TERMINATION_REASONS)


@dataclass(frozen=True, kw_only=True)
class Violation:
    """The first violated limit of an episode. ``str(violation)`` is a sentence."""

    kind: ViolationKind
    """Kind of limit:

    * ``torque``: |a| > 1, or the motor cannot hold the robot at rest at the start
    * ``position``, ``rotation``: a tracking error exceeds its bound
    * ``slack``: a tension falls below its bound (unilateral cables, task criterion), or a cable is
      slack
    * ``overload``: a tension exceeds the maximum of the robot (task criterion)
    * ``terminated``: the environment terminated the episode
    """
    index: int | None
    """Number of the motor or cable from 1, as in the paper; None for the other kinds."""
    time: float | None
    """Time of the violation [s]: 0 at the start, the control instant for torque, else the end of the
    control period. The judge always sets it."""
    excess: float | None
    """Excess: torque beyond U± [N·m], error beyond its bound [m or rad], or missing or excessive
    tension [N]; None for a slack cable and for ``terminated``."""
    reason: str = ""
    """Name of the environment's ``termination_reason`` if ``kind`` is ``terminated``; ``start`` if
    a motor cannot hold the robot at the start; else empty."""
    bound: float | None = None
    """Bound of the error [m or rad] or of the tension [N]; None if the limit has none."""

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Violation:
        """The violation of a stored row, which may have further fields."""
        return cls(**{item.name: data[item.name] for item in fields(cls) if item.name in data})

    def __str__(self) -> str:
        if self.time is None:
            return self._limit_text()
        return f"{self._limit_text()} at t = {self.time:.3f} s"

    def _limit_text(self) -> str:
        if self.kind == "torque":
            if self.reason:  # at the start
                return f"motor {self.index} cannot hold the robot at rest"
            return f"motor {self.index} reaches its torque limit"
        if self.kind == "slack":
            if self.bound is None:
                return f"cable {self.index} is slack"
            return f"cable {self.index} falls below its tension bound of {self.bound:g} N"
        if self.kind == "overload":
            return f"cable {self.index} exceeds its largest tension of {self.bound:g} N"
        if self.kind == "terminated":
            return f"terminated ({self.reason.replace('_', ' ')})"
        if self.bound is None:
            return f"{self.kind} error reaches its bound"
        unit = {"position": "mm", "rotation": "mrad"}[self.kind]
        return f"{self.kind} error reaches its bound of {1e3 * self.bound:g} {unit}"


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
    """Largest |a| of each motor. This and the following values include the step of the violation and
    no later one."""
    position_peak: float
    """Largest position error at any physics step [m]."""
    rotation_peak: float
    """Largest rotation error at any physics step [rad]."""
    least_tension: float
    """Least tension of any cable at a physics step [N]; 0 before the first step."""
    largest_tension: float
    """Largest tension of any cable at a physics step [N]; 0 before the first step."""

    @property
    def outcome(self) -> str:
        """``carried``, ``unfinished``, or ``not carried`` with the violation."""
        if self.violation is not None:
            return f"not carried: {self.violation}"
        if self.carried:
            return "carried"
        return "unfinished"


class Judge:
    """Checks N episodes step by step. It stores the first violations and the extremes, but no time
    series.

    The checks of a step are, in this order: torque (paper criterion), least tension, largest tension
    (task criterion), position error, rotation error (task criterion), termination. The checks of an
    episode stop at its first violation and at the end of the motion.

    Args:
        criterion: ``task``: position, rotation, tension ≥ T_min of unilateral cables, tension ≤
            T_max, termination, and motors that can hold the robot at the start of a motion that
            starts at rest;
            ``paper``: |a| ≤ 1, position, slack and termination.
        cables: number of cables m.
        count: number of episodes N.
    """

    def __init__(self, criterion: str, cables: int, count: int) -> None:
        self.criterion = criterion
        self.failed = np.zeros(count, np.bool_)
        """Mask of the episodes with a violation, (N,)."""
        self._violations: list[Violation | None] = [None] * count
        self._position_bound = np.zeros(count)
        self._rotation_bound = np.zeros(count)
        self._lower_tension_bound = np.zeros(count)
        self._upper_tension_bound = np.zeros(count)
        self._steps_done = np.zeros(count, np.int64)
        self.motion_steps = np.zeros(count, np.int64)
        """Number of control steps of the motion, (N,)."""
        self.payload = np.zeros(count)
        """True payloads, (N,) [kg]."""
        self._position_peak = np.zeros(count)
        self._rotation_peak = np.zeros(count)
        self._peak_action = np.zeros((count, cables))
        self._least_tension = np.zeros(count)
        self._largest_tension = np.zeros(count)

    @property
    def carried(self) -> NDArray[np.bool_]:
        """Mask of the episodes whose full motion was observed without a violation, (N,)."""
        return ~self.failed & self.finished

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Mask of the episodes whose full motion was observed, (N,)."""
        return self._steps_done >= self.motion_steps

    def reset(
        self, info: Mapping[str, Array], task: Task, mask: NDArray[np.bool_] | None = None
    ) -> None:
        """Starts episodes. Bounds, length and robot of the task are read here only.

        Args:
            info: info of the environment's reset, arrays (N, …).
            task: task of these episodes.
            mask: mask of the episodes to start, (N,); None for all.
        """
        if mask is None:
            mask = np.ones(len(self.failed), np.bool_)
        self._position_bound[mask] = task.error_bounds.position
        self._rotation_bound[mask] = np.inf
        self._lower_tension_bound[mask] = -np.inf
        self._upper_tension_bound[mask] = np.inf
        if self.criterion == "task":
            self._rotation_bound[mask] = task.error_bounds.rotation
            self._lower_tension_bound[mask] = minimum_tension(task.robot, task.cable)
            self._upper_tension_bound[mask] = task.robot.maximum_tension
        self._steps_done[mask] = 0
        self.motion_steps[mask] = task.steps
        self.payload[mask] = info["payload"][mask]
        self._position_peak[mask] = 0.0
        self._rotation_peak[mask] = 0.0
        self._peak_action[mask] = 0.0
        self._least_tension[mask] = np.inf
        self._largest_tension[mask] = 0.0
        self.failed[mask] = False
        if self.criterion == "task" and task.starts_at_rest:
            margin = info["torque_margin"]
            least = margin.min(axis=1)
            self._fail(
                "torque",
                mask & ~is_held(least),
                info["time"],
                index=margin.argmin(axis=1) + 1,
                excess=-least,
                reason="start",
            )
        self._check_errors(info, mask)

    def observe(self, info: Mapping[str, Array], terminated: NDArray[np.bool_]) -> None:
        """Checks one step of all episodes.

        Args:
            info: info of the environment's step, arrays (N, …).
            terminated: whether the environment terminated the episode, (N,).
        """
        running = ~self.failed & ~self.finished
        self._steps_done += 1
        action = np.abs(info["commanded_action"])
        time = info["time"]
        np.maximum(self._peak_action, action, out=self._peak_action, where=running[:, None])
        tension = info["least_tensions"].min(axis=1)
        np.minimum(self._least_tension, tension, out=self._least_tension, where=running)
        if self.criterion == "paper":
            largest_action = action.max(axis=1)
            saturated = running & ~is_unsaturated(largest_action)
            if saturated.any():
                motor = action.argmax(axis=1)
                excess = -np.take_along_axis(info["torque_margin"], motor[:, None], 1)[:, 0]
                self._fail("torque", saturated, info["action_time"], index=motor + 1, excess=excess)
        bound = self._lower_tension_bound
        below_bound = running & ~is_taut(tension, bound)
        if below_bound.any():
            cable = info["least_tensions"].argmin(axis=1)
            self._fail(
                "slack", below_bound, time, index=cable + 1, excess=bound - tension, bound=bound
            )
        slack = running & info["slack"].any(axis=1)
        if slack.any():
            cable = info["slack"].argmax(axis=1)
            self._fail("slack", slack, time, index=cable + 1, bound=bound)
        tensions = info["largest_tensions"]
        largest = tensions.max(axis=1)
        np.maximum(self._largest_tension, largest, out=self._largest_tension, where=running)
        cable = tensions.argmax(axis=1)
        self._check_upper(
            "overload", largest, self._upper_tension_bound, time, running, index=cable + 1
        )
        self._check_errors(info, running)
        ended = running & terminated
        if ended.any():
            self._fail("terminated", ended, time, reason=_REASONS[info["termination_reason"]])

    def _check_errors(self, info: Mapping[str, Array], running: NDArray[np.bool_]) -> None:
        position = info["tracking_error_peak"]
        rotation = info["rotation_error_peak"]
        np.maximum(self._position_peak, position, out=self._position_peak, where=running)
        np.maximum(self._rotation_peak, rotation, out=self._rotation_peak, where=running)
        self._check_upper("position", position, self._position_bound, info["time"], running)
        self._check_upper("rotation", rotation, self._rotation_bound, info["time"], running)

    def _check_upper(
        self,
        kind: ViolationKind,
        value: Array,
        bound: Array,
        time: Array,
        running: NDArray[np.bool_],
        **columns: ArrayLike,
    ) -> None:
        """Checks an upper bound. ``columns`` are further fields of the violation."""
        beyond = running & ~within_bound(value, bound)
        if beyond.any():
            self._fail(kind, beyond, time, excess=value - bound, bound=bound, **columns)

    def _fail(
        self, kind: ViolationKind, mask: NDArray[np.bool_], time: Array, **values: ArrayLike
    ) -> None:
        """Records a violation of the episodes in ``mask`` that have none. ``values`` are its
        further fields, (N,) or scalar."""
        fresh = mask & ~self.failed
        self.failed |= fresh
        columns = {name: np.broadcast_to(column, fresh.shape) for name, column in values.items()}
        for env_index in np.flatnonzero(fresh).tolist():
            given: dict[str, Any] = {"index": None, "excess": None, "time": time[env_index].item()}
            for name, column in columns.items():
                given[name] = column[env_index].item()
            # a slack cable without a tension bound has the bound −∞
            if not np.isfinite(given.get("bound", 0.0)):
                given["bound"] = None
            self._violations[env_index] = Violation(kind=kind, **given)

    def verdict(self, env_index: int) -> Verdict:
        """Outcome of one episode up to the present step."""
        tension = float(self._least_tension[env_index])
        if not np.isfinite(tension):
            tension = 0.0
        violation = None
        if self.failed[env_index]:  # reset() clears only the mask
            violation = self._violations[env_index]
        return Verdict(
            carried=bool(self.carried[env_index]),
            violation=violation,
            payload=float(self.payload[env_index]),
            peak_action=tuple(self._peak_action[env_index].tolist()),
            position_peak=float(self._position_peak[env_index]),
            rotation_peak=float(self._rotation_peak[env_index]),
            least_tension=tension,
            largest_tension=float(self._largest_tension[env_index]),
        )


class DLCCMonitor(gym.Wrapper[Array, ArrayLike, Array, ArrayLike]):
    """Wrapper that checks every episode of a single environment of this package.

    ``monitor.verdict`` is the :class:`Verdict` up to the current step. ``info["dlcc_carried"]`` is
    True when the motion is finished without a violation.

    Args:
        env: a single environment made by ``gym.make``.
        criterion: ``task`` or ``paper``.

    Raises:
        ValueError: if the criterion is unknown.
        AttributeError: if the environment is not from this package.
    """

    def __init__(self, env: gym.Env[Array, ArrayLike], *, criterion: str = "task") -> None:
        super().__init__(env)
        choice("criterion", criterion, CRITERIA)
        self._judge = Judge(criterion, env.get_wrapper_attr("task").robot.cables, 1)
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

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode and checks its initial state."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._judge.reset(_batched(info), self.env.get_wrapper_attr("task"))
        self._started = True
        return observation, info | {"dlcc_carried": False}

    def step(self, action: ArrayLike) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Steps the environment and checks the limits until the end of the motion."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._judge.observe(_batched(info), np.array([terminated]))
        info = info | {"dlcc_carried": bool(self._judge.carried[0])}
        return observation, reward, terminated, truncated, info


def _batched(info: Mapping[str, Any]) -> dict[str, Array]:
    """Info of one environment as that of a batch, arrays (1, …)."""
    return {name: np.asarray(value)[None] for name, value in info.items()}
