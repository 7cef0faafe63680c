"""The paper's robust control (Eqs. 26–36, signs corrected) for the rigid law and for the composite law."""

from __future__ import annotations

from numpy.typing import ArrayLike

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flexible import SPATIAL_ENV_IDS, Composite
from cablebot_baselines.classical.outer_loop import RobustPD, checked_gains
from cablebot_gym.envs import RIGID_ENV_IDS
from cablebot_gym.physics.textbook import MINIMUM_TENSION
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot


class Robust(FeedbackLinearization):
    """Feedback linearization with the outer loop :class:`~cablebot_baselines.classical.outer_loop.RobustPD`.

    Args:
        robot: nominal robot.
        gains: (k_p, k_d), the same for each coordinate; None for the paper's gains.
        boundary_layer: ε, bound of ‖BᵀPe‖ in the boundary layer; > 0. The accuracy depends on it. The paper gives no
            value.
        zeta: ζ, bound of the relative error of the inertia; 0 ≤ ζ < 1. The paper gives no values for ζ and φ; the
            defaults are our choice.
        phi: φ, bound of the error of the nominal forces as an acceleration [m/s², rad/s²]; ≥ 0.
        q: Q of the Lyapunov equation, a positive number or a symmetric positive definite 2×2 matrix.
        minimum_tension: T_min of a planar robot [N].

    Raises:
        ValueError: if an argument is out of its range.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: tuple[float, float] | None = None,
        boundary_layer: float = RobustPD.boundary_layer,
        zeta: float = RobustPD.zeta,
        phi: float = RobustPD.phi,
        q: ArrayLike = RobustPD.q,
        minimum_tension: float = MINIMUM_TENSION,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer = RobustPD(gains=checked_gains(gains, robot), boundary_layer=boundary_layer, zeta=zeta, phi=phi, q=q)


class RobustComposite(Composite):
    """Composite law with the outer loop :class:`~cablebot_baselines.classical.outer_loop.RobustPD`.

    Args:
        robot: nominal robot.
        gains: (k_p, k_d), the same for each coordinate; None for the paper's gains.
        boundary_layer: ε, bound of ‖BᵀPe‖ in the boundary layer; > 0.
        zeta: ζ, bound of the relative error of the inertia; 0 ≤ ζ < 1.
        phi: φ, bound of the error of the nominal forces as an acceleration [m/s², rad/s²]; ≥ 0.
        q: Q of the Lyapunov equation, a positive number or a symmetric positive definite 2×2 matrix.
        spring_damping: largest K_v in units of √(K J′); ≥ 0.
        minimum_tension: T_min of a planar robot [N].

    Raises:
        ValueError: if an argument is out of its range.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: tuple[float, float] | None = None,
        boundary_layer: float = RobustPD.boundary_layer,
        zeta: float = RobustPD.zeta,
        phi: float = RobustPD.phi,
        q: ArrayLike = RobustPD.q,
        spring_damping: float = 1.0,
        minimum_tension: float = MINIMUM_TENSION,
    ) -> None:
        super().__init__(robot, spring_damping=spring_damping, minimum_tension=minimum_tension)
        self.outer = RobustPD(gains=checked_gains(gains, robot), boundary_layer=boundary_layer, zeta=zeta, phi=phi, q=q)


def _tuned(robot: Robot) -> Robust:
    """Robust law for an unknown payload.

    φ = g/2 corresponds to a payload of half the platform's weight. The law does not tolerate sensor noise, because the
    boundary layer is thin.
    """
    return Robust(robot, boundary_layer=1e-3, zeta=0.5, phi=5.0)


ROBUST = PolicyEntry(
    name="robust",
    kind="classical",
    env_ids=RIGID_ENV_IDS,
    factory=Robust,
    summary="the paper's robust feedback linearization (Eqs. 26–36)",
)

ROBUST_TUNED = PolicyEntry(
    name="robust-tuned",
    kind="classical",
    env_ids=tuple(env_id for env_id in RIGID_ENV_IDS if "Spatial" in env_id),  # planar: cables go slack
    factory=_tuned,
    summary="robust with ζ and φ for an unknown payload",
)

ROBUST_COMPOSITE = PolicyEntry(
    name="robust-composite",
    kind="classical",
    env_ids=SPATIAL_ENV_IDS,
    factory=RobustComposite,
    summary="composite with the paper's robust term",
)
