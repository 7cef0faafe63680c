"""Laws that track planned motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cablebot_baselines.episodes import first_steps
from cablebot_baselines.laws.adaptive import Adaptive, EstimatorState
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Follower, PlannedMotion, PlannedMotions, State
from cablebot_gym.robots import Robot

ESTIMATOR_PRIOR_WEIGHT = 1e-4
"""Prior weight of the mass estimate of an exactly known robot [s], see
:class:`~cablebot_baselines.laws.adaptive.Adaptive`."""

INITIAL_ESTIMATE_WEIGHT = 0.05
"""Weight of the static mass estimate at the start of an episode [s].

After this estimation time in motion, the dynamic estimate and the static estimate have equal
weight.
"""


class PlanLaw(ClassicalLaw):
    """Tracks planned motions with given masses.

    Args:
        robot: nominal robot.
        plans: planned motion of each row of a batch, or one for all.
        period: control period [s].
        gains: (K_P, K_D) of the platform's pose error [1/s², 1/s].
        reserve: tension of redundant cables above the minimum tension of the robot [N].
    """

    def __init__(
        self,
        robot: Robot,
        plans: Sequence[PlannedMotion],
        period: float,
        *,
        gains: tuple[float, float],
        reserve: float = 1.0,
    ) -> None:
        super().__init__(robot, minimum_tension=robot.minimum_tension + reserve)
        self._follower = Follower(robot=robot, gains=gains)
        self.plan = PlannedMotions(plans)
        """The planned motions."""
        self._period = period

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Requested torques [N·m] and motor speeds [rad/s], each (..., m)."""
        plan = self.plan
        time = plan.duration - blocks["time_to_go"][..., 0]
        if "disturbance" in blocks:
            # An error of the pose makes the feedback cancel a known acceleration.
            shift = blocks["disturbance"] / self._follower.gains[0]
            blocks = blocks | {"pose": blocks["pose"] + shift}
        state = State.from_blocks(blocks, time)
        return self._follower.torques(plan, state, mass - self.robot.mass, self._period)

    @property
    def rotor_inertia(self) -> Array:
        """J of a rigid robot, J + J′ of a flexible robot [kg·m²], (m,)."""
        inertia: Array = self.robot.pulley_inertia
        if self.robot.flexible:
            inertia = inertia + self.robot.motor_inertia
        return inertia


class AdaptivePlanLaw(Adaptive):
    """Tracks planned motions and estimates the payload with the acceleration of the plan as weight.

    When the plan moves below the reference, it accelerates downward at g/2 or more. The reference
    acceleration does not contain this motion. As a weight it would overrate the small remaining
    cable forces.

    Args:
        law: law that tracks the plans.
    """

    def __init__(self, law: PlanLaw) -> None:
        super().__init__(law, estimator_prior_weight=ESTIMATOR_PRIOR_WEIGHT)
        self._plan = law.plan

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
        wrench = textbook.times_vector(np.swapaxes(structure, -1, -2), tensions)
        vertical = wrench[..., robot.dimensions - 1, None]
        weight = INITIAL_ESTIMATE_WEIGHT * robot.gravity
        impulse = np.where(starts, weight * vertical, memory.weighted_impulse)
        change = np.where(starts, weight * robot.gravity, memory.weighted_change)
        return replace(memory, weighted_impulse=impulse, weighted_change=change)
