"""The paper's law for joint springs (Eq. 22): its instability, and the effect of motor friction."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_baselines.classical import Composite, PaperFlexible
from cablebot_baselines.paper import linearised
from cablebot_baselines.paper.linearised import growth_rate
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL

ID = "CableBot-FlexSpatial-v0"
PERIOD = 1 / 500


def robot(stiffness, *, friction=0.0, unsaturated_actions=False):
    """The paper's robot at 11 kg; unsaturated motors have a very large stall torque and the same
    slope."""
    springs = FLEX_SPATIAL.transmission.replace(stiffness=stiffness, motor_damping=friction)
    paper_robot = FLEX_SPATIAL.replace(mass=11.0, transmission=springs)
    if unsaturated_actions:
        return linearised.unsaturated_actions(paper_robot)
    return paper_robot


def peaks(law, plant_robot, **keywords):
    """Largest position error in each tenth of a second on Table 3's circle [m]; infinite after a
    termination."""
    conditions = {"trajectory": "paper-spatial", "error_bounds": {"position": 0.1}}
    loop = record_rollout(law, ID, robot=plant_robot, **conditions, **keywords)
    errors = np.full(500, np.inf)
    errors[: len(loop) - 1] = loop.arrays["tracking_error_peak"]
    return errors.reshape(10, 50).max(axis=1)


def test_errors_grow_at_the_rate_of_the_linearised_loop():
    """Also with saturated motors and slack cables the circle is lost."""
    unsaturated = robot(2.0, unsaturated_actions=True)
    law = PaperFlexible(unsaturated)
    rate = 9.5
    assert growth_rate(law, unsaturated) == pytest.approx(rate, rel=0.02)
    error = peaks(law, unsaturated, cable="bilateral")
    assert np.log(error[3] / error[1]) / 0.2 == pytest.approx(rate, rel=0.1)
    assert error[5] == np.inf
    saturated = robot(2.0)
    assert peaks(PaperFlexible(saturated), saturated).max() > 0.02


def test_linearised_loop_of_stable_laws_decays():
    nominal = robot(3.0, unsaturated_actions=True)
    assert -2 < growth_rate(Composite(nominal), nominal) < -1  # the slow pole of (30, 20): −1.6
    with_friction = robot(3.0, friction=0.01, unsaturated_actions=True)
    assert growth_rate(PaperFlexible(with_friction), with_friction) < -1


def test_motor_friction_stabilises_the_law():
    """Table 4's 0.01 N·m·s/rad in the motors, in the law and, as printed, not; figures of
    independent runs."""
    plant = robot(3.0, friction=0.01)
    error = peaks(PaperFlexible(plant), plant)
    assert error.max() == pytest.approx(1.8e-3, rel=0.05)
    error = peaks(PaperFlexible(plant, as_printed=True), plant)
    assert error.max() == pytest.approx(7e-3, rel=0.05)


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


def test_repeated_observation_gives_the_same_action():
    observation, _ = gym.make(ID).reset(seed=0)
    action, state = MEASURED.predict(observation)
    repeated, _ = MEASURED.predict(observation, state, np.array(False))
    assert_array_equal(repeated, action)
