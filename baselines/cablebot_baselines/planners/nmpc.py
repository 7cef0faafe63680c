"""Receding-horizon controller (nonlinear MPC) with an observer of the robot that it meets."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import MotorPD
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.observer_law import REFERENCE, UNCERTAINTY, Instant, ObserverLaw
from cablebot_baselines.laws.outer_loop import PD, by_kind
from cablebot_baselines.laws.robust_design import RobustDesign
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.planners.horizon import (
    ExpectedRobots,
    HorizonProgram,
    Linearisation,
    Program,
    Target,
    has_plan,
)
from cablebot_baselines.planners.horizon_tuning import TUNING
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, Task
from cablebot_gym.uncertainty import find_uncertainty

_LOGGER = logging.getLogger("cablebot_gym")

STEPS_PER_PLAN = 5
"""Number of control steps between two plans."""

_LINEARISING = STEPS_PER_PLAN - 2
"""Control step after a plan in which the next plan begins."""

PAYLOAD_OF_PLANS = 1.6
"""Largest payload of a plan within the error bounds, as a multiple of that with which the motors can
track the reference exactly."""

_MAX_ERROR_RATIO = 2.0
"""Tracking error beyond which the controller does not plan, as a multiple of the error bounds."""


GAINS, PLANAR_GAINS = (400.0, 40.0), (900.0, 60.0)
"""(K_P, K_D) of the law that tracks the plan, and those of a robot in a plane [1/s², 1/s].

