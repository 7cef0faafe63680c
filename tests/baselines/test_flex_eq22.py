"""The paper's law for joint springs (Eq. 22): its instability, and the effect of motor friction."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_baselines.laws import PaperFlexible
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL

ID = "CableBot-FlexSpatial-v0"


def largest_error(law, plant_robot):
    """Largest position error on Table 3's circle [m]; infinite after a termination."""
    conditions = {"trajectory": "paper-spatial", "error_bounds": {"position": 0.1}}
    loop = record_rollout(law, ID, robot=plant_robot, **conditions)
    if loop.reason:
        return np.inf
    return loop.arrays["tracking_error_peak"].max()


@pytest.mark.landing
def test_motor_friction_stabilises_the_law():
    """Table 4's 0.01 N·m·s/rad in the motors, in the law and, as printed, not; figures of
    independent runs."""
    springs = FLEX_SPATIAL.transmission.replace(stiffness=3.0, motor_damping=0.01)
    plant = FLEX_SPATIAL.replace(mass=11.0, transmission=springs)
    error = largest_error(PaperFlexible(plant), plant)
    assert error == pytest.approx(1.8e-3, rel=0.05)
    error = largest_error(PaperFlexible(plant, as_printed=True), plant)
    assert error == pytest.approx(7e-3, rel=0.05)


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
