"""Identification of the winches of a platform whose pose is measured."""

import numpy as np
import pytest
from identification.lifts import by_motor
from identification.platforms import noisy_log, smooth_motion
from oracles.plants import with_transmission

from cablebot_gym import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_winches.identification import identify

FRICTION = {"coulomb_friction": 0.06, "damping": 0.02, "pulley_inertia": 1e-3}


def episode(env_id, robot, payload, trajectory):
    """Log of an episode of the environment with a true robot."""
    recording = record_rollout("fl", env_id, robot=robot, payload=payload, trajectory=trajectory)
    arrays = recording.arrays
    signals = {
        "speed": (arrays["motor_speeds"][1:], 0.01),
        "torque": (arrays["torques"][1:], 0.01),
    }
    # Torques and speeds are those at the start of a step, poses at its end.
    time = arrays["action_time"][1:]
    pose = arrays["true_pose"][:-1]
    rng = np.random.default_rng(0)
    return noisy_log(robot, time, pose, signals, rng, payload=payload)


@pytest.mark.landing
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
    estimates = by_motor(identify(nominal, logs))
    # It is zero, or the tensions are unknown.
    assert not estimates.pop("load_friction")[0].is_determined
    for name, items in estimates.items():
        for item in items:
            assert item.is_determined, name
            tolerance = item.half_width + 0.1 * FRICTION[name]
            assert item.value == pytest.approx(FRICTION[name], abs=tolerance), name


def log_of_torques(true, seed, pretension):
    """Log with the torques of redundant cables, without load cells."""
    rng = np.random.default_rng(seed)
    time, *motion = smooth_motion(true, rng)
    tensions = textbook.required_tensions(true, true.mass, *motion, minimum=pretension)
    angle = textbook.rest_angles(true, tensions, motion[0])
    speed = np.gradient(angle, time, axis=0)
    load = textbook.holding_torque(true, true.pulley_radius * tensions)
    torque = load + true.pulley_inertia * np.gradient(speed, time, axis=0)
    torque += true.damping * speed + textbook.coulomb_torque(true, speed)
    torque += textbook.load_friction(true, speed) * load
    signals = {"angle": (angle, 1e-5), "speed": (speed, 1e-3), "torque": (torque, 0.005)}
    return noisy_log(true, time, motion[0], signals, rng)


@pytest.mark.parametrize("elastic", [{}, {"axial_stiffness": 2e3}], ids=["rigid", "elastic"])
def test_load_friction_of_the_robot_corrects_the_tensions_of_redundant_cables(elastic):
    """The tensions behind the torques are smaller by friction and by what elastic cables wind up.
    They also give the axial stiffness, once the friction is known."""
    true = with_transmission(PLANAR, load_friction=0.1, **elastic, **FRICTION)
    wrong = dict.fromkeys(elastic, 3e3)
    nominal = with_transmission(PLANAR, load_friction=0.1, pulley_inertia=1e-4, **wrong)
    logs = [log_of_torques(true, seed, pretension) for seed, pretension in enumerate((10.0, 20.0))]
    estimates = by_motor(identify(nominal, logs))
    assert not estimates["load_friction"][0].is_determined
    for name, truth in FRICTION.items():
        for item in estimates[name]:
            assert item.value == pytest.approx(truth, abs=2 * item.half_width), name
            assert item.half_width < 0.4 * truth
    for item in estimates.get("axial_stiffness", []):
        assert item.value == pytest.approx(2e3, rel=0.005)


@pytest.mark.landing
def test_stiffness_and_motor_friction_of_joint_springs_are_identified():
    rng = np.random.default_rng(0)
    truth = {
        "stiffness": 200.0,
        "motor_inertia": 1e-3,
        "coulomb_friction": 0.05,
        "motor_damping": 0.03,
    }
    true = with_transmission(FLEX_SPATIAL, **truth)
    time, *motion = smooth_motion(true, rng)
    spring = textbook.inverse_dynamics(true, true.mass, *motion).torques
    angle = textbook.pulley_angle(true, motion[0]) + spring / true.stiffness
    speed = np.gradient(angle, time, axis=0)
    torque = spring + true.motor_inertia * np.gradient(speed, time, axis=0)
    torque += textbook.motor_friction(true, speed, spring)
    signals = {"angle": (angle, 1e-5), "speed": (speed, 1e-3), "torque": (torque, 0.005)}
    log = noisy_log(true, time, motion[0], signals, rng)
    estimates = by_motor(identify(FLEX_SPATIAL, [log]))
    for name, value in truth.items():
        for item in estimates[name]:
            assert item.is_determined, name
            assert item.value == pytest.approx(value, abs=2 * item.half_width), name


def test_redundant_cables_without_all_torques_raise():
    rng = np.random.default_rng(0)
    time, pose, *_ = smooth_motion(PLANAR, rng)
    table = np.ones((len(time), 3))
    log = noisy_log(PLANAR, time, pose, {"speed": (table, 1.0), "torque": (table, 0.1)}, rng)
    del log.columns["torque_2"]
    with pytest.raises(ValueError, match="no load cells needs the columns torque_2; add"):
        identify(PLANAR, [log])