Higher ones amplify the noise of the sensors; with lower ones a platform in a plane turns too far
where the motors have less friction.
"""


TOGETHER = 32
"""Largest number of plans that are made together: their matrices fit into the cache."""

_Rows = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannerState:
    """Plans of N environments between two control steps."""

    step: NDArray[np.int64]
    """Number of steps since the start of the episode, (N,)."""
    plan: Array
    """Control points, (N, points, n); NaN without a valid plan."""
    age: Array
    """Time since the start of the plan, (N,) [s]."""
    out_of_range: NDArray[np.bool_]
    """Whether the platform is too far from its reference to plan, (N,)."""
    pending: tuple[tuple[_Rows, Linearisation | Program], ...]
    """Finished parts of the next plans, and their environments."""


class NonlinearMPC(ObserverLaw):
    """Plans the next control periods every :data:`STEPS_PER_PLAN` control steps and tracks the plan at every step.

    A plan of a rigid robot starts from the state that the observer expects at the instant at which the
    action takes effect. It stays within the error bounds and needs small motor actions, see
    :class:`~cablebot_baselines.planners.horizon_tuning.Tuning`, for the estimated mass, strengths of
    the motors and wrench. Each plan is one iteration from the one before, a real-time iteration: of
    the control steps before the plan, one linearises the robot and the next assembles the quadratic
    program. That of the plan solves it for the measured state. Without a plan before, one step makes
    the plan.

    On joint springs a plan starts from the one before: pose, velocity, acceleration and jerk have no
    jumps, after which the springs would swing. It is a plan for stiff springs. The law that tracks it
    moves the motors as the springs demand, and corrects the errors of the platform.

    If the solver fails, the controller tracks the last plan until its end, and then the reference
    itself. If the platform is too far from the reference to plan, the controller also tracks the
    reference. :attr:`fallbacks` counts these cases.

    Args:
        robot: nominal robot.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the robot has elastic cables or motors with lag.
    """

    def __init__(self, robot: Robot) -> None:
        if robot.elastic:
            raise ValueError(f"nmpc needs rigid cables, not {robot.springs}")
        expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
        self.program = HorizonProgram(robot, by_kind(TUNING[robot.joints], robot))
        minimum = self.program.minimum_tension
        law: ClassicalLaw
        if robot.flexible:
            law = MotorPD(expectation.robot, minimum_tension=minimum)
        else:
            gains = PLANAR_GAINS if robot.planar else GAINS
            law = FeedbackLinearization(expectation.robot, gains=gains, minimum_tension=minimum)
        super().__init__(law, expectation, payload_prior=PAYLOAD_OF_PLANS)
        self.fallbacks = 0
        """Number of plans that were not made since the last :meth:`reset`: solver failures, and
        times that a platform moved too far from its reference."""

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads motions and error bounds of the tasks, and sets :attr:`fallbacks` to zero.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        super().reset(tasks)
        self.fallbacks = 0
        if self.robot.flexible:
            stiffness = RobustDesign.usual(self.expectation, tasks[0]).stiffness
            self._correction = PD(gains=(stiffness**2, 2 * stiffness))

    def reference(self, instant: Instant, memory: Any) -> tuple[dict[str, Array], PlannerState]:
        """The plans at the instant at which the action takes effect in place of the reference, and
        the plans for the next step."""
        planner = self._advanced(memory, instant.starts)
        phase = planner.step % STEPS_PER_PLAN
        is_due = phase == 0
        if is_due.any():
            planner = self._replanned(instant, planner, is_due)
        planner = self._prepared(instant, planner, phase)
        motion = self._motion(instant, planner)
        blocks = dict(zip(REFERENCE, np.moveaxis(motion, 1, 0), strict=False))
        if self.robot.flexible:
            blocks["reference_acceleration"] = self._correction(instant.ahead | blocks)
        return blocks, planner

    def _motion(self, instant: Instant, planner: PlannerState) -> Array:
        """Pose and derivatives of the plans at the instant at which the action takes effect, (N,
        derivatives, n); those of the reference without a plan."""
        reference, _ = super().reference(instant, None)
        motion = np.stack(list(reference.values()), axis=1)
        is_planned = has_plan(planner.plan)
        for age in np.unique(planner.age[is_planned]).tolist():
            rows = np.flatnonzero(is_planned & (planner.age == age))
            basis = self.program.basis_at(age)[: motion.shape[1]]
            motion[rows] = basis @ planner.plan[rows]
        return motion

    def _advanced(self, planner: PlannerState | None, starts: NDArray[np.bool_]) -> PlannerState:
        """The last plans after one control period; none where an episode starts."""
        count = len(starts)
        if planner is None:
            no_plan = np.full((count, self.program.points, self.robot.coordinates), np.nan)
            return PlannerState(
                step=np.zeros(count, np.int64),
                plan=no_plan,
                age=np.zeros(count),
                out_of_range=np.zeros(count, np.bool_),
                pending=(),
            )
        age = np.where(starts, 0.0, np.round(planner.age + self.observer.period, 9))
        plan = planner.plan.copy()
        plan[starts | (age > self.program.horizon)] = np.nan
        return PlannerState(
            step=np.where(starts, 0, planner.step + 1),
            plan=plan,
            age=age,
            out_of_range=planner.out_of_range & ~starts,
            pending=_without(planner.pending, starts),
        )

    def _replanned(
        self, instant: Instant, planner: PlannerState, is_due: NDArray[np.bool_]
    ) -> PlannerState:
        """The state with new plans of the environments that are due."""
        plan, age = planner.plan.copy(), planner.age.copy()
        obstructed = is_due & self._is_obstructed(instant.blocks)
        newly_obstructed = obstructed & ~planner.out_of_range
        self._count_fallbacks(
            int(newly_obstructed.sum()), "the platform is too far from its reference"
        )
        plan[obstructed] = np.nan
        starts = self._starts(instant, planner)
        missing = is_due & ~obstructed
        for rows, part in _without(planner.pending, ~missing):
            assert isinstance(part, Program)  # it was assembled one step before
            missing[rows] = False
            self._keep(rows, *self.program.solved(part, starts[rows]), plan, age)
        missing &= ~has_plan(plan)
        for rows in self._together(np.flatnonzero(missing)):
            target = self._target(instant, rows, 0.0)
            robots = _expected(instant, rows)
            made = self.program.plan(starts[rows], target, robots=robots)
            self._keep(rows, *made, plan, age)
        return replace(
            planner,
            plan=plan,
            age=age,
            out_of_range=np.where(is_due, obstructed, planner.out_of_range),
            pending=_without(planner.pending, is_due),
        )

    def _starts(self, instant: Instant, planner: PlannerState) -> Array:
        """Pose and derivatives at the starts of plans, (N, given, n): those of the platform, or those of
        the last plans of a flexible robot, whose springs would swing at each jump."""
        if self.robot.flexible:
            return self._motion(instant, planner)[:, : self.program.given]
        return np.stack([instant.ahead["pose"], instant.ahead["velocity"]], axis=1)

    def _keep(self, rows: _Rows, made: Array, reason: str, plan: Array, age: Array) -> None:
        """Writes the plans that were made; the last ones stay where there is none."""
        succeeded = has_plan(made)
        plan[rows[succeeded]] = made[succeeded]
        age[rows[succeeded]] = 0.0
        self._count_fallbacks(int(np.sum(~succeeded)), reason)

    def _prepared(
        self, instant: Instant, planner: PlannerState, phase: NDArray[np.int64]
    ) -> PlannerState:
        """The state with the next parts of the next plans, in the control steps before them."""
        pending: list[tuple[_Rows, Linearisation | Program]] = []
        for rows, part in planner.pending:
            if isinstance(part, Linearisation):
                target = self._target(instant, rows, self.observer.period)
                part = self.program.assembled(part, target)
            pending.append((rows, part))
        begins = (phase == _LINEARISING) & has_plan(planner.plan)
        for age in np.unique(planner.age[begins]).tolist():
            shift = self.program.shift(round(age + 2 * self.observer.period, 9))
            for rows in self._together(np.flatnonzero(begins & (planner.age == age))):
                plans = shift @ planner.plan[rows]
                part = self.program.linearised(plans, _expected(instant, rows))
                pending.append((rows, part))
        return replace(planner, pending=tuple(pending))

    def _together(self, rows: _Rows) -> list[_Rows]:
        """The rows in parts that are planned together: few, with the same error bounds."""
        groups: dict[ErrorBounds, list[int]] = {}
        for row in rows.tolist():
            groups.setdefault(self._tasks[row].error_bounds, []).append(row)
        parts = []
        for group in groups.values():
            for start in range(0, len(group), TOGETHER):
                parts.append(np.array(group[start : start + TOGETHER]))
        return parts

    def _target(self, instant: Instant, rows: _Rows, time: float) -> Target:
        """What plans have to do that start a time after the instant at which the action takes
        effect."""
        count = len(instant.time_to_go)
        curve = np.broadcast_to(self._curve, count)[rows, None]
        start = self._references.durations[curve] - instant.time_to_go[rows, None] + time
        times = start + self.program.instants
        curves = np.broadcast_to(curve, times.shape)
        (samples,) = self._references(curves, times, 1)
        n = self.robot.coordinates
        return Target(
            reference=samples[..., :n],
            last_velocity=samples[:, -1, n : 2 * n],
            error_bounds=self._tasks[rows[0]].error_bounds,
        )

    def _is_obstructed(self, blocks: dict[str, Array]) -> NDArray[np.bool_]:
        """Whether platforms are too far from their references to plan, (N,)."""
        d = self.robot.dimensions
        error = (blocks["pose"] - blocks["reference_pose"]) / _MAX_ERROR_RATIO
        position = np.linalg.norm(error[:, :d], axis=1)
        rotation = np.abs(error[:, d:]).max(axis=1, initial=0.0)
        bounds = [task.error_bounds for task in self._tasks]
        is_near = position < [each.position for each in bounds]
        is_near &= rotation < [each.rotation for each in bounds]
        return ~is_near

    def _count_fallbacks(self, count: int, reason: str) -> None:
        if count and self.fallbacks == 0:
            _LOGGER.warning(
                "nmpc has no new plan and tracks the previous plan or the reference: %s", reason
            )
        self.fallbacks += count


def _without(
    pending: Sequence[tuple[_Rows, Linearisation | Program]], dropped: NDArray[np.bool_]
) -> tuple[tuple[_Rows, Linearisation | Program], ...]:
    """Parts of plans without those of some environments, (N,)."""
    kept = []
    for rows, part in pending:
        stays = ~dropped[rows]
        if stays.all():
            kept.append((rows, part))
        elif stays.any():
            kept.append((rows[stays], part[stays]))
    return tuple(kept)


def _expected(instant: Instant, rows: _Rows) -> ExpectedRobots:
    """What is expected of the robots of some environments."""
    return ExpectedRobots(
        mass=instant.estimate.mass[rows],
        strength=instant.estimate.strength[rows],
        disturbance=instant.ahead["disturbance"][rows],
    )


NMPC = entry("nmpc", NonlinearMPC)
