"""States and plants of robots with elastic cables."""

from __future__ import annotations

import dataclasses

import numpy as np

from cablebot_gym.physics import textbook
from cablebot_gym.physics.plant import Plant
from oracles.plants import State


@dataclasses.dataclass
class ElasticState(State):
    """Without joint springs the motors' states are those of the pulleys."""

    pulley: np.ndarray
    pulley_speed: np.ndarray


def states(robot, count, tension=400.0, spread=1.0):
    """Random states near home whose tensions lie between ``1 − spread`` and ``1 + spread`` of
    ``tension``."""
    random = np.random.default_rng(1)
    size = (count, robot.coordinates)
    pose = robot.home + random.uniform(-0.15, 0.15, size)
    velocity = random.normal(size=size) / 3
    tensions = tension * (1 + spread * random.uniform(-1, 1, (count, robot.cables)))
    if robot.elastic:
        motor, pulley = textbook.rest_angles(robot, tensions, pose)
    elif robot.jointed:
        motor = (
            textbook.pulley_angle(robot, pose) + robot.pulley_radius * tensions / robot.stiffness
        )
        pulley = 0 * motor
    else:
        motor = 0 * tensions
        pulley = 0 * tensions
    speed = textbook.pulley_speed(robot, pose, velocity)
    return ElasticState(pose, velocity, motor, speed.copy(), pulley, speed)


def plant_at(robot, state, cable="unilateral"):
    everyone = np.arange(len(state.pose))
    plant = Plant(robot, len(everyone), cable=cable)
    plant.set_state(everyone, state.pose, state.velocity)
    if robot.flexible:
        plant.set_motors(everyone, state.angle, state.speed)
    if robot.elastic and robot.jointed:
        plant.set_pulleys(everyone, state.pulley, state.pulley_speed)
    return plant


def elastic_state_of(plant):
    motors = plant.motor_angle, plant.motor_speed
    return ElasticState(
        plant.pose,
        plant.velocity,
        *motors,
        plant.pulley_angle,
        plant.pulley_speed,
    )


def holding_torques(robot, state):
    """Torques (N, m) on the motors that the cables balance."""
    return textbook.cable_springs(
        robot, state.pose, 0 * state.velocity, state.pulley, 0 * state.pulley
    )[1]
