"""Largest payloads without simulation, under any reading: exact tracking of the rigid robots, and the state space by
which §3.3 of the paper moves the motors of the flexible one (Eqs. 23–25)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablebot_baselines.paper.readings import Readings
from cablebot_gym.bounds.closed_form import GRID, exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference, Trajectory, find_trajectory

COARSE = 100.0
"""Instants per second, each with its two sides, that tell an exact payload to 0.01 kg [Hz]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Profile:
    """Torques along the reference, and their limits under a reading."""

    times: Array
    """(K,) [s]."""
    torques: Array
    """τ, (K, m) [N·m]."""
    lower: Array
    """U⁻, (K, m) [N·m]."""
    upper: Array
    """U⁺, (K, m) [N·m]."""


@dataclass(frozen=True, kw_only=True)
class Heaviest:
    """A largest payload, and what ends it."""

    payload: float
    """Added to the platform [kg]; negative: the platform alone is too heavy by that much; -inf: no mass will do."""
    motor: int | None
    """The motor whose torque or tension is the limit, counted from 1."""
    time: float | None
    """When it is [s]."""


def paper_circle(robot: Robot) -> Trajectory:
    """The paper's circle of a robot (Tables 1 and 3)."""
    return find_trajectory("paper-planar" if robot.planar else "paper-spatial", robot.coordinates)


def exact_profile(readings: Readings, robot: Robot, payload: float) -> Profile:
    """Torques of exact tracking with a rigid transmission."""
    times = _times(robot)
    motion = paper_circle(robot)(times)
    tensions = _tensions(readings, robot, robot.mass + payload, motion)
    state = (motion.position, motion.velocity)
    torques = textbook.required_torques(robot, tensions, *state, motion.acceleration)
    speed = readings.line_speed(robot) * textbook.pulley_speed(robot, *state)
    lower, upper = textbook.torque_limits(robot, speed)
    return Profile(times=times, torques=torques, lower=lower, upper=upper)


def exact_limit(readings: Readings, robot: Robot) -> Heaviest:
    """The largest payload of exact tracking with a rigid transmission."""
    if robot.planar and readings.alpha == "constant":
        return _searched(readings, robot)
    found = exact_payload(
        robot,
        paper_circle(robot),
        minimum_tension=readings.minimum_tension if robot.planar else 0.0,
        line_speed=readings.line_speed(robot),
    )
    return Heaviest(payload=found.payload, motor=found.motor, time=found.time)


def state_space_profile(readings: Readings, robot: Robot, payload: float) -> Profile:
    """Torques of Eq. 22 with joint springs, by the paper's own state space.

    The platform is on the reference (Eq. 23); Eq. 24, printed with the divisor 1 + J′ where its units ask for J′,

        β̈′ = (κ + K (β − β′)) / J′,   κ = r T + J β̈,

    from β̈′ = β̇′ = 0 on gives the motors' angles, and Eq. 22 the torques τ = κ + J′ β̈′. Nothing damps them: what a jump
    of κ starts rings on. It is how the paper can have come to its figures, and the motion of no robot: by Eq. 4, Eq. 24
    belongs to τ = κ, and with Eq. 22 for τ, β̈′ cancels and no differential equation is left (docs/errata.md).

    The oscillator is solved exactly for κ + K β linear in between the instants.
    """
    times = _times(robot)
    torques, speeds = _state_space(readings, robot, robot.mass + payload, times)
    lower, upper = textbook.torque_limits(robot, speeds)
    return Profile(times=times, torques=torques, lower=lower, upper=upper)


