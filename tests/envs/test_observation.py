"""Blocks of the observation beyond state and reference, its layout, the normalised form, and sensors of winches and
platform in place of pose and velocity."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    PLANAR,
    ROBOTS,
    SPATIAL,
    make,
    random_actions,
    rigid_ids,
    rollout,
    two_ids,
)

from cablebot_gym.envs.observation import LAST_ACTIONS, observation_layout
from cablebot_gym.envs.sensors import inertial
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.kinematics import cable_lengths, euler_rate_matrix, rotation_matrix
from cablebot_gym.robots import find_robot, library

# --- last actions and slack time ----------------------------------------------------------------------------------


def test_last_actions_are_those_sent_in_this_episode():
    """Latest first, clipped, before delay, zeros after a reset."""
    dwell = {"trajectory": {"name": "dwell-planar", "duration": 0.02}}
    env = make(PLANAR, uncertainty={"delay": 2}, **dwell)
    for _ in range(2):
        observation, _ = env.reset(seed=0)
        sent = np.zeros((LAST_ACTIONS, 3))
        for action in random_actions(env, 10, -0.8, 1.6):
            last = env.layout.split(observation)["last_actions"]
            assert_array_equal(last, sent.ravel())
            observation = env.step(action)[0]
            sent = np.concatenate([np.clip(action, -1, 1)[None], sent[:-1]])


# --- layout -------------------------------------------------------------------------------------------------------


def test_model_payload_spans_the_payload_range_of_a_real_robot():
    """At 1000 kg it did: laws that read it sagged with the tonnes of FAST."""
    for name in library():
        robot = find_robot(name)
        blocks = {block.name: block for block in observation_layout(robot).blocks}
        assert robot.defaults.payload_range[1] <= blocks["model_payload"].high[0], name


# --- normalised ---------------------------------------------------------------------------------------------------


@two_ids
def test_normalised_observation_is_the_layouts_function(env_id):
    """With sensor noise, payload, delay and saturated components."""
    uncertainty = {"sensors": {"position": 1e-3, "velocity": 30.0}, "delay": 1}
    keywords = {"uncertainty": uncertainty, "payload": 1.0}
    env, twin = (make(env_id, normalised_observation=form, **keywords) for form in (False, True))
    actions = random_actions(env, 40)
    raw, normalised = (rollout(form, actions, seed=0).observations for form in (env, twin))
    assert np.any(raw == env.observation_space.high)  # velocities saturate
    assert_array_equal(normalised, env.layout.normalise(raw))
    space = twin.observation_space
    assert space == env.layout.space(normalised=True)
    assert all(observation in space for observation in normalised)
    assert np.all(np.isfinite([space.low, space.high]))


def test_pose_and_velocity_become_tracking_errors():
    env = make(SPATIAL, normalised_observation=True, trajectory="paper-spatial")
    error = np.array([0.01, -0.02, 0.0, 0.005, 0.0, -0.01])
    blocks = env.layout.split(env.reset(options={"initial_error": error})[0])
    assert_allclose(blocks["pose"], error / 0.01, atol=1e-9)
    assert_allclose(blocks["velocity"], 0.0, atol=1e-9)


ANCHORS = {"parameters": {"base_anchors": {"low": -0.01, "high": 0.01, "relative": False}}}


@rigid_ids
def test_motor_angles_are_those_of_the_true_anchors(env_id):
    """Readings of the nominal robot would tell the true pose exactly, whatever the anchors."""
    robot = ROBOTS[env_id]
    env = make(env_id, measurement="winches", uncertainty=ANCHORS)
    env.reset(seed=3)
    for _ in range(5):
        before = env.pose
        observation = env.step(np.full(robot.cables, 0.1))[0]
    base = env.truth["base_anchors"]
    assert np.abs(base - robot.base).max() > 1e-3
    poses = np.stack([robot.home, env.pose, before])
    angles = -cable_lengths(base, robot.platform, poses) / robot.pulley_radius
    reading = env.layout.split(observation)
    assert_allclose(reading["motor_angle"], angles[1] - angles[0], atol=1e-12)
    rate = (angles[1] - angles[2]) / env.settings.period
    assert_allclose(reading["motor_speed"], rate, atol=0.2 * np.abs(rate).max())


def test_imu_reads_acceleration_without_gravity_and_load_cells_the_weight():
    """At rest after a reset; then the mean acceleration of a period."""
    robot = ROBOTS[SPATIAL]
    gravity = np.array([0, 0, robot.gravity])
    env = make(SPATIAL, measurement="winches+tensions+imu", payload=2.0)
    reading = env.layout.split(env.reset()[0])
    rotation = rotation_matrix(env.pose[3:])
    assert_allclose(reading["specific_force"], rotation.T @ -gravity)
    cables = robot.base - env.pose[:3] - robot.platform @ rotation.T
    pulls = reading["tensions"] @ (cables / np.linalg.norm(cables, axis=1, keepdims=True))
    assert_allclose(pulls, -(robot.mass + 2.0) * gravity, atol=1e-9)
    velocities = []
    for action in (0.3, 0.5):
        observation = env.step(np.full(6, action))[0]
        velocities.append(env._simulation._plant.velocity[0, :3])
    acceleration = (velocities[1] - velocities[0]) / env.settings.period
    expected = rotation_matrix(env.pose[3:]).T @ (acceleration - gravity)
    force = env.layout.split(observation)["specific_force"]
    assert_allclose(force, expected, atol=1e-9)


def test_gyroscope_reads_the_rate_in_the_frame_of_the_platform():
    rng = np.random.default_rng(1)
    pose = 0.5 * rng.normal(size=6)
    velocity = rng.normal(size=6)
    rate = inertial(ROBOTS[SPATIAL], pose, velocity, np.zeros(3))[1]
    assert_allclose(rate, euler_rate_matrix(pose[3:]) @ velocity[3:])


def test_encoder_rounds_the_angles_of_motors():
    encoder = {"kind": "winches", "encoder_resolution": 1e-3}
    exact, rounded = (
        rollout(make(PLANAR, measurement=sensors), np.full((3, 3), 0.1), seed=1).observations
        for sensors in ("winches", encoder)
    )
    block = make(PLANAR, measurement=encoder).layout.slices()["motor_angle"]
    assert_allclose(rounded[:, block], 1e-3 * np.rint(exact[:, block] / 1e-3), atol=1e-12)


def test_law_of_pose_is_rejected_with_the_name_to_type():
    """A spatial robot has as many motor angles as coordinates: the law would read them as its
    pose."""
    with pytest.raises(ValueError, match=r"reads measurement 'pose'.*such as ekf\+fl"):
        evaluate_dlcc("fl", SPATIAL, measurement="winches")
