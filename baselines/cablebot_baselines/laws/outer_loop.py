"""Outer loops: the requested acceleration v of the platform as a function of the observation (Eqs.
13, 18 and 26–36).

Errors are e = z_d − z, reference minus state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.observation import Blocks
from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import choice, number, numbers

_T = TypeVar("_T")

PAPER_GAINS = {
    "planar": (2000.0, 10.0),
    "spatial": (30.0, 20.0),
}
"""(K_P, K_D) of Tables 2 and 4 [1/s², 1/s]."""


def by_kind(table: Mapping[str, _T], robot: Robot) -> _T:
    """The entry ``planar`` for a point mass in a plane, and the entry ``spatial`` for the other
    kinds."""
    return table.get(robot.kind, table["spatial"])


NAMED_GAINS = {"paper": PAPER_GAINS}
"""Tables of gains by name."""

Gains = tuple[float, float] | str
"""Gains (K_P, K_D), the same for each coordinate [1/s², 1/s], or the name of a table of them."""


def checked_gains(
    gains: Gains,
    robot: Robot,
    tables: Mapping[str, Mapping[str, tuple[float, float]]] = NAMED_GAINS,
) -> tuple[float, float]:
    """The gains (K_P, K_D), given as numbers or by the name of a table.

    Raises:
        ValueError: if ``gains`` are neither two positive numbers nor the name of a table.
    """
    if isinstance(gains, str):
        return by_kind(tables[choice("gains", gains, tables)], robot)
    form = "two numbers (K_P, K_D)"
    checked = numbers("gains", gains, shapes=[(2,)], form=form, above=0.0)
    stiffness, damping = checked.tolist()
    return stiffness, damping


@dataclass(frozen=True, kw_only=True)
class PD:
    """``v = Ẍ_d + K_D ė + K_P e`` (Eqs. 13 and 18)."""

    gains: tuple[float, float]
    """(K_P, K_D), the same for each coordinate [1/s², 1/s]."""

    def __call__(self, blocks: Blocks) -> Array:
        """The acceleration v, shape (..., n)."""
        stiffness, damping = self.gains
        error, rate = errors(blocks)
        correction: Array = damping * rate + stiffness * error
        return blocks["reference_acceleration"] + correction


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustPD:
    """PD plus the paper's robust term: ``v = z̈_d + k_d ė + k_p e + Δv`` (Eqs. 31–36, signs as
    derived here).

    With wrong parameters the error dynamics are ``ë + k_d ė + k_p e = −η − Δv`` with η = (γ⁻¹γ̂ −
    1) v + γ⁻¹Δα (Eqs. 30 and 32). For each coordinate A = [[0, 1], [−k_p, −k_d]], B = (0, 1)ᵀ and
    AᵀP + PA = −Q (Eq. 35). The vector s = BᵀPe contains all coordinates. For V = eᵀPe the
    derivative is V̇ = −eᵀQe − 2 sᵀ(η + Δv), so

        Δv = ρ s / max(‖s‖, ε),   ρ = (ζ (‖z̈_d‖ + ‖Ae‖) + φ)/(1 − ζ)

    makes V decrease outside the boundary layer ‖s‖ < ε if ‖γ⁻¹γ̂ − 1‖ ≤ ζ and ‖γ⁻¹Δα‖ ≤ φ. The
    paper's γ̄ is part of φ. As in the paper, norms mix metres and radians.

    Inside the layer the term is linear and acts as a stiffer PD. A thinner layer gives a smaller
    error, but the sampled law then chatters already at a shorter control period. For ε → ∞ the term
    vanishes.

    Raises:
        ValueError: if a parameter is out of its range.
    """

    gains: tuple[float, float]
    """(k_p, k_d), the same for each coordinate [1/s², 1/s]."""
    boundary_layer: float = 1e-3
    """ε, bound of ‖s‖ in the boundary layer; > 0. The paper has no layer (ε = 0), which
    chatters."""
    zeta: float = 0.12
    """ζ, bound of ‖γ⁻¹γ̂ − 1‖, the relative error of the nominal inertia; 0 ≤ ζ < 1."""
    phi: float = 1.2
    """φ, bound of ‖γ⁻¹Δα‖, the error of the nominal forces as an acceleration [m/s², rad/s²]; ≥
    0."""

    def __post_init__(self) -> None:
        number("boundary_layer", self.boundary_layer, above=0.0)
        number("zeta", self.zeta, least=0.0, below=1.0)
        number("phi", self.phi, least=0.0)

    @cached_property
    def system(self) -> Array:
        """A of one coordinate (Eq. 36), shape (2, 2)."""
        stiffness, damping = self.gains
        return np.array([[0.0, 1.0], [-stiffness, -damping]])

    @cached_property
    def lyapunov(self) -> Array:
        """P of one coordinate (Eq. 35) for the identity as Q, shape (2, 2), positive definite."""
        from scipy.linalg import solve_continuous_lyapunov  # slow to import

        solution: Array = solve_continuous_lyapunov(self.system.T, -np.eye(2))
        return solution

    def switching(self, blocks: Blocks) -> Array:
        """s = BᵀPe, shape (..., n)."""
        e = _error_states(blocks)
        _, rate_row = self.lyapunov
        switching: Array = e @ rate_row
        return switching

    def __call__(self, blocks: Blocks) -> Array:
        """The acceleration v, shape (..., n)."""
        drift = _error_states(blocks) @ self.system.T
        drift_norm = np.linalg.norm(drift, axis=(-2, -1))
        reference = blocks["reference_acceleration"]
        reference_norm = np.linalg.norm(reference, axis=-1)
        inertia_error = self.zeta * (reference_norm + drift_norm)
        model_error = inertia_error + self.phi
        rho = model_error / (1 - self.zeta)
        s = self.switching(blocks)
        length = np.linalg.norm(s, axis=-1)
        length = np.maximum(length, self.boundary_layer)
        slope = rho / length
        robust_term = slope[..., None] * s
        nominal_law = PD(gains=self.gains)
        return nominal_law(blocks) + robust_term


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedRobustPD:
    """The robust term of Eqs. 31–36 with the largest stiffness Ω that delay and noise permit: ``v =
    v₀ + min(κ, ρ/‖s‖) s`` with ``v₀ = z̈_d + 2 ω ė + ω² e`` and ω = Ω/2, for positions and for
    angles each.

    With Q = diag(2 ω² λ, 4 ω − 2 λ) and λ = (Ω + ω)/2 Eq. 35 gives s = BᵀPe = ė + λ e. Inside the
    boundary layer ‖s‖ ≤ ρ/κ with κ = 2 (Ω − ω) the law is PD with K_P = Ω² and K_D = 2 Ω: the
    layer is as thin as Ω permits.

    With the model mass m̂ the acceleration is (m̂/m)(v − g) + g + f/m. Outside the layer V̇ ≤ −eᵀQe
    follows from

        ρ = ζ ‖v₀ − g‖ + φ   with   |m/m̂ − 1| ≤ ζ   and   ‖f‖/m̂ ≤ φ.

    The paper divides by 1 − ζ and needs ζ < 1. An error of the mass alone multiplies Δv by the
    positive m̂/m, so this law needs neither. Angles have no error of the mass.
    """

    stiffness: float
    """Ω [1/s]."""
    zeta: float | Array
    """ζ, bound of |m/m̂ − 1|; one number, or one for each row of a batch, (N, 1)."""
    phi: tuple[float, float] | tuple[Array, Array]
    """φ of positions and of angles [m/s², rad/s²], each as ζ."""
    gravity: Array
    """g, (d,) [m/s²]. The first d coordinates are positions."""

    @property
    def gains(self) -> tuple[float, float]:
        """(K_P, K_D) inside the boundary layer [1/s², 1/s]."""
        return self.stiffness**2, 2 * self.stiffness

    def of(self, rows: NDArray[np.bool_]) -> BoundedRobustPD:
        """The loop of some rows of a batch, with arrays as ζ and φ."""
        zeta, position_phi, rotation_phi = (
            np.asarray(value)[rows] for value in (self.zeta, *self.phi)
        )
        return replace(self, zeta=zeta, phi=(position_phi, rotation_phi))

    def bounds(self, acceleration: Array) -> tuple[Array, Array]:
        """ρ of positions and of angles, each (..., 1), for v₀, (..., n)."""
        position_phi, rotation_phi = self.phi
        position_count = len(self.gravity)
        pull = acceleration[..., :position_count] - self.gravity
        pull_norm = np.linalg.norm(pull, axis=-1, keepdims=True)
        position_bound = self.zeta * pull_norm + position_phi
        rotation_bound = np.full_like(position_bound, rotation_phi)
        return position_bound, rotation_bound

    def __call__(self, blocks: Blocks) -> Array:
        """The acceleration v, shape (..., n)."""
        error, rate = errors(blocks)
        omega = self.stiffness / 2
        soft_law = PD(gains=(omega**2, 2 * omega))
        acceleration = soft_law(blocks)
        error_weight = (self.stiffness + omega) / 2  # λ
        largest_slope = 2 * (self.stiffness - omega)  # κ
        switching = rate + error_weight * error
        position_count = len(self.gravity)
        groups = np.split(switching, [position_count], axis=-1)
        bounds = self.bounds(acceleration)
        robust_terms = []
        for s, bound in zip(groups, bounds, strict=True):
            length = np.linalg.norm(s, axis=-1, keepdims=True)
            length = np.maximum(length, bound / largest_slope)
            # Angles have the bound 0 if nothing turns the platform.
            length = np.maximum(length, 1e-12)
            robust_terms.append(bound / length * s)
        return acceleration + np.concatenate(robust_terms, axis=-1)


OuterLoop = PD | RobustPD | BoundedRobustPD


def errors(blocks: Blocks) -> tuple[Array, Array]:
    """Pose error e and velocity error ė, each (..., n)."""
    error = blocks["reference_pose"] - blocks["pose"]
    rate = blocks["reference_velocity"] - blocks["velocity"]
    return error, rate


def _error_states(blocks: Blocks) -> Array:
    """(e, ė) of each coordinate, (..., n, 2)."""
    return np.stack(errors(blocks), axis=-1)
