"""Robots and references for the tests of docs/errata.md: Lagrange's equation in finite differences,
and MuJoCo."""

import numpy as np
import pytest

from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from oracles.mujoco_model import MujocoRobot
from oracles.plants import (
    State,
    differentiated,
    energies,
    textbook_rates,
    with_transmission,
)

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
each_time = pytest.mark.parametrize("time", [0.1, 0.8])


def slope(function, at, step=1e-3):
    """df/dt at a time."""
    return differentiated(lambda time: function(at + time), step)


def motion(robot, time):
    """X, Ẋ, Ẍ of some smooth motion well inside the workspace, in closed form."""
    n = robot.coordinates
    size = np.array([0.1, 0.1] if robot.planar else [0.08, 0.08, 0.05, 0.2, 0.2, 0.2])
    rate = np.linspace(4.0, 7.0, n)
    phase = np.linspace(0.3, 5.0, n)
    middle = robot.home + (np.zeros(2) if robot.planar else np.array([0, 0, 0.3, 0, 0, 0]))
    sine = np.sin(rate * time + phase)
    cosine = np.cos(rate * time + phase)
    return middle + size * sine, size * rate * cosine, -size * rate**2 * sine


def momentum(robot, pose, velocity):
    """∂L/∂Ẋ."""
    return gradient(lambda v: lagrangian(robot, pose, v), velocity)


def lagrangian(robot, pose, velocity):
    no_motors = np.zeros((2, 1, robot.cables))
    kinetic, potential = energies(robot, State(pose[None], velocity[None], *no_motors))
    return (kinetic - potential)[0]


def gradient(function, at):
    return np.array([slope(lambda s, e=e: function(at + s * e), 0.0) for e in np.eye(len(at))])


def needed_force(robot, time, *, pulleys):
    """d/dt ∂L/∂Ẋ − ∂L/∂X on the motion: the generalised force that it needs from outside, (n,)."""
    robot = with_transmission(
        robot,
        pulley_inertia=pulleys * robot.pulley_inertia,
        stiffness=None,
        motor_inertia=None,
    )
    x, v, _ = motion(robot, time)
    rate = slope(lambda t: momentum(robot, *motion(robot, t)[:2]), time)
    return rate - gradient(lambda pose: lagrangian(robot, pose, v), x)


def turning(robot, time):
    """G = ∂β/∂X and Ġ on the motion."""
    x, v, _ = motion(robot, time)
    return -textbook.jacobian(robot, x) / RADIUS, -textbook.jacobian_rate(robot, x, v) / RADIUS


def by_columns(function, at, step=1e-6):
    """Jacobian of a batched function (N, n) → (N, k) by central differences, (k, n)."""
    ahead, behind = np.split(
        function(np.concatenate([at + step * np.eye(len(at)), at - step * np.eye(len(at))])),
        2,
    )
    return (ahead - behind).T / (2 * step)


def flexible_rates(robot, states, torques):
    """Rates of (X, Ẋ, β′, β̇′), (N, 24)."""
    rates, _ = textbook_rates(robot, State(*np.split(states, 4, axis=1)), torques)
    return rates.columns()


def resting(robot):
    angle = textbook.static_motor_angle(robot, robot.mass, robot.home)
    return np.concatenate([robot.home, np.zeros(6), angle, np.zeros(6)])


def mujoco_state(state):
    """The flexible robot in MuJoCo at (X, Ẋ, β′, β̇′)."""
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    pose, velocity, angle, speed = np.split(
        np.concatenate(state) if isinstance(state, tuple) else state, 4
    )
    peer = MujocoRobot(FLEXIBLE)
    peer.set_state(pose, velocity)
    peer.set_motors(angle, speed)
    return peer


def outer_loop(law, pose, velocity, reference=0.0, acceleration=0.0):
    """The acceleration that an outer loop asks for, about a resting reference."""
    return law(
        {
            "pose": pose,
            "velocity": velocity,
            "reference_pose": reference + 0 * pose,
            "reference_velocity": 0 * pose,
            "reference_acceleration": acceleration + 0 * pose,
        }
    )


def parts_of_law(robot, pose, velocity):
    """α and γ of Eq. 27, corrected: torques at Ẍ = 0 and their slope."""

    def torques(a):
        return textbook.inverse_dynamics(robot, robot.mass, pose, velocity, a).torques

    return torques(np.zeros(6)), by_columns(torques, np.zeros(6), 1.0)
