"""The rigid plant against MuJoCo, which knows bodies and tendons but none of the paper's equations."""

from __future__ import annotations

import numpy as np
import pytest

from cablebot_gym.kinematics import (
    cable_lengths,
    euler_rate_matrix,
    euler_rate_matrix_rate,
    structure_jacobian,
    structure_jacobian_rate,
)
from cablebot_gym.physics import mujoco_model
from cablebot_gym.robots import PLANAR, SPATIAL, Motors, Transmission

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


def textbook_acceleration(robot, payload, pose, velocity, torques):
    """``Ẍ`` from ``(D + (J/r²) SᵀS) Ẍ = −h − Sᵀ(τ/r + (J/r²) Ṡ Ẋ + (c/r²) S Ẋ)``, cables pushing allowed."""
    mass, n = robot.mass + payload, robot.coordinates
    inertia_matrix, bias = mass * np.eye(n), np.zeros(n)
    if not robot.planar:
        euler, rates, inertia = pose[3:], velocity[3:], np.diag(robot.inertia)
        to_omega = euler_rate_matrix(euler)
        omega = to_omega @ rates
        inertia_matrix[3:, 3:] = to_omega.T @ inertia @ to_omega
        bias[2] = -mass * robot.gravity
        turning = inertia @ euler_rate_matrix_rate(euler, rates) @ rates + np.cross(omega, inertia @ omega)
        bias[3:] = to_omega.T @ turning
    jacobian = structure_jacobian(robot.base, robot.platform, pose)
    jacobian_rate = structure_jacobian_rate(robot.base, robot.platform, pose, velocity)
    armature, damping = robot.pulley_inertia / robot.pulley_radius**2, robot.damping / robot.pulley_radius**2
    pull = torques / robot.pulley_radius + armature * (jacobian_rate @ velocity) + damping * (jacobian @ velocity)
    with_pulleys = inertia_matrix + jacobian.T @ (armature[:, None] * jacobian)
    return np.linalg.solve(with_pulleys, -bias - jacobian.T @ pull)


def random_states(robot, seed=20):
    """Poses all over the workspace, velocities up to 1 m/s and 2 rad/s, torques of both signs up to stall."""
    rng = np.random.default_rng(seed)
    fastest = np.array([1.0, 1.0] if robot.planar else [1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    for _ in range(STATES):
        pose = rng.uniform(*robot.pose_bounds)
        yield pose, rng.uniform(-fastest, fastest), rng.uniform(-robot.stall_torque, robot.stall_torque)


@each_robot
def test_tendon_lengths_are_the_cable_lengths(robot):
    plant = mujoco_model.MujocoRobot(robot)
    for pose, velocity, _ in random_states(robot):
        plant.set_state(pose, velocity)
        np.testing.assert_allclose(plant.lengths(), cable_lengths(robot.base, robot.platform, pose), rtol=0, atol=1e-14)


@each_payload
@each_robot
def test_accelerations_agree_with_mujoco(robot, payload):
    plant = mujoco_model.MujocoRobot(robot, payload=payload)
    for pose, velocity, torques in random_states(robot):
        plant.set_state(pose, velocity)
        expected, found = plant.accelerations(torques), textbook_acceleration(robot, payload, pose, velocity, torques)
        assert np.linalg.norm(found - expected) <= 1e-11 * max(1.0, np.linalg.norm(expected))


@each_robot
def test_a_trajectory_agrees_with_mujoco_which_integrates_quaternions(robot):
    """Excludes an Euler rate matrix wrong in the same way in both: MuJoCo turns the platform without one."""
    timestep, steps, payload = 1e-3, 100, 1.0
    pose, velocity = robot.home.copy(), 0.1 * np.arange(1, robot.coordinates + 1.0)
    torques = 0.1 * robot.stall_torque
    plant = mujoco_model.MujocoRobot(robot, payload=payload, timestep=timestep)
    plant.set_state(pose, velocity)
    plant.step(torques, steps)

    def derivative(state):
        rate = state[robot.coordinates :]
        return np.append(rate, textbook_acceleration(robot, payload, state[: robot.coordinates], rate, torques))

    state = np.append(pose, velocity)
    for _ in range(steps):
        k1 = derivative(state)
        k2 = derivative(state + timestep / 2 * k1)
        k3 = derivative(state + timestep / 2 * k2)
        k4 = derivative(state + timestep * k3)
        state = state + timestep / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert np.abs(state - np.append(pose, velocity)).max() > 0.01
    np.testing.assert_allclose(np.concatenate(plant.state()), state, rtol=0, atol=1e-9)


@each_robot
def test_the_state_comes_back_as_it_was_set(robot):
    plant = mujoco_model.MujocoRobot(robot)
    for pose, velocity, _ in random_states(robot):
        plant.set_state(pose, velocity)
        np.testing.assert_allclose(np.concatenate(plant.state()), np.append(pose, velocity), rtol=0, atol=1e-13)


@pytest.mark.parametrize("arguments", [{"payload": -20.0}, {"timestep": 0.0}])
def test_what_is_not_physical_is_refused(arguments):
    with pytest.raises(ValueError, match="greater than 0"):
        mujoco_model.mjcf(SPATIAL, **arguments)


def test_torques_that_are_no_numbers_are_refused_and_not_taken_for_zeros():
    with pytest.raises(ValueError, match="finite"):
        mujoco_model.MujocoRobot(PLANAR).accelerations([0.0, np.nan, 0.0])


def test_a_missing_mujoco_names_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(mujoco_model.importlib.sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[mujoco\]'"):
        mujoco_model.MujocoRobot(SPATIAL)
