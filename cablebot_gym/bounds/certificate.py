"""Certificate of an upper payload bound for planar robots: a proof that no motion and no inputs
carry more. A maximum tension excludes further motions, so the proof holds for robots with one, too.

**Statement.** A rigid planar robot starts at the pose and velocity of the reference. Consider all
motions that stay within R of the reference ``p_d`` at every time, with all tensions T ≥ T₀, the
robot's minimum tension, and motors below their torque-speed lines. No such motion has a total mass
above ``total_mass``. The statement makes no assumption about the speed or acceleration of the
motion.

**Proof.** Let M be the total mass, ``q_i`` the lengths of the cables and ``d_i`` their directions
from the platform to the anchors. Let F_i = T_i − T₀ and ``D = Σ d_i``. Equations 1 and 37 give ``M
p̈ = Σ F_i d_i + T₀ D`` and, as ``β̇ = −q̇/r``,

    0 ≤ F_i ≤ s_i + k_i q̇_i + μ_i q̈_i,  s = (τ_s + τ_c)/r − T₀,  k = (τ_s/ω_n + c)/r²,  μ = J/r²,                (1)

where Coulomb friction τ_c helps a motor to hold a cable that unwinds.

Choose *any* functions of time, w(t) in the plane and φ_i(t) ≥ 0, with

    φ_i(t) ≥ w(t)·d_i(p)  for every p within R of p_d(t).                                                          (2)

As F_i ≥ 0, every motion satisfies ``M ∫ w·p̈ − T₀ ∫ w·D = ∫ Σ F_i w·d_i ≤ ∫ Σ F_i φ_i ≤ ∫ Σ φ_i
(s_i + k_i q̇_i + μ_i q̈_i)``. Let w, φ and their rates vanish at the end. Let them also vanish at
their start, unless that is t = 0, where pose and velocity are known. Integration by parts until
only positions remain gives, with ``b_i = μ_i φ̈_i − k_i φ̇_i``,

    M (ẇ(0)·p(0) − w(0)·ṗ(0) + ∫ ẅ·p) − Σ (∫ s_i φ_i + μ_i (φ̇_i(0) q_i(0) − φ_i(0) q̇_i(0)) − k_i φ_i(0) q_i(0)
      + ∫ b_i q_i) − T₀ ∫ w·D(p) ≤ 0.                                                                              (3)

Positions are known up to the tube. With ``p = p_d + e``, |e| ≤ R and u_i = −d_i(p_d), geometry
gives ``0 ≤ q_i(p) − q_i(p_d) − u_i·e ≤ q_i − √(q_i² − R²) =: κ_i`` and ``|D(p) − D(p_d)| ≤ R Σ
1/(q_i − R)``. Hence the left side of (3) is at least

    h(M) = [the same at p_d, without T₀ ∫ w·D] − ∫ (R |M ẅ − Σ b_i u_i| + Σ max(b_i, 0) κ_i) dt + min(g, 0)        (4)

with ``g = −T₀ ∫ (w·D(p_d) + |w| R Σ 1/(q_i − R)) dt``. If h(M) > 0, no motion carries M. No motion
carries a larger mass c M either: w/c and φ satisfy (2) as well, and with them only g changes in
(4), to g/c. The certificate is the zero of the concave function h.

**Quadrature.** w and φ are quadratic splines, C¹. Between instants η apart, p_d is replaced by its
chord, and R by ``R + max|p̈_d| η²/8``. The remaining functions have a known curvature along
straight lines. A function differs from its chord by at most η²/8 times its largest second
derivative. With speed V of the chord and a cable no shorter than ρ, a direction turns at a rate of
at most V/ρ, its second derivative is at most √(4/3) V²/ρ², and q̈ is in [0, V²/ρ].
:func:`proved_mass` applies each estimate conservatively and neglects only rounding. Condition (2)
has a closed form: over a disc of radius R at distance q, a direction turns by up to arcsin(R/q).

**Choice of w and φ.** For given M, the maximum of h subject to ∫ w·p̈_d = 1 is a second-order cone
program. It is solved as a linear program in which polygons replace circles. The accuracy of its
solution does not affect the proof. M is lowered until h vanishes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.optimize import brentq, linprog, minimize_scalar

from cablebot_gym.bounds.tube import ACCELERATION_FACTOR, REFINEMENT, Tube, norm, quadratic_splines
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.statics import hold_payload
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, find_error_bounds
from cablebot_gym.trajectories import Trajectory, find_trajectory
from cablebot_gym.utils.checks import whole

_COARSE, _FINE = 80, 160
"""Number of intervals between knots: on the full motion, and on the support of the first
multiplier."""
_DIRECTIONS = 24
"""Number of corners of the polygon that approximates a circle in the linear program."""
_ENOUGH = 1e-3
"""Relative improvement below which the search stops."""
_TRIALS = 12
"""Largest number of linear programs in a pass."""
_ROUNDING = 1e-12
"""Fraction of the largest w below which a coefficient counts as zero."""
_HEAVIEST = 1e12
"""Largest mass in the search [kg]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Multiplier:
    """The functions w and φ of a proof, as quadratic splines on N equal intervals."""

    start: float
    """First knot [s]."""
    end: float
    """Last knot [s]."""
    force: Array
    """Coefficients of w, (N + 2, 2)."""
    tension: Array
    """Coefficients of φ, (N + 2, m)."""

    def __call__(self, times: Array) -> tuple[Array, Array]:
        """``(w, ẇ, ẅ)`` of shape (3, …, 2) and ``(φ, φ̇, φ̈)`` of shape (3, …, m) at times of shape
        (…). At knots ẅ and φ̈ are the limits from the right. All values are zero outside the
        knots."""
        intervals = len(self.force) - 2
        width = (self.end - self.start) / intervals
        position = (np.asarray(times, float) - self.start) / width
        interval = np.clip(np.floor(position).astype(int), 0, intervals - 1)
        inside = ((position >= 0) & (position <= intervals))[..., None]
        # (3, 3, …): derivative, coefficient
        at = np.stack(quadratic_splines(position - interval, width))

        def values(coefficients: Array) -> Array:
            local = np.stack([coefficients[interval + j] for j in range(3)])
            return np.where(inside, np.einsum("dc...,c...i->d...i", at, local), 0.0)

        return values(self.force), values(self.tension)


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate:
    """Proved upper bound of the mass. The module docstring has the statement and the proof."""

    total_mass: float
    """Upper bound of the mass of platform and payload [kg]; ``inf`` if no mass is excluded."""
    platform_mass: float
    """Mass of the platform [kg]."""
    error_bounds: ErrorBounds
    """Bounds of the tracking error; the position bound is R."""
    conditions: str
    """Assumptions of the proof, as text."""
    method: str
    """Method of the proof, as text."""
    multiplier: Multiplier | None
    """Multiplier of the proof: ``proved_mass(robot, trajectory, error_bounds, multiplier)`` returns
    ``total_mass``. None without proof, or if the proof needs none."""

    @property
    def payload(self) -> float:
        """Upper bound of the payload [kg]; negative if the motion is infeasible even unloaded."""
        return self.total_mass - self.platform_mass

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data without the multiplier. Infinite masses are None."""
        return {
            "total_mass": self.total_mass if math.isfinite(self.total_mass) else None,
            "payload": self.payload if math.isfinite(self.payload) else None,
            # the rotation bound has no effect
            "error_bounds": {"position": self.error_bounds.position},
            "conditions": self.conditions,
            "method": self.method,
        }


CONDITIONS = (
    "the nominal rigid robot without disturbances, started at the start pose; minimum tension, errors and torque-speed "
    f"lines kept at every instant; a reference whose acceleration, between samples, stays below {ACCELERATION_FACTOR} "
    "times the largest one sampled"
)
METHOD = "duality: multipliers in time for force balance and torque-speed lines, integrated by parts to positions"


HOLD_CONDITIONS = "the nominal robot at rest at the start pose, where each motor torque is at most the stall torque"
HOLD_METHOD = "hold: static torques at the start pose"


def upper_bound(
    robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds | dict[str, float] | None = None
) -> Certificate:
    """Computes an upper bound of the mass: that of :func:`planar_certificate` for a planar rigid
    robot.

    For the other robots, it is the mass that the motors hold at rest at the start pose, in closed
    form. It is ``inf`` if the motion does not start at rest, or if the static torques do not depend
    on the mass (planar).

    Args:
        robot: any robot.
        trajectory: reference motion for this kind of robot.
        error_bounds: bounds of the tracking error; None for the default.

    Raises:
        ValueError: if an argument is invalid, or if the tube of a planar rigid robot reaches an
            anchor.
    """
    if robot.kind == "planar" and robot.weightless and not robot.flexible:
        return planar_certificate(robot, trajectory, error_bounds)
    trajectory = find_trajectory(trajectory, robot.kind)
    error_bounds = find_error_bounds(error_bounds, robot)
    return Certificate(
        total_mass=robot.mass + hold_payload(robot, trajectory, error_bounds),
        platform_mass=robot.mass,
        error_bounds=error_bounds,
        conditions=HOLD_CONDITIONS,
        method=HOLD_METHOD,
        multiplier=None,
    )


def planar_certificate(
    robot: Robot,
    trajectory: Trajectory,
    error_bounds: ErrorBounds | dict[str, float] | None = None,
    *,
    passes: int = 3,
) -> Certificate:
    """Computes a mass that no motion and no inputs of a planar robot exceed within the limits.

    The module docstring has the statement and the proof.

    Args:
        robot: a planar robot with a rigid transmission.
        trajectory: reference motion of a planar robot.
        error_bounds: bound R of the position error; None for the default.
        passes: number of refinements of the knots, a few seconds each; ≥ 1. One pass gives a valid,
            looser bound.

    Raises:
        ValueError: if an argument is invalid, if the tube reaches an anchor, or if no certificate
            is known for this kind of robot.
    """
    trajectory, error_bounds = _checked(robot, trajectory, error_bounds)
    passes = whole("passes", passes, least=1)
    best = None
    total_mass = math.inf
    for multiplier in _multipliers(robot, trajectory, error_bounds, passes):
        best = multiplier
    if best is not None:
        total_mass = proved_mass(robot, trajectory, error_bounds, best)
    return Certificate(
        total_mass=total_mass,
        platform_mass=robot.mass,
        error_bounds=error_bounds,
        conditions=CONDITIONS,
        method=METHOD,
        multiplier=best,
    )


def proved_mass(
    robot: Robot,
    trajectory: Trajectory,
    error_bounds: ErrorBounds | dict[str, float] | None,
    multiplier: Multiplier,
) -> float:
    """Total mass above which a multiplier excludes every motion [kg]; ``inf`` if it excludes no
    mass.

    Args:
        robot: a planar robot with a rigid transmission.
        trajectory: reference motion of a planar robot.
        error_bounds: bound R of the position error; None for the default.
        multiplier: any multiplier. The function checks condition (2) and the zeros at the ends.

    Raises:
        ValueError: as in :func:`planar_certificate`, or if a knot of the multiplier is outside the
            motion.
    """
    trajectory, error_bounds = _checked(robot, trajectory, error_bounds)
    if not 0 <= multiplier.start < multiplier.end <= trajectory.duration:
        raise ValueError(
            f"the knots of the multiplier must lie within the motion, 0 to {trajectory.duration:g} s"
        )
    intervals = len(multiplier.force) - 2
    tube = Tube(robot, trajectory, error_bounds, multiplier.start, multiplier.end, intervals)
    return _zero(tube, multiplier.force, multiplier.tension)


def _checked(
    robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds | dict[str, float] | None
) -> tuple[Trajectory, ErrorBounds]:
    if robot.kind != "planar" or not robot.weightless or robot.flexible:
        raise ValueError(
            f"a certificate is only available for planar rigid robots, not for {robot.name!r}"
        )
    if np.any(robot.load_friction):
        raise ValueError("no certificate is known with load_friction: set it to 0")
    return find_trajectory(trajectory, robot.kind), find_error_bounds(error_bounds, robot)


def _zero(tube: Tube, force: Array, tension: Array) -> float:
    """The mass at which h becomes positive; ``inf`` if there is none or if (2) is violated."""
    if np.any(force[~tube.free_force]) or np.any(tension[~tube.free_tension]):
        return math.inf
    if np.any(tension < 0) or np.any(tube.deficits(force, tension) > 0):
        return math.inf
    if tube.surplus(0.0, force, tension) > 0:
        return 0.0
    high = 1.0

    def surplus(mass: float) -> float:
        return tube.surplus(mass, force, tension)

    while surplus(2 * high) > surplus(high) and high < _HEAVIEST:
        high *= 2
    # h is concave, so its maximum is at most one doubling away.
    top = minimize_scalar(lambda mass: -surplus(mass), bounds=(high / 2, 2 * high)).x
    if surplus(top) <= 0:
        return math.inf
    return float(brentq(surplus, 0.0, top, rtol=1e-12))


def _lifted(tube: Tube, force: Array, tension: Array) -> Array:
    """Raises the coefficients of φ, approximately as little as possible, until (2) holds
    everywhere."""
    for _ in range(50):
        deficits = tube.deficits(force, tension)
        deficit = deficits.reshape(tube.intervals, REFINEMENT, -1).max(axis=1)
        if np.all(deficit <= 0):
            break
        # A small surplus, because rounding would cancel a small lift.
        surplus = _ROUNDING * np.abs(force).max()
        lift = np.where(deficit > 0, deficit * (1 + 1e-6) + surplus, 0.0)
        # Coefficient j acts on intervals j - 2 to j.
        padded = np.pad(lift, ((2, 2), (0, 0)))
        raised = np.max([padded[j : j + tube.intervals + 2] for j in range(3)], axis=0)
        tension = tension + np.where(tube.free_tension[:, None], raised, 0.0)
    return tension


def _multipliers(
    robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds, passes: int
) -> Iterator[Multiplier]:
    """Multipliers with decreasing bounds: first on the full motion, then on fine knots over the
    support of w."""
    start = 0.0
    end = float(trajectory.duration)
    intervals = _COARSE
    mass = math.inf
    for _ in range(passes):
        tube = Tube(robot, trajectory, error_bounds, start, end, intervals)
        before = mass
        mass, multiplier = _best(tube, mass)
        if multiplier is None:
            return
        yield multiplier
        if mass > before * (1 - _ENOUGH):
            return
        weight = norm(multiplier.force)
        # coefficient j acts on intervals j - 2 to j
        used = np.flatnonzero(weight > 1e-3 * weight.max())
        start = max(0.0, start + float(used[0] - 8) * tube.width)
        end = min(end, multiplier.start + float(used[-1] + 6) * tube.width)
        intervals = _FINE


def _best(tube: Tube, mass: float) -> tuple[float, Multiplier | None]:
    """The least bound of a multiplier on the knots of the tube, and the multiplier; None if not
    below ``mass``."""
    if tube.acceleration == 0:  # a reference at rest excludes no mass
        return mass, None
    program = _LinearProgram(tube)
    multiplier = None
    # The optimal multiplier of a trial mass also proves a bound, which is usually close to the best
    # one.
    trial = mass
    if not math.isfinite(mass):
        trial = float(np.sum(tube.pull)) / tube.acceleration
    for _ in range(_TRIALS):
        solution = program.solve(trial)
        proved = math.inf
        if solution is not None:
            force = solution[0]
            tension = _lifted(tube, *solution)
            proved = _zero(tube, force, tension)
        if proved < mass:
            before = mass
            mass = proved
            multiplier = Multiplier(start=tube.start, end=tube.end, force=force, tension=tension)
            trial = mass
            if mass > before * (1 - _ENOUGH):
                break
        elif math.isfinite(mass):
            break
        else:
            trial *= 4
    return mass, multiplier


class _LinearProgram:
    """Linear program of a tube. Its variables are the coefficients of w and φ, and |ψ| at the
    middle of each interval.

    ψ = ẅ − Σ b_i u_i / M is scaled by the squared width of an interval, so that it has the
    magnitude of w.
    """

    def __init__(self, tube: Tube) -> None:
        self.tube = tube
        n = tube.intervals
        m = tube.robot.cables
        middle = REFINEMENT // 2
        self.second = tube.width**2 * self._table(2, middle)
        self.rate = tube.width**2 * self._table(1, middle)
        self.away = tube.away[middle::REFINEMENT][:n]
        rows = []
        for point in range(0, REFINEMENT, 2):
            value = self._table(0, point)
            at = np.arange(n) * REFINEMENT + point
            towards = -tube.away[at]
            arc = tube.arc[at][..., None]
            normal = np.stack([-towards[..., 1], towards[..., 0]], axis=-1)
            along = towards * np.cos(arc)
            across = normal * np.sin(arc)
            # The hull of an arc of directions lies in the hull of its ends and the intersection of
            # its tangents.
            corners = (along + across, along - across, towards / np.cos(arc))
            for corner in corners:
                for i in range(m):
                    x, y = corner[:, i].T
                    force_x = sparse.diags_array(x) @ value
                    force_y = sparse.diags_array(y) @ value
                    tension: list[Any] = [None] * m
                    tension[i] = -value
                    rows.append([force_x, force_y, *tension, sparse.csr_array((n, n))])
        self.cone = sparse.block_array(rows, format="csr")

    def _table(self, derivative: int, point: int) -> Any:
        """Matrix from coefficients to a derivative at one point of each interval, (N, N + 2)."""
        n = self.tube.intervals
        local = self.tube.splines[derivative, :, point]
        return sparse.diags_array(
            [np.full(n, x) for x in local], offsets=[0, 1, 2], shape=(n, n + 2), format="csr"
        )

    def solve(self, mass: float) -> tuple[Array, Array] | None:
        """Coefficients of w and φ that approximately maximise h(M); None if the program is
        infeasible."""
        tube = self.tube
        n = tube.intervals
        m = tube.robot.cables
        angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        rows = []
        for x, y in zip(np.cos(angles), np.sin(angles), strict=True):
            along = self.away @ np.array([x, y])
            row = [x * self.second, y * self.second]
            for i in range(m):
                b = tube.inertia[i] * self.second - tube.slope[i] * self.rate
                row.append(sparse.diags_array(-along[:, i] / mass) @ b)
            rows.append([*row, -sparse.eye_array(n)])
        psi_rows = sparse.block_array(rows, format="csr")
        inequalities: Any = sparse.vstack([psi_rows, self.cone], format="csr")
        force_gain = tube.force - tube.robot.minimum_tension / mass * tube.towards
        tension_gain = tube.tension.T.ravel() / mass
        psi_gain = np.full(n, -tube.radius / tube.width)
        gain = np.concatenate([force_gain.T.ravel(), tension_gain, psi_gain])
        # The scale of the multiplier: the functional of w is 1.
        split = 2 * (n + 2)
        scaled = np.zeros_like(gain)
        scaled[:split] = tube.force.T.ravel()
        free = np.concatenate([tube.free_force] * 2 + [tube.free_tension] * m + [np.ones(n, bool)])
        upper = np.where(free, np.inf, 0.0)
        lower = np.zeros_like(upper)
        lower[:split] = -upper[:split]  # only w may be negative
        bounds: Any = np.stack([lower, upper], axis=-1)
        solution = linprog(
            -gain,
            A_ub=inequalities,
            b_ub=np.zeros(inequalities.shape[0]),
            A_eq=scaled[None],
            b_eq=[1.0],
            bounds=bounds,
            method="highs-ipm",
        )
        if solution.x is None:
            return None
        force = solution.x[:split].reshape(2, -1).T
        tension = solution.x[split:-n].reshape(m, -1).T
        noise = np.abs(force) < _ROUNDING * np.abs(force).max()
        force = np.where(tube.free_force[:, None] & ~noise, force, 0.0)
        tension = np.where(tube.free_tension[:, None], np.maximum(tension, 0.0), 0.0)
        return force, tension
