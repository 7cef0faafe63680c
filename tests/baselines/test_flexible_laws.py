"""The laws for joint springs: figures of independent runs, and the equations that they solve."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from cablebot_baselines.classical import (
    ADAPTIVE_COMPOSITE,
    COMPOSITE,
    Composite,
    FourthOrder,
    MotorPD,
)
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.evaluation import compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, find_robot

LAWS = {"composite": Composite, "motor-pd": MotorPD, "fl4": FourthOrder}
FLEX_SPATIAL_ID = "CableBot-FlexSpatial-v0"
FLEX_PLANAR_ID = "CableBot-FlexPlanar-v0"


def with_stiffness(stiffness, mass):
    transmission = FLEX_SPATIAL.transmission.replace(stiffness=stiffness)
    return FLEX_SPATIAL.replace(mass=mass, transmission=transmission)


@pytest.mark.parametrize("law", ["motor-pd", "composite-tuned", "adaptive-composite"])
def test_position_limits_the_dlcc_on_the_default_planar_circle(law):
    """With allocated tensions of 5 N, the jump of the acceleration took a cable below 1 N, without
    any payload, too."""
    result = evaluate_dlcc(law, FLEX_PLANAR_ID, payload_max=4.0, resolution=0.1)
    assert result.payload is not None
    assert result.payload > 1.8
    assert result.violation is not None
    assert result.violation.kind == "position"


@pytest.mark.slow
def test_laws_hold_a_platform_on_cables_that_stretch():
    """The free length of FAST's cables is 0.4 % less than their length. Without it the laws sagged
    by 28 to 115 mm."""
    motion = {
        "name": "line-spatial",
        "start": (0, 0, -140, 0, 0, 0),
        "end": (0, 0, -140.001, 0, 0, 0),
        "duration": 4.0,
    }
    laws = ["composite-tuned", "adaptive-composite", "motor-pd"]
    options = {"robot": "flex-fast", "trajectory": motion}
    comparison = compare_policies(laws, FLEX_SPATIAL_ID, payload=5e4, initial_error=0, **options)
    assert max(metrics.max_error[0] for metrics in comparison.metrics) < 1e-3


@pytest.mark.parametrize(("law", "bound"), [("composite", 6e-3), ("motor-pd", 3e-3), ("fl4", 6e-3)])
def test_errors_on_the_papers_circle_at_eleven_kilograms(law, bound):
    robot = with_stiffness(2.0, 11.0)
    verdict = record_rollout(
        LAWS[law](robot), FLEX_SPATIAL_ID, robot=robot, trajectory="paper-spatial"
    ).verdict
    assert verdict.carried
    assert verdict.position_peak < bound
    assert verdict.rotation_peak < 2e-3


def test_fourth_order_error_decays_with_the_given_poles():
    """On a dwell an initial error follows the fourth-order linear equation in all coordinates."""
    poles = (-8.0, -9.0, -10.0, -11.0)
    error = np.array([2e-3, -1e-3, 1e-3, 2e-3, 1e-3, -2e-3])
    law = FourthOrder(FLEX_SPATIAL, poles=poles)
    conditions = {"trajectory": "dwell-spatial", "initial_error": error}
    loop = record_rollout(law, FLEX_SPATIAL_ID, control_frequency=2000.0, **conditions).arrays
    # From rest: e = Σ c_i exp(p_i t) with e(0) = 1 and three derivatives zero.
    coefficients = np.linalg.solve(np.vander(poles, increasing=True).T, [1.0, 0.0, 0.0, 0.0])
    expected = float(coefficients @ np.exp(np.array(poles) * loop["time"][400]))
    remaining = loop["true_pose"][400] - loop["reference_pose"][400]
    assert 0.5 < expected < 0.9
    assert_allclose(remaining / error, expected, atol=0.01)


def test_motor_pd_tracks_a_smooth_motion_closely():
    loop = record_rollout(
        MotorPD(FLEX_SPATIAL),
        FLEX_SPATIAL_ID,
        trajectory={"name": "smooth-circle-spatial", "dwell": 0},
        initial_error=0,
        control_frequency=2000.0,
    )
    assert loop.arrays["tracking_error_peak"].max() < 2e-4


@pytest.mark.parametrize(
    ("law", "name", "holds"),
    [
        ("motor-pd", "flex-expo-lucia", True),
        ("motor-pd", "flex-gch-klaus", True),
        pytest.param("composite-tuned", "flex-ipanema-3", False, marks=pytest.mark.slow),
        pytest.param("adaptive-composite", "flex-ipanema-3", False, marks=pytest.mark.slow),
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


def test_leading_the_springs_lessens_the_error_of_a_smooth_motion():
    motion = {"name": "smooth-circle-spatial", "dwell": 0}
    errors = {}
    for leads_springs in (False, True):
        law = Composite(FLEX_SPATIAL, gains=(200.0, 28.0), leads_springs=leads_springs)
        loop = record_rollout(law, FLEX_SPATIAL_ID, trajectory=motion, initial_error=0)
        errors[leads_springs] = loop.arrays["tracking_error_peak"].max()
    assert errors[True] < errors[False] / 3


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


@pytest.mark.parametrize(("entry", "stiffness"), [(COMPOSITE, 700.0), (ADAPTIVE_COMPOSITE, 2000.0)])
def test_stiff_springs_are_stable_in_the_loop(entry, stiffness):
    """The damping for soft springs fails at 500 Hz from K = 600 on; K → ∞ is the rigid robot."""
    robot = with_stiffness(stiffness, 10.0)
    assert record_rollout(
        entry.factory(robot), FLEX_SPATIAL_ID, payload=4.0, robot=robot
    ).verdict.carried
