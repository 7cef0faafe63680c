"""A receding-horizon controller that solves from the observation alone."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cablebot_baselines.classical.adaptive import ADAPTIVE_GAINS, Adaptive, Memory
from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.law import Array, ClassicalLaw, first_steps
from cablebot_baselines.optimal.horizon import HORIZON, HorizonProgram, NoPlan, Tuning
from cablebot_gym.envs import RIGID_ENV_IDS
from cablebot_gym.envs.observation import PREVIEWS
from cablebot_gym.planning import Margins
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits, Task

_LOGGER = logging.getLogger("cablebot_gym")

EVERY = 5
"""Control steps from one plan to the next."""

TUNING = {
    "planar": Tuning(
        intervals=10,
        instants=2,
        margins=Margins(position=3e-4, demand=0.005, tension=0.5),
        power=4.0,
        error=0.1,
        end_error=0.0,
        end_velocity=1.0,
        smoothness=1e-6,
    ),
    "spatial": Tuning(
        intervals=7,
        instants=3,
        margins=Margins(position=4e-4, rotation=4e-4, demand=0.002, tension=10.0),
        power=3.0,
        error=0.3,
        end_error=0.3,
        end_velocity=3.0,
        smoothness=1e-6,
    ),
}
"""What carries most on the paper's circles."""

PRIOR = 1e-3
"""Of the mass, see :class:`~cablebot_baselines.classical.adaptive.Adaptive` [s]: a plan for a wrong mass is worse than a noisy
one."""

_FIRST_ROUNDS = 3
"""Quadratic programs of a plan that has none before it to start from."""

_RECORD = 4 * 24
"""Points of the reference that are remembered: those of as many plans as fill the horizon at 500 Hz, and some."""

_TOO_FAR = 2.0
"""Bounds away from the reference from which on nothing is planned."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Progress:
    """What one control instant leaves for the next; each array has a leading axis N."""

    steps: Array
    """Since the episode's start, (N,)."""
    clock: Array
    """Less the time left, at the last instant, (N,) [s]."""
    period: Array
    """Control period, (N,) [s]; 0 as long as it is not known."""
    times: Array
    """At which points of the reference have been previewed, by the clock, (N, _RECORD) [s]; NaN for none."""
    seen: Array
    """These points, (N, _RECORD, n)."""
    plans: tuple[Array | None, ...]
    """Control points (points, n) of each lane; None where there is no plan, or no longer."""
    age: Array
    """Of the plans, (N,) [s]."""
    lost: NDArray[np.bool_]
    """Whether the platform is too far away to plan for, (N,)."""
    law: Memory | None
    """Of the law that tracks the plan; None before the first step."""


