"""The paper's law for joint springs (Eq. 22): its instability, and the effect of motor friction."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_baselines.classical import PaperFlexible
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL

ID = "CableBot-FlexSpatial-v0"
PERIOD = 1 / 500


def largest_error(law, plant_robot):
    """Largest position error on Table 3's circle [m]; infinite after a termination."""
    conditions = {"trajectory": "paper-spatial", "error_bounds": {"position": 0.1}}
    loop = record_rollout(law, ID, robot=plant_robot, **conditions)
    if loop.reason:
        return np.inf
    return loop.arrays["tracking_error_peak"].max()


def test_motor_friction_stabilises_the_law():
    """Table 4's 0.01 N·m·s/rad in the motors, in the law and, as printed, not; figures of
    independent runs."""
    springs = FLEX_SPATIAL.transmission.replace(stiffness=3.0, motor_damping=0.01)
    plant = FLEX_SPATIAL.replace(mass=11.0, transmission=springs)
    error = largest_error(PaperFlexible(plant), plant)
    assert error == pytest.approx(1.8e-3, rel=0.05)
    error = largest_error(PaperFlexible(plant, as_printed=True), plant)
    assert error == pytest.approx(7e-3, rel=0.05)


# --- the measured acceleration ----------------------------------------------------------------------------------------


@pytest.fixture
def two_observations():
    """Consecutive observations of three environments with different motor speeds."""
    env = gym.make_vec(ID, num_envs=3, payload=np.arange(3.0))
    before, _ = env.reset(seed=0)
    after, *_ = env.step(np.full(env.action_space.shape, 0.3))
    return before, after


MEASURED = PaperFlexible(FLEX_SPATIAL, motor_acceleration="measured")
NO_START = np.zeros(3, np.bool_)


def torque(law, action, observation):
    speed = law.split(observation)["motor_speed"]
    return law.robot.stall_torque * action - law.robot.speed_slope * speed


def test_measured_acceleration_is_a_difference_quotient(two_observations):
    before, after = two_observations
    commanded = PaperFlexible(FLEX_SPATIAL, motor_acceleration="commanded")
    action, state = MEASURED.predict(before, state=None, episode_start=~NO_START)
    commanded_action, _ = commanded.predict(before)
    assert_array_equal(action, commanded_action)
    action, _ = MEASURED.predict(after, state=state, episode_start=NO_START)
    commanded_action, _ = commanded.predict(after)
    blocks = MEASURED.split(after)
    speed_change = blocks["motor_speed"] - MEASURED.split(before)["motor_speed"]
    pulley_acceleration = textbook.pulley_acceleration(
        FLEX_SPATIAL, blocks["pose"], blocks["velocity"], commanded.outer(blocks)
    )
    acceleration_difference = speed_change / PERIOD - pulley_acceleration
    inertia = FLEX_SPATIAL.transmission.motor_inertia
    expected = torque(commanded, commanded_action, after) + inertia * acceleration_difference
    assert_allclose(torque(MEASURED, action, after), expected, rtol=1e-9)
    assert np.abs(speed_change).max() > 0.1


def test_new_episode_of_a_batch_starts_with_fresh_memory(two_observations):
    before, after = two_observations
    _, state = MEASURED.predict(before, state=None, episode_start=~NO_START)
    action, _ = MEASURED.predict(after, state=state, episode_start=np.array([False, True, False]))
    going_on, _ = MEASURED.predict(after, state=state, episode_start=NO_START)
    fresh, _ = MEASURED.predict(after, state=None)
    assert_array_equal(action[1], fresh[1])
    assert_array_equal(action[[0, 2]], going_on[[0, 2]])
    assert np.all(np.abs(going_on - fresh).max(axis=1) > 1e-3)


def test_repeated_observation_gives_the_same_action():
    observation, _ = gym.make(ID).reset(seed=0)
    action, state = MEASURED.predict(observation)
    repeated, _ = MEASURED.predict(observation, state, np.array(False))
    assert_array_equal(repeated, action)
