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

_SAMPLING = 0.02
"""Sampling period for the controllability [s]; the platform moves within a few periods."""

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
    rest_state = _rest(robot)
    steps = np.full(len(rest_state), _DIFFERENCE)
    plant = _plant_at(robot, _neighbours(rest_state, steps))
    action, _ = law.predict(_observation(robot, plant))
    plant.set_action(action)
    _advance(plant, robot, period)
    transition = _central_difference(_state(plant), steps)
    largest_factor = np.abs(np.linalg.eigvals(transition)).max()
    return float(np.log(largest_factor) / period)


def controllable_states(robot: Robot) -> int:
    """Rank of the controllability matrix of a flexible robot's plant, sampled and linearised at
    rest at home.

    With m inputs and 2 (n + m) states, [B, AB, …] up to the fourth power is square if n = m. Each
    column is divided by its norm and each row by its largest absolute entry, which removes the
    influence of the units.
    """
    robot = unsaturated_actions(robot)
    torque = textbook.static_torque(robot, robot.mass, robot.home)
    rest_state = _rest(robot)
    size = len(rest_state)
    rest_values = np.concatenate([rest_state, torque / robot.stall_torque])
    steps = np.full(len(rest_values), _DIFFERENCE)
    steps[size:] /= robot.stall_torque.max()
    values = _neighbours(rest_values, steps)
    plant = _plant_at(robot, values)
    speed_slope = robot.speed_slope / robot.stall_torque
    plant.set_action(values[:, size:] + speed_slope * plant.motor_speed)
    _advance(plant, robot, _SAMPLING)
    response = _central_difference(_state(plant), steps)
    transition, reached = np.split(response, [size], axis=1)
    powers = [reached]
    while len(powers) < size // robot.cables:
        powers.append(transition @ powers[-1])
    controllability = np.concatenate(powers, axis=1)
    controllability /= np.linalg.norm(controllability, axis=0)
    controllability /= np.abs(controllability).max(axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(controllability, tol=1e-6))


def _neighbours(values: Array, steps: Array) -> Array:
    """Values with one entry each increased and then decreased by its step, (2 N, N)."""
    changes = np.diag(steps)
    return np.concatenate([values + changes, values - changes])


def _central_difference(results: Array, steps: Array) -> Array:
    """Derivatives of results, (M, N), at the :func:`_neighbours` of values, (2 N, M)."""
    above, below = np.split(results, 2)
    derivatives: Array = (above - below).T / (2 * steps)
    return derivatives


def _rest(robot: Robot) -> Array:
    """State (X, Ẋ, β′, β̇′) at rest at home."""
    angle = textbook.static_motor_angle(robot, robot.mass, robot.home)
    velocity = np.zeros(robot.coordinates)
    return np.concatenate([robot.home, velocity, angle, np.zeros(robot.cables)])


def _plant_at(robot: Robot, states: Array) -> Plant:
    """A plant in states that begin with (X, Ẋ, β′, β̇′), shape (B, ...)."""
    n, m = robot.coordinates, robot.cables
    pose, velocity, angle, speed, _ = np.split(states, np.cumsum([n, n, m, m]), axis=1)
    plant = Plant(robot, len(states), cable="bilateral")
    indices = np.arange(len(states))
    plant.set_state(indices, pose, velocity)
    plant.set_motors(indices, angle, speed)
    return plant


def _state(plant: Plant) -> Array:
    state = (plant.pose, plant.velocity, plant.motor_angle, plant.motor_speed)
    return np.concatenate(state, axis=1)


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
    references = np.zeros((1, 1, robot.coordinates))
    ends = np.zeros(1, np.int64)
    plant.advance(references, ends, substeps=substeps, step=period / substeps)
