"""States and plants of robots with elastic cables."""

from __future__ import annotations

import dataclasses

import numpy as np

from cablebot_gym.physics import textbook
from oracles.plants import State, loaded_plant, state_of, with_transmission
from oracles.platforms import CAMERA, CRANE, HANGING, TURNING

JOINTS = {"stiffness": 400.0, "motor_inertia": 3e-3, "motor_damping": 0.01}
SWIVELLED_CAMERA = CAMERA.replace(swivel_radius=(0.1, 0.05, 0.0, 0.1))
SWIVELLED_CRANE = CRANE.replace(swivel_radius=0.05)
ELASTIC = (
    with_transmission(HANGING, axial_stiffness=2e4, axial_damping=40.0, extra_length=0.5),
    with_transmission(TURNING, axial_stiffness=(2e4, 3e4, 1e4, 2e4, 5e4), **JOINTS),
    with_transmission(
        SWIVELLED_CAMERA, axial_stiffness=2e4, coulomb_friction=0.3, load_friction=0.1
    ),
    with_transmission(
        SWIVELLED_CRANE, axial_stiffness=1e5, axial_damping=20.0, load_friction=0.05, **JOINTS
    ),
)
"""The last one has everything: swivel pulleys, springs, elastic cables, load friction, an inertia and a
centre of mass without symmetry."""


@dataclasses.dataclass
class ElasticState(State):
    """Without joint springs the motors' states are those of the pulleys."""

    pulley: np.ndarray
    pulley_speed: np.ndarray


def states(robot, count, tension=400.0, spread=1.0):
    """Random states near home, wound as at rest, whose tensions lie between ``1 − spread`` and ``1 + spread`` of
    ``tension``."""
    random = np.random.default_rng(1)
    size = (count, robot.coordinates)
    pose = robot.home + random.uniform(-0.15, 0.15, size)
    velocity = random.normal(size=size) / 3
    tensions = tension * (1 + spread * random.uniform(-1, 1, (count, robot.cables)))
    motor, pulley = textbook.rest_angles(robot, tensions, pose)
    speed = textbook.pulley_speed(robot, pose, velocity)
    return ElasticState(pose, velocity, motor, speed.copy(), pulley, speed)


def plant_at(robot, state, cable="unilateral"):
    plant = loaded_plant(robot, state, cable)
    if robot.jointed:
        plant.set_pulleys(np.arange(plant.count), state.pulley, state.pulley_speed)
    return plant


def elastic_state_of(plant):
    values = vars(state_of(plant)).values()
    return ElasticState(*values, plant.pulley_angle, plant.pulley_speed)


def holding_torques(robot, state):
    """Torques (N, m) on the motors that the cables balance."""
    return textbook.cable_springs(
        robot, state.pose, 0 * state.velocity, state.pulley, 0 * state.pulley
    )[1]