class NonlinearMPC(ClassicalLaw):
    """Plans the next fifth of a second at every fifth control step, and tracks the plan by a law at every one.

    A plan starts from the measured pose and velocity, stays within the tube about the reference, and asks little of
    the motors, for the mass that the law has weighed so far, see :class:`~cablebot_baselines.optimal.horizon.Tuning`. What the
    reference will do is known from previews, those of earlier observations included. Where the solver fails, the last
    plan holds for as long as it lasts; after that, and where the platform is too far away to plan for, the law tracks
    the reference itself. :attr:`fallbacks` counts both.

    Args:
        robot: nominal robot, rigid.
        tuning: of the plans; None for :data:`TUNING`.
        gains: (K_P, K_D) of the law that tracks the plan; None for those of ``adaptive``.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the robot has joint springs.
    """

    unclipped = False

    def __init__(self, robot: Robot, *, tuning: Tuning | None = None, gains: tuple[float, float] | None = None) -> None:
        if robot.flexible:
            raise ValueError(
                f"nmpc plans for rigid robots, and {robot.name!r} has joint springs: use adaptive-composite"
            )
        kind = "planar" if robot.planar else "spatial"
        tuning = tuning or TUNING[kind]
        super().__init__(robot, minimum_tension=tuning.margins.tension)
        self.program = HorizonProgram(robot, tuning)
        law = FeedbackLinearization(robot, gains=gains or ADAPTIVE_GAINS[kind], minimum_tension=tuning.margins.tension)
        self.law = Adaptive(law, prior=PRIOR)
        self.fallbacks = 0
        """How often a plan could not be had since the last :meth:`begin`: each time that the solver failed, and each
        time that a platform got lost."""
        self._limits: tuple[Limits, ...] = (Limits(),)

    def begin(self, tasks: Sequence[Task]) -> None:
        """Refuses episodes of another robot, reads the limits, and forgets what was counted."""
        self.law.begin(tasks)
        self._limits = tuple(task.limits for task in tasks)
        self.fallbacks = 0

    def respond(self, part: dict[str, Array], state: Any = None, episode_start: Any = None) -> tuple[Array, Any]:
        """Drive commands and the next state, a :class:`Progress`, from the blocks of an observation."""
        if part["pose"].ndim == 1:
            batch = {name: block[None] for name, block in part.items()}
            command, state = self.respond(batch, state, episode_start)
            return command[0], state
        first = first_steps(state, episode_start, part["pose"].shape[:1])
        progress = self._renewed(part, state, first)
        due = progress.steps % EVERY == 0
        if np.any(due):
            progress = self._replanned(part, progress, np.flatnonzero(due))
        command, law = self.law.respond(self._followed(part, progress), progress.law, first)
        return command, replace(progress, law=law)

    def _renewed(self, part: dict[str, Array], before: Progress | None, first: NDArray[np.bool_]) -> Progress:
        """The last state a control period later, or a new one for lanes that start."""
        count, n = part["pose"].shape
        clock, none = -part["time_left"][:, 0], np.zeros(count)
        if before is None:
            return Progress(
                steps=np.zeros(count, int),
                clock=clock,
                period=none,
                times=np.full((count, _RECORD), np.nan),
                seen=np.full((count, _RECORD, n), np.nan),
                plans=(None,) * count,
                age=none,
                lost=np.zeros(count, np.bool_),
                law=None,
            )
        passed = clock - before.clock
        period = np.where(first, 0.0, np.where(passed > 0, passed, before.period))  # the clock stops at the end
        age = np.where(first, np.inf, before.age + period)
        return replace(
            before,
            steps=np.where(first, 0, before.steps + 1),
            clock=clock,
            period=period,
            times=np.where(first[:, None], np.nan, before.times),
            plans=tuple(plan if old <= HORIZON else None for plan, old in zip(before.plans, age, strict=True)),
            age=age,
            lost=before.lost & ~first,
        )

    # Planning

    def _replanned(self, part: dict[str, Array], progress: Progress, lanes: NDArray[Any]) -> Progress:
        """The state with new plans in these lanes."""
        progress = self._remembered(part, progress, lanes)
        told = self.robot.mass + part["told_payload"][:, 0]
        mass = told if progress.law is None else self.law.mass(progress.law, told)
        mass = np.where(progress.steps == 0, told, mass)
        plans, age, lost = list(progress.plans), progress.age.copy(), progress.lost.copy()
        for lane in lanes:
            limits = self._limits[lane % len(self._limits)]
            was_lost, lost[lane] = lost[lane], not self._near(part, lane, limits)
            if lost[lane]:
                plans[lane] = None
                if not was_lost:
                    self._fell_back("the platform is too far from its reference to plan for")
                continue
            try:
                plans[lane], age[lane] = self._plan(part, progress, lane, float(mass[lane]), limits), 0.0
            except NoPlan as error:
                self._fell_back(str(error))
        return replace(progress, plans=tuple(plans), age=age, lost=lost)

    def _plan(self, part: dict[str, Array], progress: Progress, lane: int, mass: float, limits: Limits) -> Array:
        program, old, age = self.program, progress.plans[lane], progress.age[lane]
        reference = self.preview(part, progress, lane)
        guess = wanted = reference(program.instants)
        if old is not None:  # and after its end its last error
            within = np.minimum(program.instants, HORIZON - age)
            guess = program.basis(within + age)[0] @ old + wanted - reference(within)
        return program.plan(
            guess,
            part["pose"][lane],
            part["velocity"][lane],
            wanted,
            reference(HORIZON, 1),
            mass=mass,
            limits=limits,
            rounds=_FIRST_ROUNDS if old is None else 1,
        )

    def _near(self, part: dict[str, Array], lane: int, limits: Limits) -> bool:
        error = part["pose"][lane] - part["reference_pose"][lane]
        distance, turn = np.linalg.norm(error[:3]), np.abs(error[3:]).max(initial=0.0)
        return bool(distance < _TOO_FAR * limits.position and turn < _TOO_FAR * limits.rotation)

    def _fell_back(self, reason: str) -> None:
        if self.fallbacks == 0:
            _LOGGER.warning("nmpc goes on with an older plan, or without one along the reference: %s", reason)
        self.fallbacks += 1

    # The reference

    def _remembered(self, part: dict[str, Array], progress: Progress, lanes: NDArray[Any]) -> Progress:
        """The state with the points that these lanes preview now."""
        names = [f"preview_{round(ahead * 1e3)}ms" for ahead in PREVIEWS]
        ahead = np.stack([part[name][lanes] for name in names], axis=1) + part["reference_pose"][lanes, None]
        times, seen = progress.times.copy(), progress.seen.copy()
        times[lanes] = np.roll(times[lanes], len(names), axis=1)
        seen[lanes] = np.roll(seen[lanes], len(names), axis=1)
        times[lanes, : len(names)] = progress.clock[lanes, None] + PREVIEWS
        seen[lanes, : len(names)] = ahead
        return replace(progress, times=times, seen=seen)

    def preview(self, part: dict[str, Array], progress: Progress, lane: int) -> CubicSpline:
        """A lane's X_d from now on to the end of the horizon, through every point of it that has been previewed.

        On the paper's planar circle it errs by 0.64 mm at most at the start, and by less than 0.04 mm from 0.1 s on.
        """
        pose, velocity = part["reference_pose"][lane], part["reference_velocity"][lane]
        if part["time_left"][lane, 0] <= 0:
            velocity = np.zeros_like(velocity)
        times, places = np.unique(np.round(progress.times[lane] - progress.clock[lane], 6), return_index=True)
        known = (times > 1e-6) & (times <= HORIZON)
        points = np.concatenate([pose[None], progress.seen[lane][places[known]]])
        return CubicSpline(np.r_[0.0, times[known]], points, bc_type=((1, velocity), "not-a-knot"))

    # Tracking

    def _followed(self, part: dict[str, Array], progress: Progress) -> dict[str, Array]:
        """The blocks with the plan in place of the reference where there is one."""
        names = ("reference_pose", "reference_velocity", "reference_acceleration")
        followed = part | {name: part[name].copy() for name in names}
        for lane, plan in enumerate(progress.plans):
            if plan is not None:
                for name, value in zip(
                    names, self.program.basis_at(round(float(progress.age[lane]), 9)) @ plan, strict=True
                ):
                    followed[name][lane] = value
        return followed


NMPC = PolicyEntry(
    name="nmpc",
    kind="optimal",
    env_ids=RIGID_ENV_IDS,
    factory=NonlinearMPC,
    summary="plans the next 0.2 s anew every fifth control step, from the observation alone",
    slow=True,
)
