"""Growth rate of small deviations in the sampled loop of a flexible robot, computed from the
eigenvalues.

The paper argues with the Fourier transform instead.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import Motors, Robot
from cablebot_reproduction.simulation import CONTROL_FREQUENCY

_TURN = 0.05
"""Maximum phase advance of the fastest mode per physics step [rad], small enough for RK4 to add no
damping."""

_DIFFERENCE = 1e-6
"""Half step of the central differences."""

_BEYOND = 1e6
"""Factor of the motor torques for motors that never saturate."""


def unsaturated_actions(robot: Robot) -> Robot:
    """Copy of the robot whose motors never saturate; the torque-speed lines keep their slope."""
    stall_torque = _BEYOND * robot.stall_torque
    free_speed = stall_torque / robot.speed_slope
    motors = Motors(stall_torque=tuple(stall_torque), free_speed=tuple(free_speed))
    return robot.replace(motors=motors)


def growth_rate(law: Any, robot: Robot, *, control_frequency: float = CONTROL_FREQUENCY) -> float:
    """max Re(log z / h) of the loop sampled with a zero-order hold, linearised at rest at home
    [1/s].

    The state is (X, Ẋ, β′, β̇′). Cables transmit compression. The linearisation uses central
    differences over one control period of the plant.

    Args:
        law: control law without memory, built for the robot.
        robot: flexible robot with the motors of :func:`unsaturated_actions`.
        control_frequency: 1/h [Hz].
    """
    period = 1 / control_frequency
    n, m = robot.coordinates, robot.cables
    rest_angle = textbook.static_motor_angle(robot, robot.mass, robot.home)
    rest = np.concatenate([robot.home, np.zeros(n), rest_angle, np.zeros(m)])
    changes = _DIFFERENCE * np.eye(len(rest))
    states = np.concatenate([rest + changes, rest - changes])
    pose, velocity, angle, speed = np.split(states, np.cumsum([n, n, m]), axis=1)
    plant = Plant(robot, len(states), cable="bilateral")
    indices = np.arange(len(states))
    plant.set_state(indices, pose, velocity)
    plant.set_motors(indices, angle, speed)
    action, _ = law.predict(_observation(robot, plant))
    plant.set_action(action)
    # Steps that are short enough not to damp the springs.
    substeps = math.ceil(period * textbook.highest_frequency(robot) / _TURN)
    ends = np.zeros(1, np.int64)
    plant.advance(np.zeros((1, 1, n)), ends, substeps=substeps, step=period / substeps)
    state = (plant.pose, plant.velocity, plant.motor_angle, plant.motor_speed)
    above, below = np.split(np.concatenate(state, axis=1), 2)
    transition = (above - below).T / (2 * _DIFFERENCE)
    largest_factor = np.abs(np.linalg.eigvals(transition)).max()
    return float(np.log(largest_factor) / period)


def _observation(robot: Robot, plant: Plant) -> Array:
    """Observation of a plant whose reference is the home pose."""
    layout = observation_layout(robot)
    observation = np.zeros((len(plant.pose), layout.size))
    blocks = layout.split(observation)
    blocks["pose"][:] = plant.pose
    blocks["velocity"][:] = plant.velocity
    blocks["reference_pose"][:] = robot.home
    blocks["motor_angle"][:] = plant.motor_angle
    blocks["motor_speed"][:] = plant.motor_speed
    return observation
