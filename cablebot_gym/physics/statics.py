"""Tensions and payloads that cables and motors can hold, at rest or along a motion, without a
simulation.

The answers are exact for rigid transmissions. Joint springs and the stretch of the cables are left
out: motor and pulley turn together.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Reference, Trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.tensions.distribution import (
    HELD,
    ScaleInterval,
    largest_scale,
)
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, at_rest, start_pose
from cablebot_gym.utils.checks import number, numbers

HEAVIEST = 1000.0
"""Largest payload that is tried, in platform masses. If this payload is feasible, the payload is
unlimited."""

_SAMPLES = 201
"""Number of checked instants of a motion."""


def resting(poses: Array) -> Reference:
    """The reference of a robot that rests at poses (K, n)."""
    zero = np.zeros_like(poses)
    return Reference(position=poses, velocity=zero, acceleration=zero, jerk=zero, snap=zero)


def tension_bounds(
    robot: Robot, reference: Reference, minimum: float, *, line_speed: ArrayLike = 1.0
) -> tuple[Array, Array]:
    """Least and largest tensions on a reference, each (K, m) [N]: the minimum tension, the robot's
    maximum tension and the torque-speed lines.

    Speeds and pulley accelerations, and so the bounds, do not depend on the mass.

    Args:
        robot: the robot.
        reference: the reference at K instants.
        minimum: minimum tension [N].
        line_speed: speed in the torque-speed lines as a multiple of β̇, one value or one per motor.

    Returns:
        The tensions; NaN where a cable has no length, and thus no direction.

    Raises:
        ValueError: if a number is not finite.
    """
    known = _has_directions(robot, reference.position)[:, None]
    pose = np.where(known, reference.position, robot.home)
    velocity = reference.velocity
    acceleration = reference.acceleration
    speed = textbook.pulley_speed(robot, pose, velocity)
    rest = textbook.required_torques(robot, np.zeros_like(speed), pose, velocity, acceleration)
    if robot.flexible:
        rest = rest + textbook.coulomb_torque(robot, speed)
    if robot.jointed:
        second = textbook.pulley_acceleration(robot, pose, velocity, acceleration)
        rest = rest + robot.motor_damping * speed
        rest = rest + robot.motor_inertia * second
    lowest, highest = textbook.torque_limits(robot, numbers("line_speed", line_speed) * speed)
    # Motor and pulley turn together, so load friction is that of a rigid transmission.
    per_tension = robot.pulley_radius * (1 + textbook.load_friction(robot, speed))
    least = np.maximum((lowest - rest) / per_tension, number("minimum", minimum))
    largest = np.minimum((highest - rest) / per_tension, robot.maximum_tension)
    return np.where(known, least, np.nan), np.where(known, largest, np.nan)


def _has_directions(robot: Robot, poses: Array) -> Array:
    """Whether all cables have a length, and so a direction, at poses (K, n), shape (K,)."""
    return np.asarray(np.isfinite(textbook.jacobian(robot, poses)).all(axis=(1, 2)))


def required_load(robot: Robot, reference: Reference, payload: float) -> Array:
    """Generalised force that a reference requires with a payload [kg], (K, n)."""
    mass = np.full(len(reference.position), robot.mass + payload)
    return textbook.load(
        robot, mass, reference.position, reference.velocity, reference.acceleration
    )


_NO_LOAD = 1e-9
"""Force of a payload below which it makes no difference [N/kg]."""


def feasible_payloads(robot: Robot, reference: Reference) -> ScaleInterval:
    """Interval of the payloads with which cables and motors follow a reference, at each of its K
    instants [kg]."""
    unloaded = required_load(robot, reference, 0.0)
    per_kilogram = required_load(robot, reference, 1.0) - unloaded
    # A payload without a force, where the motion does not accelerate, has no limit but rounding.
    per_kilogram[np.linalg.norm(per_kilogram, axis=-1) < _NO_LOAD] = 0.0
    structure = textbook.jacobian(robot, reference.position)
    least, largest = tension_bounds(robot, reference, robot.minimum_tension)
    heaviest = HEAVIEST * robot.mass
    return largest_scale(structure, unloaded, per_kilogram, least, largest, heaviest)


def payload_interval(robot: Robot, reference: Reference) -> tuple[float, float]:
    """Least and largest payload with which cables and motors follow all of a reference [kg]; (inf,
    −inf) if some instant allows none."""
    payloads = feasible_payloads(robot, reference)
    if np.any(payloads.status != HELD):
        return math.inf, -math.inf
    return float(payloads.least.max()), float(payloads.largest.min())


def status_with_payload(robot: Robot, reference: Reference, payload: float) -> ScaleInterval:
    """Status at each instant of a reference with a payload [kg], and the cables that exclude it."""
    load = required_load(robot, reference, payload)
    structure = textbook.jacobian(robot, reference.position)
    least, largest = tension_bounds(robot, reference, robot.minimum_tension)
    return largest_scale(structure, load, np.zeros_like(load), least, largest, 0.0)


def holds(robot: Robot, poses: Array, payload: float) -> Array:
    """Whether cables and motors hold a payload [kg] at rest at poses (K, n), shape (K,)."""
    with np.errstate(invalid="ignore", divide="ignore"):  # anchors and swivel pulleys
        known = _has_directions(robot, poses)
    held = np.zeros(len(poses), bool)
    held[known] = status_with_payload(robot, resting(poses[known]), payload).status == HELD
    return held


def hold_payload(robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds) -> float:
    """Largest payload with which the motors hold the robot at the start pose [kg], in closed form.

    The task criterion requires it of the motors alone: under a maximum tension, a controller may
    still let the platform drop to a pose with steeper cables. The static torques are affine in the
    payload. The result is ``inf`` if the motion does not start at rest or no payload changes the
    torques (without gravity), and ``-inf`` if the motors hold no payload.
    """
    if not at_rest(trajectory(0.0)):
        return math.inf
    pose = start_pose(robot, trajectory, error_bounds)
    if not robot.weightless and robot.cables > robot.coordinates:
        stronger = robot.replace(maximum_tension=math.inf)
        return payload_interval(stronger, resting(pose[None]))[1]
    empty = textbook.static_torque(robot, robot.mass, pose)
    loaded = textbook.static_torque(robot, robot.mass + 1.0, pose)
    slope = np.abs(loaded - empty)
    sign = np.where(loaded < empty, -1.0, 1.0)
    room = robot.stall_torque - sign * empty
    unlimited = np.where(room < -1e-9 * robot.stall_torque, -np.inf, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        payloads = np.where(slope > 0, room / slope, unlimited)
    return float(payloads.min())


EXACT_FACTOR = 5.0
"""Largest ratio of a controller's payload to that of exact tracking on a robot without gravity. It
is 2.6 for the best known payload of the paper's planar robot."""


def payload_ceiling(robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds) -> float:
    """Payload that no controller can be expected to carry [kg]; ``-inf`` if the motors cannot hold
    the start.

    With gravity it is the payload that motors and cables hold at the start pose. Without, they hold every
    payload at rest, and it is a multiple of the payload of exact tracking, at least the mass of the
    platform.
    """
    held = hold_payload(robot, trajectory, error_bounds)
    if math.isfinite(held):
        if robot.maximum_tension == math.inf:
            return held
        pose = start_pose(robot, trajectory, error_bounds)
        _, strength = payload_interval(robot, resting(pose[None]))
        if strength < 0:  # a controller may drop the platform to a pose with steeper cables
            return held
        return min(held, strength)
    if held < 0:
        return -math.inf
    instants = np.linspace(0.0, trajectory.duration, _SAMPLES)
    payloads = feasible_payloads(robot, trajectory(instants))
    exact = np.min(payloads.largest, initial=math.inf, where=payloads.status == HELD)
    if not math.isfinite(exact):
        return robot.mass
    return max(EXACT_FACTOR * float(exact), robot.mass)
