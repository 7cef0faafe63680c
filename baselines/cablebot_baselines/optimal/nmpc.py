"""Receding-horizon controller (nonlinear MPC) that plans from the observation alone."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cablebot_baselines.classical.adaptive import ADAPTIVE_GAINS, Adaptive, EstimatorState
from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.law import Array, ClassicalLaw, first_steps, flexible_advice
from cablebot_baselines.classical.outer_loop import by_kind
from cablebot_baselines.entries import entry
from cablebot_baselines.optimal.horizon import HORIZON, HorizonProgram, PlanningError, Tuning
from cablebot_gym.envs.observation import PREVIEWS
from cablebot_gym.planning import Margins
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, Task

_LOGGER = logging.getLogger("cablebot_gym")

STEPS_PER_PLAN = 5
"""Number of control steps between two plans."""

TUNING = {
    "planar": Tuning(
        intervals=10,
        instants=2,
        margins=Margins(position=3e-4, action=0.005, tension=0.5),
        action_exponent=4.0,
        error_weight=0.1,
        end_error_weight=0.0,
        end_velocity_weight=1.0,
        smoothness_weight=1e-6,
    ),
    "spatial": Tuning(
        intervals=7,
        instants=3,
        margins=Margins(position=4e-4, rotation=4e-4, action=0.002, tension=9.0),
        action_exponent=3.0,
        error_weight=0.3,
        end_error_weight=0.3,
        end_velocity_weight=3.0,
        smoothness_weight=1e-6,
    ),
}
"""Tuning with the largest DLCC on the paper's circles."""

ESTIMATOR_PRIOR_WEIGHT = 1e-3
"""Estimator prior weight, see :class:`~cablebot_baselines.classical.adaptive.Adaptive` [s].

It is small, because a plan for a wrong mass is worse than a plan for a noisy mass.
"""

_FIRST_ITERATIONS = 3
"""Number of quadratic programs for a plan without a previous plan as initial guess."""

_STORED_POINTS = 4 * 24
"""Number of stored points of the reference: slightly more than the previews of all plans of one
horizon at 500 Hz."""

