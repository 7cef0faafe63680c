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

_TURN = 0.05
"""Maximum phase advance of the fastest mode per physics step [rad], small enough for RK4 to add no
damping."""

_DIFFERENCE = 1e-6
"""Half step of the central differences."""

_SAMPLING = 0.02
"""Sampling period for the controllability [s]; the platform moves within a few periods."""

_BEYOND = 1e6
"""Factor of the motor torques for motors that never saturate."""


def unsaturated_actions(robot: Robot) -> Robot:
    """Copy of the robot whose motors never saturate; the torque-speed lines keep their slope."""
    stall = tuple(_BEYOND * robot.stall_torque)
    free = tuple(_BEYOND * robot.stall_torque / robot.speed_slope)
    return robot.replace(motors=Motors(stall_torque=stall, free_speed=free))


def growth_rate(law: Any, robot: Robot, *, control_frequency: float = 500.0) -> float:
    """max Re(log z / h) of the loop sampled with a zero-order hold, linearised at rest at home
    [1/s].

    The state is (X, Ẋ, β′, β̇′) and the motor speeds of the previous sample, which a law may store.
    Cables transmit compression. The linearisation uses central differences over one control period
    of the plant.

    Args:
        law: control law built for the robot.
        robot: flexible robot with the motors of :func:`unsaturated_actions`.
        control_frequency: 1/h [Hz].
    """
    period = 1 / control_frequency
    rest_state = np.concatenate([_rest(robot), np.zeros(robot.cables)])
    size = len(rest_state)
    step = _DIFFERENCE * np.eye(size)
    states = np.concatenate([rest_state + step, rest_state - step])
    plant = _plant_at(robot, states)
    past_speed = states[:, -robot.cables :]
    # The observation has a time of 0, so the previous sample was at the time -period.
    memory = np.column_stack([past_speed, np.full(2 * size, period)])
    action, _ = law.predict(_observation(robot, plant), state=memory)
    motor_speed = plant.motor_speed.copy()
    plant.set_action(action)
    _advance(plant, robot, period)
    after = np.concatenate([_state(plant), motor_speed], axis=1)
    above, below = np.split(after, 2)
    loop = (above - below).T / (2 * _DIFFERENCE)
    return float(np.log(np.abs(np.linalg.eigvals(loop)).max()) / period)


def controllable_states(robot: Robot) -> int:
    """Rank of the controllability matrix of a flexible robot's plant, sampled and linearised at
    rest at home.

    With m inputs and 2 (n + m) states, [B, AB, …] up to the fourth power is square if n = m. Each
    column is divided by its norm and each row by its largest absolute entry, which removes the
    influence of the units.
    """
    robot = unsaturated_actions(robot)
    minimum = textbook.MINIMUM_TENSION
    torque = textbook.static_torque(robot, robot.mass, robot.home, minimum=minimum)
    hold = torque / robot.stall_torque
    rest_state = np.concatenate([_rest(robot), hold])
    size = len(rest_state) - robot.cables
    step = np.full(len(rest_state), _DIFFERENCE)
    step[size:] /= robot.stall_torque.max()
    states = np.concatenate([rest_state + np.diag(step), rest_state - np.diag(step)])
    plant = _plant_at(robot, states)
    plant.set_action(states[:, size:] + robot.speed_slope / robot.stall_torque * plant.motor_speed)
    _advance(plant, robot, _SAMPLING)
    after = _state(plant)
    above, below = np.split(after, 2)
    response = (above - below).T / (2 * step)
    transition = response[:, :size]
    columns = [response[:, size:]]
    for _ in range(size // robot.cables - 1):
        columns.append(transition @ columns[-1])
    reach = np.concatenate(columns, axis=1)
    reach /= np.linalg.norm(reach, axis=0)
    reach /= np.abs(reach).max(axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(reach, tol=1e-6))


def _rest(robot: Robot) -> Array:
    """State (X, Ẋ, β′, β̇′) at rest at home."""
    angle = textbook.static_motor_angle(
        robot, robot.mass, robot.home, minimum=textbook.MINIMUM_TENSION
    )
    return np.concatenate([robot.home, np.zeros(robot.coordinates), angle, np.zeros(robot.cables)])


def _plant_at(robot: Robot, states: Array) -> Plant:
    """A plant in states that begin with (X, Ẋ, β′, β̇′), shape (B, ...)."""
    n, m = robot.coordinates, robot.cables
    pose, velocity, angle, speed, _ = np.split(states, [n, 2 * n, 2 * n + m, 2 * n + 2 * m], axis=1)
    plant = Plant(robot, len(states), cable="bilateral")
    everyone = np.arange(len(states))
    plant.set_state(everyone, pose, velocity)
    plant.set_motors(everyone, angle, speed)
    return plant


def _state(plant: Plant) -> Array:
    return np.concatenate(
        [plant.pose, plant.velocity, plant.motor_angle, plant.motor_speed], axis=1
    )


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


def _advance(plant: Plant, robot: Robot, period: float) -> None:
    """Advances the plant by one control period in steps that are short enough not to damp the
    springs."""
    substeps = math.ceil(period * textbook.highest_frequency(robot) / _TURN)
    wrench = np.zeros((1, 1, robot.coordinates))
    plant.advance(wrench, np.zeros(1, np.int64), substeps=substeps, step=period / substeps)
