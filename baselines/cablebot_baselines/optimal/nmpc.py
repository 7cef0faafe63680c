"""Receding-horizon controller (nonlinear MPC) with an observer of the robot that it meets."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.law import Array, flexible_advice
from cablebot_baselines.classical.observing import GAINS, UNCERTAINTY, Observing
from cablebot_baselines.classical.outer_loop import by_kind
from cablebot_baselines.entries import entry
from cablebot_baselines.estimation.expectation import Expectation
from cablebot_baselines.estimation.observer import RobotEstimate
from cablebot_baselines.optimal.horizon import (
    HORIZON,
    ExpectedRobot,
    HorizonProgram,
    PlanningError,
    Tuning,
)
from cablebot_gym.planning import Margins
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import find_uncertainty

_LOGGER = logging.getLogger("cablebot_gym")

STEPS_PER_PLAN = 5
"""Number of control steps between two plans."""

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
    """Time since each plan was made, (N,) [s]."""
    out_of_range: NDArray[np.bool_]
    """Whether the platform is too far from its reference to plan, (N,)."""


class NonlinearMPC(Observing):
    """Plans the next 0.2 s at every fifth control step and tracks the plan at every step.

    A plan starts from the state that the observer expects at the instant at which the action takes
    effect, stays within the error bounds and needs small motor actions, see
    :class:`~cablebot_baselines.optimal.horizon.Tuning`. It is a plan for the estimated mass,
    strengths of the motors and wrench.

    If the solver fails, the controller tracks the last plan until its end, and then the reference
    itself. If the platform is too far from the reference to plan, or the task is unknown because
    :meth:`reset` was not called, the controller also tracks the reference. :attr:`fallbacks` counts
    these cases.

    Args:
        robot: nominal rigid robot.
        tuning: tuning of the plans; None for :data:`TUNING`.
        gains: (K_P, K_D) of the law that tracks the plan; None for the gains of ``observing``.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the robot has joint springs or motors with lag.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        tuning: Tuning | None = None,
        gains: tuple[float, float] | None = None,
    ) -> None:
        if robot.flexible:
            raise ValueError(f"nmpc needs a rigid robot, but {flexible_advice(robot)}")
        tuning = tuning or by_kind(TUNING, robot)
        expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
        self.program = HorizonProgram(robot, tuning)
        law = FeedbackLinearization(
            expectation.robot,
            gains=gains or by_kind(GAINS, robot),
            minimum_tension=self.program.minimum_tension,
        )
        super().__init__(law, expectation)
        self.fallbacks = 0
        """Number of plans that were not made since the last :meth:`reset`: solver failures, and
        times that a platform moved too far from its reference."""
        self._tasks: tuple[Task, ...] = ()

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads motions and error bounds of the tasks, and sets :attr:`fallbacks` to zero.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        super().reset(tasks)
        self._tasks = tuple(tasks)
        self.fallbacks = 0

    def _possible(self, task: Task | None) -> float:
        """Largest payload that is considered possible in a task [kg]. Plans use the error bounds."""
        return PAYLOAD_OF_PLANS * super()._possible(task)

    def reference(
        self,
        blocks: dict[str, Array],
        estimate: RobotEstimate,
        ahead: dict[str, Array],
        memory: Any,
        starts: NDArray[np.bool_],
    ) -> tuple[dict[str, Array], PlannerState]:
        """The plans at the instant at which the action takes effect in place of the reference, and
        the plans for the next step."""
        reference, _ = super().reference(blocks, estimate, ahead, memory, starts)
        planner = self._advanced(memory, starts)
        due = np.flatnonzero(planner.steps % STEPS_PER_PLAN == 0)
        if len(due):
            planner = self._replanned(blocks, estimate, ahead, planner, due)
        names = ("reference_pose", "reference_velocity", "reference_acceleration")
        planned = {name: reference[name].copy() for name in names}
        for index, plan in enumerate(planner.plans):
            if plan is None:
                continue
            motion = self.program.basis_at(round(float(planner.plan_age[index]), 9)) @ plan
            for name, value in zip(names, motion, strict=True):
                planned[name][index] = value
        return reference | planned, planner

    def _advanced(self, before: PlannerState | None, starts: NDArray[np.bool_]) -> PlannerState:
        """The last plans after one control period; none for environments that start an episode."""
        count = len(starts)
        if before is None:
            return PlannerState(
                steps=np.zeros(count, int),
                plans=(None,) * count,
                plan_age=np.zeros(count),
                out_of_range=np.zeros(count, np.bool_),
            )
        plan_age = np.where(starts, np.inf, before.plan_age + self.observer.period)
        plans = list(before.plans)
        for index in np.flatnonzero(~(plan_age <= HORIZON)):
            plans[index] = None
        return PlannerState(
            steps=np.where(starts, 0, before.steps + 1),
            plans=tuple(plans),
            plan_age=plan_age,
            out_of_range=before.out_of_range & ~starts,
        )

    def _replanned(
        self,
        blocks: dict[str, Array],
        estimate: RobotEstimate,
        ahead: dict[str, Array],
        planner: PlannerState,
        due: NDArray[Any],
    ) -> PlannerState:
        """The state with new plans for the given environments."""
        plans = list(planner.plans)
        plan_age = planner.plan_age.copy()
        out_of_range = planner.out_of_range.copy()
        for index in due:
            was_out_of_range = out_of_range[index]
            reason = self._obstacle(blocks, index)
            out_of_range[index] = bool(reason)
            if reason:
                plans[index] = None
                if not was_out_of_range:
                    self._count_fallback(reason)
                continue
            robot = ExpectedRobot(
                mass=float(estimate.mass[index]),
                strength=estimate.strength[index],
                disturbance=ahead["disturbance"][index],
            )
            start = ahead["pose"][index], ahead["velocity"][index]
            task = self._task(index)
            now = task.trajectory.duration - blocks["time_to_go"][index, 0]
            time = float(now + estimate.delay[index])
            try:
                plans[index] = self._plan(task, time, start, robot, plans[index], plan_age[index])
                plan_age[index] = 0.0
            except PlanningError as error:
                self._count_fallback(str(error))
        return replace(planner, plans=tuple(plans), plan_age=plan_age, out_of_range=out_of_range)

    def _plan(
        self,
        task: Task,
        time: float,
        start: tuple[Array, Array],
        robot: ExpectedRobot,
        previous: Array | None,
        age: float,
    ) -> Array:
        """Control points of a plan from a time of the task on."""
        program, motion = self.program, task.trajectory
        reference = motion(time + program.instants).position
        guess = reference
        iterations = _FIRST_ITERATIONS
        if previous is not None:
            iterations = 1
            # Beyond the end of the previous plan, its last error stays constant.
            times = np.minimum(program.instants, HORIZON - age)
            guess = program.basis(times + age)[0] @ previous
            guess = guess + reference - motion(time + times).position
        return program.plan(
            guess,
            *start,
            reference,
            motion(time + HORIZON).velocity,
            robot=robot,
            error_bounds=task.error_bounds,
            iterations=iterations,
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


NMPC = entry("nmpc", NonlinearMPC)
