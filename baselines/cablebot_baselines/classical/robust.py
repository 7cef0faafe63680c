"""The paper's robust control (Eqs. 26–36, signs corrected) for the rigid law and for the composite
law."""

from __future__ import annotations

from typing import Any

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flexible import Composite
from cablebot_baselines.classical.outer_loop import RobustPD, checked_gains
from cablebot_baselines.entries import entry
from cablebot_gym.robots import Robot


class Robust(FeedbackLinearization):
    """Feedback linearization with the outer loop
    :class:`~cablebot_baselines.classical.outer_loop.RobustPD`.

    Args:
        robot: nominal robot.
        gains: (k_p, k_d), the same for each coordinate; None for the paper's gains.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.
        robustness: ``boundary_layer``, ``zeta``, ``phi`` and ``q`` of the outer loop. The accuracy
            depends on the boundary layer. The paper gives no values; the defaults are our choice.

    Raises:
        ValueError: if an argument is out of its range.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: tuple[float, float] | None = None,
        minimum_tension: float | None = None,
        **robustness: Any,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer = RobustPD(gains=checked_gains(gains, robot), **robustness)


class RobustComposite(Composite):
    """Composite law with the outer loop :class:`~cablebot_baselines.classical.outer_loop.RobustPD`.

    Args:
        robot: nominal robot.
        gains: (k_p, k_d), the same for each coordinate; None for the paper's gains.
        spring_damping: largest K_v in units of √(K J′); ≥ 0.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.
        robustness: ``boundary_layer``, ``zeta``, ``phi`` and ``q`` of the outer loop.

    Raises:
        ValueError: if an argument is out of its range.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: tuple[float, float] | None = None,
        spring_damping: float = 1.0,
        minimum_tension: float | None = None,
        **robustness: Any,
    ) -> None:
        super().__init__(robot, spring_damping=spring_damping, minimum_tension=minimum_tension)
        self.outer = RobustPD(gains=checked_gains(gains, robot), **robustness)


ROBUST = entry("robust", Robust)
ROBUST_COMPOSITE = entry("robust-composite", RobustComposite)
