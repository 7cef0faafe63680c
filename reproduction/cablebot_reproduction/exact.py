"""Largest payloads without simulation under a chosen interpretation.

The rigid robots use exact tracking. The flexible robot uses the state space of §3.3 of the paper
(Eqs. 23–25).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cablebot_gym.bounds.closed_form import GRID, ExactPayload, exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference, Trajectory, find_trajectory
from cablebot_reproduction.interpretation import Interpretation

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
    mass = robot.mass + payload
    tensions = _tensions(interpretation, robot, mass, motion)
    torques = textbook.required_torques(robot, tensions, *_state(motion))
    lower, upper = _rigid_limits(interpretation, robot, motion)
    return Profile(times=times, torques=torques, lower=lower, upper=upper)


def exact_limit(interpretation: Interpretation, robot: Robot) -> LargestPayload:
    """The largest payload of exact tracking with a rigid transmission."""
    if robot.planar and interpretation.alpha == "constant":
        return _largest_of_constant_alpha(interpretation, robot)
    bound = exact_bound(interpretation, robot)
    return LargestPayload(
        payload=bound.payload,
        motor=bound.motor,
        time=bound.time,
    )


def exact_bound(interpretation: Interpretation, robot: Robot, **keywords: Any) -> ExactPayload:
    """:func:`~cablebot_gym.bounds.closed_form.exact_payload` on the circle of the paper."""
    circle = paper_circle(robot)
    keywords["line_speed"] = interpretation.line_speed(robot)
    if robot.planar:
        keywords["minimum_tension"] = interpretation.minimum_tension
    return exact_payload(robot, circle, **keywords)


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
    mass = robot.mass + payload
    torques, speeds = _state_space(interpretation, robot, mass, times)
    lower, upper = textbook.torque_limits(robot, speeds)
    return Profile(times=times, torques=torques, lower=lower, upper=upper)


def state_space_limit(interpretation: Interpretation, robot: Robot) -> LargestPayload:
    """The largest payload of :func:`state_space_profile`. The torques are affine in the payload."""
    unloaded = state_space_profile(interpretation, robot, 0.0)
    loaded = state_space_profile(interpretation, robot, 1.0)
    unloaded_reserve = reserve(unloaded)
    loss = unloaded_reserve - reserve(loaded)
    with np.errstate(divide="ignore", invalid="ignore"):
        payloads = unloaded_reserve / loss
    payloads = np.where(loss > 0, payloads, np.inf)
    smallest = np.argmin(payloads)
    payload = payloads.flat[smallest]
    k, motor, _ = np.unravel_index(smallest, payloads.shape)
    return LargestPayload(
        payload=float(payload),
        motor=int(motor) + 1,
        time=_rounded(unloaded.times[k]),
    )


def reserve(profile: Profile) -> Array:
    """Distances of the torques to the upper and to the lower limit, (K, m, 2) [N·m]."""
    above = profile.upper - profile.torques
    below = profile.torques - profile.lower
    return np.stack([above, below], axis=-1)


def _times(robot: Robot) -> Array:
    """Instants of the whole motion. The middle, where the acceleration of the circle jumps, appears
    from both sides."""
    duration = paper_circle(robot).duration
    middle = round(GRID * duration / 2)
    count = 2 * middle
    spacing = duration / count
    grid = np.arange(count) * spacing
    after_jump = grid[middle] + 1e-9 * duration
    return np.insert(grid, middle + 1, after_jump)


def _state(motion: Reference) -> tuple[Array, Array, Array]:
    """Pose, velocity and acceleration, each (K, n): the arguments of the inverse dynamics."""
    return motion.position, motion.velocity, motion.acceleration


def _rigid_limits(
    interpretation: Interpretation, robot: Robot, motion: Reference
) -> tuple[Array, Array]:
    """Torque limits with a rigid transmission, each (K, m) [N·m]."""
    speed = textbook.pulley_speed(robot, motion.position, motion.velocity)
    line_speed = interpretation.line_speed(robot) * speed
    return textbook.torque_limits(robot, line_speed)


def _tensions(
    interpretation: Interpretation, robot: Robot, mass: float, motion: Reference
) -> Array:
    """Tensions of exact tracking, shape (K, m) [N]; a planar robot uses the interpretation of α."""
    minimum = interpretation.minimum_tension
    if robot.planar and interpretation.alpha == "constant":
        tensions = _ConstantAlpha(robot, motion, minimum)
        return tensions(mass)
    return textbook.required_tensions(robot, mass, *_state(motion), minimum=minimum)


class _ConstantAlpha:
    """Planar tensions ``T = M T_p + α N`` (Eq. 11) with the smallest constant α that keeps T_min at
    all instants."""

    def __init__(self, robot: Robot, motion: Reference, minimum: float) -> None:
        structure = textbook.jacobian(robot, motion.position)
        transposed = np.swapaxes(structure, -1, -2)
        inverse = np.linalg.pinv(transposed)
        self._particular = -np.einsum("kic,kc->ki", inverse, motion.acceleration)
        x_column = structure[..., 0]
        y_column = structure[..., 1]
        null = np.cross(x_column, y_column)
        length = np.linalg.norm(null, axis=-1, keepdims=True)
        total = null.sum(axis=-1, keepdims=True)
        self._null = null * np.sign(total) / length
        self._minimum = minimum

    def __call__(self, mass: float) -> Array:
        """Tensions T of a total mass, shape (K, 3) [N]."""
        tensions = mass * self._particular
        needed_alpha = (self._minimum - tensions) / self._null
        alpha = needed_alpha.max()
        return np.asarray(tensions + alpha * self._null)


def _largest_of_constant_alpha(interpretation: Interpretation, robot: Robot) -> LargestPayload:
    """Bisection for a constant α. The torque reserve of the motors is concave in the mass, but not
    affine."""
    times = _times(robot)
    motion = paper_circle(robot)(times)
    tensions = _ConstantAlpha(robot, motion, interpretation.minimum_tension)
    shape = (len(times), robot.cables)
    slack = np.zeros(shape)
    pulley_torques = textbook.required_torques(robot, slack, *_state(motion))
    lower, upper = _rigid_limits(interpretation, robot, motion)

    def overload(mass: float) -> Array:
        cable_torques = robot.pulley_radius * tensions(mass)
        torques = pulley_torques + cable_torques
        return np.maximum(torques - upper, lower - torques)

    def is_feasible(mass: float) -> bool:
        excess = overload(mass)
        return bool(excess.max() <= 0)

    largest_mass = 10 * robot.mass
    grid = np.linspace(0.0, largest_mass, 201)
    masses = grid[1:].tolist()
    for high in masses:
        if not is_feasible(high):
            break
    else:
        return LargestPayload(payload=np.inf, motor=None, time=None)
    index = masses.index(high)
    if index == 0:
        return LargestPayload(payload=-np.inf, motor=None, time=None)
    low = masses[index - 1]
    while high - low > 1e-9:
        middle = (low + high) / 2
        if is_feasible(middle):
            low = middle
        else:
            high = middle
    excess = overload(high)
    largest = np.argmax(excess)
    k, motor = np.unravel_index(largest, shape)
    return LargestPayload(
        payload=low - robot.mass,
        motor=int(motor) + 1,
        time=_rounded(times[k]),
    )


def _state_space(
    interpretation: Interpretation, robot: Robot, mass: float, times: Array
) -> tuple[Array, Array]:
    """Torques, and speeds for the torque-speed line of the interpretation, each of shape (K, m)."""
    motion = paper_circle(robot)(times)
    state = _state(motion)
    tensions = textbook.required_tensions(robot, mass, *state)
    kappa = textbook.required_torques(robot, tensions, *state)
    pulley_angle = textbook.pulley_angle(robot, motion.position)
    rest_angle = pulley_angle + kappa / robot.stiffness
    divisor = eq24_divisor(interpretation, robot)
    frequency = np.sqrt(robot.stiffness / divisor)
    angle, speed = _oscillation(rest_angle, frequency, times)
    effective_stiffness = robot.motor_inertia * robot.stiffness / divisor
    torques = kappa + effective_stiffness * (rest_angle - angle)
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
    angle = np.empty_like(goal)
    speed = np.zeros_like(goal)
    angle[0] = goal[0]
    for k, step in enumerate(np.diff(times)):
        next_goal = goal[k + 1]
        rate = (next_goal - goal[k]) / step
        offset = angle[k] - goal[k]
        drift = speed[k] - rate
        phase = frequency * step
        cosine = np.cos(phase)
        sine = np.sin(phase)
        sine_part = drift / frequency * sine
        angle[k + 1] = next_goal + offset * cosine + sine_part
        sine_rate = offset * frequency * sine
        speed[k + 1] = rate - sine_rate + drift * cosine
    return angle, speed


def _rounded(time: float) -> float:
    return round(float(time), 7)
