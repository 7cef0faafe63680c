"""The laws for joint springs: figures of independent runs, and the equations that they solve."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from cablebot_baselines.laws import Composite, MotorPD, PaperFlexible
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.evaluation import compare_policies
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, find_robot

FLEX_SPATIAL_ID = "CableBot-FlexSpatial-v0"


def with_stiffness(stiffness, mass):
    transmission = FLEX_SPATIAL.transmission.replace(stiffness=stiffness)
    return FLEX_SPATIAL.replace(mass=mass, transmission=transmission)


@pytest.mark.nightly
def test_laws_hold_a_platform_on_cables_that_stretch():
    """The free length of FAST's cables is 0.4 % less than their length. Without it the laws sagged
    by 28 to 115 mm."""
    motion = {
        "name": "line-spatial",
        "start": (0, 0, -140, 0, 0, 0),
        "end": (0, 0, -140.001, 0, 0, 0),
        "duration": 4.0,
    }
    laws = ["composite", "motor-pd"]
    options = {"robot": "flex-fast", "trajectory": motion}
    comparison = compare_policies(laws, FLEX_SPATIAL_ID, payload=5e4, initial_error=0, **options)
    assert max(metrics.max_error[0] for metrics in comparison.metrics) < 1e-3


@pytest.mark.landing
def test_motor_pd_tracks_a_smooth_motion_closely():
    loop = record_rollout(
        MotorPD(FLEX_SPATIAL),
        FLEX_SPATIAL_ID,
        trajectory={"name": "smooth-circle-spatial", "dwell": 0},
        initial_error=0,
        control_frequency=2000.0,
    )
    assert loop.arrays["tracking_error_peak"].max() < 2e-4


@pytest.mark.landing
@pytest.mark.parametrize(
    ("law", "name", "holds"),
    [
        ("motor-pd", "flex-expo-lucia", True),
        ("motor-pd", "flex-gch-klaus", True),
        ("composite", "flex-ipanema-3", False),
    ],
)
def test_redundant_elastic_cables_stay_taut(law, name, holds):
    """Excludes a jump from the tensions of the start to those of the law, and tensions that change
    faster than the cables follow."""
    robot = find_robot(name)
    options = {"robot": robot}
    if holds:
        name = f"dwell-{robot.kind}"
        options["trajectory"] = {"name": name, "pose": robot.home, "duration": 1.0}
    loop = record_rollout(law, fitting_env_id(robot), **options)
    assert loop.verdict.carried


def test_damping_of_soft_springs_is_the_papers_at_500_hz():
    robot = with_stiffness(3.0, 10.0)
    assert_array_equal(
        Composite(robot).damping(1 / 500), np.sqrt(robot.stiffness * robot.motor_inertia)
    )


@pytest.mark.parametrize("frequency", [100.0, 500.0, 2000.0])
@pytest.mark.parametrize("stiffness", [1.0, 300.0, 1000.0, 3000.0, 1e4])
def test_sampled_spring_damping_is_stable(stiffness, frequency):
    """A rotor on a spring whose other end hardly moves, with constant torque per period and the
    outer loop's K_D."""
    robot = with_stiffness(stiffness, 10.0)
    inertia = robot.motor_inertia[0]
    rate = textbook.highest_frequency(robot)
    gain = Composite(robot).damping(1 / frequency)[0] / inertia - 20.0
    held = expm(np.array([[0.0, 1.0, 0.0], [-(rate**2), 0.0, -gain], [0.0, 0.0, 0.0]]) / frequency)
    loop = held[:2, :2] + np.outer(held[:2, 2], [0.0, 1.0])
    assert np.abs(np.linalg.eigvals(loop)).max() < 1 + 1e-9


# --- the paper's law (Eq. 22) -----------------------------------------------------------------------------------------


def largest_error(law, plant_robot):
    """Largest position error on Table 3's circle [m]; infinite after a termination."""
    conditions = {"trajectory": "paper-spatial", "error_bounds": {"position": 0.1}}
    loop = record_rollout(law, FLEX_SPATIAL_ID, robot=plant_robot, **conditions)
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
    observation, _ = gym.make_vec(FLEX_SPATIAL_ID, num_envs=3, payload=np.arange(3.0)).reset(seed=0)
    law = PaperFlexible(FLEX_SPATIAL)
    blocks = law.split(observation)
    motion = blocks["pose"], blocks["velocity"], law.outer(blocks)
    mass = FLEX_SPATIAL.mass + np.arange(3.0)
    inverse = textbook.inverse_dynamics(FLEX_SPATIAL, mass, *motion)
    expected = inverse.torques + FLEX_SPATIAL.motor_inertia * inverse.pulley_accelerations
    torques, _ = law.torques(blocks, mass)
    assert_allclose(torques, expected, rtol=1e-9)
