"""Robots at the start of an episode: equilibrium at a pose, and the motors and pulleys that belong
to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import RobotArrays


@dataclass(frozen=True, kw_only=True)
class MotorStart:
    """Motors and pulleys of k robots at the start of an episode, each (k, m)."""

    torque: Array
    """Motor torques that hold the robots at rest [N·m]."""
    speed: Array
    """Motor and pulley speeds [rad/s]."""
    motor_angle: Array
    """Motor angles β′ [rad]; without meaning for rigid robots."""


def equilibrium_torques(
    nominal: Robot, robot: RobotArrays, mass: Array, pose: Array, *, moved: bool
) -> Array:
    """Torques r T that hold robots at rest, shape (k, m) or (1, m) [N·m].

    Args:
        nominal: the nominal robot, whose minimum tension the cables have at least.
        robot: the true robots.
        mass: total masses, (k,) [kg].
        pose: poses, (k, n).
        moved: whether parameters on which the equilibrium of unit masses depends differ from the
            nominal ones.

    Raises:
        numpy.linalg.LinAlgError: if no tensions hold a robot.
    """
    # The least largest action of redundant cables is not proportional to the mass; unique tensions
    # are. Without weight the torques do not depend on the mass.
    redundant = robot.cables > robot.coordinates and not robot.weightless
    unit = mass if redundant else np.ones(len(pose))
    moved = moved or (redundant and robot is not nominal)
    if moved or np.any(pose != pose[0]) or np.any(unit != unit[0]):
        torques = textbook.static_torque(
            robot, unit, pose, minimum=textbook.allocated_minimum(nominal)
        )
    else:
        torques = _nominal_torques(nominal, float(unit[0]), tuple(pose[0].tolist()))
    if redundant or robot.weightless:
        return torques
    return torques * mass[:, None]


@lru_cache(maxsize=64)
def _nominal_torques(robot: Robot, mass: float, pose: tuple[float, ...]) -> Array:
    """Torques that hold a mass at one pose, (1, m): most episodes start at the same one."""
    return textbook.static_torque(robot, np.array([mass]), np.array([pose]))


def motor_start(robot: RobotArrays, torque: Array, pose: Array, velocity: Array) -> MotorStart:
    """Motors and pulleys of robots that are at rest on their springs and cables, or move as if they
    were.

    Args:
        robot: the robots.
        torque: torques r T from :func:`equilibrium_torques`, (k, m) [N·m]. Springs are wound by at
            most the stall torque.
        pose: poses X, (k, n).
        velocity: velocities Ẋ, (k, n).
    """
    speed = np.zeros_like(torque)
    # most motions start at rest, and the Jacobian makes resets slow
    if robot.flexible or np.any(velocity):
        speed = textbook.pulley_speed(robot, pose, velocity)
    if not robot.flexible:
        return MotorStart(torque=torque, speed=speed, motor_angle=np.zeros_like(speed))
    wound = np.clip(torque, -robot.stall_torque, robot.stall_torque)
    if not robot.elastic:
        motor_angle = textbook.pulley_angle(robot, pose) + wound / robot.stiffness
        return MotorStart(torque=torque, speed=speed, motor_angle=motor_angle)
    tensions = wound / robot.pulley_radius
    stretch = 1 + tensions / robot.axial_stiffness  # cables are wound without their stretch
    return MotorStart(
        torque=textbook.holding_torque(robot, torque),
        speed=speed / stretch,
        motor_angle=textbook.rest_angles(robot, tensions, pose),
    )
