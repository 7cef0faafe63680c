"""Growth rate of small deviations in the sampled loop of a flexible robot, computed from the eigenvalues.

The paper argues with the Fourier transform instead.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics import textbook
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import Motors, Robot

_TURN = 0.05
"""Maximum phase advance of the fastest mode per physics step [rad], small enough for RK4 to add no damping."""
_DIFFERENCE = 1e-6
_BEYOND = 1e6


def unsaturated_actions(robot: Robot) -> Robot:
    """Copy of the robot whose motors never saturate; the torque-speed lines keep their slope."""
    stall = tuple(_BEYOND * robot.stall_torque)
    free = tuple(_BEYOND * robot.stall_torque / robot.speed_slope)
    return robot.replace(motors=Motors(stall_torque=stall, free_speed=free))


def growth_rate(law: Any, robot: Robot, *, control_frequency: float = 500.0) -> float:
    """max Re(log z / h) of the loop sampled with a zero-order hold, linearised at rest at home [1/s].

    The state is (X, Ẋ, β′, β̇′) and the motor speeds of the previous sample, which a law may store. Cables transmit
    compression. The linearisation uses central differences over one control period of the plant.

    Args:
        law: control law built for the robot.
        robot: flexible robot with the motors of :func:`unsaturated_actions`.
        control_frequency: 1/h [Hz].
    """
    n, m, period = robot.coordinates, robot.cables, 1 / control_frequency
    angle = textbook.static_motor_angle(robot, robot.mass, robot.home, minimum=textbook.MINIMUM_TENSION)
    rest = np.concatenate([robot.home, np.zeros(n), angle, np.zeros(2 * m)])
    states = np.concatenate([rest + _DIFFERENCE * np.eye(len(rest)), rest - _DIFFERENCE * np.eye(len(rest))])
    everyone = np.arange(len(states))
    plant = Plant(robot, len(states), cable="bilateral")
    pose, velocity, motor_angle, motor_speed, past = np.split(states, [n, 2 * n, 2 * n + m, 2 * n + 2 * m], axis=1)
    plant.set_state(everyone, pose, velocity)
    plant.set_motors(everyone, motor_angle, motor_speed)
    layout = observation_layout(robot)
    observation = np.zeros((len(states), layout.size))
    part = layout.split(observation)
    part["pose"][:], part["velocity"][:], part["reference_pose"][:] = pose, velocity, robot.home
    part["motor_angle"][:], part["motor_speed"][:] = motor_angle, motor_speed
    memory = np.column_stack([past, np.full(len(states), period)])  # the time in the observation is 0
    plant.set_action(law.predict(observation, state=memory)[0])
    _advance(plant, robot, period)
    motors = [plant.motor_angle, plant.motor_speed]
    after = np.concatenate([plant.pose, plant.velocity, *motors, motor_speed], axis=1)
    loop = (after[: len(rest)] - after[len(rest) :]).T / (2 * _DIFFERENCE)
    return float(np.log(np.abs(np.linalg.eigvals(loop)).max()) / period)


def controllable_states(robot: Robot, *, period: float = 0.02) -> int:
    """Rank of the controllability matrix of a flexible robot's plant, sampled and linearised at rest at home.

    With m inputs and 2 (n + m) states, [B, AB, …] up to the fourth power is square if n = m. Each column is divided by
    its norm and each row by its largest absolute entry, which removes the influence of the units.

    Args:
        robot: flexible robot.
        period: sampling period [s]; the platform should move within a few periods.
    """
    n, m = robot.coordinates, robot.cables
    size, robot = 2 * (n + m), unsaturated_actions(robot)
    angle = textbook.static_motor_angle(robot, robot.mass, robot.home, minimum=textbook.MINIMUM_TENSION)
    hold = textbook.static_torque(robot, robot.mass, robot.home, minimum=textbook.MINIMUM_TENSION) / robot.stall_torque
    rest = np.concatenate([robot.home, np.zeros(n), angle, np.zeros(m), hold])
    step = np.concatenate([np.full(size, _DIFFERENCE), np.full(m, _DIFFERENCE / robot.stall_torque.max())])
    states = np.concatenate([rest + np.diag(step), rest - np.diag(step)])
    pose, velocity, motor_angle, motor_speed, action = np.split(states, [n, 2 * n, 2 * n + m, size], axis=1)
    plant, everyone = Plant(robot, len(states), cable="bilateral"), np.arange(len(states))
    plant.set_state(everyone, pose, velocity)
    plant.set_motors(everyone, motor_angle, motor_speed)
    plant.set_action(action + robot.speed_slope / robot.stall_torque * motor_speed)
    _advance(plant, robot, period)
    motors = [plant.motor_angle, plant.motor_speed]
    after = np.concatenate([plant.pose, plant.velocity, *motors], axis=1)
    response = (after[: size + m] - after[size + m :]).T / (2 * step)
    transition, columns = response[:, :size], [response[:, size:]]
    for _ in range(size // m - 1):
        columns.append(transition @ columns[-1])
    reach = np.concatenate(columns, axis=1)
    reach /= np.linalg.norm(reach, axis=0)
    reach /= np.abs(reach).max(axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(reach, tol=1e-6))


def _advance(plant: Plant, robot: Robot, period: float) -> None:
    """Advances the plant by one control period in steps that are short enough not to damp the springs."""
    substeps = math.ceil(period * textbook.highest_frequency(robot) / _TURN)
    plant.advance(np.zeros((1, 1, robot.coordinates)), np.zeros(1, np.int64), substeps=substeps, step=period / substeps)