_MAX_ERROR_RATIO = 2.0
"""Tracking error beyond which the controller does not plan, as a multiple of the error bounds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannerState:
    """State of the controller between two control steps; each array has a leading axis N."""

    steps: Array
    """Number of steps since the start of the episode, (N,)."""
    clock: Array
    """Negative time to go at the last control step, (N,) [s]."""
    period: Array
    """Control period, (N,) [s]; 0 until it is known."""
    preview_times: Array
    """Clock times of the previewed points of the reference, (N, _STORED_POINTS) [s]; NaN for unused
    entries."""
    preview_points: Array
    """Previewed points of the reference, (N, _STORED_POINTS, n)."""
    plans: tuple[Array | None, ...]
    """Control points (points, n) of the plan of each environment; None without a valid plan."""
    plan_age: Array
    """Time since each plan was made, (N,) [s]."""
    out_of_range: NDArray[np.bool_]
    """Whether the platform is too far from its reference to plan, (N,)."""
    law: EstimatorState | None
    """State of the law that tracks the plan; None before the first step."""


class NonlinearMPC(ClassicalLaw):
    """Plans the next 0.2 s at every fifth control step and tracks the plan with the adaptive law at
    every step.

    A plan starts from the measured pose and velocity, stays within the error bounds and needs small
    motor actions, see :class:`~cablebot_baselines.optimal.horizon.Tuning`. It uses the mass that
    the law estimates. The future reference follows from the previews of the current and of earlier
    observations.

    If the solver fails, the controller tracks the last plan until its end, and then the reference
    itself. If the platform is too far from the reference to plan, the controller also tracks the
    reference. :attr:`fallbacks` counts both cases.

    Args:
        robot: nominal rigid robot.
        tuning: tuning of the plans; None for :data:`TUNING`.
        gains: (K_P, K_D) of the law that tracks the plan; None for the gains of ``adaptive``.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the robot has joint springs or motors with lag.
    """

    unsaturated_actions = False

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
        self.program = HorizonProgram(robot, tuning)
        super().__init__(robot, minimum_tension=self.program.minimum_tension)
        law = FeedbackLinearization(
            robot,
            gains=gains or by_kind(ADAPTIVE_GAINS, robot),
            minimum_tension=self.minimum_tension,
        )
        self.law = Adaptive(law, estimator_prior_weight=ESTIMATOR_PRIOR_WEIGHT)
        self.fallbacks = 0
        """Number of solver failures, and of times that a platform moved too far from its reference,
        since the last :meth:`reset`."""
        self._error_bounds: tuple[ErrorBounds, ...] = (ErrorBounds(),)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Checks the robots of the tasks, reads their error bounds and sets :attr:`fallbacks` to
        zero.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        self.law.reset(tasks)
        self._error_bounds = tuple(task.error_bounds for task in tasks)
        self.fallbacks = 0

    def respond(
        self, blocks: dict[str, Array], state: Any = None, episode_start: Any = None
    ) -> tuple[Array, Any]:
        """Actions and the next state, a :class:`PlannerState`, from the blocks of an
        observation."""
        if blocks["pose"].ndim == 1:
            batch = {name: block[None] for name, block in blocks.items()}
            action, state = self.respond(batch, state, episode_start)
            return action[0], state
        starts = first_steps(state, episode_start, blocks["pose"].shape[:1])
        planner = self._advance(blocks, state, starts)
        due = planner.steps % STEPS_PER_PLAN == 0
        if np.any(due):
            planner = self._replan(blocks, planner, np.flatnonzero(due))
        action, law = self.law.respond(self._planned_blocks(blocks, planner), planner.law, starts)
        return action, replace(planner, law=law)

    def _advance(
        self, blocks: dict[str, Array], before: PlannerState | None, starts: NDArray[np.bool_]
    ) -> PlannerState:
        """The last state advanced by one control period, and a new state for environments that
        start an episode."""
        count, n = blocks["pose"].shape
        clock = -blocks["time_to_go"][:, 0]
        zeros = np.zeros(count)
        if before is None:
            return PlannerState(
                steps=np.zeros(count, int),
                clock=clock,
                period=zeros,
                preview_times=np.full((count, _STORED_POINTS), np.nan),
                preview_points=np.full((count, _STORED_POINTS, n), np.nan),
                plans=(None,) * count,
                plan_age=zeros,
                out_of_range=np.zeros(count, np.bool_),
                law=None,
            )
        difference = clock - before.clock
        # The clock stops at the end of the reference.
        period = np.where(starts, 0.0, np.where(difference > 0, difference, before.period))
        plan_age = np.where(starts, np.inf, before.plan_age + period)
        plans = list(before.plans)
        for env_index in np.flatnonzero(~(plan_age <= HORIZON)):
            plans[env_index] = None
        return replace(
            before,
            steps=np.where(starts, 0, before.steps + 1),
            clock=clock,
            period=period,
            preview_times=np.where(starts[:, None], np.nan, before.preview_times),
            plans=tuple(plans),
            plan_age=plan_age,
            out_of_range=before.out_of_range & ~starts,
        )

    # Planning

    def _replan(
        self, blocks: dict[str, Array], planner: PlannerState, env_indices: NDArray[Any]
    ) -> PlannerState:
        """The state with new plans for the given environments."""
        planner = self._store_previews(blocks, planner, env_indices)
        model_mass = self.robot.mass + blocks["model_payload"][:, 0]
        mass = model_mass
        if planner.law is not None:
            mass = self.law.mass(planner.law, model_mass)
        mass = np.where(planner.steps == 0, model_mass, mass)
        plans = list(planner.plans)
        plan_age = planner.plan_age.copy()
        out_of_range = planner.out_of_range.copy()
        for index in env_indices:
            error_bounds = self._error_bounds[index % len(self._error_bounds)]
            was_out_of_range = out_of_range[index]
            out_of_range[index] = not self._in_range(blocks, index, error_bounds)
            if out_of_range[index]:
                plans[index] = None
                if not was_out_of_range:
                    self._count_fallback("the platform is too far from its reference")
                continue
            try:
                plans[index] = self._plan(blocks, planner, index, float(mass[index]), error_bounds)
                plan_age[index] = 0.0
            except PlanningError as error:
                self._count_fallback(str(error))
        return replace(planner, plans=tuple(plans), plan_age=plan_age, out_of_range=out_of_range)

    def _plan(
        self,
        blocks: dict[str, Array],
        planner: PlannerState,
        env_index: int,
        mass: float,
        error_bounds: ErrorBounds,
    ) -> Array:
        program = self.program
        previous = planner.plans[env_index]
        age = planner.plan_age[env_index]
        preview = self.preview(blocks, planner, env_index)
        guess = reference = preview(program.instants)
        iterations = _FIRST_ITERATIONS
        if previous is not None:
            iterations = 1
            # Beyond the end of the previous plan, its last error stays constant.
            times = np.minimum(program.instants, HORIZON - age)
            guess = program.basis(times + age)[0] @ previous + reference - preview(times)
        return program.plan(
            guess,
            blocks["pose"][env_index],
            blocks["velocity"][env_index],
            reference,
            preview(HORIZON, 1),
            mass=mass,
            error_bounds=error_bounds,
            iterations=iterations,
        )

    def _in_range(
        self, blocks: dict[str, Array], env_index: int, error_bounds: ErrorBounds
    ) -> bool:
        error = (blocks["pose"][env_index] - blocks["reference_pose"][env_index]) / _MAX_ERROR_RATIO
        d = self.robot.dimensions
        position = np.linalg.norm(error[:d])
        rotation = np.abs(error[d:]).max(initial=0.0)
        return bool(position < error_bounds.position and rotation < error_bounds.rotation)

    def _count_fallback(self, reason: str) -> None:
        if self.fallbacks == 0:
            _LOGGER.warning(
                "nmpc has no new plan and tracks the previous plan or the reference: %s", reason
            )
        self.fallbacks += 1

    # Reference

    def _store_previews(
        self, blocks: dict[str, Array], planner: PlannerState, env_indices: NDArray[Any]
    ) -> PlannerState:
        """The state with the current previews of the given environments."""
        names = [f"preview_{round(ahead * 1e3)}ms" for ahead in PREVIEWS]
        offsets = np.stack([blocks[name][env_indices] for name in names], axis=1)
        times = planner.preview_times.copy()
        points = planner.preview_points.copy()
        times[env_indices] = np.roll(times[env_indices], len(names), axis=1)
        points[env_indices] = np.roll(points[env_indices], len(names), axis=1)
        times[env_indices, : len(names)] = planner.clock[env_indices, None] + PREVIEWS
        points[env_indices, : len(names)] = offsets + blocks["reference_pose"][env_indices, None]
        return replace(planner, preview_times=times, preview_points=points)

    def preview(
        self, blocks: dict[str, Array], planner: PlannerState, env_index: int
    ) -> CubicSpline:
        """Interpolates X_d of one environment over the horizon, through all previewed points.

        On the paper's planar circle the interpolation error is at most 0.64 mm at the start, and
        less than 0.04 mm from 0.1 s on.
        """
        pose = blocks["reference_pose"][env_index]
        velocity = blocks["reference_velocity"][env_index]
        if blocks["time_to_go"][env_index, 0] <= 0:
            velocity = np.zeros_like(velocity)
        relative = np.round(planner.preview_times[env_index] - planner.clock[env_index], 6)
        times, indices = np.unique(relative, return_index=True)
        ahead = (times > 1e-6) & (times <= HORIZON)
        points = np.concatenate([pose[None], planner.preview_points[env_index][indices[ahead]]])
        return CubicSpline(np.r_[0.0, times[ahead]], points, bc_type=((1, velocity), "not-a-knot"))

    # Tracking

    def _planned_blocks(self, blocks: dict[str, Array], planner: PlannerState) -> dict[str, Array]:
        """The blocks with the plan in place of the reference for environments that have a plan."""
        names = ("reference_pose", "reference_velocity", "reference_acceleration")
        planned = blocks | {name: blocks[name].copy() for name in names}
        for env_index, plan in enumerate(planner.plans):
            if plan is not None:
                motion = self.program.basis_at(round(float(planner.plan_age[env_index]), 9)) @ plan
                for name, value in zip(names, motion, strict=True):
                    planned[name][env_index] = value
        return planned


NMPC = entry("nmpc", NonlinearMPC)
