"""The paper's law for joint springs (Eq. 22): its instability, and the effect of motor friction."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_baselines.classical import Composite, PaperFlexible
from cablebot_baselines.paper import linearised
from cablebot_baselines.paper.linearised import growth_rate
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL

ID = "CableBot-FlexSpatial-v0"


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


def test_torques_equal_the_paper_s_equation():
    """Eq. 22 with the sign of T corrected: the torque of rigid joints and J′ β̈."""
    observation, _ = gym.make_vec(ID, num_envs=3, payload=np.arange(3.0)).reset(seed=0)
    law = PaperFlexible(FLEX_SPATIAL)
    blocks = law.split(observation)
    motion = blocks["pose"], blocks["velocity"], law.outer(blocks)
    mass = FLEX_SPATIAL.mass + np.arange(3.0)
    tensions = textbook.required_tensions(FLEX_SPATIAL, mass, *motion)
    expected = textbook.required_torques(FLEX_SPATIAL, tensions, *motion)
    expected += FLEX_SPATIAL.motor_inertia * textbook.pulley_acceleration(FLEX_SPATIAL, *motion)
    torques, _ = law.torques(blocks, mass)
    assert_allclose(torques, expected, rtol=1e-9)