def state_space_limit(readings: Readings, robot: Robot) -> Heaviest:
    """The largest payload of :func:`state_space_profile`, whose torques are affine in it."""
    empty, loaded = (state_space_profile(readings, robot, payload) for payload in (0.0, 1.0))
    above, below = (
        (empty.upper - empty.torques, loaded.upper - loaded.torques),
        (empty.torques - empty.lower, loaded.torques - loaded.lower),
    )
    rooms = np.stack([above[0], below[0]], axis=-1)
    slopes = rooms - np.stack([above[1], below[1]], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.where(slopes > 0, rooms / slopes, np.inf)
    k, motor, _ = np.unravel_index(np.argmin(ends), ends.shape)
    return Heaviest(payload=float(ends[k, motor].min()), motor=int(motor) + 1, time=_rounded(empty.times[k]))


def _times(robot: Robot) -> Array:
    """Instants of the whole motion, both sides of each half of it, where the circle's acceleration jumps."""
    duration = paper_circle(robot).duration
    count = 2 * round(GRID * duration / 2)
    grid = np.arange(count) * (duration / count)
    middle = count // 2
    return np.insert(grid, middle + 1, grid[middle] + 1e-9 * duration)


def _tensions(readings: Readings, robot: Robot, mass: float, motion: Reference) -> Array:
    """Tensions of exact tracking (K, m), by the reading's α where there is a choice."""
    state = (motion.position, motion.velocity, motion.acceleration)
    if robot.planar and readings.alpha == "constant":
        return _ConstantAlpha(robot, motion, readings.minimum_tension)(mass)
    return textbook.required_tensions(robot, mass, *state, minimum=readings.minimum_tension)


class _ConstantAlpha:
    """Planar tensions ``T = M T_p + α N`` (Eq. 11) with one α for all times, the least that keeps T_min throughout."""

    def __init__(self, robot: Robot, motion: Reference, minimum: float) -> None:
        structure = textbook.jacobian(robot, motion.position)
        self._particular = -np.einsum("kic,kc->ki", np.linalg.pinv(np.swapaxes(structure, -1, -2)), motion.acceleration)
        null = np.cross(structure[..., 0], structure[..., 1])
        self._null = null * np.sign(null.sum(axis=-1, keepdims=True)) / np.linalg.norm(null, axis=-1, keepdims=True)
        self._minimum = minimum

    def __call__(self, mass: float) -> Array:
        """T (K, 3) of a total mass."""
        tensions = mass * self._particular
        alpha = ((self._minimum - tensions) / self._null).max()
        return np.asarray(tensions + alpha * self._null)


def _searched(readings: Readings, robot: Robot) -> Heaviest:
    """Bisection for one α for all times: what the motors have left is concave in the mass, but not affine."""
    times = _times(robot)
    motion = paper_circle(robot)(times)
    tensions, state = _ConstantAlpha(robot, motion, readings.minimum_tension), (motion.position, motion.velocity)
    still = textbook.required_torques(robot, np.zeros((len(times), robot.cables)), *state, motion.acceleration)
    lower, upper = textbook.torque_limits(robot, readings.line_speed(robot) * textbook.pulley_speed(robot, *state))

    def overload(mass: float) -> Array:
        torques = still + robot.pulley_radius * tensions(mass)
        return np.maximum(torques - upper, lower - torques)

    masses = np.linspace(0.0, 10 * robot.mass, 201)[1:]
    fails = next((k for k, mass in enumerate(masses) if overload(float(mass)).max() > 0), None)
    if fails is None:
        return Heaviest(payload=np.inf, motor=None, time=None)
    if fails == 0:
        return Heaviest(payload=-np.inf, motor=None, time=None)
    low, high = float(masses[fails - 1]), float(masses[fails])
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (low, middle) if overload(middle).max() > 0 else (middle, high)
    k, motor = np.unravel_index(np.argmax(overload(high)), (len(times), robot.cables))
    return Heaviest(payload=low - robot.mass, motor=int(motor) + 1, time=_rounded(times[k]))


def _state_space(readings: Readings, robot: Robot, mass: float, times: Array) -> tuple[Array, Array]:
    """Torques, and the speeds that the reading's torque-speed line takes, each (K, m)."""
    motion = paper_circle(robot)(times)
    state = (motion.position, motion.velocity)
    pulley_speed = textbook.pulley_speed(robot, *state)
    tensions = textbook.required_tensions(robot, mass, *state, motion.acceleration)
    spring = textbook.required_torques(robot, tensions, *state, motion.acceleration)
    goal = textbook.pulley_angle(robot, motion.position) + spring / robot.stiffness  # β + κ/K
    divisor = robot.motor_inertia if readings.eq24 == "corrected" else 1.0 + robot.motor_inertia
    angle, motor_speed = _oscillation(goal, np.sqrt(robot.stiffness / divisor), times)
    torques = spring + robot.motor_inertia * robot.stiffness / divisor * (goal - angle)
    if readings.line in ("physical", "reversed"):
        return torques, readings.line_speed(robot) * motor_speed
    return torques, readings.line_speed(robot) * pulley_speed


def _oscillation(goal: Array, frequency: Array, times: Array) -> tuple[Array, Array]:
    """ẍ = ω² (g − x) from x = g and ẋ = 0 on, g linear between the instants: x and ẋ, each (K, m)."""
    angle, speed = np.empty_like(goal), np.zeros_like(goal)
    angle[0] = goal[0]
    for k, step in enumerate(np.diff(times)):
        rate = (goal[k + 1] - goal[k]) / step
        offset, drift = angle[k] - goal[k], speed[k] - rate
        cosine, sine = np.cos(frequency * step), np.sin(frequency * step)
        angle[k + 1] = goal[k + 1] + offset * cosine + drift / frequency * sine
        speed[k + 1] = rate - offset * frequency * sine + drift * cosine
    return angle, speed


def _rounded(time: float) -> float:
    return round(float(time), 7)
