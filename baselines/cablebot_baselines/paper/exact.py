"""Largest payloads without simulation under a chosen interpretation.

The rigid robots use exact tracking. The flexible robot uses the state space of §3.3 of the paper
(Eqs. 23–25).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_gym.bounds.closed_form import GRID, ExactPayload, exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference, Trajectory, find_trajectory

COARSE = 100.0
"""Number of instants per second, each evaluated from both sides, for an exact payload accurate to
0.01 kg [Hz]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Profile:
    """Torques along the reference and their limits under an interpretation."""

    times: Array
    """Instants, shape (K,) [s]."""
    torques: Array
    """Torques τ, shape (K, m) [N·m]."""
    lower: Array
    """Lower torque limits U⁻, shape (K, m) [N·m]."""
    upper: Array
    """Upper torque limits U⁺, shape (K, m) [N·m]."""


@dataclass(frozen=True, kw_only=True)
class LargestPayload:
    """A largest payload and its limiting motor."""

    payload: float
    """Mass added to the platform [kg]. A negative value is the excess mass of the platform alone;
    -inf if no mass is feasible."""
    motor: int | None
    """Motor whose torque or tension reaches its limit, counted from 1; None if no limit exists."""
    time: float | None
    """Time of the violation [s]."""


def paper_circle(robot: Robot) -> Trajectory:
    """Circle of the paper for a robot (Tables 1 and 3)."""
    name = "paper-spatial"
    if robot.planar:
        name = "paper-planar"
    return find_trajectory(name, robot.coordinates)


def exact_profile(interpretation: Interpretation, robot: Robot, payload: float) -> Profile:
    """Torques of exact tracking with a rigid transmission."""
    times = _times(robot)
    motion = paper_circle(robot)(times)
    tensions = _tensions(interpretation, robot, robot.mass + payload, motion)
    torques = textbook.required_torques(
        robot, tensions, motion.position, motion.velocity, motion.acceleration
    )
    speed = interpretation.line_speed(robot) * textbook.pulley_speed(
        robot, motion.position, motion.velocity
    )
    lower, upper = textbook.torque_limits(robot, speed)
    return Profile(times=times, torques=torques, lower=lower, upper=upper)


def exact_limit(interpretation: Interpretation, robot: Robot) -> LargestPayload:
    """The largest payload of exact tracking with a rigid transmission."""
    if robot.planar and interpretation.alpha == "constant":
        return _searched(interpretation, robot)
    bound = exact_bound(interpretation, robot)
    return LargestPayload(payload=bound.payload, motor=bound.motor, time=bound.time)


def exact_bound(interpretation: Interpretation, robot: Robot, **keywords: Any) -> ExactPayload:
    """:func:`~cablebot_gym.bounds.closed_form.exact_payload` on the circle of the paper."""
    keywords["line_speed"] = interpretation.line_speed(robot)
    if robot.planar:
        keywords["minimum_tension"] = interpretation.minimum_tension
    return exact_payload(robot, paper_circle(robot), **keywords)


def state_space_profile(interpretation: Interpretation, robot: Robot, payload: float) -> Profile:
    """Torques of Eq. 22 with joint springs, by the paper's own state space.

    The platform is on the reference (Eq. 23). Eq. 24 gives the motor angles, starting from β̈′ =
    β̇′ = 0:

        β̈′ = (κ + K (β − β′)) / J′,   κ = r T + J β̈.

    The paper prints the divisor 1 + J′, but the units require J′. Eq. 22 gives the torques τ = κ +
    J′ β̈′. This oscillation has no damping, so a jump of κ excites a permanent oscillation. The
    paper may have computed its figures in this way, but no physical robot moves like this: by Eq.
    4, Eq. 24 corresponds to τ = κ, and with τ from Eq. 22, β̈′ cancels and no differential equation
    remains (docs/errata.md).

    The solution is exact for κ + K β that is linear between the instants.
    """
    times = _times(robot)
    torques, speeds = _state_space(interpretation, robot, robot.mass + payload, times)
    lower, upper = textbook.torque_limits(robot, speeds)
    return Profile(times=times, torques=torques, lower=lower, upper=upper)


def state_space_limit(interpretation: Interpretation, robot: Robot) -> LargestPayload:
    """The largest payload of :func:`state_space_profile`. The torques are affine in the payload."""
    empty = state_space_profile(interpretation, robot, 0.0)
    full = state_space_profile(interpretation, robot, 1.0)
    slope = reserve(empty) - reserve(full)
    with np.errstate(divide="ignore", invalid="ignore"):
        payloads = np.where(slope > 0, reserve(empty) / slope, np.inf)
    k, motor, _ = np.unravel_index(np.argmin(payloads), payloads.shape)
    return LargestPayload(
        payload=float(payloads[k, motor].min()), motor=int(motor) + 1, time=_rounded(empty.times[k])
    )


def reserve(profile: Profile) -> Array:
    """Distances of the torques to the upper and to the lower limit, (K, m, 2) [N·m]."""
    return np.stack([profile.upper - profile.torques, profile.torques - profile.lower], axis=-1)


def _times(robot: Robot) -> Array:
    """Instants of the whole motion. The middle, where the acceleration of the circle jumps, appears
    from both sides."""
    duration = paper_circle(robot).duration
    count = 2 * round(GRID * duration / 2)
    grid = np.arange(count) * (duration / count)
    middle = count // 2
    return np.insert(grid, middle + 1, grid[middle] + 1e-9 * duration)


