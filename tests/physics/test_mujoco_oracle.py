"""The plant against MuJoCo, which knows bodies and tendons but none of the paper's equations."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import mujoco_model
from oracles.plants import (
    FLEX_HANGING,
    FLEX_QUAD,
    FLEX_UNEQUAL,
    OTHER_KINDS,
    QUAD,
    ROUGH,
    UNEQUAL,
    State,
    advance,
    drive_speed,
    each_of,
    evaluated,
    every_robot,
    flexible_robots,
    free_motors,
    held_states,
    loaded_plant,
    motion_accelerations,
    off_centre,
    random_states,
    state_of,
    textbook_rates,
    with_transmission,
    worst_relative_error,
)
from oracles.platforms import CAMERA, CRANE, HANGING, TURNING

from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL

pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")

STATES, PAYLOAD = 100, 3.5


def loaded_peer(peer, state, lane):
    peer.set_state(state.pose[lane], state.velocity[lane])
    if peer.robot.flexible:
        peer.set_motors(state.angle[lane], state.speed[lane])


@each_of(PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL, QUAD, UNEQUAL, FLEX_QUAD, FLEX_UNEQUAL, *ROUGH, *OTHER_KINDS)
def test_accelerations_of_textbook_and_kernel_are_those_of_mujoco(robot):
    """Reached: 5e-15; flexible 2e-12, and 4e-12 by differences: winches far off cost MuJoCo's springs digits.

    MuJoCo's motors get the torque that the Coulomb friction leaves.
    """
    state, action = random_states(robot, STATES, seed=20, reach=0.6 if robot.flexible else 1.0)
    torques, mass = np.clip(action, -0.9, 0.9) * robot.stall_torque, robot.mass + PAYLOAD
    peer, platform, motors = mujoco_model.MujocoRobot(robot, payload=PAYLOAD), [], []
    speed = drive_speed(robot, state)
    left = torques - robot.coulomb_friction * speed / np.hypot(speed, 0.5)
    for lane in range(STATES):
        loaded_peer(peer, state, lane)
        platform.append(peer.accelerations(left[lane]))
        if robot.flexible:
            motors.append(peer.motor_accelerations(left[lane]))
    tolerance = 1e-11 if robot.flexible else 1e-13
    rates, _ = textbook_rates(robot, state, torques, mass=mass)
    assert worst_relative_error(rates.velocity, np.array(platform)) <= tolerance
    compiled, _ = evaluated(loaded_plant(robot, state, mass=mass), torques)
    assert worst_relative_error(compiled, np.array(platform)) <= tolerance
    if robot.flexible:
        assert worst_relative_error(rates.speed, np.array(motors)) <= 1e-11
        if robot.coulomb_friction.any():  # it changes within the step of the differences
            return
        moved, turned = motion_accelerations(robot, state, torques, mass=mass)
        assert worst_relative_error(moved, np.array(platform)) <= 1e-10
        assert worst_relative_error(turned, np.array(motors)) <= 1e-10


@pytest.mark.parametrize("spread", [0.5, 2.0], ids=["taut", "slack"])
@each_of(HANGING, TURNING, CAMERA, CRANE)
def test_elastic_cables_are_the_one_sided_springs_of_mujoco(robot, spread):
    """Their damping while taut; MuJoCo's dampers push slack cables, too. The pulleys stand still."""
    damping = 30.0 if spread < 1 else 0.0
    robot = with_transmission(robot, axial_stiffness=2e4, axial_damping=damping, extra_length=0.3)
    state, _ = random_states(robot, STATES, seed=24, reach=0.4)
    tensions = 400 * (1 + spread * np.random.default_rng(25).uniform(-1, 1, (STATES, robot.cables)))
    angle = textbook.rest_angles(robot, tensions, state.pose)[1]
    compiled = loaded_plant(robot, State(state.pose, state.velocity, angle, 0 * angle), "unilateral")
    home, peer, expected = textbook.cable_lengths(robot, robot.home), mujoco_model.MujocoRobot(robot), []
    for lane in range(STATES):
        peer.set_state(state.pose[lane], state.velocity[lane])
        peer.set_free_lengths(home + robot.extra_length - robot.pulley_radius * angle[lane])
        expected.append(peer.accelerations(np.zeros(robot.cables)))
    found, pulled = evaluated(compiled, np.zeros_like(angle))
    assert np.all(pulled > 0) if spread < 1 else np.any(pulled == 0)
    assert worst_relative_error(found, np.array(expected)) <= 1e-9


