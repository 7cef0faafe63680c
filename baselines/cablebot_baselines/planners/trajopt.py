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
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.observer_law import UNCERTAINTY
from cablebot_baselines.laws.observing import Observing
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.planners.plan_law import PlanLaw
from cablebot_baselines.planners.rehearsed import (
    OPTIMAL,
    Planner,
    largest_tension_margin,
    replayed_plan,
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
    * The exact plan is for a known payload that is heavier than that. It hardly has margins, but
      where a replay exceeds a limit, and is tracked with that payload.

    The first planning of a task takes seconds to minutes. The plan is then stored on disk.

    Without a plan, the policy tracks the reference itself as ``observing`` does. :attr:`fallbacks`
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
        # The laws, and the rows of a batch in which each acts.
        self._laws: list[tuple[NDArray[np.intp], ClassicalLaw]] = []
        self._plans: dict[Any, tuple[Trajectory, PlannedMotion | None]] = {}
        self._expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
        self._reference_law = Observing(robot)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Plans the motions of each different task.

        Raises:
            ValueError: if a task's robot differs from the policy's robot in kind or anchors.
        """
        self._reference_law.reset(tasks)  # before a plan takes time
        self._rehearse(tasks)
        rows: dict[Callable[..., ClassicalLaw], list[int]] = {}
        plans = []
        for row, task in enumerate(tasks):
            make, plan = self._planned(task)
            rows.setdefault(make, []).append(row)
            plans.append(plan)
        self._laws = []
        for make, of_law in rows.items():
            law = make([plans[row] for row in of_law], [tasks[row] for row in of_law])
            self._laws.append((np.array(of_law), law))
        without_plan = Counter(tasks[row].trajectory.name for row in rows.get(self._without, []))
        for name, episodes in without_plan.items():
            _LOGGER.warning(
                "%s tracks trajectory %r without a plan in %d episodes: no motion within the "
                "error bounds is feasible with a payload",
                self.planner.name,
                name,
                episodes,
            )
        self.fallbacks = without_plan.total()

    def _planned(self, task: Task) -> tuple[Callable[..., ClassicalLaw], PlannedMotion | None]:
        """The function that makes the law for a task, and the plan that it tracks."""
        _, plan = self._plans[self._key("rehearsed", task)]
        if plan is not None and (not task.payload_known or task.model_payload <= plan.payload):
            return self._rehearsed, plan
        if not task.payload_known:
            return self._without, None
        key = self._key("exact", task)
        if key not in self._plans:
            plan = None
            with suppress(Infeasible):
                plan = self._exact_plan(task)
            self._keep(key, task, plan)
        _, plan = self._plans[key]
        if plan is not None:
            return self._exact, plan
        return self._without, None

    def _rehearse(self, tasks: Sequence[Task]) -> None:
        """Makes the rehearsed plans of all tasks that have none yet."""
        new = {}
        for task in tasks:
            key = self._key("rehearsed", task)
            if key not in self._plans:
                new[key] = replace(task, robot=self.robot)
        uncertainty = find_uncertainty(UNCERTAINTY, self.robot)
        groups: dict[Any, list[Any]] = {}
        for key in new:
            _, _, *alike = key
            groups.setdefault(tuple(alike), []).append(key)
        for keys in groups.values():
            of_group = [new[key] for key in keys]
            plans = self.planner.rehearsed(of_group, uncertainty)
            for key, task, plan in zip(keys, of_group, plans, strict=True):
                self._keep(key, task, plan)

    def _key(self, kind: str, task: Task) -> tuple[Any, ...]:
        """Key of a plan: its kind, the motion, and the rest of the task."""
        motion: Any = task.trajectory
        if not isinstance(motion, Hashable):
            motion = id(motion)  # a trajectory that is not hashable is equal only to itself
        return kind, motion, task.error_bounds, task.control_frequency, task.cable

    def _keep(self, key: tuple[Any, ...], task: Task, plan: PlannedMotion | None) -> None:
        if plan is not None and plan.payload <= 0:
            plan = None
        # Stores the trajectory, too: its id may be part of the key, so it must stay alive.
        self._plans[key] = task.trajectory, plan

    def _exact_plan(self, task: Task) -> PlannedMotion:
        """The plan for an exactly known robot."""
        margins = exact_margins(self.robot, task.error_bounds)
        nominal = replace(task, robot=self.robot)

        def make() -> PlannedMotion:
            program, _ = self.planner.first(self.robot, nominal, margins, 0.0)
            return replayed_plan(program, margins, nominal, self._exact)

        return self.planner.cached(nominal, make, margins=margins)

    def _rehearsed(self, plans: Sequence[PlannedMotion], tasks: Sequence[Task]) -> ClassicalLaw:
        return tracking_law(plans, self._expectation, tasks)

    def _exact(self, plans: Sequence[PlannedMotion], tasks: Sequence[Task]) -> ClassicalLaw:
        joints = self.robot.joints
        law = PlanLaw(
            self.robot,
            plans,
            1 / tasks[0].control_frequency,
            gains=EXACT_GAINS[joints],
            reserve=EXACT_RESERVE[joints],
        )
        law.reset(tasks)
        return law

    def _without(self, plans: Sequence[None], tasks: Sequence[Task]) -> ClassicalLaw:
        self._reference_law.reset(tasks)
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
            RuntimeError: before the first :meth:`reset`.
            ValueError: if the observation does not have this robot's layout.
        """
        laws = self._laws
        if not laws:
            raise RuntimeError("call reset(tasks) before predict(): the tasks have the motions")
        if len(laws) == 1:
            return laws[0][1].predict(observation, state, episode_start, deterministic)
        observation = np.asarray(observation, float)
        count = len(observation)
        actions = np.empty((count, self.robot.cables))
        states = []
        starts = first_steps(state, episode_start, (count,))
        states_before = state or (None,) * len(laws)
        for (rows, law), before in zip(laws, states_before, strict=True):
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
