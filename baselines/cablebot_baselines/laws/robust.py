"""The paper's robust control (Eqs. 26–36, signs corrected) for the rigid law and for the composite
law."""

from __future__ import annotations

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import Composite
from cablebot_baselines.laws.outer_loop import Gains, RobustPD, checked_gains
from cablebot_gym.robots import Robot


def make_robust(
    robot: Robot,
    *,
    gains: Gains = "paper",
    minimum_tension: float | None = None,
    boundary_layer: float = RobustPD.boundary_layer,
    zeta: float = RobustPD.zeta,
    phi: float = RobustPD.phi,
) -> FeedbackLinearization | Composite:
    """Feedback linearization of a rigid robot, or the composite law of a robot with joint springs or
    elastic cables, with the outer loop :class:`~cablebot_baselines.laws.outer_loop.RobustPD`.

    Args:
        robot: nominal robot.
        gains: (k_p, k_d), the same for each coordinate, or ``paper``.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.
        boundary_layer: ε of the outer loop. The accuracy depends on it. The paper gives no values of
            this and the other parameters; the defaults are our choice.
        zeta: its ζ.
        phi: its φ [m/s², rad/s²].

    Raises:
        ValueError: if an argument is out of its range.
    """
    law: FeedbackLinearization | Composite
    if robot.flexible:
        law = Composite(robot, minimum_tension=minimum_tension)
    else:
        law = FeedbackLinearization(robot, minimum_tension=minimum_tension)
    law.outer = RobustPD(
        gains=checked_gains(gains, robot), boundary_layer=boundary_layer, zeta=zeta, phi=phi
    )
    return law


ROBUST = entry("robust", make_robust)
