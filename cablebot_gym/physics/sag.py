"""Sag of heavy cables, which the straight cables of the model leave out: catenary and the
platform's pose.

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

_LEAST_EXCESS = 1e-10
"""Least extra length of a cable at its tension at rest in :func:`settle`, as a fraction of its chord.
A plumb cable has none: without it, nothing would relate its tension to its length."""

_HALVINGS = 50
"""Largest number of halvings of a step of :func:`settle`."""

_NOT_SETTLED = "no equilibrium on sagging cables was found: raise minimum_tension"


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
        tension: T, shape (...) [N]; ≥ 0.
        weight: w, shape (...) [N/m]; ≥ 0.

    Raises:
        ValueError: if a number is not finite.
    """
    _check_finite(across=across, rise=rise, tension=tension, weight=weight)
    tension = np.asarray(tension, float)
    weight = np.asarray(weight, float)
    across, height, tension, weight = np.broadcast_arrays(across, np.abs(rise), tension, weight)
    chord = np.hypot(across, height)
    # infinite without tension, and where sinh μ overflows
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        # With a = H/w, μ = d/(2a): the length is √(h² + (d sinh μ/μ)²), and the slope in the middle
        # is sinh ξ.
        ratio = weight * chord / (2 * tension)  # μ, because H = T d/chord
        longer = _sinh_excess(ratio) / np.where(ratio > 0, ratio, 1.0)  # sinh μ/μ − 1
        stretched = across * (1 + longer)
        both_lengths = np.hypot(height, stretched) + chord  # of cable and chord
        # length − chord without cancellation
        extra = across * longer * ((stretched + across) / both_lengths)
        # The cable is furthest from the chord where its slope is that of the chord, h/d = sinh ξ′.
        # This point is a (ξ′ − ξ) from the middle, nearer to the upper end, and
        # sinh(ξ′ − ξ) = h (length − chord)/(d² sinh μ/μ).
        shift = np.arcsinh(height * (longer / (1 + longer)) * ((2 + longer) / both_lengths))
        to_upper_end = ratio - shift  # in units of a
        # Gap between chord and cable, from the upper end, with a cosh ξ′ = T/w
        gap = 2 * np.sinh(to_upper_end / 2) ** 2
        gap = gap + height / chord * _sinh_excess(to_upper_end)
        sag = tension / np.where(weight > 0, weight, 1.0) * gap * across / chord
    is_too_long = ~np.isfinite(stretched)
    return np.where(is_too_long, np.inf, sag), np.where(is_too_long, np.inf, extra)


def sag(robot: Robot, pose: ArrayLike, tensions: ArrayLike) -> Sag:
    """Sag of a robot's cables at poses (..., n) with tensions T (..., m); without the radius of
    swivel pulleys."""
    _check_finite(tensions=tensions)
    tensions = np.asarray(tensions, float)
    across, rise = _chords(robot, pose)
    weight = _weights(robot)
    depth, extra = catenary(across, rise, tensions, weight)
    stiffness = np.full(robot.cables, np.inf)
    if robot.elastic:
        stiffness = robot.axial_stiffness
    with np.errstate(divide="ignore", invalid="ignore"):  # cables without tension or weight
        bending = (weight * across / tensions) ** 2
        irvine = np.where(bending > 0, bending * stiffness / tensions, 0.0)
    length = np.broadcast_to(np.hypot(across, rise), tensions.shape)
    return Sag(length=length, sag=depth, extra_length=extra, irvine=irvine)


def _chords(robot: Robot, pose: ArrayLike) -> tuple[Array, Array]:
    """Horizontal and vertical distance of the ends of the cables, each (..., m) [m]."""
    vectors = kinematics.cable_vectors(robot.base, robot.platform, pose)
    rise = vectors[..., -1]
    if _is_level(robot):
        return np.linalg.norm(vectors, axis=-1), np.zeros_like(rise)
    return np.linalg.norm(vectors[..., :-1], axis=-1), rise


def _is_level(robot: Robot) -> bool:
    """Whether the robot moves in a horizontal plane, from which its cables sag."""
    return robot.planar and robot.plane == "horizontal"


def _weights(robot: Robot) -> Array:
    """Weight of the cables per length, shape (m,) [N/m]."""
    gravity = robot.gravity
    if _is_level(robot):
        gravity = GRAVITY
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
    chord = np.hypot(across, rise)
    weight = _weights(robot)
    sagging = (weight * across) ** 2 * chord / 24  # extra length times T²
    if not np.any(sagging):
        return Settled(pose_change=np.zeros_like(pose), tensions=straight)
    if not straight.min() > 0:
        raise ValueError(_NOT_SETTLED)
    sagging = np.maximum(sagging, _LEAST_EXCESS * chord * straight**2)
    compliance = np.zeros(robot.cables)
    if robot.elastic:
        compliance = chord / robot.axial_stiffness
    change = np.zeros_like(pose)
    load = textbook.bias(robot, mass, pose, change)
    load = load + _cable_weight(robot, pose, weight * chord / 2)

    def tensions_of(stretch: Array) -> Array:
        """Tensions of chords that are longer by ``stretch``, by bisection of their logarithms."""
        low = np.full(robot.cables, -20.0)
        high = np.full(robot.cables, 30.0)
        for _ in range(100):
            middle = (low + high) / 2
            tension = np.exp(middle)
            is_low = (tension - straight) * compliance - sagging / tension**2 < stretch
            low = np.where(is_low, middle, low)
            high = np.where(is_low, high, middle)
        return np.exp((low + high) / 2)

    tension = tensions_of(np.zeros(robot.cables))
    unbalanced = load + structure.T @ tension
    tolerance = 1e-9 * float(np.linalg.norm(load))
    for _ in range(200):
        residual = np.linalg.norm(unbalanced)
        if residual < tolerance:
            return Settled(pose_change=change, tensions=tension)
        stiffness = 1 / (compliance + 2 * sagging / tension**3)  # of each cable
        step = np.linalg.solve(structure.T @ (stiffness[:, None] * structure), -unbalanced)
        for _ in range(_HALVINGS):  # the residual falls along a short enough step
            tension = tensions_of(structure @ (change + step))
            unbalanced = load + structure.T @ tension
            if np.linalg.norm(unbalanced) < residual:
                break
            step = step / 2
        else:  # also if the step is not finite
            break
        change = change + step
    raise ValueError(_NOT_SETTLED)


def _cable_weight(robot: Robot, pose: Array, half: Array) -> Array:
    """Required generalised force of weights at the platform anchors, shape (n,)."""
    d = robot.dimensions
    force = np.zeros((robot.cables, d))
    if not _is_level(robot):
        force[:, -1] = half
    load = np.zeros(robot.coordinates)
    load[:d] = -force.sum(axis=0)
    if robot.point_mass:
        return load
    arms = kinematics.turned(pose, robot.platform)
    if robot.planar:
        load[2] = -np.sum(arms[:, 0] * force[:, 1] - arms[:, 1] * force[:, 0])
        return load
    euler = pose[3:]
    moment = np.cross(arms, force).sum(axis=0)
    moment_in_frame = kinematics.rotation_matrix(euler).T @ moment
    load[3:] = -kinematics.euler_rate_matrix(euler).T @ moment_in_frame
    return load
