"""The paper's own law for joint springs (Eq. 22), which does not stabilise them: shipped to show that."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, get_args

import numpy as np

from cablebot_baselines.classical.flexible import SPATIAL_ENV_IDS, FlexibleLaw
from cablebot_baselines.classical.law import Array, first_steps
from cablebot_baselines.classical.outer_loop import PD, OuterLoop, checked_gains
from cablebot_gym.physics.textbook import MINIMUM_TENSION
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot

MotorAcceleration = Literal["commanded", "measured"]


class PaperFlexible(FlexibleLaw):
    """``τ = r T(v) + J β̈(v) + J′ β̈′ + c′ β̇`` (Eq. 22, sign of T corrected), v of Eq. 18, linearises nothing.

    Commanded, β̈′ := β̈(v): the loop M J′ s⁴ + K (M + J′)(s² + K_D s + K_P) has no s³ term, and is unstable for every K
    and every K_D > 0, the fast pair near +K_D/2, unless the motors' own friction c′ exceeds about K_D J′. Measured, β̈′
    cancels the motor's inertia with a gain of exactly 1, one sample late, s³ + K/(J′ h) = 0, and diverges at once.

    Args:
        robot: nominal flexible robot.
        motor_acceleration: ``commanded``: β̈′ of the pulley under v; ``measured``: the difference of the motors' speeds
            at the last two control instants. That needs predict's ``state``; an episode's first step commands it.
        as_printed: leaves out the terms of damping, which the paper drops from Eq. 4 on.
        gains: (K_P, K_D); None for the paper's.
        minimum_tension: T_min of a planar robot [N].

    Raises:
        ValueError: if the robot has no springs, or an argument is not valid.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        motor_acceleration: MotorAcceleration = "commanded",
        as_printed: bool = False,
        gains: tuple[float, float] | None = None,
        minimum_tension: float = MINIMUM_TENSION,
    ) -> None:
        if motor_acceleration not in get_args(MotorAcceleration):
            choices = " or ".join(get_args(MotorAcceleration))
            raise ValueError(f"motor_acceleration must be {choices}, not {motor_acceleration!r}")
        super().__init__(_undamped(robot) if as_printed else robot, minimum_tension=minimum_tension)
        self.motor_acceleration = motor_acceleration
        self.outer: OuterLoop = PD(gains=checked_gains(gains, robot))

    def _control(self, part: dict[str, Array], mass: Array, state: Any, episode_start: Any) -> tuple[Array, Array, Any]:
        torques, winding, _ = self._as_rigid(mass, part, self.outer(part))
        if self.motor_acceleration == "measured":
            winding, state = _measured(part, state, episode_start, otherwise=winding)
        return torques + self.robot.motor_inertia * winding, part["motor_speed"], state


def _measured(part: dict[str, Array], state: Any, episode_start: Any, *, otherwise: Array) -> tuple[Array, Array]:
    """β̈′ from the motors' last two speeds, and the state: these speeds and the time left."""
    now = np.concatenate([part["motor_speed"], part["time_left"]], axis=-1)
    first = first_steps(state, episode_start, now.shape[:-1])[..., None]
    change = now - (now if state is None else state)
    # The clock that the observation carries stands still once the reference has ended.
    elapsed = np.where(first, 0.0, -change[..., -1:])
    measured = change[..., :-1] / np.where(elapsed > 0, elapsed, 1.0)
    return np.where(elapsed > 0, measured, otherwise), now


def _undamped(robot: Robot) -> Robot:
    return robot.replace(transmission=dataclasses.replace(robot.transmission, damping=0.0, motor_damping=0.0))


FLEX_EQ22 = PolicyEntry(
    name="flex-eq22",
    kind="classical",
    env_ids=SPATIAL_ENV_IDS,
    factory=PaperFlexible,
    summary="the paper's law for joint springs (Eq. 22), unstable without motor friction",
)
