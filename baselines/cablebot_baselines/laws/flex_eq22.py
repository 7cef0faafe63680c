"""The paper's control law for joint springs (Eq. 22).

The law does not stabilise the springs. The package includes it to demonstrate this instability.
"""

from __future__ import annotations

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.flexible import FlexibleLaw
from cablebot_baselines.laws.law import Array
from cablebot_baselines.laws.outer_loop import PD, Gains, OuterLoop, checked_gains
from cablebot_gym.robots import Robot


class PaperFlexible(FlexibleLaw):
    """``τ = r T(v) + J β̈(v) + J′ β̈′ + c′ β̇`` (Eq. 22, sign of T corrected) with v of Eq. 18 and
    the motor acceleration β̈′ := β̈(v).

    The law does not linearise the plant. The loop M J′ s⁴ + K (M + J′)(s² + K_D s + K_P) has no s³
    term. It is unstable for every K and every K_D > 0, with its fast pole pair near +K_D/2, unless
    the motor friction c′ exceeds about K_D J′.

    Args:
        robot: nominal flexible robot.
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
        as_printed: bool = False,
        gains: Gains = "paper",
        minimum_tension: float | None = None,
    ) -> None:
        if as_printed:
            frictionless = robot.transmission.replace(
                damping=0.0, motor_damping=0.0, coulomb_friction=0.0, load_friction=0.0
            )
            robot = robot.replace(transmission=frictionless)
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer: OuterLoop = PD(gains=checked_gains(gains, robot))

    def _motor_torques(self, blocks: dict[str, Array], mass: Array) -> Array:
        torques, motor_acceleration, _ = self._rigid_torques(mass, blocks, self.outer(blocks))
        return torques + self.model.motor_inertia * motor_acceleration


FLEX_EQ22 = entry("flex-eq22", PaperFlexible)
