"""The paper's law for joint springs (Eq. 22): how unstable it is, and what the motors' friction makes of it."""

from __future__ import annotations

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.classical import Composite, PaperFlexible
from cablebot_baselines.paper import linearised
from cablebot_baselines.paper.linearised import growth_rate
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL

ID = "CableBot-FlexSpatial-v0"
PERIOD = 1 / 500


def robot(stiffness, *, friction=0.0, unsaturated_actions=False):
    """The paper's robot at 11 kg; unclipped motors have a stall torque beyond reach on a line of the same slope."""
    springs = dataclasses.replace(FLEX_SPATIAL.transmission, stiffness=stiffness, motor_damping=friction)
    made = FLEX_SPATIAL.replace(mass=11.0, transmission=springs)
    return linearised.unsaturated_actions(made) if unsaturated_actions else made


def peaks(law, plant_robot, **keywords):
    """Largest position error in each tenth of a second on Table 3's circle [m]; infinite where the episode ended."""
    env = gym.make(ID, robot=plant_robot, max_episode_steps=-1, termination_radius=0.2, **keywords)
    observation, _ = env.reset(seed=0)
    state, record = None, np.full(500, np.inf)
    for step in range(500):
        action, state = law.predict(observation, state=state, episode_start=np.array(step == 0))
        observation, _, terminated, _, info = env.step(action)
        if terminated:
            break
        record[step] = info["tracking_error_peak"]
    return record.reshape(10, 50).max(axis=1)


@pytest.mark.parametrize(("stiffness", "rate"), [(2.0, 9.5), (3.0, 9.7)])
def test_sampled_loop_is_not_as_stable_as_the_paper_says(stiffness, rate):
    nominal = robot(stiffness, unsaturated_actions=True)
    assert growth_rate(PaperFlexible(nominal), nominal) == pytest.approx(rate, rel=0.02)


def test_linearisation_does_not_call_every_law_unstable():
    nominal = robot(3.0, unsaturated_actions=True)
    assert -2 < growth_rate(Composite(nominal), nominal) < -1  # the slow pole of (30, 20): −1.6
    rubbing = robot(3.0, friction=0.01, unsaturated_actions=True)
    assert growth_rate(PaperFlexible(rubbing), rubbing) < -1


@pytest.mark.parametrize(("stiffness", "rate"), [(2.0, 9.5), (3.0, 9.7)])
def test_circle_is_not_tracked_without_friction(stiffness, rate):
    nominal = robot(stiffness, unsaturated_actions=True)
    error = peaks(PaperFlexible(nominal), nominal, cable="bilateral")
    assert np.log(error[3] / error[1]) / 0.2 == pytest.approx(rate, rel=0.1)
    assert error[5] == np.inf


@pytest.mark.parametrize("stiffness", [2.0, 3.0])
def test_clipped_motors_and_slack_cables_do_not_save_it(stiffness):
    nominal = robot(stiffness)
    assert peaks(PaperFlexible(nominal), nominal).max() > 0.02


@pytest.mark.parametrize("stiffness", [2.0, 3.0])
def test_measured_motor_acceleration_does_not_last_a_tenth_of_a_second(stiffness):
    nominal = robot(stiffness, unsaturated_actions=True)
    law = PaperFlexible(nominal, motor_acceleration="measured")
    continuous = np.cbrt(stiffness / (4e-4 * PERIOD)) / 2  # of s³ + K/(J′ h) = 0
    assert growth_rate(law, nominal) == pytest.approx(continuous, rel=0.05)
    error = peaks(law, nominal, cable="bilateral")
    assert error[0] > 0.01
    assert error[0] > 10 * peaks(PaperFlexible(nominal), nominal, cable="bilateral")[0]


@pytest.mark.parametrize(("stiffness", "modelled", "printed"), [(2.0, 2.4e-3, 7e-3), (3.0, 1.8e-3, 7e-3)])
def test_motor_friction_is_not_unable_to_stabilise_it(stiffness, modelled, printed):
    """Table 4's 0.01 N·m·s/rad in the motors, known to the law and, as printed, not; figures of independent runs."""
    rubbing = robot(stiffness, friction=0.01)
    assert peaks(PaperFlexible(rubbing), rubbing).max() == pytest.approx(modelled, rel=0.05)
    assert peaks(PaperFlexible(rubbing, as_printed=True), rubbing).max() == pytest.approx(printed, rel=0.05)


