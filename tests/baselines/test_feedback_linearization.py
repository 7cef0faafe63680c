"""Feedback linearization against the paper's formulas, written independently with complex steps and an SVD."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablebot_baselines.classical import FL, FL_TUNED, FeedbackLinearization
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Motors

IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
GAINS = {"planar": (2000.0, 10.0), "spatial": (30.0, 20.0)}
"""(K_P, K_D), Tables 2 and 4."""
STALL = {"planar": 5.0, "spatial": 10.0}
"""τ_s, Tables 7 and 8 [N·m]."""
RADIUS, INERTIA, FREE_SPEED = 0.05, 8e-4, 1000 * math.pi / 30
"""r [m], J [kg·m²] and ω_n [rad/s] of both robots."""
DAMPING = {"planar": 0.0, "spatial": 0.01}
"""c [N·m·s/rad]."""

each_kind = pytest.mark.parametrize("kind", list(ROBOTS))

SQUARE = PLANAR.replace(
    name="square", base_anchors=((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)), home_pose=(0.0, 0.0)
)
"""Four cables in the plane."""


# --- the formulas, for real and complex scalars -----------------------------------------------------------------------


def rotation(psi, theta, phi):
    """Rz(φ) Ry(θ) Rx(ψ)."""
    cos, sin = np.cos, np.sin
    rx = np.array([[1, 0, 0], [0, cos(psi), -sin(psi)], [0, sin(psi), cos(psi)]])
    ry = np.array([[cos(theta), 0, sin(theta)], [0, 1, 0], [-sin(theta), 0, cos(theta)]])
    rz = np.array([[cos(phi), -sin(phi), 0], [sin(phi), cos(phi), 0], [0, 0, 1]])
    return rz @ ry @ rx


def rate_matrix(psi, theta):
    """The paper's P: the contribution of each Euler rate to ω in the platform's frame."""
    first = np.array([1, 0, 0])
    second = rotation(psi, 0, 0).T @ np.array([0, 1, 0])
    third = rotation(psi, 0, 0).T @ rotation(0, theta, 0).T @ np.array([0, 0, 1])
    return np.stack([first, second, third], axis=1)


STEP = 1e-30
"""A complex step has no cancellation, so that its derivatives are exact."""


def lengths(robot, pose):
    if len(pose) == 2:
        ends = np.broadcast_to(pose, (len(robot.base_anchors), 2))
    else:
        ends = pose[:3] + np.array(robot.platform_anchors) @ rotation(*pose[3:]).T
    return np.sqrt(np.sum((ends - np.array(robot.base_anchors)) ** 2, axis=1))


def structure(robot, pose):
    """S = ∂q/∂X, column by column."""
    return np.stack([lengths(robot, pose + 1j * STEP * e).imag / STEP for e in np.eye(len(pose))], axis=1)


def length_rates(robot, pose, velocity, acceleration, time=0.0):
    """q̇ at a time on the parabola through the state, from l · l̇ / q; complex times allowed."""
    now, rates = pose + velocity * time + acceleration * time**2 / 2, velocity + acceleration * time
    base = np.array(robot.base_anchors)
    if len(pose) == 2:
        vector, speed = now - base, np.broadcast_to(rates, base.shape)
    else:
        turn, arms = rotation(*now[3:]), np.array(robot.platform_anchors)
        omega = rate_matrix(*now[3:5]) @ rates[3:]
        vector, speed = now[:3] + arms @ turn.T - base, rates[:3] + np.cross(omega, arms) @ turn.T
    return np.sum(vector * speed, axis=1) / np.sqrt(np.sum(vector**2, axis=1))


def law(robot, kind, observation, minimum=5.0, gains=None):
    """Tensions, torques and actions of Eqs. 10–13 (planar) and 16–18 (spatial) for one observation."""
    blocks = {name: np.array(observation[at]) for name, at in observation_layout(robot).slices().items()}
    stiffness, damping = gains or GAINS[kind]
    pose, velocity = blocks["pose"], blocks["velocity"]
    v = (
        blocks["reference_acceleration"]
        + damping * (blocks["reference_velocity"] - velocity)
        + stiffness * (blocks["reference_pose"] - pose)
    )  # Eq. 18
    mass = {"planar": 1.0, "spatial": 10.0}[kind] + blocks["model_payload"][0]
    s = structure(robot, pose)
    if kind == "planar":
        tensions = planar_tensions(s, mass * v, minimum)
    else:
        p = rate_matrix(*pose[3:5])
        p_rate = rate_matrix(*(pose[3:5] + 1j * STEP * velocity[3:5])).imag / STEP
        moments = np.diag([0.58, 0.58, 1.16])
        omega = p @ velocity[3:]
        force = mass * (v[:3] - np.array([0, 0, 9.81]))
        moment = p.T @ (moments @ (p @ v[3:] + p_rate @ velocity[3:]) + np.cross(omega, moments @ omega))
        tensions = -np.linalg.solve(s.T, np.concatenate([force, moment]))  # Eq. 16
    beta_rate = -length_rates(robot, pose, velocity, v) / RADIUS
    beta_second = -length_rates(robot, pose, velocity, v, 1j * STEP).imag / STEP / RADIUS
    torques = RADIUS * tensions + INERTIA * beta_second + DAMPING[kind] * beta_rate  # Eqs. 1, 13 and 17
    return tensions, torques, (torques + STALL[kind] / FREE_SPEED * beta_rate) / STALL[kind]


def planar_tensions(s, force, minimum):
    """T = T_p + α N (Eq. 11), N > 0 from the null space, α the least that keeps every tension at the minimum."""
    _, _, rows = np.linalg.svd(s.T)
    null = rows[-1] * np.sign(rows[-1][0])
    assert np.all(null > 0)
    particular = -np.linalg.pinv(s.T) @ force
    return particular + np.max((minimum - particular) / null) * null


def motor_speed(robot, observation):
    """β̇ of one observation."""
    at = observation_layout(robot).slices()
    return -structure(robot, observation[at["pose"]]) @ observation[at["velocity"]] / RADIUS


def random_observations(kind, seed, count, model_payload=None):
    """Observations far enough off the reference for every term to matter."""
    robot, rng = ROBOTS[kind], np.random.default_rng(seed)
    layout, n = observation_layout(robot), robot.coordinates
    at, made = layout.slices(), rng.uniform(0, 1, (count, layout.size))
    pose = rng.uniform(-0.1, 0.1, (count, n))
    if kind == "spatial":
        pose[:, 2] += 0.25
    made[:, at["pose"]] = pose
    made[:, at["reference_pose"]] = pose + rng.uniform(-0.02, 0.02, (count, n))
    made[:, at["velocity"]] = rng.uniform(-1, 1, (count, n))
    made[:, at["reference_velocity"]] = rng.uniform(-1, 1, (count, n))
    made[:, at["reference_acceleration"]] = rng.uniform(-8, 8, (count, n))
    made[:, at["model_payload"]] = rng.uniform(0, 5, (count, 1)) if model_payload is None else model_payload
    return made


# --- the law ----------------------------------------------------------------------------------------------------------


@each_kind
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), gains=st.sampled_from([None, (123.0, 4.5)]))
def test_actions_equal_the_paper_s_equations(kind, seed, gains):
    observation = random_observations(kind, seed, 1)[0]
    _, _, expected = law(ROBOTS[kind], kind, observation, gains=gains)
    action, _ = FeedbackLinearization(ROBOTS[kind], gains=gains).predict(observation)
    np.testing.assert_allclose(action, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("minimum", [0.0, 17.0])
def test_least_planar_tension_equals_the_minimum(minimum):
    law_ = FeedbackLinearization(PLANAR, minimum_tension=minimum)
    for observation in random_observations("planar", 3, 20):
        tensions, torques, _ = law(PLANAR, "planar", observation, minimum=minimum)
        action = law_.predict(observation)[0]
        # Only T differs from the motor's own fraction of the torque.
        torque = action * STALL["planar"] - STALL["planar"] / FREE_SPEED * motor_speed(PLANAR, observation)
        found = tensions + (torque - torques) / RADIUS
        assert found.min() == pytest.approx(minimum, abs=1e-9)
        np.testing.assert_allclose(found, tensions, rtol=1e-9, atol=1e-9)


@each_kind
def test_law_has_no_memory_and_does_not_saturate_its_actions(kind):
    observation, state = random_observations(kind, 4, 3, model_payload=100.0), object()
    fl = FeedbackLinearization(ROBOTS[kind])
    assert fl.unsaturated_actions is True
    action, after = fl.predict(observation, state=state, episode_start=np.ones(3, np.bool_), deterministic=True)
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
    observation, nominal = random_observations(kind, 5, 1)[0], ROBOTS[kind]
    strong = nominal.replace(motors=Motors(stall_torque=2 * STALL[kind], free_speed=1000 * RPM))
    torque = [
        FeedbackLinearization(robot).predict(observation)[0] * robot.stall_torque
        - robot.speed_slope * motor_speed(nominal, observation)
        for robot in (nominal, strong)
    ]
    np.testing.assert_allclose(torque[0], torque[1], rtol=1e-9)


@pytest.mark.parametrize("gains", [(0.0, 1.0), (30.0, -1.0), (math.nan, 1.0), (30.0,), ("a", 1.0)])
def test_invalid_gains_raise(gains):
    with pytest.raises(ValueError, match="gains must be"):
        FeedbackLinearization(SPATIAL, gains=gains)


@pytest.mark.parametrize("minimum", [-1e-9, math.inf])
def test_invalid_minimum_tension_raises(minimum):
    with pytest.raises(ValueError, match=r"minimum_tension must be .* at least 0 N"):
        FeedbackLinearization(PLANAR, minimum_tension=minimum)


# --- in the loop ------------------------------------------------------------------------------------------------------


def run(env, policy):
    """Infos of a whole motion."""
    observation, _ = env.reset(seed=0)
    infos = []
    for _ in range(env.unwrapped.task.steps):
        observation, _, terminated, _, info = env.step(policy.predict(observation)[0])
        infos.append(info)
        assert not terminated, info["termination_reason"]
    return infos


@pytest.mark.parametrize(("env_id", "robot"), [(IDS["planar"], SQUARE), (IDS["spatial"], SPATIAL)])
def test_closed_loop_tracks_the_reference_within_a_millimetre(env_id, robot):
    """Also with four cables in the plane; the plant has the tensions that the law requests."""
    infos = run(gym.make(env_id, robot=robot, max_episode_steps=-1), FeedbackLinearization(robot, minimum_tension=3.0))
    assert len(infos) == 500
    assert 0 < max(info["tracking_error_peak"] for info in infos) < 1e-3
    assert max(info["rotation_error_peak"] for info in infos) < 1e-3
    assert not any(info["slack"].any() for info in infos)
    if robot.planar:
        tensions = np.array([info["tensions"] for info in infos if np.all(np.abs(info["commanded_action"]) <= 1)])
        assert tensions.shape[1] == 4
        np.testing.assert_allclose(tensions.min(axis=1), 3.0, rtol=1e-6)
        assert np.all(tensions.max(axis=0) > 5.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "paper", "tuned"), [("planar", (1.92, 0.66), (1.94, 0.79)), ("spatial", (4.03, 0.39), (3.88, 4.15))]
)
def test_dlcc_with_the_paper_s_and_with_tuned_gains(kind, paper, tuned):
    """Payload known and unknown [kg]. With a known payload the gains hardly matter."""
    for entry, payloads in ((FL, paper), (FL_TUNED, tuned)):
        for known, payload in zip((True, False), payloads, strict=True):
            result = evaluate_dlcc(entry.factory(ROBOTS[kind]), IDS[kind], payload_known=known, resolution=0.02)
            assert result.payload == pytest.approx(payload, abs=0.04)