@each_of(QUAD, UNEQUAL, FLEX_QUAD, FLEX_UNEQUAL, FLEX_HANGING, TURNING, CAMERA, CRANE)
def test_wrench_acts_at_the_centre_of_mass_in_the_base_frame(robot):
    state, action = random_states(robot, STATES, seed=22)
    torques, rng = action * robot.stall_torque, np.random.default_rng(23)
    force, moment = rng.uniform(-50, 50, (STATES, 3)), rng.uniform(-10, 10, (STATES, 3))
    compiled, peer, expected = loaded_plant(robot, state), mujoco_model.MujocoRobot(robot), []
    compiled.set_wrench(np.arange(STATES), force[:, : robot.dimensions], moment)
    for lane in range(STATES):
        loaded_peer(peer, state, lane)
        peer.set_wrench(force[lane], moment[lane])
        expected.append(peer.accelerations(torques[lane]))
    assert worst_relative_error(evaluated(compiled, torques)[0], np.array(expected)) <= 1e-10


@pytest.mark.parametrize("count", [1, 2])
@every_robot
def test_trajectory_is_that_of_mujoco(robot, count):
    """100 RK4 steps of both, each a control period of the plant; MuJoCo integrates a quaternion."""
    timestep, steps, (pose, velocity) = 5e-4, 100, off_centre(robot)
    state, torques = State(pose[None], velocity[None], *np.zeros((2, 1, robot.cables))), 0.1 * robot.stall_torque
    if robot.flexible:
        state, torques = held_states(robot, pose, velocity)
        torques = 0.7 * torques[0] + 0.02
    peer = mujoco_model.MujocoRobot(robot, timestep=timestep)
    loaded_peer(peer, state, 0)
    peer.step(torques, steps)
    plant = loaded_plant(free_motors(robot), state[np.zeros(count, int)])
    for _ in range(steps):
        advance(plant, torques, timestep, 1)
    ends = (*peer.state(), *(peer.motors() if robot.flexible else ()))
    for found, expected, began in zip(vars(state_of(plant)).values(), ends, vars(state).values(), strict=False):
        assert np.abs(found - began).max() > 1e-3
        size = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found / size, np.tile(expected / size, (count, 1)), rtol=0, atol=1e-11)


@each_of(PLANAR, SPATIAL, QUAD, UNEQUAL)
def test_model_has_the_lengths_and_returns_the_state(robot):
    """The oracle's own conversion of Euler angles to quaternions and back."""
    peer = mujoco_model.MujocoRobot(robot)
    state, _ = random_states(robot, STATES, reach=1.0)
    for pose, velocity in zip(state.pose, state.velocity, strict=True):
        peer.set_state(pose, velocity)
        np.testing.assert_allclose(peer.lengths(), cable_lengths(robot.base, robot.platform, pose), rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.concatenate(peer.state()), np.append(pose, velocity), rtol=0, atol=1e-13)


@flexible_robots
def test_model_starts_with_unwound_springs(robot):
    """Without :meth:`set_motors` the motors turn with the pulleys."""
    peer, (state, _) = mujoco_model.MujocoRobot(robot), random_states(robot, 20, seed=3)
    for pose, velocity in zip(state.pose, state.velocity, strict=True):
        peer.set_state(pose, velocity)
        angle, speed = peer.motors()
        np.testing.assert_allclose(angle, textbook.pulley_angle(robot, pose), rtol=0, atol=1e-11)
        np.testing.assert_allclose(speed, textbook.pulley_speed(robot, pose, velocity), rtol=0, atol=1e-11)
