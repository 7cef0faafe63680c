"""Sensors of winches and platform in place of pose and velocity."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cablebot_gym
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.sensors import inertial
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.kinematics import cable_lengths, rotation_matrix
from cablebot_gym.measurement import Measurement, find_measurement
from cablebot_gym.robots import find_robot

ANCHORS = {"parameters": {"base_anchors": {"low": -0.01, "high": 0.01, "relative": False}}}


def sensors(env_id):
    """All sensors that a robot can have."""
    return "winches+tensions" + ("+imu" if "Spatial" in env_id else "")


@pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)
def test_environment_with_winches_passes_the_checks_of_gymnasium(env_id):
    env = gym.make(
        env_id, measurement=sensors(env_id), normalised_observation=True, observation_dtype="float32"
    ).unwrapped
    check_env(env, skip_render_check=True)
    assert {"pose", "velocity"}.isdisjoint(env.layout.slices())


@pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)
def test_single_and_vector_environments_return_equal_readings(env_id):
    keywords = {
        "measurement": {"kind": "winches", "encoder_resolution": 1e-3, "tensions": True, "imu": "Spatial" in env_id},
        "uncertainty": "hardware",
    }
    single, vector = gym.make(env_id, **keywords), gym.make_vec(env_id, num_envs=5, **keywords)
    rows, one = vector.reset(seed=[7] * 5)[0], single.reset(seed=7)[0]
    actions = np.random.default_rng(0).uniform(-0.2, 0.3, (20, *single.action_space.shape))
    for action in actions:
        np.testing.assert_array_equal(rows, np.tile(one, (5, 1)))
        rows, one = vector.step(np.tile(action, (5, 1)))[0], single.step(action)[0]


@pytest.mark.parametrize("env_id", ["CableBot-Planar-v0", "CableBot-Spatial-v0"])
def test_motor_angles_are_those_of_the_true_anchors(env_id):
    """Readings of the nominal robot would tell the true pose exactly, whatever the anchors."""
    env, robot = gym.make(env_id, measurement="winches", uncertainty=ANCHORS).unwrapped, find_robot(env_robot(env_id))
    env.reset(seed=3)
    for _ in range(5):
        before = env.pose
        observation = env.step(np.full(robot.cables, 0.1))[0]
    base = env.truth["base_anchors"]
    lengths = [cable_lengths(base, robot.platform, pose) for pose in (robot.home, env.pose, before)]
    read = env.layout.split(observation)
    np.testing.assert_allclose(read["motor_angle"], (lengths[0] - lengths[1]) / robot.pulley_radius, atol=1e-12)
    rate = (lengths[2] - lengths[1]) / robot.pulley_radius / env.settings.period
    np.testing.assert_allclose(read["motor_speed"], rate, atol=0.2 * np.abs(rate).max())
    assert np.abs(base - robot.base).max() > 1e-3


def test_imu_at_rest_reads_gravity_and_load_cells_hold_the_weight():
    robot = find_robot("spatial")
    env = gym.make("CableBot-Spatial-v0", measurement="winches+tensions+imu", payload=2.0).unwrapped
    read = env.layout.split(env.reset()[0])
    np.testing.assert_allclose(read["specific_force"], rotation_matrix(env.pose[3:]).T @ [0, 0, -robot.gravity])
    pulls = read["tensions"] @ -np.array(
        [env.pose[:3] + rotation_matrix(env.pose[3:]) @ b - a for a, b in zip(robot.base, robot.platform, strict=True)]
        / cable_lengths(robot.base, robot.platform, env.pose)[:, None]
    )
    np.testing.assert_allclose(pulls, [0, 0, -(robot.mass + 2.0) * robot.gravity], atol=1e-9)


def test_accelerometer_reads_the_mean_acceleration_of_the_last_period():
    robot, velocities = find_robot("spatial"), []
    env = gym.make("CableBot-Spatial-v0", measurement="winches+imu").unwrapped
    env.reset()
    for action in ([0.3] * 6, [0.5] * 6):
        observation = env.step(np.array(action))[0]
        velocities.append(env._simulation._plant.velocity[0, :3])
    acceleration = (velocities[1] - velocities[0]) / env.settings.period
    expected = rotation_matrix(env.pose[3:]).T @ (acceleration - [0, 0, robot.gravity])
    np.testing.assert_allclose(env.layout.split(observation)["specific_force"], expected, atol=1e-9)


def test_gyroscope_reads_the_rate_in_the_frame_of_the_platform():
    rng, step = np.random.default_rng(1), 1e-6
    pose, velocity = 0.5 * rng.normal(size=6), rng.normal(size=6)
    rate = inertial(find_robot("spatial"), pose, velocity, np.zeros(3))[1]
    turned = rotation_matrix(pose[3:]).T @ rotation_matrix(pose[3:] + step * velocity[3:])
    np.testing.assert_allclose(rate, [turned[2, 1] / step, turned[0, 2] / step, turned[1, 0] / step], rtol=1e-4)


def test_zero_error_is_constant_in_an_episode_and_absent_from_the_task():
    errors = {"sensor_bias": {"motor_angle": 0.1}}
    keywords = {"measurement": {"kind": "winches", "encoder_resolution": 1e-3}}
    true = gym.make("CableBot-Planar-v0", measurement="winches").unwrapped
    drawn = gym.make("CableBot-Planar-v0", uncertainty=errors, **keywords).unwrapped
    offsets, tasks = [], []
    for seed in (1, 2):
        pairs = [[env.reset(seed=seed)[0] for env in (true, drawn)]]
        pairs += [[env.step(np.full(3, 0.1))[0] for env in (true, drawn)] for _ in range(3)]
        found = np.array([b[:3] - a[:3] for a, b in pairs])
        assert np.ptp(found, axis=0).max() <= 1e-3 + 1e-12
        np.testing.assert_allclose(np.array(pairs)[:, 1, :3] / 1e-3, np.rint(np.array(pairs)[:, 1, :3] / 1e-3))
        offsets.append(found[0])
        tasks.append(str(drawn.task))
    assert np.abs(offsets[0] - offsets[1]).max() > 0.01
    assert tasks[0] == tasks[1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("winch", "did you mean 'winches'"),
        ("winches+gps", "unknown sensor 'gps'"),
        ("winches+imu", "no platform with three angles"),
        ({"tensions": True}, "belong to the kind 'winches'"),
        ({"kind": "winches", "encoder_resolution": -1.0}, "at least 0 rad"),
    ],
)
def test_invalid_measurement_is_rejected(given, message):
    with pytest.raises(ValueError, match=message):
        find_measurement(given, find_robot("planar"))


def test_measurement_has_a_name():
    assert find_measurement("winches+tensions", find_robot("planar")).name == "winches+tensions"
    assert Measurement().name == "pose"


def test_law_of_pose_is_rejected_with_the_name_to_type():
    """A spatial robot has as many motor angles as coordinates: the law would read them as its pose."""
    with pytest.raises(ValueError, match=r"reads measurement 'pose'.*such as ekf\+fl"):
        evaluate_dlcc("fl", "CableBot-Spatial-v0", measurement="winches")
