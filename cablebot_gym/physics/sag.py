"""Sag of heavy cables, which the straight cables of the model leave out: catenary, parabola, and
the platform's pose.

T is the component of the tension along the chord between the ends of a cable, w the weight per
length [N/m], and θ the inclination of the chord. The horizontal force is ``T cos θ``. Only the
component ``w cos θ`` bends the cable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym import kinematics
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import GRAVITY, Robot
from cablebot_gym.utils.checks import all_finite


@dataclass(frozen=True, kw_only=True, eq=False)
class Sag:
    """Sag of cables; each array has the shape of the tensions."""

    length: Array
    """Length of the chord [m]."""
    sag: Array
    """Largest distance between cable and chord [m]."""
    extra_length: Array
    """Length of the cable minus that of the chord [m]."""
    irvine: Array
    """Irvine's parameter λ² = (w cos θ L/T)² EA/T; infinite if the cable does not stretch."""

    @property
    def stiffness_factor(self) -> Array:
        """Stiffness of the cable over that of a straight one, 1/(1 + λ²/12)."""
        factor: Array = 1 / (1 + self.irvine / 12)
        return factor


def _check_finite(**arguments: ArrayLike) -> None:
    for name, values in arguments.items():
        all_finite(name, values)


def _sinh_excess(x: Array) -> Array:
    """sinh x − x for x ≥ 0, without cancellation."""
    square = x**2
    series = x * square / 6 * (1 + square / 20 * (1 + square / 42))
    return np.where(x < 0.05, series, np.sinh(x) - x)


def catenary(
    across: ArrayLike, rise: ArrayLike, tension: ArrayLike, weight: ArrayLike
) -> tuple[Array, Array]:
    """Largest distance between cable and chord, and extra length [m] of a catenary that does not
    stretch.

    Args:
        across: horizontal distance d of the ends, shape (...) [m]; ≥ 0.
        rise: vertical distance h of the ends, shape (...) [m].
        tension: T, shape (...) [N]; > 0.
        weight: w, shape (...) [N/m]; ≥ 0.

    Raises:
        ValueError: if a number is not finite.
    """
    _check_finite(across=across, rise=rise, tension=tension, weight=weight)
    across, rise, tension, weight = np.broadcast_arrays(
        *(np.asarray(a, float) for a in (across, rise, tension, weight))
    )
    height = np.abs(rise)
    chord = np.hypot(across, height)
    # With a = H/w, μ = d/(2a): the length is √(h² + (d sinh μ/μ)²), and the slope in the middle is
    # sinh ξ.
    ratio = weight * chord / (2 * tension)  # μ, because H = T d/chord
    with np.errstate(over="ignore", invalid="ignore"):  # infinite where sinh μ overflows
        longer = _sinh_excess(ratio) / np.where(ratio > 0, ratio, 1.0)  # sinh μ/μ − 1
        stretched = across * (1 + longer)
        length = np.hypot(height, stretched)
        # length − chord without cancellation
        extra = across * longer * ((stretched + across) / (length + chord))
        # The cable is furthest from the chord where its slope is that of the chord, h/d = sinh ξ′.
        # This point is a (ξ′ − ξ) from the middle, nearer to the upper end, and
        # sinh(ξ′ − ξ) = h (length − chord)/(d² sinh μ/μ).
        shift = np.arcsinh(height * (longer / (1 + longer)) * ((2 + longer) / (length + chord)))
        to_upper_end = ratio - shift  # in units of a
        # Gap between chord and cable, from the upper end, with a cosh ξ′ = T/w
        gap = 2 * np.sinh(to_upper_end / 2) ** 2
        gap = gap + height / chord * _sinh_excess(to_upper_end)
        sag = tension / np.where(weight > 0, weight, 1.0) * gap * across / chord
    is_cable = np.isfinite(stretched)
    return np.where(is_cable, sag, np.inf), np.where(is_cable, extra, np.inf)


def parabola(
    across: ArrayLike, rise: ArrayLike, tension: ArrayLike, weight: ArrayLike
) -> tuple[Array, Array]:
    """Sag and extra length [m] of the parabola, ``w cos θ L²/(8 T)`` and ``(w cos θ)² L³/(24 T²)``.

    The limit of :func:`catenary`, with the same arguments, for ``w L ≪ T``.
    """
    _check_finite(across=across, rise=rise, tension=tension, weight=weight)
    across, rise, tension = (np.asarray(a, float) for a in (across, rise, tension))
    chord = np.hypot(across, rise)
    normal = np.asarray(weight, float) * across / chord
    return normal * chord**2 / (8 * tension), normal**2 * chord**3 / (24 * tension**2)


def sag(robot: Robot, pose: ArrayLike, tensions: ArrayLike) -> Sag:
    """Sag of a robot's cables at poses (..., n) with tensions T (..., m); without the radius of
    swivel pulleys."""
    _check_finite(tensions=tensions)
    tensions = np.asarray(tensions, float)
    across, rise = _chords(robot, pose)
    chord, weight = np.hypot(across, rise), _weights(robot)
    depth, extra = catenary(across, rise, tensions, weight)
    bending = (weight * across / tensions) ** 2
    stiffness = robot.axial_stiffness if robot.elastic else np.full(robot.cables, np.inf)
    with np.errstate(invalid="ignore"):
        irvine = np.where(bending > 0, bending * stiffness / tensions, 0.0)
    length = np.broadcast_to(chord, tensions.shape)
    return Sag(length=length, sag=depth, extra_length=extra, irvine=irvine)


