"""Identification of the winches of a platform whose pose is measured."""

import numpy as np
import pytest
from identification.lifts import by_motor
from oracles.plants import with_transmission

from cablebot_gym import record_rollout
from cablebot_gym.identification import identify
from cablebot_gym.identification.log import Log, pose_columns
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL

FRICTION = {"coulomb_friction": 0.06, "damping": 0.02, "pulley_inertia": 1e-3}


def columns_of(robot, time, pose, signals, rng):
    """Columns with noise of a log with a pose."""
    columns = {"time": time}
    for name, values in zip(pose_columns(robot), pose.T, strict=True):
        columns[name] = values + 2e-5 * rng.standard_normal(len(time))
    for quantity, (table, noise) in signals.items():
        for motor in range(robot.cables):
            errors = noise * rng.standard_normal(len(time))
            columns[f"{quantity}_{motor + 1}"] = table[:, motor] + errors
    return columns


def episode(env_id, robot, payload, trajectory=None):
    """Log of an episode of the environment with a true robot."""
    recording = record_rollout("fl", env_id, robot=robot, payload=payload, trajectory=trajectory)
    arrays = recording.arrays
    # Torques and speeds are those at the start of a step, poses at its end.
    pose = arrays["true_pose"][:-1]
    signals = {
        "speed": (arrays["motor_speeds"][1:], 0.01),
        "torque": (arrays["torques"][1:], 0.01),
    }
    time = arrays["action_time"][1:]
    columns = columns_of(robot, time, pose, signals, np.random.default_rng(0))
    columns["payload"] = np.full(len(time), payload)
    return Log(name="episode.csv", columns=columns)


@pytest.mark.parametrize(
    ("env_id", "nominal", "motions"),
    [
        ("CableBot-Spatial-v0", SPATIAL, ("circle-spatial", "lemniscate-spatial")),
        ("CableBot-Planar-v0", PLANAR, ("circle-planar", "lemniscate-planar")),
    ],
    ids=["inverse dynamics", "redundant cables"],
)
def test_friction_and_inertia_of_an_environment_are_identified(env_id, nominal, motions):
    """Actions that are held during a step delay the torques by half a step: the tolerance has a
    part for it."""
    true = with_transmission(nominal, **FRICTION)
    logs = [episode(env_id, true, 0.5 * i, motion) for i, motion in enumerate(motions, 1)]
    for name, items in by_motor(identify(nominal, logs)).items():
        if name == "load_friction":
            assert not items[0].is_determined  # it is zero, or the tensions are unknown
            continue
        for item in items:
            assert item.is_determined, name
            tolerance = item.half_width + 0.1 * FRICTION[name]
            assert item.value == pytest.approx(FRICTION[name], abs=tolerance), name


def smooth_motion(robot, rng):
    """Times, pose, velocity and acceleration of a motion of several frequencies."""
    time = 0.002 * np.arange(6000)
    sizes = np.where(np.arange(robot.coordinates) < robot.dimensions, 0.03, 0.05)
    pose = np.tile(robot.home, (len(time), 1))
    velocity, acceleration = np.zeros_like(pose), np.zeros_like(pose)
    for _ in range(3):
        rate, phase = rng.uniform(2, 7, robot.coordinates), rng.uniform(0, 6, robot.coordinates)
        argument = time[:, None] * rate + phase
        pose = pose + sizes / 2 * np.sin(argument)
        velocity = velocity + sizes / 2 * rate * np.cos(argument)
        acceleration = acceleration - sizes / 2 * rate**2 * np.sin(argument)
    return time, pose, velocity, acceleration


def test_drum_radius_and_length_offset_follow_from_pose_and_angle():
    rng = np.random.default_rng(0)
    true = with_transmission(SPATIAL, pulley_radius=0.053, **FRICTION)
    time, *motion = smooth_motion(true, rng)
    required = textbook.inverse_dynamics(true, true.mass, *motion)
    angle = textbook.pulley_angle(true, motion[0]) - 0.01 / 0.053
    signals = {"angle": (angle, 1e-4), "torque": (required.torques, 0.01)}
    log = Log(name="a.csv", columns=columns_of(true, time, motion[0], signals, rng))
    result = identify(SPATIAL, [log])
    estimates = by_motor(result)
    for name, truth in {"pulley_radius": 0.053, "length_offset": -0.01, **FRICTION}.items():
        for item in estimates[name]:
            tolerance = 1.5 * item.half_width + 1e-3 * abs(truth)
            assert item.value == pytest.approx(truth, abs=tolerance), name
            assert item.half_width < 0.3 * abs(truth)
    assert result.robot.pulley_radius == pytest.approx(0.053, rel=1e-3)


def test_stiffness_and_motor_friction_of_joint_springs_are_identified():
    rng = np.random.default_rng(0)
    truth = {"stiffness": 200.0, "motor_inertia": 1e-3, "coulomb_friction": 0.05}
    true = with_transmission(FLEX_SPATIAL, **truth, motor_damping=0.03)
    time, *motion = smooth_motion(true, rng)
    spring = textbook.inverse_dynamics(true, true.mass, *motion).torques
    angle = textbook.pulley_angle(true, motion[0]) + spring / true.stiffness
    speed = np.gradient(angle, time, axis=0)
    torque = spring + true.motor_inertia * np.gradient(speed, time, axis=0)
    torque += textbook.motor_friction(true, speed, spring)
    signals = {"angle": (angle, 1e-5), "speed": (speed, 1e-3), "torque": (torque, 0.005)}
    log = Log(name="a.csv", columns=columns_of(true, time, motion[0], signals, rng))
    estimates = by_motor(identify(FLEX_SPATIAL, [log]))
    for name, value in (truth | {"motor_damping": 0.03}).items():
        for item in estimates[name]:
            assert item.is_determined, name
            assert item.value == pytest.approx(value, abs=2 * item.half_width), name


def test_redundant_cables_without_all_torques_raise():
    rng = np.random.default_rng(0)
    time, pose, *_ = smooth_motion(PLANAR, rng)
    signals = {"speed": (np.zeros((len(time), 3)), 1.0), "torque": (np.ones((len(time), 3)), 0.1)}
    columns = columns_of(PLANAR, time, pose, signals, rng)
    del columns["torque_2"]
    with pytest.raises(ValueError, match="no load cells needs the columns torque_2; add"):
        identify(PLANAR, [Log(name="a.csv", columns=columns)])
