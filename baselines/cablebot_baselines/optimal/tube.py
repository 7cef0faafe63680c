"""A policy that plans a motion inside the tube once for each task, and then follows it."""

from __future__ import annotations

import logging
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.adaptive import ADAPTIVE_GAINS, Adaptive, Memory
from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flexible import composite_tuned
from cablebot_baselines.classical.law import Array, ClassicalLaw, first_steps
from cablebot_gym.envs import ENV_IDS
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Follower, Infeasible, Margins, PlannedMotion, State, planned
from cablebot_gym.planning.stage_functions import import_casadi
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits, Task
from cablebot_gym.trajectories import Trajectory

_LOGGER = logging.getLogger("cablebot_gym")

INTERVALS = 50.0
"""Of a plan's splines, per second; twice as many carry 0.3 % more and take three times as long to plan."""

MINIMUM_INTERVALS = 20
"""Of a plan for a short motion."""

WEIGHING = 0.05
"""For how long the platform has to be weighed in motion until that counts as much as its weight at the start [s]."""


@dataclass(frozen=True, kw_only=True)
class Style:
    """How near to the limits a plan comes, and how stiffly it is followed."""

    share: float
    """Of the bounds of position and rotation that the plan leaves unused."""
    demand: float
    """Of the drive commands' ±1 that it leaves unused."""
    tension: float
    """Least tension [N]."""
    gains: tuple[float, float]
    """(K_P, K_D) on the platform's error [1/s², 1/s]."""
    prior: float
    """Weight of the told mass [s], see :class:`~cablebot_baselines.classical.adaptive.Adaptive`."""
    motor_frequency: float = 100.0
    """Of the motor loop of a flexible robot [rad/s]."""
    lighter: float = 0.0
    """By how much of itself the platform may be lighter than told."""

    def margins(self, limits: Limits) -> Margins:
        """What the plan leaves unused."""
        position, rotation = self.share * limits.position, self.share * limits.rotation
        return Margins(position=position, rotation=rotation, demand=self.demand, tension=self.tension)


CLOSE = {
    "rigid": Style(share=0.02, demand=0.005, tension=2.0, gains=(2500.0, 100.0), prior=1e-4),
    "flexible": Style(share=0.02, demand=0.01, tension=4.0, gains=(100.0, 10.0), prior=1e-4),
}
"""Near to the limits, for a robot that is as told but for its payload."""

SAFE = {
    "rigid": Style(share=0.2, demand=0.02, tension=5.0, gains=(400.0, 40.0), prior=2e-3, lighter=0.15),
    "flexible": Style(share=0.35, demand=0.03, tension=4.5, gains=(200.0, 20.0), prior=2e-3, lighter=0.15),
}
"""With room for noise and for a robot that is not quite as told."""


