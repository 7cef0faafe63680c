"""Receding-horizon controller (nonlinear MPC) with an observer of the robot that it meets."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.law import Array
from cablebot_baselines.laws.observer_law import UNCERTAINTY, Instant, ObserverLaw
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
    ),
    "spatial": Tuning(
        intervals=7,
        instants=3,
        margins=Margins(position=5e-4, rotation=1.2e-3, action=0.002, tension=9.0),
        action_exponent=3.0,
        error_weight=0.3,
        end_error_weight=0.3,
        end_velocity_weight=3.0,
    ),
}
"""Tuning with the largest DLCC on the paper's circles."""

PAYLOAD_OF_PLANS = 1.6
"""Largest payload of a plan within the error bounds, as a multiple of that with which the motors can
track the reference exactly."""

_PLANNED = ("reference_pose", "reference_velocity", "reference_acceleration")
"""Blocks in which a plan replaces the reference."""

_MAX_ERROR_RATIO = 2.0
"""Tracking error beyond which the controller does not plan, as a multiple of the error bounds."""


GAINS, PLANAR_GAINS = (400.0, 40.0), (900.0, 60.0)
"""(K_P, K_D) of the law that tracks the plan, and those of a robot in a plane [1/s², 1/s].

Higher ones amplify the noise of the sensors; with lower ones a platform in a plane turns too far
where the motors have less friction.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannerState:
    """Plan of one environment between two control steps."""

    step: int = 0
    """Number of steps since the start of the episode."""
    plan: Array | None = None
    """Control points (points, n); None without a valid plan."""
    age: float = 0.0
    """Time since the start of the plan [s]."""
    pending: Linearisation | Program | None = None
    """Finished parts of the next plan; None if there are none."""
    out_of_range: bool = False
    """Whether the platform is too far from its reference to plan."""


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
    itself. If the platform is too far from the reference to plan, the controller also tracks the
    reference. :attr:`fallbacks` counts these cases.

    Args:
        robot: nominal rigid robot.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the robot has joint springs or motors with lag.
    """

    def __init__(self, robot: Robot) -> None:
        if robot.flexible:
            raise ValueError(f"nmpc needs a rigid robot, not {robot.springs}")
        expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
        gains = GAINS
        if robot.planar:
            gains = PLANAR_GAINS
        self.program = HorizonProgram(robot, by_kind(TUNING, robot))
        law = FeedbackLinearization(
            expectation.robot,
            gains=gains,
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

    def reference(
        self, instant: Instant, memory: Any
    ) -> tuple[dict[str, Array], list[PlannerState]]:
        """The plans at the instant at which the action takes effect in place of the reference, and
        the plans for the next step."""
        planners = []
        for index, starts in enumerate(instant.starts):
            planner = PlannerState()
            if memory is not None and not starts:
                planner = self._advanced(memory[index])
            phase = planner.step % STEPS_PER_PLAN
            if phase == 0:
                planner = self._replanned(instant, index, planner)
            elif phase >= _LINEARISING:
                planner = self._prepared(instant, index, planner, phase)
            planners.append(planner)
        if any(planner.plan is None for planner in planners):
            planned, _ = super().reference(instant, memory)
        else:
            planned = {name: np.empty_like(instant.ahead["pose"]) for name in _PLANNED}
        for index, planner in enumerate(planners):
            if planner.plan is None:
                continue
            motion = self.program.basis_at(round(planner.age, 9)) @ planner.plan
            for name, value in zip(_PLANNED, motion, strict=True):
                planned[name][index] = value
        return planned, planners

    def _advanced(self, planner: PlannerState) -> PlannerState:
        """The last plan after one control period."""
        age = planner.age + self.observer.period
        plan = planner.plan
        if age > HORIZON:
            plan = None
        return replace(planner, step=planner.step + 1, plan=plan, age=age)

    def _replanned(self, instant: Instant, index: int, planner: PlannerState) -> PlannerState:
        """The state with a new plan."""
        reason = self._obstacle(instant.blocks, index)
        if reason:
            if not planner.out_of_range:
                self._count_fallback(reason)
            return replace(planner, plan=None, pending=None, out_of_range=True)
        part = planner.pending
        planner = replace(planner, pending=None, out_of_range=False)
        start = instant.ahead["pose"][index], instant.ahead["velocity"][index]
        try:
            if isinstance(part, Program):
                plan = self.program.solved(part, *start)
            elif planner.plan is None:
                plan = self.program.plan(
                    *start,
                    self._target(instant, index, 0.0),
                    robot=_expected(instant, index),
                )
            else:
                return planner  # nothing was prepared, and the last plan is still valid
        except PlanningError as error:
            self._count_fallback(str(error))
            return planner
        return replace(planner, plan=plan, age=0.0)

    def _prepared(
        self, instant: Instant, index: int, planner: PlannerState, phase: int
    ) -> PlannerState:
        """The state with the next part of the next plan, in a control step before it."""
        part = planner.pending
        pending: Linearisation | Program | None = None
        try:
            if isinstance(part, Linearisation):
                target = self._target(instant, index, self.observer.period)
                pending = self.program.assembled(part, target)
            elif planner.plan is not None and phase == _LINEARISING:
                age = round(planner.age + 2 * self.observer.period, 9)
                plan = self.program.shift(age) @ planner.plan
                pending = self.program.linearised(plan, _expected(instant, index))
        except PlanningError as error:
            self._count_fallback(str(error))
        return replace(planner, pending=pending)

    def _target(self, instant: Instant, index: int, time: float) -> Target:
        """What a plan has to do that starts a time after the instant at which the action takes
        effect."""
        task = self._tasks[index]
        start = float(instant.time(task, index) + time)
        motion = task.trajectory(start + self.program.instants)
        return Target(
            reference=motion.position,
            last_velocity=motion.velocity[-1],
            error_bounds=task.error_bounds,
        )

    def _obstacle(self, blocks: dict[str, Array], index: int) -> str:
        """Why there can be no plan; empty if there can."""
        bounds = self._tasks[index].error_bounds
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
