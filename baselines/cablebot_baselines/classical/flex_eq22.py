"""The paper's control law for joint springs (Eq. 22).

The law does not stabilise the springs. The package includes it to demonstrate this instability.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from cablebot_baselines.classical.flexible import FlexibleLaw
from cablebot_baselines.classical.law import Array
from cablebot_baselines.classical.outer_loop import PD, Gains, OuterLoop, checked_gains
from cablebot_baselines.entries import entry
from cablebot_baselines.episodes import first_steps
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import choice

MotorAcceleration = Literal["commanded", "measured"]


class PaperFlexible(FlexibleLaw):
    """``τ = r T(v) + J β̈(v) + J′ β̈′ + c′ β̇`` (Eq. 22, sign of T corrected) with v of Eq. 18.

    The law does not linearise the plant. Its two variants differ in the motor acceleration β̈′:

    * ``commanded``: β̈′ := β̈(v). The loop M J′ s⁴ + K (M + J′)(s² + K_D s + K_P) has no s³ term.
      It is unstable for every K and every K_D > 0, with its fast pole pair near +K_D/2, unless the
      motor friction c′ exceeds about K_D J′.
    * ``measured``: β̈′ cancels the motor inertia with a gain of exactly 1 and a delay of one
      sample. The loop s³ + K/(J′ h) = 0 diverges immediately.

    Args:
        robot: nominal flexible robot.
        motor_acceleration: ``commanded``: β̈′ is the pulley acceleration for v. ``measured``: β̈′
            is the difference quotient of the motor speeds at the last two control steps. This
            variant needs the ``state`` of predict and uses the commanded value in the first step of
            an episode.
        as_printed: whether to omit the damping terms, as the paper does from Eq. 4 on.
        gains: (K_P, K_D) or ``paper``.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.

    Raises:
        ValueError: if the robot has no joint springs, or an argument is invalid.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        motor_acceleration: MotorAcceleration = "commanded",
        as_printed: bool = False,
        gains: Gains = "paper",
        minimum_tension: float | None = None,
    ) -> None:
        choice("motor_acceleration", motor_acceleration, get_args(MotorAcceleration))
        if as_printed:
            frictionless = robot.transmission.replace(
                damping=0.0, motor_damping=0.0, coulomb_friction=0.0, load_friction=0.0
            )
            robot = robot.replace(transmission=frictionless)
        super().__init__(robot, minimum_tension=minimum_tension)
        self.motor_acceleration = motor_acceleration
        self.outer: OuterLoop = PD(gains=checked_gains(gains, robot))

    def _control(
        self, blocks: dict[str, Array], mass: Array, state: Any, episode_start: Any
    ) -> tuple[Array, Array, Any]:
        torques, motor_acceleration, _ = self._rigid_torques(mass, blocks, self.outer(blocks))
        if self.motor_acceleration == "measured":
            motor_acceleration, state = _measured_acceleration(
                blocks, state, episode_start, default=motor_acceleration
            )
        torques = torques + self.model.motor_inertia * motor_acceleration
        return torques, blocks["motor_speed"], state


def _measured_acceleration(
    blocks: dict[str, Array], state: Any, episode_start: Any, *, default: Array
) -> tuple[Array, Array]:
    """β̈′ from the last two motor speeds, and the new state: the motor speeds and the time to
    go."""
    now = np.concatenate([blocks["motor_speed"], blocks["time_to_go"]], axis=-1)
    starts = first_steps(state, episode_start, now.shape[:-1])[..., None]
    before = now
    if state is not None:
        before = state
    speed_change, time_change = np.split(now - before, [-1], axis=-1)
    # The observed time to go stays constant after the end of the reference.
    period = np.where(starts, 0.0, -time_change)
    measured = speed_change / np.where(period > 0, period, 1.0)
    return np.where(period > 0, measured, default), now


FLEX_EQ22 = entry("flex-eq22", PaperFlexible)
