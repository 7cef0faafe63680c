"""The rigid plant against MuJoCo, which knows bodies and tendons but none of the paper's equations."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import mujoco_model

from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import kernel, plant, textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Motors, Transmission

pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")

STATES = 200

# Every motor and every axis different, so that no two can be swapped unseen.
UNEQUAL_SPATIAL = SPATIAL.replace(
    name="unequal spatial",
    inertia=(0.9, 0.3, 0.6),  # a plate, whose largest moment rounds to just above the sum of the others
    motors=Motors(stall_torque=(8.0, 9.0, 10.0, 11.0, 12.0, 13.0), free_speed=100.0),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0),
        damping=(0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    ),
    home_pose=(0.02, -0.01, 0.4, 0.03, -0.02, 0.05),
)
UNEQUAL_PLANAR = PLANAR.replace(
    name="unequal planar",
    base_anchors=((-0.6, -0.3), (0.5, -0.4), (0.4, 0.5), (-0.5, 0.6)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06), pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3), damping=(0.0, 0.01, 0.02, 0.03)
    ),
    home_pose=(0.05, 0.1),
)

each_robot = pytest.mark.parametrize(
    "robot", [PLANAR, SPATIAL, UNEQUAL_PLANAR, UNEQUAL_SPATIAL], ids=lambda robot: robot.name
)
each_payload = pytest.mark.parametrize("payload", [0.0, 3.5])


def loaded_plant(robot, payload, count):
    """The compiled plant with cables that may push, as MuJoCo's do, and a payload."""
    compiled = plant.Plant(robot, count, cable="bilateral")
    parameters = plant.pack_parameters(robot)
    parameters[kernel.MASS] += payload
    compiled.set_parameters(np.arange(count), np.tile(parameters, (count, 1)))
    return compiled


