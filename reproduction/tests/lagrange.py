"""Robots and references for the errata: Lagrange's equation in finite differences, and MuJoCo."""

import numpy as np
import pytest
from oracles.mujoco_model import MujocoRobot
from oracles.plants import differentiated, with_transmission

from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL

RUBBING = with_transmission(PLANAR, damping=0.02)
"""The planar robot with friction, so that no term of Eqs. 1 and 2 vanishes."""
UNEVEN = SPATIAL.replace(inertia=(0.9, 0.3, 0.7))
"""The spatial robot with three different moments: with I_xx = I_yy some wrong terms cancel."""
FLEXIBLE = FLEX_SPATIAL.replace(mass=11.0)
"""Table 5 with the K of §5.2.3."""
KP = 30.0
KD = 20.0
"""Gains of Tables 4 and 5."""
RADIUS = 0.05
TIME = 0.8


def slope(function, at, step=1e-3):
    """df/dt at a time."""
    return differentiated(lambda time: function(at + time), step)


def motion(robot, time=TIME):
    """X, Ẋ, Ẍ of some smooth motion well inside the workspace, in closed form."""
    n = robot.coordinates
    size = np.array([0.1, 0.1] if robot.planar else [0.08, 0.08, 0.05, 0.2, 0.2, 0.2])
    rate = np.linspace(4.0, 7.0, n)
    middle = robot.home + (np.zeros(2) if robot.planar else np.array([0, 0, 0.3, 0, 0, 0]))
    angle = rate * time + np.linspace(0.3, 5.0, n)
    sine, cosine = np.sin(angle), np.cos(angle)
    return middle + size * sine, size * rate * cosine, -size * rate**2 * sine


def momentum(robot, pose, velocity):
    """∂L/∂Ẋ."""
    return gradient(lambda v: lagrangian(robot, pose, v), velocity)


def lagrangian(robot, pose, velocity):
    inertia = textbook.mass_matrix(robot, robot.mass, pose)
    pulley = textbook.pulley_speed(robot, pose, velocity)
    kinetic = velocity @ inertia @ velocity + np.sum(robot.pulley_inertia * pulley**2)
    weight = robot.mass * robot.gravity_vector
    return kinetic / 2 + pose[: robot.dimensions] @ weight


def gradient(function, at):
    return np.array([slope(lambda s, e=e: function(at + s * e), 0.0) for e in np.eye(len(at))])


def needed_force(robot, *, pulleys):
    """d/dt ∂L/∂Ẋ − ∂L/∂X on the motion: the generalised force that it needs from outside, (n,)."""
    inertia = pulleys * robot.pulley_inertia
    robot = with_transmission(robot, pulley_inertia=inertia, stiffness=None, motor_inertia=None)
    x, v, _ = motion(robot)
    rate = slope(lambda t: momentum(robot, *motion(robot, t)[:2]), TIME)
    return rate - gradient(lambda pose: lagrangian(robot, pose, v), x)


def turning(robot):
    """G = ∂β/∂X and Ġ on the motion."""
    x, v, _ = motion(robot)
    return -textbook.jacobian(robot, x) / RADIUS, -textbook.jacobian_rate(robot, x, v) / RADIUS


def mujoco_state(pose, velocity, angle, speed):
    """The flexible robot in MuJoCo."""
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    peer = MujocoRobot(FLEXIBLE)
    peer.set_state(pose, velocity)
    peer.set_motors(angle, speed)
    return peer


def parts_of_law(robot, pose, velocity):
    """α and γ of Eq. 27, corrected: torques at Ẍ = 0 and their slope."""

    def torques(a):
        return textbook.inverse_dynamics(robot, robot.mass, pose, velocity, a).torques

    without = torques(np.zeros(6))
    return without, np.stack([torques(e) - without for e in np.eye(6)], axis=1)
