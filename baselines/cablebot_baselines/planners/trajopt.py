"""Policy that plans a motion within the error bounds for each task and then tracks it."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.entries import entry
from cablebot_baselines.episodes import first_steps
from cablebot_baselines.laws.adaptive import make_adaptive
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.observer_law import UNCERTAINTY, ObserverLaw
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.planners.plan_law import AdaptivePlanLaw, PlanLaw
from cablebot_baselines.planners.rehearsed import (
    OPTIMAL,
    Planner,
    largest_tension_margin,
    tracking_law,
)
from cablebot_gym.motions import Trajectory
from cablebot_gym.planning import Infeasible, Margins, PlannedMotion
from cablebot_gym.planning.stage_functions import check_model, import_casadi
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, Task
from cablebot_gym.uncertainty import find_uncertainty

_LOGGER = logging.getLogger("cablebot_gym")

ERROR_MARGIN = 0.02
"""Margin of the plan for an exactly known robot to its error bounds, as a fraction of them."""

EXACT_MARGINS = {
    "rigid": Margins(action=0.005, tension=1.0),
    "flexible": Margins(action=0.01, tension=3.0),
}
"""Further margins of the plan for an exactly known robot, by its joints."""

EXACT_GAINS = {"rigid": (2500.0, 100.0), "flexible": (100.0, 10.0)}
"""(K_P, K_D) of the law that tracks it [1/s², 1/s], by joints of the robot."""

EXACT_RESERVE = {"rigid": 1.0, "flexible": 3.0}
"""Tension of redundant cables above the minimum tension of the robot [N], by its joints."""


def exact_margins(robot: Robot, error_bounds: ErrorBounds) -> Margins:
    """Margins of the plan for an exactly known robot.

    When a motor reverses, its friction changes sign within a control period. Without springs this
    changes the tension of its cable, so the margin includes Coulomb friction.
    """
    margins = EXACT_MARGINS[robot.joints]
    tension = margins.tension
    if not robot.flexible:
        tension += float((robot.coulomb_friction / robot.pulley_radius).max())
    return replace(
        margins,
        position=ERROR_MARGIN * error_bounds.position,
        rotation=ERROR_MARGIN * error_bounds.rotation,
        tension=min(tension, largest_tension_margin(robot)),
    )


class TrajOpt:
    """Plans motions per task for the largest possible payload, and tracks them with the actual
    payload.

    A plan begins at the start pose of the task and includes its dwells. It is feasible with its
    largest payload and without payload, and therefore with every payload in between. There are two
    of them:

    * The rehearsed plan is for robots that are not exactly known: its margins follow from episodes
      with random robots (:mod:`~cablebot_baselines.planners.rehearsed`), and it is tracked with an
      observer of mass, motors and delay. It serves unknown payloads, and known ones up to its own.
    * The exact plan is for a known payload that is heavier than that. It hardly has margins, and
      only the mass is estimated while it is tracked.

    The first planning of a task takes seconds to minutes. The plan is then stored on disk.

    Without a plan, the policy tracks the reference itself with the adaptive law. :attr:`fallbacks`
    counts these episodes, and a warning gives the reason.

    Args:
        robot: nominal robot.
        planner: how plans are made.

    Raises:
        ValueError: if the motors of the robot have a lag.
    """

    unsaturated_actions = False

    def __init__(self, robot: Robot, planner: Planner = OPTIMAL) -> None:
        check_model(robot)
        self.robot = robot
        self.planner = planner
        self.fallbacks = 0
        """Number of episodes without a plan since the last :meth:`reset`."""
        # Environments with the same plan and their law.
        self._groups: list[tuple[NDArray[np.intp], ClassicalLaw]] = []
        self._laws: dict[Any, tuple[Trajectory, ClassicalLaw | None]] = {}
        self._reference_law = make_adaptive(robot)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Plans the motions of each different task.

        Raises:
            ValueError: if a task's robot differs from the policy's robot in kind or anchors.
        """
        self._reference_law.reset(tasks)
        groups: dict[int, tuple[ClassicalLaw, list[int]]] = {}
        without_plan: Counter[str] = Counter()
        for env_index, task in enumerate(tasks):
            law = self._law(task)
            if law is None:
                without_plan[task.trajectory.name] += 1
                law = self._reference_law
            _, indices = groups.setdefault(id(law), (law, []))
            indices.append(env_index)
        for name, episodes in without_plan.items():
            _LOGGER.warning(
                "%s tracks trajectory %r without a plan in %d episodes: no motion within the "
                "error bounds is feasible with a payload",
                self.planner.name,
                name,
                episodes,
            )
        self.fallbacks = without_plan.total()
        self._groups = [(np.array(indices), law) for law, indices in groups.values()]

    def _law(self, task: Task) -> ClassicalLaw | None:
        """The law of a task's episode with the rehearsed plan or the exact one; None if there is no
        plan."""
        rehearsed = self._stored(self._rehearsed_law, task)
        if isinstance(rehearsed, ObserverLaw):
            assert rehearsed.largest_payload is not None
            is_light = task.model_payload <= rehearsed.largest_payload
            if is_light or not task.payload_known:
                return rehearsed
        return self._stored(self._exact_law, task)

    def _stored(
        self, make: Callable[[Task], tuple[PlannedMotion, ClassicalLaw]], task: Task
    ) -> ClassicalLaw | None:
        """The law that a function makes for a plan; None if there is no plan. It is made once."""
        motion: Any = task.trajectory
        if not isinstance(motion, Hashable):
            motion = id(motion)  # a trajectory that is not hashable is equal only to itself
        key = (make.__name__, motion, task.error_bounds, task.control_frequency, task.cable)
        if key not in self._laws:
            law = None
            with suppress(Infeasible):
                plan, tracking = make(task)
                if plan.payload > 0:
                    law = tracking
            # Stores the trajectory, too: its id may be part of the key, so it must stay alive.
            self._laws[key] = task.trajectory, law
        return self._laws[key][1]

    def _rehearsed_law(self, task: Task) -> tuple[PlannedMotion, ClassicalLaw]:
        """The plan for robots that are not exactly known, and its law."""
        uncertainty = find_uncertainty(UNCERTAINTY, self.robot)
        plan = self.planner.rehearsed(replace(task, robot=self.robot), uncertainty)
        return plan, tracking_law(plan, Expectation.of(self.robot, uncertainty), task)

    def _exact_law(self, task: Task) -> tuple[PlannedMotion, ClassicalLaw]:
        """The plan for an exactly known robot, and its law."""
        margins = exact_margins(self.robot, task.error_bounds)

        def make() -> PlannedMotion:
            return self.planner.first(self.robot, task, margins, 0.0, final=True)[1]

        plan = self.planner.cached(replace(task, robot=self.robot), make, margins=margins)
        joints = self.robot.joints
        tracking = PlanLaw(
            self.robot,
            plan,
            1 / task.control_frequency,
            gains=EXACT_GAINS[joints],
            reserve=EXACT_RESERVE[joints],
        )
        return plan, AdaptivePlanLaw(tracking, plan)

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions (m,) or (N, m), and the state to pass next time.

        Raises:
            RuntimeError: before the first :meth:`reset`.
            ValueError: if the observation does not have this robot's layout.
        """
        groups = self._groups
        if not groups:
            raise RuntimeError("call reset(tasks) before predict(): the tasks have the motions")
        if len(groups) == 1:
            return groups[0][1].predict(observation, state, episode_start, deterministic)
        observation = np.asarray(observation, float)
        count = len(observation)
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
    """The policy with trajectory optimisation for a nominal robot.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: as :class:`TrajOpt`.
    """
    import_casadi()
    return TrajOpt(robot)


TRAJOPT = entry("trajopt", make_trajopt)
