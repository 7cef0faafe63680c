"""The paper's robust control (Eqs. 26–36, signs corrected) for the rigid law and for the composite
law."""

from __future__ import annotations

from typing import Any

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flexible import Composite
from cablebot_baselines.classical.outer_loop import Gains, RobustPD, checked_gains
from cablebot_baselines.entries import entry
from cablebot_gym.robots import Robot


class Robust(FeedbackLinearization):
    """Feedback linearization with the outer loop
    :class:`~cablebot_baselines.classical.outer_loop.RobustPD`.

    Args:
        robot: nominal robot.
        gains: (k_p, k_d), the same for each coordinate, or ``paper``.
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
        gains: Gains = "paper",
        minimum_tension: float | None = None,
        **robustness: Any,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer = RobustPD(gains=checked_gains(gains, robot), **robustness)


class RobustComposite(Composite):
    """Composite law with the outer loop :class:`~cablebot_baselines.classical.outer_loop.RobustPD`.

    Args:
        robot: nominal robot.
        gains: (k_p, k_d), the same for each coordinate, or ``paper``.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.
        robustness: ``boundary_layer``, ``zeta``, ``phi`` and ``q`` of the outer loop.

    Raises:
        ValueError: if an argument is out of its range.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: Gains = "paper",
        minimum_tension: float | None = None,
        **robustness: Any,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer = RobustPD(gains=checked_gains(gains, robot), **robustness)


def make_robust(
    robot: Robot,
    *,
    gains: Gains = "paper",
    minimum_tension: float | None = None,
    boundary_layer: float = RobustPD.boundary_layer,
    zeta: float = RobustPD.zeta,
    phi: float = RobustPD.phi,
) -> Robust | RobustComposite:
    """The robust law of a rigid robot, or that of a robot with joint springs or elastic cables.

    Args:
        robot: nominal robot.
        gains: as in :class:`Robust`.
        minimum_tension: as in :class:`Robust`.
        boundary_layer: ε of :class:`~cablebot_baselines.classical.outer_loop.RobustPD`.
        zeta: its ζ.
        phi: its φ [m/s², rad/s²].

    Raises:
        ValueError: if an argument is out of its range.
    """
    law = RobustComposite if robot.flexible else Robust
    return law(
        robot,
        gains=gains,
        minimum_tension=minimum_tension,
        boundary_layer=boundary_layer,
        zeta=zeta,
        phi=phi,
    )


ROBUST = entry("robust", make_robust)
