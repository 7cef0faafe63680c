"""Feedback linearization against the paper's formulas, in closed loop, and its DLCC."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.classical import FL, FL_TUNED, FeedbackLinearization
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Motors

IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
GAINS = {"planar": (2000.0, 10.0), "spatial": (30.0, 20.0)}
"""(K_P, K_D), Tables 2 and 4."""

each_kind = pytest.mark.parametrize("kind", list(ROBOTS))

SQUARE = PLANAR.replace(
    name="square",
    base_anchors=((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),
    home_pose=(0.0, 0.0),
)
"""Four cables in the plane."""


def random_observations(kind, seed, count, model_payload=None):
    """Observations far enough off the reference for every term to matter."""
    robot = ROBOTS[kind]
    rng = np.random.default_rng(seed)
    layout = observation_layout(robot)
    n = robot.coordinates
    at = layout.slices()
    rows = rng.uniform(0, 1, (count, layout.size))
    pose = rng.uniform(-0.1, 0.1, (count, n))
    if kind == "spatial":
        pose[:, 2] += 0.25
    rows[:, at["pose"]] = pose
    rows[:, at["reference_pose"]] = pose + rng.uniform(-0.02, 0.02, (count, n))
    rows[:, at["velocity"]] = rng.uniform(-1, 1, (count, n))
    rows[:, at["reference_velocity"]] = rng.uniform(-1, 1, (count, n))
    rows[:, at["reference_acceleration"]] = rng.uniform(-8, 8, (count, n))
    rows[:, at["model_payload"]] = (
        rng.uniform(0, 5, (count, 1)) if model_payload is None else model_payload
    )
    return rows


# --- the law ----------------------------------------------------------------------------------------------------------


@each_kind
@pytest.mark.parametrize(("gains", "minimum"), [(None, 5.0), ((123.0, 4.5), 17.0)])
def test_actions_equal_the_paper_s_equations(kind, gains, minimum):
    """Eqs. 10–13 (planar) and 16–18 (spatial); on a planar robot the least tension is the
    minimum."""
    robot = ROBOTS[kind]
    observation = random_observations(kind, 3, 40)
    law = FeedbackLinearization(robot, gains=gains, minimum_tension=minimum)
    x = law.split(observation)
    (stiffness, damping) = gains or GAINS[kind]
    v = (
        x["reference_acceleration"]
        + damping * (x["reference_velocity"] - x["velocity"])
        + stiffness * (x["reference_pose"] - x["pose"])
    )  # Eq. 18
    mass = {"planar": 1.0, "spatial": 10.0}[kind] + x["model_payload"][:, 0]
    tensions = textbook.required_tensions(robot, mass, x["pose"], x["velocity"], v, minimum=minimum)
    torques = textbook.required_torques(robot, tensions, x["pose"], x["velocity"], v)
    expected = textbook.normalised_action(
        robot, torques, textbook.pulley_speed(robot, x["pose"], x["velocity"])
    )
    np.testing.assert_allclose(
        law.predict(observation)[0], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()
    )


@each_kind
def test_law_is_stateless_and_declares_unsaturated_actions(kind):
    observation = random_observations(kind, 4, 3, model_payload=100.0)
    state = object()
    fl = FeedbackLinearization(ROBOTS[kind])
    assert fl.unsaturated_actions is True
    action, after = fl.predict(
        observation, state=state, episode_start=np.ones(3, np.bool_), deterministic=True
    )
    assert after is state
    assert np.abs(action).max() > 1.5


@each_kind
def test_law_uses_the_model_payload_only(kind):
    """An unknown payload has no effect; a known one counts in addition to the platform's mass."""

    def action(robot=ROBOTS[kind], **keywords):
        observation, _ = gym.make(IDS[kind], robot=robot, **keywords).reset(seed=0)
        return FeedbackLinearization(robot).predict(observation)[0]

    np.testing.assert_array_equal(action(payload=1.5, payload_known=False), action())
    heavier = ROBOTS[kind].replace(mass=ROBOTS[kind].mass + 1.5)
    np.testing.assert_allclose(action(payload=1.5), action(robot=heavier), rtol=1e-12)


@each_kind
def test_law_uses_the_motors_of_its_robot(kind):
    observation = random_observations(kind, 5, 1)[0]
    nominal = ROBOTS[kind]
    strong = nominal.replace(
        motors=Motors(stall_torque=2 * nominal.motors.stall_torque, free_speed=1000 * RPM)
    )
    speed = FeedbackLinearization(nominal).torques(
        FeedbackLinearization(nominal).split(observation), nominal.mass
    )[1]
    torque = [
        FeedbackLinearization(robot).predict(observation)[0] * robot.stall_torque
        - robot.speed_slope * speed
        for robot in (nominal, strong)
    ]
    np.testing.assert_allclose(torque[0], torque[1], rtol=1e-9)


@pytest.mark.parametrize("gains", [(0.0, 1.0), (math.nan, 1.0), (30.0,), ("a", 1.0)])
def test_invalid_gains_and_minimum_tension_raise(gains):
    with pytest.raises(ValueError, match="gains must be"):
        FeedbackLinearization(SPATIAL, gains=gains)
    with pytest.raises(ValueError, match=r"minimum_tension must be .* at least 0 N"):
        FeedbackLinearization(PLANAR, minimum_tension=-1e-9)


# --- in the loop ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("env_id", "robot"), [(IDS["planar"], SQUARE), (IDS["spatial"], SPATIAL)])
def test_closed_loop_tracks_the_reference_within_a_millimetre(env_id, robot):
    """Also with four cables in the plane; the plant has the tensions that the law requests."""
    circle = "paper-planar" if robot.planar else "paper-spatial"
    env = gym.make(env_id, robot=robot, trajectory=circle)
    law = FeedbackLinearization(robot, minimum_tension=3.0)
    observation, _ = env.reset(seed=0)
    truncated = False
    while not truncated:
        observation, _, terminated, truncated, info = env.step(law.predict(observation)[0])
        assert not terminated
        assert not info["slack"].any()
        if robot.planar and np.all(np.abs(info["commanded_action"]) <= 1):
            assert info["tensions"].min() == pytest.approx(3.0, rel=1e-6)
    assert 0 < info["tracking_error_peak"] < 1e-3
    assert info["rotation_error_peak"] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "paper", "tuned"),
    [("planar", (1.92, 0.66), (1.94, 0.79)), ("spatial", (4.03, 0.39), (3.88, 4.15))],
)
def test_dlcc_with_the_paper_s_and_with_tuned_gains(kind, paper, tuned):
    """Payload known and unknown on the circle as printed, with tensions above 0 [kg]. Known: gains
    hardly matter."""
    keywords = {
        "trajectory": f"paper-{kind}",
        "resolution": 0.02,
        "robot": ROBOTS[kind].replace(minimum_tension=1e-9),
    }
    for entry, payloads in ((FL, paper), (FL_TUNED, tuned)):
        for known, payload in zip((True, False), payloads, strict=True):
            result = evaluate_dlcc(
                entry.factory(ROBOTS[kind]), IDS[kind], payload_known=known, **keywords
            )
            assert result.payload == pytest.approx(payload, abs=0.04)
