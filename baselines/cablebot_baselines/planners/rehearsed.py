"""Plans for robots that are not exactly known: rehearsed on random robots until all of them carry the
payload."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from cablebot_baselines.laws.law import ClassicalLaw
from cablebot_baselines.laws.observer_law import Instant, ObserverLaw
from cablebot_baselines.laws.outer_loop import by_kind
from cablebot_baselines.laws.robust_design import RobustDesign
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.planners.plan_law import PlanLaw
from cablebot_baselines.planners.rehearsal import (
    ROBOTS,
    Rehearsal,
    grown_margins,
    keeps_least_tension,
    rehearse,
    spread_margins,
)
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.planning import (
    Infeasible,
    MarginProfile,
    Margins,
    MotionProgram,
    PlannedMotion,
)
from cablebot_gym.planning.library import cached_plan, stored_plan
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, Task
from cablebot_gym.uncertainty import Uncertainty

INTERVALS_PER_SECOND = {"rigid": 36.0, "flexible": 30.0}
"""Spline intervals of a plan per second [1/s], by joints of the robot. More of them hardly increase
the DLCC and take longer to plan: minutes with joint springs."""

MINIMUM_INTERVALS, MAXIMUM_INTERVALS = 20, 80
"""Minimum and maximum number of spline intervals of a plan."""

COARSE = 1.5
"""How many times fewer intervals the first plan of a flexible robot has. It takes the second one of
two payloads as a start."""

GAINS = {
    "planar": (1600.0, 80.0),
    "planar-platform": (8100.0, 180.0),
    "spatial": (400.0, 40.0),
}
"""(K_P, K_D) by kind of a rigid robot [1/s², 1/s]; other kinds have those of ``spatial``. Higher ones
amplify the noise of the sensors, in proportion to the mass; lower ones leave light platforms to the
errors of the motors."""

SPRING_RATIO = 1.75
"""Largest Ω of the gains of a flexible robot, which are at most those of ``spatial``, in units of that
of :class:`~cablebot_baselines.laws.robust_design.RobustDesign`. Soft springs resonate with more."""

SENSOR_BIASES = 4.5
"""Margin to the error bounds of the first plan in standard deviations of the bias of the sensors."""

FIRST_MARGINS = Margins(position=0.04, rotation=0.04, action=0.04, tension=3.0)
"""Further margins of the first plan; those to the error bounds are fractions of them."""

LEAST_MARGINS = Margins(position=0.01, rotation=0.01, action=0.005, tension=1.0)
"""Least margins of all plans; those to the error bounds are fractions of them."""

SPRING_RESERVE = 0.9
"""Largest margin to the minimum tension of the first plan of springs, as a fraction of that at the
start."""

SPRING_RATE = 100.0
"""How fast the margin to the minimum tension of springs may grow from that at the start [N/s]."""

LIGHTEST = 2.0
"""How many standard deviations the lightest platform of a plan is below the expected one."""

FRACTIONS = (0.0, 0.94, 1.0)
"""Rehearsed payloads as fractions of that of the plan."""

REPLAYS = 16
"""Number of replayed payloads of the plan for an exactly known robot."""

ROUNDS = 3
"""Largest number of plans after the first one."""

TOGETHER = 8
"""Largest number of motions that are planned and rehearsed together: their programs take memory."""


def intervals_of(robot: Robot, trajectory: Trajectory) -> int:
    """Number of spline intervals of the plans for a motion."""
    count = math.ceil(INTERVALS_PER_SECOND[robot.joints] * trajectory.duration)
    return min(max(MINIMUM_INTERVALS, count), MAXIMUM_INTERVALS)


class PlanProgram(Protocol):
    """Plans the same motion again, with other margins."""

    def resolve(self, margins: Margins, profile: MarginProfile | None = None) -> PlannedMotion:
        """The plan with constant margins and margins over time in addition.

        Raises:
            Infeasible: if there is none.
        """


class FirstPlan(Protocol):
    """Makes a program and its first plan."""

    def __call__(
        self, robot: Robot, task: Task, margins: Margins, lightest: float
    ) -> tuple[PlanProgram, PlannedMotion]:
        """The program of a robot and a task, and its plan with some margins, which is feasible from a
        lightest payload [kg] to its own.

        Raises:
            Infeasible: if there is none.
        """


@dataclass(frozen=True, kw_only=True)
class Planner:
    """How plans are made."""

    name: str
    """Name of the policy."""
    first: FirstPlan
    """Makes the first plan."""
    module: str
    """Module of ``first``; a change of its code makes cached plans again."""
    key: str = ""
    """Further data on which the plans depend, such as the hash of weights."""

    def cached(self, task: Task, make: Callable[[], PlannedMotion], **more: Any) -> PlannedMotion:
        """The cached plan of a task, which also depends on ``more``."""
        keywords = self._keywords(task) | more
        return cached_plan(self.module, task.robot, task.trajectory, make, **keywords)

    def _keywords(self, task: Task) -> dict[str, Any]:
        """Data on which a cached plan depends."""
        return {
            "error_bounds": task.error_bounds,
            "control_frequency": task.control_frequency,
            "cable": task.cable,
            "planner": (self.name, self.key),
        }

    def rehearsed(
        self, tasks: Sequence[Task], uncertainty: Uncertainty
    ) -> list[PlannedMotion | None]:
        """The plan of each task that carries most on the random robots of an uncertainty, with unknown
        payload; None where there is none. The tasks differ in their motions alone."""
        plans: list[PlannedMotion | None] = []
        searches = {}
        more = {"uncertainty": repr(uncertainty)}
        for index, task in enumerate(tasks):
            keywords = self._keywords(task) | more
            plans.append(stored_plan(self.module, task.robot, task.trajectory, **keywords))
            if plans[index] is None:
                unknown = replace(task, payload_known=False, model_payload=0.0)
                searches[index] = PlanSearch(self, unknown, uncertainty)
        missing = list(searches)
        for start in range(0, len(missing), TOGETHER):
            some = missing[start : start + TOGETHER]
            found = find_plans([searches[index] for index in some])
            for index, plan in zip(some, found, strict=True):
                plans[index] = plan
                if plan is not None:
                    self.cached(tasks[index], _given(plan), **more)
        return plans


def _given(plan: PlannedMotion) -> Callable[[], PlannedMotion]:
    return lambda: plan


def first_optimum(
    robot: Robot, task: Task, margins: Margins, lightest: float
) -> tuple[MotionProgram, PlannedMotion]:
    """The nonlinear program, and its solution.

    Raises:
        Infeasible: if there is no motion within the limits.
    """
    settings: dict[str, Any] = {"margins": margins, "period": 1 / task.control_frequency}
    motion = (robot, task.trajectory, task.error_bounds)
    intervals = intervals_of(robot, task.trajectory)
    program = MotionProgram(*motion, intervals=intervals, lightest=lightest, **settings)
    if not robot.flexible:
        return program, program.solve()
    few = max(MINIMUM_INTERVALS, round(intervals / COARSE))
    start = MotionProgram(*motion, intervals=few, **settings).solve()
    try:
        return program, program.solve(start, near=True)
    except Infeasible:
        return program, program.solve(start)


OPTIMAL = Planner(name="trajopt", first=first_optimum, module=__name__)
"""Plans by trajectory optimisation."""


def replayed_plan(
    program: PlanProgram,
    margins: Margins,
    task: Task,
    make_law: Callable[[Sequence[PlannedMotion], Sequence[Task]], ClassicalLaw],
) -> PlannedMotion:
    """The plan for an exactly known robot. Its margins grow at the times at which a replay exceeds a
    limit, between the instants of the program or by the error of the law.

    Args:
        program: makes the plans.
        margins: constant margins.
        task: the task, with a known payload.
        make_law: makes the law that tracks the plan.

    Raises:
        Infeasible: if there is no plan with these margins.
    """
    plan = best = program.resolve(margins)
    most = -1.0
    profile = None
    with suppress(Infeasible):
        for _ in range(ROUNDS):
            payloads = np.linspace(0.0, plan.payload, REPLAYS).tolist()
            law = make_law([plan], [task])
            (replay,) = rehearse(law, [task], Uncertainty(), [payloads], robots=1)
            carried = replay.largest_carried(reserved=False)
            if carried > most:
                most, best = carried, plan
            if carried >= plan.payload:
                break
            if profile is None:
                profile = MarginProfile.zeros(replay.times, task.robot.cables)
            profile = grown_margins(profile, replay)
            plan = program.resolve(margins, profile)
    return best


def tracking_law(
    plans: Sequence[PlannedMotion], expectation: Expectation, tasks: Sequence[Task]
) -> ObserverLaw:
    """The law that tracks plans on robots that are not exactly known.

    Args:
        plans: plan of each row of a batch, or one for all.
        expectation: what is expected of the robot.
        tasks: tasks of the plans.
    """
    robot = expectation.robot
    period = 1 / tasks[0].control_frequency
    gains = by_kind(GAINS, robot)
    if robot.flexible:
        largest = math.sqrt(GAINS["spatial"][0])
        stiffness = min(largest, SPRING_RATIO * RobustDesign.usual(expectation, tasks[0]).stiffness)
        gains = stiffness**2, 2 * stiffness
    tracking = PlanLaw(robot, plans, period, gains=gains)
    law = _Tracking(tracking, expectation, largest_payload=tracking.plan.payload)
    law.reset(tasks)
    return law


class _Tracking(ObserverLaw):
    """A law that tracks its own plans, which the references of the tasks do not concern."""

    def reference(self, instant: Instant, memory: Any) -> tuple[dict[str, Array], Any]:
        """No blocks: the law reads the time to go."""
        return {}, None


@dataclass(frozen=True, kw_only=True)
class RehearsalQuestion:
    """What a search wants to be rehearsed."""

    plan: PlannedMotion
    """The plan."""
    fractions: tuple[float, ...]
    """Payloads as fractions of that of the plan."""

    @property
    def payloads(self) -> list[float]:
        """Payloads [kg]."""
        return [fraction * self.plan.payload for fraction in self.fractions]


class PlanSearch:
    """Search for the plan that carries most on random robots.

    The first plan has margins for the bias of the sensors. A rehearsal gives the spread of the
    robots about it, and thus margins over time. Each further plan is rehearsed too, until all
    robots carry its payload: margins grow at the times at which robots exceed a limit.

    Args:
        planner: how plans are made.
        task: the task, with an unknown payload.
        uncertainty: the uncertainty.
    """

    def __init__(self, planner: Planner, task: Task, uncertainty: Uncertainty) -> None:
        self._planner = planner
        self.task = task
        """The task."""
        self.uncertainty = uncertainty
        """The uncertainty."""
        self.expectation = Expectation.of(task.robot, uncertainty)
        """What is expected of the robot."""

    def run(self) -> Generator[RehearsalQuestion, Rehearsal, PlannedMotion]:
        """The plan, after the rehearsals for which the generator asks.

        Raises:
            Infeasible: if there is no motion within the error bounds for the expected robot, or the
                random robots fail unloaded.
        """
        lightest = -LIGHTEST * self.expectation.mass_spread
        margins = self._margins(self._first_margins, biases=SENSOR_BIASES)
        robot = self.expectation.robot
        program, plan = self._planner.first(robot, self.task, margins, lightest)
        rehearsal = yield RehearsalQuestion(plan=plan, fractions=(0.0, 1.0))
        profile = self._startable(spread_margins(rehearsal, plan))
        most, best = _carried(rehearsal), plan
        for _ in range(ROUNDS):
            try:
                plan = program.resolve(*self._split(profile))
            except Infeasible:
                profile = profile.scaled(0.5)
                continue
            rehearsal = yield RehearsalQuestion(plan=plan, fractions=FRACTIONS)
            carried = _carried(rehearsal)
            if carried > most:
                most, best = carried, plan
            if carried[0] >= plan.payload:
                break
            profile = self._startable(grown_margins(profile, rehearsal))
        if most[1] < 0:
            raise Infeasible("the random robots carry none of the plans")
        return best

    @property
    def _first_margins(self) -> Margins:
        """Margins of the first plan. The law of a rigid robot with redundant cables can keep the least
        tension of ``observing``; with less, cables would go slack in the first rehearsal."""
        robot = self.expectation.robot
        if not keeps_least_tension(robot):
            return FIRST_MARGINS
        least = RobustDesign.usual(self.expectation, self.task).minimum_tension
        return replace(FIRST_MARGINS, tension=least - robot.minimum_tension)

    def _margins(self, margins: Margins, biases: float = 0.0) -> Margins:
        """Margins in SI units, with a number of standard deviations of the sensors' bias."""
        bounds: ErrorBounds = self.task.error_bounds
        robot = self.expectation.robot
        position = margins.position * bounds.position
        rotation = margins.rotation * bounds.rotation
        bias = self.uncertainty.sensor_bias
        if bias is not None:
            position += min(biases * bias.position, bounds.position / 4)
            rotation += min(biases * bias.rotation, bounds.rotation / 4)
        tension = min(margins.tension, largest_tension_margin(robot))
        return replace(margins, position=position, rotation=rotation, tension=tension)

    def _split(self, profile: MarginProfile) -> tuple[Margins, MarginProfile]:
        """Constant margins, and those over time in addition."""
        margins = self._margins(LEAST_MARGINS)
        robot = self.expectation.robot
        if keeps_least_tension(robot):
            tension = margins.tension + profile.tension.max()
            tension = min(float(tension), largest_tension_margin(robot))
            margins = replace(margins, tension=tension)
            profile = replace(profile, tension=np.zeros_like(profile.tension))
        return margins, profile

    def _startable(self, profile: MarginProfile) -> MarginProfile:
        """A profile without margins at the start that the springs cannot keep there."""
        robot = self.expectation.robot
        is_stretched = robot.cables == robot.coordinates and not robot.weightless
        if not robot.flexible or is_stretched:  # by the weight of the platform
            return profile
        least = self._margins(LEAST_MARGINS).tension
        ceiling = np.maximum(SPRING_RESERVE * _reserve(robot) - least, 0.0)
        ceiling = ceiling + SPRING_RATE * profile.times
        return replace(profile, tension=np.minimum(profile.tension, ceiling))


