"""The paper's feedback linearization for rigid transmissions (Eqs. 10–13 planar, 16–18 spatial)."""

from __future__ import annotations

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.outer_loop import (
    NAMED_GAINS,
    PD,
    Gains,
    OuterLoop,
    checked_gains,
)
from cablebot_gym.robots import Robot

TUNED_GAINS = {"planar": (2000.0, 90.0), "spatial": (1600.0, 80.0)}
"""(K_P, K_D) with the largest DLCC for an unknown payload [1/s², 1/s].

With a known payload the DLCC is that of the paper's gains.
"""

_TABLES = NAMED_GAINS | {"tuned": TUNED_GAINS}


class FeedbackLinearization(ClassicalLaw):
    """``τ = r T + J β̈ + c β̇`` with ``−Sᵀ T = D v + h`` and ``v = Ẍ_d + K_D ė + K_P e``, e = X_d −
    X.

    The law uses the nominal parameters and the model payload. With more cables than coordinates it
    allocates tensions of at least ``minimum_tension``; for the planar robot of the paper they are
    the smallest ones (Eq. 11 with the smallest α). The action is not saturated: |a| > 1 is the
    paper's torque violation.

    Args:
        robot: nominal robot.
        gains: (K_P, K_D), the same for each coordinate, ``paper`` or ``tuned``. Sampling with
            period h reduces the effective K_D by about K_P h/2, so the planar gains need a control
            frequency well above 100 Hz.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.

    Raises:
        ValueError: if the gains are invalid, or ``minimum_tension`` is negative.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: Gains = "paper",
        minimum_tension: float | None = None,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer: OuterLoop = PD(gains=checked_gains(gains, robot, _TABLES))

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Requested torques [N·m] and motor speeds [rad/s], each (..., m)."""
        required = self._inverse_dynamics(
            mass, blocks["pose"], blocks["velocity"], self.outer(blocks)
        )
        return required.torques, required.speeds


FL = entry("fl", FeedbackLinearization)
