"""Policy that plans one motion within the error bounds for each task and then tracks it."""

from __future__ import annotations

import logging
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.adaptive import Adaptive, EstimatorState, make_adaptive
from cablebot_baselines.classical.law import Array, ClassicalLaw, first_steps
from cablebot_baselines.entries import entry
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Follower, Infeasible, Margins, PlannedMotion, State, plan_motion
from cablebot_gym.planning.stage_functions import check_model, import_casadi
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, Task
from cablebot_gym.trajectories import Trajectory

_LOGGER = logging.getLogger("cablebot_gym")

INTERVALS_PER_SECOND = 50.0
"""Spline intervals of a plan per second [1/s]. More of them hardly increase the DLCC and take
longer to plan."""

MINIMUM_INTERVALS, MAXIMUM_INTERVALS = 20, 240
"""Minimum and maximum number of spline intervals of a plan."""

INITIAL_ESTIMATE_WEIGHT = 0.05
"""Weight of the static mass estimate at the start of an episode [s].

After this estimation time in motion, the dynamic estimate and the static estimate have equal
weight.
"""


@dataclass(frozen=True, kw_only=True)
class TrajOptSettings:
    """Margins of a plan and parameters of the law that tracks it."""

    error_margin: float
    """Margin to the error bounds of position and rotation, as a fraction of the bounds."""
    action_margin: float
    """Margin to the action limits ±1."""
    tension_margin: float
    """Margin to the robot's minimum tension [N]."""
    gains: tuple[float, float]
    """(K_P, K_D) of the platform's pose error [1/s², 1/s]."""
    estimator_prior_weight: float
    """Estimator prior weight [s], see :class:`~cablebot_baselines.classical.adaptive.Adaptive`."""
    motor_frequency: float = 100.0
    """Angular frequency of the motor loop of a flexible robot [rad/s]."""
    mass_deficit: float = 0.0
    """Relative deviation of the platform mass below its nominal value that the plan covers."""

    def margins(self, robot: Robot, error_bounds: ErrorBounds) -> Margins:
        """Margins of the plan for a robot and error bounds.

        When a motor reverses, its Coulomb friction changes sign within a control period. Without
        springs this changes the tension of its cable, so the margin includes it. With springs and
        redundant cables the margin is at most that at the start of an episode.
        """
        position = self.error_margin * error_bounds.position
        rotation = self.error_margin * error_bounds.rotation
        tension = self.tension_margin
        if not robot.flexible:
            tension += float((robot.coulomb_friction / robot.pulley_radius).max())
        elif robot.cables > robot.coordinates:
            reserve = textbook.allocated_minimum(robot) - robot.minimum_tension
            tension = min(tension, reserve)
        return Margins(
            position=position, rotation=rotation, action=self.action_margin, tension=tension
        )


TRAJOPT_SETTINGS = {
    "rigid": TrajOptSettings(
        error_margin=0.02,
        action_margin=0.005,
        tension_margin=1.0,
        gains=(2500.0, 100.0),
        estimator_prior_weight=1e-4,
    ),
    "flexible": TrajOptSettings(
        error_margin=0.02,
        action_margin=0.01,
        tension_margin=3.0,
        gains=(100.0, 10.0),
        estimator_prior_weight=1e-4,
    ),
}
"""Settings of ``trajopt`` with small margins, for a robot with nominal parameters and any
payload."""

TRAJOPT_MARGIN_SETTINGS = {
    "rigid": TrajOptSettings(
        error_margin=0.2,
        action_margin=0.02,
        tension_margin=4.0,
        gains=(400.0, 40.0),
        estimator_prior_weight=2e-3,
        mass_deficit=0.15,
    ),
    "flexible": TrajOptSettings(
        error_margin=0.35,
        action_margin=0.03,
        tension_margin=3.5,
        gains=(200.0, 20.0),
        estimator_prior_weight=2e-3,
        mass_deficit=0.15,
    ),
}
"""Settings of ``trajopt-margin`` with margins for sensor noise and for model error."""


