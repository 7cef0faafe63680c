"""Laws that track planned motions."""

from __future__ import annotations

from collections.abc import Sequence

from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_gym.planning import Follower, PlannedMotion, PlannedMotions, State
from cablebot_gym.robots import Robot


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
