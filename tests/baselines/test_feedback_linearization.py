"""Feedback linearization against the paper's formulas and in closed loop."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.plants import each_of

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Motors

PAPER_GAINS = {"planar": (2000.0, 10.0), "spatial": (30.0, 20.0)}
"""(K_P, K_D), Tables 2 and 4."""

STRONG = Motors(stall_torque=20.0, free_speed=1000 * RPM)

SQUARE = PLANAR.replace(
    name="square",
    base_anchors=((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),
    home_pose=(0.0, 0.0),
)
"""Four cables in the plane."""


def random_observations(robot, count):
    """Observations far enough off the reference for every term to matter."""
    rng = np.random.default_rng(3)
    layout = observation_layout(robot)
    rows = rng.uniform(0, 1, (count, layout.size))
    blocks = layout.split(rows)
    shape = (count, robot.coordinates)
    sizes = {"pose": 0.1, "velocity": 1, "reference_velocity": 1, "reference_acceleration": 8}
    for name, size in sizes.items():
        blocks[name][:] = rng.uniform(-size, size, shape)
    blocks["pose"][:, 2:3] += 0.25
    blocks["reference_pose"][:] = blocks["pose"] + rng.uniform(-0.02, 0.02, shape)
    blocks["model_payload"][:] = rng.uniform(0, 5, (count, 1))
    return rows


# --- the law ----------------------------------------------------------------------------------------------------------


@each_of(PLANAR, SPATIAL)
@pytest.mark.parametrize(
    ("motors", "gains", "minimum"), [(None, "paper", 5.0), (STRONG, (123.0, 4.5), 17.0)]
)
def test_actions_equal_the_paper_s_equations(robot, motors, gains, minimum):
    """Eqs. 10–13 (planar) and 16–18 (spatial); on a planar robot the least tension is the
    minimum."""
    robot = robot.replace(motors=motors or robot.motors)
    observation = random_observations(robot, 40)
    law = FeedbackLinearization(robot, gains=gains, minimum_tension=minimum)
    x = law.split(observation)
    stiffness, damping = PAPER_GAINS[robot.kind] if gains == "paper" else gains
    # Eq. 18
    v = (
        x["reference_acceleration"]
        + damping * (x["reference_velocity"] - x["velocity"])
        + stiffness * (x["reference_pose"] - x["pose"])
    )
    mass = robot.mass + x["model_payload"][:, 0]
    motion = x["pose"], x["velocity"], v
    inverse = textbook.inverse_dynamics(robot, mass, *motion, minimum=minimum)
    expected = textbook.normalised_action(robot, inverse.torques, inverse.speeds)
    tolerance = 1e-9 * np.abs(expected).max()
    action, _ = law.predict(observation)
    assert_allclose(action, expected, rtol=1e-9, atol=tolerance)
    assert law.unsaturated_actions


# --- in the loop ------------------------------------------------------------------------------------------------------


@each_of(SQUARE, SPATIAL)
def test_closed_loop_tracks_the_reference_within_a_millimetre(robot):
    """Also with four cables in the plane; the plant has the tensions that the law requests."""
    law = FeedbackLinearization(robot, minimum_tension=3.0)
    env_id = f"CableBot-{robot.kind.capitalize()}-v0"
    loop = record_rollout(law, env_id, robot=robot, trajectory=f"paper-{robot.kind}")
    arrays = loop.arrays
    assert not loop.reason
    assert not arrays["slack"].any()
    if robot.planar:
        unsaturated = np.all(np.abs(arrays["commanded_action"]) <= 1, axis=1)
        assert_allclose(arrays["tensions"][unsaturated].min(axis=1), 3.0, rtol=1e-6)
    assert 0 < arrays["tracking_error_peak"].max() < 1e-3
    assert arrays["rotation_error_peak"].max() < 1e-3