class PlanLaw(ClassicalLaw):
    """Tracks one planned motion with a given mass.

    Args:
        robot: nominal robot.
        plan: planned motion.
        period: control period [s].
        settings: parameters of the tracking law.
    """

    def __init__(
        self, robot: Robot, plan: PlannedMotion, period: float, settings: TrajOptSettings
    ) -> None:
        super().__init__(robot, minimum_tension=robot.minimum_tension + settings.tension_margin)
        self._follower = Follower(
            robot=robot, gains=settings.gains, motor_frequency=settings.motor_frequency
        )
        self._plan, self._period = plan, period

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Requested torques [N·m] and motor speeds [rad/s], each (..., m)."""
        plan = self._plan
        state = State.from_blocks(blocks, plan.duration - blocks["time_to_go"][..., 0])
        return self._follower.torques(plan, state, mass - self.robot.mass, self._period)

    @property
    def rotor_inertia(self) -> Array:
        """J of a rigid robot, J + J′ of a flexible robot [kg·m²], (m,)."""
        inertia: Array = self.robot.pulley_inertia
        if self.robot.flexible:
            inertia = inertia + self.robot.motor_inertia
        return inertia


class AdaptivePlanLaw(Adaptive):
    """Tracks one planned motion and estimates the payload with the acceleration of the plan as
    weight.

    When the plan moves below the reference, it accelerates downward at g/2 or more. The reference
    acceleration does not contain this motion. As a weight it would overrate the small remaining
    cable forces.

    Args:
        robot: nominal robot.
        plan: planned motion.
        period: control period [s].
        settings: parameters of the tracking law and of the estimator.
    """

    def __init__(
        self, robot: Robot, plan: PlannedMotion, period: float, settings: TrajOptSettings
    ) -> None:
        law = PlanLaw(robot, plan, period, settings)
        super().__init__(law, estimator_prior_weight=settings.estimator_prior_weight)
        self._plan = plan

    def respond(
        self, blocks: dict[str, Array], state: Any = None, episode_start: Any = None
    ) -> tuple[Array, Any]:
        """Actions from the blocks of an observation, with the plan in place of the reference."""
        motion = self._plan(self._plan.duration - blocks["time_to_go"][..., 0])
        reference = {
            "reference_pose": motion.position,
            "reference_velocity": motion.velocity,
            "reference_acceleration": motion.acceleration,
        }
        return super().respond(blocks | reference, state, episode_start)

    def _updated_state(
        self, blocks: dict[str, Array], before: EstimatorState | None, episode_start: Any
    ) -> EstimatorState:
        """Estimator state, with a static estimate of the first step for a robot with joint springs.

        An episode starts at rest, so the initial spring torques give the mass.
        """
        memory = super()._updated_state(blocks, before, episode_start)
        robot = self.robot
        if not robot.flexible or robot.weightless:
            return memory
        starts = first_steps(before, episode_start, blocks["pose"].shape[:-1])[..., None]
        structure = textbook.jacobian(robot, blocks["pose"])
        tensions = memory.torques / robot.pulley_radius
        wrench = np.swapaxes(structure, -1, -2) @ tensions[..., None]
        vertical = wrench[..., robot.dimensions - 1, :]
        weight = INITIAL_ESTIMATE_WEIGHT * robot.gravity
        impulse = np.where(starts, weight * vertical, memory.weighted_impulse)
        change = np.where(starts, weight * robot.gravity, memory.weighted_change)
        return replace(memory, weighted_impulse=impulse, weighted_change=change)


class TrajOpt:
    """Plans one motion per task for the largest possible payload, and tracks it with the actual
    payload.

    The plan begins at the start pose of the task and includes its dwells. The plan is feasible with
    the largest payload and without payload, and therefore with every payload in between. The policy
    tracks it with an estimate of the mass, so it corrects a wrong or unknown payload
    (:class:`~cablebot_baselines.classical.adaptive.Adaptive`). The first planning of a task takes
    seconds. The plan is then stored on disk.

    Without a plan, or without a call of :meth:`reset`, the policy tracks the reference itself with
    the adaptive law. :attr:`fallbacks` counts these episodes, and a warning gives the reason.

    Args:
        robot: nominal robot.
        settings: margins and parameters of the tracking law for this kind of robot.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the motors of the robot have a lag.
    """

    unsaturated_actions = False

    def __init__(self, robot: Robot, settings: TrajOptSettings) -> None:
        import_casadi()
        check_model(robot)
        self.robot, self.settings = robot, settings
        self.fallbacks = 0
        """Number of episodes without a plan since the last :meth:`reset`."""
        # Environments with the same task and their law.
        self._groups: list[tuple[NDArray[np.intp], Adaptive]] | None = None
        self._plans: dict[Any, tuple[Trajectory, PlannedMotion | str]] = {}
        self._reference_law = make_adaptive(robot)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Plans one motion for each different task.

        Raises:
            ValueError: if a task's robot differs from the policy's robot in kind or anchors.
        """
        self._reference_law.reset(tasks)
        self.fallbacks = 0
        groups: dict[Any, list[int]] = {}
        for env_index, task in enumerate(tasks):
            motion: Any = task.trajectory
            if not isinstance(motion, Hashable):
                motion = id(motion)  # a trajectory that is not hashable is equal only to itself
            key = (motion, task.error_bounds, task.control_frequency)
            groups.setdefault(key, []).append(env_index)
        self._groups = []
        for key, indices in groups.items():
            law = self._law(key, tasks[indices[0]], len(indices))
            self._groups.append((np.array(indices), law))

    def _law(self, key: Any, task: Task, episodes: int) -> Adaptive:
        if key not in self._plans:
            # Stores the trajectory, too: its id may be part of the key, so it must stay alive.
            self._plans[key] = task.trajectory, self._plan(task)
        _, plan = self._plans[key]
        if isinstance(plan, str):
            return self._fall_back(episodes, plan)
        return AdaptivePlanLaw(self.robot, plan, 1 / task.control_frequency, self.settings)

    def _plan(self, task: Task) -> PlannedMotion | str:
        """The motion for the largest possible payload, or the reason why there is no plan."""
        intervals = math.ceil(INTERVALS_PER_SECOND * task.trajectory.duration)
        try:
            plan = plan_motion(
                self.robot,
                task.trajectory,
                task.error_bounds,
                intervals=min(max(MINIMUM_INTERVALS, intervals), MAXIMUM_INTERVALS),
                margins=self.settings.margins(self.robot, task.error_bounds),
                lightest=-self.settings.mass_deficit * self.robot.mass,
                period=1 / task.control_frequency,
            )
        except Infeasible as error:
            _LOGGER.debug("no plan for %r: %s", task.trajectory.name, error)
            return f"trajectory {task.trajectory.name!r} has no feasible motion within the error bounds"
        if plan.payload <= 0:
            return f"trajectory {task.trajectory.name!r} allows no payload"
        return plan

    def _fall_back(self, episodes: int, reason: str) -> Adaptive:
        self.fallbacks += episodes
        _LOGGER.warning(
            "trajopt tracks the reference without a plan in %d episodes: %s", episodes, reason
        )
        return self._reference_law

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions (m,) or (N, m), and the state to pass next time.

        Raises:
            ValueError: if the observation does not have this robot's layout.
        """
        observation = np.asarray(observation, float)
        count = len(np.atleast_2d(observation))
        groups = self._groups
        if groups is None or (len(groups) > 1 and sum(len(rows) for rows, _ in groups) != count):
            if state is None:
                self._fall_back(
                    count, "the tasks of the batch are unknown; call reset(tasks) before predict()"
                )
            return self._reference_law.predict(observation, state, episode_start, deterministic)
        if len(groups) == 1:
            return groups[0][1].predict(observation, state, episode_start, deterministic)
        actions = np.empty((count, self.robot.cables))
        states = []
        starts = first_steps(state, episode_start, (count,))
        states_before = state or (None,) * len(groups)
        for (rows, law), before in zip(groups, states_before, strict=True):
            actions[rows], after = law.predict(
                observation[rows], before, starts[rows], deterministic
            )
            states.append(after)
        return actions, tuple(states)


def make_trajopt(robot: Robot) -> TrajOpt:
    """Makes the policy ``trajopt``."""
    return TrajOpt(robot, TRAJOPT_SETTINGS[robot.joints])


def make_trajopt_margin(robot: Robot) -> TrajOpt:
    """Makes the policy ``trajopt-margin``."""
    return TrajOpt(robot, TRAJOPT_MARGIN_SETTINGS[robot.joints])


TRAJOPT = entry("trajopt", make_trajopt)
TRAJOPT_MARGIN = entry("trajopt-margin", make_trajopt_margin)