def _tensions(
    interpretation: Interpretation, robot: Robot, mass: float, motion: Reference
) -> Array:
    """Tensions of exact tracking, shape (K, m) [N]; a planar robot uses the interpretation of α."""
    minimum = interpretation.minimum_tension
    if robot.planar and interpretation.alpha == "constant":
        return _ConstantAlpha(robot, motion, minimum)(mass)
    state = (motion.position, motion.velocity, motion.acceleration)
    return textbook.required_tensions(robot, mass, *state, minimum=minimum)


class _ConstantAlpha:
    """Planar tensions ``T = M T_p + α N`` (Eq. 11) with the smallest constant α that keeps T_min at
    all instants."""

    def __init__(self, robot: Robot, motion: Reference, minimum: float) -> None:
        structure = textbook.jacobian(robot, motion.position)
        inverse = np.linalg.pinv(np.swapaxes(structure, -1, -2))
        self._particular = -np.einsum("kic,kc->ki", inverse, motion.acceleration)
        null = np.cross(structure[..., 0], structure[..., 1])
        sign = np.sign(null.sum(axis=-1, keepdims=True))
        self._null = null * sign / np.linalg.norm(null, axis=-1, keepdims=True)
        self._minimum = minimum

    def __call__(self, mass: float) -> Array:
        """Tensions T of a total mass, shape (K, 3) [N]."""
        tensions = mass * self._particular
        alpha = ((self._minimum - tensions) / self._null).max()
        return np.asarray(tensions + alpha * self._null)


def _searched(interpretation: Interpretation, robot: Robot) -> LargestPayload:
    """Bisection for a constant α. The torque reserve of the motors is concave in the mass, but not
    affine."""
    times = _times(robot)
    motion = paper_circle(robot)(times)
    state = (motion.position, motion.velocity)
    tensions = _ConstantAlpha(robot, motion, interpretation.minimum_tension)
    slack = np.zeros((len(times), robot.cables))
    pulley_torques = textbook.required_torques(robot, slack, *state, motion.acceleration)
    speed = interpretation.line_speed(robot) * textbook.pulley_speed(robot, *state)
    lower, upper = textbook.torque_limits(robot, speed)

    def overload(mass: float) -> Array:
        torques = pulley_torques + robot.pulley_radius * tensions(mass)
        return np.maximum(torques - upper, lower - torques)

    masses = np.linspace(0.0, 10 * robot.mass, 201)[1:].tolist()
    overloaded = [mass for mass in masses if overload(mass).max() > 0]
    if not overloaded:
        return LargestPayload(payload=np.inf, motor=None, time=None)
    high = overloaded[0]
    if high == masses[0]:
        return LargestPayload(payload=-np.inf, motor=None, time=None)
    low = masses[masses.index(high) - 1]
    while high - low > 1e-9:
        middle = (low + high) / 2
        if overload(middle).max() > 0:
            high = middle
        else:
            low = middle
    k, motor = np.unravel_index(np.argmax(overload(high)), (len(times), robot.cables))
    return LargestPayload(payload=low - robot.mass, motor=int(motor) + 1, time=_rounded(times[k]))


def _state_space(
    interpretation: Interpretation, robot: Robot, mass: float, times: Array
) -> tuple[Array, Array]:
    """Torques, and speeds for the torque-speed line of the interpretation, each of shape (K, m)."""
    motion = paper_circle(robot)(times)
    state = (motion.position, motion.velocity, motion.acceleration)
    tensions = textbook.required_tensions(robot, mass, *state)
    spring = textbook.required_torques(robot, tensions, *state)
    rest_angle = textbook.pulley_angle(robot, motion.position) + spring / robot.stiffness  # β + κ/K
    divisor = eq24_divisor(interpretation, robot)
    angle, speed = _oscillation(rest_angle, np.sqrt(robot.stiffness / divisor), times)
    torques = spring + robot.motor_inertia * robot.stiffness / divisor * (rest_angle - angle)
    if interpretation.line not in ("physical", "reversed"):
        speed = textbook.pulley_speed(robot, motion.position, motion.velocity)
    return torques, interpretation.line_speed(robot) * speed


def eq24_divisor(interpretation: Interpretation, robot: Robot) -> Array:
    """J′, or 1 + J′ as printed, (m,)."""
    if interpretation.eq24 == "verbatim":
        return 1.0 + robot.motor_inertia
    return robot.motor_inertia


def _oscillation(goal: Array, frequency: Array, times: Array) -> tuple[Array, Array]:
    """Solves ẍ = ω² (g − x) from x = g and ẋ = 0 with g linear between the instants; returns x and
    ẋ, each (K, m)."""
    angle, speed = np.empty_like(goal), np.zeros_like(goal)
    angle[0] = goal[0]
    for k, step in enumerate(np.diff(times)):
        rate = (goal[k + 1] - goal[k]) / step
        offset = angle[k] - goal[k]
        drift = speed[k] - rate
        cosine = np.cos(frequency * step)
        sine = np.sin(frequency * step)
        angle[k + 1] = goal[k + 1] + offset * cosine + drift / frequency * sine
        speed[k + 1] = rate - offset * frequency * sine + drift * cosine
    return angle, speed


def _rounded(time: float) -> float:
    return round(float(time), 7)
