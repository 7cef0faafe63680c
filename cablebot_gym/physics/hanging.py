"""Pose and tensions at rest, also of platforms that hang on fewer cables than coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import root

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot

_TOLERANCE = 1e-9
"""Largest error of lengths [m], and of forces as a fraction of the weight."""

_NEUTRAL = 1e-6
"""A frequency below this part of the largest one is a rounding error: nothing brings back a platform
that turns about its only cable."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RestPose:
    """A platform at rest."""

    pose: Array
    """X, shape (n,)."""
    tensions: Array
    """Cable tensions, shape (m,) [N]."""


def home_at_rest(robot: Robot, mass: float, minimum: float) -> RestPose:
    """Pose and tensions at rest with the cable lengths of the home pose.

    Args:
        robot: the robot.
        mass: mass of platform and payload [kg].
        minimum: least tension of redundant cables [N].

    Raises:
        ValueError: if a platform on fewer cables than coordinates does not hang near home.
    """
    if robot.hanging:
        home_lengths = textbook.cable_lengths(robot, robot.home)
        return hanging_pose(robot, mass, home_lengths, robot.home)
    torques = textbook.static_torque(robot, mass, robot.home, minimum=minimum)
    return RestPose(pose=robot.home, tensions=torques / robot.pulley_radius)


def hanging_pose(robot: Robot, mass: float, lengths: ArrayLike, near: ArrayLike) -> RestPose:
    """The pose in which a platform hangs: ``h(X) + Sᵀ T = 0`` and ``q(X) = lengths``.

    The payload does not move it, because it is in the centre of mass.

    Args:
        robot: a robot with gravity and fewer cables than coordinates.
        mass: mass of platform and payload [kg].
        lengths: cable lengths, shape (m,) [m].
        near: a pose near the result, shape (n,).

    Raises:
        ValueError: if no pose near ``near`` has these lengths at rest, with all cables taut and the
            platform in its lowest position.
    """
    lengths = np.asarray(lengths, float)
    start = np.asarray(near, float)
    m = robot.cables
    n = robot.coordinates
    still = np.zeros(n)
    weight = mass * robot.gravity

    def errors(unknowns: Array) -> Array:
        """Unbalanced forces over the weight, and errors of the lengths; T is over the weight."""
        pose, tensions = np.split(unknowns, [n])
        forces = textbook.bias(robot, mass, pose, still) / weight
        forces = forces + textbook.jacobian(robot, pose).T @ tensions
        length_errors = textbook.cable_lengths(robot, pose) - lengths
        return np.concatenate([forces, length_errors])

    def slopes(unknowns: Array) -> Array:
        pose, tensions = np.split(unknowns, [n])
        structure = textbook.jacobian(robot, pose)
        stiffness = textbook.weight_stiffness(robot, mass, pose) / weight
        stiffness += textbook.tension_stiffness(robot, pose, tensions)
        return np.block([[stiffness, structure.T], [structure, np.zeros((m, m))]])

    forces = textbook.bias(robot, mass, start, still) / weight
    to_forces = -textbook.jacobian(robot, start).T
    start_tensions = np.linalg.lstsq(to_forces, forces, rcond=None)[0]
    near_rest = np.concatenate([start, start_tensions])
    solution = root(errors, near_rest, jac=slopes, options={"xtol": 1e-13}).x
    largest_error = np.max(np.abs(errors(solution)))
    if not largest_error < _TOLERANCE:
        raise ValueError(f"{robot.name}: no pose at rest near {start.tolist()} has these lengths")
    pose, tensions = np.split(solution, [n])
    tensions = weight * tensions
    if tensions.min() <= 0:
        slack = int(np.argmin(tensions)) + 1
        raise ValueError(f"{robot.name}: cable {slack} is slack at rest with these lengths")
    frequencies, _ = textbook.locked_modes(robot, mass, pose, tensions)
    if not frequencies[0] > _NEUTRAL * frequencies[-1]:
        raise ValueError(f"{robot.name}: the pose at rest near {start.tolist()} is not stable")
    return RestPose(pose=pose, tensions=tensions)