def _chords(robot: Robot, pose: ArrayLike) -> tuple[Array, Array]:
    """Horizontal and vertical distance of the ends of the cables, each (..., m) [m]."""
    vectors = kinematics.cable_vectors(robot.base, robot.platform, pose)
    if robot.planar and robot.plane == "horizontal":
        return np.linalg.norm(vectors, axis=-1), np.zeros(vectors.shape[:-1])
    return np.linalg.norm(vectors[..., :-1], axis=-1), vectors[..., -1]


def _weights(robot: Robot) -> Array:
    """Weight of the cables per length, shape (m,) [N/m]."""
    gravity = GRAVITY if robot.planar and robot.plane == "horizontal" else robot.gravity
    return gravity * robot.per_motor(robot.cable_density)


@dataclass(frozen=True, kw_only=True, eq=False)
class Settled:
    """Rest of a platform on sagging cables whose motors stand where straight cables would hold the
    pose."""

    pose_change: Array
    """Change of the pose, shape (n,) [m, rad]."""
    tensions: Array
    """Tensions of the sagging cables, shape (m,) [N]."""


def settle(robot: Robot, mass: float, pose: ArrayLike, tensions: ArrayLike) -> Settled:
    """Pose change and tensions at rest if the cables sag and weigh, by statics that are linear in
    the pose change.

    Half of the weight of each cable acts on its platform anchor. The chord of cable i becomes
    longer by ``e = (T − T⁰) L/EA − (w cos θ)² L³/(24 T²)``. This is a rising function of T, so the
    equilibrium is unique. The stiffness that comes from turning the tensions is left out.

    Args:
        robot: the robot, with or without elastic cables.
        mass: mass of platform and payload [kg].
        pose: X, shape (n,).
        tensions: tensions T⁰ of the straight cables at rest, shape (m,) [N]; > 0.

    Raises:
        ValueError: if no equilibrium is found, because cables hang nearly without tension.
    """
    _check_finite(mass=mass, pose=pose, tensions=tensions)
    pose = np.asarray(pose, float)
    straight = np.asarray(tensions, float)
    structure = textbook.jacobian(robot, pose)
    across, rise = _chords(robot, pose)
    chord, weight = np.hypot(across, rise), _weights(robot)
    bent = (weight * across) ** 2 * chord / 24
    soft = chord / robot.axial_stiffness if robot.elastic else np.zeros(robot.cables)
    load = textbook.bias(robot, mass, pose, np.zeros_like(pose)) + _cable_weight(
        robot, pose, weight * chord / 2
    )
    if not np.any(bent):
        return Settled(pose_change=np.zeros_like(pose), tensions=straight)

    def tension(stretch: Array) -> Array:
        low, high = np.full(robot.cables, -20.0), np.full(robot.cables, 30.0)  # of log T
        for _ in range(100):
            middle = (low + high) / 2
            value = np.exp(middle)
            longer = (value - straight) * soft - bent / value**2 < stretch
            low = np.where(longer, middle, low)
            high = np.where(longer, high, middle)
        return np.exp((low + high) / 2)

    found = tension(np.zeros(robot.cables))
    change = np.zeros_like(pose)
    scale = float(np.linalg.norm(load))
    for _ in range(200):
        missing = load + structure.T @ found
        if np.linalg.norm(missing) < 1e-9 * scale:
            return Settled(pose_change=change, tensions=found)
        rates = 1 / (soft + 2 * bent / found**3)
        step = np.linalg.solve(structure.T @ (rates[:, None] * structure), -missing)
        while True:  # the residual falls along a short enough step
            trial = tension(structure @ (change + step))
            if (
                np.linalg.norm(load + structure.T @ trial) < np.linalg.norm(missing)
                or np.abs(step).max() < 1e-15
            ):
                break
            step = step / 2
        change, found = change + step, trial
    raise ValueError("no equilibrium on sagging cables was found: raise minimum_tension")


def _cable_weight(robot: Robot, pose: Array, half: Array) -> Array:
    """Required generalised force of weights at the platform anchors, shape (n,)."""
    d = robot.dimensions
    force = np.zeros((robot.cables, d))
    if not (robot.planar and robot.plane == "horizontal"):
        force[:, -1] = half
    load = np.zeros(robot.coordinates)
    load[:d] = -force.sum(axis=0)
    if robot.kind == "spatial":
        arms = kinematics.turned(pose, robot.platform)
        turned = kinematics.rotation_matrix(pose[3:]).T @ np.cross(arms, force).sum(axis=0)
        load[3:] = -kinematics.euler_rate_matrix(pose[3:]).T @ turned
    elif robot.kind == "planar-platform":
        arms = kinematics.turned(pose, robot.platform)
        load[2] = -np.sum(arms[:, 0] * force[:, 1] - arms[:, 1] * force[:, 0])
    return load
