"""Largest payloads without simulation.

The rigid robots use exact tracking. The robot with joint springs uses the state space of §3.3 of
the paper (Eqs. 23–25).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablebot_gym.bounds.closed_form import GRID, exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import TorqueProfile
from cablebot_gym.robots import Robot
from cablebot_reproduction.robots import line_speed, paper_circle

COARSE = 100.0
"""Number of instants per second, each evaluated from both sides, for an exact payload accurate to
0.01 kg [Hz]."""


class LargestPayload(NamedTuple):
    """A largest payload and its limiting motor."""

    payload: float
    """Mass added to the platform [kg]. A negative value is the excess mass of the platform
    alone."""
    motor: int | None
    """Motor whose torque or tension reaches its limit, counted from 1."""
    time: float | None
    """Time of the violation [s]."""


def exact_limit(
    robot: Robot,
    line: str = "physical",
    *,
    minimum_tension: float = textbook.MINIMUM_TENSION,
    alpha: str = "least",
) -> LargestPayload:
    """The largest payload of exact tracking with a rigid transmission.

    Args:
        robot: rigid robot.
        line: one of :data:`~cablebot_reproduction.robots.LINES`.
        minimum_tension: T_min of a planar robot [N].
        alpha: α of Eq. 11 of a planar robot: the smallest value at each instant (``least``), or the
            smallest constant (``constant``) that keeps T_min.
    """
    if robot.planar and alpha == "constant":
        return _limit_of_constant_alpha(robot, line, minimum_tension)
    if not robot.planar:
        minimum_tension = 0.0
    exact = exact_payload(
        robot,
        paper_circle(robot),
        line_speed=line_speed(line, robot),
        minimum_tension=minimum_tension,
    )
    return LargestPayload(exact.payload, exact.motor, exact.time)


def _limit_of_constant_alpha(robot: Robot, line: str, minimum: float) -> LargestPayload:
    """Bisection with the tensions ``T = M T_p + α N`` (Eq. 11). The torque reserve of the motors is
    concave in the mass M, but not affine."""
    times = instants(robot)
    state = circle_state(robot, times)
    pose, velocity, acceleration = state
    structure = textbook.jacobian(robot, pose)
    inverse = np.linalg.pinv(np.swapaxes(structure, -1, -2))
    particular = -np.einsum("kic,kc->ki", inverse, acceleration)
    null = np.cross(structure[..., 0], structure[..., 1])
    sign = np.sign(null.sum(axis=-1, keepdims=True))
    null = null * sign / np.linalg.norm(null, axis=-1, keepdims=True)
    pulley_torques = textbook.required_torques(robot, np.zeros_like(null), *state)
    speed = line_speed(line, robot) * textbook.pulley_speed(robot, pose, velocity)
    lower, upper = textbook.torque_limits(robot, speed)

    def overload(mass: float) -> Array:
        alpha = ((minimum - mass * particular) / null).max()
        tensions = mass * particular + alpha * null
        torques = pulley_torques + robot.pulley_radius * tensions
        return np.maximum(torques - upper, lower - torques)

    step = 0.05 * robot.mass
    low, high = 0.0, step
    while overload(high).max() <= 0:
        low, high = high, high + step
    while high - low > 1e-9:
        middle = (low + high) / 2
        if overload(middle).max() <= 0:
            low = middle
        else:
            high = middle
    k, motor = np.unravel_index(np.argmax(overload(high)), null.shape)
    return LargestPayload(low - robot.mass, int(motor) + 1, round(float(times[k]), 7))


def state_space_profile(
    robot: Robot, payload: float, *, line: str = "physical", eq24: str = "corrected"
) -> TorqueProfile:
    """Torques of Eq. 22 with joint springs, by the paper's own state space.

    The platform is on the reference (Eq. 23). Eq. 24 gives the motor angles, starting from β̈′ =
    β̇′ = 0:

        β̈′ = (κ + K (β − β′)) / J′,   κ = r T + J β̈.

    The paper prints the divisor 1 + J′ (``eq24="verbatim"``), but the units require J′. Eq. 22
    gives the torques τ = κ + J′ β̈′. This oscillation has no damping, so a jump of κ excites a
    permanent oscillation. The paper may have computed its figures in this way, but no physical
    robot moves like this: by Eq. 4, Eq. 24 corresponds to τ = κ, and with τ from Eq. 22, β̈′ cancels
    and no differential equation remains.

    The solution is exact for κ + K β that is linear between the instants.
    """
    times = instants(robot)
    pose, velocity, acceleration = circle_state(robot, times)
    mass = robot.mass + payload
    required = textbook.inverse_dynamics(robot, mass, pose, velocity, acceleration)
    kappa = required.torques
    divisor = eq24_divisor(robot, eq24)
    rest_angle = textbook.pulley_angle(robot, pose) + kappa / robot.stiffness
    angle, speed = _oscillation(rest_angle, np.sqrt(robot.stiffness / divisor), times)
    stiffness = robot.motor_inertia * robot.stiffness / divisor
    torques = kappa + stiffness * (rest_angle - angle)
    if line not in ("physical", "reversed"):
        speed = required.speeds
    lower, upper = textbook.torque_limits(robot, line_speed(line, robot) * speed)
    return TorqueProfile(
        times=times,
        torques=torques,
        lower=lower,
        upper=upper,
        end=1.0,
        name="required torque",
    )


def state_space_limit(
    robot: Robot, line: str = "physical", *, eq24: str = "corrected"
) -> LargestPayload:
    """The largest payload of :func:`state_space_profile`. The torques are affine in the payload."""
    unloaded = state_space_profile(robot, 0.0, line=line, eq24=eq24)
    unloaded_reserve = reserve(unloaded)
    loss = unloaded_reserve - reserve(state_space_profile(robot, 1.0, line=line, eq24=eq24))
    with np.errstate(divide="ignore", invalid="ignore"):
        payloads = np.where(loss > 0, unloaded_reserve / loss, np.inf)
    k, motor, _ = np.unravel_index(np.argmin(payloads), payloads.shape)
    return LargestPayload(float(payloads.min()), int(motor) + 1, round(float(unloaded.times[k]), 7))


def reserve(profile: TorqueProfile) -> Array:
    """Distances of the torques to the upper and to the lower limit, (K, m, 2) [N·m]."""
    above = profile.upper - profile.torques
    below = profile.torques - profile.lower
    return np.stack([above, below], axis=-1)


def eq24_divisor(robot: Robot, eq24: str = "corrected") -> Array:
    """J′, or 1 + J′ as printed, (m,)."""
    if eq24 == "verbatim":
        return 1.0 + robot.motor_inertia
    return robot.motor_inertia


def exact_torques(robot: Robot) -> Array:
    """Torques of exact tracking with a rigid transmission at the instants of
    :func:`state_space_profile`, (K, m) [N·m]."""
    state = circle_state(robot, instants(robot))
    return textbook.inverse_dynamics(robot, robot.mass, *state).torques


def instants(robot: Robot) -> Array:
    """Instants of the whole motion. The middle, where the acceleration of the circle jumps, appears
    from both sides."""
    duration = paper_circle(robot).duration
    middle = round(GRID * duration / 2)
    grid = np.arange(2 * middle) * (duration / (2 * middle))
    return np.insert(grid, middle + 1, grid[middle] + 1e-9 * duration)


def circle_state(robot: Robot, times: Array) -> tuple[Array, Array, Array]:
    """Pose, velocity and acceleration on the circle, each (K, n)."""
    motion = paper_circle(robot)(times)
    return motion.position, motion.velocity, motion.acceleration


def _oscillation(goal: Array, frequency: Array, times: Array) -> tuple[Array, Array]:
    """Solves ẍ = ω² (g − x) from x = g and ẋ = 0 with g linear between the instants; returns x and
    ẋ, each (K, m)."""
    angle = np.empty_like(goal)
    speed = np.zeros_like(goal)
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