def _carried(rehearsal: Rehearsal) -> tuple[float, float]:
    """Largest payload that all robots carry with the reserves, and without them [kg]: a plan that
    misses the reserves is better than none."""
    return rehearsal.largest_carried(), rehearsal.largest_carried(reserved=False)


def find_plans(searches: Sequence[PlanSearch]) -> list[PlannedMotion | None]:
    """The plans of some searches, which share their rehearsals; None where there is none. Their tasks
    differ in their motions alone."""
    plans: list[PlannedMotion | None] = [None] * len(searches)
    runs = {index: search.run() for index, search in enumerate(searches)}
    answers: dict[int, Any] = dict.fromkeys(runs)
    while runs:
        questions = {}
        for index, run in list(runs.items()):
            try:
                questions[index] = run.send(answers[index])
            except (StopIteration, Infeasible) as end:
                plans[index] = getattr(end, "value", None)
                del runs[index]
        asking = [searches[index] for index in questions]
        rehearsals = _rehearsed(asking, list(questions.values()))
        answers = dict(zip(questions, rehearsals, strict=True))
    return plans


def _rehearsed(
    searches: Sequence[PlanSearch], questions: Sequence[RehearsalQuestion]
) -> list[Rehearsal]:
    """The rehearsals that some searches ask for."""
    if not searches:
        return []
    plans: list[PlannedMotion] = []
    tasks: list[Task] = []
    for search, question in zip(searches, questions, strict=True):
        rows = ROBOTS * len(question.fractions)
        plans += [question.plan] * rows
        tasks += [search.task] * rows
    first = searches[0]
    law = tracking_law(plans, first.expectation, tasks)
    return rehearse(
        law,
        [search.task for search in searches],
        first.uncertainty,
        [question.payloads for question in questions],
    )


def largest_tension_margin(robot: Robot) -> float:
    """Largest constant margin of a plan to the minimum and the maximum tension [N]: half of the
    tensions between them remain. The springs can have it at the start, too."""
    largest = (robot.maximum_tension - robot.minimum_tension) / 4
    if robot.flexible:
        largest = min(largest, SPRING_RESERVE * _reserve(robot))
    return largest


def _reserve(robot: Robot) -> float:
    """Margin of the springs at the start to the minimum tension [N]."""
    return textbook.allocated_minimum(robot) - robot.minimum_tension