def random_states(robot, seed=20):
    """Poses all over the workspace, velocities up to 1 m/s and 2 rad/s, torques of both signs up to stall."""
    rng = np.random.default_rng(seed)
    fastest = np.array([1.0, 1.0] if robot.planar else [1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    pose = rng.uniform(*robot.pose_bounds, (STATES, robot.coordinates))
    velocity = rng.uniform(-fastest, fastest, (STATES, robot.coordinates))
    return pose, velocity, rng.uniform(-robot.stall_torque, robot.stall_torque, (STATES, robot.cables))


def mujoco_accelerations(robot, payload, pose, velocity, torques):
    peer = mujoco_model.MujocoRobot(robot, payload=payload)
    found = []
    for state in zip(pose, velocity, torques, strict=True):
        peer.set_state(*state[:2])
        found.append(peer.accelerations(state[2]))
    return np.array(found)


def worst_relative_error(found, expected):
    size = np.maximum(1.0, np.linalg.norm(expected, axis=-1))
    return np.max(np.linalg.norm(found - expected, axis=-1) / size)


@each_robot
def test_tendon_lengths_exclude_an_anchor_in_the_wrong_place(robot):
    peer = mujoco_model.MujocoRobot(robot)
    for pose, velocity, _ in zip(*random_states(robot), strict=True):
        peer.set_state(pose, velocity)
        np.testing.assert_allclose(peer.lengths(), cable_lengths(robot.base, robot.platform, pose), rtol=0, atol=1e-14)


@each_payload
@each_robot
def test_mujocos_accelerations_exclude_a_wrong_term_in_the_textbook(robot, payload):
    """Reached: 5e-15."""
    pose, velocity, torques = random_states(robot)
    expected = mujoco_accelerations(robot, payload, pose, velocity, torques)
    found, _ = textbook.forward_dynamics(robot, robot.mass + payload, pose, velocity, torques, cable="bilateral")
    assert worst_relative_error(found, expected) <= 1e-13


@each_payload
@each_robot
def test_mujocos_accelerations_exclude_a_wrong_term_in_the_compiled_kernel(robot, payload):
    """Reached: 5e-15."""
    pose, velocity, torques = random_states(robot, seed=21)
    expected = mujoco_accelerations(robot, payload, pose, velocity, torques)
    compiled = loaded_plant(robot, payload, STATES)
    compiled.set_state(np.arange(STATES), pose, velocity)
    assert worst_relative_error(compiled.evaluate(torques)[0], expected) <= 1e-13


@pytest.mark.parametrize(
    "robot",
    [PLANAR, SPATIAL, UNEQUAL_PLANAR, UNEQUAL_SPATIAL, FLEX_PLANAR, FLEX_SPATIAL],
    ids=lambda robot: robot.name,
)
def test_mujocos_accelerations_exclude_a_wrench_in_the_wrong_frame_or_at_the_wrong_point(robot):
    """Reached: 2e-15, and 4e-13 flexible, where winches far off cost MuJoCo's springs digits."""
    pose, velocity, torques = random_states(robot, seed=22)
    rng, lanes = np.random.default_rng(23), np.arange(STATES)
    force, moment = rng.uniform(-50, 50, (STATES, 3)), rng.uniform(-10, 10, (STATES, 3))
    compiled, peer = loaded_plant(robot, 1.0, STATES), mujoco_model.MujocoRobot(robot, payload=1.0)
    compiled.set_state(lanes, pose, velocity)
    compiled.set_wrench(lanes, force[:, :2] if robot.planar else force, moment)
    turned = textbook.pulley_angle(robot, pose) + rng.uniform(-1, 2, torques.shape)
    speed = rng.uniform(-20, 20, torques.shape)
    if robot.flexible:
        compiled.set_motors(lanes, turned, speed)
    expected = []
    for lane in lanes:
        peer.set_state(pose[lane], velocity[lane])
        if robot.flexible:
            peer.set_motors(turned[lane], speed[lane])
        peer.set_wrench(force[lane], moment[lane])
        expected.append(peer.accelerations(torques[lane]))
    assert worst_relative_error(compiled.evaluate(torques)[0], np.array(expected)) <= 1e-10


@pytest.mark.parametrize("count", [1, 2])
@each_robot
def test_mujocos_trajectory_excludes_an_euler_rate_matrix_wrong_in_textbook_and_kernel_alike(robot, count):
    """MuJoCo integrates a quaternion, with an RK4 of its own; a control period is one physics step here."""
    timestep, steps, payload = 1e-3, 100, 1.0
    torques = 0.1 * robot.stall_torque
    pose, velocity = robot.home.copy(), 0.1 * np.arange(1, robot.coordinates + 1.0)
    peer = mujoco_model.MujocoRobot(robot, payload=payload, timestep=timestep)
    peer.set_state(pose, velocity)
    peer.step(torques, steps)
    compiled = loaded_plant(robot, payload, count)
    compiled.set_state(np.arange(count), np.tile(pose, (count, 1)), np.tile(velocity, (count, 1)))
    for _ in range(steps):
        speed = textbook.pulley_speed(robot, compiled.pose, compiled.velocity)
        action = (torques + robot.speed_slope * speed) / robot.stall_torque
        assert np.abs(action).max() < 1  # else the plant would clip, which MuJoCo does not
        compiled.set_action(action)
        compiled.advance(np.zeros((1, 1, robot.coordinates)), np.zeros(1, np.int64), substeps=1, step=timestep)
        np.testing.assert_allclose(compiled.per_cable(kernel.TORQUE), np.tile(torques, (count, 1)), rtol=1e-12)
    end = np.concatenate([compiled.pose, compiled.velocity], axis=1)
    assert np.abs(end - np.append(pose, velocity)).max() > 0.01
    np.testing.assert_allclose(end, np.tile(np.concatenate(peer.state()), (count, 1)), rtol=0, atol=1e-12)


@each_robot
def test_a_round_trip_through_quaternions_excludes_a_state_that_comes_back_changed(robot):
    peer = mujoco_model.MujocoRobot(robot)
    for pose, velocity, _ in zip(*random_states(robot), strict=True):
        peer.set_state(pose, velocity)
        np.testing.assert_allclose(np.concatenate(peer.state()), np.append(pose, velocity), rtol=0, atol=1e-13)


@pytest.mark.parametrize("arguments", [{"payload": -20.0}, {"timestep": 0.0}])
def test_a_refusal_excludes_a_platform_of_negative_mass_and_a_step_of_no_time(arguments):
    with pytest.raises(ValueError, match="greater than 0"):
        mujoco_model.mjcf(SPATIAL, **arguments)


def test_a_refusal_excludes_torques_that_are_no_numbers_taken_for_zeros():
    with pytest.raises(ValueError, match="finite"):
        mujoco_model.MujocoRobot(PLANAR).accelerations([0.0, np.nan, 0.0])


def test_the_message_excludes_a_missing_mujoco_without_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(mujoco_model.importlib.sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[mujoco\]'"):
        mujoco_model.MujocoRobot(SPATIAL)
