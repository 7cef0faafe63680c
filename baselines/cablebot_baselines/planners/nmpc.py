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
from cablebot_baselines.laws.law import Array
from cablebot_baselines.laws.observer_law import (
    UNCERTAINTY,
    Instant,
    ObserverLaw,
    observed_gains,
)
from cablebot_baselines.laws.outer_loop import by_kind
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.planners.horizon import (
    HORIZON,
    ExpectedRobot,
    HorizonProgram,
    Linearisation,
    PlanningError,
    Program,
    Target,
    Tuning,
)
from cablebot_gym.planning import Margins
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import find_uncertainty

_LOGGER = logging.getLogger("cablebot_gym")

STEPS_PER_PLAN = 5
"""Number of control steps between two plans."""

_LINEARISING = STEPS_PER_PLAN - 2
"""Control step after a plan in which the next plan begins."""

TUNING = {
    "planar": Tuning(
        intervals=10,
        instants=2,
        margins=Margins(position=7e-4, action=0.005, tension=3.5),
        action_exponent=4.0,
        error_weight=0.1,
        end_error_weight=0.0,
        end_velocity_weight=1.0,
        smoothness_weight=1e-6,
    ),
    "spatial": Tuning(
        intervals=7,
        instants=3,
        margins=Margins(position=5e-4, rotation=1.2e-3, action=0.002, tension=9.0),
        action_exponent=3.0,
        error_weight=0.3,
        end_error_weight=0.3,
        end_velocity_weight=3.0,
        smoothness_weight=1e-6,
    ),
}
"""Tuning with the largest DLCC on the paper's circles."""

PAYLOAD_OF_PLANS = 1.6
"""Largest payload of a plan within the error bounds, as a multiple of that with which the motors can
track the reference exactly."""

_FIRST_ITERATIONS = 3
"""Number of quadratic programs for a plan without a previous plan as initial guess."""

_PLANNED = ("reference_pose", "reference_velocity", "reference_acceleration")
"""Blocks in which a plan replaces the reference."""

