"""How fast small deviations grow in a flexible robot's sampled loop: the eigenvalues that the paper left to Fourier."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics import textbook
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import Motors, Robot

_TURN = 0.05
"""Of the fastest mode in a physics step at most [rad]: far below where RK4 would damp it."""
_DIFFERENCE = 1e-6
_BEYOND = 1e6


def unclipped(robot: Robot) -> Robot:
    """The robot with motors whose stall torque is beyond reach, on torque-speed lines of the same slope."""
    stall = tuple(_BEYOND * robot.stall_torque)
    free = tuple(_BEYOND * robot.stall_torque / robot.speed_slope)
    return robot.replace(motors=Motors(stall_torque=stall, free_speed=free))


def growth_rate(law: Any, robot: Robot, *, control_frequency: float = 500.0) -> float:
    """max Re(log z / h) of the loop sampled with a zero-order hold, linearised at rest at home [1/s].

    Its state is (X, Ẋ, β′, β̇′) and the motor speeds one sample ago, which a law may remember. Cables may push, and the
    linearisation is by central differences over one control period of the plant itself.

    Args:
        law: built for the robot.
        robot: flexible, with motors as of :func:`unclipped`.
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
    memory = np.column_stack([past, np.full(len(states), period)])  # the clock of the observation stands at 0 now
    plant.set_demand(law.predict(observation, state=memory)[0])
    _advance(plant, robot, period)
    motors = [plant.motor_angle, plant.motor_speed]
    after = np.concatenate([plant.pose, plant.velocity, *motors, motor_speed], axis=1)
    loop = (after[: len(rest)] - after[len(rest) :]).T / (2 * _DIFFERENCE)
    return float(np.log(np.abs(np.linalg.eigvals(loop)).max()) / period)


def controllable_states(robot: Robot, *, period: float = 0.02) -> int:
    """Rank of the controllability matrix of a flexible robot's plant, sampled and linearised at rest at home.

    With m inputs and 2 (n + m) states, [B, AB, …] up to the fourth power is square where n = m; columns have unit
    length and rows that of their state's largest response, so that units do not decide.

    Args:
        robot: flexible.
        period: of the sampling [s]; a few of them should move the platform.
    """
    n, m = robot.coordinates, robot.cables
    size, robot = 2 * (n + m), unclipped(robot)
    angle = textbook.static_motor_angle(robot, robot.mass, robot.home, minimum=textbook.MINIMUM_TENSION)
    hold = textbook.static_torque(robot, robot.mass, robot.home, minimum=textbook.MINIMUM_TENSION) / robot.stall_torque
    rest = np.concatenate([robot.home, np.zeros(n), angle, np.zeros(m), hold])
    step = np.concatenate([np.full(size, _DIFFERENCE), np.full(m, _DIFFERENCE / robot.stall_torque.max())])
    states = np.concatenate([rest + np.diag(step), rest - np.diag(step)])
    pose, velocity, motor_angle, motor_speed, demand = np.split(states, [n, 2 * n, 2 * n + m, size], axis=1)
    plant, everyone = Plant(robot, len(states), cable="bilateral"), np.arange(len(states))
    plant.set_state(everyone, pose, velocity)
    plant.set_motors(everyone, motor_angle, motor_speed)
    plant.set_demand(demand + robot.speed_slope / robot.stall_torque * motor_speed)
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
    """One control period, in steps that do not damp the springs."""
    substeps = math.ceil(period * textbook.highest_frequency(robot) / _TURN)
    plant.advance(np.zeros((1, 1, robot.coordinates)), np.zeros(1, np.int64), substeps=substeps, step=period / substeps)