class PlanLaw(ClassicalLaw):
    """Follows one planned motion with a believed mass.

    Args:
        robot: nominal robot.
        plan: the motion.
        period: control period [s].
        style: how to follow it.
    """

    def __init__(self, robot: Robot, plan: PlannedMotion, period: float, style: Style) -> None:
        super().__init__(robot, minimum_tension=style.tension)
        self._follower = Follower(robot=robot, gains=style.gains, motor_frequency=style.motor_frequency)
        self._plan, self._period = plan, period

    def torques(self, part: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Torques that the law asks for [N·m], and motor speeds [rad/s], each (..., m)."""
        plan = self._plan
        state = State.of(part, plan.duration - part["time_left"][..., 0])
        return self._follower.torques(plan, state, mass - self.robot.mass, self._period)

    @property
    def turning_inertia(self) -> Array:
        """J, or J + J′ of a flexible robot [kg·m²], (m,)."""
        robot = self.robot
        return robot.pulley_inertia + robot.motor_inertia if robot.flexible else robot.pulley_inertia


class AdaptivePlanLaw(Adaptive):
    """Follows one planned motion, and weighs its payload by the plan's acceleration.

    The plan falls into its sag at half of g and more: weighed by the reference's acceleration, which knows nothing of
    it, the little that is left of the weight would count too much.

    Args:
        robot: nominal robot.
        plan: the motion.
        period: control period [s].
        style: how to follow it.
    """

    def __init__(self, robot: Robot, plan: PlannedMotion, period: float, style: Style) -> None:
        super().__init__(PlanLaw(robot, plan, period, style), prior=style.prior)
        self._plan = plan

    def respond(self, part: dict[str, Array], state: Any = None, episode_start: Any = None) -> tuple[Array, Any]:
        """Drive commands from the blocks of an observation, whose reference becomes the plan."""
        motion = self._plan(self._plan.duration - part["time_left"][..., 0])
        planned = {
            "reference_pose": motion.position,
            "reference_velocity": motion.velocity,
            "reference_acceleration": motion.acceleration,
        }
        return super().respond(part | planned, state, episode_start)

    def _weighed(self, part: dict[str, Array], before: Memory | None, episode_start: Any) -> Memory:
        """An episode of a robot with springs starts at rest on them: the first look weighs it."""
        memory, robot = super()._weighed(part, before, episode_start), self.robot
        if not robot.flexible or robot.planar:
            return memory
        first = first_steps(before, episode_start, part["pose"].shape[:-1])[..., None]
        wrench = (
            np.swapaxes(textbook.jacobian(robot, part["pose"]), -1, -2)
            @ (memory.torques / robot.pulley_radius)[..., None]
        )
        weight = WEIGHING * robot.gravity
        return replace(
            memory,
            impulse=np.where(first, weight * wrench[..., 2, :], memory.impulse),
            change=np.where(first, weight * robot.gravity, memory.change),
        )


@dataclass(frozen=True, kw_only=True)
class _Group:
    """Episodes of a batch with the same task, and the law that runs them."""

    lanes: NDArray[np.intp]
    law: Adaptive


class Tube:
    """Plans the heaviest payload's motion once per task (the rated payload), and follows it with whatever is carried.

    The plan is possible with that payload and without any, and so with every one in between. It is followed by the
    plant's law on an estimate of the mass, told or not (:class:`~cablebot_baselines.classical.adaptive.Adaptive`), so that a
    wrong payload is soon a right one. Planning takes seconds the first time and is then kept on disk.

    Where no plan can be made, or :meth:`begin` has told nothing, episodes fall back on the adaptive law on the
    reference itself; ``fallbacks`` counts them and a warning says why.

    Args:
        robot: nominal robot.
        style: margins and gains for this kind of robot.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
    """

    unclipped = False

    def __init__(self, robot: Robot, style: Style) -> None:
        import_casadi()
        self.robot, self.style = robot, style
        self.fallbacks = 0
        """Episodes since the last :meth:`begin` that follow no plan."""
        self._groups: tuple[_Group, ...] | None = None
        self._plans: dict[Any, tuple[Trajectory, PlannedMotion | str]] = {}
        self._reference_law = _reference_law(robot)

    def begin(self, tasks: Sequence[Task]) -> None:
        """Plans.

        Raises:
            ValueError: if a task's robot is of another kind, or has other anchors.
        """
        self._reference_law.begin(tasks)
        self.fallbacks = 0
        alike: dict[Any, list[int]] = {}
        for lane, task in enumerate(tasks):
            alike.setdefault(_case(task), []).append(lane)
        self._groups = tuple(
            _Group(lanes=np.array(lanes), law=self._law(tasks[lanes[0]], len(lanes))) for lanes in alike.values()
        )

    def _law(self, task: Task, episodes: int) -> Adaptive:
        key = _case(task)
        if key not in self._plans:
            self._plans[key] = task.trajectory, self._plan(task)  # the object lives as long as its identity counts
        plan = self._plans[key][1]
        if isinstance(plan, str):
            return self._fall_back(episodes, plan)
        return AdaptivePlanLaw(self.robot, plan, 1 / task.control_frequency, self.style)

    def _plan(self, task: Task) -> PlannedMotion | str:
        """The motion for the heaviest payload, or why there is none."""
        try:
            plan = planned(
                self.robot,
                task.trajectory,
                task.limits,
                intervals=max(MINIMUM_INTERVALS, math.ceil(INTERVALS * task.trajectory.duration)),
                margins=self.style.margins(task.limits),
                lightest=-self.style.lighter * self.robot.mass,
                period=1 / task.control_frequency,
            )
        except Infeasible as error:
            _LOGGER.debug("no plan for %r: %s", task.trajectory.name, error)
            return f"no motion along {task.trajectory.name!r} inside the limits was found"
        return plan if plan.payload > 0 else f"{task.trajectory.name!r} leaves no payload to plan for"

    def _fall_back(self, episodes: int, reason: str) -> Adaptive:
        self.fallbacks += episodes
        _LOGGER.warning("%d episodes follow the reference itself, without a plan: %s", episodes, reason)
        return self._reference_law

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Drive commands (m,) or (N, m), and the state to pass next time.

        Raises:
            ValueError: if the observation is not of this robot's layout.
        """
        observation = np.asarray(observation, float)
        lanes = len(observation) if observation.ndim == 2 else 1
        groups = self._groups
        if groups is None or (len(groups) > 1 and sum(len(group.lanes) for group in groups) != lanes):
            if state is None:
                self._fall_back(lanes, "begin() has not told the tasks")
            return self._reference_law.predict(observation, state, episode_start, deterministic)
        if len(groups) == 1:
            return groups[0].law.predict(observation, state, episode_start, deterministic)
        command, states = np.empty((lanes, self.robot.cables)), []
        for place, group in enumerate(groups):
            start = None if episode_start is None else np.asarray(episode_start)[group.lanes]
            before = None if state is None else state[place]
            command[group.lanes], after = group.law.predict(observation[group.lanes], before, start, deterministic)
            states.append(after)
        return command, tuple(states)


def _case(task: Task) -> tuple[Any, ...]:
    """Tells tasks with different plans apart; a trajectory that cannot be hashed is like itself alone."""
    motion = task.trajectory if isinstance(task.trajectory, Hashable) else id(task.trajectory)
    return motion, task.limits, task.control_frequency


def _reference_law(robot: Robot) -> Adaptive:
    """The law that follows the reference itself."""
    if robot.flexible:
        return Adaptive(composite_tuned(robot))
    return Adaptive(FeedbackLinearization(robot, gains=ADAPTIVE_GAINS["planar" if robot.planar else "spatial"]))


def close(robot: Robot) -> Tube:
    """``tube``."""
    return Tube(robot, CLOSE[robot.joints])


def safe(robot: Robot) -> Tube:
    """``tube-safe``."""
    return Tube(robot, SAFE[robot.joints])


TUBE = PolicyEntry(
    name="tube",
    kind="optimal",
    env_ids=tuple(ENV_IDS),
    factory=close,
    summary="plans the heaviest payload's motion inside the tube, follows it, weighs its payload",
)

TUBE_SAFE = PolicyEntry(
    name="tube-safe",
    kind="optimal",
    env_ids=tuple(ENV_IDS),
    factory=safe,
    summary="tube with a margin for noise and for a robot that is not quite as told",
)
