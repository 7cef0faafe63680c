"""Textbook and plant against MuJoCo, which knows bodies and tendons but none of the paper's equations."""

import numpy as np
import pytest
from oracles.mujoco_model import MujocoRobot
from oracles.plants import (
    FLEX_HANGING,
    FLEX_QUAD,
    FLEX_UNEQUAL,
    KINDS,
    QUAD,
    UNEQUAL,
    State,
    advance,
    each_of,
    free_motors,
    friction_torques,
    loaded_plant,
    random_states,
    textbook_rates,
    with_transmission,
    worst_relative_error,
)
from oracles.platforms import CAMERA, CRANE, FLAT, HANGING, TURNING

from cablebot_gym.physics import textbook

pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")

STATES = 50
PAYLOAD = 3.5


def accelerations_of_mujoco(peer, state, torques, wrench=None):
    """Accelerations of the platform, and of the motors of a flexible robot, (N, n) and (N, m)."""
    platform = []
    motors = []
    for lane, torque in enumerate(torques):
        peer.set_lane(state, lane)
        if wrench is not None:
            peer.set_wrench(*(vectors[lane] for vectors in wrench))
        platform.append(peer.accelerations(torque))
        if peer.robot.flexible:
            motors.append(peer.motor_accelerations(torque))
    return np.array(platform), np.array(motors)


@each_of(*KINDS, FLAT)
def test_accelerations_are_those_of_mujoco(robot):
    """Reached: 5e-15; flexible 2e-12: winches far off cost MuJoCo's springs digits.

    MuJoCo's motors get the torque that the friction leaves.
    """
    state, action = random_states(robot, STATES, seed=20, reach=0.6 if robot.flexible else 1.0)
    torques = np.clip(action, -0.9, 0.9) * robot.stall_torque
    mass = robot.mass + PAYLOAD
    rates, tension = textbook_rates(robot, state, torques, mass=mass)
    after_friction = torques - friction_torques(robot, state, torques, tension, "bilateral")
    peer = MujocoRobot(robot, payload=PAYLOAD)
    platform, motors = accelerations_of_mujoco(peer, state, after_friction)
    tolerance = 1e-11 if robot.flexible else 1e-13
    assert worst_relative_error(rates.velocity, platform) <= tolerance
    if robot.flexible:
        assert worst_relative_error(rates.speed, motors) <= 1e-11


@pytest.mark.parametrize("spread", [0.5, 2.0], ids=["taut", "slack"])
@each_of(CAMERA, CRANE, HANGING, TURNING)
def test_elastic_cables_are_the_one_sided_springs_of_mujoco(robot, spread):
    """Their damping while taut; MuJoCo's dampers push slack cables, too. The pulleys stand
    still."""
    damping = 30.0 if spread < 1 else 0.0
    robot = with_transmission(robot, axial_stiffness=2e4, axial_damping=damping, extra_length=0.3)
    state, _ = random_states(robot, STATES, seed=24, reach=0.4)
    tensions = 400 * (1 + spread * np.random.default_rng(25).uniform(-1, 1, (STATES, robot.cables)))
    angle = textbook.rest_angles(robot, tensions, state.pose)
    free_lengths = (
        textbook.cable_lengths(robot, robot.home) + robot.extra_length - robot.pulley_radius * angle
    )
    peer = MujocoRobot(robot)
    expected = []
    for lane in range(STATES):
        peer.set_state(state.pose[lane], state.velocity[lane])
        peer.set_free_lengths(free_lengths[lane])
        expected.append(peer.accelerations(np.zeros(robot.cables)))
    still = 0 * angle
    elastic = State(state.pose, state.velocity, angle, still)
    rates, tension = textbook_rates(robot, elastic, still, "unilateral")
    assert np.all(tension > 0) == (spread < 1)
    assert worst_relative_error(rates.velocity, np.array(expected)) <= 1e-9


@each_of(QUAD, UNEQUAL, FLEX_QUAD, FLEX_UNEQUAL, FLEX_HANGING, CAMERA, CRANE)
def test_wrench_acts_at_the_centre_of_mass_in_the_base_frame(robot):
    robot = free_motors(robot)
    state, action = random_states(robot, STATES, seed=22)
    torques = np.clip(action, -1, 1) * robot.stall_torque
    rng = np.random.default_rng(23)
    force = rng.uniform(-50, 50, (STATES, 3))
    moment = rng.uniform(-10, 10, (STATES, 3))
    expected, _ = accelerations_of_mujoco(MujocoRobot(robot), state, torques, (force, moment))
    plant = loaded_plant(robot, state)
    plant.set_wrench(np.arange(STATES), force[:, : robot.dimensions], moment)
    advance(plant, torques, 1e-7, 1)
    acceleration = (plant.velocity - state.velocity) / 1e-7
    assert worst_relative_error(acceleration, expected) <= 1e-4