def test_law_is_not_more_than_composite_without_its_damping():
    observation, _ = gym.make_vec(ID, num_envs=3, initial_error=np.full(6, 0.01)).reset(seed=0)
    expected = Composite(FLEX_SPATIAL, spring_damping=0.0).predict(observation)[0]
    np.testing.assert_allclose(PaperFlexible(FLEX_SPATIAL).predict(observation)[0], expected, rtol=1e-12)


# --- the measured acceleration ----------------------------------------------------------------------------------------


def two_observations(count=None, seed=0):
    """Consecutive observations with other motor speeds, as a batch or alone."""
    make = gym.make(ID) if count is None else gym.make_vec(ID, num_envs=count, payload=np.arange(count, dtype=float))
    first, _ = make.reset(seed=seed)
    second, *_ = make.step(np.full(make.action_space.shape, 0.3))
    return first, second


def torque(law, action, observation):
    speed = law._layout.split(observation)["motor_speed"]
    return law.robot.stall_torque * action - law.robot.speed_slope * speed


@pytest.mark.parametrize("count", [None, 3])
def test_measured_acceleration_is_not_another_than_the_difference_of_motor_speeds(count):
    first, second = two_observations(count)
    measured = PaperFlexible(FLEX_SPATIAL, motor_acceleration="measured")
    commanded = PaperFlexible(FLEX_SPATIAL)
    start = np.array(True) if count is None else np.ones(count, np.bool_)
    action, state = measured.predict(first, state=None, episode_start=start)
    np.testing.assert_array_equal(action, commanded.predict(first)[0])
    action, state = measured.predict(second, state=state, episode_start=~start)
    speeds = [measured._layout.split(each)["motor_speed"] for each in (first, second)]
    blocks = measured._layout.split(second)
    winding = textbook.pulley_acceleration(
        FLEX_SPATIAL, blocks["pose"], blocks["velocity"], commanded.outer(blocks)
    )  # what the other variant takes in its place
    inertia = FLEX_SPATIAL.transmission.motor_inertia
    expected = torque(commanded, commanded.predict(second)[0], second) - inertia * winding
    expected = expected + inertia * 500 * (speeds[1] - speeds[0])
    np.testing.assert_allclose(torque(measured, action, second), expected, rtol=1e-9)
    assert np.abs(speeds[1] - speeds[0]).max() > 0.1


def test_new_episode_in_a_batch_does_not_remember_the_old_one():
    first, second = two_observations(3)
    measured = PaperFlexible(FLEX_SPATIAL, motor_acceleration="measured")
    _, state = measured.predict(first, state=None, episode_start=np.ones(3, np.bool_))
    action, _ = measured.predict(second, state=state, episode_start=np.array([False, True, False]))
    going_on, _ = measured.predict(second, state=state, episode_start=np.zeros(3, np.bool_))
    fresh, _ = measured.predict(second, state=None)
    np.testing.assert_array_equal(action[1], fresh[1])
    np.testing.assert_array_equal(action[[0, 2]], going_on[[0, 2]])
    assert np.all(np.abs(going_on - fresh).max(axis=1) > 1e-3)


def test_clock_that_stands_still_does_not_divide_by_zero():
    observation, _ = gym.make(ID).reset(seed=0)
    measured = PaperFlexible(FLEX_SPATIAL, motor_acceleration="measured")
    action, state = measured.predict(observation)
    again, _ = measured.predict(observation, state=state, episode_start=np.array(False))
    np.testing.assert_array_equal(again, action)


@pytest.mark.parametrize("choice", ["v", "Measured", None])
def test_unknown_motor_acceleration_is_not_accepted(choice):
    with pytest.raises(ValueError, match="motor_acceleration must be commanded or measured"):
        PaperFlexible(FLEX_SPATIAL, motor_acceleration=choice)


def test_rigid_robot_is_not_accepted():
    with pytest.raises(ValueError, match=r"PaperFlexible needs joint springs, but robot 'spatial' has none\. Use fl\."):
        PaperFlexible(SPATIAL)