_MAX_ERROR_RATIO = 2.0
"""Tracking error beyond which the controller does not plan, as a multiple of the error bounds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannerState:
    """Plans between two control steps; each array has a leading axis N."""

    steps: Array
    """Number of steps since the start of the episode, (N,)."""
    plans: tuple[Array | None, ...]
    """Control points (points, n) of the plan of each environment; None without a valid plan."""
    plan_age: Array
    """Time since the start of each plan, (N,) [s]."""
    pending: tuple[Linearisation | Program | None, ...]
    """Finished parts of the next plan of each environment; None if there are none."""
    out_of_range: NDArray[np.bool_]
    """Whether the platform is too far from its reference to plan, (N,)."""


class NonlinearMPC(ObserverLaw):
    """Plans the next 0.2 s at every fifth control step and tracks the plan at every step.

    A plan starts from the state that the observer expects at the instant at which the action takes
    effect, stays within the error bounds and needs small motor actions, see
    :class:`~cablebot_baselines.planners.horizon.Tuning`. It is a plan for the estimated mass,
    strengths of the motors and wrench. Each plan is one iteration from the one before, a real-time
    iteration: of the control steps before the plan, one linearises the robot and the next assembles
    the quadratic program. That of the plan solves it for the measured state. Without a plan before,
    one step makes the plan.

    If the solver fails, the controller tracks the last plan until its end, and then the reference
    itself. If the platform is too far from the reference to plan, or the task is unknown because
    :meth:`reset` was not called, the controller also tracks the reference. :attr:`fallbacks` counts
    these cases.

    Args:
        robot: nominal rigid robot.
        tuning: tuning of the plans; None for :data:`TUNING`.
        gains: (K_P, K_D) of the law that tracks the plan; None for
            :func:`~cablebot_baselines.laws.observer_law.observed_gains`.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the robot has joint springs or motors with lag.
    """

    def __init__(
        self,
        robot: Robot,
        tuning: Tuning | None = None,
        *,
        gains: tuple[float, float] | None = None,
    ) -> None:
        if robot.flexible:
            raise ValueError(f"nmpc needs a rigid robot, not {robot.springs}")
        tuning = tuning or by_kind(TUNING, robot)
        expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
        self.program = HorizonProgram(robot, tuning)
        law = FeedbackLinearization(
            expectation.robot,
            gains=gains or observed_gains(robot),
            minimum_tension=self.program.minimum_tension,
        )
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

    def reference(self, instant: Instant, memory: Any) -> tuple[dict[str, Array], PlannerState]:
        """The plans at the instant at which the action takes effect in place of the reference, and
        the plans for the next step."""
        planner = self._advanced(memory, instant.starts)
        phase = planner.steps % STEPS_PER_PLAN
        if np.any(phase == 0):
            planner = self._replanned(instant, planner, np.flatnonzero(phase == 0))
        if np.any(phase >= _LINEARISING):
            planner = self._prepared(instant, planner, phase)
        if any(plan is None for plan in planner.plans):
            planned, _ = super().reference(instant, memory)
        else:
            planned = {name: np.empty_like(instant.ahead["pose"]) for name in _PLANNED}
        for index, plan in enumerate(planner.plans):
            if plan is None:
                continue
            motion = self.program.basis_at(round(float(planner.plan_age[index]), 9)) @ plan
            for name, value in zip(_PLANNED, motion, strict=True):
                planned[name][index] = value
        return planned, planner

    def _advanced(self, before: PlannerState | None, starts: NDArray[np.bool_]) -> PlannerState:
        """The last plans after one control period; none for environments that start an episode."""
        count = len(starts)
        if before is None:
            return PlannerState(
                steps=np.zeros(count, int),
                plans=(None,) * count,
                plan_age=np.zeros(count),
                pending=(None,) * count,
                out_of_range=np.zeros(count, np.bool_),
            )
        plan_age = np.where(starts, np.inf, before.plan_age + self.observer.period)
        plans = list(before.plans)
        for index in np.flatnonzero(~(plan_age <= HORIZON)):
            plans[index] = None
        pending = list(before.pending)
        for index in np.flatnonzero(starts):
            pending[index] = None
        return PlannerState(
            steps=np.where(starts, 0, before.steps + 1),
            plans=tuple(plans),
            plan_age=plan_age,
            pending=tuple(pending),
            out_of_range=before.out_of_range & ~starts,
        )

    def _replanned(
        self, instant: Instant, planner: PlannerState, due: NDArray[Any]
    ) -> PlannerState:
        """The state with new plans for the given environments."""
        plans = list(planner.plans)
        pending = list(planner.pending)
        plan_age = planner.plan_age.copy()
        out_of_range = planner.out_of_range.copy()
        for index in due:
            program = pending[index]
            pending[index] = None
            was_out_of_range = out_of_range[index]
            reason = self._obstacle(instant.blocks, index)
            out_of_range[index] = bool(reason)
            if reason:
                plans[index] = None
                if not was_out_of_range:
                    self._count_fallback(reason)
                continue
            start = instant.ahead["pose"][index], instant.ahead["velocity"][index]
            try:
                if isinstance(program, Program):
                    plans[index] = self.program.solved(program, *start)
                elif plans[index] is None:
                    plans[index] = self.program.plan(
                        *start,
                        self._target(instant, index, 0.0),
                        robot=_expected(instant, index),
                        iterations=_FIRST_ITERATIONS,
                    )
                else:
                    continue  # nothing was prepared, and the last plan is still valid
                plan_age[index] = 0.0
            except PlanningError as error:
                self._count_fallback(str(error))
        return replace(
            planner,
            plans=tuple(plans),
            plan_age=plan_age,
            pending=tuple(pending),
            out_of_range=out_of_range,
        )

    def _prepared(
        self, instant: Instant, planner: PlannerState, phase: NDArray[Any]
    ) -> PlannerState:
        """The state with the next parts of the next plans, in the control steps before them."""
        pending = list(planner.pending)
        for index in np.flatnonzero(phase >= _LINEARISING).tolist():
            plan, part = planner.plans[index], pending[index]
            pending[index] = None
            try:
                if isinstance(part, Linearisation):
                    target = self._target(instant, index, self.observer.period)
                    pending[index] = self.program.assembled(part, target)
                elif plan is not None and phase[index] == _LINEARISING:
                    age = round(float(planner.plan_age[index]) + 2 * self.observer.period, 9)
                    robot = _expected(instant, index)
                    pending[index] = self.program.linearised(self.program.shift(age) @ plan, robot)
            except PlanningError as error:
                self._count_fallback(str(error))
        return replace(planner, pending=tuple(pending))

    def _target(self, instant: Instant, index: int, time: float) -> Target:
        """What a plan has to do that starts a time after the instant at which the action takes
        effect."""
        task = self._task(index)
        start = float(instant.time(task, index) + time)
        motion = task.trajectory(start + self.program.instants)
        return Target(
            reference=motion.position,
            last_velocity=motion.velocity[-1],
            error_bounds=task.error_bounds,
        )

    def _task(self, index: int) -> Task:
        return self._tasks[index % len(self._tasks)]

    def _obstacle(self, blocks: dict[str, Array], index: int) -> str:
        """Why there can be no plan; empty if there can."""
        if not self._tasks:
            return "the task is unknown; call reset(tasks) before predict()"
        bounds = self._task(index).error_bounds
        error = (blocks["pose"][index] - blocks["reference_pose"][index]) / _MAX_ERROR_RATIO
        d = self.robot.dimensions
        position = np.linalg.norm(error[:d])
        rotation = np.abs(error[d:]).max(initial=0.0)
        if position < bounds.position and rotation < bounds.rotation:
            return ""
        return "the platform is too far from its reference"

    def _count_fallback(self, reason: str) -> None:
        if self.fallbacks == 0:
            _LOGGER.warning(
                "nmpc has no new plan and tracks the previous plan or the reference: %s", reason
            )
        self.fallbacks += 1


def _expected(instant: Instant, index: int) -> ExpectedRobot:
    """What is expected of the robot of an environment."""
    return ExpectedRobot(
        mass=float(instant.estimate.mass[index]),
        strength=instant.estimate.strength[index],
        disturbance=instant.ahead["disturbance"][index],
    )


NMPC = entry("nmpc", NonlinearMPC)
